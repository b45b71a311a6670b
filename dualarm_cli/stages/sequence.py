"""Method `sequence`: optimise the whole cycle at once, with simpler plans as starts."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from functools import partial

import numpy as np

from dualarm_cli.background import BackgroundCall
from dualarm_cli.effort.stages import SCALING
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.model.motion_limits import is_slowed
from dualarm_cli.postures import StopPosture
from dualarm_cli.postures.stage_plan import ArmStop, StagePlan, same_postures
from dualarm_cli.postures.stage_problems import stop_problems
from dualarm_cli.refusals import Refusal
from dualarm_cli.stages.method import Decided, MethodProblem
from dualarm_cli.stages.minimum_time_move import MINIMUM_TIME
from dualarm_cli.stages.plans.launches import default_launches
from dualarm_cli.stages.plans.problem import ArmDecisions, Decisions, SequenceProblem
from dualarm_cli.stages.plans.times import (
    Evaluated,
    TransferChain,
    evaluate,
    start_angle,
    start_joints,
)
from dualarm_cli.stages.search.search import (
    SequenceResult,
    search,
    search_in_parts,
    search_near,
)
from dualarm_cli.stages.search.shared_angles import stages_apart
from dualarm_cli.stages.sequence_problem import sequence_problem
from dualarm_cli.stages.serving import FIXED
from dualarm_cli.stages.stage_by_stage import check_stages, choose_stages, choose_stages_with


def decisions_of(problem: SequenceProblem, model: CellModel, stages: list[StagePlan]) -> Decisions:
    """Convert stages to decisions.

    Args:
        problem: the job's sequence.
        model: the job's cell.
        stages: all stages of the job; a final return is ignored.
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
    """Convert decisions to stages; the return, if any, is the last one.

    Args:
        model: the job's cell.
        job: the job.
        problem: sequence problem of the job.
        decisions: a feasible plan.
        solver: name of the method that decided it.
    """
    # Plans are compared with stops at every line end before they are blended.
    plan = evaluate(replace(problem, launches=None), decisions)
    position = _start(model, job, problem, plan)
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
            posture = _posture(plan, a, k)
            # Full turns of the lines' joints are counted from the target.
            turned[columns] = posture.q_target
            target_problem = stop_problems(model, job, turned, {arm.name: work[arm.name]})[arm.name]
            stops[arm.name] = ArmStop(arm.name, task, stop, target_problem, posture)
            arrival[columns], end[columns] = posture.q_approach, posture.q_retract
        length = float(plan.stages[k])
        plans.append(StagePlan(position, arrival, end, stops, solver, length))
        position = end.copy()
    if problem.returns:
        plans.append(StagePlan(position, first, first, {}, "return", plan.closing))
    return plans


def _start(model: CellModel, job: Job, problem: SequenceProblem, plan: Evaluated) -> FloatArray:
    """Return all joints before the first stage [rad], shape (n,)."""
    position = np.array(job.start_joints)
    if problem.turns:
        position[model.platform_columns] = start_angle(problem, plan.decisions.angle)
    for work, postures in zip(problem.arms, plan.arms, strict=True):
        chain = TransferChain.of(work)
        position[model.arms[work.name].columns] = start_joints(problem, work, chain, postures)
    return position


def _posture(plan: Evaluated, arm: int, stage: int) -> StopPosture:
    row, joints = plan.decisions.arms[arm].take(np.array([stage])), plan.arms[arm]
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


def solve_sequence(problem: MethodProblem) -> Decided:
    """Plan the whole sequence, see `_solved`."""
    with ExitStack() as workers:
        return _solved(problem, workers)


def within_limits(
    problem: MethodProblem, numbers: SequenceProblem
) -> tuple[MethodProblem, SequenceProblem]:
    """Return problem and sequence with the robot's limits; a margin is only a preference."""
    limits = problem.without_margin
    if limits is None:
        return problem, numbers
    problem = replace(problem, model=limits.model, job=limits.job, without_margin=None)
    return problem, replace(numbers_of(problem), with_margin=numbers.arms)


