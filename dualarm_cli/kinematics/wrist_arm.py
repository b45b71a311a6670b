"""Closed-form inverse kinematics of six-axis arms whose last three axes meet in a point."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from dualarm_cli.errors import UnsupportedError
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray, readonly
from dualarm_cli.kinematics.general_arm import GeneralArm, ReachedPostures, pose_error
from dualarm_cli.kinematics.numeric_inverse import RESIDUAL, polished
from dualarm_cli.kinematics.platform_chain import rotation_z
from dualarm_cli.kinematics.srs import srs_limits
from dualarm_cli.kinematics.three_axes import ThreeAxes, point_miss, point_postures

ALIGNED = 1e-12
"""Sine of the angle of the outer axes below which only the sum or difference of their turns counts."""
SLACK = 1e-12
"""How far an angle may pass what the axes allow, by rounding [rad]."""


@dataclass(frozen=True)
class Turns:
    """Turns about three axes."""

    q: FloatArray
    """Angles [rad], finite everywhere, shape (..., 2, 3)."""
    possible: BoolArray
    """Whether the rotation can be made, shape (...)."""
    aligned: BoolArray
    """Whether the first angle is free and took its reference, shape (...)."""


def three_turns(R_12: FloatArray, R_23: FloatArray, M: FloatArray, reference: FloatArray) -> Turns:
    """Returns the angles of M = Rz(a) R_12 Rz(b) R_23 Rz(c), as the subproblems of Paden and Kahan do [Murray1994].

    With alpha, beta the angles of the axes 1 to 2 and 2 to 3, and theta from 1 to 3 as M has it, the middle angle
    counted from where the outer axes are nearest is phi, half of it
    tan² (phi/2) = sin((theta + alpha - beta)/2) sin((theta - alpha + beta)/2) /
    (sin((alpha + beta + theta)/2) sin((alpha + beta - theta)/2)): the spherical triangle of the three axes, exact near
    its ends. Way 0 has phi >= 0, way 1 phi <= 0. The third angle is what is left, so that nothing is lost where the
    outer axes are nearly aligned; where they are, the first angle is the reference. Our own derivation.

    Args:
        R_12: second frame in the first, its z the axis, shape (3, 3).
        R_23: third frame in the second, shape (3, 3).
        M: rotations, shape (..., 3, 3).
        reference: first angle where it is free [rad], broadcast against (...).
    """
    first, last = R_12[2], R_23[:, 2]  # axes 1 and 3 in frame 2, joint 2 at zero
    alpha = np.arctan2(np.hypot(first[0], first[1]), first[2])
    beta = np.arctan2(np.hypot(last[0], last[1]), last[2])
    x, y = M[..., 0, 2], M[..., 1, 2]
    sine = np.hypot(x, y)
    theta = np.arctan2(sine, M[..., 2, 2])
    near = np.sin(0.5 * (theta + alpha - beta)) * np.sin(0.5 * (theta - alpha + beta))
    far = np.sin(0.5 * (alpha + beta + theta)) * np.sin(0.5 * (alpha + beta - theta))
    least, most = abs(alpha - beta), min(alpha + beta, 2.0 * np.pi - alpha - beta)
    possible = (theta >= least - SLACK) & (theta <= most + SLACK)
    phi = 2.0 * np.arctan2(np.sqrt(np.maximum(near, 0.0)), np.sqrt(np.maximum(far, 0.0)))
    b = np.stack([phi, -phi], axis=-1) + (
        np.arctan2(first[1], first[0]) - np.arctan2(last[1], last[0])
    )
    outer = R_12 @ rotation_z(b) @ last
    aligned = sine < ALIGNED
    turned = (x + 1j * y)[..., None] * (outer[..., 0] - 1j * outer[..., 1])
    a = np.where(aligned[..., None], np.asarray(reference)[..., None], np.angle(turned))
    middle = rotation_z(a) @ R_12 @ rotation_z(b) @ R_23
    # Rz(c) = middle^T M: its first column.
    left = np.swapaxes(middle, -1, -2) @ M[..., None, :, :1]
    c = np.arctan2(left[..., 1, 0], left[..., 0, 0])
    return Turns(np.stack([a, b, c], axis=-1), possible, aligned)


WRIST_TOLERANCE = 1e-6
"""Largest distance of the last three axes from a common point that closed forms start from [m]."""
LEAST_ANGLE = 1e-6
"""Least sine of the angle of neighbouring wrist axes."""
EXACT = 1e-12
"""A geometry within this of its family needs no polish [m and rad]; what is polished comes nearer than this."""
SPREAD = 8
"""Postures that stand for all where axes 4 and 6 are aligned."""


@dataclass(frozen=True)
class WristSolutions:
    """All postures of many flange poses."""

    q: FloatArray
    """Joints [rad] in (-pi, pi], shape (..., 8, 6); zeros where there is none."""
    reachable: BoolArray
    """Which branches reach the pose, joint limits apart, shape (..., 8)."""
    singular: BoolArray
    """Where a joint is free and took its reference: the wrist centre on axis 1 (joint 1) or, in an arm of equal links,
    on axis 2 (joint 2), axes 4 and 6 aligned (joint 4), shape (..., 8)."""


@dataclass(frozen=True)
class WristArm(GeneralArm):
    """A GeneralArm of six axes, the last three of which meet in a point: every pose has up to eight postures.

    Branch = 4 * shoulder + 2 * elbow + wrist, each 0 or 1. Wrist is 1 where joint 5 is on the negative side of where
    axes 4 and 6 are nearest to each other. Where axes 2 and 3 are parallel, shoulder is 0 where the wrist centre is in
    front of axis 1 (on the side to which the common normal from axis 1 to axis 2 points), elbow is 1 where the forearm
    is turned clockwise about axis 2 against the upper arm. All that is continuous away from singularities. What
    shoulder and elbow are of other arms is in `point_postures`.

    Where a joint is free (see `WristSolutions.singular`) it takes its reference; where the elbow is stretched, both of
    its postures are the same.
    """

    def __post_init__(self) -> None:
        """Freezes the arrays.

        Raises:
            UnsupportedError: the arm does not have six axes, or not these.
        """
        super().__post_init__()
        problem = self._problem()
        if problem:
            raise UnsupportedError(
                f"there are no closed forms for this arm: {problem}; use numeric inverse kinematics"
            )

    @classmethod
    def of(cls, arm: GeneralArm) -> WristArm:
        """Returns an arm with closed forms.

        Args:
            arm: of six axes with a spherical wrist.

        Raises:
            UnsupportedError: it is another one.
        """
        return cls(*(getattr(arm, field.name) for field in fields(GeneralArm)))

    def _problem(self) -> str:
        """Returns why there are no closed forms, or nothing."""
        if self.axes != 6:
            return f"it has {self.axes} axes instead of 6"
        if self.wrist_gap > WRIST_TOLERANCE:
            return (
                f"its last three axes miss a common point by {self.wrist_gap * 1000:.3g} mm "
                f"({WRIST_TOLERANCE:g} m are allowed)"
            )
        for k in (4, 5):
            if np.hypot(*self.R_parent_joint[k][:2, 2]) < LEAST_ANGLE:
                return f"axes {k} and {k + 1} are parallel"
        if self.shoulder.family is None:
            return (
                "its first three axes do not carry the wrist through a volume, or the first two nearly meet or "
                "are nearly parallel"
            )
        return ""

    @cached_property
    def _wrist(self) -> tuple[FloatArray, FloatArray]:
        """The wrist centre in frame 3 and in the flange frame [m], each of shape (3,)."""
        R, p, _, origin = self._chain(np.zeros((1, 6)))
        center = self.meeting_point
        x = np.eye(3)
        for k in range(3):
            x = x @ self.R_parent_joint[k]
        return readonly(x.T @ (center - origin[:, 2, 0])), readonly(R[0].T @ (center - p[0]))

    @cached_property
    def shoulder(self) -> ThreeAxes:
        """The first three axes and the wrist centre that they carry."""
        return ThreeAxes.of(self.R_parent_joint[:3], self.p_parent_joint[:3], self._wrist[0])

    @cached_property
    def exact(self) -> bool:
        """Whether the closed forms need no polish."""
        return max(self.wrist_gap, self.shoulder.neglected) < EXACT

    def wrist_center(self, R: FloatArray, p: FloatArray) -> FloatArray:
        """Returns the wrist centre [m], shape (..., 3), of flange poses (..., 3, 3), (..., 3)."""
        center: FloatArray = p + R @ self._wrist[1]
        return center

    def solve(
        self, R: FloatArray, p: FloatArray, reference: FloatArray | None = None
    ) -> WristSolutions:
        """Returns all eight branches.

        Args:
            R: flange rotations in the frame that carries the arm, shape (..., 3, 3).
            p: flange positions [m], shape (..., 3), broadcast against R.
            reference: joints where one is free [rad], shape (..., 6), broadcast with the poses; the middle of the
                limits without.
        """
        R, p = np.asarray(R, dtype=np.float64), np.asarray(p, dtype=np.float64)
        free = self.middle if reference is None else np.asarray(reference, dtype=np.float64)
        shape = np.broadcast_shapes(R.shape[:-2], p.shape[:-1], free.shape[:-1])
        R = np.broadcast_to(R, (*shape, 3, 3)).reshape(-1, 3, 3)
        p = np.broadcast_to(p, (*shape, 3)).reshape(-1, 3)
        free = np.broadcast_to(free, (*shape, 6)).reshape(-1, 6)
        first = point_postures(self.shoulder, self.wrist_center(R, p), free[:, :3])
        frame = self.R_parent_joint[0] @ rotation_z(first.q[..., 0])
        for k in (1, 2):
            frame = frame @ self.R_parent_joint[k] @ rotation_z(first.q[..., k])
        left = np.swapaxes(frame @ self.R_parent_joint[3], -1, -2)
        M = left @ (R @ self.R_last_flange.T)[:, None]
        last = three_turns(self.R_parent_joint[4], self.R_parent_joint[5], M, free[:, 3:4])
        q = np.empty((len(p), 4, 2, 6))
        q[..., :3], q[..., 3:] = first.q[:, :, None], srs_limits.wrap(last.q)
        reachable = np.repeat(first.reachable & last.possible, 2, axis=1)
        singular = np.repeat(first.singular | last.aligned, 2, axis=1)
        q = np.where(reachable[..., None], q.reshape(-1, 8, 6), 0.0)
        if not self.exact:
            q, reachable = self._polish(q, reachable, R, p)
        return WristSolutions(
            q.reshape(*shape, 8, 6),
            reachable.reshape(*shape, 8),
            (singular & reachable).reshape(*shape, 8),
        )

    def _polish(
        self, q: FloatArray, reachable: BoolArray, R: FloatArray, p: FloatArray
    ) -> tuple[FloatArray, BoolArray]:
        """Returns postures (b, 8, 6) after Newton steps where rounding or the geometry left something over.

        What then does not meet its pose is none: right at a singularity rounding decides whether there is one.
        """
        row, branch = np.nonzero(reachable)
        some = q[row, branch]
        R_now, p_now = self.forward(some)
        error = np.abs(pose_error(R_now, p_now, R[row], p[row])).max(axis=1)
        off = np.flatnonzero(error > EXACT)
        if not len(off):
            return q, reachable
        row, branch = row[off], branch[off]
        better, left = polished(self.without_limits, R[row], p[row], some[off])
        met = np.asarray((left <= RESIDUAL).all(axis=1))
        found, reached = q.copy(), reachable.copy()
        found[row, branch] = np.where(met[:, None], srs_limits.wrap(better), 0.0)
        reached[row, branch] = met
        return found, reached

    def branch(self, q: FloatArray) -> IntArray:
        """Returns the branch of postures (..., 6), shape (...): the solution of their poses that they are."""
        q = np.asarray(q, dtype=np.float64)
        found = self.solve(*self.forward(q), reference=q)
        away = np.abs(srs_limits.wrap(found.q - q[..., None, :])).max(axis=-1)
        return np.asarray(np.where(found.reachable, away, np.inf).argmin(axis=-1), dtype=np.int64)

    def reach_miss(self, R: FloatArray, p: FloatArray) -> FloatArray:
        """Returns how far the wrist centre is beyond reach [m], joints 2 and 3 within limits, shape (...); 0 within.

        Joint 1 is taken as free, and no rotation is out of reach.

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

    def closed_postures(self, R: FloatArray, p: FloatArray) -> ReachedPostures:
        """Returns all postures within limits that reach poses; where axes 4 and 6 are aligned, samples of them.

        Args:
            R: flange rotations in the frame that carries the arm, shape (m, 3, 3).
            p: flange positions [m], shape (m, 3).
        """
        found = self.solve(R, p)
        q = self.nearest_turns(found.q, self.middle)
        good = found.reachable & self.within_limits(q)
        pose, branch = np.nonzero(good)
        parts = [(pose, branch, q[pose, branch])]
        free = np.flatnonzero(found.singular.any(axis=1))
        if len(free):
            parts.append(self._spread(R[free], p[free], free))
        pose, branch, joints = (np.concatenate(part) for part in zip(*parts, strict=True))
        order = np.lexsort((branch, pose))
        miss = np.zeros((len(p), 2))
        none = np.flatnonzero(np.bincount(pose, minlength=len(p)) == 0)
        if len(none):
            miss[none] = self._miss(R[none], p[none], q[none], found.reachable[none])
        return ReachedPostures(pose[order], joints[order], branch[order], miss)

    def _spread(
        self, R: FloatArray, p: FloatArray, pose: IntArray
    ) -> tuple[IntArray, IntArray, FloatArray]:
        """Returns poses, branches and postures with free joints all over their limits."""
        low = np.maximum(self.lower, self.middle - np.pi)
        high = np.minimum(self.upper, self.middle + np.pi)
        share = ((np.arange(SPREAD) + 0.5) / SPREAD)[:, None, None]
        found = self.solve(R, p, low + share * (high - low))
        q = self.nearest_turns(found.q, self.middle)
        good: BoolArray = np.logical_and(found.singular, self.within_limits(q))
        _, row, branch = np.nonzero(good)
        return pose[row], branch, q[good]

    def _miss(
        self, R: FloatArray, p: FloatArray, q: FloatArray, reachable: BoolArray
    ) -> FloatArray:
        """Returns what poses without a posture are missed by, distance [m] and angle [rad], shape (m, 2).

        Out of reach: by how much. Within it: what the best branch misses with its joints set back to their limits.
        """
        R_now, p_now = self.forward(np.clip(q, self.lower, self.upper))
        e = pose_error(R_now, p_now, R[:, None], p[:, None])
        error = np.stack(
            [np.linalg.norm(e[..., :3], axis=-1), np.linalg.norm(e[..., 3:], axis=-1)], axis=-1
        )
        best = np.where(reachable, error.sum(axis=-1), np.inf).argmin(axis=1)
        miss = error[np.arange(len(p)), best]
        out = self.reach_miss(R, p)
        return np.where(out[:, None] > 0.0, np.stack([out, np.zeros_like(out)], axis=1), miss)


def with_closed_forms(arm: GeneralArm) -> GeneralArm:
    """Returns an arm with its closed forms if there are any, and as it is otherwise.

    Args:
        arm: any arm.
    """
    try:
        return WristArm.of(arm)
    except UnsupportedError:
        return arm
