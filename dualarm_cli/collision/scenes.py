"""Scenes: rooms that are occupied while a job is executed, for each arm.

A scene is a stage, or the time between two events of asynchronous arms. The load of an arm determines whether its own
part is still in its room; the other arm's parts are present if they are there at any time of the stage.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import field, replace

from dualarm_cli.collision.rooms import PartRoom, RoomKey
from dualarm_cli.model.job import Job, StopKey, Task
from dualarm_cli.model.lying import LyingPart, Visit, lying_parts
from dualarm_cli.records import dataclass

AFTER_ALL = 1 << 60
"""Time after all others."""


@dataclass(frozen=True)
class ArmScene:
    """Parts that an arm may collide with in a scene, as indices of rooms."""

    empty: frozenset[int] = frozenset()
    """Rooms that are occupied while the arm holds no part."""
    holding: frozenset[int] = frozenset()
    """Rooms that are occupied while the arm holds a part."""
    here: Mapping[int, Visit] = field(default_factory=dict)
    """Rooms of its present stop; its tool may touch these parts on lines."""
    left: Mapping[int, Visit] = field(default_factory=dict)
    """Rooms of the previous stop."""
    carries: Task | None = None
    """Task whose part it holds or will hold."""


Scene = Mapping[str, ArmScene]
"""Scene of each arm, by name."""


@dataclass(frozen=True)
class _Span:
    """Occupation of a room, up to 2k in stage k (events before 2k + 1)."""

    start: int
    end: int
    lying: LyingPart

    @property
    def events(self) -> tuple[StopKey | None, StopKey | None]:
        """Stops whose events begin and end it."""
        return self.lying.since, self.lying.until

    def at(self, time: int) -> bool:
        """Check whether the room is occupied at a time."""
        return self.start <= time <= self.end


def stage_scenes(job: Job, rooms: Sequence[PartRoom]) -> tuple[Scene, ...]:
    """List the occupied rooms before all stages and in each stage.

    Args:
        job: the job, with arms and order decided.
        rooms: rooms of its parts, and of parts that lie throughout.
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
    """List the occupied rooms in each of the given spans.

    Args:
        job: the job, with arms and order decided.
        rooms: rooms of its parts, and of parts that lie throughout.
        visits: picks and places in the order in which they change the rooms.
        coming: index of the first visit after the tool has begun to approach a pick, by the pick.
        spans: number of visits before each span, and the arms that are on the retract of their last one.
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
    """Compute the occupation of each room, and the rooms that are always occupied."""
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
    lying_keys = [(task.id, stop.action) for task, stop in job.lying]
    fixed = frozenset(room_of[key] for key in lying_keys if key in room_of)
    return spans, fixed


def _met(
    arm: str,
    visited: tuple[Visit | None, Visit | None],
    now: Sequence[int],
    fixed: frozenset[int],
    spans: Mapping[int, _Span],
    times: tuple[int, int],
) -> ArmScene:
    """List the parts that an arm may collide with at its stop and the previous one."""
    here, before = visited
    at_stop: dict[int, Visit] = {}
    left: dict[int, Visit] = {}
    for r in now:
        lying = spans[r].lying
        for visit, rooms in ((before, left), (here, at_stop)):
            if visit is not None and (arm, visit[0].id, visit[1].action) in (
                lying.key,
                lying.until,
            ):
                rooms[r] = visit
    before_event = after = frozenset(now) | fixed
    if here is not None and here[0].part:
        # The load shows whether the arm's own event has passed.
        key = arm, here[0].id, here[1].action
        before_event, after = (
            frozenset(r for r in now if key not in spans[r].events or spans[r].at(time)) | fixed
            for time in times
        )
    empty, holding = (
        (after, before_event) if here and here[1].action == "place" else (before_event, after)
    )
    task = here or before
    return ArmScene(empty, holding, at_stop, left, task and task[0])
