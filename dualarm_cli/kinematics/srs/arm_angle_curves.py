"""Joints as closed-form functions of the arm angle."""

from __future__ import annotations

from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from dualarm_cli.geometry import elementary
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.kinematics.srs.srs_canonical import SrsCanonical
from dualarm_cli.kinematics.srs.srs_limits import wrap
from dualarm_cli.records import dataclass

Scalar = TypeVar("Scalar", bound=np.generic)


@dataclass(frozen=True)
class CurveTolerances:
    """Tolerances of joints over the arm angle, with turn and flip tables.

    The tables are by joint.
    """

    stretched: float = 1e-14
    """Distance within which a wrist centre snaps to an end of its reach [m].

    The bend, a square root of the gap, would otherwise be 1e-8 rad of noise.
    """
    on_axis: float = 1e-12
    """Sine of a direction's angle to the first axis below which they are parallel."""
    turning: tuple[int, ...] = (0, 2, 4, 6)
    """Joints that are an arc tangent of the arm angle: 1, 3, 5 and 7."""
    flipped_by: tuple[int, ...] = (2, 2, 6, 4, 5, 1, 1)
    """Bits of a branch that flip each joint: 4 elbow, 2 shoulder, 1 wrist.

    A flip turns the joint by half a turn, or changes its sign; two of them cancel.
    """
    near_singular: float = 1e-4
    """Sine of a middle joint below which its triple is solved again.

    The second solution keeps all digits there.
    """
    singular: float = 1e-12
    """Sine of a middle joint below which its triple is singular (first joint 0)."""
    slack: float = 1e-11
    """Rounding tolerance of a wrist centre's reach [m]."""


CURVES = CurveTolerances()


