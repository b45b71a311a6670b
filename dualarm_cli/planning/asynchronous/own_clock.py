"""Timeline of one arm with a standing platform: motion, rests and departures.

`OwnClock` is the motion of one arm through its stops and the places at which it can wait. `leaving_times` turns a
coordination of two arms that was found in whole steps into exact instants.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dualarm_cli.collision.clearance import CellClearance
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.model.job import Job
from dualarm_cli.model.motion.trajectory import SAME_TIME, Trajectory
from dualarm_cli.model.schedule import Event, Segment, Stage, WaitReason
from dualarm_cli.motion.builder import Motion
from dualarm_cli.records import dataclass
from dualarm_cli.timing.composition import concatenate, hold

LINES = ("approach", "dwell", "retract")
"""Segments on which a held part may touch stationary bodies."""
AT_REST = 1e-6
"""Speed below which a joint counts as standing [rad/s or m/s]."""
BEFORE_MOVING = ("transfer", "return")
"""Segments before which an arm may wait."""


@dataclass(frozen=True)
class Wait:
    """Wait inserted into an arm's motion."""

    at: float
    """Instant by the arm's own clock [s]."""
    length: float
    """Duration of the wait [s]."""
    reason: WaitReason
    """Reason of the wait."""


@dataclass(frozen=True)
class OwnClock:
    """Motion of one arm by its own clock."""

    arm: str
    """Name of the arm."""
    trajectory: Trajectory
    """Trajectory of the arm's joints."""
    stages: tuple[Stage, ...]
    """Stages: each stop, and the return."""
    segments: tuple[Segment, ...]
    """Segments in time order, without gaps."""
    events: tuple[Event, ...]
    """Events in time order."""

    @classmethod
    def of(cls, motion: Motion, arm: str, joints: tuple[str, ...]) -> OwnClock:
        """Extract the only working arm from a motion."""
        segments = tuple(part for part in motion.segments if part.arm == arm)
        return cls(
            arm,
            motion.trajectory.select(joints),
            tuple(replace(stage, arm=arm) for stage in motion.stages),
            segments,
            tuple(event for event in motion.events if event.arm == arm),
        )

    @property
    def duration(self) -> float:
        """Duration of the motion [s]."""
        return self.trajectory.duration

    def rests(self) -> list[float]:
        """Return the increasing instants of possible waits by the arm's clock [s].

        These are departures, starts of lines and starts of tasks without duration, if the arm is at rest there.
        """
        candidates = list(self.line_begins().values())
        before = BEFORE_MOVING[0]  # with a free start the first line may begin at once
        for part in self.segments:
            to_line = before in BEFORE_MOVING and part.kind not in BEFORE_MOVING
            if part.kind in BEFORE_MOVING or to_line:
                candidates.append(part.start)
            before = part.kind
        rests: list[float] = []
        for time in sorted(candidates):
            if (not rests or time > rests[-1] + SAME_TIME) and self._stands(time):
                rests.append(time)
        return rests

    def _stands(self, time: float) -> bool:
        """Return whether all joints stand at an instant [s]."""
        return bool(np.abs(self.trajectory.clamped(np.array([time]))[1]).max(initial=0.0) < AT_REST)

    def line_begins(self) -> dict[str, float]:
        """Return the start of each task's first line, by the own clock [s].

        A bare move, without lines and dwell, begins at the arm's departure and ends on its arrival.
        """
        begins: dict[str, float] = {}
        before = BEFORE_MOVING[0]  # with a free start the first line may begin at once
        for part in self.segments:
            if before in BEFORE_MOVING and part.kind not in BEFORE_MOVING and part.kind != "wait":
                begins.setdefault(part.task, part.start)
            before = part.kind
        for event in self.events:
            leaves = (
                part.start
                for part in self.segments
                if part.kind in BEFORE_MOVING and abs(part.end - event.time) <= SAME_TIME
            )
            if event.task not in begins:
                begins[event.task] = min(leaves, default=event.time)
        return begins

    def task_ends(self) -> dict[str, float]:
        """Return the end of each task, by the own clock [s]."""
        ends = {event.task: event.time + event.dwell for event in self.events}
        for part in self.segments:
            if part.task in ends and part.kind not in ("wait", *BEFORE_MOVING):
                ends[part.task] = max(ends[part.task], part.end)
        return ends

    def last_line(self) -> float:
        """Return the end of the last line or dwell, by the own clock [s]."""
        return max(self.task_ends().values(), default=0.0)

    def held(self, time: FloatArray, cell: CellClearance, job: Job) -> IntArray:
        """Return the held part at instants, as indices of the collision test, shape (t,).

        Args:
            time: instants by its own clock [s], shape (t,).
            cell: the collision test.
            job: job with fixed arms and order.
        """
        tasks, number = {task.id: task for task in job.tasks}, cell.loads.number
        parts = np.full(len(time), number(job.held_at_start(self.arm)))
        begins = self._begins()
        for event in self.events:
            if event.task not in tasks:
                continue
            task, began = tasks[event.task], begins[event.task, event.action]
            parts[time >= began - SAME_TIME] = number(task.held_before(event.action))
            parts[time >= event.changes_held - SAME_TIME] = number(task.held_after(event.action))
        for start, end in self._lines():
            inside = (time >= start - SAME_TIME) & (time <= end + SAME_TIME)
            parts[inside] = cell.loads.on_lines(parts[inside])
        return parts

    def _begins(self) -> dict[tuple[str, str], float]:
        """Return the start of each stop's first line or dwell [s], by (task, action)."""
        begins = {(event.task, event.action): event.time for event in self.events}
        for part in self.segments:
            key = (part.task, part.action)
            if part.kind in LINES and key in begins:
                begins[key] = min(begins[key], part.start)
        return begins

    def _lines(self) -> list[tuple[float, float]]:
        """Return the time spans of lines and dwells."""
        spans: list[tuple[float, float]] = [(e.time, e.time + e.dwell) for e in self.events]
        spans += [(p.start, p.end) for p in self.segments if p.kind in LINES]
        return sorted(spans)

    def with_waits(self, waits: Sequence[Wait]) -> OwnClock:
        """Insert waits into the motion."""
        waits = sorted((wait for wait in waits if wait.length > SAME_TIME), key=lambda w: w.at)
        if not waits:
            return self
        at, until = [wait.at for wait in waits], np.cumsum([wait.length for wait in waits])

        def begins(time: float) -> float:
            k = bisect_right(at, time + SAME_TIME)
            return time + (float(until[k - 1]) if k else 0.0)

        def ends(time: float) -> float:
            k = bisect_left(at, time - SAME_TIME)
            return time + (float(until[k - 1]) if k else 0.0)

        moved = [replace(p, start=begins(p.start), end=ends(p.end)) for p in self.segments]
        for wait in waits:
            end = begins(wait.at)
            task = next((p for p in self.segments if p.start >= wait.at - SAME_TIME), None)
            names = (task.task, task.action) if task is not None else ("", "")
            moved.append(
                Segment(self.arm, "wait", *names, end - wait.length, end, reason=wait.reason)
            )
        return OwnClock(
            self.arm,
            with_holds(self.trajectory, waits),
            tuple(
                replace(s, start=begins(s.start), end=max(begins(s.start), ends(s.end)))
                for s in self.stages
            ),
            tuple(sorted(moved, key=lambda part: (part.start, part.end))),
            tuple(
                replace(e, time=begins(e.time) if self._goes_on(e) else ends(e.time))
                for e in self.events
            ),
        )

    def _goes_on(self, event: Event) -> bool:
        """Return whether a dwell or retract follows an event; else its stop ends.

        A stop without duration, because the arm is already there, follows its wait, and so does its event.
        """
        segments = [p for p in self.segments if (p.task, p.action) == (event.task, event.action)]
        return not segments or any(
            part.kind in LINES and abs(part.start - event.time) <= SAME_TIME for part in segments
        )


