"""Contours of feature curves: where pipes and spheres meet, ellipses, lines."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, readonly
from dualarm_cli.geometry.elementary import cos, cube, power, sin
from dualarm_cli.records import dataclass

NODES = 2049
"""Nodes at which contours are measured."""
EVEN = readonly(np.linspace(0.0, 1.0, NODES))
"""Nodes of a contour that is equally smooth everywhere."""


class Contour(Protocol):
    """A smooth curve on a surface, by a parameter from 0 to 1."""

    def point(self, t: FloatArray) -> FloatArray:
        """Returns points (k, 3) [m] at parameters (k,)."""

    def rate(self, t: FloatArray) -> FloatArray:
        """Returns their derivatives by the parameter (k, 3) [m]."""

    def second(self, t: FloatArray) -> FloatArray:
        """Returns their second derivatives by the parameter (k, 3) [m]."""

    def third_bound(self, t: FloatArray, half: FloatArray) -> FloatArray:
        """Returns what the third derivative's length does not exceed (k,) [m] within `half` (k,) of parameters (k,)."""

    @property
    def nodes(self) -> FloatArray:
        """Parameters from 0 to 1 between which it is smooth, close enough to measure it."""

    def normal(self, t: FloatArray) -> FloatArray:
        """Returns vectors (k, 3) that point out of the surface there, of any length."""


