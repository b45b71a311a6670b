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

from dualarm_cli.model.job import Job, PoseTarget, Stop, StopKey, Task
from dualarm_cli.records import dataclass

SAME_SPOT = 1e-6
"""Largest distance of a pick from the part that it takes [m]."""


@dataclass(frozen=True)
class LyingPart:
    """A part at rest, or on a belt, between two events of a job."""

    task: Task
    """The task that picks it there, or that has placed it there."""
    stop: Stop
    """The pick or place whose tool pose says where it is."""
    since: StopKey | None = None
    """Place after which it is there; None from the start, unless fed."""
    until: StopKey | None = None
    """The pick that takes it; None for none."""
    fed: bool = False
    """Flag of parts that are brought to their pick after `since`.

    At the latest they are there as the tool comes onto the approach.
    """

    @property
    def key(self) -> StopKey:
        """Arm, task and action of its stop."""
        return self.task.arm, self.task.id, self.stop.action

    @property
    def label(self) -> str:
        """Name for messages."""
        return lying_label(self.task)


Visit = tuple[Task, Stop]
"""A stop with its task."""


def lying_label(task: Task) -> str:
    """Name a task's part where it waits or lies, for messages."""
    return f"{task.part.partition('@')[0]} of {task.id}"


def lying_parts(job: Job, visits: Sequence[Visit]) -> tuple[LyingPart, ...]:
    """List the parts that wait and lie in a job.

    Args:
        job: with its cell and buffers.
        visits: its stops in the order in which they happen, each with its task and the arm that does it.
    """
    own = [(t, s) for t, s in visits if s.action in ("pick", "place")]
    put_down = {task.id: (task.arm, task.id, "place") for task, s in own if s.action == "place"}
    found: list[LyingPart] = []
    for spot in _spots(own):
        picked = any(stop.action == "pick" for _, stop in spot)
        for before, (task, stop), after in zip(
            (None, *spot), spot, (*spot[1:], None), strict=False
        ):
            key = task.arm, task.id, stop.action
            taker = None
            if after is not None and after[1].action == "pick":
                taker = after[0].arm, after[0].id, "pick"
            if stop.action == "place":
                # A chute moves on what is put into it, and a pile is beneath what is put onto it.
                moves_on = stop.buffer and not (taker or (picked and after is None))
                if not (task.leaves or moves_on):
                    found.append(LyingPart(task, stop, since=key, until=taker))
            elif before is None:
                fed = bool(stop.buffer) and not job.buffers[stop.buffer].initial
                found.append(LyingPart(task, stop, until=key, fed=fed))
            elif before[1].action == "pick" or before[0].leaves:
                since = put_down.get(before[0].id)
                found.append(LyingPart(task, stop, since, key, fed=True))
            elif not _has_shape(job, before[0]):
                since = before[0].arm, before[0].id, "place"
                found.append(LyingPart(task, stop, since, key))
    return tuple(lying for lying in found if _has_shape(job, lying.task))


def _has_shape(job: Job, task: Task) -> bool:
    return bool(job.cell.parts.get(task.part))


def _spots(visits: Sequence[Visit]) -> list[list[Visit]]:
    """Group stops by their tool positions, with each one on a belt by itself."""
    spots: list[list[Visit]] = []
    places = np.empty((len(visits), 3))
    for task, stop in visits:
        if not isinstance(stop.target, PoseTarget):
            continue
        here = np.full(3, np.nan) if stop.moves else stop.target.pose.translation
        apart = np.abs(places[: len(spots)] - here).max(axis=1, initial=0.0)
        same = np.flatnonzero(apart <= SAME_SPOT)
        if not stop.moves and len(same):
            spots[int(same[0])].append((task, stop))
        else:
            places[len(spots)] = here
            spots.append([(task, stop)])
    return spots


def lying_beside(job: Job, done: Sequence[Task], now: Sequence[Task]) -> tuple[Visit, ...]:
    """List the stops of parts that lie during all of some tasks.

    Args:
        job: the whole of it, decided.
        done: its tasks before.
        now: those that are done meanwhile; their own parts are left out.
    """
    before, own = ({(t.arm, t.id) for t in some} for some in (done, now))
    later = [t for t in job.tasks if (t.arm, t.id) not in before | own]
    visits = [(t, s) for t in (*done, *now, *later) for s in t.stops]
    found = []
    for lying in lying_parts(job, visits):
        since, until = (None if key is None else key[:2] for key in (lying.since, lying.until))
        begun = since in before if since is not None else not lying.fed
        if begun and until not in before | own and lying.key[:2] not in own:
            found.append((lying.task, lying.stop))
    return tuple(found)


def may_touch(one: Task, other: Task) -> bool:
    """Return whether the parts of two tasks may touch."""
    return other.id in one.touches or one.id in other.touches
