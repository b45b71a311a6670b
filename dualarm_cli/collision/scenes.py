"""Rooms of parts that are taken while a job goes on, as each arm meets them.

A scene is a stage, or the time between two events of asynchronous arms. An arm tells by what it holds whether its own
part is still there; of the other arm's parts all count that are there at some time of the stage.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import field, replace

from dualarm_cli.collision.rooms import PartRoom, RoomKey
from dualarm_cli.model.job import Job, StopKey, Task
from dualarm_cli.model.lying import LyingPart, Visit, lying_parts
from dualarm_cli.records import dataclass

AFTER_ALL = 1 << 60
"""A time after every other one."""


@dataclass(frozen=True)
class ArmScene:
    """The parts that one arm meets in a scene, as numbers of rooms."""

    empty: frozenset[int] = frozenset()
    """Those that lie while it holds no part."""
    holding: frozenset[int] = frozenset()
    """Those that lie while it holds one."""
    here: Mapping[int, Visit] = field(default_factory=dict)
    """Those of its own stop, with that: its tool may touch them on the lines."""
    left: Mapping[int, Visit] = field(default_factory=dict)
    """Those of the stop that it has left, with that."""
    carries: Task | None = None
    """The task whose part it holds or is about to hold."""


Scene = Mapping[str, ArmScene]
"""By arm."""


@dataclass(frozen=True)
class _Span:
    """When a room is taken: in stage k until 2 k, its events being between 2 k and 2 k + 1."""

    start: int
    end: int
    lying: LyingPart

    @property
    def events(self) -> tuple[StopKey | None, StopKey | None]:
        """The stops whose events begin and end it."""
        return self.lying.since, self.lying.until

    def at(self, time: int) -> bool:
        """Return whether it is taken at a time."""
        return self.start <= time <= self.end


def stage_scenes(job: Job, rooms: Sequence[PartRoom]) -> tuple[Scene, ...]:
    """List what lies before all stages and in each of them.

    Args:
        job: decided.
        rooms: of its parts, and of those that lie beside it.
    """
    stages = job.stages()
    visits = [row[arm] for row in stages for arm in row]
    number: dict[StopKey, int] = {
        (arm, t.id, s.action): k for k, row in enumerate(stages) for arm, (t, s) in row.items()
    }
    spans, fixed = _spans(job, visits, rooms, number, lambda key: 2 * number[key])
    arms = [arm.name for arm in job.cell.robot.arms]
    scenes: list[Scene] = [{arm: ArmScene(fixed, fixed) for arm in arms}]
    last: dict[str, Visit] = {}
    for k, row in enumerate(stages):
        now = [r for r, span in spans.items() if span.at(2 * k) or span.at(2 * k + 1)]
        visited = {arm: (row.get(arm), last.get(arm)) for arm in arms}
        scenes.append({a: _met(a, visited[a], now, fixed, spans, (2 * k, 2 * k + 1)) for a in arms})
        last |= row
    return tuple(scenes)


def timed_scenes(
    job: Job,
    rooms: Sequence[PartRoom],
    visits: Sequence[Visit],
    coming: Mapping[StopKey, int],
    spans: Sequence[tuple[int, Collection[str]]],
) -> tuple[Scene, ...]:
    """List what lies in each of some spans of time.

    Args:
        job: decided.
        rooms: of its parts, and of those that lie beside it.
        visits: picks and places in the order in which they change what lies.
        coming: number of the first visit that comes after the tool is on its way to a pick, by the pick.
        spans: for each the number of visits before it, and the arms that are on the retract of their last one.
    """
    number: dict[StopKey, int] = {(t.arm, t.id, s.action): k for k, (t, s) in enumerate(visits)}
    taken, fixed = _spans(job, visits, rooms, number, lambda key: 2 * coming[key])
    arms = [arm.name for arm in job.cell.robot.arms]
    scenes: list[Scene] = []
    for k, leaving in spans:
        now = [r for r, span in taken.items() if span.at(2 * k)]
        row = {}
        for arm in arms:
            before = [visit for visit in visits[:k] if visit[0].arm == arm]
            after = [visit for visit in visits[k:] if visit[0].arm == arm]
            visited = after[0] if after else None, before[-1] if before else None
            row[arm] = _met(arm, visited, now, fixed, taken, (2 * k, 2 * k))
            if arm in leaving:
                row[arm] = replace(row[arm], here=row[arm].left, left={})
        scenes.append(row)
    return tuple(scenes)


def _spans(
    job: Job,
    visits: Sequence[Visit],
    rooms: Sequence[PartRoom],
    number: Mapping[StopKey, int],
    coming: Callable[[StopKey], int],
) -> tuple[dict[int, _Span], frozenset[int]]:
    """Return when each room is taken, and the rooms that are taken all the time."""
    room_of: dict[RoomKey, int] = {room.key: r for r, room in enumerate(rooms)}
    spans = {}
    for lying in lying_parts(job, visits):
        r = room_of.get(lying.key[1:])
        if r is None:
            continue
        start = 0
        if lying.fed:
            start = coming(lying.key)
        if lying.since is not None and lying.since in number:
            put = 2 * number[lying.since] + 1
            start = min(start, put) if lying.fed else put
        end = AFTER_ALL if lying.until is None else 2 * number[lying.until]
        spans[r] = _Span(start, end, lying)
    beside = [(task.id, stop.action) for task, stop in job.beside]
    fixed = frozenset(room_of[key] for key in beside if key in room_of)
    return spans, fixed


def _met(
    arm: str,
    visited: tuple[Visit | None, Visit | None],
    now: Sequence[int],
    fixed: frozenset[int],
    spans: Mapping[int, _Span],
    times: tuple[int, int],
) -> ArmScene:
    """List the parts that one arm meets in a scene: at its stop there, or else after the one before."""
    here, before = visited
    own: dict[int, Visit] = {}
    left: dict[int, Visit] = {}
    for r in now:
        lying = spans[r].lying
        for visit, found in ((before, left), (here, own)):
            if visit is not None and (arm, visit[0].id, visit[1].action) in (
                lying.key,
                lying.until,
            ):
                found[r] = visit
    first = then = frozenset(now) | fixed
    if here is not None and here[0].part:
        # It tells by what it holds whether its own event is over.
        key = arm, here[0].id, here[1].action
        first, then = (
            frozenset(r for r in now if key not in spans[r].events or spans[r].at(time)) | fixed
            for time in times
        )
    empty, holding = (then, first) if here and here[1].action == "place" else (first, then)
    task = here or before
    return ArmScene(empty, holding, own, left, task and task[0])