def with_holds(trajectory: Trajectory, waits: Sequence[Wait]) -> Trajectory:
    """Insert holds into a trajectory at instants of rest."""
    parts, start = [], 0.0
    for wait in waits:
        if wait.at > start + SAME_TIME:
            parts.append(piece(trajectory, start, wait.at))
        position = trajectory.clamped(np.array([wait.at]))[0][0]
        parts.append(hold(trajectory.joints, position, wait.length))
        start = wait.at
    if trajectory.duration > start + SAME_TIME:
        parts.append(piece(trajectory, start, trajectory.duration))
    return concatenate(parts)


def piece(trajectory: Trajectory, start: float, end: float) -> Trajectory:
    """Cut a trajectory between two of its knots, starting at time 0."""
    time = trajectory.time
    # At the very ends all knots are kept: a jump of acceleration from and to rest is two of them.
    first = int(np.searchsorted(time, start + SAME_TIME, side="right")) - 1
    first = 0 if start <= SAME_TIME else first
    last = int(np.searchsorted(time, end - SAME_TIME, side="left"))
    last = len(time) - 1 if end >= time[-1] - SAME_TIME else last
    rows = slice(first, last + 1)
    return Trajectory(
        trajectory.joints,
        time[rows] - time[first],
        trajectory.position[rows],
        trajectory.velocity[rows],
        trajectory.acceleration[rows],
    )


@dataclass(frozen=True)
class Since:
    """Instant of an arm's own clock relative to its departure from a rest.

    It moves with the departure.
    """

    rest: int
    """Number of the rest; -1 for the start of the motion, which nothing moves."""
    after: float
    """Time since the departure [s]."""


