"""The method `minimum_time`: every stage as fast as it can be from where the one before ended."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.minimum_time.problem import ArmDecisions, Decisions, SequenceProblem
from dualarm_cli.minimum_time.search import best_move
from dualarm_cli.minimum_time.times import Evaluated
from dualarm_cli.planning.method import Decided, MethodProblem
from dualarm_cli.planning.platform_candidates import platform_candidates
from dualarm_cli.planning.sequence_plans import stage_plans
from dualarm_cli.planning.sequence_problem import sequence_problem
from dualarm_cli.planning.stages import stop_problems

BALANCING = "exact"
"""Platform solver whose candidates (equal elbows, stationary points, ends of reach) are looked at in any case."""


def solve_move_by_move(problem: MethodProblem, refined: bool = True) -> Decided:
    """Returns the plan of the quickest stage after the quickest stage; nothing is looked ahead.

    Args:
        problem: the job.
        refined: whether every stage's plan is refined; without, it is found five times as fast.

    Raises:
        InfeasibleError: a stage that cannot be made from where the one before ended.
    """
    model, job = problem.model, problem.job
    numbers = sequence_problem(model, job)
    position = np.array(job.cell.robot.postures["home" if job.start == "free" else job.start])
    angle = np.zeros(numbers.stages)
    arms = [ArmDecisions.idle(work.start, numbers.stages) for work in numbers.arms]
    for k, work in enumerate(job.stages()):
        stage = _one_stage(numbers, model, position, k)
        extra = np.zeros(0)
        if numbers.turns:
            seen = stop_problems(model, job, position, work)
            candidates = platform_candidates(model, position, seen, BALANCING)
            extra = np.array([float(angles[0]) for _, angles in candidates])
        found = best_move(stage, extra, refined, problem.seed)
        if found is None:
            names = ", ".join(task.id for task, _ in work.values())
            raise InfeasibleError(
                f"stage {k + 1} ({names}): no posture of both arms was found on the grid; try --platform exact"
            )
        angle[k] = found.decisions.angle[0]
        for a, decided in enumerate(found.decisions.arms):
            if stage.arms[a].stops[0] is not None:
                arms[a] = arms[a].put(np.array([k]), decided)
        position = _after(stage, model, position, found)
    decisions = Decisions(angle, tuple(arms))
    return Decided(stage_plans(model, job, numbers, decisions, "minimum_time"))


def _one_stage(
    numbers: SequenceProblem, model: CellModel, position: FloatArray, k: int
) -> SequenceProblem:
    """Returns stage k alone, from where everything stands."""
    arms = tuple(
        replace(work, stops=(work.stops[k],), start=position[model.arms[work.name].columns])
        for work in numbers.arms
    )
    return replace(
        numbers,
        arms=arms,
        platform_start=position[model.platform_columns],
        free_start=numbers.free_start and k == 0,
        returns=False,
    )


def _after(
    stage: SequenceProblem, model: CellModel, position: FloatArray, found: Evaluated
) -> FloatArray:
    """Returns where everything stands after a stage."""
    after = position.copy()
    if stage.turns:
        after[model.platform_columns] = found.decisions.angle[0]
    for work, reached in zip(stage.arms, found.arms, strict=True):
        if work.stops[0] is not None:
            after[model.arms[work.name].columns] = reached.q_retract[0]
    return after
