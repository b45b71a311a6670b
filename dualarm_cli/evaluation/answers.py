"""Evaluations of requests, from the store, or else from a crew or cluster."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Sequence

from dualarm_cli.errors import Diagnostic, InputError
from dualarm_cli.evaluation.fingerprint import path_of
from dualarm_cli.evaluation.request import Request, case_name
from dualarm_cli.evaluation.store import Store
from dualarm_cli.model.studies.evaluation import Evaluation
from dualarm_cli.records import dataclass

Run = Callable[[Sequence[Request]], Iterator[tuple[int, Evaluation]]]
"""Function that evaluates requests: yields each one's index and evaluation on completion."""


@dataclass(frozen=True)
class Answer:
    """Evaluation of one request."""

    index: int
    """Index of the request."""
    evaluation: Evaluation
    """Result of the request."""
    from_store: bool
    """Flag of an evaluation from the store."""


def answers(
    requests: Sequence[Request],
    run: Run,
    store: Store | None,
    seen: dict[str, str] | None = None,
) -> Iterator[Answer]:
    """Yield the evaluation of every request: stored ones first, others on completion.

    Args:
        requests: any number; equal requests are evaluated once.
        run: evaluates requests that the store lacks; not called if it has all.
        store: of evaluations, extended by new ones, or None.
        seen: hashes by path of the files of earlier evaluations, extended; None for no earlier ones.

    Raises:
        InputError: a file changed meanwhile, so that answers cannot be compared with each other.
    """
    seen = {} if seen is None else seen
    missing: dict[str, list[int]] = {}
    for index, request in enumerate(requests):
        stored = None if store is None else store.find(request)
        if stored is not None:
            _compare_inputs(request, stored, seen)
            yield Answer(index, stored, from_store=True)
        else:
            missing.setdefault(json.dumps(request.as_document()), []).append(index)
    places = list(missing.values())
    if not places:
        return
    for number, evaluation in run([requests[same[0]] for same in places]):
        if store is not None:
            store.keep(requests[places[number][0]], evaluation)
        _compare_inputs(requests[places[number][0]], evaluation, seen)
        for index in places[number]:
            yield Answer(index, evaluation, from_store=False)


def _compare_inputs(request: Request, answer: Evaluation, seen: dict[str, str]) -> None:
    """Raise InputError if a file changed between two evaluations."""
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
