"""Refinements of a simple method's plan as whole methods: what a user would try instead, and ours in CasADi."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from dualarm_cli.minimum_time.continuous import refine
from dualarm_cli.minimum_time.problem import SequenceProblem
from dualarm_cli.minimum_time.stops import StopTable
from dualarm_cli.minimum_time.times import Evaluated
from dualarm_cli.peers.grid import local_search
from dualarm_cli.peers.ipopt import nonlinear_program
from dualarm_cli.peers.repair import repaired
from dualarm_cli.peers.swarm import particle_swarm
from dualarm_cli.planning.method import Decided, MethodProblem
from dualarm_cli.planning.minimum_time_move import MINIMUM_TIME
from dualarm_cli.planning.sequence import solve_sequence
from dualarm_cli.planning.sequence_plans import decisions_of, stage_plans
from dualarm_cli.planning.sequence_problem import sequence_problem
from dualarm_cli.planning.stages import choose_stages

Improve = Callable[[SequenceProblem, tuple[StopTable, ...], Evaluated], Evaluated]


def solve_grid(problem: MethodProblem) -> Decided:
    """Returns the plan of the method `minimum_time`, improved by local search."""
    start = _greedy(problem, MINIMUM_TIME)

    def improve(
        numbers: SequenceProblem, tables: tuple[StopTable, ...], plan: Evaluated
    ) -> Evaluated:
        return local_search(numbers, tables, plan, problem.effort)

    return _improved(problem, start, "grid", improve)


def solve_swarm(problem: MethodProblem) -> Decided:
    """Returns the best plan of a particle swarm around the plan of the method `fixed`."""

    def improve(
        numbers: SequenceProblem, tables: tuple[StopTable, ...], plan: Evaluated
    ) -> Evaluated:
        return particle_swarm(numbers, tables, plan, problem.effort, problem.seed)

    return _improved(problem, _greedy(problem, "fixed"), "swarm", improve)


def solve_ipopt(problem: MethodProblem) -> Decided:
    """Returns IPOPT's local optimum over joints from the plan of the method `fixed`."""

    def improve(
        numbers: SequenceProblem, tables: tuple[StopTable, ...], plan: Evaluated
    ) -> Evaluated:
        return nonlinear_program(numbers, tables, plan, problem.effort)

    return _improved(problem, _greedy(problem, "fixed"), "ipopt", improve)


def solve_continuous(problem: MethodProblem) -> Decided:
    """Returns IPOPT's local optimum from the plan of the method `sequence`."""

    def improve(
        numbers: SequenceProblem, tables: tuple[StopTable, ...], plan: Evaluated
    ) -> Evaluated:
        return refine(numbers, tables, plan, problem.effort)

    return _improved(problem, solve_sequence(problem), "continuous", improve)


def _greedy(problem: MethodProblem, name: str) -> Decided:
    stages = choose_stages(
        problem.model, problem.job, name, problem.redundancy, holding=problem.holding
    )
    return Decided(stages)


def _improved(problem: MethodProblem, start: Decided, name: str, improve: Improve) -> Decided:
    """Returns a plan after an improvement of its numbers; with the start beside it, timed exactly as well."""
    model, job = problem.model, problem.job
    numbers = sequence_problem(model, job)
    tables = tuple(StopTable.of(work) for work in numbers.arms)
    plan = repaired(numbers, tables, decisions_of(numbers, model, start.stages))
    if plan is None:
        note = (
            f"{name}: the plan it starts from is too close to a joint limit; it was left as it is"
        )
        return replace(start, notes=(*start.notes, note))
    better = improve(numbers, tables, plan)
    stages = stage_plans(model, job, numbers, better.decisions, name)
    notes = start.notes
    if better.total >= plan.total:
        notes = (*notes, f"{name} found nothing faster than the plan it starts from")
    return Decided(stages, start.grid_gap, (start.stages, *start.alternatives), notes)
