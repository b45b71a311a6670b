"""What paired arms do side by side, where they meet, and what they wait for."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import TypeVar

T = TypeVar("T")


def side_by_side(
    rows: Mapping[str, Sequence[T]],
    meets: Callable[[T], bool],
    needs: Callable[[T], Collection[str]],
    ends: Callable[[T], str],
) -> tuple[list[dict[str, T]], list[T]]:
    """Returns stages, and what is left as arms wait for one another for ever.

    In every stage each arm does its next thing as soon as what that needs has ended in an earlier stage: without needs
    the k-th things of all arms between two meetings. Each meeting is a stage of its own. An arm that has run out of
    things, waits, or is early at a meeting is missing from a stage.

    Args:
        rows: what each arm does, in its order; every arm that meets others does so as often.
        meets: whether a thing is done by all arms at once.
        needs: what has to have ended before a thing, by name.
        ends: the name of what ends with a thing; empty for nothing.
    """
    place, over = dict.fromkeys(rows, 0), set[str]()
    stages: list[dict[str, T]] = []
    while True:
        heads = {name: row[place[name]] for name, row in rows.items() if place[name] < len(row)}
        if not all(meets(one) for one in heads.values()) or len(heads) < len(rows):
            now = {name: one for name, one in heads.items() if not meets(one)}
        else:
            now = heads
        now = {name: one for name, one in now.items() if over.issuperset(needs(one))}
        if not now:
            return stages, list(heads.values())
        stages.append(now)
        over.update(ends(one) for one in now.values())
        for name in now:
            place[name] += 1