def _solved(problem: MethodProblem, workers: ExitStack) -> Decided:
    """Plan the whole sequence; simpler plans compete as alternatives.

    In short sequences, and if its grids have no plan, the search starts from the unrefined plans of every greedy
    method. Those close to its result are refined and compete with it in exact timing.

    Args:
        problem: problem of the method.
        workers: ends what still runs in worker processes.

    Raises:
        InfeasibleError: no method finds a plan; the reason of the first one.
    """
    model, job = problem.model, problem.job
    numbers = numbers_of(problem)
    spares = problem.settings.spares
    long_sequence = numbers.stages >= numbers.settings.in_parts
    # For arms without an arm angle greedy plans take as long as the search: use them only if it fails.
    general = not problem.model.has_arm_angles
    in_parts = spares and not general and long_sequence and not numbers.returns
    short = numbers.stages <= SCALING.short and numbers.launches is not None
    if problem.without_margin is not None and (in_parts or short):
        # Plans with a margin are candidates of the search with the robot's limits.
        problem, numbers = within_limits(problem, numbers)
        model, job = problem.model, problem.job
    # Long orders come with a plan that the slow simpler methods do not reach.
    long = len(job.stages()) > numbers.settings.given_stages
    given = problem.start is not None and long and spares
    nearby = _near_unchecked(problem, numbers)
    if problem.unchecked and spares:
        # Simpler methods are slow with clearance: compare them only if clearance is expensive.
        if nearby:
            return Decided(nearby[0], simpler=None if given else lambda: _simpler(problem))
        if problem.neighbourhood_only:
            raise InfeasibleError(Refusal("no_plan_on_grid"))
    starts: dict[str, list[StagePlan]] = {}
    failure: InfeasibleError | None = None
    # A further search is there for another plan.
    greedy = not problem.meshes and len(job.stages()) <= _begun(problem, numbers)
    # A blended search restarts from its own plan and seldom loses against simpler plans.
    few = (
        problem.settings.search.refined
        if numbers.launches is not None
        else numbers.settings.few_stages
    )
    always = job.tool_speed is not None or len(job.stages()) <= few or not spares
    quickest: BackgroundCall[list[StagePlan]] | None = None

    def simpler_starts(on_grid: bool) -> list[Decisions]:
        nonlocal starts, failure, quickest
        if given or general or (not greedy if on_grid else problem.without_margin is not None):
            return []
        starts, failure = _starts(problem, on_grid)
        if always and MINIMUM_TIME in starts:
            quickest = BackgroundCall(partial(_refined_start, problem))
            workers.enter_context(quickest)
        return [decisions_of(numbers, model, stages) for stages in starts.values()]

    decided = [] if problem.start is None else [problem.start]
    if long_sequence and not general and not decided and problem.holding is None:
        check_stages(problem, stages_apart(numbers))
    result = None
    if in_parts and problem.holding is None:
        result = search_in_parts(numbers, decided, problem.effort, problem.seed)
    if result is None:
        result = search(numbers, decided, problem.effort, problem.seed, simpler_starts)
    if result is None and nearby:
        return Decided(nearby[0])
    if result is None and general:
        return Decided(choose_stages(problem, FIXED))
    if result is None:
        raise failure or InfeasibleError(Refusal("no_plan_on_grid"))
    stages = stage_plans(model, job, numbers, result.best.decisions, "sequence")
    if result.is_infeasible:
        return Decided(stages, is_infeasible=True)
    polished = (stage_plans(model, job, numbers, plan, "sequence") for plan in result.others)
    alternatives = *_rivals(problem, starts, result, quickest), *polished
    # The grid's bound ignores the cost of clearance, the plan on the grid includes it.
    gap = _grid_gap(result) if problem.holding is None else None
    simpler = (lambda: _simpler(problem)) if general else None
    return Decided(stages, gap, (*nearby, *alternatives), simpler=simpler)


def _begun(problem: MethodProblem, numbers: SequenceProblem) -> float:
    """Return the number of stages up to which simpler methods' plans are starts.

    Where stops have several yaws, a grid misses more.
    """
    stops = (stop for arm in numbers.arms for stop in arm.stops if stop is not None)
    several = any(len(stop.yaw) > 1 and not stop.free_yaw for stop in stops)
    begun = problem.settings.search.begun
    return max(begun, SCALING.short) if several else begun


def _near_unchecked(problem: MethodProblem, numbers: SequenceProblem) -> list[list[StagePlan]]:
    """Search near the unchecked plan; return its stages, or nothing."""
    if not problem.unchecked:
        return []
    near = search_near(
        numbers,
        decisions_of(numbers, problem.model, list(problem.unchecked)),
        problem.colliding_stages,
        problem.effort,
        problem.seed,
        # A search that ignores tool speed limits keeps the stages that do not collide.
        local=is_slowed(problem.job) and not problem.is_careful,
    )
    if near is None:
        return []
    return [stage_plans(problem.model, problem.job, numbers, near.decisions, "sequence")]


