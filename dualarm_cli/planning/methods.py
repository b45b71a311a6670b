"""Whole methods, from a job to its decided stages: what `--platform` names and `compare solvers` compares."""

from __future__ import annotations

from collections.abc import Callable

from dualarm_cli.planning.method import Decided, MethodProblem
from dualarm_cli.planning.minimum_time_move import MINIMUM_TIME
from dualarm_cli.planning.peer_methods import (
    solve_continuous,
    solve_grid,
    solve_ipopt,
    solve_swarm,
)
from dualarm_cli.planning.sampled import solve_sampled
from dualarm_cli.planning.sequence import solve_sequence
from dualarm_cli.planning.serving import FIXED, SAMPLED, why_unserved
from dualarm_cli.planning.stages import choose_stages
from dualarm_cli.platform_angle import PLATFORM_SOLVERS
from dualarm_cli.registry import Registry, Solver


def _needs_turntable(problem: MethodProblem) -> str | None:
    if problem.turns_for_both:
        return None
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
            name="sequence",
            solve=solve_sequence,
            summary="Platform angles and both arms' postures together over the whole cycle, by least time.",
            reference="ours: node grid, coupled dynamic programming, beam, linear steps",
            why_unsupported=_served("sequence"),
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
            summary="The plan of `sequence`, refined as one nonlinear program in CasADi by IPOPT.",
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
            name=SAMPLED,
            solve=solve_sampled,
            summary="Any arms: platform angles and sampled postures of all stages by beam search, then refined.",
            reference="ours: dynamic programming per arm as the beam's bound, coordinate descent",
            why_unsupported=_served(SAMPLED),
        ),
        Solver(
            name="grid",
            solve=solve_grid,
            summary="Peer: local search over single decisions, from the plan of `minimum_time`.",
            reference="compass search [Kolda2003]",
            why_unsupported=_served("grid"),
        ),
        Solver(
            name="swarm",
            solve=solve_swarm,
            summary="Peer: particle swarm over all continuous decisions from the plan of `fixed`.",
            reference="[Clerc2002]",
            why_unsupported=_served("swarm"),
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