@dataclass(frozen=True)
class ArmPlane:
    """Arm planes of targets: shoulder to wrist, elbow circle and bend, component first.

    The elbow moves on a circle about the unit vector u from shoulder to wrist, at the arm angle psi
    from r towards t: h(psi) = r cos psi + t sin psi. Upper arm and forearm then point along
    cos a u + sin a h and cos f u - sin f h, and the elbow's axis along -u × h for a positive bend.
    """

    u: FloatArray
    """Direction from shoulder to wrist, shape (3, ...)."""
    r: FloatArray
    """Direction to the elbow, seen along u, at psi = 0, shape (3, ...)."""
    t: FloatArray
    """u × r, shape (3, ...)."""
    cos_a: FloatArray
    """Cosine of the angle from u to the upper arm, shape (...)."""
    sin_a: FloatArray
    """Its sine, not negative, shape (...)."""
    cos_f: FloatArray
    """Cosine of the angle from the forearm to u, shape (...)."""
    sin_f: FloatArray
    """Its sine, not negative, shape (...)."""
    bend: FloatArray
    """Angle between upper arm and forearm [rad], 0 when stretched, shape (...)."""
    reachable: BoolArray
    """Flags of targets that the links reach, shape (...)."""
    R: FloatArray
    """Canonical flange rotation, shape (3, 3, ...), broadcast against the vectors."""

    @classmethod
    def of(cls, w: FloatArray, R: FloatArray, upper: float, fore: float) -> ArmPlane:
        """Compute the arm planes of wrist centres.

        The law of cosines gives the bend; sine by Heron's product, so that no digits are lost near
        the stretched and the folded arm. Directions follow from the bend, not from |w|, so that
        flange orientations stay exact there. The arm angle of a wrist centre in the shoulder is
        counted about the first axis.

        Args:
            w: from shoulder to wrist in the canonical base frame [m], shape (3, ...).
            R: canonical flange rotation, shape (3, 3, ...).
            upper: length of the upper arm [m].
            fore: length of the forearm [m].
        """
        distance = np.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
        reach, core = upper + fore, abs(upper - fore)
        reachable = (distance <= reach + CURVES.slack) & (distance >= core - CURVES.slack)
        d = np.where(distance < core + CURVES.stretched, core, distance)
        d = np.where(d > reach - CURVES.stretched, reach, d)
        product = 2.0 * upper * fore
        cos_bend = np.clip((d * d - upper * upper - fore * fore) / product, -1.0, 1.0)
        sin_bend = np.sqrt((reach - d) * (reach + d) * (d - core) * (d + core)) / product
        bend = elementary.arctan2(sin_bend, cos_bend)
        along, beside = upper + fore * elementary.cos(bend), fore * elementary.sin(bend)
        tiny = distance < CURVES.slack
        length = np.where(tiny, 1.0, distance)
        u = np.where(tiny, np.array([0.0, 0.0, 1.0]).reshape(3, *(1,) * tiny.ndim), w / length)
        r, t = reference_directions(u)
        a = np.where(tiny, 0.5 * np.pi, elementary.arctan2(beside, along))
        f = bend - a
        return cls(
            u,
            r,
            t,
            elementary.cos(a),
            elementary.sin(a),
            elementary.cos(f),
            elementary.sin(f),
            bend,
            reachable,
            R,
        )

    @cached_property
    def R_plane(self) -> FloatArray:
        """Columns of the flange rotation in the frame (u, r, t), shape (3, 3, ...)."""
        frame = np.stack([self.u, self.r, self.t])
        R = self.R
        # Written out: numpy's matrix products want the matrix last, and all else here is first.
        return np.stack(
            [
                np.stack([v[0] * R[0, k] + v[1] * R[1, k] + v[2] * R[2, k] for k in range(3)])
                for v in frame
            ]
        )

    def select(self, chosen: BoolArray) -> ArmPlane:
        """Select the planes of the chosen elements, one after the other.

        Args:
            chosen: mask of a shape that this broadcasts to.
        """
        return ArmPlane(
            u=_chosen(self.u, 1, chosen),
            r=_chosen(self.r, 1, chosen),
            t=_chosen(self.t, 1, chosen),
            cos_a=_chosen(self.cos_a, 0, chosen),
            sin_a=_chosen(self.sin_a, 0, chosen),
            cos_f=_chosen(self.cos_f, 0, chosen),
            sin_f=_chosen(self.sin_f, 0, chosen),
            bend=_chosen(self.bend, 0, chosen),
            reachable=_chosen(self.reachable, 0, chosen),
            R=_chosen(self.R, 2, chosen),
        )

    def triples(self, sin: FloatArray, cos: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute rotations of shoulder and wrist triple, (3, 3, ...), for positive bend.

        Args:
            sin: sine of the arm angle, shape (...).
            cos: its cosine, shape (...).
        """
        h, m = self.r * cos + self.t * sin, self.t * cos - self.r * sin
        shoulder = np.stack(
            [self.sin_a * self.u - self.cos_a * h, -m, self.cos_a * self.u + self.sin_a * h], axis=1
        )
        fore = np.stack(
            [-self.cos_f * h - self.sin_f * self.u, -m, self.cos_f * self.u - self.sin_f * h]
        )
        wrist: FloatArray = np.einsum(
            "ik...,kj...->ij...", fore, np.broadcast_to(self.R, (3, 3, *fore.shape[2:]))
        )
        return shoulder, wrist


def _chosen(values: NDArray[Scalar], leading: int, chosen: BoolArray) -> NDArray[Scalar]:
    """Select elements of values behind a number of component axes."""
    head, tail = values.shape[:leading], values.shape[leading:]
    padded = values.reshape((*head, *(1,) * (chosen.ndim - len(tail)), *tail))
    return np.broadcast_to(padded, (*head, *chosen.shape))[..., chosen]


def reference_directions(u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compute the reference directions r and t of the arm angle, (3, ...) each.

    r is at psi = 0, t = u × r at psi = pi/2.

    r is the base's x axis carried along by the smallest rotation that takes z (the first axis) to
    u. It is continuous for all u but one, -z: no reference can do better, as there is no continuous
    field of tangents on a sphere, and the plane through the first axis fails at +z too, where arms
    work. With (x, y, z) = u and x = rho c, y = rho s: r = (1 - v c², -v c s, -x), v = 1 - z. At -z
    itself c = 1, s = 0 stands in. Our own derivation; the same field as a stereographic projection
    from -z gives.

    Args:
        u: unit vectors, shape (3, ...).
    """
    x, y, z = u
    rho = np.sqrt(x * x + y * y)
    on_axis = rho < CURVES.on_axis
    length = np.where(on_axis, 1.0, rho)
    c, s = np.where(on_axis, 1.0, x / length), np.where(on_axis, 0.0, y / length)
    v = 1.0 - z
    mixed = -v * c * s
    return np.stack([1.0 - v * c * c, mixed, -x]), np.stack([mixed, 1.0 - v * s * s, -y])


@dataclass(frozen=True)
class ArmAngleCurves:
    """Joints of the branch with theta2, theta4, theta6 >= 0 over the arm angle.

    Every row of coefficients (A, B, C) stands for A sin psi + B cos psi + C. Joints 1, 3, 5 and 7
    are atan2(turning[i, 0], turning[i, 1]), signs and zero offsets included; theta2 and theta6 are
    the arc cosines of `bending`; joint 4 does not depend on psi. [Shimizu2008] has the same form.
    """

    plane: ArmPlane
    """Arm planes of the targets."""
    canonical: SrsCanonical
    """Signs and offsets of the arm."""
    turning: FloatArray
    """Coefficients of the arc-tangent joints, shape (4, 2, 3, ...)."""
    bending: FloatArray
    """Coefficients of the arc-cosine joints, shape (2, 3, ...)."""

    @classmethod
    def of(cls, canonical: SrsCanonical, plane: ArmPlane) -> ArmAngleCurves:
        """Compute the curves of targets (...)."""
        (x, y, z), (rx, ry, rz), (tx, ty, tz) = plane.u, plane.r, plane.t
        ca, sa, cf, sf = plane.cos_a, plane.sin_a, plane.cos_f, plane.sin_f
        (k0u, k1u, k2u), (k0r, k1r, k2r), (k0t, k1t, k2t) = plane.R_plane
        shape = np.broadcast_shapes(ca.shape, k0u.shape)
        turning, bending = np.empty((4, 2, 3, *shape)), np.empty((2, 3, *shape))
        # Entries of Z Y Z: (c1 s2, s1 s2, c2) is the last column, (-s2 c3, s2 s3, c2) the last row.
        _set(turning[0, 0], sa * ty, sa * ry, ca * y)
        _set(turning[0, 1], sa * tx, sa * rx, ca * x)
        _set(bending[0], sa * tz, sa * rz, ca * z)
        _set(turning[1, 0], rz, -tz, 0.0)
        _set(turning[1, 1], ca * tz, ca * rz, -sa * z)
        _set(turning[2, 0], k2r, -k2t, 0.0)
        _set(turning[2, 1], -cf * k2t, -cf * k2r, -sf * k2u)
        _set(bending[1], -sf * k2t, -sf * k2r, cf * k2u)
        _set(turning[3, 0], -sf * k1t, -sf * k1r, cf * k1u)
        _set(turning[3, 1], sf * k0t, sf * k0r, -cf * k0u)
        _settle(canonical, plane, turning)
        for i, joint in enumerate(CURVES.turning):
            sign, offset = canonical.sign[joint], canonical.offset[joint]
            if offset != 0.0:
                c, s = elementary.cos(offset), elementary.sin(offset)
                num, den = turning[i].copy()
                turning[i, 0], turning[i, 1] = num * c - den * s, num * s + den * c
            if sign < 0:
                turning[i, 0] *= -1.0
        return cls(plane, canonical, turning, bending)

    def pairs(self, sin: FloatArray, cos: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
        """Compute plain and flipped values of joints 1 to 7 in (-pi, pi] [rad].

        `flips` says which of the two a branch has.

        Args:
            sin: sine of the arm angle, broadcast against the targets.
            cos: its cosine.
        """
        pairs = []
        for joint, theta in enumerate(self.angles(sin, cos)):
            if joint in CURVES.turning:
                opposite = np.asarray(theta - np.where(theta > 0.0, np.pi, -np.pi))
                # Half a turn back from 1e-17 rounds to -pi.
                np.copyto(opposite, np.pi, where=opposite <= -np.pi)
                pairs.append((theta, opposite))
            else:
                offset = self.canonical.offset[joint]
                both = (theta, -theta)
                pairs.append(
                    both if offset == 0.0 else (wrap(theta - offset), wrap(-theta - offset))
                )
        return pairs

    def angles(self, sin: FloatArray, cos: FloatArray) -> list[FloatArray]:
        """Compute joints 1-7 [rad], each (...), of the branch theta2, theta6 >= 0.

        Joints 1, 3, 5, 7 in (-pi, pi]; for 2, 4, 6 the canonical theta in [0, pi].

        Args:
            sin: sine of the arm angle, broadcast against the targets.
            cos: its cosine.
        """
        sin, cos = np.asarray(sin), np.asarray(cos)
        q = []
        sines = []
        for i in range(4):
            num = _at(self.turning[i, 0], sin, cos)
            den = _at(self.turning[i, 1], sin, cos)
            angle = np.asarray(elementary.arctan2(num, den))
            np.copyto(angle, np.pi, where=angle <= -np.pi)
            q.append(angle)
            if i in (0, 2):
                sines.append(np.asarray(np.sqrt(num * num + den * den)))
        # The arc cosine by its tangent: as exact at 0 and pi as elsewhere.
        middle = [
            np.asarray(elementary.arctan2(sines[j], _at(self.bending[j], sin, cos)))
            for j in range(2)
        ]
        for j in range(2):
            near = sines[j] < CURVES.near_singular
            if near.any():
                self._resolve(j, near, sin, cos, q, middle)
        bend = np.broadcast_to(self.plane.bend, q[0].shape)
        return [q[0], middle[0], q[1], bend, q[2], middle[1], q[3]]

    def _resolve(
        self,
        triple: int,
        near: BoolArray,
        sin: FloatArray,
        cos: FloatArray,
        q: list[FloatArray],
        middle: list[FloatArray],
    ) -> None:
        """Overwrite a triple's outer joints if its middle joint is nearly 0 or pi.

        The outer joints are each ill-determined there, their sum (or difference) is not: the last
        one is computed from the first, which is set to 0 where nothing determines it.
        """
        sin = np.broadcast_to(sin, near.shape)[near]
        cos = np.broadcast_to(cos, near.shape)[near]
        M = self.plane.select(near).triples(sin, cos)[triple]
        first, last = 2 * triple, 2 * triple + 1
        sign, offset = self.canonical.sign, self.canonical.offset
        s2 = np.hypot(M[0, 2], M[1, 2])
        joint = q[first][near]
        joint[s2 < CURVES.singular] = 0.0
        theta = sign[CURVES.turning[first]] * joint + offset[CURVES.turning[first]]
        s, c = elementary.sin(theta), elementary.cos(theta)
        # Y Z = Z(-theta) M has (s, c) of its last angle in its second row.
        angle = elementary.arctan2(c * M[1, 0] - s * M[0, 0], c * M[1, 1] - s * M[0, 1])
        # Signed: theta2 may come out an ulp below zero where the first joint was set.
        bent = elementary.arctan2(c * M[0, 2] + s * M[1, 2], M[2, 2])
        q[first][near] = joint
        q[last][near] = wrap(sign[CURVES.turning[last]] * (angle - offset[CURVES.turning[last]]))
        middle[triple][near] = bent


def flips(joint: int, branch: IntArray) -> BoolArray:
    """Return whether branches (...) take the second of a joint's two values, shape (...).

    Args:
        joint: counted from 0.
        branch: 0 to 7, shape (...).
    """
    bits = branch & CURVES.flipped_by[joint]
    odd: BoolArray = ((bits >> 2) ^ (bits >> 1) ^ bits) & 1 == 1
    return odd


def _settle(canonical: SrsCanonical, plane: ArmPlane, turning: FloatArray) -> None:
    """Overwrite the curves of singular triples at each arm angle.

    They are those of a stretched arm.

    Their outer joints turn about one line: the first is 0 and the last has all of the turn.
    """
    x, y, _ = plane.u
    (k0u, k1u, _), (k0r, k1r, k2r), (k0t, k1t, k2t) = plane.R_plane
    ca, sa, cf, sf = plane.cos_a, plane.sin_a, plane.cos_f, plane.sin_f
    shoulder = sa + np.hypot(x, y) < CURVES.singular
    wrist = sf + np.hypot(k2r, k2t) < CURVES.singular
    # The second row of Z(-theta) M, as functions of psi, for the theta of a first joint at 0.
    if shoulder.any():
        _, ry, _ = plane.r
        _, ty, _ = plane.t
        rows = [[-ca * ty, -ca * ry, sa * y], [ry, -ty, 0.0 * y]]
        _overwrite(turning[0:2], shoulder, rows, 0.0)
    if wrist.any():
        s, c = elementary.sin(canonical.offset[4]), elementary.cos(canonical.offset[4])
        rows = [
            [c * kr + s * cf * kt, -c * kt + s * cf * kr, s * sf * ku]
            for ku, kr, kt in ((k0u, k0r, k0t), (k1u, k1r, k1t))
        ]
        _overwrite(turning[2:4], wrist, rows, canonical.offset[4])


def _overwrite(
    turning: FloatArray, chosen: BoolArray, rows: list[list[FloatArray]], theta: float
) -> None:
    """Set a constant first joint and given last-joint rows for chosen elements."""
    # Short, so that the sine of the middle joint, which is their length, stays next to nothing.
    first = np.square(CURVES.singular) * np.array([elementary.sin(theta), elementary.cos(theta)])
    for k in range(2):
        for j in range(3):
            turning[0, k, j] = np.where(chosen, first[k] if j == 2 else 0.0, turning[0, k, j])
            turning[1, k, j] = np.where(chosen, rows[k][j], turning[1, k, j])


def _set(
    row: FloatArray, a: FloatArray | float, b: FloatArray | float, c: FloatArray | float
) -> None:
    row[0], row[1], row[2] = a, b, c


def _at(row: FloatArray, sin: FloatArray, cos: FloatArray) -> FloatArray:
    """Compute A sin + B cos + C."""
    value: FloatArray = row[0] * sin
    value = value + row[1] * cos
    value += row[2]
    return value