@dataclass(frozen=True)
class ClockSteps:
    """A timeline of whole steps.

    Each place at which the arm may wait has a step of its own.
    """

    step: float
    """Length of a step [s]."""
    rests: tuple[float, ...]
    """Instants of the own clock at which the arm may wait [s], increasing."""
    places: tuple[int, ...]
    """The step of each rest, never before its instant, increasing."""
    count: int
    """Number of steps.

    The arm leaves its last rest even if its clock has no length.
    """
    duration: float
    """Length of the clock [s]."""

    @classmethod
    def of(cls, rests: Sequence[float], duration: float, step: float) -> ClockSteps:
        """Lays steps over a clock.

        Args:
            rests: when the arm may wait, by its own clock [s], increasing.
            duration: length of the clock [s].
            step: length of a step [s].
        """
        places: list[int] = []
        for time in rests:
            places.append(max(_up(time, step), places[-1] + 1 if places else 0))
        count = max(_up(duration, step), places[-1] + 1 if places else 0)
        return cls(step, tuple(rests), tuple(places), count, duration)

    def times(self) -> FloatArray:
        """Compute the instants of all steps by the own clock [s], shape (count + 1,).

        They are exact at rests.
        """
        times = np.minimum(self.step * np.arange(self.count + 1), self.duration)
        times[list(self.places)] = self.rests
        return times

    def rest_at(self, time: float) -> int | None:
        """Return the number of the rest at an instant, or None.

        Args:
            time: the instant of the own clock [s].
        """
        k = bisect_left(self.rests, time - SAME_TIME)
        return k if k < len(self.rests) and self.rests[k] <= time + SAME_TIME else None

    def place_after(self, time: float) -> int:
        """Return the first step not before an instant between two rests.

        Args:
            time: the instant of the own clock [s].
        """
        k = bisect_right(self.rests, time + SAME_TIME) - 1
        least = self.places[k] + 1 if k >= 0 else 0
        return min(max(_up(time, self.step), least), self.count)

    def arrived(self, time: float) -> Since:
        """Express an instant relative to the last rest that is strictly before it.

        The arm has yet to leave a rest that is just then.

        Args:
            time: of the own clock [s].
        """
        return self._since(bisect_left(self.rests, time - SAME_TIME) - 1, time)

    def left(self, time: float) -> Since:
        """Express an instant relative to the last rest up to it.

        The arm has left a rest that is just then.

        Args:
            time: of the own clock [s].
        """
        return self._since(bisect_right(self.rests, time + SAME_TIME) - 1, time)

    def reached(self, place: int) -> Since:
        """Return the arrival at a step, before any wait there."""
        k = bisect_left(self.places, place)
        time = min(self.step * place, self.duration)
        if k < len(self.places) and self.places[k] == place:
            time = self.rests[k]
        return self._since(k - 1, time)

    def _since(self, rest: int, time: float) -> Since:
        return Since(rest, time - (self.rests[rest] if rest >= 0 else 0.0))


def _up(time: float, step: float) -> int:
    return int(np.ceil(time / step - SAME_TIME))


@dataclass(frozen=True)
class NotBefore:
    """Earliest departure from a rest, at an instant or after the other arm's progress."""

    arm: int
    """Index of the arm."""
    rest: int
    """Number of the rest."""
    reason: WaitReason
    """Reason for waiting.

    It is empty for a rule that only states the other arm's progress meanwhile.
    """
    time: float
    """Instant [s]; with `reference`, time after that instant (negative: before) [s]."""
    reference: Since | None = None
    """Instant of the other arm's clock from which `time` counts."""


def leaving_times(
    clocks: Sequence[ClockSteps], rules: Sequence[NotBefore]
) -> tuple[tuple[float, ...], ...] | None:
    """Compute the earliest departures of all arms from their rests [s].

    Args:
        clocks: one or two arms' own clocks.
        rules: rules of departure, preferably in order of time.

    Returns:
        Departures by arm, or None if arms wait for each other forever.
    """
    departures = [list(clock.rests) for clock in clocks]
    for _ in range(sum(map(len, departures)) + 2):
        moved = False
        for rule in rules:
            at = due(rule, departures)
            times, rests = departures[rule.arm], clocks[rule.arm].rests
            if times[rule.rest] >= at - SAME_TIME:
                continue
            moved = True
            times[rule.rest] = at
            for k in range(rule.rest + 1, len(times)):
                times[k] = max(times[k], times[k - 1] + rests[k] - rests[k - 1])
        if not moved:
            return tuple(map(tuple, departures))
    return None


def due(rule: NotBefore, leaving: Sequence[Sequence[float]]) -> float:
    """Compute the earliest departure that a rule allows its arm [s].

    Args:
        rule: one rule.
        leaving: by arm, when it leaves its rests [s].
    """
    if rule.reference is None:
        return rule.time
    left = leaving[1 - rule.arm][rule.reference.rest] if rule.reference.rest >= 0 else 0.0
    return left + rule.reference.after + rule.time


def waits_at(clock: ClockSteps, leaving: Sequence[float]) -> list[float]:
    """Compute how long an arm waits at each rest [s].

    Args:
        clock: its own clock.
        leaving: when it leaves its rests [s].
    """
    waits, gone = [], 0.0
    for time, left in zip(clock.rests, leaving, strict=True):
        waits.append(left - time - gone)
        gone = left - time
    return waits
