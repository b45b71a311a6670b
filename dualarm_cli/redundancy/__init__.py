"""The redundancy family: which posture, of the many that reach a target, an arm takes."""

from __future__ import annotations

from dualarm_cli.redundancy.arm_angle import choose_posture
from dualarm_cli.redundancy.problem import NoPosture, StopPosture, StopProblem
from dualarm_cli.registry import Registry, Solver

REDUNDANCY_SOLVERS: Registry[Solver[StopProblem, StopPosture | NoPosture]] = Registry(
    "redundancy",
    [
        Solver(
            name="arm_angle",
            solve=choose_posture,
            summary="Closed form over branches and arm angle; the posture of least stage time.",
            reference="[Shimizu2008]; choice by closed-form move time: ours",
        ),
    ],
)

__all__ = ["REDUNDANCY_SOLVERS", "NoPosture", "StopPosture", "StopProblem"]
