"""A plan that is shorter than a known one: the search begun again from it, with wider limits of position.

A plan whose joints keep away from their limits, so that tools can pass lines' ends in motion, is often not the shortest
one: what the room costs may be more than what it gains. Our own.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.effort import SHORT
from dualarm_cli.stages.plans.problem import Decisions, SequenceProblem
from dualarm_cli.stages.plans.stops import StopTable
from dualarm_cli.stages.plans.times import Evaluated, evaluate
from dualarm_cli.stages.search.corridor import best_combination
from dualarm_cli.stages.search.node_plans import plans_on_nodes
from dualarm_cli.stages.search.search import (
    best_of_each_kind,
    combination,
    polished_in_motion,
    polished_thoroughly,
    search_effort,
    with_best_ways,
)

CYCLES = 2
"""Rounds of polishing in motion."""
SHORTER = 1e-3
"""Share of the known plan's length by which another one has to be shorter, as both are estimates."""


def search_again(
    problem: SequenceProblem, given: Decisions, grid_total: float | None, effort: str, seed: int
) -> Evaluated | None:
    """Search for a plan that is estimated to be shorter than a given one.

    A short sequence's plan is combined with those of one grid, unless the grid has nothing new. The better one is
    polished with the ways of passing lines' ends that go best with it.

    Args:
        problem: the sequence.
        given: a plan for it, found with narrower limits of position.
        grid_total: length of the best plan on the first grid with these [s]; None where it is not known.
        effort: one of EFFORTS.
        seed: of the random steps of polishing.

    Returns:
        The plan in times with stops, None where none is shorter.
    """
    how, at_rest = search_effort(problem, effort), replace(problem, ways=None)
    tables = tuple(StopTable.of(work) for work in problem.arms)
    known = evaluate(at_rest, tables, given)
    tried = [known]
    if problem.stages <= SHORT:
        made = plans_on_nodes(at_rest, tables, how.meshes[0], how.plans).plans
        pool = [plan for _, plan in made if np.isfinite(plan.total)]
        if pool and made[0][0].total != grid_total:
            best, _ = combination(
                at_rest, tables, best_of_each_kind(at_rest, [known, *pool]), how, seed
            )
            if how.cycles > 1:
                # Beside a polished plan, what is on nodes seems too long to be polished.
                pool = best_of_each_kind(at_rest, pool)
                other, others = combination(at_rest, tables, pool, how, seed)
                decisions = [plan.decisions for plan in (other, *others)]
                best = best_combination(at_rest, tables, best, decisions)
            tried.append(best)

    def length(plan: Evaluated) -> float:
        if problem.ways is None:
            return plan.total
        return with_best_ways(problem, tables, plan)[1].total

    lengths = [length(plan) for plan in tried]
    best = tried[int(np.argmin(lengths))]
    if best is not known or problem.ways is None:
        best = polished_thoroughly(problem, tables, best, replace(how, cycles=1), seed)
    if problem.ways is not None:
        cycles = range(how.cycles, how.cycles + CYCLES)
        [best] = polished_in_motion(problem, tables, how, seed, None, cycles, [best])
    return best if length(best) < (1.0 - SHORTER) * lengths[0] else None
