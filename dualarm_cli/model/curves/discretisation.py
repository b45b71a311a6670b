"""Discretisation of curves for controllers: points at equal lengths, and their accuracy."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, readonly
from dualarm_cli.geometry.elementary import arctan2, cube
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.geometry.rotations import log_rotation
from dualarm_cli.model.curves.contours import Contour
from dualarm_cli.model.curves.feature_curve import MeasuredCurve
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class DiscretisationSettings:
    """Resolution of discretised curves."""

    remainder: float = 1e-6
    """Remainder of a curve below which it joins the last step [m]."""
    inner: int = 16
    """Subdivisions of a step at which chord errors are measured."""
    rounding: float = 1.0 + 1e-9
    """Factor on proven bounds that covers rounding."""
    cells: int = 16384
    """Minimum number of cells over which curvature is bounded."""
    shortest_step: float = 2e-6
    """Smallest step [m]."""
    most_points: int = 100_000
    """Maximum number of points of one curve."""


CURVE_STEPS = DiscretisationSettings()

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)


@dataclass(frozen=True)
class Points:
    """Points of a curve with their frames; the last step may be shorter."""

    step: float
    """Nominal length of a step: speed times interval [m]."""
    parameter: FloatArray
    """Parameters of the contour, from 0 to 1, shape (k,)."""
    R: FloatArray
    """Frames in the part: x along the curve, z outwards, shape (k, 3, 3)."""
    p: FloatArray
    """Points in the part [m], shape (k, 3)."""

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for name in ("parameter", "R", "p"):
            object.__setattr__(self, name, readonly(getattr(self, name)))


@dataclass(frozen=True)
class Quality:
    """Accuracy of discretised points; lengths are integrated independently of their placement."""

    spacing_error: float
    """Largest error of a whole step's length along the curve [m]."""
    speed_error: float
    """Largest error of a whole step's length as a fraction of the step."""
    drift: float
    """Accumulated length error at the last whole step [m]."""
    last_step: float
    """Length of the last step, to the curve's end [m]."""
    chord_error: float
    """Largest measured distance of the curve from a chord [m]."""
    chord_bound: float
    """Proven bound of the distance from any chord [m]."""
    curvature_bound: float
    """Proven bound of the curvature [1/m]; infinite at a corner."""
    turn: float
    """Largest rotation between neighbouring frames [rad]."""
    least_dot: float
    """Smallest cosine between an axis and the neighbouring frame's; a flip is below 0."""
    lean: float
    """Largest angle between x and the curve's direction [rad].

    It is 0 unless a file gives the frames.
    """


def step_lengths(length: float, step: float) -> FloatArray:
    """Compute the lengths of a curve's points: whole steps, then the end, (k,) [m].

    Args:
        length: of the curve [m].
        step: [m].
    """
    count = max(int(np.floor((length - CURVE_STEPS.remainder) / step)), 0)
    return np.append(step * np.arange(count + 1.0), length)


def by_length(curve: MeasuredCurve, step: float) -> Points:
    """Place points at equal lengths with a shorter last step: the integral of Eq. 14.

    Args:
        curve: the curve.
        step: speed times interval [m].
    """
    parameter = curve.arc.at(step_lengths(curve.length, step))
    parameter[0], parameter[-1] = 0.0, 1.0
    return Points(step, parameter, *curve.at_parameter(parameter))


def by_euler(curve: MeasuredCurve, step: float) -> Points:
    """Place points by the Euler step of [Qin2024] Eq. 14 to 17.

    The step is theta + V T / |P'(theta)|. The printed algorithm stops at the last step before the end; here the end is
    added.

    Args:
        curve: the curve.
        step: speed times interval, V T [m].
    """
    parameters, theta = [0.0], 0.0
    while True:
        rate = curve.contour.rate(np.array([theta]))[0]
        size = float(np.sqrt(product(rate, rate)))
        theta += step / size
        if theta > 1.0 - CURVE_STEPS.remainder / size:
            break
        parameters.append(theta)
    parameter = np.array([*parameters, 1.0])
    return Points(step, parameter, *curve.at_parameter(parameter))


