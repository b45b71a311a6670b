"""Motion of arms at their stops: lines, dwells and hand-overs, with segments and events."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin

from dualarm_cli.background import map_halves
from dualarm_cli.compiled import trajectories
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.products import product
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import JointTarget, PoseTarget
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.schedule import Event, SegmentKind, Stage, WaitReason
from dualarm_cli.motion.builder import MotionBuilder
from dualarm_cli.motion.transfers import (
    PLATFORM,
    Drive,
    Key,
    Rates,
    Transfers,
    transfers_within_tool_speed,
)
from dualarm_cli.postures import StopProblem
from dualarm_cli.postures.stage_plan import ArmStop, StagePlan, giver_and_taker
from dualarm_cli.postures.stop_lines import line_path
from dualarm_cli.postures.tracked import Tracked
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal
from dualarm_cli.timing.composition import hold
from dualarm_cli.timing.launch import Launch, reversed_in_time, solve_launch
from dualarm_cli.timing.problem import LineProblem


@dataclass(frozen=True)
class LineSettings:
    """Resolution and tolerance of timed lines."""

    line_tolerance: float = 5e-5
    """Largest deviation from a line [m, rad], half of the verified tolerance."""
    knots: tuple[int, ...] = (12, 24, 48, 96, 192, 384)
    """Numbers of knots, tried in order until the tool is within tolerance."""
    shared: int = 48
    """Number of lines from which two processes time them.

    Starting a process takes as long as timing twenty lines.
    """


LINE = LineSettings()

PATH_SAMPLES = 65
"""Number of samples of a line with exact inverse kinematics."""
CHECKS_PER_KNOT = 4
"""Instants per interval at which the deviation is measured."""


def stage_of(
    model: CellModel,
    plan: StagePlan,
    transfers: Transfers,
    start: float,
    end: float,
    critical: str,
) -> Stage:
    """Build a stage with the times of its transfers and its bottleneck.

    Args:
        model: the job's cell.
        plan: the stage.
        transfers: straight transfers.
        start: start time [s].
        end: end time [s].
        critical: the arm that ends last; empty for a return.
    """
    return Stage(
        start=start,
        end=end,
        tasks=tuple(dict.fromkeys(stop.task.id for stop in plan.stops.values())),
        platform_solver=plan.solver,
        platform_angle=model.platform_angle(plan.arrival),
        platform_time=transfers.times.get(PLATFORM, 0.0),
        arm_times={name: t for name, t in transfers.times.items() if name != PLATFORM},
        joint_times=transfers.joint_times,
        bottleneck=transfers.bottleneck(critical),
    )


def event_of(model: CellModel, plan: StagePlan, arm_stop: ArmStop, time: float) -> Event:
    """Build the event of a stop, with the commanded pose.

    The pose is the target turned by the chosen yaw, or the passed pose next to it.
    """
    target, name = arm_stop.stop.target, arm_stop.arm
    if name in plan.through:
        pose = model.tool_pose(name, plan.arrival)
    elif isinstance(target, PoseTarget):
        turn = pin.SE3(pin.utils.rotate("z", arm_stop.posture.yaw), np.zeros(3))
        pose = target.pose * turn
    else:
        assert isinstance(target, JointTarget)  # seams are planned in sections of their own
        position = np.array(plan.arrival)
        position[model.arms[name].columns] = target.configurations[arm_stop.posture.target]
        pose = model.tool_pose(name, position)
    return Event(
        time=time,
        arm=name,
        task=arm_stop.task.id,
        action=arm_stop.stop.action,
        frame=f"{name}_tcp",
        pose=pose,
        dwell=arm_stop.stop.dwell.total,
        velocity=arm_stop.stop.velocity,
        signal=arm_stop.stop.signal,
        grasp=arm_stop.task.grasp.name if arm_stop.task.grasp is not None else "",
        width=model.cell.width(arm_stop.task.part),
    )


def solve_line(
    drive: Drive,
    arm_stop: ArmStop,
    line: str,
    path: tuple[FloatArray, FloatArray],
    launch: Launch | None = None,
) -> Trajectory:
    """Time the motion of an arm along its approach or retract.

    Args:
        drive: of the job.
        arm_stop: the arm's stop.
        line: `approach` or `retract`.
        path: joints along it (m, n) [rad], and lengths travelled (m,) [m].
        launch: launch at the line's outer end; None at rest.

    Raises:
        InfeasibleError: the tool leaves the tolerance with any number of knots.
    """
    (q, length), away = path, line == "retract"
    drive = drive.along(arm_stop, line)
    limits, cap = drive.group_limits[arm_stop.arm], drive.caps.get(arm_stop.arm)
    # A launch is given from the target outwards.
    along = q if away or launch is None else q[::-1]
    for knots in LINE.knots:
        problem = LineProblem(limits.joints, along, length, limits, cap, knots)
        if launch is None:
            trajectory = drive.timing.line(problem)
        else:
            outwards = solve_launch(problem, launch)
            trajectory = outwards if away else reversed_in_time(outwards)
        distance, angle = line_deviation(arm_stop.problem, q, trajectory)
        if max(distance, angle) <= LINE.line_tolerance:
            return trajectory
    details = {
        "line": line,
        "mm": distance * 1000,
        "angle": angle,
        "most": LINE.line_tolerance * 1000,
    }
    arguments = arm_stop.stop.place, arm_stop.task.id, arm_stop.arm, distance, LINE.line_tolerance
    raise InfeasibleError(Refusal("line_left", *arguments, data=details))


def line_deviation(
    problem: StopProblem, q: FloatArray, trajectory: Trajectory
) -> tuple[float, float]:
    """Compute the largest distance [m] and angle [rad] of the tool from its line.

    Args:
        problem: problem of the line's stop.
        q: exact joints along the line [rad], shape (m, 7); only the ends are used.
        trajectory: motion to check.
    """
    tip = product(-problem.R_tool_flange.T, problem.p_tool_flange)
    knots = trajectory.time, trajectory.position, trajectory.velocity, trajectory.acceleration
    return trajectories.line_deviation(
        (*problem.arm.chain, tip), q[[0, -1]], knots, CHECKS_PER_KNOT
    )


def add_handover(
    record: MotionBuilder,
    drive: Drive,
    plan: StagePlan,
    pair: tuple[ArmStop, ArmStop],
    ends: Mapping[str, float],
) -> dict[str, float]:
    """Append a hand-over; return the end of each arm's part [s].

    The taking arm approaches and grips while the giving arm stands still. Then the giving arm releases and retracts
    while the taking arm stands still.

    Args:
        record: plan under construction.
        drive: of the job.
        plan: the stage.
        pair: the giving and the taking arm's stop.
        ends: arrival of each group at its lines, from the stage's start [s].
    """
    begin, giver, taker = record.clock, *pair
    # An arm that arrives in motion is the last, except for rounding.
    moves = (taker.arm, "approach") in plan.passes
    arrival = ends[taker.arm] if moves else max(ends.values())

    def wait(arm_stop: ArmStop, start: float, end: float) -> None:
        if end <= start:
            return
        arm = drive.model.arms[arm_stop.arm]
        stands = hold(arm.arm.joints, plan.arrival[arm.columns], end - start)
        record.add(arm_stop.arm, stands)
        record.add_segment(arm_stop.arm, "wait", arm_stop, start, end, "partner")

    clock = begin + arrival
    wait(taker, begin + ends[taker.arm], clock)
    gripped = add_stop(record, drive, plan, taker, clock)
    wait(giver, begin + ends[giver.arm], gripped)
    away = add_stop(record, drive, plan, giver, gripped)
    return {taker.arm: gripped - begin, giver.arm: away - begin}


def timed_line(drive: Drive, plan: StagePlan, arm_stop: ArmStop, line: str) -> Trajectory:
    """Return the timed `approach` or `retract` of a stop, from the cache if known."""
    key = _timed_key(drive, plan, arm_stop, line)
    if key not in drive.cache.lines:
        launch = plan.passes.get((arm_stop.arm, line))
        path = joints_along(drive, plan, arm_stop, line)
        timed = solve_line(drive, arm_stop, line, path, launch)
        drive.cache.lines[key] = arm_stop.stop, timed
    return drive.cache.lines[key][1]


def time_lines(drive: Drive, plans: Sequence[StagePlan]) -> None:
    """Time the uncached lines of stages, in two processes if allowed.

    Lines that cannot be timed are skipped.

    Args:
        drive: of the job; its `cache` gets the lines.
        plans: stages.
    """
    requests: dict[Key, tuple[StagePlan, ArmStop, str]] = {}
    for plan in plans:
        for arm_stop in plan.stops.values():
            if arm_stop.tracked is not None:
                continue
            for line, distance in (
                ("approach", arm_stop.stop.approach),
                ("retract", arm_stop.stop.retract),
            ):
                key = _timed_key(drive, plan, arm_stop, line)
                if distance > 0.0 and key not in drive.cache.lines:
                    requests[key] = plan, arm_stop, line

    def timed(batch: Sequence[tuple[StagePlan, ArmStop, str]]) -> list[Trajectory | None]:
        motions: list[Trajectory | None] = []
        for request in batch:
            try:
                motions.append(timed_line(drive, *request))
            except InfeasibleError:
                motions.append(None)
        return motions

    lines = list(requests.values())
    for request, trajectory in zip(lines, map_halves(timed, lines, LINE.shared), strict=True):
        if trajectory is not None:
            remember_line(drive, *request, trajectory)


def remember_line(
    drive: Drive, plan: StagePlan, arm_stop: ArmStop, line: str, timed: Trajectory
) -> None:
    """Store the timed line of a stop in the cache."""
    key = _timed_key(drive, plan, arm_stop, line)
    drive.cache.lines.setdefault(key, (arm_stop.stop, timed))


def _timed_key(drive: Drive, plan: StagePlan, arm_stop: ArmStop, line: str) -> Key:
    """Build the cache key of a timed line."""
    launch = plan.passes.get((arm_stop.arm, line))
    return (line, launch, *line_key(drive.model, plan, arm_stop, line))


def joints_along(
    drive: Drive, plan: StagePlan, arm_stop: ArmStop, line: str
) -> tuple[FloatArray, FloatArray]:
    """Return the joints along a line, and the lengths travelled; see `line_path`."""
    key = (line, *line_key(drive.model, plan, arm_stop, line))
    if key not in drive.cache.paths:
        q, length = line_path(arm_stop.problem, arm_stop.posture, line, PATH_SAMPLES)
        drive.cache.paths[key] = arm_stop.stop, q, length
    _, q, length = drive.cache.paths[key]
    return q, length


def rates_between(drive: Drive, before: StagePlan | None, plan: StagePlan) -> Rates:
    """Return the rates of arms that depart or arrive in motion.

    Arms with a detour are left out, because it has its own rates.
    """
    rates = {}
    for name in drive.columns:
        if name in plan.detours:
            continue
        leaving = None if before is None else before.through.get(name)
        arriving = plan.through.get(name)
        if before is not None and (name, "retract") in before.passes:
            line = timed_line(drive, before, before.stops[name], "retract")
            leaving = np.stack([line.velocity[-1], line.acceleration[-1]])
        if (name, "approach") in plan.passes:
            line = timed_line(drive, plan, plan.stops[name], "approach")
            arriving = np.stack([line.velocity[0], line.acceleration[0]])
        if leaving is not None or arriving is not None:
            rates[name] = leaving, arriving
    return rates


def transfers_in_motion(drive: Drive, plan: StagePlan, rates: Rates) -> Transfers:
    """Time the transfers of a stage whose arms may move at both ends.

    An arm that passes its target arrives at the stage's end. A taking arm that arrives in motion arrives when the
    giving arm is ready.
    """
    drive = drive.to(plan)
    transfers = transfers_within_tool_speed(drive, plan, rates)
    minimum: dict[str, float] = {}
    times = {name: motion.duration for name, motion in transfers.motion.items()}
    if plan.through:
        ends = [
            times.get(name, 0.0) + stop_duration(drive, plan, arm_stop)
            for name, arm_stop in plan.stops.items()
        ]
        minimum = dict.fromkeys(plan.through, max([*times.values(), *ends]))
    pair = giver_and_taker(plan.stops)
    if pair is not None and (pair[1].arm, "approach") in plan.passes:
        minimum[pair[1].arm] = max(times.values())
    return transfers_within_tool_speed(drive, plan, rates, minimum) if minimum else transfers


def stop_duration(drive: Drive, plan: StagePlan, arm_stop: ArmStop) -> float:
    """Compute the duration of a stop from approach to retract [s]."""
    if arm_stop.tracked is not None:
        return arm_stop.tracked.motion.duration
    stop, duration = arm_stop.stop, arm_stop.stop.dwell.total
    for line, distance in (("approach", stop.approach), ("retract", stop.retract)):
        duration += timed_line(drive, plan, arm_stop, line).duration if distance > 0.0 else 0.0
    return duration


def add_stop(
    record: MotionBuilder,
    drive: Drive,
    plan: StagePlan,
    arm_stop: ArmStop,
    clock: float,
    earliest_end: float = 0.0,
) -> float:
    """Append approach, dwell and retract of an arm; return their end [s].

    Args:
        record: plan under construction.
        drive: of the job.
        plan: the stage.
        arm_stop: the arm's stop.
        clock: start time [s].
        earliest_end: earliest end [s]; an arm that departs in motion waits at its target for it.
    """
    name, stop = arm_stop.arm, arm_stop.stop
    joints = drive.model.arms[name].arm.joints

    def add(piece: Trajectory, kind: SegmentKind, reason: WaitReason = "") -> None:
        nonlocal clock
        record.add(name, piece)
        record.add_segment(name, kind, arm_stop, clock, clock + piece.duration, reason)
        clock += piece.duration

    if arm_stop.tracked is not None:
        return _add_tracked(record, drive.model, plan, arm_stop, arm_stop.tracked, clock)
    if stop.approach > 0:
        add(timed_line(drive, plan, arm_stop, "approach"), "approach")
    record.events.append(event_of(drive.model, plan, arm_stop, clock))
    if stop.dwell.total > 0:
        add(hold(joints, arm_stop.posture.q_target, stop.dwell.total), "dwell")
    if stop.retract > 0:
        retract = timed_line(drive, plan, arm_stop, "retract")
        early = earliest_end - (clock + retract.duration)
        if (name, "retract") in plan.passes and early > 0.0:
            add(hold(joints, arm_stop.posture.q_target, early), "wait", "partner")
        add(retract, "retract")
    return clock


def _add_tracked(
    record: MotionBuilder,
    model: CellModel,
    plan: StagePlan,
    arm_stop: ArmStop,
    tracked: Tracked,
    clock: float,
) -> float:
    """Append a stop on a conveyor, its lines merged with the ramps; return its end [s]."""
    name = arm_stop.arm
    reached, left = clock + tracked.reached, clock + tracked.left
    end = clock + tracked.motion.duration
    record.add(name, tracked.motion)
    record.add_segment(name, "approach", arm_stop, clock, reached)
    record.events.append(event_of(model, plan, arm_stop, reached))
    if left > reached:
        record.add_segment(name, "dwell", arm_stop, reached, left)
    record.add_segment(name, "retract", arm_stop, left, end)
    return end


def line_key(model: CellModel, plan: StagePlan, arm_stop: ArmStop, line: str) -> Key:
    """Build the cache key of a line: target, platform, posture and start."""
    posture, problem = arm_stop.posture, arm_stop.problem
    outer = plan.arrival if line == "approach" else plan.end
    numbers = (
        outer[model.platform_columns],
        problem.start,
        posture.q_target,
        [
            posture.target,
            posture.yaw,
            posture.branch,
            posture.psi_target,
            posture.psi_approach,
            posture.psi_retract,
        ],
    )
    return arm_stop.arm, id(arm_stop.stop), np.concatenate(numbers).tobytes()
