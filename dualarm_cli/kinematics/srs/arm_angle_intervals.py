"""Feasible arm angles of a target in closed form, from the joint limits, without sampling."""

from __future__ import annotations

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class ArmAngleIntervals:
    """Arm angles at which all joints are within limits, for each target and branch.

    Along one interval the joints move continuously (whole turns apart, where a joint's range is
    more than one turn). Every end touches a limit of a joint, or is an arm angle at which a triple
    passes exactly through its singularity, where the outer joints of the branch jump by half a
    turn. Two intervals share an end where a joint whose range is exactly one turn would have to
    pass from one limit to the other. Single feasible arm angles between infeasible ones are left
    out.
    """

    start: FloatArray
    """First arm angle of each interval in [-pi, pi], ascending [rad], shape (..., 8, k).

    NaN where
    there are fewer."""
    end: FloatArray
    """Last arm angle of each interval [rad], shape (..., 8, k).

    It is within a turn of `start`.
    """
    count: IntArray
    """Number of intervals, shape (..., 8)."""