def judge(curve: MeasuredCurve, points: Points) -> Quality:
    """Measure and bound the accuracy of a curve's points.

    A step of length h along a curve whose curvature is at most kappa stays within kappa h² / 8 of its chord: the
    error of linear interpolation by the length, whose second derivative is the curvature. kappa is bounded on short
    cells from the contour's derivatives in closed form at their middle and a bound on the third derivative over the
    cell. max |P''| times the squared parameter step over 8 is a bound too; the smaller one is used.

    Args:
        curve: the curve.
        points: points on it.
    """
    contour, t = curve.contour, points.parameter
    # Steps are cut into cells, so that coarse steps have enough of them, too.
    parts = -(-CURVE_STEPS.cells // (len(t) - 1))
    cells = np.linspace(t[:-1], t[1:], parts, endpoint=False, axis=1)
    edges = np.append(cells.ravel(), t[-1])
    spacing = _cell_lengths(contour, edges).reshape(-1, parts).sum(axis=1)
    whole = spacing[:-1] - points.step
    kappa, second = (bound.reshape(-1, parts).max(axis=1) for bound in _bounds(contour, edges))
    bounds = np.minimum(kappa * np.square(spacing), second * np.square(np.diff(t))) / 8.0
    turned = log_rotation(product(np.swapaxes(points.R[:-1], 1, 2), points.R[1:]))
    rate = product(contour.rate(t), curve.T_part_curve.rotation.T)
    sine = norm(np.cross(points.R[:, :, 0], rate), axis=1)
    error = float(np.abs(whole).max(initial=0.0))
    return Quality(
        spacing_error=error,
        speed_error=error / points.step,
        drift=float(abs(whole.sum())),
        last_step=float(spacing[-1]),
        chord_error=_chord_error(contour, t),
        chord_bound=float(bounds.max()) * CURVE_STEPS.rounding,
        curvature_bound=float(kappa.max()) * CURVE_STEPS.rounding,
        turn=float(norm(turned, axis=1).max()),
        least_dot=float((points.R[:-1] * points.R[1:]).sum(axis=1).min()),
        lean=float(arctan2(sine, (points.R[:, :, 0] * rate).sum(axis=1)).max()),
    )


def _cell_lengths(contour: Contour, edges: FloatArray) -> FloatArray:
    """Integrate the lengths of cells between parameters (k + 1,), (k,) [m].

    Five-point Gauss-Legendre quadrature.
    """
    h = np.diff(edges)
    inner = edges[:-1, None] + h[:, None] * (0.5 + 0.5 * _NODES)
    speed = norm(contour.rate(inner.ravel()), axis=1).reshape(inner.shape)
    lengths: FloatArray = h * product(speed, 0.5 * _WEIGHTS)
    return lengths


def _bounds(contour: Contour, edges: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Bound curvature [1/m] and second derivative [m] on cells between parameters (k + 1,).

    Over a cell of half width d around t: |P''| <= |P''(t)| + d T with T >= |P'''|; |P'| >= |P'(t)| - d max|P''|;
    |P' x P''| <= |P'(t) x P''(t)| + d T max|P'|; the curvature is |P' x P''| / |P'|³.
    """
    t, d = 0.5 * (edges[1:] + edges[:-1]), 0.5 * np.diff(edges)
    rate, bend, third = contour.rate(t), contour.second(t), contour.third_bound(t, d)
    size = norm(rate, axis=1)
    second = norm(bend, axis=1) + d * third
    least, most = np.maximum(size - d * second, 0.0), size + d * second
    across = norm(np.cross(rate, bend), axis=1) + d * third * most
    with np.errstate(divide="ignore", invalid="ignore"):
        kappa = np.where(across > 0.0, across / cube(least), 0.0)
    return kappa, second


def _chord_error(contour: Contour, t: FloatArray) -> float:
    """Measure the largest distance of a curve from its chords at inner points [m]."""
    p = contour.point(t)
    chord = np.diff(p, axis=0)
    chord /= norm(chord, axis=1)[:, None]
    worst = 0.0
    for share in np.arange(1, CURVE_STEPS.inner) / CURVE_STEPS.inner:
        off = contour.point(t[:-1] + share * np.diff(t)) - p[:-1]
        across = off - (off * chord).sum(axis=1)[:, None] * chord
        worst = max(worst, float(norm(across, axis=1).max()))
    return worst
