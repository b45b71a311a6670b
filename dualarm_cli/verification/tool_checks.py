"""Checks of the tools in the world: poses, dwells, lines."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise

import numpy as np
import pinocchio as pin

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import TURN, arctan2
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.model.job import Job, JointTarget, PoseTarget, Stop
from dualarm_cli.model.lines import LineDirection
from dualarm_cli.model.schedule import WORK_ENDS, Event, Schedule, Segment
from dualarm_cli.model.verification import Check
from dualarm_cli.records import dataclass
from dualarm_cli.verification.measuring.criteria import judge, not_checked
from dualarm_cli.verification.measuring.dense_times import AT_ONCE, dense_spans, tool_spans
from dualarm_cli.verification.measuring.line_spans import LineSpan
from dualarm_cli.verification.measuring.tolerances import TOL
from dualarm_cli.verification.measuring.tool_model import ToolModel, rotation_angle


@dataclass(frozen=True)
class SpeedSampling:
    """Instants at which tool speeds are measured."""

    step: float = 1e-3
    """Spacing of the instants [s]."""
    half: float = 1e-5
    """Half-width of the central difference [s]."""
    block: int = 10_000
    """Maximum number of instants measured at once, to limit memory."""
    longest: float = 7_200.0
    """Longest motion that is checked [s]."""


SPEED = SpeedSampling()


def check_tool_speed(schedule: Schedule, cap: float | None, model: ToolModel) -> Check:
    """Check the speed cap of the tool centre points, at 1 kHz and all knots.

    Args:
        schedule: the schedule to check.
        cap: largest speed in the world [m/s], or None.
        model: forward kinematics of the schedule's robot.
    """
    if cap is None:
        return not_checked("tool_speed")
    allowed = cap * (1.0 + TOL.tool_speed_slack)
    if where := too_long(schedule):
        return judge("tool_speed", np.inf, allowed, where)
    worst, time = Worst(), schedule.trajectory.time
    for block in instants(schedule, float(time[0]), float(time[-1])):
        for arm, speed in tool_speeds(schedule, model, block, schedule.robot.arms).items():
            k = int(np.argmax(speed))
            worst.add(float(speed[k]), f"{arm} tool at {block[k]:.3f} s")
    return worst.judge("tool_speed", allowed)


def too_long(schedule: Schedule) -> str:
    """Describe a motion too long to measure at 1 kHz, or return an empty text."""
    duration = schedule.trajectory.duration
    if duration <= SPEED.longest:
        return ""
    return (
        f"a motion of {duration:g} s is too long to check, at most {SPEED.longest:g} s are checked"
    )


def instants(schedule: Schedule, start: float, end: float) -> Iterator[FloatArray]:
    """List the knots and instants at 1 kHz of a span, in blocks [s].

    Where acceleration jumps, the fastest instant is a knot.
    """
    knots = schedule.trajectory.time
    inside = knots[(knots > start) & (knots < end)]
    times = np.union1d(np.append(np.arange(start, end, SPEED.step), end), inside)
    yield from np.array_split(times, len(times) // SPEED.block + 1)


def tool_speeds(
    schedule: Schedule, model: ToolModel, times: FloatArray, arms: Iterable[str]
) -> dict[str, FloatArray]:
    """Measure the speed of the arms' tools at instants [m/s], by central differences."""
    trajectory = schedule.trajectory
    # At the ends of the motion the window is cut short.
    before, after = (
        np.clip(times + shift, trajectory.time[0], trajectory.time[-1])
        for shift in (-SPEED.half, SPEED.half)
    )
    width = after - before
    earlier, later = trajectory.clamped(before)[0], trajectory.clamped(after)[0]
    speeds = {}
    for arm in arms:
        distance = norm(model.poses(arm, later)[1] - model.poses(arm, earlier)[1], axis=1)
        speeds[arm] = np.divide(distance, width, out=np.zeros_like(width), where=width > 0)
    return speeds


@dataclass
class Worst:
    """Worst of many measurements, with its place."""

    value: float = 0.0
    where: str = "everywhere"
    count: int = 0

    def add(self, value: float, where: str) -> None:
        """Add a measurement and its place."""
        self.count += 1
        # A NaN is worse than any number, and stays.
        if not value <= self.value and not np.isnan(self.value):
            self.value, self.where = value, where

    def judge(self, name: str, allowed: float, nothing: str = "", *, slides: bool = False) -> Check:
        """Judge the worst value.

        Without measurements the check is not made, for the given reason or the usual one.
        """
        if self.count == 0:
            return not_checked(name, nothing)
        return judge(name, self.value, allowed, self.where, slides=slides)


