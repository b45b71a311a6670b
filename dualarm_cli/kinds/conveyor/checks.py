"""Checks of tools at targets that conveyors carry: with the part, in its window, straight in the belt's frame."""

from __future__ import annotations

from dataclasses import field

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.model.job import Job, PoseTarget, Stop, StopKey
from dualarm_cli.model.schedule import Event, Schedule
from dualarm_cli.model.verification import Check
from dualarm_cli.records import dataclass
from dualarm_cli.verification.criteria import Criterion
from dualarm_cli.verification.dense_times import dense_times
from dualarm_cli.verification.kind_checks import KindChecks
from dualarm_cli.verification.tolerances import TOL
from dualarm_cli.verification.tool_checks import Worst, pose_error
from dualarm_cli.verification.tool_model import ToolModel, rotation_angle

STEP = 1e-5
"""Half of the time over which a tool's velocity is measured [s]."""
NO_JOB = (
    "which parts come when and how long lines are is in the task file: none was given (--tasks)"
)
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
"""Listed where targets move."""


@dataclass
class _Found:
    """The worst of every kind."""

    part: Worst = field(default_factory=Worst)
    window: Worst = field(default_factory=Worst)
    velocity: Worst = field(default_factory=Worst)
    stays: Worst = field(default_factory=Worst)
    steady: Worst = field(default_factory=Worst)
    beside: Worst = field(default_factory=Worst)
    turned: Worst = field(default_factory=Worst)
    length: Worst = field(default_factory=Worst)

    def checks(self) -> list[Check]:
        """Returns the checks."""
        return [
            self.part.judge("conveyor_part", TOL.pose_distance),
            self.window.judge("conveyor_windows", TOL.same_time),
            self.velocity.judge("conveyor_velocity", TOL.belt_speed),
            self.stays.judge("conveyor_dwells", TOL.pose_distance),
            self.steady.judge("conveyor_dwells_steady", TOL.pose_angle),
            self.beside.judge("conveyor_lines_straight", TOL.line_distance),
            self.turned.judge("conveyor_lines_steady", TOL.line_angle),
            self.length.judge("conveyor_line_lengths", TOL.line_distance),
        ]


def check_conveyors(
    schedule: Schedule, stated: tuple[Event, ...], job: Job | None, model: ToolModel
) -> list[Check]:
    """Checks tools at targets on conveyors; returns nothing where there are none.

    At its event a tool is where the part is then, within the stretch that the file allows, and as fast as it; during
    the dwell it stays with it. Before and after that it moves straight along its z axis in the belt's frame, as far as
    the file asks; where it gets up to the belt's speed beyond that is its own matter.

    Args:
        schedule: with events that move as the job's targets do.
        stated: the events as they were written.
        job: each task with the arm that did it; None where there is no task file.
        model: where the tools are.
    """
    stops = job.stops_by_key() if job else {}
    asked = any(stop.belt is not None for stop in stops.values())
    if not asked and not any(event.moves for event in (*schedule.events, *stated)):
        return []
    found = _Found()
    for event, written in zip(schedule.events, stated, strict=True):
        if not (event.moves or written.moves):
            continue
        where = f"{event.task} ({event.action}) at {event.time:.6f} s"
        off = np.subtract(written.velocity, event.velocity)
        found.velocity.add(float(norm(off)), f"{where}: the event states another one")
        if event.moves:
            stop = stops.get(_key(event))
            _measure_event(schedule, model, event, stop, found, where)
            if stop is not None:
                _measure_lines(schedule, model, event, stop, found)
    return found.checks()


def _key(event: Event) -> StopKey:
    return event.arm, event.task, event.action


def _measure_event(
    schedule: Schedule,
    model: ToolModel,
    event: Event,
    stop: Stop | None,
    found: _Found,
    where: str,
) -> None:
    """Adds the tool's place at an event, its velocity at both ends of the dwell, and how it stays with the part."""
    trajectory, over = schedule.trajectory, event.time + event.dwell
    if stop is not None and stop.belt is not None:
        assert isinstance(stop.target, PoseTarget)  # the reader refuses others on conveyors
        belt, target = stop.belt, stop.target
        nominal = target.pose.copy()
        velocity = belt.conveyor.velocity
        nominal.translation = nominal.translation + velocity * (event.time - belt.at)
        pose = model.pose(event.arm, trajectory.at(np.array([event.time]))[0][0])
        found.part.add(pose_error(nominal, target, pose), where)
        last = belt.passes + belt.within / float(norm(velocity))
        found.window.add(
            max(belt.passes - event.time, event.time - last),
            f"{where}, allowed from {belt.passes:.6f} to {last:.6f} s",
        )
    for time in (event.time, over):
        ends = np.clip([time - STEP, time + STEP], 0.0, trajectory.duration)
        _, p = model.poses(event.arm, trajectory.at(ends)[0])
        speed = (p[1] - p[0]) / np.diff(ends)
        found.velocity.add(float(norm(speed - np.array(event.velocity))), where)
    if event.dwell > 0:
        times = dense_times(trajectory.time, event.time, over)
        local, angle = _in_belt(schedule, model, event, times)
        found.stays.add(float(norm(local, axis=1).max()), where)
        found.steady.add(float(angle.max()), where)


def _in_belt(
    schedule: Schedule, model: ToolModel, event: Event, times: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Returns the tool's positions (m, 3) in the frame of the event's pose moving with the belt [m], and its turns."""
    R, p = model.poses(event.arm, schedule.trajectory.at(times)[0])
    part = event.pose.translation + (times - event.time)[:, None] * np.array(event.velocity)
    return product(p - part, event.pose.rotation), rotation_angle(product(event.pose.rotation.T, R))


def _measure_lines(
    schedule: Schedule, model: ToolModel, event: Event, stop: Stop, found: _Found
) -> None:
    """Adds how straight and how long the ways to the part and from it are in the belt's frame."""
    over = event.time + event.dwell
    for kind, asked in (("approach", stop.approach), ("retract", stop.retract)):
        where = f"{kind} of {event.task} ({event.action})"
        own = [
            s
            for s in schedule.segments
            if s.kind == kind and (s.arm, s.task, s.action) == _key(event)
        ]
        if len(own) != 1:
            if own or asked > 0.0:
                listed = f"listed {len(own)} times" if own else "missing"
                found.length.add(np.inf, f"{where} is {listed}")
            continue
        [segment] = own
        where += f" at {segment.start:.3f} s"
        apart = segment.end - event.time if kind == "approach" else segment.start - over
        if not abs(apart) <= TOL.same_time:
            found.length.add(np.inf, f"{where} does not lead to or from its event")
        times = dense_times(schedule.trajectory.time, segment.start, segment.end)
        # From the part outward.
        times = times[::-1] if kind == "approach" else times
        local, angle = _in_belt(schedule, model, event, times)
        depth = -local[:, 2]
        there = np.flatnonzero(depth >= asked - TOL.line_distance)
        if not len(there):
            found.length.add(asked - float(depth.max()), where)
        line = slice(0, int(there[0]) + 1 if len(there) else len(depth))
        found.beside.add(float(np.hypot(local[line, 0], local[line, 1]).max()), where)
        found.turned.add(float(angle[line].max()), where)
        back = float((np.maximum.accumulate(depth[line]) - depth[line]).max())
        found.length.add(max(back, -float(depth[line].min()), abs(float(depth[0]))), where)


CHECKS = KindChecks(
    {
        "lines": lambda case: check_conveyors(
            case.known_arms_only, case.stated, case.done, case.model
        )
    },
    CRITERIA,
)
