"""Motion while tools stand at their targets: platform and arms move on, and inverse kinematics keeps the tools there.

The platform goes straight to where it leaves the stage, and so does the arm angle of each arm. That is a path of all
these joints, which is timed as a line is. Where the platform moves, all arms at targets move with it, from when the
last one is there; where it does not, each arm moves by itself. No arm leaves its target before that is over. Our own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.continuation import moved_along, spare_directions
from dualarm_cli.kinematics.general_arm import GeneralArm
from dualarm_cli.kinematics.srs.srs_arm import SrsArm
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.motion.builder import MotionBuilder
from dualarm_cli.motion.stop_motion import KNOTS, PATH_SAMPLES, add_segment, event_of, timed_line
from dualarm_cli.motion.transfers import PLATFORM, Drive, Key
from dualarm_cli.postures.stage_plan import ArmStop, StagePlan
from dualarm_cli.refusals import Refusal
from dualarm_cli.timing.composition import hold
from dualarm_cli.timing.problem import LineProblem

HELD_DISTANCE, HELD_ANGLE = 1e-5, 5e-5
"""How far the tool may be from its target [m] and turned away [rad]: half of what is verified."""
CHECKS_PER_KNOT = 4
"""Instants per interval at which that is measured."""
SAME_JOINTS = 1e-6
"""How near to the configuration in which an arm leaves its way there must end [rad]."""
LARGEST_STEP = 0.2
"""A joint that moves more between two samples has jumped [rad]."""


@dataclass(frozen=True)
class DwellMotion:
    """What moves while tools stand."""

    groups: tuple[str, ...]
    """The arms, after the platform where it moves too."""
    motion: Mapping[str, Trajectory]
    """By group, all of one length."""
    duration: float
    """How long it takes [s]."""


def dwell_motions(drive: Drive, plan: StagePlan) -> tuple[DwellMotion, ...]:
    """Returns what moves in the dwells of a stage: platform and arms together, or each arm by itself.

    Args:
        drive: of the job.
        plan: the stage.

    Raises:
        InfeasibleError: a tool cannot be kept at its target.
    """
    index = drive.model.platform_columns
    if np.array_equal(plan.arrival[index], plan.end[index]):
        return tuple(_timed(drive, plan, (name,)) for name in plan.leaving)
    return (_timed(drive, plan, (PLATFORM, *plan.leaving)),)


def _timed(drive: Drive, plan: StagePlan, groups: tuple[str, ...]) -> DwellMotion:
    columns = drive.model.platform_columns
    ends = [plan.arrival[columns], plan.end[columns]]
    for name, left in plan.leaving.items():
        ends += [plan.stops[name].posture.q_target, left.posture.q_target]
    key: Key = (*groups, *(end.tobytes() for end in ends))
    if key not in drive.known.dwells:
        drive.known.dwells[key] = _solved(drive, plan, groups)
    parts = drive.known.dwells[key]
    motion = dict(zip(groups, parts, strict=True))
    return DwellMotion(groups, motion, parts[0].duration)


def _solved(drive: Drive, plan: StagePlan, groups: tuple[str, ...]) -> tuple[Trajectory, ...]:
    """Returns the motion of some groups in the dwells of a stage, timed."""
    path = dwell_path(drive.model, plan, groups, PATH_SAMPLES)
    names = tuple(joint for group in groups for joint in drive.joints(group))
    limits, share = drive.limits.select(names), np.linspace(0.0, 1.0, PATH_SAMPLES)
    for knots in KNOTS:
        motion = drive.timing.line(LineProblem(names, path, share, limits, None, knots))
        distance, angle = _tool_deviation(drive, plan, groups, motion)
        if distance <= HELD_DISTANCE and angle <= HELD_ANGLE:
            return tuple(motion.select(drive.joints(group)) for group in groups)
    raise InfeasibleError(Refusal("no_plan_on_grid"))


def dwell_path(
    model: CellModel, plan: StagePlan, groups: tuple[str, ...], samples: int
) -> FloatArray:
    """Returns the joints of some groups along their way while tools stand [rad or m], shape (samples, n).

    Args:
        model: the job's cell.
        plan: the stage.
        groups: of which.
        samples: how many of them, at equal shares of the way.

    Raises:
        InfeasibleError: an arm cannot keep its tool at its target on the way.
    """
    share = np.linspace(0.0, 1.0, samples)[:, None]
    index = model.platform_columns
    platform = plan.arrival[index] + share * (plan.end[index] - plan.arrival[index])
    found = [platform] if PLATFORM in groups else []
    R_carried, p_carried = model.platform.pose(platform)
    for name in groups:
        if name == PLATFORM:
            continue
        arm, stop, left = model.arms[name].kinematics, plan.stops[name], plan.leaving[name]
        R, p = arm.forward(stop.posture.q_target)
        # The flange stays where it is in the world.
        R_back = np.swapaxes(R_carried, -1, -2)
        R_flange = R_back @ (R_carried[0] @ R)
        p_flange = (R_back @ (p_carried[0] + R_carried[0] @ p - p_carried)[..., None])[..., 0]
        found.append(_followed(arm, stop, left, (R_flange, p_flange)))
    return np.hstack(found)


def _followed(
    arm: SrsArm | GeneralArm, stop: ArmStop, left: ArmStop, flange: tuple[FloatArray, FloatArray]
) -> FloatArray:
    """Returns an arm's joints (m, n) as its flange follows poses, (m, 3, 3) and (m, 3), from one posture to another.

    Raises:
        InfeasibleError: it cannot.
    """
    (R, p), first, last = flange, stop.posture.q_target, left.posture.q_target
    share = np.linspace(0.0, 1.0, len(R))
    if isinstance(arm, GeneralArm):
        begin = np.tile(first, (len(R), 1))
        ways = spare_directions(arm, first[None])[0] @ (last - first)
        q, ok = moved_along(arm, begin, R, p, share * (ways[0] if len(ways) else 0.0))
        good = bool(ok.all())
    else:
        one, other = stop.posture, left.posture
        psi = one.psi_target + share * (other.psi_target - one.psi_target)
        q, reached = arm.solve_branch(R, p, psi, np.full(len(R), one.branch))
        steps = np.diff(q, axis=0)
        steps -= 2.0 * np.pi * np.round(steps / (2.0 * np.pi))
        q = first + np.vstack([np.zeros_like(first), np.cumsum(steps, axis=0)])
        good = bool(reached.all() and arm.within_limits(q).all())
    good = good and bool(np.abs(np.diff(q, axis=0)).max() <= LARGEST_STEP)
    if not good or np.abs(q[[0, -1]] - np.stack([first, last])).max() > SAME_JOINTS:
        raise InfeasibleError(Refusal("no_plan_on_grid"))
    # To the last digit, so that pieces of motion can be joined.
    q[0], q[-1] = first, last
    return q


def _tool_deviation(
    drive: Drive, plan: StagePlan, groups: tuple[str, ...], motion: Trajectory
) -> tuple[float, float]:
    """Returns how far tools are from where they stand at most: distance [m] and angle [rad]."""
    share = np.arange(CHECKS_PER_KNOT) / CHECKS_PER_KNOT
    times = (motion.time[:-1, None] + np.diff(motion.time)[:, None] * share).ravel()
    joints = motion.at(times)[0]
    model, columns, distance, angle = drive.model, {}, 0.0, 0.0
    first = 0
    for group in groups:
        columns[group] = slice(first, first + len(drive.columns[group]))
        first = columns[group].stop
    platform = np.tile(plan.arrival[model.platform_columns], (len(times), 1))
    if PLATFORM in groups:
        platform = joints[:, columns[PLATFORM]]
    R_carried, p_carried = model.platform.pose(platform)
    for name in groups:
        if name == PLATFORM:
            continue
        arm = model.arms[name]
        R, p = arm.kinematics.forward(joints[:, columns[name]])
        tip = p_carried + (R_carried @ (p + R @ arm.T_flange_tcp.translation)[..., None])[..., 0]
        turned = R_carried @ R
        gap = np.linalg.norm(turned - turned[0], axis=(1, 2)) / (2.0 * np.sqrt(2.0))
        distance = max(distance, float(np.linalg.norm(tip - tip[0], axis=1).max()))
        angle = max(angle, float(2.0 * np.arcsin(np.clip(gap, 0.0, 1.0)).max()))
    return distance, angle


def add_moving_dwells(
    record: MotionBuilder, drive: Drive, plan: StagePlan, ends: Mapping[str, float]
) -> dict[str, float]:
    """Appends the stops of a stage in whose dwells joints move; returns when each group is done with it [s].

    Args:
        record: what is planned so far.
        drive: of the job.
        plan: the stage.
        ends: when each group is where its lines begin, from the stage's start [s].
    """
    lines = {
        (name, line): timed_line(drive, plan, one, line)
        for name, one in plan.stops.items()
        for line, way in (("approach", one.stop.approach), ("retract", one.stop.retract))
        if way > 0.0
    }
    length = {key: line.duration for key, line in lines.items()}
    there = {name: ends[name] + length.get((name, "approach"), 0.0) for name in plan.stops}
    leaves = {name: there[name] + one.stop.dwell.total for name, one in plan.stops.items()}
    moves: dict[str, tuple[float, Trajectory]] = {}
    for move in dwell_motions(drive, plan):
        arms = [name for name in move.groups if name != PLATFORM]
        start = max(there[name] for name in arms)
        moves |= {name: (start, move.motion[name]) for name in move.groups}
        leaves |= {name: max(leaves[name], start + move.duration) for name in arms}
    latest = {name: leaves[name] + length.get((name, "retract"), 0.0) for name in plan.stops}
    over = max({**ends, **latest}.values())
    found = dict(ends)
    if PLATFORM in moves:
        found[PLATFORM] = _add_move(
            record, drive, PLATFORM, plan.arrival, ends[PLATFORM], moves[PLATFORM]
        )
    for name, one in plan.stops.items():
        if (name, "retract") in plan.passes:
            # What leaves in motion leaves as the stage ends.
            leaves[name] += over - latest[name]
        found[name] = _add_stop(
            record, drive, plan, one, lines, (there[name], leaves[name], moves.get(name))
        )
    return found


def _add_move(
    record: MotionBuilder,
    drive: Drive,
    group: str,
    position: FloatArray,
    clock: float,
    move: tuple[float, Trajectory],
) -> float:
    """Appends a group's motion in a dwell, and standing until it begins; returns when it is over [s].

    Args:
        record: what is planned so far.
        drive: of the job.
        group: which one.
        position: all joints until then [rad or m], shape (n,).
        clock: since when it stands, from the stage's start [s].
        move: when it begins [s], and the motion.
    """
    start, motion = move
    if start > clock:
        record.add(group, hold(drive.joints(group), position[drive.columns[group]], start - clock))
    record.add(group, motion)
    return start + motion.duration


def _add_stop(
    record: MotionBuilder,
    drive: Drive,
    plan: StagePlan,
    arm_stop: ArmStop,
    lines: Mapping[tuple[str, str], Trajectory],
    stay: tuple[float, float, tuple[float, Trajectory] | None],
) -> float:
    """Appends one arm's stop; returns when it is over, from the stage's start [s].

    Args:
        record: what is planned so far.
        drive: of the job.
        plan: the stage.
        arm_stop: what the arm does in it.
        lines: the stage's lines, by arm and line.
        stay: when it comes to its target and leaves it, from the stage's start [s], and what moves meanwhile.
    """
    name, begin, (there, leaves, move) = arm_stop.arm, record.clock, stay
    approach, retract = lines.get((name, "approach")), lines.get((name, "retract"))
    if approach is not None:
        record.add(name, approach)
        start = begin + there - approach.duration
        add_segment(record, name, "approach", arm_stop, start, begin + there)
    record.events.append(event_of(drive.model, plan, arm_stop, begin + there))
    clock, position = there, np.array(plan.arrival)
    position[drive.columns[name]] = arm_stop.posture.q_target
    if move is not None:
        clock = _add_move(record, drive, name, position, clock, move)
        position[drive.columns[name]] = plan.leaving[name].posture.q_target
    if leaves > clock:
        record.add(name, hold(drive.joints(name), position[drive.columns[name]], leaves - clock))
    over = there + arm_stop.stop.dwell.total
    add_segment(record, name, "dwell", arm_stop, begin + there, begin + over)
    if leaves > over:
        add_segment(record, name, "wait", arm_stop, begin + over, begin + leaves, "partner")
    if retract is None:
        return leaves
    record.add(name, retract)
    end = leaves + retract.duration
    add_segment(record, name, "retract", arm_stop, begin + leaves, begin + end)
    return end
