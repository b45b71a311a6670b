"""Greedy methods: decide stage by stage, platform angle first, then postures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.postures.clear_postures import StageCollisionTest
from dualarm_cli.postures.stage_plan import StagePlan, giver_and_taker
from dualarm_cli.postures.stage_problems import Clock
from dualarm_cli.refusals import Refusal
from dualarm_cli.stages.method import MethodProblem
from dualarm_cli.stages.minimum_time_move import MINIMUM_TIME, choose_quickest
from dualarm_cli.stages.serving import FIXED
from dualarm_cli.stages.stage_choice import OpenStage, choose_stage
from dualarm_cli.timing.stage_length import stage_length


def choose_stages(
    problem: MethodProblem, platform: str, *, refine: bool = True, count: int | None = None
) -> list[StagePlan]:
    """Decide the stages of a job greedily in order.

    Args:
        problem: the job, its redundancy solver, and what has to be collision-free.
        platform: name of the platform solver, or `minimum_time`.
        refine: whether postures are refined; without it stages are decided faster, to compare.
        count: how many stages are decided; all of them by default.

    Raises:
        InfeasibleError: a target that no posture reaches, with its place and by how much it misses.
    """
    plan = choose_stages_with(problem, [platform], refine=refine, count=count)[platform]
    if isinstance(plan, InfeasibleError):
        raise plan
    return plan


def choose_stages_with(
    problem: MethodProblem,
    platforms: Sequence[str],
    *,
    refine: bool = True,
    count: int | None = None,
) -> dict[str, list[StagePlan] | InfeasibleError]:
    """Decide the stages of a job by several platform solvers independently.

    Stage by stage all of them together, so that postures from every solver's positions are computed at once.

    Args:
        problem: the job, its redundancy solver, and what has to be collision-free.
        platforms: names of the platform solvers; `minimum_time` may be among them.
        refine: whether postures are refined.
        count: how many stages are decided; all of them by default.
    """
    model, job = problem.model, problem.job
    clock = Clock.of(model, job)
    home = np.array(job.start_joints)
    plans: dict[str, list[StagePlan]] = {name: [] for name in platforms}
    failures: dict[str, InfeasibleError] = {}
    for k, work in enumerate(job.stages()[:count]):
        stage = OpenStage(model, clock, work, refine, _test_of(problem, k), problem.redundancy)
        positions = {
            name: np.array(stages[-1].end) if stages else home
            for name, stages in plans.items()
            if name not in failures
        }
        greedy = {name: position for name, position in positions.items() if name != MINIMUM_TIME}
        made = choose_stage(stage, greedy)
        if MINIMUM_TIME in positions:
            made[MINIMUM_TIME] = choose_quickest(stage, positions[MINIMUM_TIME])
        for name, plan in made.items():
            if isinstance(plan, InfeasibleError):
                failures[name] = plan
            elif not plans[name] and job.start == "free":
                plans[name].append(_starting_there(plan))
            else:
                plans[name].append(plan)
    for stages in plans.values():
        if job.returns and stages:
            stages.append(_return(model, clock, stages))
    return {name: failures.get(name, plans[name]) for name in platforms}


def _test_of(problem: MethodProblem, stage: int) -> StageCollisionTest | None:
    """Return the collision test of a stage, or None where collisions are not checked."""
    holding = problem.holding
    return None if holding is None else StageCollisionTest(problem.model, holding, stage)


def check_stages(problem: MethodProblem, stages: Sequence[int]) -> None:
    """Refuse stages that cannot be made even by themselves.

    Args:
        problem: the job, its redundancy solver, and what has to be collision-free.
        stages: their numbers.

    Raises:
        InfeasibleError: a stage has no postures, with the place of its tasks.
    """
    clock, work = Clock.of(problem.model, problem.job), problem.job.stages()
    position, refusals = np.array(problem.job.start_joints), list[Refusal]()
    for k in stages:
        stage = OpenStage(
            problem.model, clock, work[k], False, _test_of(problem, k), problem.redundancy
        )
        [plan] = choose_stage(stage, {FIXED: position}).values()
        if isinstance(plan, InfeasibleError):
            refusals += plan.refusals
    if refusals:
        raise InfeasibleError(*refusals)


def _starting_there(plan: StagePlan) -> StagePlan:
    """Move the start of the first stage to the end of its transfer."""
    lines, dwells = [], []
    for arm in plan.stops.values():
        transfer = arm.problem.transfer_time(arm.posture.q_approach - arm.problem.start)
        lines.append(arm.posture.cost - max(float(transfer), arm.problem.waiting))
        dwells.append(arm.stop.dwell.total)
    is_handover = giver_and_taker(plan.stops) is not None
    length = stage_length([0.0] * len(lines), lines, dwells, is_handover)
    return replace(plan, start=plan.arrival, duration=float(length))


def _return(model: CellModel, clock: Clock, plans: Sequence[StagePlan]) -> StagePlan:
    """Build the return to the start of the first transfer."""
    position, first = plans[-1].end, plans[0].start
    moved = first - position
    longest = max(
        float(clock.platform_times(moved[model.platform_columns])),
        *(
            float(clock.arms[name].law.duration(moved[arm.columns]))
            for name, arm in model.arms.items()
        ),
    )
    return StagePlan(position, first, first, {}, "return", longest)
