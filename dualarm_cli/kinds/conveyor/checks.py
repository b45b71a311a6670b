"""Checks of tools at targets on conveyors.

A tool is with the part, in its window, and straight in the belt's frame.
"""

from __future__ import annotations

from dataclasses import field

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.model.job import Job, PoseTarget, Stop, StopKey
from dualarm_cli.model.schedule import Event, Schedule
from dualarm_cli.model.verification import Check
from dualarm_cli.records import dataclass
from dualarm_cli.verification.kind_checks import KindChecks
from dualarm_cli.verification.measuring.criteria import Criterion
from dualarm_cli.verification.measuring.dense_times import dense_times
from dualarm_cli.verification.measuring.tolerances import TOL
from dualarm_cli.verification.measuring.tool_model import ToolModel, rotation_angle
from dualarm_cli.verification.tool_checks import Worst, pose_error

HALF_STEP = 1e-5
"""Half of the time over which a tool's velocity is measured [s]."""
NO_JOB = "the task file has the parts' times and the lines' lengths, and none was given (--tasks)"
NO_DWELLS = "no event on a conveyor has a dwell"
CRITERIA = {
    "conveyor_part": Criterion(
        "m, rad", "Distance or angle of the tool from the part at its event.", NO_JOB
    ),
    "conveyor_windows": Criterion("s", "Time of an event outside the window of its part.", NO_JOB),
    "conveyor_velocity": Criterion(
        "m/s", "Difference of the tool's velocity from the belt's at its event.", "nothing is done"
    ),
    "conveyor_dwells": Criterion(
        "m", "Largest distance of the tool from the part during the dwell.", NO_DWELLS
    ),
    "conveyor_dwells_steady": Criterion(
        "rad", "Largest turn of the tool against the part during the dwell.", NO_DWELLS
    ),
    "conveyor_lines_straight": Criterion(
        "m", "Distance of the tool from a straight line in the belt's frame.", NO_JOB
    ),
    "conveyor_lines_steady": Criterion(
        "rad", "Turn of the tool on a line in the belt's frame.", NO_JOB
    ),
    "conveyor_line_lengths": Criterion(
        "m", "Length that an approach or retract lacks, in the belt's frame.", NO_JOB
    ),
}
"""Criteria, listed where targets move."""


@dataclass
class _Violations:
    """Largest violation of each criterion."""

    part: Worst = field(default_factory=Worst)
    window: Worst = field(default_factory=Worst)
    velocity: Worst = field(default_factory=Worst)
    stays: Worst = field(default_factory=Worst)
    steady: Worst = field(default_factory=Worst)
    straight: Worst = field(default_factory=Worst)
    turned: Worst = field(default_factory=Worst)
    length: Worst = field(default_factory=Worst)

    def checks(self) -> list[Check]:
        """Judge every criterion."""
        return [
            self.part.judge("conveyor_part", TOL.pose_distance),
            self.window.judge("conveyor_windows", TOL.same_time),
            self.velocity.judge("conveyor_velocity", TOL.belt_speed),
            self.stays.judge("conveyor_dwells", TOL.pose_distance),
            self.steady.judge("conveyor_dwells_steady", TOL.pose_angle),
            self.straight.judge("conveyor_lines_straight", TOL.line_distance),
            self.turned.judge("conveyor_lines_steady", TOL.line_angle),
            self.length.judge("conveyor_line_lengths", TOL.line_distance),
        ]


def check_conveyors(
    schedule: Schedule, stated: tuple[Event, ...], job: Job | None, model: ToolModel
) -> list[Check]:
    """Check tools at targets on conveyors; an empty list without such targets.

    At its event a tool is at the part, within the stretch that the file allows, and at the belt's velocity; during the
    dwell it stays with the part. On the lines it moves straight in the belt's frame, over the lengths of the
    file; beyond them its path is free.

    Args:
        schedule: with events that move as the job's targets do.
        stated: events as written in the file.
        job: each task with the arm that did it; None without a task file.
        model: kinematics of the tools.
    """
    stops = job.stops_by_key() if job else {}
    has_belts = any(stop.belt is not None for stop in stops.values())
    if not has_belts and not any(event.moves for event in (*schedule.events, *stated)):
        return []
    violations = _Violations()
    for event, written in zip(schedule.events, stated, strict=True):
        if not (event.moves or written.moves):
            continue
        place = f"{event.task} ({event.action}) at {event.time:.6f} s"
        off = np.subtract(written.velocity, event.velocity)
        violations.velocity.add(float(norm(off)), f"{place}: the event states another one")
        if event.moves:
            stop = stops.get(_key(event))
            _measure_event(schedule, model, event, stop, violations, place)
            if stop is not None:
                _measure_lines(schedule, model, event, stop, violations)
    return violations.checks()


