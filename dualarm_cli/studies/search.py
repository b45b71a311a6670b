"""Points of a study: enumerated, sampled or searched, and their evaluation into rows.

The search is a tree-structured Parzen estimator (optuna) in batches. The batch size does not depend on the number of
processes, and results come in the order of the requests, so that the same seed gives the same points everywhere.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import field, replace
from itertools import product
from typing import Any

import numpy as np

from dualarm_cli.errors import MissingDependencyError, UsageError
from dualarm_cli.evaluation.answers import Run, answers
from dualarm_cli.evaluation.request import Request
from dualarm_cli.evaluation.store import Store
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.studies.evaluation import Evaluation
from dualarm_cli.model.studies.study import Amount, Parameter, Point, Sampling, Study
from dualarm_cli.records import dataclass
from dualarm_cli.studies.requests import point_requests, reference_requests
from dualarm_cli.studies.rows import StudyRow


@dataclass(frozen=True)
class StudySearchSettings:
    """Settings of the parameter search."""

    batch: int = 8
    """Number of points per batch."""
    max_proposals: int = 20
    """Maximum number of further proposals after a repeated point."""
    max_draws: int = 200
    """Maximum number of random draws if the estimator has no new point."""
    no_plan_cost: float = 1e9
    """Cost of a point without a plan; the constraint on plans counts first."""
    max_points: int = 100_000
    """Maximum number of points of one study."""


SEARCH = StudySearchSettings()


Rows = Callable[[Sequence[Point], Sequence[StudyRow]], list[StudyRow]]
"""Function that evaluates points, given the earlier rows."""


def require_optuna() -> None:
    """Raise MissingDependencyError if optuna is not installed, without loading it."""
    from importlib.util import find_spec

    if find_spec("optuna") is None:
        raise MissingDependencyError("optuna", "optimise")


def search(study: Study, budget: int, seed: int, evaluate: Rows) -> list[StudyRow]:
    """Search a study's points for good objectives, and return distinct points in order.

    The first points cover the ranges evenly; the estimator proposes the others from the good rows. Rows without a plan
    count as worse than all others. With several objectives the search approximates their Pareto set.

    Args:
        study: parameters and objectives.
        budget: maximum number of points.
        seed: of all randomness.
        evaluate: evaluates points into rows.

    Raises:
        MissingDependencyError: optuna is not installed.
    """
    require_optuna()
    searcher = _Searcher(study, budget, seed)
    rows: list[StudyRow] = []
    while len(rows) < budget:
        points = searcher.ask(min(SEARCH.batch, budget - len(rows)))
        if not points:
            break
        fresh = evaluate(points, rows)
        for row in fresh:
            searcher.tell(row)
        rows += fresh
    return rows


class _Searcher:
    """Ask-and-tell interface to the estimator."""

    def __init__(self, study: Study, budget: int, seed: int) -> None:
        import optuna

        optuna.logging.set_verbosity(optuna.logging.WARNING)
        self._state = optuna.trial.TrialState
        self._study, self._rng = study, np.random.default_rng(seed)
        self._axes = [_Axis(f"x{k}", parameter) for k, parameter in enumerate(study.parameters)]
        first = int(np.clip(budget // 3, min(budget, 2), 10 + 2 * len(self._axes)))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # parts of the estimator that optuna calls experimental
            sampler = optuna.samplers.TPESampler(
                seed=seed,
                n_startup_trials=first,
                multivariate=True,
                constant_liar=True,
                constraints_func=lambda trial: (trial.user_attrs.get("misses", 0.0),),
            )
            directions = ["minimize"] * len(study.objectives)
            self._optuna = optuna.create_study(directions=directions, sampler=sampler)
        shares = sample_shares(Sampling("halton", first, seed), len(self._axes))
        self._spread = iter([self._point(row) for row in shares])
        self._trials: dict[Point, Any] = {}
        self._known: dict[Point, tuple[list[float], float]] = {}

    def ask(self, count: int) -> list[Point]:
        """Propose up to `count` new points; fewer if there are no more."""
        points = []
        for _ in range(count):
            point = self._next()
            if point is None:
                break
            points.append(point)
        return points

    def tell(self, row: StudyRow) -> None:
        """Report the result of a point."""
        costs = row.costs(self._study.objectives)
        if costs is None:
            costs, misses = [SEARCH.no_plan_cost] * len(self._study.objectives), 1.0
        else:
            misses = 0.0
        self._known[row.point] = costs, misses
        self._tell(self._trials[row.point], costs, misses)

    def _tell(self, trial: Any, costs: list[float], misses: float) -> None:
        trial.set_user_attr("misses", misses)
        self._optuna.tell(trial, costs)

    def _next(self) -> Point | None:
        """Propose one new point: of the initial design, of the estimator, or random."""
        for point in self._spread:
            if point not in self._trials:
                return self._take(self._trial_of(point), point)
        for _ in range(SEARCH.max_proposals):
            trial = self._ask()
            point = tuple(axis.level(trial.params[axis.name]) for axis in self._axes)
            if point not in self._trials:
                return self._take(trial, point)
            # The repeated result moves the estimator away from this point.
            if point in self._known:
                self._tell(trial, *self._known[point])
            else:
                self._optuna.tell(trial, state=self._state.FAIL)
        drawn = self._any()
        return None if drawn is None else self._take(self._trial_of(drawn), drawn)

    def _take(self, trial: Any, point: Point) -> Point:
        self._trials[point] = trial
        return point

    def _trial_of(self, point: Point) -> Any:
        """Create a trial of a given point."""
        values = {a.name: a.value(level) for a, level in zip(self._axes, point, strict=True)}
        self._optuna.enqueue_trial(values)
        return self._ask()

    def _ask(self) -> Any:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return self._optuna.ask({axis.name: axis.distribution for axis in self._axes})

    def _point(self, shares: Sequence[float]) -> Point:
        return tuple(a.at(float(share)) for a, share in zip(self._axes, shares, strict=True))

    def _any(self) -> Point | None:
        """Draw a new random point, or None."""
        for _ in range(SEARCH.max_draws):
            point = self._point(self._rng.random(len(self._axes)).tolist())
            if point not in self._trials:
                return point
        return next((p for p in self._all() if p not in self._trials), None)

    def _all(self) -> Iterator[Point]:
        """Yield every combination if all parameters have steps."""
        if all(axis.levels for axis in self._axes):
            yield from product(*(axis.levels for axis in self._axes))


class _Axis:
    """Encoding of a parameter: fraction of a range, index of a number, or word."""

    def __init__(self, name: str, parameter: Parameter) -> None:
        from optuna.distributions import (
            CategoricalDistribution,
            FloatDistribution,
            IntDistribution,
        )

        self.name, self._span = name, parameter.span
        self.levels = list(parameter.levels)
        self.distribution: Any
        if self._span is not None:
            self.distribution = FloatDistribution(0.0, 1.0)
        elif parameter.is_numeric:
            self.levels.sort(key=lambda level: level.si if isinstance(level, Amount) else 0.0)
            self.distribution = IntDistribution(0, len(self.levels) - 1)
        else:
            self.distribution = CategoricalDistribution(list(range(len(self.levels))))

    def at(self, share: float) -> Any:
        """Return the level at a fraction from 0 to 1."""
        if self._span is not None:
            return self._span.at(share)
        return self.levels[min(int(share * len(self.levels)), len(self.levels) - 1)]

    def level(self, value: Any) -> Any:
        """Decode the estimator's value of a level."""
        return self._span.at(value) if self._span is not None else self.levels[value]

    def value(self, level: Any) -> Any:
        """Encode a level for the estimator."""
        if self._span is None:
            return self.levels.index(level)
        low, high = self._span.low.number, self._span.high.number
        return float(np.clip((level.number - low) / (high - low), 0.0, 1.0))


