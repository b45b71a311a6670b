"""Closed-form inverse kinematics of six-axis arms with a spherical wrist."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, readonly
from dualarm_cli.geometry.elementary import TURN, angle_between, arctan2, sin
from dualarm_cli.geometry.joint_axes import SRS_TOLERANCE
from dualarm_cli.geometry.products import product
from dualarm_cli.kinematics.closed_arm import CLOSED, ClosedArm, PoseSolutions
from dualarm_cli.kinematics.platform_chain import rotation_z
from dualarm_cli.kinematics.srs import srs_limits
from dualarm_cli.kinematics.three_axes import ThreeAxes, point_miss, point_postures
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class Turns:
    """Angles about three axes, both solutions."""

    q: FloatArray
    """Angles [rad], finite everywhere, shape (..., 2, 3)."""
    possible: BoolArray
    """Flags of rotations that are possible, shape (...)."""
    aligned: BoolArray
    """Flags of a free first angle at its reference, shape (...)."""


def three_turns(R_12: FloatArray, R_23: FloatArray, M: FloatArray, reference: FloatArray) -> Turns:
    """Solve M = Rz(a) R_12 Rz(b) R_23 Rz(c) for the three angles.

    A subproblem of Paden and Kahan [Murray1994]. With alpha, beta the angles between axes 1 and 2, 2 and 3, and theta
    between 1 and 3 by M, the middle angle, counted from the nearest position of the outer axes, is phi:
    tan² (phi/2) = sin((theta + alpha - beta)/2) sin((theta - alpha + beta)/2) /
    (sin((alpha + beta + theta)/2) sin((alpha + beta - theta)/2)), from the spherical triangle of the three axes and
    exact near its ends. Solution 0 has phi >= 0, solution 1 phi <= 0. The third angle follows from the others, so that
    no digits are lost if the outer axes are nearly aligned; if they are aligned, the first angle is the reference. Our
    own derivation.

    Args:
        R_12: second frame in the first, its z the axis, shape (3, 3).
        R_23: third frame in the second, shape (3, 3).
        M: rotations, shape (..., 3, 3).
        reference: value of a free first angle [rad], broadcast against (...).
    """
    first, last = R_12[2], R_23[:, 2]  # axes 1 and 3 in frame 2, joint 2 at zero
    alpha = arctan2(np.hypot(first[0], first[1]), first[2])
    beta = arctan2(np.hypot(last[0], last[1]), last[2])
    x, y = M[..., 0, 2], M[..., 1, 2]
    sine = np.hypot(x, y)
    theta = arctan2(sine, M[..., 2, 2])
    near = sin(0.5 * (theta + alpha - beta)) * sin(0.5 * (theta - alpha + beta))
    far = sin(0.5 * (alpha + beta + theta)) * sin(0.5 * (alpha + beta - theta))
    least, most = abs(alpha - beta), min(alpha + beta, TURN - alpha - beta)
    possible = (theta >= least - CLOSED.slack) & (theta <= most + CLOSED.slack)
    phi = 2.0 * arctan2(np.sqrt(np.maximum(near, 0.0)), np.sqrt(np.maximum(far, 0.0)))
    b = np.stack([phi, -phi], axis=-1) + (arctan2(first[1], first[0]) - arctan2(last[1], last[0]))
    outer = product(R_12, rotation_z(b), last)
    aligned = sine < CLOSED.aligned
    turned = angle_between((x + 1j * y)[..., None], outer[..., 0] + 1j * outer[..., 1])
    a = np.where(aligned[..., None], np.asarray(reference)[..., None], turned)
    middle = product(rotation_z(a), R_12, rotation_z(b), R_23)
    # Rz(c) = middle^T M: its first column.
    remaining = product(np.swapaxes(middle, -1, -2), M[..., None, :, :1])
    c = arctan2(remaining[..., 1, 0], remaining[..., 0, 0])
    return Turns(np.stack([a, b, c], axis=-1), possible, aligned)


@dataclass(frozen=True)
class WristArm(ClosedArm):
    """Six-axis arm whose last three axes meet in a point.

    Branch = 4 * shoulder + 2 * elbow + wrist, each 0 or 1. Wrist is 1 where joint 5 is on the negative side of where
    axes 4 and 6 are nearest to each other. Where axes 2 and 3 are parallel, shoulder is 0 where the wrist centre is in
    front of axis 1 (on the side to which the common normal from axis 1 to axis 2 points), elbow is 1 where the forearm
    is turned clockwise about axis 2 against the upper arm. All that is continuous away from singularities. What
    shoulder and elbow are of other arms is in `point_postures`.

    A joint is free, and takes its reference, where the wrist centre is on axis 1 (joint 1) or, in an arm of equal
    links, on axis 2 (joint 2), and where axes 4 and 6 are aligned (joint 4). Where the elbow is stretched, both of its
    postures are the same.
    """

    def _problem(self) -> str:
        """Explain why the axes have no closed forms of this family, or return ''."""
        if self.wrist_gap > SRS_TOLERANCE:
            return (
                f"its last three axes miss a common point by {self.wrist_gap * 1000:.3g} mm "
                f"({SRS_TOLERANCE:g} m are allowed)"
            )
        for k in (4, 5):
            if np.hypot(*self.R_parent_joint[k][:2, 2]) < CLOSED.least_angle:
                return f"axes {k} and {k + 1} are parallel"
        if self.shoulder.family is None:
            return (
                "its first three axes do not carry the wrist through a volume, or the first two nearly meet or "
                "are nearly parallel"
            )
        return ""

    @cached_property
    def _wrist(self) -> tuple[FloatArray, FloatArray]:
        """Wrist centre in frame 3 and the flange frame [m], each (3,)."""
        R, p, _, origin = self._chain(np.zeros((1, 6)))
        center = self.meeting_point
        x = np.eye(3)
        for k in range(3):
            x = product(x, self.R_parent_joint[k])
        return readonly(product(x.T, center - origin[:, 2, 0])), readonly(
            product(R[0].T, center - p[0])
        )

    @cached_property
    def shoulder(self) -> ThreeAxes:
        """First three axes with the wrist centre that they carry."""
        return ThreeAxes.of(self.R_parent_joint[:3], self.p_parent_joint[:3], self._wrist[0])

    @property
    def facts(self) -> Mapping[str, Any]:
        """Solver, branches and family of the first three axes, as `dualarm robot` has them."""
        return {**super().facts, "shoulder": self.shoulder.family or ""}

    @cached_property
    def exact(self) -> bool:
        """Flag of closed forms that need no polish."""
        return max(self.wrist_gap, self.shoulder.neglected) < CLOSED.exact

    def wrist_center(self, R: FloatArray, p: FloatArray) -> FloatArray:
        """Compute the wrist centre [m], shape (..., 3), of flange poses."""
        center: FloatArray = p + product(R, self._wrist[1])
        return center

    fixed_point = wrist_center

    @property
    def lever(self) -> float:
        """Distance of `fixed_point` from the point that `reach_miss` examines: none [m]."""
        return 0.0

    def _postures(self, R: FloatArray, p: FloatArray, reference: FloatArray) -> PoseSolutions:
        """Compute all branches before polishing; out of reach joints are arbitrary."""
        first = point_postures(self.shoulder, self.wrist_center(R, p), reference[:, :3])
        frame = product(self.R_parent_joint[0], rotation_z(first.q[..., 0]))
        for k in (1, 2):
            frame = product(frame, self.R_parent_joint[k], rotation_z(first.q[..., k]))
        left = np.swapaxes(product(frame, self.R_parent_joint[3]), -1, -2)
        M = product(left, product(R, self.R_last_flange.T)[:, None])
        last = three_turns(self.R_parent_joint[4], self.R_parent_joint[5], M, reference[:, 3:4])
        q = np.empty((len(p), 4, 2, 6))
        q[..., :3], q[..., 3:] = first.q[:, :, None], srs_limits.wrap(last.q)
        return PoseSolutions(
            q.reshape(-1, CLOSED.branches, 6),
            np.repeat(first.reachable & last.possible, 2, axis=1),
            np.repeat(first.singular | last.aligned, 2, axis=1),
        )

    def reach_miss(self, R: FloatArray, p: FloatArray) -> FloatArray:
        """Compute the wrist centre's distance beyond reach [m], shape (...), 0 within.

        Joints 2 and 3 are within limits, joint 1 is free, and every rotation counts as possible.

        Args:
            R: flange rotations in the frame that carries the arm, shape (..., 3, 3).
            p: flange positions [m], shape (..., 3).
        """
        center = self.wrist_center(np.asarray(R, dtype=np.float64), np.asarray(p))
        flat = center.reshape(-1, 3)
        first = point_postures(self.shoulder, flat, np.broadcast_to(self.middle[:3], flat.shape))
        fits = first.reachable.copy()
        for k in (1, 2):
            fits &= srs_limits.some_turn_within(
                first.q[..., k], float(self.lower[k]), float(self.upper[k])
            )
        miss = np.zeros(len(flat))
        out = ~fits.any(axis=1)
        if out.any():
            miss[out] = point_miss(self.shoulder, flat[out], self.lower[1:3], self.upper[1:3])
        return miss.reshape(center.shape[:-1])

    def _miss(self, R: FloatArray, p: FloatArray) -> FloatArray:
        """Compute the miss of poses without posture, distance [m] and angle [rad], (m, 2).

        Out of reach: the distance beyond it. Within reach: the miss of the best branch with joints clipped to limits.
        """
        solutions = self.solve(R, p)
        miss = self._clipped_miss(
            self.nearest_turns(solutions.q, self.middle), solutions.reachable, R, p
        )
        out = self.reach_miss(R, p)
        return np.where(out[:, None] > 0.0, np.stack([out, np.zeros_like(out)], axis=1), miss)
