"""Contours of feature curves: intersections of pipes and spheres, ellipses, lines."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, readonly
from dualarm_cli.geometry.elementary import cos, cube, power, sin
from dualarm_cli.records import dataclass

NODES = 2049
"""Number of nodes at which contours are measured."""
EVEN = readonly(np.linspace(0.0, 1.0, NODES))
"""Nodes of a contour that is equally smooth everywhere."""


class Contour(Protocol):
    """Smooth curve on a surface, with a parameter from 0 to 1."""

    def point(self, t: FloatArray) -> FloatArray:
        """Compute points (k, 3) [m] at parameters (k,)."""

    def rate(self, t: FloatArray) -> FloatArray:
        """Compute first derivatives by the parameter (k, 3) [m]."""

    def second(self, t: FloatArray) -> FloatArray:
        """Compute second derivatives by the parameter (k, 3) [m]."""

    def third_bound(self, t: FloatArray, half: FloatArray) -> FloatArray:
        """Bound the norm of the third derivative within `half` of parameters (k,) [m]."""

    @property
    def nodes(self) -> FloatArray:
        """Parameters from 0 to 1 between which the curve is smooth."""

    def normal(self, t: FloatArray) -> FloatArray:
        """Compute outward vectors of the surface (k, 3), of any length."""


@dataclass(frozen=True)
class _Branch:
    """Branch pipe that intersects another body."""

    main_radius: float
    """Radius of the other body, R [m]."""
    branch_radius: float
    """Radius of the branch pipe, r [m]."""
    angle: float
    """Angle of the branch pipe's axis, alpha [rad]."""
    eccentricity: float
    """Distance of its axis from the other body's axis or centre, e [m]."""
    start: float
    """Angle about the branch pipe at the start, beta [rad]."""
    end: float
    """Angle about the branch pipe at the end [rad]; below the start the direction reverses."""

    def _beta(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute cosine and sine of the angle about the branch pipe."""
        beta = self.start + t * (self.end - self.start)
        return cos(beta), sin(beta)

    @property
    def nodes(self) -> FloatArray:
        """Nodes at equal steps."""
        return EVEN


@dataclass(frozen=True)
class Saddle(_Branch):
    """Intersection of a branch pipe with a main pipe: [Qin2024] Eq. 12.

    The main pipe's axis is z. The branch pipe's frame is shifted by the eccentricity along y, then turned about y, so
    that its axis leans from z towards x; the normal is the main pipe's. r is at most R less the eccentricity.
    """

    def point(self, t: FloatArray) -> FloatArray:
        """Compute points (k, 3) [m] at parameters (k,)."""
        c, s = self._beta(t)
        ca, sa = cos(self.angle), sin(self.angle)
        y = self.branch_radius * s + self.eccentricity
        x = np.sqrt(np.square(self.main_radius) - np.square(y))
        # Eq. 12: z on the branch pipe is (x - r cos beta cos alpha) / sin alpha in its own frame.
        along = (x - self.branch_radius * c * ca) / sa
        z = -self.branch_radius * c * sa + along * ca
        return np.stack([x, y, z], axis=-1)

    def rate(self, t: FloatArray) -> FloatArray:
        """Compute first derivatives by the parameter (k, 3) [m]."""
        c, s = self._beta(t)
        r, ca, sa = self.branch_radius, cos(self.angle), sin(self.angle)
        y = r * s + self.eccentricity
        dy = r * c
        dx = -y * dy / np.sqrt(np.square(self.main_radius) - np.square(y))
        dz = r * s * sa + (dx + r * s * ca) / sa * ca
        derivative: FloatArray = np.stack([dx, dy, dz], axis=-1) * (self.end - self.start)
        return derivative

    def second(self, t: FloatArray) -> FloatArray:
        """Compute second derivatives by the parameter (k, 3) [m]."""
        c, s = self._beta(t)
        r, sa = self.branch_radius, sin(self.angle)
        y = r * s + self.eccentricity
        x = np.sqrt(np.square(self.main_radius) - np.square(y))
        ddx = y / x * r * s - np.square(self.main_radius) * np.square(r * c) / cube(x)
        # z is x cot alpha - r cos beta / sin alpha.
        ddz = (ddx * cos(self.angle) + r * c) / sa
        derivative: FloatArray = np.stack([ddx, -r * s, ddz], axis=-1) * np.square(
            self.end - self.start
        )
        return derivative

    def third_bound(self, t: FloatArray, half: FloatArray) -> FloatArray:
        """Bound the norm of the third derivative within `half` of parameters (k,) [m].

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
        bound: FloatArray = np.sqrt(np.square(dddx) + np.square(r) + np.square(dddz)) * cube(turn)
        return bound

    def normal(self, t: FloatArray) -> FloatArray:
        """Compute the main pipe's outward normals (k, 3)."""
        outward: FloatArray = self.point(t) * np.array([1.0, 1.0, 0.0])
        return outward


@dataclass(frozen=True)
class SphereArc(_Branch):
    """Intersection of a branch pipe with a sphere: [Qin2024] Eq. 11.

    The sphere's equation replaces the third coordinate there.

    The pipe's frame is shifted by the eccentricity along x, then turned about x; with no eccentricity it is a circle.
    """

    def _turned(self, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        ca, sa = cos(self.angle), sin(self.angle)
        return np.stack([x, y * ca - z * sa, y * sa + z * ca], axis=-1)

    def point(self, t: FloatArray) -> FloatArray:
        """Compute points (k, 3) [m] at parameters (k,)."""
        c, s = self._beta(t)
        x, y = self.branch_radius * c + self.eccentricity, self.branch_radius * s
        return self._turned(
            x, y, np.sqrt(np.square(self.main_radius) - np.square(x) - np.square(y))
        )

    def rate(self, t: FloatArray) -> FloatArray:
        """Compute first derivatives by the parameter (k, 3) [m]."""
        c, s = self._beta(t)
        x, y = self.branch_radius * c + self.eccentricity, self.branch_radius * s
        dx, dy = -self.branch_radius * s, self.branch_radius * c
        dz = -(x * dx + y * dy) / np.sqrt(np.square(self.main_radius) - np.square(x) - np.square(y))
        derivative: FloatArray = self._turned(dx, dy, dz) * (self.end - self.start)
        return derivative

    def second(self, t: FloatArray) -> FloatArray:
        """Compute second derivatives by the parameter (k, 3) [m]."""
        c, s = self._beta(t)
        r, e = self.branch_radius, self.eccentricity
        z = np.sqrt(np.square(self.main_radius) - np.square(r) - np.square(e) - 2.0 * r * e * c)
        # z² = R² - r² - e² - 2 r e cos beta, so that z' = r e sin beta / z.
        ddz = r * e * c / z - np.square(r * e * s) / cube(z)
        derivative: FloatArray = self._turned(-r * c, -r * s, ddz) * np.square(
            self.end - self.start
        )
        return derivative

    def third_bound(self, t: FloatArray, half: FloatArray) -> FloatArray:
        """Bound the norm of the third derivative within `half` of parameters (k,) [m].

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
        bound: FloatArray = np.hypot(r, dddz) * cube(turn)
        return bound

    def normal(self, t: FloatArray) -> FloatArray:
        """Compute the sphere's outward normals (k, 3)."""
        return self.point(t)


@dataclass(frozen=True)
class Ellipse:
    """Ellipse or circle about the origin in the plane z = 0."""

    semi_axes: tuple[float, float]
    """Semi-axes along x and y [m]."""
    start: float
    """Parametric angle at the start [rad]: x = a cos, y = b sin."""
    end: float
    """Parametric angle at the end [rad]."""
    outward: bool = False
    """Whether normals are in the plane and point outwards; otherwise they are along z."""

    def point(self, t: FloatArray) -> FloatArray:
        """Compute points (k, 3) [m] at parameters (k,)."""
        u = self.start + t * (self.end - self.start)
        a, b = self.semi_axes
        return np.stack([a * cos(u), b * sin(u), np.zeros_like(u)], axis=-1)

    def rate(self, t: FloatArray) -> FloatArray:
        """Compute first derivatives by the parameter (k, 3) [m]."""
        u = self.start + t * (self.end - self.start)
        a, b = self.semi_axes
        derivative: FloatArray = np.stack([-a * sin(u), b * cos(u), np.zeros_like(u)], axis=-1)
        return derivative * (self.end - self.start)

    def second(self, t: FloatArray) -> FloatArray:
        """Compute second derivatives by the parameter (k, 3) [m]."""
        return -self.point(t) * np.square(self.end - self.start)

    def third_bound(self, t: FloatArray, half: FloatArray) -> FloatArray:
        """Bound the norm of the third derivative anywhere (k,) [m]."""
        return np.full(len(t), max(self.semi_axes) * cube(abs(self.end - self.start)))

    @property
    def nodes(self) -> FloatArray:
        """Nodes at equal steps."""
        return EVEN

    def normal(self, t: FloatArray) -> FloatArray:
        """Compute normals (k, 3): along z, or outwards in the plane."""
        if not self.outward:
            return np.tile([0.0, 0.0, 1.0], (len(t), 1))
        x, y, z = self.point(t).T
        a, b = self.semi_axes
        return np.stack([x / np.square(a), y / np.square(b), z], axis=-1)


@dataclass(frozen=True)
class LineContour:
    """Straight line."""

    start: FloatArray
    """Start point [m], shape (3,)."""
    end: FloatArray
    """End point [m], shape (3,)."""
    up: FloatArray
    """Outward vector of the surface, not parallel to the line, shape (3,)."""

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for name in ("start", "end", "up"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    def point(self, t: FloatArray) -> FloatArray:
        """Compute points (k, 3) [m] at parameters (k,)."""
        points: FloatArray = self.start + t[:, None] * (self.end - self.start)
        return points

    def rate(self, t: FloatArray) -> FloatArray:
        """Compute first derivatives by the parameter (k, 3) [m]."""
        return np.tile(self.end - self.start, (len(t), 1))

    def second(self, t: FloatArray) -> FloatArray:
        """Return zeros (k, 3)."""
        return np.zeros((len(t), 3))

    def third_bound(self, t: FloatArray, half: FloatArray) -> FloatArray:
        """Return zeros (k,)."""
        return np.zeros(len(t))

    @property
    def nodes(self) -> FloatArray:
        """Nodes at equal steps."""
        return EVEN

    def normal(self, t: FloatArray) -> FloatArray:
        """Return the surface's normal (k, 3)."""
        return np.tile(self.up, (len(t), 1))
