"""Requests answered: from a store where it knows the answer, by a crew or a cluster otherwise."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from dualarm_cli.evaluation.request import Request
from dualarm_cli.evaluation.store import Store
from dualarm_cli.model.evaluation import Evaluation

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


def answers(requests: Sequence[Request], run: Run, store: Store | None) -> Iterator[Answer]:
    """Yields an answer to every request: those that the store knows first, the others as they are done.

    Args:
        requests: any number; those that are the same are evaluated once.
        run: evaluates what is not known; not called where all is.
        store: of answers, which new ones are kept in; None for none.
    """
    open_ones: dict[str, list[int]] = {}
    for index, request in enumerate(requests):
        found = None if store is None else store.find(request)
        if found is not None:
            yield Answer(index, found, known=True)
        else:
            open_ones.setdefault(repr(request), []).append(index)
    places = list(open_ones.values())
    if not places:
        return
    for number, evaluation in run([requests[same[0]] for same in places]):
        if store is not None:
            store.keep(requests[places[number][0]], evaluation)
        for index in places[number]:
            yield Answer(index, evaluation, known=False)
