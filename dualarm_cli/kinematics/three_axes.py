"""The first three axes of an arm and the point that they carry: measured, and of which family they are."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, readonly

Family = Literal["elbow", "two_steps", "quartic"]

PARALLEL = 1e-7
"""Sine of the angle of two axes below which they count as parallel."""
MEETING = 1e-9
"""Distance of two axes below which they meet [m]; first harmonics below it are none [m, m²]."""
LEAST_LINK = 1e-6
"""Shortest link of an elbow [m]."""
LEAST_PRODUCT = 1e-3
"""Least distance of axes 1 and 2 times the sine of their angle for which the quartic keeps its digits [m]."""


@dataclass(frozen=True)
class ThreeAxes:
    """Three revolute axes and a point beyond the third, in frames whose z is the axis (as in GeneralArm).

    The origins of frames 1 and 2 are moved along their axes to the feet of the common normal of axes 1 and 2, so that
    R12^T p12 is the normal itself: across both axes, of the length of their distance.
    """

    R1: FloatArray
    """Frame 1 in the frame that carries the arm, joint 1 at zero, shape (3, 3)."""
    p1: FloatArray
    """Its origin [m], shape (3,)."""
    R12: FloatArray
    """Frame 2, joint 2 at zero, in frame 1, shape (3, 3)."""
    p12: FloatArray
    """Its origin in frame 1 [m]: across axis 1, shape (3,)."""
    R23: FloatArray
    """Frame 3, joint 3 at zero, in frame 2, shape (3, 3)."""
    p23: FloatArray
    """Its origin in frame 2 [m], shape (3,)."""
    point: FloatArray
    """What is carried, in frame 3 [m], shape (3,)."""

    def __post_init__(self) -> None:
        """Freezes the arrays."""
        for name in self.__dataclass_fields__:
            object.__setattr__(self, name, readonly(getattr(self, name)))

    @classmethod
    def of(cls, R: FloatArray, p: FloatArray, point: FloatArray) -> ThreeAxes:
        """Measures axes.

        Args:
            R: constant rotation before each joint's motion, shape (3, 3, 3).
            p: constant translation before each joint's motion [m], shape (3, 3).
            point: what is carried, in frame 3 [m], shape (3,).
        """
        across = R[1][:2, 2]
        sine2 = float(across @ across)
        # Parallel axes have normals everywhere.
        shift = -float(p[1][:2] @ across) / sine2 if sine2 > PARALLEL**2 else 0.0
        p12 = p[1] + shift * R[1][:, 2]
        p23 = p[2] - np.array([0.0, 0.0, shift])
        p1 = p[0] + R[0][:, 2] * p12[2]
        return cls(R[0], p1, R[1], p12 * [1.0, 1.0, 0.0], R[2], p23, point)

    @cached_property
    def axis1(self) -> complex:
        """The part of axis 1 across axis 2, in frame 2 as a complex number: its modulus is the sine of their angle."""
        return complex(self.R12[2, 0], self.R12[2, 1])

    @cached_property
    def normal(self) -> complex:
        """The common normal of axes 1 and 2, in frame 2 as a complex number [m]."""
        u = self.R12.T @ self.p12
        return complex(u[0], u[1])

    @cached_property
    def circle(self) -> FloatArray:
        """The point in frame 2, joint 2 at zero, over joint 3: rows times (1, cos, sin) [m], shape (3, 3)."""
        x, y, z = self.point
        R = self.R23
        return readonly(
            np.array([self.p23 + R[:, 2] * z, R[:, 0] * x + R[:, 1] * y, R[:, 1] * x - R[:, 0] * y])
        )

    @cached_property
    def squared(self) -> FloatArray:
        """Squared distance of the point from frame 2's origin, over joint 3: times (1, cos, sin) [m²], shape (3,)."""
        c, a, b = self.circle
        return readonly([c @ c + a @ a, 2.0 * c @ a, 2.0 * c @ b])

    @cached_property
    def family(self) -> Family | None:
        """Which closed form serves; None for axes that do not carry the point through a volume.

        elbow: axes 2 and 3 parallel. two_steps: axes 1 and 2 meet or are parallel, so that joint 3 follows by itself.
        quartic: any other three ([Pieper1968]) whose axes 1 and 2 do not nearly meet or are nearly parallel: None too.
        """
        crossed = abs(self.axis1) > PARALLEL
        if float(np.hypot(*self.R23[:2, 2])) <= PARALLEL:
            links = min(abs(complex(*self.p23[:2])), abs(complex(*self.point[:2])))
            return "elbow" if crossed and links > LEAST_LINK else None
        if not crossed:
            lifts = min(float(np.hypot(*self.circle[1:, 2])), abs(self.normal)) > MEETING
            return "two_steps" if lifts else None
        if abs(self.normal) <= MEETING:
            return "two_steps" if float(np.hypot(*self.squared[1:])) > MEETING else None
        moves = np.abs(self.circle[1:, 2]).max() + np.abs(self.squared[1:]).max()
        told = abs(self.normal) * abs(self.axis1) >= LEAST_PRODUCT
        return "quartic" if told and float(moves) > MEETING else None

    @cached_property
    def neglected(self) -> float:
        """What the family takes for 0 and is not quite [m or rad]; inf where zeros are not computed to rounding."""
        if self.family == "elbow":
            return float(np.hypot(*self.R23[:2, 2]))
        if self.family == "two_steps":
            return min(abs(self.axis1), abs(self.normal))
        return np.inf

    def place(self, q: FloatArray) -> FloatArray:
        """Returns where the point is with joint 1 at zero, in frame 1 [m], shape (..., 3).

        Args:
            q: joints 2 and 3 [rad], shape (..., 2).
        """
        c, s = np.cos(q), np.sin(q)
        f = self.circle[0] + c[..., 1:] * self.circle[1] + s[..., 1:] * self.circle[2]
        x = c[..., 0] * f[..., 0] - s[..., 0] * f[..., 1]
        y = s[..., 0] * f[..., 0] + c[..., 0] * f[..., 1]
        found: FloatArray = np.stack([x, y, f[..., 2]], axis=-1) @ self.R12.T + self.p12
        return found

    def section(self, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Returns how far the point is from axis 1 and along it [m], (b, 2), with derivatives (b, 2, 2), (b, 2, 2, 2).

        Args:
            q: joints 2 and 3 [rad], shape (b, 2).
        """
        c, s = np.cos(q), np.sin(q)
        own, a, b = self.circle
        f = own + c[:, 1:] * a + s[:, 1:] * b
        df, ddf = c[:, 1:] * b - s[:, 1:] * a, -(c[:, 1:] * a + s[:, 1:] * b)
        # Rows of Rz(q2) and its derivatives on f and its derivatives: place, then by (2), (3), (2, 2), (2, 3), (3, 3).
        x, y, z = np.stack([f, f, df, f, df, ddf]).transpose(2, 0, 1)
        cos = np.stack([c[:, 0], -s[:, 0], c[:, 0], -c[:, 0], -s[:, 0], c[:, 0]])
        sin = np.stack([s[:, 0], c[:, 0], s[:, 0], -s[:, 0], c[:, 0], s[:, 0]])
        z = z * np.array([1.0, 0.0, 1.0, 0.0, 0.0, 1.0])[:, None]
        h = np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=-1) @ self.R12.T
        h[0] += self.p12
        r = np.maximum(np.hypot(h[0, :, 0], h[0, :, 1]), 1e-12)
        toward = h[0, :, :2] / r[:, None]
        radial = (h[1:, :, :2] * toward).sum(axis=-1)
        # The radius bends by what goes across it as well.
        aside = h[1:3, :, 1] * toward[:, 0] - h[1:3, :, 0] * toward[:, 1]
        bent = radial[2:] + np.stack([aside[0] ** 2, aside[0] * aside[1], aside[1] ** 2]) / r
        at = np.stack([r, h[0, :, 2]], axis=1)
        slope = np.stack([radial[:2].T, h[1:3, :, 2].T], axis=1)
        both = np.stack([bent.T, h[3:, :, 2].T], axis=1)
        return at, slope, both[..., [0, 1, 1, 2]].reshape(len(q), 2, 2, 2)