def check_events(schedule: Schedule, model: ToolModel) -> list[Check]:
    """Check that tools are at their events' poses, and stay there during dwells.

    Args:
        schedule: the schedule to check.
        model: forward kinematics of the tools.
    """
    distance, angle, knot = Worst(), Worst(), Worst()
    still_distance, still_angle = Worst(), Worst()
    # Moving targets have checks of their own.
    dwelling = [event for event in schedule.events if event.dwell > 0 and not event.moves]
    dwells = tool_spans(
        schedule.trajectory, model, [(e.arm, e.time, e.time + e.dwell) for e in dwelling]
    )
    knots = schedule.trajectory.time
    for event in schedule.events:
        where = f"{event.task} ({event.action}) at {event.time:.6f} s"
        after = int(np.searchsorted(knots, event.time))
        knot.add(float(np.abs(knots[max(0, after - 1) : after + 1] - event.time).min()), where)
        # The instant by pinocchio, the dwell by arrays: two methods that must agree.
        pose = model.pose(event.arm, schedule.trajectory.clamped(np.array([event.time]))[0][0])
        distance.add(float(norm(pose.translation - event.pose.translation)), where)
        angle.add(float(rotation_angle(product(event.pose.rotation.T, pose.rotation))), where)
        if event.dwell > 0 and not event.moves:
            R, p = next(dwells)
            still_distance.add(float(norm(p - event.pose.translation, axis=1).max()), where)
            still_angle.add(float(rotation_angle(product(event.pose.rotation.T, R)).max()), where)
    return [
        knot.judge("events_at_knots", TOL.same_time),
        distance.judge("tool_position_at_events", TOL.pose_distance),
        angle.judge("tool_angle_at_events", TOL.pose_angle),
        still_distance.judge("tool_still_in_dwells", TOL.pose_distance),
        still_angle.judge("tool_steady_in_dwells", TOL.pose_angle),
    ]


def check_targets(schedule: Schedule, job: Job) -> Check:
    """Check that every event's pose is allowed by the job's target.

    A target that is passed in motion allows the distance of its blend.
    """
    worst = Worst()
    stops = job.stops_by_key()
    for event in schedule.events:
        stop = stops.get((event.arm, event.task, event.action))
        if stop is None or stop.moves or not isinstance(stop.target, PoseTarget | JointTarget):
            continue  # check_order names it; other and moving targets have checks of their own
        where = f"{event.task} ({event.action})"
        within = stop.blend if schedule.blending.passes(stop) else 0.0
        worst.add(_target_error(schedule, job, event, stop.target, within), where)
    return worst.judge("events_at_targets", TOL.pose_distance)


def check_stands(schedule: Schedule, job: Job) -> Check:
    """Check that arm and platform stand at targets that may not be passed in motion."""
    worst, stops, trajectory = Worst(), job.stops_by_key(), schedule.trajectory
    for event in schedule.events:
        stop = stops.get((event.arm, event.task, event.action))
        free = stop is None or stop.moves or event.action in WORK_ENDS.values()
        if free or (stop is not None and stop.blend > 0.0 and schedule.blending.passes(stop)):
            continue
        names = (*schedule.robot.arms[event.arm].joints, *schedule.robot.platform)
        columns = [trajectory.joints.index(name) for name in names]
        speed = np.abs(trajectory.clamped(np.array([event.time]))[1][0, columns])
        worst.add(
            float(speed.max(initial=0.0)), f"{event.task} ({event.action}) at {event.time:.6f} s"
        )
    return worst.judge("stands_at_events", TOL.event_speed)


def _target_error(
    schedule: Schedule, job: Job, event: Event, target: PoseTarget | JointTarget, within: float
) -> float:
    """Measure an event's error, beyond its target's freedoms and `within` [m, rad]."""
    if isinstance(target, JointTarget):
        names = job.cell.robot.arm(event.arm).joints
        columns = [schedule.trajectory.joints.index(name) for name in names]
        q = schedule.trajectory.clamped(np.array([event.time]))[0][0, columns]
        return float(np.abs(target.configurations - q).max(axis=1).min())
    return pose_error(target.pose, target, event.pose, within)


def pose_error(nominal: pin.SE3, target: PoseTarget, pose: pin.SE3, within: float = 0.0) -> float:
    """Measure a pose's error beyond the freedoms of a target [m, rad].

    Args:
        nominal: pose of the target.
        target: its freedoms.
        pose: the pose to check.
        within: allowed distance [m].
    """
    error = nominal.actInv(pose)
    off = max(0.0, float(norm(error.translation)) - within)
    if target.free_yaw:
        tilt = arctan2(np.hypot(error.rotation[0, 2], error.rotation[1, 2]), error.rotation[2, 2])
        return max(off, float(tilt))
    turns = np.arange(target.symmetry) * (TURN / target.symmetry)
    angles = [
        float(rotation_angle(product(error.rotation, pin.utils.rotate("z", -turn))))
        for turn in turns
    ]
    return max(off, min(angles))