@dataclass(frozen=True)
class _Branch:
    """A branch pipe that meets another body."""

    main_radius: float
    """Radius of the other body, R [m]."""
    branch_radius: float
    """Radius of the branch pipe, r [m]."""
    angle: float
    """Turn of the branch pipe's axis, alpha [rad]."""
    eccentricity: float
    """Distance of its axis from the other body's axis or centre, e [m]."""
    start: float
    """Angle about the branch pipe where the contour begins, beta [rad]."""
    end: float
    """Angle about the branch pipe where it ends [rad]; below the start it goes the other way round."""

    def _beta(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Returns cosine and sine of the angle about the branch pipe."""
        beta = self.start + t * (self.end - self.start)
        return cos(beta), sin(beta)

    @property
    def nodes(self) -> FloatArray:
        """Even ones."""
        return EVEN


@dataclass(frozen=True)
class Saddle(_Branch):
    """Where a branch pipe meets a main pipe: [Qin2024] Eq. 12.

    The main pipe's axis is z. The branch pipe's frame is shifted by the eccentricity along y, then turned about y, so
    that its axis leans from z towards x; the normal is the main pipe's. r is at most R less the eccentricity.
    """

    def point(self, t: FloatArray) -> FloatArray:
        """Returns points (k, 3) [m] at parameters (k,)."""
        c, s = self._beta(t)
        ca, sa = cos(self.angle), sin(self.angle)
        y = self.branch_radius * s + self.eccentricity
        x = np.sqrt(np.square(self.main_radius) - np.square(y))
        # Eq. 12: z on the branch pipe is (x - r cos beta cos alpha) / sin alpha in its own frame.
        along = (x - self.branch_radius * c * ca) / sa
        z = -self.branch_radius * c * sa + along * ca
        return np.stack([x, y, z], axis=-1)

    def rate(self, t: FloatArray) -> FloatArray:
        """Returns their derivatives by the parameter (k, 3) [m]."""
        c, s = self._beta(t)
        r, ca, sa = self.branch_radius, cos(self.angle), sin(self.angle)
        y = r * s + self.eccentricity
        dy = r * c
        dx = -y * dy / np.sqrt(np.square(self.main_radius) - np.square(y))
        dz = r * s * sa + (dx + r * s * ca) / sa * ca
        found: FloatArray = np.stack([dx, dy, dz], axis=-1) * (self.end - self.start)
        return found

    def second(self, t: FloatArray) -> FloatArray:
        """Returns their second derivatives by the parameter (k, 3) [m]."""
        c, s = self._beta(t)
        r, sa = self.branch_radius, sin(self.angle)
        y = r * s + self.eccentricity
        x = np.sqrt(np.square(self.main_radius) - np.square(y))
        ddx = y / x * r * s - np.square(self.main_radius) * np.square(r * c) / cube(x)
        # z is x cot alpha - r cos beta / sin alpha.
        ddz = (ddx * cos(self.angle) + r * c) / sa
        found: FloatArray = np.stack([ddx, -r * s, ddz], axis=-1) * np.square(self.end - self.start)
        return found

    def third_bound(self, t: FloatArray, half: FloatArray) -> FloatArray:
        """Returns what the third derivative's length does not exceed (k,) [m] within `half` (k,) of parameters (k,).

        x = f(y) with f(y)² = R² - y² and y' = r cos beta, so that x''' = f''' y'³ + 3 f'' y' y'' + f' y'''.
        """
        c, s = self._beta(t)
        r, R, turn = self.branch_radius, self.main_radius, abs(self.end - self.start)
        cosine = np.minimum(np.abs(c) + half * turn, 1.0)
        y = np.abs(r * s + self.eccentricity) + r * cosine * half * turn
        y = np.minimum(y, r + abs(self.eccentricity))
        x = np.sqrt(np.square(R) - np.square(y))
        dddx = 3.0 * np.square(R) * y * cube(r * cosine) / power(x, 5)
        dddx = dddx + 3.0 * np.square(R) * np.square(r) * cosine / cube(x) + y * r * cosine / x
        dddz = (dddx * abs(cos(self.angle)) + r) / abs(sin(self.angle))
        found: FloatArray = np.sqrt(np.square(dddx) + np.square(r) + np.square(dddz)) * cube(turn)
        return found

    def normal(self, t: FloatArray) -> FloatArray:
        """Returns the main pipe's outward normals (k, 3)."""
        found: FloatArray = self.point(t) * np.array([1.0, 1.0, 0.0])
        return found


@dataclass(frozen=True)
class SphereArc(_Branch):
    """Where a branch pipe meets a sphere: [Qin2024] Eq. 11, with the sphere in place of its third coordinate.

    The pipe's frame is shifted by the eccentricity along x, then turned about x; with no eccentricity it is a circle.
    """

    def _turned(self, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        ca, sa = cos(self.angle), sin(self.angle)
        return np.stack([x, y * ca - z * sa, y * sa + z * ca], axis=-1)

    def point(self, t: FloatArray) -> FloatArray:
        """Returns points (k, 3) [m] at parameters (k,)."""
        c, s = self._beta(t)
        x, y = self.branch_radius * c + self.eccentricity, self.branch_radius * s
        return self._turned(
            x, y, np.sqrt(np.square(self.main_radius) - np.square(x) - np.square(y))
        )

    def rate(self, t: FloatArray) -> FloatArray:
        """Returns their derivatives by the parameter (k, 3) [m]."""
        c, s = self._beta(t)
        x, y = self.branch_radius * c + self.eccentricity, self.branch_radius * s
        dx, dy = -self.branch_radius * s, self.branch_radius * c
        dz = -(x * dx + y * dy) / np.sqrt(np.square(self.main_radius) - np.square(x) - np.square(y))
        found: FloatArray = self._turned(dx, dy, dz) * (self.end - self.start)
        return found

    def second(self, t: FloatArray) -> FloatArray:
        """Returns their second derivatives by the parameter (k, 3) [m]."""
        c, s = self._beta(t)
        r, e = self.branch_radius, self.eccentricity
        z = np.sqrt(np.square(self.main_radius) - np.square(r) - np.square(e) - 2.0 * r * e * c)
        # z² = R² - r² - e² - 2 r e cos beta, so that z' = r e sin beta / z.
        ddz = r * e * c / z - np.square(r * e * s) / cube(z)
        found: FloatArray = self._turned(-r * c, -r * s, ddz) * np.square(self.end - self.start)
        return found

    def third_bound(self, t: FloatArray, half: FloatArray) -> FloatArray:
        """Returns what the third derivative's length does not exceed (k,) [m] within `half` (k,) of parameters (k,).

        With q = z²: z''' = q''' / 2z - 3 q' q'' / 4z³ + 3 q'³ / 8z⁵.
        """
        turn = abs(self.end - self.start)
        c, s = self._beta(t)
        r, e = self.branch_radius, abs(self.eccentricity)
        sine = np.minimum(np.abs(s) + half * turn, 1.0)
        square = (
            np.square(self.main_radius)
            - np.square(r)
            - np.square(e)
            - 2.0 * r * self.eccentricity * c
        )
        least = np.square(self.main_radius) - np.square(r + e)
        z = np.sqrt(np.maximum(square - 2.0 * r * e * sine * half * turn, least))
        dddz = (
            r * e * sine / z
            + 3.0 * np.square(r * e) * sine / cube(z)
            + 3.0 * cube(r * e * sine) / power(z, 5)
        )
        found: FloatArray = np.hypot(r, dddz) * cube(turn)
        return found

    def normal(self, t: FloatArray) -> FloatArray:
        """Returns the sphere's outward normals (k, 3)."""
        return self.point(t)


@dataclass(frozen=True)
class Ellipse:
    """An ellipse, or a circle, about the origin in the plane z = 0."""

    semi_axes: tuple[float, float]
    """Along x and y [m]."""
    start: float
    """Its own angle where it begins [rad]: x = a cos, y = b sin."""
    end: float
    """Its own angle where it ends [rad]."""
    outward: bool = False
    """Whether the tool comes from outside, in the plane; else from above, along z."""

    def point(self, t: FloatArray) -> FloatArray:
        """Returns points (k, 3) [m] at parameters (k,)."""
        u = self.start + t * (self.end - self.start)
        a, b = self.semi_axes
        return np.stack([a * cos(u), b * sin(u), np.zeros_like(u)], axis=-1)

    def rate(self, t: FloatArray) -> FloatArray:
        """Returns their derivatives by the parameter (k, 3) [m]."""
        u = self.start + t * (self.end - self.start)
        a, b = self.semi_axes
        found: FloatArray = np.stack([-a * sin(u), b * cos(u), np.zeros_like(u)], axis=-1)
        return found * (self.end - self.start)

    def second(self, t: FloatArray) -> FloatArray:
        """Returns their second derivatives by the parameter (k, 3) [m]."""
        return -self.point(t) * np.square(self.end - self.start)

    def third_bound(self, t: FloatArray, half: FloatArray) -> FloatArray:
        """Returns what the third derivative's length does not exceed (k,) [m] anywhere."""
        return np.full(len(t), max(self.semi_axes) * cube(abs(self.end - self.start)))

    @property
    def nodes(self) -> FloatArray:
        """Even ones."""
        return EVEN

    def normal(self, t: FloatArray) -> FloatArray:
        """Returns z, or in the plane what points away from the ellipse, (k, 3)."""
        if not self.outward:
            return np.tile([0.0, 0.0, 1.0], (len(t), 1))
        x, y, z = self.point(t).T
        a, b = self.semi_axes
        return np.stack([x / np.square(a), y / np.square(b), z], axis=-1)


@dataclass(frozen=True)
class LineContour:
    """A straight line."""

    start: FloatArray
    """Where it begins [m], shape (3,)."""
    end: FloatArray
    """Where it ends [m], shape (3,)."""
    up: FloatArray
    """Out of the surface, not along the line, shape (3,)."""

    def __post_init__(self) -> None:
        """Freezes the arrays."""
        for name in ("start", "end", "up"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    def point(self, t: FloatArray) -> FloatArray:
        """Returns points (k, 3) [m] at parameters (k,)."""
        found: FloatArray = self.start + t[:, None] * (self.end - self.start)
        return found

    def rate(self, t: FloatArray) -> FloatArray:
        """Returns their derivatives by the parameter (k, 3) [m]."""
        return np.tile(self.end - self.start, (len(t), 1))

    def second(self, t: FloatArray) -> FloatArray:
        """Returns zeros (k, 3)."""
        return np.zeros((len(t), 3))

    def third_bound(self, t: FloatArray, half: FloatArray) -> FloatArray:
        """Returns zeros (k,)."""
        return np.zeros(len(t))

    @property
    def nodes(self) -> FloatArray:
        """Even ones."""
        return EVEN

    def normal(self, t: FloatArray) -> FloatArray:
        """Returns the surface's normal (k, 3)."""
        return np.tile(self.up, (len(t), 1))
