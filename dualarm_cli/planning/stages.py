"""Decisions, stage by stage: platform angle by its solver, then one posture per arm."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.cell_model import ArmModel, CellModel
from dualarm_cli.model.job import Job, JointTarget, PoseTarget, Stop, Task
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.planning.platform_candidates import platform_candidates
from dualarm_cli.planning.reach import explain_reach, reachable_positions
from dualarm_cli.redundancy import REDUNDANCY_SOLVERS, NoPosture, StopPosture, StopProblem
from dualarm_cli.timing.line_profile import estimate_line_durations
from dualarm_cli.timing.rest_to_rest import RestToRest

YAW_STEPS = 24
"""Turns about the tool's z axis that are tried where any will do: 15 degrees apart."""


@dataclass(frozen=True)
class ArmStop:
    """What one arm does in a stage."""

    arm: str
    """Name of the arm."""
    task: Task
    """The task it works on."""
    stop: Stop
    """The target."""
    problem: StopProblem
    """The stop as the redundancy solver saw it, for the lines."""
    posture: StopPosture
    """How the stop is made."""


@dataclass(frozen=True)
class StagePlan:
    """Everything decided about one stage; times follow from it."""

    start: FloatArray
    """All joints before [rad], shape (n,)."""
    arrival: FloatArray
    """All joints after the transfer [rad], shape (n,)."""
    end: FloatArray
    """All joints after the retracts [rad], shape (n,)."""
    stops: Mapping[str, ArmStop]
    """By arm; an arm without a partner's work in this stage is missing. Empty for a return."""
    solver: str
    """The method that gave the platform angle."""
    duration: float
    """Estimated length of the stage [s]."""


@dataclass(frozen=True)
class _Clock:
    """Closed-form times under the job's limits."""

    platform: RestToRest | None
    arms: Mapping[str, RestToRest]
    limits: Mapping[str, JointLimits]
    refine: bool = True


def choose_stages(
    model: CellModel,
    job: Job,
    platform: str,
    redundancy: str,
    *,
    refine: bool = True,
    count: int | None = None,
) -> list[StagePlan]:
    """Returns the stages of a job, decided greedily in their order.

    Args:
        model: the job's cell.
        job: what is to be done.
        platform: name of the platform solver.
        redundancy: name of the redundancy solver.
        refine: whether postures are refined; without it stages are decided three times as fast, to compare.
        count: how many stages are decided; all of them by default.

    Raises:
        InfeasibleError: a target that no posture reaches, with its place and by how much it misses.
    """
    robot, clock = job.cell.robot, replace(_clock(job), refine=refine)
    position = np.array(robot.postures["home" if job.start == "free" else job.start])
    plans: list[StagePlan] = []
    for work in job.stages()[:count]:
        plan = _choose_stage(model, clock, position, work, platform, redundancy)
        if not plans and job.start == "free":
            plan = replace(plan, start=plan.arrival)
        plans.append(plan)
        position = np.array(plan.end)
    if job.returns and plans:
        first = plans[0].start
        time = _transfer_times(model, clock, position, first)
        plans.append(StagePlan(position, first, first, {}, "return", max(time.values())))
    return plans


def stop_problems(
    model: CellModel, job: Job, position: FloatArray, work: Mapping[str, tuple[Task, Stop]]
) -> dict[str, StopProblem]:
    """Returns each arm's stop as seen with the platform where it is.

    Args:
        model: the job's cell.
        job: for its limits.
        position: all joints before the stage [rad], shape (n,).
        work: the stage's targets by arm.
    """
    clock = _clock(job)
    return {
        name: _stop_problem(model, clock, position, position, name, stop)
        for name, (_, stop) in work.items()
    }


def _clock(job: Job) -> _Clock:
    robot = job.cell.robot
    limits = robot.limits.scaled(job.speed)
    return _Clock(
        _rest_to_rest(limits.select(robot.platform)) if robot.platform else None,
        {arm.name: _rest_to_rest(limits.select(arm.joints)) for arm in robot.arms},
        {arm.name: limits.select(arm.joints) for arm in robot.arms},
    )


def _rest_to_rest(limits: JointLimits) -> RestToRest:
    return RestToRest(limits.velocity, limits.acceleration, limits.jerk)


def _choose_stage(
    model: CellModel,
    clock: _Clock,
    position: FloatArray,
    work: Mapping[str, tuple[Task, Stop]],
    platform: str,
    redundancy: str,
) -> StagePlan:
    """Returns the stage at the first platform position at which every arm finds a posture."""
    reasons: dict[str, NoPosture] = {}
    at_start = {
        name: _stop_problem(model, clock, position, position, name, stop)
        for name, (_, stop) in work.items()
    }
    for solver, angles in platform_candidates(model, position, at_start, platform):
        plan, reasons = _try_position(model, clock, position, angles, work, solver, redundancy)
        if plan is not None:
            return plan
    for angles in reachable_positions(model, position, at_start):
        plan, _ = _try_position(model, clock, position, angles, work, "reach", redundancy)
        if plan is not None:
            return plan
    raise InfeasibleError(_explain(model, position, work, at_start, reasons))


