"""Closed-form kinematics of spherical-revolute-spherical (SRS) arms."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from dualarm_cli.compiled import srs as compiled
from dualarm_cli.errors import UnsupportedError
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray, readonly
from dualarm_cli.geometry.elementary import TURN, arccos, arctan2, cos, sin
from dualarm_cli.geometry.joint_axes import SRS_TOLERANCE, SrsGeometry
from dualarm_cli.geometry.products import cross, norm, product
from dualarm_cli.kinematics.posture_source import (
    LARGEST_STEP,
    PROVEN_MISS,
    Posture,
    PostureSource,
    ReachedPostures,
    ToolPose,
)
from dualarm_cli.kinematics.srs import srs_limits
from dualarm_cli.kinematics.srs.arm_angle_curves import (
    CURVES,
    ArmAngleCurves,
    ArmPlane,
    reference_directions,
)
from dualarm_cli.kinematics.srs.arm_angle_intervals import ArmAngleIntervals
from dualarm_cli.kinematics.srs.srs_canonical import SrsCanonical
from dualarm_cli.records import dataclass

ARM_ANGLES = 36
"""Number of arm angles around the circle at which postures are computed."""
ELBOWS, TINY = 60, 1e-9
"""Number of elbows examined on their circle, and least divisor [m]."""


@dataclass(frozen=True)
class SrsSolutions:
    """Postures of targets, all branches."""

    q: FloatArray
    """Joints [rad] in (-pi, pi], shape (..., 8, 7), zeros out of reach."""
    reachable: BoolArray
    """Flags of targets within reach, without joint limits, shape (...)."""


@dataclass(frozen=True)
class SrsArm(PostureSource):
    """Forward and inverse kinematics of one arm in its base frame.

    The arm angle psi is the position of the elbow on its circle about the line from shoulder to wrist.
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
    has_arm_angle = True
    reach_step = np.radians(1.0)

    def __post_init__(self) -> None:
        """Freeze the arrays.

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
        """Canonical form of the arm: a chain Z Y Z Y Z Y Z."""
        return SrsCanonical.of(self.geometry)

    @cached_property
    def numbers(self) -> FloatArray:
        """Numbers of the arm for compiled functions: `Arm` of `compiled/src/srs.c`."""
        canonical, geometry = self.canonical, self.geometry
        parts = (
            canonical.B.ravel(),
            canonical.C.ravel(),
            geometry.shoulder,
            geometry.p_flange_wrist,
        )
        links = [geometry.upper, geometry.fore]
        return readonly(
            np.concatenate(
                [*parts, links, canonical.sign, canonical.offset, self.lower, self.upper]
            )
        )

    @cached_property
    def chain(self) -> tuple[FloatArray, BoolArray]:
        """Constant transforms between joints, (8, 3, 4), and flags of sliding joints, (7,).

        Rotation and position [m] of each joint at zero in the one before, and of the flange in the last one. All turn
        about their z axes: Y(q + offset) of the canonical form is M Z(q + offset) M^T.
        """
        canonical, geometry = self.canonical, self.geometry
        # M takes z to y; a half turn about x reverses the turn about z.
        M, reverse = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]), np.diag([1.0, -1.0, -1.0])
        link_lengths = {3: geometry.upper, 5: geometry.fore}
        steps, before = np.zeros((8, 3, 4)), canonical.B
        steps[0, :, 3] = geometry.shoulder
        for k, (sign, offset) in enumerate(zip(canonical.sign, canonical.offset, strict=True)):
            swap = M if k % 2 else np.eye(3)
            half = reverse if sign < 0.0 else np.eye(3)
            steps[k, :, :3] = product(before, swap, half)
            if k in link_lengths:
                steps[k, :, 3] = product(before, np.array([0.0, 0.0, link_lengths[k]]))
            c, s = cos(offset), sin(offset)
            before = product(half, np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), swap.T)
        steps[7, :, :3] = product(before, canonical.C)
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
        """Compute flange rotations (..., 3, 3), positions (..., 3) [m] of joints (..., 7)."""
        q = np.asarray(q, dtype=np.float64)
        shape = q.shape[:-1]
        columns, upper, fore, _ = self.canonical.chain(q)
        w = self.geometry.upper * upper + self.geometry.fore * fore
        rotation, wrist, origin = self._to_canonical
        R = product(rotation.T, columns.reshape(9, -1))
        p = product(self.canonical.B, w.reshape(3, -1) + origin[:, None] - product(wrist, R))
        return R.T.reshape(*shape, 3, 3), p.T.reshape(*shape, 3)

    def wrist_center(self, R: FloatArray, p: FloatArray) -> FloatArray:
        """Compute the wrist centre [m], shape (..., 3), of flange poses."""
        return p + product(R, self.geometry.p_flange_wrist)

    fixed_point = wrist_center

    @property
    def last_axis(self) -> tuple[FloatArray, FloatArray]:
        """Direction (3,) of the last joint's axis, and a point (3,) on it [m].

        Both are in the flange frame.
        """
        direction = product(self.geometry.R_flange.T, self.geometry.axes[6])
        return direction, self.geometry.p_flange_wrist

    def elbow(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute elbow [m] and joint 4's axis in the base frame, (..., 3) each."""
        _, upper, _, normal = self.canonical.chain(q)
        bend = self.canonical.sign[3] * q[..., 3] + self.canonical.offset[3]
        turned = np.where(sin(bend) < 0.0, -1.0, 1.0)[..., None]
        upper, normal = (
            product(part.T, self.canonical.B.T).reshape(*q.shape[:-1], 3)
            for part in (upper, normal)
        )
        return self.geometry.shoulder + self.geometry.upper * upper, turned * normal

    def elbow_interior_angle(self, q4: FloatArray) -> FloatArray:
        """Compute the angle between upper arm and forearm [rad], pi if stretched, (...).

        Args:
            q4: joint 4 [rad], shape (...).
        """
        return np.pi - np.abs(srs_limits.wrap(np.asarray(q4) + self.canonical.offset[3]))

    def reach_miss(self, R: FloatArray, p: FloatArray) -> FloatArray:
        """Compute the distance of flange poses beyond `reach` [m], shape (...), 0 within.

        Args:
            R: flange rotations in the base frame, shape (..., 3, 3).
            p: flange positions in the base frame [m], shape (..., 3).
        """
        miss = np.abs(self.signed_miss(R, p))
        return np.where(miss > CURVES.slack, miss, 0.0)

    def feasible_arm_angles(self, R: FloatArray, p: FloatArray) -> ArmAngleIntervals:
        """Compute the arm angles at which all joints of a branch are within limits.

        Where joint i meets a limit L, one equation A sin psi + B cos psi + C = 0 holds: for joints 1,
        3, 5, 7 num(psi) cos L - den(psi) sin L = 0, for joints 2 and 6 cos theta(psi) = cos(L +
        offset); all eight branches share them. Their roots cut the circle into arcs, and on an arc
        each joint is either within or beyond its limits: the midpoint decides exactly. [Shimizu2008]
        has the idea; arcs instead of case distinctions, whole turns and exact singularities are our
        own.

        Args:
            R: flange rotations in the base frame, shape (..., 3, 3).
            p: flange positions in the base frame [m], shape (..., 3), broadcast against R.
        """
        shape = np.broadcast_shapes(np.shape(R)[:-2], np.shape(p)[:-1])
        poses = np.broadcast_to(R, (*shape, 3, 3)), np.broadcast_to(p, (*shape, 3))
        start, end, count = compiled.arm_angle_intervals(
            self.numbers, poses[0].reshape(-1, 3, 3), poses[1].reshape(-1, 3)
        )
        return ArmAngleIntervals(
            start.reshape(*shape, *start.shape[1:]),
            end.reshape(*shape, *end.shape[1:]),
            count.reshape(*shape, 8),
        )

    def curves(self, R: FloatArray, p: FloatArray) -> ArmAngleCurves:
        """Compute the joints of targets (...) as functions of the arm angle.

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
        """Solve for all eight branches of flange poses.

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
        """Solve for joints (..., 7) of a branch per element, with reach flags (...).

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

    def postures(
        self, R: FloatArray, p: FloatArray, *, first_only: bool = False, thorough: bool = True
    ) -> ReachedPostures:
        """Compute postures within limits, at many arm angles or one per feasible interval."""
        if thorough:
            psi = np.linspace(-np.pi, np.pi, ARM_ANGLES, endpoint=False)[:, None]
            every = np.arange(8, dtype=np.int64)
            q, reachable = self.solve_branch(R[:, None, None], p[:, None, None], psi, every)
            q = self.nearest_turns(q, self.middle)
            good = reachable & self.within_limits(q)
            pose, _, branch = np.nonzero(good)
            q = q[good]
        else:
            near = np.flatnonzero(self.reach_miss(R, p) == 0.0)
            intervals = self.feasible_arm_angles(R[near], p[near])
            row, branch, k = np.nonzero(np.isfinite(intervals.start))
            psi = 0.5 * (intervals.start + intervals.end)[row, branch, k]
            pose = near[row]
            q = self.nearest_turns(self.solve_branch(R[pose], p[pose], psi, branch)[0], self.middle)
        beyond = np.abs(self.signed_miss(R, p))
        return ReachedPostures(pose, q, branch, np.stack([beyond, np.zeros_like(beyond)], axis=-1))

    def neighbour(self, posture: Posture, R: FloatArray, p: FloatArray) -> FloatArray | None:
        """Compute the joints of a posture's branch and arm angle that reach a pose."""
        q, reachable = self.solve_branch(R, p, posture.psi, np.array(posture.branch))
        q = self.nearest_turns(q, posture.q)
        return q if reachable and self.within_limits(q) else None

    def follow_line(
        self, posture: Posture, pose: ToolPose, length: float, psi_end: float, samples: int
    ) -> FloatArray:
        """Compute joints along a straight tool line.

        `psi_end` is the arm angle at its end.
        """
        R, p, outward = (x[None] for x in pose)
        psi, lengths = np.array([[posture.psi, psi_end, psi_end]]), np.array([[0.0, length]])
        both = R, p, np.repeat(outward, 2, axis=0)
        lines = compiled.LinePair(both, np.array([posture.branch]), psi, lengths, posture.q[None])
        q, _ = compiled.joints_along_lines(self.numbers, lines, np.pi, samples)
        return q[0, samples - 1 :]

    def follow_points(
        self, posture: Posture, R: FloatArray, p: FloatArray, drift: FloatArray, target: int
    ) -> tuple[FloatArray, bool]:
        """Compute the joints of a posture's branch along flange poses of one rotation."""
        rows, psi = np.broadcast_to(R, (len(p), 3, 3)), posture.psi + drift
        q, reachable = self.solve_branch(rows, p, psi, np.array(posture.branch))
        steps = self.less_turns(np.diff(q, axis=0))
        q = np.concatenate([q[:1], q[:1] + np.cumsum(steps, axis=0)])
        q = q + (self.nearest_turns(self.less_turns(q[target]), posture.q) - q[target])
        smooth = np.abs(steps).max(initial=0.0) <= LARGEST_STEP
        return q, bool(reachable.all() and smooth and self.within_limits(q).all())

    def reached(self, R: FloatArray, p: FloatArray) -> tuple[BoolArray, FloatArray]:
        """Test exactly which poses postures within limits reach, and compute `signed_miss`."""
        feasible = np.asarray(self.feasible_arm_angles(R, p).count.any(axis=-1))
        return feasible, self.signed_miss(R, p)

    def why_missed(self, miss: float) -> str:
        """Return the key of the refusal for a signed miss [m], 0 within reach."""
        return "beyond_reach" if miss > 0 else "too_near_shoulder" if miss < 0 else "beyond_limits"

    def signed_miss(self, R: FloatArray, p: FloatArray) -> FloatArray:
        """Compute the wrist's signed distance beyond `reach` [m], shape (...).

        It is negative if the wrist is too near the shoulder, and 0 within reach.
        """
        least, most = self.reach
        distance = norm(self.wrist_center(R, p) - self.geometry.shoulder, axis=-1)
        return np.where(distance > most, distance - most, np.minimum(0.0, distance - least))

    def proven_miss(self, R: FloatArray, p: FloatArray) -> tuple[float, float] | None:
        """Return zeros if no posture within limits reaches any of the poses (y,), else None."""
        return None if self._wider.feasible_arm_angles(R, p).count.any() else (0.0, 0.0)

    @cached_property
    def _wider(self) -> SrsArm:
        """The arm with slightly wider limits.

        Rounding takes away the single arm angles at the ends of its limits.
        """
        return replace(self, lower=self.lower - PROVEN_MISS, upper=self.upper + PROVEN_MISS)

    def may_bend(
        self, R: FloatArray, p: FloatArray, moved: FloatArray, turned: FloatArray
    ) -> BoolArray:
        """Return whether joints 2 and 6 may be within limits near poses (k,).

        The elbow is on a circle about the line from shoulder to wrist; its position decides how far both joints bend.

        Args:
            R: flange rotations, shape (k, 3, 3).
            p: flange positions [m], shape (k, 3).
            moved: largest distance of the wrist from there [m], shape (k,).
            turned: largest turn of the flange from there [rad], shape (k,).
        """
        upper, fore = self.geometry.upper, self.geometry.fore
        to_wrist = self.wrist_center(R, p) - self.geometry.shoulder
        distance = np.maximum(norm(to_wrist, axis=1), TINY)
        along = to_wrist / distance[:, None]
        # The circle's middle on the line, its radius, and its shift and widening by the wrist's motion.
        links = upper * upper - fore * fore
        middle = 0.5 * (distance + links / distance)
        radius = np.sqrt(np.maximum(0.0, upper * upper - middle * middle))
        shifted = 0.5 * moved * (1.0 + abs(links) / np.square(np.maximum(distance - moved, TINY)))
        change = shifted * (2.0 * np.maximum(upper, np.abs(middle)) + shifted)
        wider = np.minimum(np.sqrt(change), change / np.maximum(radius, TINY))
        aside = np.where(np.abs(along[:, :1]) < 0.7, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
        aside = cross(along, aside)
        aside = aside / norm(aside, axis=1, keepdims=True)
        psi = np.linspace(-np.pi, np.pi, ELBOWS, endpoint=False)[:, None]
        circle = cos(psi) * aside[:, None] + sin(psi) * cross(along, aside)[:, None]
        elbow = (middle[:, None] * along)[:, None] + radius[:, None, None] * circle
        # From any elbow to the next one examined: along the circle, by shift and width, and turned with the line.
        off = radius * (np.pi / ELBOWS) + shifted + wider + 2.0 * upper * moved / distance
        first_axis, last_axis = self.canonical.B[:, 2], product(R, self.canonical.C[2])[:, None]
        fits = np.ones(elbow.shape[:2], dtype=np.bool_)
        for joint, link, axis, slack in (
            (1, elbow, first_axis, off / upper),
            (5, to_wrist[:, None] - elbow, last_axis, (off + moved) / fore + turned),
        ):
            bend = arccos(np.clip((link * axis).sum(axis=-1) / norm(link, axis=-1), -1.0, 1.0))
            # A chord is at least 2 / pi of its arc.
            fits &= bend <= self._largest_bend(joint) + PROVEN_MISS + 0.5 * np.pi * slack[:, None]
        return np.asarray(fits.any(axis=1))

    def _largest_bend(self, joint: int) -> float:
        """Return the largest angle between the two links that a joint bends [rad]."""
        low, high, zero = self.lower[joint], self.upper[joint], self.canonical.offset[joint]
        if srs_limits.some_turn_within(np.array(np.pi - zero), float(low), float(high)):
            return np.pi
        ends = np.array([low, high]) + zero
        return float(np.abs(ends - TURN * np.round(ends / TURN)).max())

    def branch(self, q: FloatArray) -> IntArray:
        """Compute the branch of postures (..., 7), shape (...)."""
        bits = [srs_limits.wrap(q[..., i] + self.canonical.offset[i]) < 0.0 for i in (3, 1, 5)]
        return np.asarray(4 * bits[0] + 2 * bits[1] + bits[2], dtype=np.int64)

    def arm_angle(self, q: FloatArray) -> FloatArray:
        """Compute the arm angle [rad] of postures (..., 7), shape (...).

        It follows from the elbow's axis, so that the stretched and the folded arm have one too.
        """
        q = np.asarray(q, dtype=np.float64)
        _, upper, fore, normal = self.canonical.chain(q)
        w = self.geometry.upper * upper + self.geometry.fore * fore
        d = np.sqrt((w * w).sum(axis=0))
        tiny = d < CURVES.slack
        u = np.where(tiny, np.array([0.0, 0.0, 1.0])[:, None], w / np.where(tiny, 1.0, d))
        r, t = reference_directions(u)
        # For a positive bend the elbow's axis is -u × h = r sin psi - t cos psi.
        psi = arctan2((normal * r).sum(axis=0), -(normal * t).sum(axis=0))
        return srs_limits.wrap(psi).reshape(q.shape[:-1])


def _targets(
    R: FloatArray, p: FloatArray, psi: FloatArray | float, also: tuple[int, ...] = ()
) -> tuple[tuple[FloatArray, FloatArray], tuple[IntArray, FloatArray], tuple[int, ...]]:
    """Flatten flange poses, and the pose and arm angle of each element.

    The last result is the shape of the elements.

    Args:
        R: flange rotations, shape (..., 3, 3).
        p: flange positions, shape (..., 3).
        psi: arm angles, shape (...); all three are broadcast.
        also: a further shape to broadcast against.
    """
    pose_shape = np.broadcast_shapes(np.shape(R)[:-2], np.shape(p)[:-1])
    shape = np.broadcast_shapes(pose_shape, np.shape(psi), also)
    poses = (
        np.broadcast_to(R, (*pose_shape, 3, 3)).reshape(-1, 3, 3),
        np.broadcast_to(p, (*pose_shape, 3)).reshape(-1, 3),
    )
    index = np.broadcast_to(np.arange(len(poses[0])).reshape(pose_shape), shape).ravel()
    return poses, (index, np.broadcast_to(psi, shape).astype(np.float64).ravel()), shape


def closed_form(arm: PostureSource) -> SrsArm:
    """Return an arm if it is spherical-revolute-spherical.

    Raises:
        UnsupportedError: the arm is of another family.
    """
    if not isinstance(arm, SrsArm):
        raise UnsupportedError(
            "an arm that is not spherical-revolute-spherical has no closed form over an arm angle; "
            "use redundancy numeric"
        )
    return arm
