"""What paired arms do side by side, and where they meet."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

T = TypeVar("T")


def side_by_side(rows: Mapping[str, Sequence[T]], meets: Callable[[T], bool]) -> list[dict[str, T]]:
    """Returns stages: the k-th thing of each arm between two meetings, and each meeting as a stage of its own.

    An arm that has run out of things until the next meeting is missing from the stages before it.

    Args:
        rows: what each arm does, in its order; every arm that meets others does so as often.
        meets: whether a thing is done by all arms at once.
    """
    runs = {name: _runs(row, meets) for name, row in rows.items()}
    found = []
    for number in range(max((len(own) for own in runs.values()), default=0)):
        now = {name: own[number] for name, own in runs.items() if number < len(own)}
        found += [
            {name: own[k] for name, own in now.items() if k < len(own)}
            for k in range(max(len(own) for own in now.values()))
        ]
    return found


def _runs(row: Sequence[T], meets: Callable[[T], bool]) -> list[list[T]]:
    """Returns one arm's things between its meetings, and each of these by itself."""
    found: list[list[T]] = [[]]
    for one in row:
        if meets(one):
            found += [[one], []]
        else:
            found[-1].append(one)
    return found
