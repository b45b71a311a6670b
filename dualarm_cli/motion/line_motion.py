"""Lines on which the platform turns: inverse kinematics keeps each tool on its line in the world.

The platform goes straight from its place at the targets to that at the lines' outer ends, each tool along its line, and
each arm angle from that at the target to that at the outer end, all with one parameter. That is a path of all these
joints, which is timed as a line is. All arms that work in the stage are on such a line together. Our own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.motion.transfers import PLATFORM, Drive, Key
from dualarm_cli.motion.world_poses import (
    followed,
    in_carried_frame,
    largest_angle,
    measured_tools,
)
from dualarm_cli.postures.stage_plan import ArmStop, StagePlan
from dualarm_cli.refusals import Refusal
from dualarm_cli.timing.launch import Launch, reversed_in_time, solve_launch
from dualarm_cli.timing.problem import LineProblem

LINE_TOLERANCE = 5e-5
"""How far the tool may leave its line [m] and its orientation [rad]: half of what is verified."""
PATH_SAMPLES = 65
"""Exact inverse kinematics along a line."""
KNOTS = (12, 24, 48, 96, 192, 384)
"""Numbers of knots that are tried until the tool stays within the tolerance."""


def groups_on_line(plan: StagePlan) -> tuple[str, ...]:
    """Returns the groups that are on a line together where the platform turns on it."""
    return (PLATFORM, *plan.stops)


def with_turned_line(
    drive: Drive, plan: StagePlan, line: str, platform: FloatArray, target: FloatArray
) -> StagePlan:
    """Returns a stage in which the platform moves while all of its arms are on a line.

    Args:
        drive: of the job.
        plan: the stage; what comes before or after has to be fitted to its other ends.
        line: `approach` or `retract`.
        platform: its joints at the outer end [rad or m], shape (k,).
        target: its joints at the targets [rad or m], shape (k,).

    Raises:
        InfeasibleError: an arm cannot keep its tool on its line.
    """
    away = line == "retract"
    outer = np.array(plan.end if away else plan.arrival)
    outer[drive.model.platform_columns] = platform
    plan = _ending(replace(plan, turned={**plan.turned, line: target}), line, outer)
    outer = np.array(outer)
    stops, leaving = dict(plan.stops), dict(plan.leaving)
    for name in plan.stops:
        own = leaving if away and name in leaving else stops
        q, made = _arm_path(drive, plan, own[name], line)[-1], own[name].posture
        outer[drive.columns[name]] = q
        made = replace(made, q_retract=q) if away else replace(made, q_approach=q)
        own[name] = replace(own[name], posture=made)
    return replace(_ending(plan, line, outer), stops=stops, leaving=leaving)


def _ending(plan: StagePlan, line: str, outer: FloatArray) -> StagePlan:
    """Returns a stage with all joints at the outer end of a line [rad or m], shape (n,)."""
    return replace(plan, end=outer) if line == "retract" else replace(plan, arrival=outer)


def turned_path(drive: Drive, plan: StagePlan, line: str) -> FloatArray:
    """Returns platform and arms along a line on which the platform turns, from the targets outwards.

    Returns:
        Joints of `groups_on_line` at PATH_SAMPLES equal shares of the way [rad or m], shape (PATH_SAMPLES, n).

    Raises:
        InfeasibleError: an arm cannot keep its tool on its line.
    """
    arms = [_arm_path(drive, plan, plan.stop_at(line, one), line) for one in plan.stops.values()]
    return np.hstack([_platform_path(drive, plan, line), *arms])


def _platform_path(drive: Drive, plan: StagePlan, line: str) -> FloatArray:
    columns = drive.model.platform_columns
    outer = plan.end if line == "retract" else plan.arrival
    target = plan.platform_at(line, columns)
    share = np.linspace(0.0, 1.0, PATH_SAMPLES)[:, None]
    return target + share * (outer[columns] - target)


def line_length(one: ArmStop, line: str) -> float:
    """Returns the length of a stop's `approach` or `retract` [m]."""
    return one.stop.retract if line == "retract" else one.stop.approach


