"""Grouping of the work of several arms into stages, with prerequisites and joint items."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from dualarm_cli.model.job import Stop, Task
    from dualarm_cli.model.robot import Robot

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


def section_stages(
    section: Sequence[Task], robot: Robot
) -> tuple[list[dict[str, tuple[Task, Stop]]], list[tuple[Task, Stop]]]:
    """Group the stops of one section into stages; return also the deadlocked stops."""
    ids = {task.id for task in section}
    rows = {
        arm.name: [(task, stop) for task in section if task.arm == arm.name for stop in task.stops]
        for arm in robot.arms
    }

    def needs(visit: tuple[Task, Stop]) -> Sequence[str]:
        # Other sections are finished before this one begins, or begin after its end.
        task, stop = visit
        return [name for name in task.after if name in ids] if stop is task.stops[0] else ()

    def ends(visit: tuple[Task, Stop]) -> str:
        # A hand-over is finished when the part is placed.
        task, stop = visit
        return task.id if stop is task.stops[-1] and stop.action != "give" else ""

    return side_by_side(
        {name: row for name, row in rows.items() if row},
        lambda visit: visit[1].action in ("give", "take"),
        needs,
        ends,
    )
