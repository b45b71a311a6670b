"""Seam solvers: joints of both arms along a curve on a held part.

One arm works along the curve, the other holds the part.
"""

from __future__ import annotations

from dualarm_cli.kinds.seam.closed_chain.problem import NoSeam, SeamMotion, SeamProblem
from dualarm_cli.kinds.seam.closed_chain.solvers import (
    solve_least_motion,
    solve_moving,
    solve_still,
)
from dualarm_cli.registry import Registry, Solver


def _needs_freedom(problem: SeamProblem) -> str | None:
    if problem.chain.work.hold.given and problem.chain.work.master is not None:
        return "the file gives the pose of the part"
    if problem.chain.work.hold.still:
        return "the file has the part stand still"
    return None


SEAM_SOLVERS: Registry[Solver[SeamProblem, SeamMotion | NoSeam]] = Registry(
    "seam solver",
    "method:",
    [
        Solver(
            name="moving",
            solve=solve_moving,
            summary="Part and tool move together, as fast as the joints allow; "
            "the part rests where that is fast enough.",
            reference="closed chain: [Qin2024] Eq. 2-6, 18, 19; choice by sequential quadratic programming: ours",
            why_unsupported=_needs_freedom,
        ),
        Solver(
            name="still",
            solve=solve_still,
            summary="Best still pose of the part, with arm angles and spin; or the part as the file has it.",
            reference="closed chain: [Qin2024]; choice by sequential quadratic programming: ours",
        ),
        Solver(
            name="least_motion",
            solve=solve_least_motion,
            summary="Inverse kinematics along the seam by steps of least norm, the quickest of many starts.",
            reference="[Qin2024] section 3.5",
        ),
    ],
)

__all__ = ["SEAM_SOLVERS", "NoSeam", "SeamMotion", "SeamProblem"]
