"""Path followers: redundancy resolution for tools on given paths."""

from __future__ import annotations

from dualarm_cli.kinds.path.following.acceleration import (
    follow_manipulability,
    follow_min_acceleration,
)
from dualarm_cli.kinds.path.following.arm_angle import follow_arm_angle
from dualarm_cli.kinds.path.following.problem import NoPath, PathMotion, PathProblem
from dualarm_cli.kinds.path.following.velocity import (
    follow_min_norm,
    follow_spring,
    follow_spring_damped,
)
from dualarm_cli.registry import Registry, Solver


def _needs_closed_form(problem: PathProblem) -> str | None:
    if problem.model is not None:
        return None
    return "its arms are not spherical-revolute-spherical"


PATH_SOLVERS: Registry[Solver[PathProblem, PathMotion | NoPath]] = Registry(
    "path follower",
    "redundancy",
    [
        Solver(
            name="arm_angle",
            solve=follow_arm_angle,
            summary="Platform at rest; branch and arm angles of least joint motion over the whole path.",
            reference="[Shimizu2008]; choice by dynamic programming: ours",
            why_unsupported=_needs_closed_form,
        ),
        Solver(
            name="virtual_spring",
            solve=follow_spring,
            summary="Whole body; springs pull the elbows to critical points by an exact null-space projector.",
            reference="[Choi2020] Eq. 1-35; exact projector and correction: ours",
        ),
        Solver(
            name="virtual_spring_damped",
            solve=follow_spring_damped,
            summary="The same as printed in the paper: damped projector, no "
            "correction; the tools follow only approximately.",
            reference="[Choi2020] Eq. 1-35",
        ),
        Solver(
            name="manipulability",
            solve=follow_manipulability,
            summary="Whole body; accelerations within all limits by a quadratic program, towards manipulability.",
            reference="[Zhang2024] Eq. 24, signs, gradient and bounds corrected",
        ),
        Solver(
            name="min_acceleration",
            solve=follow_min_acceleration,
            summary="Whole body; least accelerations within all limits: the reference for manipulability.",
            reference="[Zhang2024] Eq. 9 and 24",
        ),
        Solver(
            name="min_norm",
            solve=follow_min_norm,
            summary="Whole body; least joint speeds by damped least squares, tools corrected.",
            reference="[Choi2020] Eq. 3; [Zhang2024] Eq. 8",
        ),
    ],
)

__all__ = ["PATH_SOLVERS", "NoPath", "PathMotion", "PathProblem"]
