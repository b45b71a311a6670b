"""Closed-form forward and inverse kinematics of a spherical-revolute-spherical arm."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from dualarm_cli.compiled import srs as compiled
from dualarm_cli.errors import UnsupportedError
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray, readonly
from dualarm_cli.geometry.elementary import arctan2, cos, sin
from dualarm_cli.geometry.joint_axes import SrsGeometry
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.kinematics.srs import srs_limits
from dualarm_cli.kinematics.srs.arm_angle_curves import (
    REACH_SLACK,
    ArmAngleCurves,
    ArmPlane,
    reference_directions,
)
from dualarm_cli.kinematics.srs.srs_canonical import SrsCanonical
from dualarm_cli.records import dataclass

SRS_TOLERANCE = 1e-6
"""Largest deviation from exact SRS geometry that the closed forms ignore [m and rad]."""


@dataclass(frozen=True)
class SrsSolutions:
    """All postures of many targets."""

    q: FloatArray
    """Joints [rad] in (-pi, pi], shape (..., 8, 7); zeros where out of reach."""
    reachable: BoolArray
    """Whether the target is within reach, joint limits apart, shape (...)."""


@dataclass(frozen=True)
class SrsArm:
    """Forward and inverse kinematics of one arm in its base frame.

    The arm angle psi says where the elbow is on its circle about the line from shoulder to wrist.
    It is counted from a direction that is carried along from the first axis by the smallest
    rotation (`reference_directions`): continuous everywhere but where the wrist lies behind the
    shoulder on the first axis. All eight branches of one psi have their elbow at the same place.

    Branch = 4 * elbow + 2 * shoulder + wrist, each 0 or 1. With theta2, theta4, theta6 the angles
    of joints 2, 4, 6 counted from where axis 1 and upper arm, upper arm and forearm, forearm and
    axis 7 lie along each other: elbow is 1 for theta4 < 0, shoulder for theta2 < 0, wrist for
    theta6 < 0. Changing one of them turns both neighbours by half a turn. Where a triple is
    singular (theta2 = 0 or pi) joint 1 is 0 or pi (joint 5 for the wrist), and joint 3 (7) has all
    of the turn.
    """

    geometry: SrsGeometry
    """Axes, centres and flange at q = 0."""
    lower: FloatArray
    """Lowest joint positions [rad], shape (7,), -inf allowed."""
    upper: FloatArray
    """Highest joint positions [rad], shape (7,), inf allowed."""

    def __post_init__(self) -> None:
        """Freezes the arrays.

        Raises:
            UnsupportedError: the geometry is not SRS.
        """
        if not self.geometry.is_srs(SRS_TOLERANCE):
            raise UnsupportedError(
                f"the arm is not spherical-revolute-spherical: {self.geometry.deviation}, links "
                f"{self.geometry.upper * 1000:.4g} and {self.geometry.fore * 1000:.4g} mm; "
                f"{SRS_TOLERANCE:g} m and rad are allowed; use a general inverse kinematics for it"
            )
        object.__setattr__(self, "lower", readonly(self.lower))
        object.__setattr__(self, "upper", readonly(self.upper))

    @cached_property
    def canonical(self) -> SrsCanonical:
        """Signs, offsets and frames that make the arm a chain Z Y Z Y Z Y Z."""
        return SrsCanonical.of(self.geometry)

    @cached_property
    def numbers(self) -> FloatArray:
        """The arm for the compiled functions: `Arm` of `compiled/src/srs.c`."""
        own, geometry = self.canonical, self.geometry
        parts = (own.B.ravel(), own.C.ravel(), geometry.shoulder, geometry.p_flange_wrist)
        links = [geometry.upper, geometry.fore]
        return readonly(
            np.concatenate([*parts, links, own.sign, own.offset, self.lower, self.upper])
        )

    @cached_property
    def chain(self) -> tuple[FloatArray, BoolArray]:
        """Constant steps from joint to joint, shape (8, 3, 4), and that no joint slides, shape (7,).

        Rotation and position [m] of each joint at zero in the one before, and of the flange in the last one. All turn
        about their z axes: Y(q + offset) of the canonical form is M Z(q + offset) M^T.
        """
        own, geometry = self.canonical, self.geometry
        # M takes z to y; a half turn about x reverses the turn about z.
        M, reverse = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]), np.diag([1.0, -1.0, -1.0])
        ways = {3: geometry.upper, 5: geometry.fore}
        steps, before = np.zeros((8, 3, 4)), own.B
        steps[0, :, 3] = geometry.shoulder
        for k, (sign, offset) in enumerate(zip(own.sign, own.offset, strict=True)):
            swap = M if k % 2 else np.eye(3)
            half = reverse if sign < 0.0 else np.eye(3)
            steps[k, :, :3] = product(before, swap, half)
            if k in ways:
                steps[k, :, 3] = product(before, np.array([0.0, 0.0, ways[k]]))
            c, s = cos(offset), sin(offset)
            before = product(half, np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), swap.T)
        steps[7, :, :3] = product(before, own.C)
        steps[7, :, 3] = product(-steps[7, :, :3], geometry.p_flange_wrist)
        return readonly(steps), np.zeros(7, dtype=np.bool_)

    @cached_property
    def _to_canonical(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Linear maps on flattened flange rotations: to canonical ones and to wrist centres."""
        B, C = self.canonical.B, self.canonical.C
        # Row-major: (B^T R C^T)_ij = sum over kl of B_ki C_jl R_kl.
        rotation = np.asarray(np.kron(B.T, C), dtype=np.float64)
        wrist = np.asarray(np.kron(B.T, self.geometry.p_flange_wrist), dtype=np.float64)
        return rotation, wrist, product(B.T, self.geometry.shoulder)

    @cached_property
    def reach(self) -> tuple[float, float]:
        """Least and greatest distance of the wrist from the shoulder [m], joint 4 within limits."""
        low, high = self.lower[3], self.upper[3]
        zero = self.canonical.offset[3]
        cosines = [cos(angle + zero) for angle in (low, high) if np.isfinite(angle)]
        for extreme in (0.0, np.pi):
            if srs_limits.some_turn_within(np.array(extreme - zero), low, high):
                cosines.append(cos(extreme))
        a1, a2 = self.geometry.upper, self.geometry.fore
        least, most = (
            float(np.sqrt(max(0.0, a1 * a1 + a2 * a2 + 2.0 * a1 * a2 * cosine)))
            for cosine in (min(cosines), max(cosines))
        )
        return least, most

    def forward(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Returns flange rotations (..., 3, 3) and positions (..., 3) [m] for joints (..., 7)."""
        q = np.asarray(q, dtype=np.float64)
        shape = q.shape[:-1]
        columns, upper, fore, _ = self.canonical.chain(q)
        w = self.geometry.upper * upper + self.geometry.fore * fore
        rotation, wrist, origin = self._to_canonical
        R = product(rotation.T, columns.reshape(9, -1))
        p = product(self.canonical.B, w.reshape(3, -1) + origin[:, None] - product(wrist, R))
        return R.T.reshape(*shape, 3, 3), p.T.reshape(*shape, 3)

    def wrist_center(self, R: FloatArray, p: FloatArray) -> FloatArray:
        """Returns the wrist centre [m], shape (..., 3), of flange poses (..., 3, 3), (..., 3)."""
        return p + product(R, self.geometry.p_flange_wrist)

    def elbow(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Returns the elbow [m] and the axis of joint 4 through it, base frame, (..., 3) each, of joints (..., 7)."""
        _, upper, _, normal = self.canonical.chain(q)
        bend = self.canonical.sign[3] * q[..., 3] + self.canonical.offset[3]
        turned = np.where(sin(bend) < 0.0, -1.0, 1.0)[..., None]
        upper, normal = (
            product(part.T, self.canonical.B.T).reshape(*q.shape[:-1], 3)
            for part in (upper, normal)
        )
        return self.geometry.shoulder + self.geometry.upper * upper, turned * normal

    def elbow_interior_angle(self, q4: FloatArray) -> FloatArray:
        """Returns the angle between upper arm and forearm [rad], pi where stretched, shape (...).

        Args:
            q4: joint 4 [rad], shape (...).
        """
        return np.pi - np.abs(srs_limits.wrap(np.asarray(q4) + self.canonical.offset[3]))

    def reach_miss(self, R: FloatArray, p: FloatArray) -> FloatArray:
        """Returns how far flange poses are beyond `reach` [m], shape (...); 0 within.

        Args:
            R: flange rotations in the base frame, shape (..., 3, 3).
            p: flange positions in the base frame [m], shape (..., 3).
        """
        d = norm(self.wrist_center(R, p) - self.geometry.shoulder, axis=-1)
        least, most = self.reach
        miss = np.maximum(d - most, least - d)
        return np.where(miss > REACH_SLACK, miss, 0.0)

    def within_limits(self, q: FloatArray) -> BoolArray:
        """Returns whether all joints (..., 7) are within their limits, shape (...)."""
        return srs_limits.within_limits(q, self.lower, self.upper)

    def nearest_turns(self, q: FloatArray, reference: FloatArray) -> FloatArray:
        """Returns q with whole turns added: nearest to the reference among those within limits.

        A joint that no turn brings within its limits keeps its value.

        Args:
            q: joints in [-pi, pi] [rad], shape (..., 7).
            reference: joints to be near to [rad], broadcast against q.
        """
        return srs_limits.nearest_turns(q, reference, self.lower, self.upper)

    def curves(self, R: FloatArray, p: FloatArray) -> ArmAngleCurves:
        """Returns the joints of targets (...) as functions of the arm angle.

        Args:
            R: flange rotations in the base frame, shape (..., 3, 3).
            p: flange positions in the base frame [m], shape (..., 3), broadcast against R.
        """
        R, p = np.asarray(R, dtype=np.float64), np.asarray(p, dtype=np.float64)
        ndim = max(R.ndim - 2, p.ndim - 1)
        shape_R = (1,) * (ndim - R.ndim + 2) + R.shape[:-2]
        shape_p = (1,) * (ndim - p.ndim + 1) + p.shape[:-1]
        rotation, wrist, origin = self._to_canonical
        flat = R.reshape(-1, 9).T
        w = (product(self.canonical.B.T, p.reshape(-1, 3).T) - origin[:, None]).reshape(3, *shape_p)
        w = w + product(wrist, flat).reshape(3, *shape_R)
        R_canonical = product(rotation, flat).reshape(3, 3, *shape_R)
        plane = ArmPlane.of(w, R_canonical, self.geometry.upper, self.geometry.fore)
        return ArmAngleCurves.of(self.canonical, plane)

    def solve(self, R: FloatArray, p: FloatArray, psi: FloatArray | float) -> SrsSolutions:
        """Returns all eight branches.

        Args:
            R: flange rotations in the base frame, shape (..., 3, 3).
            p: flange positions in the base frame [m], shape (..., 3).
            psi: arm angles [rad], broadcast against (...).
        """
        target, angle, shape = _targets(R, p, psi)
        q, reachable = compiled.postures(self.numbers, *target, *angle)
        return SrsSolutions(q.reshape(*shape, 8, 7), reachable.reshape(shape))

    def solve_branch(
        self, R: FloatArray, p: FloatArray, psi: FloatArray | float, branch: IntArray
    ) -> tuple[FloatArray, BoolArray]:
        """Returns joints (..., 7) of one branch per element and whether it is within reach (...).

        Args:
            R: flange rotations in the base frame, shape (..., 3, 3).
            p: flange positions in the base frame [m], shape (..., 3).
            psi: arm angles [rad], broadcast against (...).
            branch: branch of each element, broadcast against (...).
        """
        target, angle, shape = _targets(R, p, psi, np.shape(branch))
        branch = np.broadcast_to(branch, shape).ravel().astype(np.int64)
        q, reachable = compiled.postures(self.numbers, *target, *angle, branch)
        return q.reshape(*shape, 7), reachable.reshape(shape)

    def branch(self, q: FloatArray) -> IntArray:
        """Returns the branch of postures (..., 7), shape (...)."""
        bits = [srs_limits.wrap(q[..., i] + self.canonical.offset[i]) < 0.0 for i in (3, 1, 5)]
        return np.asarray(4 * bits[0] + 2 * bits[1] + bits[2], dtype=np.int64)

    def arm_angle(self, q: FloatArray) -> FloatArray:
        """Returns the arm angle [rad] of postures (..., 7), shape (...).

        It follows from the elbow's axis, so that the stretched and the folded arm have one too.
        """
        q = np.asarray(q, dtype=np.float64)
        _, upper, fore, normal = self.canonical.chain(q)
        w = self.geometry.upper * upper + self.geometry.fore * fore
        d = np.sqrt((w * w).sum(axis=0))
        tiny = d < REACH_SLACK
        u = np.where(tiny, np.array([0.0, 0.0, 1.0])[:, None], w / np.where(tiny, 1.0, d))
        r, t = reference_directions(u)
        # For a positive bend the elbow's axis is -u × h = r sin psi - t cos psi.
        psi = arctan2((normal * r).sum(axis=0), -(normal * t).sum(axis=0))
        return srs_limits.wrap(psi).reshape(q.shape[:-1])


def _targets(
    R: FloatArray, p: FloatArray, psi: FloatArray | float, also: tuple[int, ...] = ()
) -> tuple[tuple[FloatArray, FloatArray], tuple[IntArray, FloatArray], tuple[int, ...]]:
    """Returns flange poses in a row, pose and arm angle of every element in a row, and the shape of all elements.

    Args:
        R: flange rotations, shape (..., 3, 3).
        p: flange positions, shape (..., 3).
        psi: arm angles, shape (...); all three are broadcast.
        also: a further shape to broadcast against.
    """
    own = np.broadcast_shapes(np.shape(R)[:-2], np.shape(p)[:-1])
    shape = np.broadcast_shapes(own, np.shape(psi), also)
    poses = (
        np.broadcast_to(R, (*own, 3, 3)).reshape(-1, 3, 3),
        np.broadcast_to(p, (*own, 3)).reshape(-1, 3),
    )
    index = np.broadcast_to(np.arange(len(poses[0])).reshape(own), shape).ravel()
    return poses, (index, np.broadcast_to(psi, shape).astype(np.float64).ravel()), shape


def closed_form(arm: object) -> SrsArm:
    """Returns an arm if it is spherical-revolute-spherical.

    Raises:
        UnsupportedError: it is another one.
    """
    if not isinstance(arm, SrsArm):
        raise UnsupportedError(
            "an arm that is not spherical-revolute-spherical has no closed form over an arm angle; "
            "use --redundancy numeric"
        )
    return arm