def _arm_path(drive: Drive, plan: StagePlan, one: ArmStop, line: str) -> FloatArray:
    """Returns one arm's joints along its line (PATH_SAMPLES, n), from the target outwards."""
    platform, made = _platform_path(drive, plan, line), one.posture
    end = made.psi_retract if line == "retract" else made.psi_approach
    ways = [made.psi_target, end, made.branch, line_length(one, line)]
    numbers = made.q_target, ways, platform[0], platform[-1]
    key: Key = ("turned", line, one.arm, np.concatenate(numbers).tobytes())
    if key not in drive.known.paths:
        arm = drive.model.arms[one.arm].kinematics
        R_first, p_first = drive.model.platform.pose(platform[0])
        R, p = arm.forward(made.q_target)
        R_flange, z = product(R_first, R), _tool_axis(drive, one.arm, product(R_first, R))
        depth = np.linspace(0.0, line_length(one, line), PATH_SAMPLES)
        points = p_first + product(R_first, p) - depth[:, None] * z
        flange = in_carried_frame(drive.model, platform, R_flange, points)
        q = followed(arm, made, end - made.psi_target, flange)
        drive.known.paths[key] = one.stop, q, depth
    return drive.known.paths[key][1]


def _tool_axis(drive: Drive, name: str, R_flange: FloatArray) -> FloatArray:
    """Returns the direction of a tool's z axis, given the rotation of its flange."""
    axis: FloatArray = product(R_flange, drive.model.arms[name].T_flange_tcp.rotation[:, 2])
    return axis


def turned_problem(drive: Drive, plan: StagePlan, line: str) -> LineProblem:
    """Returns a line on which the platform turns as what is to be timed, from the targets outwards.

    Raises:
        InfeasibleError: an arm cannot keep its tool on its line.
    """
    names = tuple(joint for group in groups_on_line(plan) for joint in drive.joints(group))
    longest = max(line_length(one, line) for one in plan.stops.values())
    length = np.linspace(0.0, longest, PATH_SAMPLES)
    path = turned_path(drive, plan, line)
    return LineProblem(names, path, length, drive.limits.select(names), drive.cap)


def turned_line(drive: Drive, plan: StagePlan, line: str) -> Mapping[str, Trajectory]:
    """Returns the timed motion of platform and arms along a line on which the platform turns, by group.

    Raises:
        InfeasibleError: a tool cannot be kept on its line within the tolerance.
    """
    groups, columns = groups_on_line(plan), drive.model.platform_columns
    launch = plan.passes.get((PLATFORM, line))
    outer = plan.end if line == "retract" else plan.arrival
    numbers = [plan.platform_at(line, columns), outer[columns]]
    for one in plan.stops.values():
        made = plan.stop_at(line, one).posture
        end = made.psi_retract if line == "retract" else made.psi_approach
        ways = [made.psi_target, end, made.branch, line_length(one, line)]
        numbers += [made.q_target, np.array(ways)]
    key: Key = (line, launch, *groups, np.concatenate(numbers).tobytes())
    if key not in drive.known.together:
        timed = _timed(drive, plan, line, launch)
        parts = tuple(timed.select(drive.joints(group)) for group in groups)
        drive.known.together[key] = parts
    return dict(zip(groups, drive.known.together[key], strict=True))


def _timed(drive: Drive, plan: StagePlan, line: str, launch: Launch | None) -> Trajectory:
    problem, away = turned_problem(drive, plan, line), line == "retract"
    for knots in KNOTS:
        finer = replace(problem, knots=knots)
        if launch is not None:
            timed = solve_launch(finer, launch)
            timed = timed if away else reversed_in_time(timed)
        else:
            position = finer.position if away else finer.position[::-1]
            timed = drive.timing.line(replace(finer, position=position))
        if turned_deviation(drive, plan, line, timed) <= LINE_TOLERANCE:
            return timed
    raise InfeasibleError(Refusal("no_plan_on_grid"))


def turned_deviation(drive: Drive, plan: StagePlan, line: str, timed: Trajectory) -> float:
    """Returns how far tools leave their lines [m] or orientations [rad] at most, measured in the world."""
    columns = drive.model.platform_columns
    platform = plan.platform_at(line, columns)
    R_first, p_first = drive.model.platform.pose(platform)
    worst = 0.0
    for name, (R, tip) in measured_tools(drive, groups_on_line(plan), timed, platform).items():
        arm, made = drive.model.arms[name], plan.stop_at(line, plan.stops[name]).posture
        R_arm, p_arm = arm.kinematics.forward(made.q_target)
        R_target = product(R_first, R_arm)
        target = p_first + product(R_first, p_arm + product(R_arm, arm.T_flange_tcp.translation))
        z = _tool_axis(drive, name, R_target)
        offset = tip - target
        beside = offset - product(offset, z)[:, None] * z
        off = float(norm(beside, axis=1).max())
        worst = max(worst, off, largest_angle(R, R_target))
    return worst
