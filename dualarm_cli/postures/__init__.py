"""Redundancy solvers: the posture of an arm at a stop."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from dualarm_cli.postures.arm_angle import choose_posture, choose_postures
from dualarm_cli.postures.numeric import choose_numeric
from dualarm_cli.postures.problem import NoPosture, StopPosture, StopProblem
from dualarm_cli.registry import Registry, Solver


def _needs_closed_form(problem: StopProblem) -> str | None:
    if problem.arm.has_arm_angle:
        return None
    return "the arm has no arm angle (it is not spherical-revolute-spherical)"


def _needs_general_arm(problem: StopProblem) -> str | None:
    if problem.arm.has_arm_angle:
        return "the arm is modelled in closed form; the numeric solver needs it modelled as a general arm"
    return None


REDUNDANCY_SOLVERS: Registry[Solver[StopProblem, StopPosture | NoPosture]] = Registry(
    "redundancy",
    "redundancy",
    [
        Solver(
            name="arm_angle",
            solve=choose_posture,
            summary="Closed form over branches and arm angle; the posture of least stage time.",
            reference="[Shimizu2008]; choice by closed-form move time: ours",
            why_unsupported=_needs_closed_form,
        ),
        Solver(
            name="numeric",
            solve=choose_numeric,
            summary="Any arm of six joints or more: damped least squares from many starts, self-motion, continuation.",
            reference="[Sugihara2011]; branches, lines and choice: ours",
            why_unsupported=_needs_general_arm,
        ),
    ],
)

BATCH_FORMS: Mapping[str, Callable[[Sequence[StopProblem]], list[StopPosture | NoPosture]]] = {
    "arm_angle": choose_postures,
}
"""Batch solvers by name of the redundancy solver."""


def solve_stops(name: str, problems: Sequence[StopProblem]) -> list[StopPosture | NoPosture]:
    """Solve many stops by one redundancy solver, in batches if it has a batch form.

    Args:
        name: of the solver.
        problems: of any arms.

    Raises:
        UnknownSolverError: no redundancy solver has this name.
    """
    solver = REDUNDANCY_SOLVERS[name]
    if name in BATCH_FORMS:
        return BATCH_FORMS[name](problems)
    return [solver.solve(problem) for problem in problems]


__all__ = ["REDUNDANCY_SOLVERS", "NoPosture", "StopPosture", "StopProblem", "solve_stops"]