def _key(event: Event) -> StopKey:
    return event.arm, event.task, event.action


def _measure_event(
    schedule: Schedule,
    model: ToolModel,
    event: Event,
    stop: Stop | None,
    violations: _Violations,
    place: str,
) -> None:
    """Add the errors at an event and over its dwell: pose, window, velocity, stay."""
    trajectory, end = schedule.trajectory, event.time + event.dwell
    if stop is not None and stop.belt is not None:
        assert isinstance(stop.target, PoseTarget)  # the reader refuses others on conveyors
        belt, target = stop.belt, stop.target
        nominal = target.pose.copy()
        velocity = belt.conveyor.velocity
        nominal.translation = nominal.translation + velocity * (event.time - belt.at)
        pose = model.pose(event.arm, trajectory.clamped(np.array([event.time]))[0][0])
        violations.part.add(pose_error(nominal, target, pose), place)
        last = belt.passes + belt.within / float(norm(velocity))
        violations.window.add(
            max(belt.passes - event.time, event.time - last),
            f"{place}, allowed from {belt.passes:.6f} to {last:.6f} s",
        )
    for time in (event.time, end):
        ends = np.clip([time - HALF_STEP, time + HALF_STEP], 0.0, trajectory.duration)
        _, p = model.poses(event.arm, trajectory.clamped(ends)[0])
        speed = (p[1] - p[0]) / np.diff(ends)
        violations.velocity.add(float(norm(speed - np.array(event.velocity))), place)
    if event.dwell > 0:
        times = dense_times(trajectory.time, event.time, end)
        local, angle = _in_belt(schedule, model, event, times)
        violations.stays.add(float(norm(local, axis=1).max()), place)
        violations.steady.add(float(angle.max()), place)


def _in_belt(
    schedule: Schedule, model: ToolModel, event: Event, times: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Compute tool positions (m, 3) [m] and turns in the event's moving pose."""
    R, p = model.poses(event.arm, schedule.trajectory.clamped(times)[0])
    part = event.pose.translation + (times - event.time)[:, None] * np.array(event.velocity)
    return product(p - part, event.pose.rotation), rotation_angle(product(event.pose.rotation.T, R))


def _measure_lines(
    schedule: Schedule, model: ToolModel, event: Event, stop: Stop, violations: _Violations
) -> None:
    """Add errors in straightness and length of an event's lines in the belt's frame."""
    end = event.time + event.dwell
    for kind, (length, line) in zip(("approach", "retract"), stop.lines, strict=True):
        place = f"{kind} of {event.task} ({event.action})"
        segments = [
            s
            for s in schedule.segments
            if s.kind == kind and (s.arm, s.task, s.action) == _key(event)
        ]
        if len(segments) != 1:
            if segments or length > 0.0:
                listed = f"listed {len(segments)} times" if segments else "missing"
                violations.length.add(np.inf, f"{place} is {listed}")
            continue
        [segment] = segments
        place += f" at {segment.start:.3f} s"
        gap = segment.end - event.time if kind == "approach" else segment.start - end
        if not abs(gap) <= TOL.same_time:
            violations.length.add(np.inf, f"{place} does not lead to or from its event")
        times = dense_times(schedule.trajectory.time, segment.start, segment.end)
        # From the part outward.
        times = times[::-1] if kind == "approach" else times
        local, angle = _in_belt(schedule, model, event, times)
        local = product(local, line.axes(event.pose.rotation))
        depth = -local[:, 2]
        reached = np.flatnonzero(depth >= length - TOL.line_distance)
        if not len(reached):
            violations.length.add(length - float(depth.max()), place)
        on_line = slice(0, int(reached[0]) + 1 if len(reached) else len(depth))
        violations.straight.add(float(np.hypot(*local[on_line, :2].T).max()), place)
        violations.turned.add(float(angle[on_line].max()), place)
        backward = float((np.maximum.accumulate(depth[on_line]) - depth[on_line]).max())
        off = max(backward, -float(depth[on_line].min()), abs(float(depth[0])))
        violations.length.add(off, place)


CHECKS = KindChecks(
    {
        "lines": lambda case: check_conveyors(
            case.known_arms_only, case.stated, case.done, case.model
        )
    },
    CRITERIA,
)