def whole_grid(study: Study) -> int | None:
    """Count the points of the whole grid, or return None for ranges without steps."""
    if any(parameter.span is not None for parameter in study.parameters):
        return None
    return math.prod(len(parameter.levels) for parameter in study.parameters)


def count_points(study: Study) -> int | None:
    """Count the points of a study.

    None where a range has neither steps nor samples.
    """
    sampled = any(parameter.span is not None for parameter in study.parameters)
    if sampled and study.sampling is None:
        return None
    count = study.sampling.count if sampled and study.sampling is not None else 1
    for parameter in study.parameters:
        count *= max(1, len(parameter.levels))
    return count


def study_points(study: Study) -> list[Point]:
    """Enumerate the points of a study: all combinations of its parameters' values.

    Samples of the ranges are combined with all steps of the other parameters. The last parameter changes first, and
    samples change before all parameters.

    Args:
        study: the study.

    Raises:
        UsageError: a range has neither steps nor samples, or there are too many points.
    """
    count = count_points(study)
    if count is None:
        parameter = next(p for p in study.parameters if p.span is not None)
        raise UsageError(
            f"{parameter.place}: the range of {parameter.name!r} has no steps; give it step or count, add "
            "`sample: {count: 40}` to the study, or search it with --optimise"
        )
    if count > SEARCH.max_points:
        raise UsageError(
            f"{study.name}: has {count:,} points, at most {SEARCH.max_points:,} are planned; use longer steps, "
            "`sample:`, or --optimise"
        )
    spans = [p.span for p in study.parameters if p.span is not None]
    samples: list[Point] = [()]
    if study.sampling is not None:
        shares = sample_shares(study.sampling, len(spans))
        samples = [
            tuple(span.at(float(share)) for span, share in zip(spans, row, strict=True))
            for row in shares
        ]
    points = []
    for steps in product(*(p.levels for p in study.parameters if p.span is None)):
        for sample in samples:
            level, drawn = iter(steps), iter(sample)
            points.append(
                tuple(next(level) if p.span is None else next(drawn) for p in study.parameters)
            )
    return points