def check_lines(schedule: Schedule, job: Job | None, model: ToolModel) -> list[Check]:
    """Check that tools approach and retract straight, by the job's lengths and directions."""
    beside, turned, length, gap = Worst(), Worst(), Worst(), Worst()
    events = {(e.arm, e.task, e.action): e for e in schedule.events}
    stops = job.stops_by_key() if job else {}
    lines = [s for s in schedule.segments if s.kind in ("approach", "retract")]
    waits: dict[tuple[str, str, str], list[Segment]] = {}
    for segment in schedule.segments:
        if segment.kind == "wait":
            waits.setdefault((segment.arm, segment.task, segment.action), []).append(segment)
    # Lines of moving targets are straight in the target's frame, and have checks of their own.
    still = [s for s in lines if (s.arm, s.task, s.action) in events]
    still = [s for s in still if not events[s.arm, s.task, s.action].moves]
    tools = tool_spans(schedule.trajectory, model, [(s.arm, s.start, s.end) for s in still])
    for segment in lines:
        key = (segment.arm, segment.task, segment.action)
        where = f"{segment.kind} of {segment.task} ({segment.action}) at {segment.start:.3f} s"
        if key not in events:
            beside.add(np.inf, f"{where}: no event belongs to it")
            continue
        event = events[key]
        if event.moves:
            continue
        _measure_line(next(tools), segment, event, stops.get(key), (beside, turned, length), where)
        gap.add(_time_from_stand(segment, event, waits.get(key, [])), where)
    missing = _missing_lines(lines, stops)
    if missing:
        length.add(np.inf, missing)
    return [
        beside.judge("lines_straight", TOL.line_distance),
        turned.judge("lines_steady", TOL.line_angle),
        length.judge("line_lengths", TOL.line_distance),
        gap.judge("lines_at_events", TOL.same_time),
    ]


def _time_from_stand(line: Segment, event: Event, waits: Sequence[Segment]) -> float:
    """Compute the time between a line and the stand-still at its target [s].

    After its dwell an arm may wait at the target; waits have a check that the arm stands.
    """
    if line.kind == "approach":
        return abs(line.end - event.time)
    stand_end = event.time + event.dwell
    for wait in waits:
        if abs(wait.start - stand_end) <= TOL.same_time:
            stand_end = wait.end
    return abs(line.start - stand_end)


def _measure_line(
    tool: tuple[FloatArray, FloatArray],
    segment: Segment,
    event: Event,
    stop: Stop | None,
    worst: tuple[Worst, Worst, Worst],
    where: str,
) -> None:
    R, p = tool
    kind, line = int(segment.kind == "retract"), LineDirection()
    if stop is not None:
        line = stop.lines[kind][1]
    # In its own axes the line is the negative z axis.
    axes = product(event.pose.rotation, line.axes(event.pose.rotation))
    local = product(p - event.pose.translation, axes)
    worst[0].add(float(np.hypot(local[:, 0], local[:, 1]).max()), where)
    worst[1].add(float(rotation_angle(product(event.pose.rotation.T, R)).max()), where)
    depth = -local[:, 2] if kind else -local[::-1, 2]
    length = float(depth[-1]) if stop is None else stop.lines[kind][0]
    # Backward motion from the farthest point so far, not between samples: a slow one counts too.
    backwards = float((np.maximum.accumulate(depth) - depth).max())
    beyond = max(-float(depth.min()), float(depth.max()) - length)
    ends = max(abs(float(depth[0])), abs(float(depth[-1]) - length))
    worst[2].add(max(ends, backwards, beyond), where)


def _missing_lines(lines: list[Segment], stops: dict[tuple[str, str, str], Stop]) -> str:
    """Describe a line of the job that the schedule lacks, or return ''."""
    listed = {(s.arm, s.task, s.action, s.kind) for s in lines}
    for (arm, task, action), stop in stops.items():
        if stop.moves:
            continue
        for kind, length in (("approach", stop.approach), ("retract", stop.retract)):
            if length > 0 and (arm, task, action, kind) not in listed:
                return f"{kind} of {task} ({action}) is missing"
    return ""


def check_platform_still(schedule: Schedule, lines: Sequence[LineSpan]) -> Check:
    """Check that the platform stands during every line and dwell.

    Args:
        schedule: the schedule to check, with its listed lines and dwells.
        lines: measured spans of the job's stops.
    """
    robot, trajectory = schedule.robot, schedule.trajectory
    if not robot.platform:
        return not_checked("platform_still")
    spans = [
        (s.start, s.end, f"{s.kind} of {s.task}")
        for s in schedule.segments
        if s.kind in ("approach", "retract", "dwell")
    ]
    spans += [(s.start, s.end, f"lines of {s.event.task}") for s in lines]
    # Without a job, events have the dwells.
    spans += [(e.time, e.time + e.dwell, f"dwell of {e.task}") for e in schedule.events if e.dwell]
    worst, platform = Worst(), trajectory.select(robot.platform)
    for k in range(0, len(spans), AT_ONCE):
        batch = spans[k : k + AT_ONCE]
        starts, ends, names = zip(*batch, strict=True)
        times, first = dense_spans(trajectory.time, starts, ends)
        position, velocity, _ = platform.clamped(times)
        for start, work, (i, j) in zip(starts, names, pairwise(first), strict=True):
            q, v = position[i:j], velocity[i:j]
            moved = max(float(np.abs(v[1:-1]).max(initial=0.0)), float(np.abs(q - q[0]).max()))
            worst.add(moved, f"{work} at {start:.3f} s")
    nothing = "the schedule lists no lines and no dwells in which it has to stand"
    slides = robot.platform_slides
    return worst.judge("platform_still", TOL.same_joints, nothing, slides=slides)
