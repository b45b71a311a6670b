"""Whole methods, from a job to its decided stages: what `--platform` names and `compare solvers` compares."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from dualarm_cli.platform_angle import PLATFORM_SOLVERS
from dualarm_cli.registry import Registry, Solver
from dualarm_cli.stages.method import Decided, MethodProblem
from dualarm_cli.stages.minimum_time_move import MINIMUM_TIME
from dualarm_cli.stages.peers.continuous import refine
from dualarm_cli.stages.peers.feasible_start import repaired
from dualarm_cli.stages.peers.ipopt import nonlinear_program
from dualarm_cli.stages.plans.problem import SequenceProblem
from dualarm_cli.stages.plans.stops import StopTable
from dualarm_cli.stages.plans.times import Evaluated
from dualarm_cli.stages.sequence import decisions_of, solve_sequence, stage_plans
from dualarm_cli.stages.sequence_problem import sequence_problem
from dualarm_cli.stages.serving import FIXED, SEQUENCE, why_unserved
from dualarm_cli.stages.stage_by_stage import choose_stages

Improve = Callable[[SequenceProblem, tuple[StopTable, ...], Evaluated], Evaluated]


def solve_ipopt(problem: MethodProblem) -> Decided:
    """Returns IPOPT's local optimum over joints from the plan of the method `fixed`."""

    def improve(
        numbers: SequenceProblem, tables: tuple[StopTable, ...], plan: Evaluated
    ) -> Evaluated:
        return nonlinear_program(numbers, tables, plan, problem.effort)

    return _improved(problem, _greedy_start(problem, "fixed"), "ipopt", improve)


def solve_continuous(problem: MethodProblem) -> Decided:
    """Returns IPOPT's local optimum from the plan of the method `sequence`."""

    def improve(
        numbers: SequenceProblem, tables: tuple[StopTable, ...], plan: Evaluated
    ) -> Evaluated:
        return refine(numbers, tables, plan, problem.effort)

    return _improved(problem, solve_sequence(problem), "continuous", improve)


def _greedy_start(problem: MethodProblem, name: str) -> Decided:
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
        note = f"{name}: the initial plan is too close to a joint limit and was kept"
        return replace(start, notes=(*start.notes, note))
    better = improve(numbers, tables, plan)
    stages = stage_plans(model, job, numbers, better.decisions, name)
    notes = start.notes
    if better.total >= plan.total:
        notes = (*notes, f"{name} found nothing faster than the initial plan")
    return Decided(stages, start.grid_gap, (start.stages, *start.alternatives), notes)


def _needs_turntable(problem: MethodProblem) -> str | None:
    if problem.turns_for_both:
        return None
    if problem.model.platform.is_rail:
        return (
            "its platform slides, and [Bottin2021] balances the elbows of arms on a turning one; --platform "
            f"{SEQUENCE}, {MINIMUM_TIME} and {FIXED} plan it"
        )
    return "it is not two arms on one turning platform"


def _served(
    name: str, own: Callable[[MethodProblem], str | None] = lambda _: None
) -> Callable[[MethodProblem], str | None]:
    """Returns why a method does not serve a problem: by itself, or together with its redundancy solver."""

    def why(problem: MethodProblem) -> str | None:
        robot = problem.job.cell.robot
        return why_unserved(name, problem.redundancy, robot) or own(problem)

    return why


def _greedy(platform: str) -> Callable[[MethodProblem], Decided]:
    def solve(problem: MethodProblem) -> Decided:
        stages = choose_stages(
            problem.model, problem.job, platform, problem.redundancy, holding=problem.holding
        )
        return Decided(stages)

    return solve


METHODS: Registry[Solver[MethodProblem, Decided]] = Registry(
    "method",
    "--platform (compare: --method)",
    [
        Solver(
            name=SEQUENCE,
            solve=solve_sequence,
            summary="Platform angles and both arms' postures together over the whole cycle, by least time.",
            reference="ours: node grid, coupled dynamic programming, beam, linear steps",
            why_unsupported=_served(SEQUENCE),
        ),
        Solver(
            name=MINIMUM_TIME,
            solve=_greedy(MINIMUM_TIME),
            summary="Stage by stage: the platform angle and postures of least time for this stage alone.",
            reference="ours",
            why_unsupported=_served(MINIMUM_TIME),
        ),
        Solver(
            name="continuous",
            solve=solve_continuous,
            summary="The plan of `sequence`, refined as one nonlinear program by CasADi and IPOPT.",
            reference="ours; IPOPT [Waechter2006]",
            why_unsupported=_served("continuous"),
        ),
        *(
            Solver(
                name=solver.name,
                solve=_greedy(solver.name),
                summary=f"Stage by stage: {solver.summary[0].lower()}{solver.summary[1:]}",
                reference=solver.reference,
                why_unsupported=_served(solver.name)
                if solver.name == FIXED
                else _served(solver.name, _needs_turntable),
            )
            for solver in PLATFORM_SOLVERS
        ),
        Solver(
            name="ipopt",
            solve=solve_ipopt,
            summary="Peer: one nonlinear program over all joints by IPOPT, from the plan of `fixed`.",
            reference="IPOPT [Waechter2006]",
            why_unsupported=_served("ipopt"),
        ),
    ],
)
