"""Smooth contours through points, with given or rotation-minimising normals."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray, readonly
from dualarm_cli.geometry.linear_systems import solve
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.geometry.splines import closed_quintic_spline, quintic_spline
from dualarm_cli.model.curves.contours import NODES
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class SplineSettings:
    """Tolerances and iterations of splines through points."""

    along: float = 1e-9
    """Sine of the angle to the curve below which a normal is tangential."""
    few: int = 8
    """Largest number of points with straight ends of an open spline.

    More points determine the end curvature.
    """
    exact: float = 1e-9
    """Largest error at skipped points that lets a spline skip them [m]."""
    rounded: float = 1e-5
    """Error at skipped points that the rounding of files may explain [m].

    Below it a spline gets more points only if they reduce the error by `gained`.
    """
    gained: float = 4.0
    """Least factor by which twice as many points reduce an error that is not rounding."""
    same_normal: float = 1e-6
    """Difference of the first and last normal below which they are equal."""


SPLINE = SplineSettings()

UNIT = 0.2
"""Length that stands for a unit vector in point selection [m].

Rounded points also misplace vectors along the curve.
"""


@dataclass(frozen=True)
class PointSpline:
    """Quintic spline (C4) through points by chord length, with normals."""

    points: FloatArray
    """Two or more points; neighbours differ [m], shape (k, 3).

    On a closed spline the last point is replaced by the first.
    """
    up: FloatArray
    """Outward vectors at every point, shape (k, 3); or at the first, shape (3,).

    A single vector is carried along the curve with least rotation.
    """
    closed: bool = False
    """Whether the spline is closed and smooth at its first point."""
    given: FloatArray | None = None
    """Parameters of the points, from 0 to 1, shape (k,); None for chord lengths."""

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for name in ("points", "up", "given"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, readonly(getattr(self, name)))

    @classmethod
    def through(cls, points: FloatArray, up: FloatArray, *, closed: bool) -> PointSpline:
        """Interpolate as few points as determine the others: see `telling`."""
        t = chord_parameters(points)
        normals = up if up.ndim == 2 else np.zeros((len(points), 0))
        k = telling(t, np.concatenate([points, UNIT * _directions(normals)], axis=1), closed=closed)
        return cls(points[k], up[k] if up.ndim == 2 else up, closed, t[k])

    @cached_property
    def knots(self) -> FloatArray:
        """Parameters of the points, from 0 to 1, shape (k,)."""
        return chord_parameters(self.points) if self.given is None else self.given

    @cached_property
    def nodes(self) -> FloatArray:
        """Knots, and equal parts between them."""
        pieces = len(self.knots) - 1
        parts = max(4, -(-(NODES - 1) // pieces))
        at = np.linspace(0.0, float(pieces), pieces * parts + 1)
        return readonly(np.interp(at, np.arange(pieces + 1.0), self.knots))

    @cached_property
    def _curve(self) -> object:
        # Periodic ends must be equal bit by bit.
        points = np.concatenate([self.points[:-1], self.points[:1]]) if self.closed else self.points
        return quintic(self.knots, points, closed=self.closed)

    @cached_property
    def _normals(self) -> object:
        if self.up.ndim == 1:
            nodes = self.nodes
            carried = _carried_along(self.up, self.point(nodes), self.rate(nodes))
            return quintic(nodes, carried, closed=False)
        up = _directions(self.up)
        if self.closed and np.allclose(up[0], up[-1], rtol=0.0, atol=SPLINE.same_normal):
            up[-1] = up[0]
            return quintic(self.knots, up, closed=True)
        return quintic(self.knots, up, closed=False)

    def point(self, t: FloatArray) -> FloatArray:
        """Compute points (k, 3) [m] at parameters (k,)."""
        return np.asarray(self._curve(t))  # type: ignore[operator]

    def rate(self, t: FloatArray) -> FloatArray:
        """Compute first derivatives by the parameter (k, 3) [m]."""
        return np.asarray(self._curve(t, 1))  # type: ignore[operator]

    def second(self, t: FloatArray) -> FloatArray:
        """Compute second derivatives by the parameter (k, 3) [m]."""
        return np.asarray(self._curve(t, 2))  # type: ignore[operator]

    def third_bound(self, t: FloatArray, half: FloatArray) -> FloatArray:
        """Bound the norm of the third derivative within `half` of parameters (k,) [m].

        It is a parabola between knots, within the hull of its three Bezier points. The bound is the largest norm of
        those points over all intervals that are touched.
        """
        third, fourth = (np.asarray(self._curve(self.knots, k)) for k in (3, 4))  # type: ignore[operator]
        middle = third[:-1] + 0.5 * np.diff(self.knots)[:, None] * fourth[:-1]
        hull = np.stack([third[:-1], middle, third[1:]])
        size = norm(hull, axis=2).max(axis=0)
        last = len(size) - 1
        low = np.clip(np.searchsorted(self.knots, t - half, side="left") - 1, 0, last)
        high = np.clip(np.searchsorted(self.knots, t + half, side="right") - 1, 0, last)
        edges = np.stack([low, high + 1], axis=1).ravel()
        bounds: FloatArray = np.maximum.reduceat(np.append(size, 0.0), edges)[::2]
        return bounds

    def normal(self, t: FloatArray) -> FloatArray:
        """Compute outward vectors of the surface (k, 3)."""
        return np.asarray(self._normals(t))  # type: ignore[operator]


def chord_parameters(points: FloatArray) -> FloatArray:
    """Compute chord-length parameters of points (k, 3) from 0 to 1, shape (k,)."""
    steps = norm(np.diff(points, axis=0), axis=1)
    parameters = np.concatenate([[0.0], np.cumsum(steps)]) / steps.sum()
    parameters[-1] = 1.0
    return readonly(parameters)


def telling(knots: FloatArray, values: FloatArray, *, closed: bool) -> IntArray:
    """Select as few of k values as determine the others; return rising indices.

    A curve is the same however densely a file describes it: derivatives of a spline through many points are those of
    the file's rounding. Selected values are at equal steps. Their number is doubled until the spline passes the others
    at `exact`, or at `rounded` without further improvement.

    Args:
        knots: parameters of the values, rising, shape (k,).
        values: points, or unit vectors by UNIT [m], shape (k, d).
        closed: whether the last value is the first one.
    """
    last, pieces, before = len(knots) - 1, SPLINE.few, np.inf
    fewer = np.arange(0)
    values = np.concatenate([values[:-1], values[:1]]) if closed else values
    while 2 * pieces <= last:
        k: IntArray = np.linspace(0, last, pieces + 1).round().astype(np.int64)
        interpolated = np.asarray(quintic(knots[k], values[k], closed=closed)(knots))  # type: ignore[operator]
        off = float(np.abs(interpolated - values).max())
        if before <= SPLINE.rounded and off * SPLINE.gained > before:
            return fewer
        if off <= SPLINE.exact:
            return k
        pieces, before, fewer = 2 * pieces, off, k
    return np.arange(last + 1)


def quintic(knots: FloatArray, values: FloatArray, *, closed: bool) -> object:
    """Interpolate with a quintic spline (C4), smooth enough for finite jerk.

    A closed spline is periodic. At open ends its first two derivatives are those of the quartic through the last five
    values, because natural ends overshoot on uneven values. With few values the ends are straight.
    """
    if closed:
        return closed_quintic_spline(knots, values)
    if len(knots) > SPLINE.few:
        ends = _end_rates(knots[:5], values[:5]), _end_rates(knots[:-6:-1], values[:-6:-1])
        return quintic_spline(knots, values, *ends)
    free = [(2, np.zeros(values.shape[1])), (4, np.zeros(values.shape[1]))]
    return quintic_spline(knots, values, free, free)


def _end_rates(knots: FloatArray, values: FloatArray) -> list[tuple[int, FloatArray]]:
    """Estimate first and second derivative at the first of five values, each (d,).

    They are those of the quartic through all five.
    """
    scale = knots[4] - knots[0]
    powers = np.vander((knots - knots[0]) / scale, increasing=True)
    _, first, second, *_ = solve(powers, values)
    return [(1, first / scale), (2, 2.0 * second / np.square(scale))]


def _directions(vectors: FloatArray) -> FloatArray:
    """Normalise vectors (k, d).

    A long normal next to short ones would distort the curve between them.
    """
    if not vectors.size:
        return vectors
    directions: FloatArray = vectors / norm(vectors, axis=1)[:, None]
    return directions


def _carried_along(up: FloatArray, p: FloatArray, rate: FloatArray) -> FloatArray:
    """Carry a normal along a curve without twist, by double reflection ([Wang2008]).

    Zeros if it is tangential at the first point.

    Args:
        up: at the first point, shape (3,).
        p: points [m], shape (k, 3).
        rate: along the curve, shape (k, 3).
    """
    tangent = rate / norm(rate, axis=1)[:, None]
    normals = np.empty_like(p)
    r = up - product(up, tangent[0]) * tangent[0]
    if norm(r) < SPLINE.along * norm(up):
        return np.zeros_like(p)
    normals[0] = r = r / norm(r)
    for k in range(len(p) - 1):
        # Reflect in the plane between the points, then in the one between the tangents.
        v = p[k + 1] - p[k]
        scale = 2.0 / product(v, v)
        r = r - scale * product(v, r) * v
        t = tangent[k] - scale * product(v, tangent[k]) * v
        w = tangent[k + 1] - t
        size = product(w, w)
        if size > 0.0:
            r = r - 2.0 / size * product(w, r) * w
        normals[k + 1] = r
    return normals