def _try_position(
    model: CellModel,
    clock: _Clock,
    position: FloatArray,
    angles: FloatArray,
    work: Mapping[str, tuple[Task, Stop]],
    solver: str,
    redundancy: str,
) -> tuple[StagePlan | None, dict[str, NoPosture]]:
    """Returns the stage at one platform position, or None and every arm's reason against it."""
    choose = REDUNDANCY_SOLVERS[redundancy].solve
    turned = np.array(position)
    turned[model.platform_columns] = angles
    stops: dict[str, ArmStop] = {}
    reasons: dict[str, NoPosture] = {}
    arrival, end, longest = turned.copy(), turned.copy(), 0.0
    for name, (task, stop) in work.items():
        problem = _stop_problem(model, clock, position, turned, name, stop)
        posture = choose(problem)
        if isinstance(posture, NoPosture):
            reasons[name] = posture
            continue
        stops[name] = ArmStop(name, task, stop, problem, posture)
        columns = model.arms[name].columns
        arrival[columns], end[columns] = posture.q_approach, posture.q_retract
        longest = max(longest, posture.cost + stop.dwell.total)
    if reasons:
        return None, reasons
    return StagePlan(np.array(position), arrival, end, stops, solver, longest), {}


def _stop_problem(
    model: CellModel,
    clock: _Clock,
    position: FloatArray,
    turned: FloatArray,
    name: str,
    stop: Stop,
) -> StopProblem:
    """Returns one arm's stop with the platform as in `turned`, coming from `position`."""
    arm = model.arms[name]
    R_base_tool, p_base_tool, configurations = _targets(model, arm, turned, stop)
    T_tool_flange = arm.T_flange_tcp.inverse()
    limits = clock.limits[name]
    waiting = 0.0
    if clock.platform is not None:
        moved = (turned - position)[model.platform_columns]
        waiting = float(clock.platform.duration(moved))

    def line_time(q: FloatArray, length: FloatArray) -> FloatArray:
        return estimate_line_durations(q, length, limits)

    return StopProblem(
        arm=arm.kinematics,
        R_base_tool=R_base_tool,
        p_base_tool=p_base_tool,
        R_tool_flange=T_tool_flange.rotation,
        p_tool_flange=T_tool_flange.translation,
        configurations=configurations,
        yaw=stop_yaws(stop),
        free_yaw=isinstance(stop.target, PoseTarget) and stop.target.free_yaw,
        approach=stop.approach,
        retract=stop.retract,
        start=position[arm.columns],
        waiting=waiting,
        transfer_time=clock.arms[name].duration,
        line_time=line_time,
        refine=clock.refine,
    )


def _targets(
    model: CellModel, arm: ArmModel, turned: FloatArray, stop: Stop
) -> tuple[FloatArray, FloatArray, FloatArray | None]:
    """Returns tool rotations, tool positions and configurations in the carried frame."""
    tcp = arm.T_flange_tcp
    if isinstance(stop.target, JointTarget):
        R, p = arm.kinematics.forward(stop.target.configurations)
        return R @ tcp.rotation, p + R @ tcp.translation, stop.target.configurations
    R_world, p_world = model.carried_frame(turned)
    R = R_world.T @ stop.target.pose.rotation
    p = R_world.T @ (stop.target.pose.translation - p_world)
    return R[None], p[None], None


def stop_yaws(stop: Stop) -> FloatArray:
    """Returns the turns about the tool's z axis that are tried at a stop [rad], shape (y,)."""
    if isinstance(stop.target, JointTarget):
        return np.zeros(1)
    turns = YAW_STEPS if stop.target.free_yaw else stop.target.symmetry
    return np.arange(turns, dtype=np.float64) * (2.0 * np.pi / turns)


def _transfer_times(
    model: CellModel, clock: _Clock, start: FloatArray, goal: FloatArray
) -> dict[str, float]:
    """Returns the closed-form time of each arm and of the platform [s]."""
    moved = goal - start
    times = {
        name: float(clock.arms[name].duration(moved[arm.columns]))
        for name, arm in model.arms.items()
    }
    if clock.platform is not None:
        times["platform"] = float(clock.platform.duration(moved[model.platform_columns]))
    return times


def _explain(
    model: CellModel,
    position: FloatArray,
    work: Mapping[str, tuple[Task, Stop]],
    stops: Mapping[str, StopProblem],
    reasons: Mapping[str, NoPosture],
) -> str:
    """Returns what a person needs to mend a stage that cannot be made: only the arms at fault."""
    faults = {name: explain_reach(model, position, stop) for name, stop in stops.items()}
    faults = {name: fault for name, fault in faults.items() if fault is not None}
    if not faults:
        faults = {name: reason.reason for name, reason in reasons.items()}
        if model.platform.is_turntable and len(work) > 1:
            faults = dict.fromkeys(work, "reached, but at no platform angle that suits both arms")
    lines = []
    for name, fault in faults.items():
        task, stop = work[name]
        lines.append(f"{stop.place}: task '{task.id}': {name} arm cannot {stop.action}: {fault}")
    if not model.platform.joints:
        where = "no posture"
    elif model.platform.is_turntable:
        where = "no posture at any platform angle"
    else:
        where = (
            "no posture with the platform held where it starts (this version turns one joint only)"
        )
    return where + " makes this stage:\n  " + "\n  ".join(lines)