def numbers_of(problem: MethodProblem) -> SequenceProblem:
    """Build the sequence problem, with line ends in motion if the search supports that."""
    job = problem.job
    lines = any(stop.approach or stop.retract for task in job.tasks for stop in task.stops)
    given = problem.model, job, problem.holding, problem.no_goods
    numbers = sequence_problem(*given, is_careful=problem.is_careful)
    numbers = replace(
        numbers,
        settings=problem.settings.sequence,
        meshes=problem.meshes,
        progress=problem.progress,
    )
    if not (problem.blends and problem.is_timed_whole and lines):
        return numbers
    if problem.without_margin is not None:
        limits = problem.without_margin.job.limits
        arms = (
            replace(work, robot_limits=limits.select(work.limits.joints)) for work in numbers.arms
        )
        numbers = replace(numbers, arms=tuple(arms))
    return replace(numbers, launches=default_launches(numbers))


def _simpler(problem: MethodProblem) -> list[list[StagePlan]]:
    """Plan by the simpler methods; leave out equal plans."""
    few = len(problem.job.stages()) <= problem.settings.sequence.few_stages
    names = [*problem.simpler, *([MINIMUM_TIME] if few and problem.model.has_arm_angles else [])]
    plans: list[list[StagePlan]] = []
    for plan in choose_stages_with(problem, names).values():
        if isinstance(plan, InfeasibleError) or any(same_postures(plan, kept) for kept in plans):
            continue
        plans.append(plan)
    return plans


def _starts(
    problem: MethodProblem, on_grid: bool
) -> tuple[dict[str, list[StagePlan]], InfeasibleError | None]:
    """Plan by the simpler methods without refinement; also return the first refusal.

    Args:
        problem: the problem of the method.
        on_grid: whether the search's grids have a plan.
    """
    starts: dict[str, list[StagePlan]] = {}
    failure: InfeasibleError | None = None
    long = len(problem.job.stages()) > SCALING.long
    # In long sequences the plan of `linearised` is nearly that of `exact`.
    names = [name for name in problem.simpler if not (long and name == "linearised")]
    if on_grid and problem.settings.search.quickest_moves_only:
        names = []
    rough = choose_stages_with(problem, [*names, MINIMUM_TIME], refine=False)
    for name, plan in rough.items():
        if isinstance(plan, InfeasibleError):
            failure = failure or plan
        elif not any(same_postures(plan, accepted) for accepted in starts.values()):
            starts[name] = plan
    return starts, failure


def _grid_gap(result: SequenceResult) -> float | None:
    if result.grid_total is None or result.grid_bound is None or result.grid_total <= 0.0:
        return None
    return max(0.0, 1.0 - result.grid_bound / result.grid_total)


def _refined_start(problem: MethodProblem) -> list[StagePlan]:
    """Refine the plan of `minimum_time`; empty if a stage has none."""
    plan = choose_stages_with(problem, [MINIMUM_TIME])[MINIMUM_TIME]
    return [] if isinstance(plan, InfeasibleError) else plan


def _rivals(
    problem: MethodProblem,
    starts: dict[str, list[StagePlan]],
    result: SequenceResult,
    quickest: BackgroundCall[list[StagePlan]] | None,
) -> tuple[list[StagePlan], ...]:
    """Refine the simpler plans that exact timing may show to be as fast.

    Args:
        problem: the problem of the method.
        starts: unrefined plans of the simpler methods.
        result: result of the search.
        quickest: refinement of the `minimum_time` plan, where it is refined in any case.
    """
    total, settings = result.best.total, problem.settings.sequence
    capped = problem.job.tool_speed is not None
    even = SCALING.damping(len(problem.job.stages()))
    excess = dict.fromkeys(starts, np.inf if capped else settings.refined * even)
    if MINIMUM_TIME in excess:
        excess[MINIMUM_TIME] = np.inf if quickest else settings.refined_moves * even
    limits = {name: (1.0 + share) * total for name, share in excess.items()}
    rivals = [name for name, rough in starts.items() if _length(rough) <= limits[name]]
    here = [name for name in rivals if not (quickest and name == MINIMUM_TIME)]
    refined = choose_stages_with(problem, here)
    if quickest:
        refined[MINIMUM_TIME] = quickest.result()
    ordered = (refined[name] for name in rivals)
    plans = [plan for plan in ordered if plan and not isinstance(plan, InfeasibleError)]
    # Only exact timing shows the cost of a tool speed limit.
    longest = (1.0 + settings.alike * even) * total
    return tuple(plan for plan in plans if capped or _length(plan) <= longest)


def _length(plan: list[StagePlan]) -> float:
    return sum(stage.duration for stage in plan)
