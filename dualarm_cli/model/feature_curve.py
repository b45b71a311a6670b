"""Feature curves of parts: where pipes and spheres meet, ellipses, lines, splines; their frames never flip."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
import pinocchio as pin

from dualarm_cli.geometry.arrays import FloatArray, readonly
from dualarm_cli.model.arc_length import ArcLength
from dualarm_cli.model.tool_path import Poses

NODES = 2049
"""Nodes at which lengths of curves are measured."""


class Contour(Protocol):
    """A smooth curve on a surface, by a parameter from 0 to 1."""

    def point(self, t: FloatArray) -> FloatArray:
        """Returns points (k, 3) [m] at parameters (k,)."""

    def rate(self, t: FloatArray) -> FloatArray:
        """Returns their derivatives by the parameter (k, 3) [m]."""

    def normal(self, t: FloatArray) -> FloatArray:
        """Returns vectors (k, 3) that point out of the surface there, of any length."""


@dataclass(frozen=True)
class Saddle:
    """Where a branch pipe meets a main pipe: [Qin2024] Eq. 12.

    The main pipe's axis is z. The branch pipe's frame is shifted by the eccentricity along y, then turned about y, so
    that its axis leans from z towards x; the normal is the main pipe's.
    """

    main_radius: float
    """R [m]."""
    branch_radius: float
    """r [m], at most R less the eccentricity."""
    angle: float
    """Between the pipes' axes, alpha [rad]."""
    eccentricity: float
    """Distance between the pipes' axes, e [m]."""
    start: float
    """Angle about the branch pipe where it begins, beta [rad]."""
    end: float
    """Angle about the branch pipe where it ends [rad]; below the start it goes the other way round."""

    def _beta(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        beta = self.start + t * (self.end - self.start)
        return np.cos(beta), np.sin(beta)

    def point(self, t: FloatArray) -> FloatArray:
        """Returns points (k, 3) [m] at parameters (k,)."""
        c, s = self._beta(t)
        ca, sa = np.cos(self.angle), np.sin(self.angle)
        y = self.branch_radius * s + self.eccentricity
        x = np.sqrt(self.main_radius**2 - y**2)
        # Eq. 12: z on the branch pipe is (x - r cos beta cos alpha) / sin alpha in its own frame.
        along = (x - self.branch_radius * c * ca) / sa
        z = -self.branch_radius * c * sa + along * ca
        return np.stack([x, y, z], axis=-1)

    def rate(self, t: FloatArray) -> FloatArray:
        """Returns their derivatives by the parameter (k, 3) [m]."""
        c, s = self._beta(t)
        r, ca, sa = self.branch_radius, np.cos(self.angle), np.sin(self.angle)
        y = r * s + self.eccentricity
        dy = r * c
        dx = -y * dy / np.sqrt(self.main_radius**2 - y**2)
        dz = r * s * sa + (dx + r * s * ca) / sa * ca
        found: FloatArray = np.stack([dx, dy, dz], axis=-1) * (self.end - self.start)
        return found

    def normal(self, t: FloatArray) -> FloatArray:
        """Returns the main pipe's outward normals (k, 3)."""
        found: FloatArray = self.point(t) * np.array([1.0, 1.0, 0.0])
        return found


@dataclass(frozen=True)
class SphereArc:
    """Where a branch pipe meets a sphere: [Qin2024] Eq. 11, with the sphere in place of its third coordinate.

    The pipe's frame is shifted by the eccentricity along x, then turned about x; with no eccentricity it is a circle.
    """

    main_radius: float
    """Of the sphere, R [m]."""
    branch_radius: float
    """r [m]."""
    angle: float
    """Turn of the pipe's axis about x, alpha [rad]."""
    eccentricity: float
    """Distance of the pipe's axis from the sphere's centre, e [m]."""
    start: float
    """Angle about the pipe where it begins, beta [rad]."""
    end: float
    """Angle about the pipe where it ends [rad]."""

    def _turned(self, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        ca, sa = np.cos(self.angle), np.sin(self.angle)
        return np.stack([x, y * ca - z * sa, y * sa + z * ca], axis=-1)

    def point(self, t: FloatArray) -> FloatArray:
        """Returns points (k, 3) [m] at parameters (k,)."""
        beta = self.start + t * (self.end - self.start)
        x = self.branch_radius * np.cos(beta) + self.eccentricity
        y = self.branch_radius * np.sin(beta)
        return self._turned(x, y, np.sqrt(self.main_radius**2 - x**2 - y**2))

    def rate(self, t: FloatArray) -> FloatArray:
        """Returns their derivatives by the parameter (k, 3) [m]."""
        beta = self.start + t * (self.end - self.start)
        c, s = np.cos(beta), np.sin(beta)
        x, y = self.branch_radius * c + self.eccentricity, self.branch_radius * s
        dx, dy = -self.branch_radius * s, self.branch_radius * c
        dz = -(x * dx + y * dy) / np.sqrt(self.main_radius**2 - x**2 - y**2)
        found: FloatArray = self._turned(dx, dy, dz) * (self.end - self.start)
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
        return np.stack([a * np.cos(u), b * np.sin(u), np.zeros_like(u)], axis=-1)

    def rate(self, t: FloatArray) -> FloatArray:
        """Returns their derivatives by the parameter (k, 3) [m]."""
        u = self.start + t * (self.end - self.start)
        a, b = self.semi_axes
        found: FloatArray = np.stack([-a * np.sin(u), b * np.cos(u), np.zeros_like(u)], axis=-1)
        return found * (self.end - self.start)

    def normal(self, t: FloatArray) -> FloatArray:
        """Returns z, or in the plane what points away from the ellipse, (k, 3)."""
        if not self.outward:
            return np.tile([0.0, 0.0, 1.0], (len(t), 1))
        x, y, z = self.point(t).T
        a, b = self.semi_axes
        return np.stack([x / a**2, y / b**2, z], axis=-1)


@dataclass(frozen=True)
class Segment:
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

    def normal(self, t: FloatArray) -> FloatArray:
        """Returns the surface's normal (k, 3)."""
        return np.tile(self.up, (len(t), 1))


@dataclass(frozen=True)
class PointSpline:
    """A smooth curve through points: a natural quintic (C4) by the chords' lengths, normals given or carried along."""

    points: FloatArray
    """Two or more; neighbours differ [m], shape (k, 3)."""
    up: FloatArray
    """Out of the surface: at every point, shape (k, 3); or at the first one, shape (3,), and from there on turned no
    more than the curve bends (rotation-minimising)."""
    closed: bool = False
    """Whether the last point is the first one, and the curve is as smooth there as anywhere."""

    def __post_init__(self) -> None:
        """Freezes the arrays."""
        for name in ("points", "up"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    @cached_property
    def _knots(self) -> FloatArray:
        steps = np.linalg.norm(np.diff(self.points, axis=0), axis=1)
        return np.concatenate([[0.0], np.cumsum(steps)]) / steps.sum()

    @cached_property
    def _curve(self) -> object:
        return _smooth_spline(self._knots, self.points, closed=self.closed)

    @cached_property
    def _normals(self) -> object:
        if self.up.ndim == 2:
            closed = self.closed and np.array_equal(self.up[0], self.up[-1])
            return _smooth_spline(self._knots, self.up, closed=closed)
        nodes = np.linspace(0.0, 1.0, NODES)
        carried = _carried_along(self.up, self.point(nodes), self.rate(nodes))
        return _smooth_spline(nodes, carried, closed=False)

    def point(self, t: FloatArray) -> FloatArray:
        """Returns points (k, 3) [m] at parameters (k,)."""
        return np.asarray(self._curve(t))  # type: ignore[operator]

    def rate(self, t: FloatArray) -> FloatArray:
        """Returns their derivatives by the parameter (k, 3) [m]."""
        return np.asarray(self._curve(t, 1))  # type: ignore[operator]

    def normal(self, t: FloatArray) -> FloatArray:
        """Returns vectors (k, 3) that point out of the surface."""
        return np.asarray(self._normals(t))  # type: ignore[operator]


def _smooth_spline(knots: FloatArray, values: FloatArray, *, closed: bool) -> object:
    """Returns a quintic spline: tangents are as smooth as joints need them for finite jerk."""
    # Slow to import, and needed for splines alone.
    from scipy.interpolate import make_interp_spline

    free = [(3, np.zeros(3)), (4, np.zeros(3))]
    return make_interp_spline(knots, values, k=5, bc_type="periodic" if closed else (free, free))


def _carried_along(up: FloatArray, p: FloatArray, rate: FloatArray) -> FloatArray:
    """Returns a normal carried along a curve without turning about it, by double reflection ([Wang2008]).

    Args:
        up: at the first point, not along the curve, shape (3,).
        p: points [m], shape (k, 3).
        rate: along the curve, shape (k, 3).
    """
    tangent = rate / np.linalg.norm(rate, axis=1)[:, None]
    found = np.empty_like(p)
    r = up - (up @ tangent[0]) * tangent[0]
    found[0] = r = r / np.linalg.norm(r)
    for k in range(len(p) - 1):
        # First in the plane between the points, then in the one between the tangents.
        v = p[k + 1] - p[k]
        scale = 2.0 / (v @ v)
        r = r - scale * (v @ r) * v
        t = tangent[k] - scale * (v @ tangent[k]) * v
        w = tangent[k + 1] - t
        size = w @ w
        if size > 0.0:
            r = r - 2.0 / size * (w @ r) * w
        found[k + 1] = r
    return found


@dataclass(frozen=True)
class FeatureCurve:
    """A curve on a part, by the length along it, with a frame: x along the curve, z out of the surface.

    z is the surface's normal made perpendicular to the curve; as both are smooth the frame never flips ([Qin2024]
    section 3.3, Fig. 8).
    """

    contour: Contour
    """The curve in a frame of its own."""
    T_part_curve: pin.SE3
    """That frame in the part's."""

    @cached_property
    def arc(self) -> ArcLength:
        """Its length over the contour's parameter ([Qin2024] Eq. 14)."""
        return ArcLength.measure(
            lambda t: np.asarray(np.linalg.norm(self.contour.rate(t), axis=1)),
            np.linspace(0.0, 1.0, NODES),
        )

    @cached_property
    def length(self) -> float:
        """Length [m]."""
        return self.arc.whole

    def at(self, s: FloatArray) -> Poses:
        """Returns frames on the curve in the part's frame at lengths (k,) [m]."""
        return self.at_parameter(self.arc.at(np.clip(s, 0.0, self.length)))

    def at_parameter(self, t: FloatArray) -> Poses:
        """Returns frames on the curve in the part's frame at the contour's parameters (k,)."""
        R = contour_frames(self.contour, t)
        T = self.T_part_curve
        return T.rotation @ R, self.contour.point(t) @ T.rotation.T + T.translation


def contour_frames(contour: Contour, t: FloatArray) -> FloatArray:
    """Returns rotations (k, 3, 3) at parameters (k,): x along the curve, z out of the surface, y = z x x."""
    rate, normal = contour.rate(t), contour.normal(t)
    x = rate / np.linalg.norm(rate, axis=1)[:, None]
    z = normal - (normal * x).sum(axis=1)[:, None] * x
    z /= np.linalg.norm(z, axis=1)[:, None]
    return np.stack([x, np.cross(z, x), z], axis=-1)


def least_lean(contour: Contour) -> float:
    """Returns the least angle between a contour and its surface's normal [rad]: near 0 there is no frame."""
    t = np.linspace(0.0, 1.0, NODES)
    rate, normal = contour.rate(t), contour.normal(t)
    with np.errstate(invalid="ignore", divide="ignore"):
        sine = np.linalg.norm(np.cross(rate, normal), axis=1) / (
            np.linalg.norm(rate, axis=1) * np.linalg.norm(normal, axis=1)
        )
    return float(np.arcsin(np.clip(np.nan_to_num(sine), 0.0, 1.0)).min())
