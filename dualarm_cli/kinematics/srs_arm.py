"""Closed-form inverse kinematics of a spherical-revolute-spherical arm over its arm angle."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray, readonly
from dualarm_cli.kinematics.srs_geometry import SrsGeometry

REACH_SLACK = 1e-12
"""How far |cos q4| may exceed one by rounding before a pose is out of reach."""
PARALLEL = 1e-9
"""Below this sine the wrist counts as lying on the first axis."""


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

    The arm angle psi turns the arm plane (shoulder, elbow, wrist) about the line from shoulder to wrist;
    psi = 0 where the first axis lies in that plane. With the wrist on the first axis that plane is
    undefined and the base's own second axis stands in for its normal.

    Branch = 4 * elbow + 2 * shoulder + wrist, each 0 or 1: elbow 0 has q4 on the positive side of the
    stretched arm, shoulder and wrist 0 have a positive sine of the middle joint of their triple.
    """

    geometry: SrsGeometry
    """Axes, centres and flange at q = 0."""
    lower: FloatArray
    """Lowest joint positions [rad], shape (7,)."""
    upper: FloatArray
    """Highest joint positions [rad], shape (7,)."""

    def __post_init__(self) -> None:
        """Freezes the arrays."""
        object.__setattr__(self, "lower", readonly(self.lower))
        object.__setattr__(self, "upper", readonly(self.upper))

    @cached_property
    def _shoulder(self) -> _Triple:
        return _Triple.of(*self.geometry.axes[0:3])

    @cached_property
    def _wrist(self) -> _Triple:
        return _Triple.of(*self.geometry.axes[4:7])

    @cached_property
    def _links(self) -> tuple[FloatArray, FloatArray, float]:
        """Upper arm and forearm at q = 0 and the joint-4 angle from stretched to there."""
        g = self.geometry
        u, f = g.elbow - g.shoulder, g.wrist - g.elbow
        return u, f, float(np.arctan2(g.axes[3] @ np.cross(u, f), u @ f))

    def forward(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Returns flange rotations (..., 3, 3) and positions (..., 3) [m] for joints (..., 7)."""
        g = self.geometry
        u, f, _ = self._links
        R03 = _rotations(g.axes[0:3], q[..., 0:3])
        R04 = R03 @ _rotation(g.axes[3], q[..., 3])
        R07 = R04 @ _rotations(g.axes[4:7], q[..., 4:7])
        p = g.shoulder + R03 @ u + R04 @ f + R07 @ (g.p_flange - g.wrist)
        return R07 @ g.R_flange, p

    def wrist_center(self, R: FloatArray, p: FloatArray) -> FloatArray:
        """Returns the wrist centre [m], shape (..., 3), of flange poses."""
        return p + R @ self.geometry.p_flange_wrist

    def elbow_interior_angle(self, q4: FloatArray) -> FloatArray:
        """Returns the angle between upper arm and forearm [rad]; pi where stretched."""
        return np.pi - np.abs(_wrap(np.asarray(q4) + self._links[2]))

    def reach_miss(self, R: FloatArray, p: FloatArray) -> FloatArray:
        """Returns how far each flange pose is beyond the links' reach [m], shape (...); 0 within."""
        r = np.linalg.norm(self.wrist_center(R, p) - self.geometry.shoulder, axis=-1)
        a1, a2 = self.geometry.upper, self.geometry.fore
        return np.maximum(0.0, np.maximum(r - (a1 + a2), abs(a1 - a2) - r))

    def within_limits(self, q: FloatArray) -> BoolArray:
        """Returns whether all joints are within their limits, shape (...)."""
        inside: BoolArray = ((q >= self.lower) & (q <= self.upper)).all(axis=-1)
        return inside

    def nearest_turns(self, q: FloatArray, reference: FloatArray) -> FloatArray:
        """Returns q with whole turns added: nearest to the reference among those within limits.

        A joint that no turn brings within its limits keeps its value.

        Args:
            q: joints [rad], shape (..., 7).
            reference: joints to be near to [rad], broadcast against q.
        """
        turn = 2.0 * np.pi
        nearest = q + turn * np.round((reference - q) / turn)
        low = q + turn * np.ceil((self.lower - q) / turn)
        high = q + turn * np.floor((self.upper - q) / turn)
        return np.where(low <= high, np.clip(nearest, low, high), q)

    def solve(self, R: FloatArray, p: FloatArray, psi: FloatArray) -> SrsSolutions:
        """Returns all eight branches.

        Args:
            R: flange rotations in the base frame, shape (..., 3, 3).
            p: flange positions in the base frame [m], shape (..., 3).
            psi: arm angles [rad], broadcast against (...).
        """
        plane = _ArmPlane.of(self, R, p)
        shape = np.broadcast_shapes(plane.reachable.shape, np.shape(psi))
        q = np.empty((*shape, 8, 7))
        sin, cos = np.sin(psi), np.cos(psi)
        for elbow in (0, 1):
            shoulder, q4, wrist = self._postures(plane, sin, cos, 1 - 2 * elbow)
            for branch in range(4):
                row = q[..., 4 * elbow + branch, :]
                row[..., 3] = q4
                row[..., 0:3] = _flip(shoulder, branch >> 1, self._shoulder)
                row[..., 4:7] = _flip(wrist, branch & 1, self._wrist)
        reachable = np.broadcast_to(plane.reachable, shape)
        q[~reachable] = 0.0
        return SrsSolutions(_wrap(q), reachable)

    def solve_branch(
        self, R: FloatArray, p: FloatArray, psi: FloatArray, branch: IntArray
    ) -> tuple[FloatArray, BoolArray]:
        """Returns joints (..., 7) of one branch per element and whether it is within reach (...).

        Args:
            R: flange rotations in the base frame, shape (..., 3, 3).
            p: flange positions in the base frame [m], shape (..., 3).
            psi: arm angles [rad], broadcast against (...).
            branch: branch of each element, broadcast against (...).
        """
        plane = _ArmPlane.of(self, R, p)
        shape = np.broadcast_shapes(plane.reachable.shape, np.shape(psi), np.shape(branch))
        branch = np.broadcast_to(branch, shape)
        sign = 1 - 2 * (branch >> 2)
        shoulder, q4, wrist = self._postures(plane, np.sin(psi), np.cos(psi), sign)
        q = np.empty((*shape, 7))
        q[..., 0:3] = _flip(shoulder, (branch >> 1) & 1, self._shoulder)
        q[..., 3] = q4
        q[..., 4:7] = _flip(wrist, branch & 1, self._wrist)
        reachable = np.broadcast_to(plane.reachable, shape)
        q[~reachable] = 0.0
        return _wrap(q), reachable

    def _postures(
        self, plane: _ArmPlane, sin: FloatArray, cos: FloatArray, sign: int | IntArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Returns shoulder angles (..., 3), q4 (...), wrist angles (..., 3) of unflipped triples."""
        g = self.geometry
        u, f, zero = self._links
        q4 = sign * plane.bend - zero
        R34 = _rotation(g.axes[3], q4)
        v = u + R34 @ f
        v = v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), PARALLEL)
        # R03 takes v to w, the fourth axis to the normal n of the arm plane.
        n = cos[..., None] * plane.n0 + sin[..., None] * plane.m0
        to = np.stack([np.broadcast_to(plane.w, n.shape), n, np.cross(plane.w, n)], axis=-1)
        e4 = np.broadcast_to(g.axes[3], v.shape)
        R03 = to @ np.stack([v, e4, np.cross(v, e4)], axis=-2)
        R47 = np.swapaxes(R03 @ R34, -1, -2) @ (plane.R @ g.R_flange.T)
        return self._shoulder.angles(R03), np.broadcast_to(q4, n.shape[:-1]), self._wrist.angles(R47)

    def branch(self, q: FloatArray) -> IntArray:
        """Returns the branch of postures (..., 7), shape (...)."""
        _, _, zero = self._links
        bits = [
            _wrap(q[..., 3] + zero) < 0,
            np.sin(q[..., 1] + self._shoulder.zero) < 0,
            np.sin(q[..., 5] + self._wrist.zero) < 0,
        ]
        return np.asarray(4 * bits[0] + 2 * bits[1] + bits[2], dtype=np.int64)

    def arm_angle(self, q: FloatArray) -> FloatArray:
        """Returns the arm angle [rad] of postures (..., 7), shape (...)."""
        R, p = self.forward(q)
        plane = _ArmPlane.of(self, R, p)
        n = _rotations(self.geometry.axes[0:3], q[..., 0:3]) @ self.geometry.axes[3]
        return np.arctan2((n * plane.m0).sum(axis=-1), (n * plane.n0).sum(axis=-1))


@dataclass(frozen=True)
class _Triple:
    """Three axes that meet at right angles: Rot(e1, a) Rot(e2, b) Rot(e3, c), in closed form.

    With B = [e2 x e1, e2, e1] and e3 = cos(zero) e1 + sin(zero) e2 x e1 the product is
    B Rz(a) Ry(b + zero) Rz(c) Ry(-zero) B^T (our own derivation).
    """

    B: FloatArray
    C: FloatArray
    zero: float

    @classmethod
    def of(cls, e1: FloatArray, e2: FloatArray, e3: FloatArray) -> _Triple:
        x = np.cross(e2, e1)
        zero = float(np.arctan2(e3 @ x, e3 @ e1))
        c, s = np.cos(zero), np.sin(zero)
        B = np.column_stack([x, e2, e1])
        return cls(B, B @ np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]), zero)

    def angles(self, R: FloatArray) -> FloatArray:
        """Returns the three angles (..., 3) with a positive sine of the middle one."""
        M = self.B.T @ R @ self.C
        b = np.arctan2(np.hypot(M[..., 0, 2], M[..., 1, 2]), M[..., 2, 2])
        singular = np.hypot(M[..., 0, 2], M[..., 1, 2]) < PARALLEL
        # Where the outer axes are one line only the sum (or difference) counts: c = 0.
        a = np.where(
            singular,
            np.arctan2(M[..., 1, 0], M[..., 1, 1]),
            np.arctan2(M[..., 1, 2], M[..., 0, 2]),
        )
        c = np.where(singular, 0.0, np.arctan2(M[..., 2, 1], -M[..., 2, 0]))
        return np.stack([a, b - self.zero, c], axis=-1)


def _flip(angles: FloatArray, flip: int | IntArray, triple: _Triple) -> FloatArray:
    """Returns the other solution of a triple where `flip` is 1: (a + pi, -b, c + pi)."""
    if isinstance(flip, int):
        if not flip:
            return angles
        return np.stack(
            [
                angles[..., 0] + np.pi,
                -(angles[..., 1] + triple.zero) - triple.zero,
                angles[..., 2] + np.pi,
            ],
            axis=-1,
        )
    return np.where(np.asarray(flip)[..., None] == 1, _flip(angles, 1, triple), angles)


@dataclass(frozen=True)
class _ArmPlane:
    """What does not depend on the arm angle: direction to the wrist, elbow bend, reference plane."""

    R: FloatArray
    w: FloatArray
    n0: FloatArray
    m0: FloatArray
    bend: FloatArray
    reachable: BoolArray

    @classmethod
    def of(cls, arm: SrsArm, R: FloatArray, p: FloatArray) -> _ArmPlane:
        g = arm.geometry
        w = arm.wrist_center(R, p) - g.shoulder
        r = np.linalg.norm(w, axis=-1)
        a1, a2 = g.upper, g.fore
        x = (r**2 - a1**2 - a2**2) / (2.0 * a1 * a2)
        reachable = (np.abs(x) <= 1.0 + REACH_SLACK) & (r > PARALLEL)
        w = w / np.maximum(r, PARALLEL)[..., None]
        n0 = np.cross(g.axes[0], w)
        length = np.linalg.norm(n0, axis=-1, keepdims=True)
        n0 = np.where(length > PARALLEL, n0 / np.maximum(length, PARALLEL), g.axes[1])
        return cls(R, w, n0, np.cross(w, n0), np.arccos(np.clip(x, -1.0, 1.0)), reachable)


def _rotation(axis: FloatArray, angle: FloatArray) -> FloatArray:
    """Returns rotations about a fixed unit axis, shape (..., 3, 3) (Rodrigues)."""
    K = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0.0]])
    angle = np.asarray(angle)[..., None, None]
    rotation: FloatArray = np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * (K @ K)
    return rotation


def _rotations(axes: FloatArray, q: FloatArray) -> FloatArray:
    """Returns the product of rotations about fixed axes (k, 3) by angles (..., k)."""
    R = _rotation(axes[0], q[..., 0])
    for k in range(1, len(axes)):
        R = R @ _rotation(axes[k], q[..., k])
    return R


def _wrap(angle: FloatArray) -> FloatArray:
    """Returns angles in (-pi, pi]."""
    return -((-angle + np.pi) % (2.0 * np.pi) - np.pi)
