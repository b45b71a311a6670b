"""Assembly of motions: pieces in sequence, with their stages, segments and events."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Collection, Mapping
from dataclasses import field, replace
from functools import cached_property

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.motion.joint_motion import merge
from dualarm_cli.model.motion.trajectory import SAME_TIME, Trajectory
from dualarm_cli.model.robot import Robot
from dualarm_cli.model.schedule import Event, Segment, SegmentKind, Stage, WaitReason
from dualarm_cli.motion.waiting import with_ends
from dualarm_cli.postures.stage_plan import ArmStop
from dualarm_cli.records import dataclass
from dualarm_cli.timing.composition import concatenate

LINES = ("approach", "dwell", "retract")
"""Segments during which a part may touch bodies that stand still."""
ROBOT = "robot"
"""Name of the joint group of all joints."""


@dataclass(frozen=True)
class Motion:
    """Motion of a job with its stages, segments and events."""

    trajectory: Trajectory
    """Motion of all joints."""
    stages: tuple[Stage, ...]
    """Stages in time order."""
    segments: tuple[Segment, ...]
    """Segments by arm, in time order."""
    events: tuple[Event, ...]
    """Events in time order."""
    gain: float | None = None
    """Time gained by blending [s]; None if tools stop at the outer ends of lines."""

    @cached_property
    def event_of(self) -> Mapping[tuple[int, str], Event]:
        """Event of an arm in a stage, by the stage's index and the arm.

        It may be at the border of two stages.
        """
        remaining: dict[str, list[Event]] = {}
        for event in reversed(self.events):
            remaining.setdefault(event.arm, []).append(event)
        events_by_stage = {}
        for k, stage in enumerate(self.stages):
            for arm, events in remaining.items():
                # Both arms may share a task, each in its own stages.
                works = bool(events) and events[-1].task in stage.tasks
                if works and events[-1].time + events[-1].dwell <= stage.end + SAME_TIME:
                    events_by_stage[k, arm] = events.pop()
        return events_by_stage

    @cached_property
    def lines(self) -> tuple[Segment, ...]:
        """Segments on lines, by start time."""
        return tuple(sorted((s for s in self.segments if s.kind in LINES), key=lambda s: s.start))

    def lines_within(self, arms: Collection[str], start: float, end: float) -> list[Segment]:
        """Select the arms' segments on lines between two times [s], by start time."""
        first = bisect_left(self.lines, start - SAME_TIME, key=lambda s: s.start)
        last = bisect_right(self.lines, end + SAME_TIME, key=lambda s: s.start)
        return [s for s in self.lines[first:last] if s.arm in arms and s.end <= end + SAME_TIME]