def sample_shares(sampling: Sampling, dimensions: int) -> FloatArray:
    """Draw samples of the unit cube, shape (count, dimensions).

    Args:
        sampling: method, count and seed. Of a Latin hypercube each of `count` equal parts of every side has one sample.
            The first points of a longer Halton sequence are those of a shorter one.
        dimensions: of the cube.
    """
    from scipy.stats import qmc  # takes a second, and grids do not need it

    rng = np.random.default_rng(sampling.seed)
    if sampling.method == "halton":
        return qmc.Halton(dimensions, rng=rng).random(sampling.count)
    return qmc.LatinHypercube(dimensions, rng=rng).random(sampling.count)


@dataclass(frozen=True)
class Progress:
    """Progress of a study."""

    done: int
    """Number of finished points."""
    of: int
    """Total number of points."""
    from_store: int
    """Number of plans from the store."""
    best: StudyRow | None
    """Best row so far by the first objective."""


@dataclass
class Desk:
    """Evaluator of a study's points, from the store or by new plans."""

    run: Run
    """Runner of requests that the store lacks."""
    store: Store | None
    """Store of earlier evaluations, or None."""
    tell: Callable[[Progress], None] = lambda _: None
    """Progress callback after every point."""
    from_store: int = 0
    """Number of plans from the store."""
    planned: int = 0
    """Number of new plans."""
    seen: dict[str, str] = field(default_factory=dict)
    """Hashes of the files read, by path."""

    def rows(
        self, study: Study, points: Sequence[Point], done: Sequence[StudyRow] = ()
    ) -> list[StudyRow]:
        """Evaluate points into one row each, in their order.

        Args:
            study: the study.
            points: to evaluate.
            done: earlier rows of the same study; they count as progress, and numbering continues after them.

        Raises:
            InputError: a file of the jobs changed meanwhile.
        """
        requests = [point_requests(study, point) for point in points]
        rows = self._evaluated(
            requests, lambda k, e: StudyRow(len(done) + k, points[k], e), study, list(done)
        )
        return [rows[k] for k in range(len(points))]

    def reference(self, study: Study) -> StudyRow:
        """Evaluate the unchanged files of a study, as row number -1."""
        requests = [reference_requests(study)]
        return self._evaluated(requests, lambda _, e: StudyRow(-1, (), e), study, None)[0]

    def pages(self, study: Study, rows: Sequence[StudyRow]) -> dict[tuple[int, int], str]:
        """Collect the page data of plans, and plan those again that the store lacks.

        Args:
            study: the study.
            rows: rows to show.

        Returns:
            Packed page data by the numbers of row and task file, without those that have no plan.

        Raises:
            InputError: a file of the jobs changed meanwhile.
        """
        requests = [
            replace(request, page=True)
            for row in rows
            for request in (
                point_requests(study, row.point) if row.number >= 0 else reference_requests(study)
            )
        ]
        places = [(row.number, k) for row in rows for k in range(len(study.tasks))]
        pages_by_place: dict[tuple[int, int], str] = {}
        every = answers(requests, self.run, self.store, self.seen)
        for done, answer in enumerate(every, start=1):
            self.from_store += answer.from_store
            self.planned += not answer.from_store
            if answer.evaluation.page:
                pages_by_place[places[answer.index]] = answer.evaluation.page
            self.tell(Progress(done, len(requests), self.from_store, None))
        return pages_by_place

    def _evaluated(
        self,
        batches: Sequence[Sequence[Request]],
        make_row: Callable[[int, tuple[Evaluation, ...]], StudyRow],
        study: Study,
        done: list[StudyRow] | None,
    ) -> dict[int, StudyRow]:
        """Evaluate requests into rows by place, each row once it is complete."""
        owners = [(k, j) for k, requests in enumerate(batches) for j in range(len(requests))]
        flat = [request for requests in batches for request in requests]
        parts: dict[int, dict[int, Evaluation]] = {k: {} for k in range(len(batches))}
        rows: dict[int, StudyRow] = {}
        best = min((row for row in done or () if row.is_planned), key=_first(study), default=None)
        for answer in answers(flat, self.run, self.store, self.seen):
            k, j = owners[answer.index]
            parts[k][j] = answer.evaluation
            self.from_store += answer.from_store
            self.planned += not answer.from_store
            if len(parts[k]) < len(batches[k]):
                continue
            rows[k] = row = make_row(k, tuple(parts[k][j] for j in range(len(batches[k]))))
            if done is not None:
                best = min(
                    (r for r in (best, row) if r is not None and r.is_planned),
                    key=_first(study),
                    default=None,
                )
                ready = len(done) + len(rows)
                self.tell(Progress(ready, len(done) + len(batches), self.from_store, best))
        return rows


def _first(study: Study) -> Callable[[StudyRow], float]:
    """Create the cost function of a row's first objective."""

    def cost(row: StudyRow) -> float:
        costs = row.costs(study.objectives[:1])
        return float("inf") if costs is None else costs[0]

    return cost
