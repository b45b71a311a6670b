"""Requests answered: from a store where it knows the answer, by a crew or a cluster otherwise."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence

from dualarm_cli.errors import Diagnostic, InputError
from dualarm_cli.evaluation.fingerprint import path_of
from dualarm_cli.evaluation.request import Request, case_name
from dualarm_cli.evaluation.store import Store
from dualarm_cli.model.evaluation import Evaluation
from dualarm_cli.records import dataclass

Run = Callable[[Sequence[Request]], Iterator[tuple[int, Evaluation]]]
"""Evaluates requests: yields the place of each and what it came to, in the order in which they are done."""


@dataclass(frozen=True)
class Answer:
    """What one request came to."""

    index: int
    """Its place among the requests."""
    evaluation: Evaluation
    """What it came to."""
    known: bool
    """Whether the store knew."""


def answers(
    requests: Sequence[Request],
    run: Run,
    store: Store | None,
    seen: dict[str, str] | None = None,
) -> Iterator[Answer]:
    """Yields an answer to every request: those that the store knows first, the others as they are done.

    Args:
        requests: any number; those that are the same are evaluated once.
        run: evaluates what is not known; not called where all is.
        store: of answers, which new ones are kept in; None for none.
        seen: hashes by path of the files that earlier answers were made from, added to; None where there are none.

    Raises:
        InputError: a file changed meanwhile, so that answers cannot be compared with each other.
    """
    seen = {} if seen is None else seen
    open_ones: dict[str, list[int]] = {}
    for index, request in enumerate(requests):
        found = None if store is None else store.find(request)
        if found is not None:
            _compare_inputs(request, found, seen)
            yield Answer(index, found, known=True)
        else:
            open_ones.setdefault(repr(request), []).append(index)
    places = list(open_ones.values())
    if not places:
        return
    for number, evaluation in run([requests[same[0]] for same in places]):
        if store is not None:
            store.keep(requests[places[number][0]], evaluation)
        _compare_inputs(requests[places[number][0]], evaluation, seen)
        for index in places[number]:
            yield Answer(index, evaluation, known=False)


def _compare_inputs(request: Request, answer: Evaluation, seen: dict[str, str]) -> None:
    """Makes sure that a file holds the same in all answers.

    Raises:
        InputError: one does not.
    """
    for name, held in answer.inputs.items():
        path = path_of(name, request.folder)
        if path not in seen:
            seen[path] = seen.setdefault(os.path.realpath(path), held)
        if seen[path] != held:
            message = (
                "has changed while cells were planned, so some plans are out of date; run the same command again to "
                "replan what has changed"
            )
            raise InputError([Diagnostic(case_name(path), 0, 0, "E500", message)])
