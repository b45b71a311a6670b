"""Conversion of a job to the arrays of the sequence search."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from dualarm_cli.collision.lying import stop_yaws
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.cell_model import ArmModel, CellModel
from dualarm_cli.model.job import Job, JointTarget, PoseTarget, Stop, Task
from dualarm_cli.model.motion_limits import MotionLimits, is_slowed
from dualarm_cli.model.part_flow import NO_CARE, Care
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.postures.holding import Holding
from dualarm_cli.stages.plans.clearance import NoGood, SequenceClearance
from dualarm_cli.stages.plans.problem import ArmWork, SequenceProblem, StopTarget
from dualarm_cli.stages.plans.slowing import UNLIMITED, Pace


def sequence_problem(
    model: CellModel,
    job: Job,
    holding: Holding | None = None,
    no_goods: tuple[NoGood, ...] = (),
    *,
    is_careful: bool = False,
) -> SequenceProblem:
    """Build the sequence problem of a job, under its limits at its speed.

    Args:
        model: the job's cell.
        job: job with its limits.
        holding: parts and margins for collision checking; None disables it.
        no_goods: stages that collided before.
        is_careful: whether care and the tool speed limit count.
    """
    stages = job.stages()
    stops = {
        name: [
            _target(work[name][1], None if holding is None else holding.yaws[k, name])
            if name in work
            else None
            for k, work in enumerate(stages)
        ]
        for name in model.arms
    }
    handing = tuple(any(stop.action == "give" for _, stop in work.values()) for work in stages)
    sequence = replace(_problem(model, job, stops), handing=handing)
    if is_careful and is_slowed(job):
        sequence = _careful(model, job, sequence)
    if holding is None:
        return sequence
    start = np.array(job.start_joints)
    return replace(sequence, clearance=_clearance(model, start, holding, no_goods))


def stops_problem(
    model: CellModel, job: Job, stops: Mapping[str, Sequence[Stop | None]]
) -> SequenceProblem:
    """Build a sequence problem whose stages are given stops.

    Args:
        model: the job's cell.
        job: for its limits and its start.
        stops: each arm's stops, all of them as many.
    """
    targets = {
        name: [None if stop is None else _target(stop, None) for stop in arm_stops]
        for name, arm_stops in stops.items()
    }
    return _problem(model, job, targets)


def _problem(
    model: CellModel, job: Job, stops: Mapping[str, Sequence[StopTarget | None]]
) -> SequenceProblem:
    robot = job.cell.robot
    limits = job.limits
    start = np.array(job.start_joints)
    arms = tuple(
        _arm_work(arm, limits.select(arm.arm.joints), tuple(stops[name]), start[arm.columns])
        for name, arm in model.arms.items()
    )
    law, span = None, (0.0, 0.0)
    if model.platform.is_chosen:
        platform = limits.select(robot.platform)
        law = platform.law
        span = (float(platform.lower[0]), float(platform.upper[0]))
    return SequenceProblem(
        platform=model.platform,
        platform_law=law,
        platform_range=span,
        platform_start=start[model.platform_columns],
        arms=arms,
        free_start=job.start == "free",
        returns=job.returns,
    )


def _careful(model: CellModel, job: Job, sequence: SequenceProblem) -> SequenceProblem:
    """Add care and the tool speed limit to all stops and to the return."""
    stages, arms = job.stages(), []
    for arm in sequence.arms:
        stops = (
            None if stop is None else replace(stop, pace=_pace(model, job, arm.name, work))
            for stop, work in zip(arm.stops, stages, strict=True)
        )
        home = _pace(model, job, arm.name, {})
        arms.append(replace(arm, stops=tuple(stops), home_pace=home))
    return replace(sequence, arms=tuple(arms))


def _pace(model: CellModel, job: Job, name: str, work: Mapping[str, tuple[Task, Stop]]) -> Pace:
    """Return an arm's limits in a stage, of no stops for a return."""
    keys = frozenset((arm, task.id, stop.action) for arm, (task, stop) in work.items())
    moving = MotionLimits.of_stage(job, keys)
    joints = (*model.arms[name].arm.joints, *model.platform.joints * model.platform.is_chosen)
    task, stop = work.get(name, (None, None))
    lines = [NO_CARE] * 2
    if task is not None and stop is not None:
        lines = [task.care_before(stop.action), task.care_after(stop.action)]
    cap = UNLIMITED if job.tool_speed is None else job.tool_speed
    return Pace(
        moving.joints.select(joints),
        moving.caps.get(name, UNLIMITED),
        (_line_time(job, joints, lines[0]), _line_time(job, joints, lines[1])),
        (min(cap, lines[0].tool_speed), min(cap, lines[1].tool_speed)),
    )


def _line_time(job: Job, joints: tuple[str, ...], care: Care) -> float:
    """Return the factor on a line's time, that of a small displacement of all joints."""
    limits, moved = job.limits.select(joints), np.full(len(joints), 0.2)
    slow = limits.scaled(care.speed, care.acceleration)
    return float(slow.law.duration(moved) / limits.law.duration(moved))


def _clearance(
    model: CellModel, start: FloatArray, holding: Holding, no_goods: tuple[NoGood, ...]
) -> SequenceClearance:
    columns, turns = tuple(model.platform_columns), model.platform.is_chosen
    return SequenceClearance(holding, columns, start, turns, no_goods)


def _arm_work(
    arm: ArmModel, limits: JointLimits, stops: tuple[StopTarget | None, ...], start: np.ndarray
) -> ArmWork:
    T_tool_flange = arm.T_flange_tcp.inverse()
    return ArmWork(
        name=arm.arm.name,
        kinematics=arm.kinematics,
        limits=limits,
        law=limits.law,
        R_tool_flange=T_tool_flange.rotation,
        p_tool_flange=T_tool_flange.translation,
        stops=stops,
        start=start,
    )


def _target(stop: Stop, yaws: FloatArray | None) -> StopTarget:
    target = stop.target
    if isinstance(target, JointTarget):
        R, p, free, configurations = np.eye(3), np.zeros(3), False, target.configurations
    else:
        assert isinstance(target, PoseTarget)  # seams are planned in sections of their own
        R, p = target.pose.rotation, target.pose.translation
        free, configurations = target.free_yaw, None
    return StopTarget(
        R_world_tool=R,
        p_world_tool=p,
        configurations=configurations,
        yaw=stop_yaws(stop) if yaws is None else yaws,
        free_yaw=free,
        approach=stop.approach,
        retract=stop.retract,
        dwell=stop.dwell.total,
        directions=stop.directions.vectors,
    )
