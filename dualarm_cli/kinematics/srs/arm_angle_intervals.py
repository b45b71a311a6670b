"""Feasible arm angles of a target in closed form, from the joint limits, without sampling."""

from __future__ import annotations

import numpy as np

from dualarm_cli.compiled import srs as compiled
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.kinematics.srs.srs_arm import SrsArm
from dualarm_cli.kinematics.srs.srs_limits import TURN
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
    """First arm angle of each interval in [-pi, pi], ascending [rad], shape (..., 8, k); NaN where
    there are fewer."""
    end: FloatArray
    """Last arm angle, greater than `start` by at most a full turn [rad], shape (..., 8, k)."""
    count: IntArray
    """Number of intervals, shape (..., 8)."""

    def contains(self, psi: FloatArray) -> BoolArray:
        """Returns whether each branch holds arm angles, shape (..., 8).

        Args:
            psi: arm angles [rad], broadcast against (...).
        """
        turned = np.mod(np.asarray(psi)[..., None, None] - self.start, TURN)
        return np.asarray((turned <= self.end - self.start).any(axis=-1))


def feasible_arm_angles(arm: SrsArm, R: FloatArray, p: FloatArray) -> ArmAngleIntervals:
    """Returns the arm angles at which all joints of a branch are within limits.

    Where joint i meets a limit L, one equation A sin psi + B cos psi + C = 0 holds: for joints 1,
    3, 5, 7 num(psi) cos L - den(psi) sin L = 0, for joints 2 and 6 cos theta(psi) = cos(L +
    offset); all eight branches share them. Their roots cut the circle into arcs on each of which
    every joint is either within or beyond its limits: the midpoint decides exactly. [Shimizu2008]
    has the idea; arcs instead of case distinctions, whole turns and exact singularities are our
    own.

    Args:
        arm: the arm and its limits.
        R: flange rotations in the base frame, shape (..., 3, 3).
        p: flange positions in the base frame [m], shape (..., 3), broadcast against R.
    """
    shape = np.broadcast_shapes(np.shape(R)[:-2], np.shape(p)[:-1])
    poses = np.broadcast_to(R, (*shape, 3, 3)), np.broadcast_to(p, (*shape, 3))
    start, end, count = compiled.arm_angle_intervals(
        arm.numbers, poses[0].reshape(-1, 3, 3), poses[1].reshape(-1, 3)
    )
    return ArmAngleIntervals(
        start.reshape(*shape, *start.shape[1:]),
        end.reshape(*shape, *end.shape[1:]),
        count.reshape(*shape, 8),
    )
