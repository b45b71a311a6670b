"""Grouping of the work of several arms into stages, with prerequisites and joint items."""

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
    """Group the work of several arms into stages; return also deadlocked items.

    In each stage every arm does its next item whose prerequisites ended in earlier stages. Without prerequisites, stage
    k has the k-th item of each arm. Each joint item (hand-over) is a stage of all arms. An arm is missing from a stage
    if it has no more items, waits for a prerequisite, or is early at a joint item.

    Args:
        rows: items of each arm, in order; every arm with joint items has the same number of them.
        meets: test of items that all arms do at once.
        needs: names of the prerequisites of an item.
        ends: name that is finished with an item; empty for none.
    """
    place, over = dict.fromkeys(rows, 0), set[str]()
    stages: list[dict[str, T]] = []
    while True:
        heads = {name: row[place[name]] for name, row in rows.items() if place[name] < len(row)}
        now = heads
        if not all(meets(item) for item in heads.values()) or len(heads) < len(rows):
            now = {name: item for name, item in heads.items() if not meets(item)}
        now = {name: item for name, item in now.items() if over.issuperset(needs(item))}
        if not now:
            return stages, list(heads.values())
        stages.append(now)
        over.update(ends(item) for item in now.values())
        for name in now:
            place[name] += 1
