"""Between decided stages and the numbers of the search: there and back."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.minimum_time.problem import ArmDecisions, Decisions, SequenceProblem
from dualarm_cli.minimum_time.stops import StopTable
from dualarm_cli.minimum_time.times import Chain, Evaluated, evaluate, start_angle, start_joints
from dualarm_cli.model.job import Job
from dualarm_cli.planning.stages import ArmStop, StagePlan, stop_problems
from dualarm_cli.redundancy import StopPosture


def decisions_of(problem: SequenceProblem, model: CellModel, stages: list[StagePlan]) -> Decisions:
    """Returns decided stages as numbers.

    Args:
        problem: the job's sequence.
        model: the job's cell.
        stages: of all its stages; a return at the end is left out.
    """
    n = problem.stages
    angle = np.zeros(n)
    if problem.turns:
        column = model.platform_columns[0]
        angle = np.array([plan.arrival[column] for plan in stages[:n]])
    arms = []
    for work in problem.arms:
        decisions = ArmDecisions.idle(work.start, n)
        for k, plan in enumerate(stages[:n]):
            if work.name in plan.stops:
                decisions = decisions.put(np.array([k]), _row(plan.stops[work.name].posture))
        arms.append(decisions)
    return Decisions(angle, tuple(arms))


def _row(posture: StopPosture) -> ArmDecisions:
    return ArmDecisions(
        np.array([posture.target]),
        np.array([posture.yaw]),
        np.array([posture.branch]),
        np.array([posture.psi_target]),
        np.array([posture.psi_approach]),
        np.array([posture.psi_retract]),
        posture.q_target[None],
    )


def stage_plans(
    model: CellModel, job: Job, problem: SequenceProblem, decisions: Decisions, solver: str
) -> list[StagePlan]:
    """Returns the stages of a decided sequence, the return last where there is one.

    Args:
        model: the job's cell.
        job: what is to be done.
        problem: the same as numbers.
        decisions: a possible plan.
        solver: name of the method that made it.
    """
    tables = tuple(StopTable.of(work) for work in problem.arms)
    found = evaluate(problem, tables, decisions)
    position = _start(model, job, problem, found)
    first = position
    plans = []
    for k, work in enumerate(job.stages()):
        arrival = position.copy()
        if problem.turns:
            arrival[model.platform_columns] = decisions.angle[k]
        turned, end = arrival.copy(), arrival.copy()
        stops = {}
        for a, arm in enumerate(problem.arms):
            if arm.name not in work:
                continue
            task, stop = work[arm.name]
            columns = model.arms[arm.name].columns
            posture = _posture(found, a, k)
            # Seen from the target itself: the lines' whole turns are counted from there.
            turned[columns] = posture.q_target
            seen = stop_problems(model, job, turned, {arm.name: work[arm.name]})[arm.name]
            stops[arm.name] = ArmStop(arm.name, task, stop, seen, posture)
            arrival[columns], end[columns] = posture.q_approach, posture.q_retract
        length = float(found.stages[k])
        plans.append(StagePlan(position, arrival, end, stops, solver, length))
        position = end.copy()
    if problem.returns:
        plans.append(StagePlan(position, first, first, {}, "return", found.closing))
    return plans


def _start(model: CellModel, job: Job, problem: SequenceProblem, found: Evaluated) -> FloatArray:
    """Returns all joints before the first stage [rad], shape (n,)."""
    robot = job.cell.robot
    position = np.array(robot.postures["home" if job.start == "free" else job.start])
    if problem.turns:
        position[model.platform_columns] = start_angle(problem, found.decisions.angle)
    for work, postures in zip(problem.arms, found.arms, strict=True):
        chain = Chain.of(work)
        position[model.arms[work.name].columns] = start_joints(problem, work, chain, postures)
    return position


def _posture(found: Evaluated, arm: int, stage: int) -> StopPosture:
    row, joints = found.decisions.arms[arm].take(np.array([stage])), found.arms[arm]
    return StopPosture(
        target=int(row.target[0]),
        yaw=float(row.yaw[0]),
        branch=int(row.branch[0]),
        psi_target=float(row.psi_target[0]),
        psi_approach=float(row.psi_approach[0]),
        psi_retract=float(row.psi_retract[0]),
        q_approach=joints.q_approach[stage],
        q_target=joints.q_target[stage],
        q_retract=joints.q_retract[stage],
        cost=float(joints.work[stage]),
    )
