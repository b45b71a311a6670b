"""Smooth contours through points, with normals given or carried along without turning."""

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
    """Sine of the angle to the curve below which a normal points along it."""
    few: int = 8
    """Points below which the ends of an open spline are straight; more of them tell how it bends there."""
    exact: float = 1e-9
    """Largest error at skipped points that lets a spline skip them [m]."""
    rounded: float = 1e-5
    """Error at skipped points that the rounding of files may explain [m].

    Here a spline stops taking more points if they do not reduce the error by `gained`.
    """
    gained: float = 4.0
    """Least factor by which twice as many points reduce the error.

    Rounding reduces nothing.
    """
    same_normal: float = 1e-6
    """Difference of the first and last normal of a closed spline below which they are one."""


SPLINE = SplineSettings()

UNIT = 0.2
"""Length that a unit vector counts as there [m]: rounded points also misplace vectors along the curve."""


@dataclass(frozen=True)
class PointSpline:
    """A smooth curve through points: a quintic (C4), by the chords' lengths, with normals given or carried along."""

    points: FloatArray
    """Two or more; neighbours differ [m], shape (k, 3). Where it is closed the last one is taken to be the first."""
    up: FloatArray
    """Out of the surface: at every point, shape (k, 3); or at the first one, shape (3,), and from there on turned no
    more than the curve bends (rotation-minimising)."""
    closed: bool = False
    """Whether the last point is the first one, and the curve is as smooth there as anywhere."""
    given: FloatArray | None = None
    """Parameters of the points, from 0 to 1, shape (k,); None for those by their own chords' lengths."""

    def __post_init__(self) -> None:
        """Freezes the arrays."""
        for name in ("points", "up", "given"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, readonly(getattr(self, name)))

    @classmethod
    def through(cls, points: FloatArray, up: FloatArray, *, closed: bool) -> PointSpline:
        """Returns the spline through as many of the points as tell the others: see `telling`."""
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
        """The knots, and equal parts between them."""
        pieces = len(self.knots) - 1
        parts = max(4, -(-(NODES - 1) // pieces))
        at = np.linspace(0.0, float(pieces), pieces * parts + 1)
        return readonly(np.interp(at, np.arange(pieces + 1.0), self.knots))

    @cached_property
    def _curve(self) -> object:
        # Periodic ends have to be the same to the last digit.
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
        """Returns points (k, 3) [m] at parameters (k,)."""
        return np.asarray(self._curve(t))  # type: ignore[operator]

    def rate(self, t: FloatArray) -> FloatArray:
        """Returns their derivatives by the parameter (k, 3) [m]."""
        return np.asarray(self._curve(t, 1))  # type: ignore[operator]

    def second(self, t: FloatArray) -> FloatArray:
        """Returns their second derivatives by the parameter (k, 3) [m]."""
        return np.asarray(self._curve(t, 2))  # type: ignore[operator]

    def third_bound(self, t: FloatArray, half: FloatArray) -> FloatArray:
        """Returns what the third derivative's length does not exceed (k,) [m] within `half` (k,) of parameters (k,).

        It is a parabola between knots, within the hull of its three Bezier points: the farthest of those of the
        stretches between knots that are touched.
        """
        third, fourth = (np.asarray(self._curve(self.knots, k)) for k in (3, 4))  # type: ignore[operator]
        middle = third[:-1] + 0.5 * np.diff(self.knots)[:, None] * fourth[:-1]
        hull = np.stack([third[:-1], middle, third[1:]])
        size = norm(hull, axis=2).max(axis=0)
        last = len(size) - 1
        low = np.clip(np.searchsorted(self.knots, t - half, side="left") - 1, 0, last)
        high = np.clip(np.searchsorted(self.knots, t + half, side="right") - 1, 0, last)
        edges = np.stack([low, high + 1], axis=1).ravel()
        found: FloatArray = np.maximum.reduceat(np.append(size, 0.0), edges)[::2]
        return found

    def normal(self, t: FloatArray) -> FloatArray:
        """Returns vectors (k, 3) that point out of the surface."""
        return np.asarray(self._normals(t))  # type: ignore[operator]


def chord_parameters(points: FloatArray) -> FloatArray:
    """Returns parameters of points (k, 3) from 0 to 1 by the chords' lengths, shape (k,)."""
    steps = norm(np.diff(points, axis=0), axis=1)
    found = np.concatenate([[0.0], np.cumsum(steps)]) / steps.sum()
    found[-1] = 1.0
    return readonly(found)


def telling(knots: FloatArray, values: FloatArray, *, closed: bool) -> IntArray:
    """Returns the places of as few of k values as tell the others, or of all, rising.

    A curve is the same however densely a file describes it: derivatives of a spline through all of many points are
    those of what the file rounds away. Those that are taken are equally many apart; they are doubled until the spline
    passes the others at `exact`, or at `rounded` and twice as many bring it no nearer.

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
        found = np.asarray(quintic(knots[k], values[k], closed=closed)(knots))  # type: ignore[operator]
        off = float(np.abs(found - values).max())
        if before <= SPLINE.rounded and off * SPLINE.gained > before:
            return fewer
        if off <= SPLINE.exact:
            return k
        pieces, before, fewer = 2 * pieces, off, k
    return np.arange(last + 1)


def quintic(knots: FloatArray, values: FloatArray, *, closed: bool) -> object:
    """Returns a quintic spline (C4): its tangents are smooth enough for finite jerk.

    Periodic where it is closed. At open ends its first two derivatives are those of the quartic through the last five
    values: left to the quintic itself, uneven values make the ends hook. Of few values the ends are straight.
    """
    if closed:
        return closed_quintic_spline(knots, values)
    if len(knots) > SPLINE.few:
        ends = _end_rates(knots[:5], values[:5]), _end_rates(knots[:-6:-1], values[:-6:-1])
        return quintic_spline(knots, values, *ends)
    free = [(2, np.zeros(values.shape[1])), (4, np.zeros(values.shape[1]))]
    return quintic_spline(knots, values, free, free)


def _end_rates(knots: FloatArray, values: FloatArray) -> list[tuple[int, FloatArray]]:
    """Returns first and second derivative, each (d,), of the quartic through values (5, d) at the first of them."""
    scale = knots[4] - knots[0]
    powers = np.vander((knots - knots[0]) / scale, increasing=True)
    _, first, second, *_ = solve(powers, values)
    return [(1, first / scale), (2, 2.0 * second / np.square(scale))]


def _directions(vectors: FloatArray) -> FloatArray:
    """Returns vectors (k, d) at length 1: a long normal beside short ones would pull the curve between them."""
    if not vectors.size:
        return vectors
    found: FloatArray = vectors / norm(vectors, axis=1)[:, None]
    return found


def _carried_along(up: FloatArray, p: FloatArray, rate: FloatArray) -> FloatArray:
    """Returns a normal carried along a curve without turning about it, by double reflection ([Wang2008]).

    Zeros where it points along the curve at the first point: there is nothing to carry then.

    Args:
        up: at the first point, shape (3,).
        p: points [m], shape (k, 3).
        rate: along the curve, shape (k, 3).
    """
    tangent = rate / norm(rate, axis=1)[:, None]
    found = np.empty_like(p)
    r = up - product(up, tangent[0]) * tangent[0]
    if norm(r) < SPLINE.along * norm(up):
        return np.zeros_like(p)
    found[0] = r = r / norm(r)
    for k in range(len(p) - 1):
        # First in the plane between the points, then in the one between the tangents.
        v = p[k + 1] - p[k]
        scale = 2.0 / product(v, v)
        r = r - scale * product(v, r) * v
        t = tangent[k] - scale * product(v, tangent[k]) * v
        w = tangent[k + 1] - t
        size = product(w, w)
        if size > 0.0:
            r = r - 2.0 / size * product(w, r) * w
        found[k + 1] = r
    return found
