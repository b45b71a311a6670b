"""What a target fixes before an arm angle is chosen: shoulder-wrist line, reference, elbow bend."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from dualarm_cli.geometry.arrays import BoolArray, FloatArray

Scalar = TypeVar("Scalar", bound=np.generic)

REACH_SLACK = 1e-11
"""How far a wrist centre may be out of reach by rounding [m]."""
STRETCHED = 1e-14
"""A wrist centre this close to the end of its reach is taken to be there [m]: the bend, a square
root of the gap, would otherwise be 1e-8 rad of noise."""
ON_AXIS = 1e-12
"""Below this sine of its angle to the first axis a direction counts as lying on it."""


@dataclass(frozen=True)
class ArmPlane:
    """Targets in canonical frames, component first: vectors (3, ...), rotations (3, 3, ...).

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
    """Whether the links reach, shape (...)."""
    R: FloatArray
    """Canonical flange rotation, shape (3, 3, ...), broadcast against the vectors."""

    @classmethod
    def of(cls, w: FloatArray, R: FloatArray, upper: float, fore: float) -> ArmPlane:
        """Returns the arm planes of wrist centres.

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
        reachable = (distance <= reach + REACH_SLACK) & (distance >= core - REACH_SLACK)
        d = np.where(distance < core + STRETCHED, core, distance)
        d = np.where(d > reach - STRETCHED, reach, d)
        product = 2.0 * upper * fore
        cos_bend = np.clip((d * d - upper * upper - fore * fore) / product, -1.0, 1.0)
        sin_bend = np.sqrt((reach - d) * (reach + d) * (d - core) * (d + core)) / product
        bend = np.arctan2(sin_bend, cos_bend)
        along, beside = upper + fore * np.cos(bend), fore * np.sin(bend)
        tiny = distance < REACH_SLACK
        length = np.where(tiny, 1.0, distance)
        u = np.where(tiny, np.array([0.0, 0.0, 1.0]).reshape(3, *(1,) * tiny.ndim), w / length)
        r, t = reference_directions(u)
        a = np.where(tiny, 0.5 * np.pi, np.arctan2(beside, along))
        f = bend - a
        return cls(u, r, t, np.cos(a), np.sin(a), np.cos(f), np.sin(f), bend, reachable, R)

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
        """Returns the planes of the chosen elements, one after the other.

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
        """Returns the rotations of shoulder and wrist triple, (3, 3, ...), for a positive bend.

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
    """Returns the chosen elements of values with a number of component axes in front."""
    head, tail = values.shape[:leading], values.shape[leading:]
    padded = values.reshape((*head, *(1,) * (chosen.ndim - len(tail)), *tail))
    return np.broadcast_to(padded, (*head, *chosen.shape))[..., chosen]


def reference_directions(u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Returns r and t = u × r, (3, ...) each: where psi = 0 and psi = pi/2 point, seen along u.

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
    on_axis = rho < ON_AXIS
    length = np.where(on_axis, 1.0, rho)
    c, s = np.where(on_axis, 1.0, x / length), np.where(on_axis, 0.0, y / length)
    v = 1.0 - z
    mixed = -v * c * s
    return np.stack([1.0 - v * c * c, mixed, -x]), np.stack([mixed, 1.0 - v * s * s, -y])
