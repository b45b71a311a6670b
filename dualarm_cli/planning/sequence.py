"""The method `sequence`: everything together over the whole cycle, from every simpler method's plan."""

from __future__ import annotations

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.minimum_time.search import search
from dualarm_cli.planning.method import Decided, MethodProblem
from dualarm_cli.planning.sequence_plans import decisions_of, stage_plans
from dualarm_cli.planning.sequence_problem import sequence_problem
from dualarm_cli.planning.stages import StagePlan, choose_stages

ALIKE = 0.08
"""A simpler method's plan that is estimated to be slower by less than this share is timed exactly as well: estimates of
lines are a few percent off, and a third of a cycle is lines."""


def solve_sequence(problem: MethodProblem) -> Decided:
    """Returns the plan of the search over the whole sequence, and simpler ones that may turn out to be as fast.

    Raises:
        InfeasibleError: no method finds a plan; the reason of the first one.
    """
    model, job = problem.model, problem.job
    numbers = sequence_problem(model, job)
    starts: dict[str, list[StagePlan]] = {}
    failure: InfeasibleError | None = None
    for name in problem.simpler:
        try:
            starts[name] = choose_stages(model, job, name, problem.redundancy)
        except InfeasibleError as error:
            failure = failure or error
    decisions = [decisions_of(numbers, model, stages) for stages in starts.values()]
    found = search(numbers, decisions, problem.effort, problem.seed)
    if found is None:
        raise failure or InfeasibleError("no plan was found on the grid of nodes")
    stages = stage_plans(model, job, numbers, found.best.decisions, "sequence")
    gap = None
    if found.grid_total is not None and found.grid_bound is not None and found.grid_total > 0:
        gap = max(0.0, 1.0 - found.grid_bound / found.grid_total)
    near = (1.0 + ALIKE) * found.best.total
    alternatives = [
        plan for plan in starts.values() if sum(stage.duration for stage in plan) <= near
    ]
    return Decided(stages, gap, tuple(alternatives))
