"""The method `sequence`: everything together over the whole cycle, from every simpler method's plan."""

from __future__ import annotations

from contextlib import suppress

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.minimum_time.search import Found, search
from dualarm_cli.planning.method import Decided, MethodProblem
from dualarm_cli.planning.move_by_move import solve_move_by_move
from dualarm_cli.planning.sequence_plans import decisions_of, stage_plans
from dualarm_cli.planning.sequence_problem import sequence_problem
from dualarm_cli.planning.stages import StagePlan, choose_stages

ALIKE = 0.08
"""A simpler method's plan that is estimated to be slower by less than this share is timed exactly as well: estimates of
lines are a few percent off, and a third of a cycle is lines."""
REFINED = 0.12
"""A simpler method's plan is refined only if it is slower by less than this share: refining gains 1 to 7 percent."""
FEW_STAGES = 12
"""Up to so many stages the plan that is quickest move by move is a start too; beyond, with thorough effort only, since
it costs as much as the search and has always been slower there."""


def solve_sequence(problem: MethodProblem) -> Decided:
    """Returns the plan of the search over the whole sequence, and simpler ones that may turn out to be as fast.

    The search starts from every greedy method's plan with unrefined postures; those that come near its result are
    refined and compete with it when all are timed exactly.

    Raises:
        InfeasibleError: no method finds a plan; the reason of the first one.
    """
    model, job = problem.model, problem.job
    numbers = sequence_problem(model, job)
    starts: dict[str, list[StagePlan]] = {}
    failure: InfeasibleError | None = None
    for name in problem.simpler:
        try:
            starts[name] = choose_stages(model, job, name, problem.redundancy, refine=False)
        except InfeasibleError as error:
            failure = failure or error
    found = search(
        numbers,
        [decisions_of(numbers, model, stages) for stages in starts.values()],
        problem.effort,
        problem.seed,
    )
    if found is None:
        raise failure or InfeasibleError("no plan was found on the grid of nodes")
    stages = stage_plans(model, job, numbers, found.best.decisions, "sequence")
    alternatives = _rivals(problem, starts, found)
    return Decided(stages, _grid_gap(found), alternatives)


def _grid_gap(found: Found) -> float | None:
    if found.grid_total is None or found.grid_bound is None or found.grid_total <= 0.0:
        return None
    return max(0.0, 1.0 - found.grid_bound / found.grid_total)


def _rivals(
    problem: MethodProblem, starts: dict[str, list[StagePlan]], found: Found
) -> tuple[list[StagePlan], ...]:
    """Returns simpler methods' refined plans that may be as fast as the search's when timed exactly."""
    total = found.best.total
    plans = [
        choose_stages(problem.model, problem.job, name, problem.redundancy)
        for name, rough in starts.items()
        if _length(rough) <= (1.0 + REFINED) * total
    ]
    if len(problem.job.stages()) <= FEW_STAGES or problem.effort == "thorough":
        with suppress(InfeasibleError):
            plans.append(solve_move_by_move(problem).stages)
    return tuple(plan for plan in plans if _length(plan) <= (1.0 + ALIKE) * total)


def _length(plan: list[StagePlan]) -> float:
    return sum(stage.duration for stage in plan)
