"""A study carried out: points to rows, through the store, by a crew or a cluster."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import field, replace

from dualarm_cli.evaluation.answers import Run, answers
from dualarm_cli.evaluation.request import Request
from dualarm_cli.evaluation.store import Store
from dualarm_cli.model.evaluation import Evaluation
from dualarm_cli.model.study import Point, Study
from dualarm_cli.records import dataclass
from dualarm_cli.studies.requests import point_requests, reference_requests
from dualarm_cli.studies.rows import StudyRow


@dataclass(frozen=True)
class Progress:
    """How far a study is."""

    done: int
    """Points that are done."""
    of: int
    """Points that there are."""
    known: int
    """Plans that the store knew."""
    best: StudyRow | None
    """The best row so far by the first objective."""


@dataclass
class Desk:
    """Where plans come from, and who receives the progress."""

    run: Run
    """Evaluates what the store does not know."""
    store: Store | None
    """Of answers."""
    tell: Callable[[Progress], None] = lambda _: None
    """Called after every point."""
    known: int = 0
    """Plans that the store knew."""
    planned: int = 0
    """Plans that were made."""
    seen: dict[str, str] = field(default_factory=dict)
    """Hashes by path of the files that plans were made from."""

    def rows(
        self, study: Study, points: Sequence[Point], done: Sequence[StudyRow] = ()
    ) -> list[StudyRow]:
        """Returns a row for each point, in the order of the points.

        Args:
            study: what the points are of.
            points: what is asked.
            done: rows of the same study that came before; they count as progress, and number on.

        Raises:
            InputError: a file of the jobs changed meanwhile.
        """
        asked = [point_requests(study, point) for point in points]
        found = self._evaluated(
            asked, lambda k, e: StudyRow(len(done) + k, points[k], e), study, list(done)
        )
        return [found[k] for k in range(len(points))]

    def reference(self, study: Study) -> StudyRow:
        """Returns what the files come to as they are; its number is -1."""
        asked = [reference_requests(study)]
        return self._evaluated(asked, lambda _, e: StudyRow(-1, (), e), study, None)[0]

    def pages(self, study: Study, rows: Sequence[StudyRow]) -> dict[tuple[int, int], str]:
        """Returns the data of plans' pages, packed, by the numbers of row and task file; none where there is no plan.

        What the store has no page of is planned again.

        Args:
            study: what the rows are of.
            rows: that are to be seen.

        Raises:
            InputError: a file of the jobs changed meanwhile.
        """
        asked = [
            replace(request, page=True)
            for row in rows
            for request in (
                point_requests(study, row.point) if row.number >= 0 else reference_requests(study)
            )
        ]
        places = [(row.number, k) for row in rows for k in range(len(study.tasks))]
        found: dict[tuple[int, int], str] = {}
        every = answers(asked, self.run, self.store, self.seen)
        for done, answer in enumerate(every, start=1):
            self.known += answer.known
            self.planned += not answer.known
            if answer.evaluation.page:
                found[places[answer.index]] = answer.evaluation.page
            self.tell(Progress(done, len(asked), self.known, None))
        return found

    def _evaluated(
        self,
        asked: Sequence[Sequence[Request]],
        made: Callable[[int, tuple[Evaluation, ...]], StudyRow],
        study: Study,
        done: list[StudyRow] | None,
    ) -> dict[int, StudyRow]:
        """Returns rows by place; each is made as soon as all its requests are answered."""
        owners = [(k, j) for k, requests in enumerate(asked) for j in range(len(requests))]
        flat = [request for requests in asked for request in requests]
        parts: dict[int, dict[int, Evaluation]] = {k: {} for k in range(len(asked))}
        found: dict[int, StudyRow] = {}
        best = min((row for row in done or () if row.is_planned), key=_first(study), default=None)
        for answer in answers(flat, self.run, self.store, self.seen):
            k, j = owners[answer.index]
            parts[k][j] = answer.evaluation
            self.known += answer.known
            self.planned += not answer.known
            if len(parts[k]) < len(asked[k]):
                continue
            found[k] = row = made(k, tuple(parts[k][j] for j in range(len(asked[k]))))
            if done is not None:
                best = min(
                    (r for r in (best, row) if r is not None and r.is_planned),
                    key=_first(study),
                    default=None,
                )
                ready = len(done) + len(found)
                self.tell(Progress(ready, len(done) + len(asked), self.known, best))
        return found


def _first(study: Study) -> Callable[[StudyRow], float]:
    """Returns what rows are compared by: the first objective."""

    def cost(row: StudyRow) -> float:
        costs = row.costs(study.objectives[:1])
        return float("inf") if costs is None else costs[0]

    return cost
