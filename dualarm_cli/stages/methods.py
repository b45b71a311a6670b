"""Registry of planning methods, as named by `--platform` and compared by `compare solvers`."""

from __future__ import annotations

from collections.abc import Callable

from dualarm_cli.platform_angle import PLATFORM_SOLVERS
from dualarm_cli.registry import Registry, Solver
from dualarm_cli.stages.method import Decided, MethodProblem
from dualarm_cli.stages.minimum_time_move import MINIMUM_TIME
from dualarm_cli.stages.sequence import solve_sequence
from dualarm_cli.stages.serving import FIXED, SEQUENCE, why_unserved
from dualarm_cli.stages.stage_by_stage import choose_stages


def _needs_turntable(problem: MethodProblem) -> str | None:
    if problem.turns_for_both:
        return None
    if problem.model.platform.is_rail:
        return (
            "its platform slides, and [Bottin2021] balances the elbows of arms on a turning one; the platform methods "
            f"{SEQUENCE}, {MINIMUM_TIME} and {FIXED} plan it"
        )
    return "it is not two arms on one turning platform"


def _served(
    name: str, method_reason: Callable[[MethodProblem], str | None] = lambda _: None
) -> Callable[[MethodProblem], str | None]:
    """Explain why a robot does not support a method with its redundancy solver.

    None if supported.
    """

    def why(problem: MethodProblem) -> str | None:
        robot = problem.job.cell.robot
        return why_unserved(name, problem.redundancy, robot) or method_reason(problem)

    return why


def _greedy(platform: str) -> Callable[[MethodProblem], Decided]:
    def solve(problem: MethodProblem) -> Decided:
        return Decided(choose_stages(problem, platform))

    return solve


METHODS: Registry[Solver[MethodProblem, Decided]] = Registry(
    "method",
    "platform",
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
    ],
)
