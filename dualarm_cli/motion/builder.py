"""Motion as it is put together: pieces one after the other, with the stages, segments and events that name them."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Collection, Mapping
from dataclasses import field, replace
from functools import cached_property

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.joint_motion import SAME_TIME, merge
from dualarm_cli.model.robot import Robot
from dualarm_cli.model.schedule import Event, Segment, SegmentKind, Stage, WaitReason
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.motion.waiting import with_ends
from dualarm_cli.postures.stage_plan import ArmStop
from dualarm_cli.records import dataclass
from dualarm_cli.timing.composition import concatenate

LINES = ("approach", "dwell", "retract")
"""Segments on which a part may touch what stands still."""
ROBOT = "robot"
"""Name of the joint group of all joints together."""


@dataclass(frozen=True)
class Motion:
    """A job's whole motion and what happens in it."""

    trajectory: Trajectory
    """All joints of the robot."""
    stages: tuple[Stage, ...]
    """In time order."""
    segments: tuple[Segment, ...]
    """Arm by arm, in time order."""
    events: tuple[Event, ...]
    """In time order."""
    gain: float | None = None
    """How much shorter it is than with stops at the outer ends of lines [s]; None where tools stop there."""

    @cached_property
    def event_of(self) -> Mapping[tuple[int, str], Event]:
        """The event of an arm in a stage, by the stage's place and the arm; it may lie on the border of two stages."""
        left: dict[str, list[Event]] = {}
        for event in reversed(self.events):
            left.setdefault(event.arm, []).append(event)
        found = {}
        for k, stage in enumerate(self.stages):
            for arm, events in left.items():
                # A task may be both arms', each with stages of its own.
                works = bool(events) and events[-1].task in stage.tasks
                if works and events[-1].time + events[-1].dwell <= stage.end + SAME_TIME:
                    found[k, arm] = events.pop()
        return found

    @cached_property
    def lines(self) -> tuple[Segment, ...]:
        """Segments on lines, in order of their starts."""
        return tuple(sorted((s for s in self.segments if s.kind in LINES), key=lambda s: s.start))

    def lines_within(self, arms: Collection[str], start: float, end: float) -> list[Segment]:
        """Returns the segments of arms on lines between two instants [s], in order of their starts."""
        first = bisect_left(self.lines, start - SAME_TIME, key=lambda s: s.start)
        last = bisect_right(self.lines, end + SAME_TIME, key=lambda s: s.start)
        return [s for s in self.lines[first:last] if s.arm in arms and s.end <= end + SAME_TIME]


@dataclass
class MotionBuilder:
    """What is planned so far, either by joint group or all joints together."""

    pieces: dict[str, list[Trajectory]] = field(default_factory=dict)
    """Motions of each joint group, or of ROBOT alone, one after the other."""
    stages: list[Stage] = field(default_factory=list)
    """In time order."""
    segments: list[Segment] = field(default_factory=list)
    """In time order for each arm."""
    events: list[Event] = field(default_factory=list)
    """What tools come to."""
    clock: float = 0.0
    """When what is added next begins [s]."""
    begins: dict[str, dict[int, float]] = field(default_factory=dict)
    """When each group's first piece since the clock was set begins [s], by its place among the group's pieces."""
    gain: float | None = None
    """How much shorter the motions that were added are than with stops at the outer ends of lines [s]."""

    def add(self, group: str, piece: Trajectory) -> None:
        """Appends a motion of a joint group; the clock stays, as other groups move meanwhile."""
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
        """Note what an arm does between two instants.

        Args:
            name: the arm.
            kind: what it does.
            arm_stop: the stop that it belongs to; None for none.
            start: when it begins [s].
            end: when it ends [s].
            reason: why it waits, if it does.
        """
        task = arm_stop.task.id if arm_stop else ""
        action = arm_stop.stop.action if arm_stop else ""
        dwell = arm_stop.stop.dwell if arm_stop and kind == "dwell" else None
        self.segments.append(Segment(name, kind, task, action, start, end, dwell, reason))

    def add_whole(self, piece: Trajectory) -> None:
        """Appends a motion of all joints."""
        self.add(ROBOT, piece)
        self.clock += piece.duration

    def append(self, motion: Motion) -> None:
        """Appends a motion of all joints with what happens in it."""
        t = self.clock
        if motion.gain is not None:
            self.gain = (self.gain or 0.0) + motion.gain
        self.stages += [replace(s, start=s.start + t, end=s.end + t) for s in motion.stages]
        self.segments += [replace(s, start=s.start + t, end=s.end + t) for s in motion.segments]
        self.events += [replace(e, time=e.time + t) for e in motion.events]
        self.add_whole(motion.trajectory)

    def take_transfer(self, begin: float) -> Stage | None:
        """Takes the stage of a transfer since an instant [s] off the stages, None where nothing moved since."""
        return self.stages.pop() if self.clock > begin else None

    def add_work(
        self, task: str, solver: str, begin: float, angle: float | None, transfer: Stage | None
    ) -> None:
        """Closes the stage of one task that is planned by itself.

        Args:
            task: the task's id.
            solver: name of the method that planned it.
            begin: when it began, with the transfer where there is one [s].
            angle: of the platform at its end [rad]; None without a one-joint platform.
            transfer: what becomes part of it, from `take_transfer`.
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
        """All joints before the first motion of all of them [rad], shape (n,)."""
        return self.pieces[ROBOT][0].position[0]

    @property
    def end(self) -> FloatArray:
        """All joints after the last motion of all of them [rad], shape (n,)."""
        return self.pieces[ROBOT][-1].position[-1]

    def joined(self, group: str) -> Trajectory:
        """Returns the motion of a joint group, whose pieces begin when the clock says so."""
        return concatenate(self.pieces[group], self.begins.get(group))

    def build(self, robot: Robot) -> Motion:
        """Returns the motion of all joints, arm by arm and in time order.

        Raises:
            ValueError: a piece does not begin where or when the one before it ends.
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
    """Returns the event at the nearest knot: knots nearer than a nanosecond have become one."""
    after = int(np.clip(np.searchsorted(time, event.time), 1, len(time) - 1))
    nearest = min(time[after - 1], time[after], key=lambda knot: abs(knot - event.time))
    return replace(event, time=float(nearest))
