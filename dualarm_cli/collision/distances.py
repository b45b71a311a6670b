"""Distances of many segments from segments and boxes at once, components first."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from dualarm_cli.geometry.arrays import FloatArray

T = TypeVar("T", bound=np.floating[Any])

TINY = 1e-18
"""Squared lengths below this are points [m²]."""
PARALLEL = 1e-12
"""Squared sine of the angle between segments below which they are taken as parallel."""


def dot(a: NDArray[T], b: NDArray[T]) -> NDArray[T]:
    """Returns the scalar products of vectors (3, ...), broadcast, shape (...)."""
    product: NDArray[T] = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product


def segment_distance(a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray) -> FloatArray:
    """Returns the distance of segments a-b from segments c-d [m], shape (...); exact up to rounding.

    The squared distance is a convex quadratic of both parameters: its minimum is the free one clamped, once along
    either segment ([Ericson2004] 5.1.9).

    Args:
        a: ends of the first segments [m], shape (3, ...), broadcast with the others.
        b: their other ends.
        c: ends of the second segments.
        d: their other ends.
    """
    u, v, w = b - a, d - c, a - c
    uu, vv, uv = dot(u, u), dot(v, v), dot(u, v)
    uw, vw = dot(u, w), dot(v, w)
    denominator = uu * vv - uv * uv
    with np.errstate(divide="ignore", invalid="ignore"):
        slanted = denominator > PARALLEL * uu * vv
        s = np.where(slanted, (uv * vw - vv * uw) / denominator, 0.0)
        s = np.clip(s, 0.0, 1.0)
        t = np.where(vv > TINY, (uv * s + vw) / vv, 0.0)
        t = np.clip(t, 0.0, 1.0)
        s = np.where(uu > TINY, (uv * t - uw) / uu, 0.0)
        s = np.clip(s, 0.0, 1.0)
    apart = w + s * u - t * v
    return np.sqrt(dot(apart, apart))


def box_distance(a: FloatArray, b: FloatArray, half: FloatArray) -> FloatArray:
    """Returns the distance of segments a-b from boxes about the origin [m], shape (...); exact up to rounding.

    Half the derivative of the squared distance along the segment rises, and is linear between the places where the
    segment crosses the planes of the sides: it is zero on the straight line between the last of them where it is
    negative and the first where it is not. Inside, the distance is minus the depth there.

    Args:
        a: ends in the box's frame [m], shape (3, ...).
        b: other ends.
        half: half sides of the box [m], shape (3, ...).
    """
    u = b - a
    low, high = np.zeros(u.shape[1:]), np.ones(u.shape[1:])
    at_low, at_high = _slope(a, u, half, low), _slope(a, u, half, high)
    with np.errstate(divide="ignore", invalid="ignore"):
        crossings = [(side - a) / u for side in (half, -half)]
    for x in (x for crossing in crossings for x in crossing):
        # What is not between is neither; comparisons with NaN are false.
        between = (x > low) & (x < high)
        slope = _slope(a, u, half, np.where(between, x, low))
        rises = between & (slope >= 0.0)
        falls = between & (slope < 0.0)
        high, at_high = np.where(rises, x, high), np.where(rises, slope, at_high)
        low, at_low = np.where(falls, x, low), np.where(falls, slope, at_low)
    with np.errstate(divide="ignore", invalid="ignore"):
        x = low - at_low * (high - low) / (at_high - at_low)
    x = np.where(at_low >= 0.0, low, np.where(at_high <= 0.0, high, x))
    return point_box(a + x * u, half)


def _slope(a: FloatArray, u: FloatArray, half: FloatArray, x: FloatArray) -> FloatArray:
    """Returns half the derivative of the squared distance of a + x u from boxes, shape (...)."""
    point = a + x * u
    return dot(u, point - np.clip(point, -half, half))


def point_box(x: FloatArray, half: FloatArray) -> FloatArray:
    """Returns the signed distance of points (3, ...) from boxes about the origin [m], shape (...)."""
    beyond = np.abs(x) - half
    outside = np.maximum(beyond, 0.0)
    return np.sqrt(dot(outside, outside)) + np.minimum(beyond.max(axis=0), 0.0)
