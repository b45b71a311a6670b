"""Parts where they wait before their pick and where they lie after their place.

The life of a part, as events of the job in the order in which they happen:

    work            from                               to                         where
    pick            the start                          the pick's event           at the pick
    pick, fed       the part before it is put down,    the pick's event           at the pick
                    at the latest its own approach
    place           the end of the place's dwell       the end of the motion      at the place
    place, pick     the end of the place's dwell       the event of the pick      at the place
    belt            the start                          the pick's event           moves with the belt
    hand-over       as a pick and a place: in between one of the arms holds the part

Nothing waits in a buffer whose picks are elsewhere than its places, and nothing lies where a part leaves the cell.
Parts without shapes, and stops whose targets are joint positions, are no bodies.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.job import Job, PoseTarget, Stop, StopKey, Task
from dualarm_cli.model.part_flow import kind_of_part
from dualarm_cli.records import dataclass

SAME_SPOT = 1e-6
"""Largest distance of a pick from the part that it takes [m]."""


@dataclass(frozen=True)
class LyingPart:
    """A part at rest, or on a belt, between two events of a job."""

    task: Task
    """Task that picks the part there or has placed it there."""
    stop: Stop
    """Pick or place whose tool pose locates the part."""
    since: StopKey | None = None
    """Place that puts it there; None from the start, unless fed."""
    until: StopKey | None = None
    """Pick that takes it; None for none."""
    fed: bool = False
    """Whether the part is brought to its pick after `since`.

    It is there at the latest when the tool begins the approach.
    """

    @property
    def key(self) -> StopKey:
        """Key of its stop: arm, task and action."""
        return self.task.arm, self.task.id, self.stop.action

    @property
    def label(self) -> str:
        """Name for messages."""
        return lying_label(self.task)


Visit = tuple[Task, Stop]
"""Task and stop."""


def lying_label(task: Task) -> str:
    """Name a task's part where it waits or lies, for messages."""
    return f"{kind_of_part(task.part)} of {task.id}"


def spot(task: Task, target: PoseTarget) -> FloatArray:
    """Locate the part at a target [m], shape (3,).

    For a part without grasps it is the position of the tool.
    """
    pose = target.pose if task.grasp is None else target.pose * task.grasp.pose.inverse()
    position: FloatArray = pose.translation
    return position


def lying_parts(job: Job, visits: Sequence[Visit]) -> tuple[LyingPart, ...]:
    """List the parts that wait and lie in a job.

    Args:
        job: with its cell and buffers.
        visits: its stops in the order in which they happen, each with its task and the arm that does it.
    """
    transports = [(t, s) for t, s in visits if s.action in ("pick", "place")]
    put_down = {
        task.id: (task.arm, task.id, "place") for task, s in transports if s.action == "place"
    }
    lying_parts: list[LyingPart] = []
    for spot in _spots(transports):
        picked = any(stop.action == "pick" for _, stop in spot)
        for before, (task, stop), after in zip(
            (None, *spot), spot, (*spot[1:], None), strict=False
        ):
            key = task.arm, task.id, stop.action
            taker = None
            if after is not None and after[1].action == "pick":
                taker = after[0].arm, after[0].id, "pick"
            if stop.action == "place":
                # Parts move on in a chute; parts in a pile are beneath the next one.
                moves_on = stop.buffer and not (taker or (picked and after is None))
                if not (task.leaves or moves_on):
                    lying_parts.append(LyingPart(task, stop, since=key, until=taker))
            elif before is None:
                fed = bool(stop.buffer) and not job.buffers[stop.buffer].initial
                lying_parts.append(LyingPart(task, stop, until=key, fed=fed))
            elif before[1].action == "pick" or before[0].leaves:
                since = put_down.get(before[0].id)
                lying_parts.append(LyingPart(task, stop, since, key, fed=True))
            elif not _has_shape(job, before[0]):
                since = before[0].arm, before[0].id, "place"
                lying_parts.append(LyingPart(task, stop, since, key))
    return tuple(part for part in lying_parts if _has_shape(job, part.task))


def _has_shape(job: Job, task: Task) -> bool:
    return bool(job.cell.parts.get(task.part))


def _spots(visits: Sequence[Visit]) -> list[list[Visit]]:
    """Group stops by spot; each stop on a belt is a group by itself."""
    spots: list[list[Visit]] = []
    places = np.empty((len(visits), 3))
    for task, stop in visits:
        if not isinstance(stop.target, PoseTarget):
            continue
        position = np.full(3, np.nan) if stop.moves else spot(task, stop.target)
        distances = np.abs(places[: len(spots)] - position).max(axis=1, initial=0.0)
        same = np.flatnonzero(distances <= SAME_SPOT)
        if not stop.moves and len(same):
            spots[int(same[0])].append((task, stop))
        else:
            places[len(spots)] = position
            spots.append([(task, stop)])
    return spots


def lying_throughout(job: Job, done: Sequence[Task], now: Sequence[Task]) -> tuple[Visit, ...]:
    """List the stops of parts that lie throughout the given tasks.

    Args:
        job: the complete job, with arms and order decided.
        done: tasks before them.
        now: the given tasks; their own parts are not listed.
    """
    before, current = ({(t.arm, t.id) for t in tasks} for tasks in (done, now))
    later = [t for t in job.tasks if (t.arm, t.id) not in before | current]
    order = [(t, s) for t in (*done, *now, *later) for s in t.stops]
    visits = []
    for part in lying_parts(job, order):
        since, until = (None if key is None else key[:2] for key in (part.since, part.until))
        is_there = since in before if since is not None else not part.fed
        if is_there and until not in before | current and part.key[:2] not in current:
            visits.append((part.task, part.stop))
    return tuple(visits)


def may_touch(task: Task, other_task: Task) -> bool:
    """Check whether the parts of two tasks may touch."""
    return other_task.id in task.touches or task.id in other_task.touches
