"""Timing solvers: time laws of transfers and lines."""

from __future__ import annotations

from collections.abc import Callable

from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.records import dataclass
from dualarm_cli.registry import Registry
from dualarm_cli.timing import double_s, line_profile, ruckig_, toppra_
from dualarm_cli.timing.problem import (
    LineProblem,
    TransferProblem,
    why_jerk_limits_unsupported,
)


def _supports_all(_: JointLimits) -> str | None:
    return None


@dataclass(frozen=True)
class TimingSolver:
    """Timing method: a transfer solver and a line solver."""

    name: str
    """Name on the command line and in files."""
    transfer: Callable[[TransferProblem], Trajectory]
    """Solver of transfers from rest to rest."""
    line: Callable[[LineProblem], Trajectory]
    """Solver of lines along a given path."""
    summary: str
    """Method in one sentence."""
    reference: str
    """Paper and equation, or `ours`."""
    why_unsupported: Callable[[JointLimits], str | None] = _supports_all
    """Check of limits: the reason why they are not supported, or None."""


TIMING_SOLVERS: Registry[TimingSolver] = Registry(
    "timing",
    "timing",
    [
        TimingSolver(
            name="ruckig",
            transfer=ruckig_.solve_transfer,
            line=line_profile.solve_line,
            summary="Jerk-limited: transfers by ruckig, lines by the fastest double-S profile.",
            reference="[Berscheid2021]; line profiles: ours",
        ),
        TimingSolver(
            name="toppra",
            transfer=ruckig_.solve_transfer,
            line=toppra_.solve_line,
            summary="Lines time-optimal under velocity and acceleration limits, by toppra.",
            reference="[Pham2018]",
            why_unsupported=why_jerk_limits_unsupported,
        ),
        TimingSolver(
            name="trapezoid",
            transfer=double_s.solve_transfer,
            line=line_profile.solve_line,
            summary="Transfers by synchronised trapezoids in closed form.",
            reference="[Biagiotti2008] §3.2",
            why_unsupported=why_jerk_limits_unsupported,
        ),
    ],
)

__all__ = ["TIMING_SOLVERS", "LineProblem", "TimingSolver", "TransferProblem"]