@dataclass
class MotionBuilder:
    """Plan under construction, by joint group or for all joints together."""

    pieces: dict[str, list[Trajectory]] = field(default_factory=dict)
    """Motions of each joint group, or of ROBOT alone, in order."""
    stages: list[Stage] = field(default_factory=list)
    """Stages in time order."""
    segments: list[Segment] = field(default_factory=list)
    """Segments in time order for each arm."""
    events: list[Event] = field(default_factory=list)
    """Events, in any order."""
    clock: float = 0.0
    """Start time of the next addition [s]."""
    begins: dict[str, dict[int, float]] = field(default_factory=dict)
    """Start of each group's first piece after the clock was set [s], by its index."""
    gain: float | None = None
    """Time gained by blending in the added motions [s]."""

    def add(self, group: str, piece: Trajectory) -> None:
        """Append a motion of a joint group, without advancing the clock."""
        pieces, begins = self.pieces.setdefault(group, []), self.begins.setdefault(group, {})
        if self.clock != next(reversed(begins.values()), None):
            begins[len(pieces)] = self.clock
        pieces.append(piece)

    def add_segment(
        self,
        name: str,
        kind: SegmentKind,
        arm_stop: ArmStop | None,
        start: float,
        end: float,
        reason: WaitReason = "",
    ) -> None:
        """Record an activity of an arm.

        Args:
            name: the arm.
            kind: kind of activity.
            arm_stop: its stop, or None.
            start: start time [s].
            end: end time [s].
            reason: reason of a wait.
        """
        task = arm_stop.task.id if arm_stop else ""
        action = arm_stop.stop.action if arm_stop else ""
        dwell = arm_stop.stop.dwell if arm_stop and kind == "dwell" else None
        self.segments.append(Segment(name, kind, task, action, start, end, dwell, reason))

    def add_whole(self, piece: Trajectory) -> None:
        """Append a motion of all joints and advance the clock."""
        self.add(ROBOT, piece)
        self.clock += piece.duration

    def append(self, motion: Motion) -> None:
        """Append a motion of all joints with its stages, segments and events."""
        t = self.clock
        if motion.gain is not None:
            self.gain = (self.gain or 0.0) + motion.gain
        self.stages += [replace(s, start=s.start + t, end=s.end + t) for s in motion.stages]
        self.segments += [replace(s, start=s.start + t, end=s.end + t) for s in motion.segments]
        self.events += [replace(e, time=e.time + t) for e in motion.events]
        self.add_whole(motion.trajectory)

    def take_transfer(self, begin: float) -> Stage | None:
        """Remove and return the transfer's stage since a time [s]; None without motion."""
        return self.stages.pop() if self.clock > begin else None

    def add_work(
        self, task: str, solver: str, begin: float, angle: float | None, transfer: Stage | None
    ) -> None:
        """Add the stage of a task that is planned by itself.

        Args:
            task: id of the task.
            solver: name of the method that planned it.
            begin: start time, transfer included [s].
            angle: platform angle at its end [rad]; None without a one-joint platform.
            transfer: stage of its transfer, from `take_transfer`.
        """
        self.stages.append(
            Stage(
                start=begin,
                end=self.clock,
                tasks=(task,),
                platform_solver=solver,
                platform_angle=angle,
                platform_time=transfer.platform_time if transfer else 0.0,
                arm_times=transfer.arm_times if transfer else {},
                joint_times=transfer.joint_times if transfer else {},
                bottleneck=transfer.bottleneck if transfer else "",
            )
        )

    @property
    def begin(self) -> FloatArray:
        """Joint values before the first motion of all joints [rad], shape (n,)."""
        return self.pieces[ROBOT][0].position[0]

    @property
    def end(self) -> FloatArray:
        """Joint values after the last motion of all joints [rad], shape (n,)."""
        return self.pieces[ROBOT][-1].position[-1]

    def joined(self, group: str) -> Trajectory:
        """Join the pieces of a joint group at their recorded start times."""
        return concatenate(self.pieces[group], self.begins.get(group))

    def build(self, robot: Robot) -> Motion:
        """Build the motion of all joints.

        Raises:
            ValueError: a piece does not begin at the end of the one before it.
        """
        groups = {name: self.joined(name) for name in self.pieces}
        events = self.events
        if ROBOT in groups:
            trajectory = groups[ROBOT]
        else:
            trajectory = merge(list(groups.values()), joints=robot.joints)
            events = [_at_knot(event, trajectory.time) for event in events]
        number = {arm.name: k for k, arm in enumerate(robot.arms)}
        segments = sorted(self.segments, key=lambda part: (number[part.arm], part.start))
        return Motion(
            trajectory,
            tuple(self.stages),
            with_ends(segments, events),
            tuple(sorted(events, key=lambda event: (event.time, event.arm))),
            self.gain,
        )


def _at_knot(event: Event, time: FloatArray) -> Event:
    """Move an event to the nearest knot, because knots within a nanosecond are merged."""
    after = int(np.clip(np.searchsorted(time, event.time), 1, len(time) - 1))
    nearest = min(time[after - 1], time[after], key=lambda knot: abs(knot - event.time))
    return replace(event, time=float(nearest))
