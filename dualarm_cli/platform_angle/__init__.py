"""Solvers of the platform angle of one move."""

from __future__ import annotations

from dualarm_cli.platform_angle.exact import solve_exact
from dualarm_cli.platform_angle.linearised import solve_linearised
from dualarm_cli.platform_angle.problem import Kind, PlatformProblem, elbow_angles
from dualarm_cli.platform_angle.solution import PlatformSolution, solve_fixed
from dualarm_cli.registry import Registry, Solver

PLATFORM_SOLVERS: Registry[Solver[PlatformProblem, PlatformSolution]] = Registry(
    "platform",
    "platform",
    [
        Solver(
            name="fixed",
            solve=solve_fixed,
            summary="The platform does not turn.",
            reference="baseline",
        ),
        Solver(
            name="exact",
            solve=solve_exact,
            summary="Exactly equal elbow displacements: roots of a quartic, otherwise stationary points.",
            reference="ours, after [Bottin2021] Eq. 3",
        ),
        Solver(
            name="linearised",
            solve=solve_linearised,
            summary="Equal elbow displacements, with the arccosine to first order.",
            reference="[Bottin2021] Eq. 14 and 15",
        ),
    ],
)

__all__ = ["PLATFORM_SOLVERS", "Kind", "PlatformProblem", "PlatformSolution", "elbow_angles"]
