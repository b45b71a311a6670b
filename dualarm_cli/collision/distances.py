"""Distances of many segments from segments, boxes and half-spaces at once: never more than the true ones."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray

TINY = 1e-12
"""Squared lengths below this are points [m²]."""
GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)
ROUNDS = 14
"""Golden sections of a segment: what is left of it, a thousandth, is taken off the distance."""


def segment_distance(a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray) -> FloatArray:
    """Returns the distance of segments a-b from segments c-d [m], shape (...); exact up to rounding.

    The squared distance is a convex quadratic of both parameters: its minimum is the free one clamped, once along
    either segment ([Ericson2004] 5.1.9).

    Args:
        a: ends of the first segments [m], shape (..., 3), broadcast with the others.
        b: their other ends.
        c: ends of the second segments.
        d: their other ends.
    """
    u, v, w = b - a, d - c, a - c
    uu, vv, uv = (u * u).sum(-1), (v * v).sum(-1), (u * v).sum(-1)
    uw, vw = (u * w).sum(-1), (v * w).sum(-1)
    denominator = uu * vv - uv * uv
    with np.errstate(divide="ignore", invalid="ignore"):
        s = np.where(denominator > TINY, (uv * vw - vv * uw) / denominator, 0.0)
        s = np.clip(s, 0.0, 1.0)
        t = np.where(vv > TINY, (uv * s + vw) / vv, 0.0)
        t = np.clip(t, 0.0, 1.0)
        s = np.where(uu > TINY, (uv * t - uw) / uu, 0.0)
        s = np.clip(s, 0.0, 1.0)
    apart = w + s[..., None] * u - t[..., None] * v
    return np.sqrt((apart * apart).sum(-1))


def box_distance(a: FloatArray, b: FloatArray, half: FloatArray) -> FloatArray:
    """Returns a bound below the distance of segments a-b from a box about the origin [m], shape (...).

    The distance from a convex solid is convex along a segment, and changes by no more than the way: golden sections
    find its minimum up to what is left of the segment. Inside, it is minus the depth of the deepest point looked at.

    Args:
        a: ends in the box's frame [m], shape (..., 3).
        b: other ends.
        half: half sides of the box [m], shape (..., 3).
    """
    u = b - a
    length = np.sqrt((u * u).sum(-1))
    low, high = np.zeros(length.shape), np.ones(length.shape)
    one, other = 1.0 - GOLDEN + low, GOLDEN + low
    at_one, at_other = (_point_box(a + x[..., None] * u, half) for x in (one, other))
    least = np.minimum(np.minimum(at_one, at_other), _point_box(a, half))
    least = np.minimum(least, _point_box(b, half))
    for _ in range(ROUNDS):
        left = at_one < at_other
        low, high = np.where(left, low, one), np.where(left, other, high)
        new = np.where(left, high - GOLDEN * (high - low), low + GOLDEN * (high - low))
        value = _point_box(a + new[..., None] * u, half)
        one, other = np.where(left, new, other), np.where(left, one, new)
        at_one, at_other = np.where(left, value, at_other), np.where(left, at_one, value)
        least = np.minimum(least, value)
    return least - (high - low) * length


def _point_box(x: FloatArray, half: FloatArray) -> FloatArray:
    """Returns the signed distance of points from a box about the origin [m], shape (...)."""
    beyond = np.abs(x) - half
    outside = np.maximum(beyond, 0.0)
    return np.sqrt((outside * outside).sum(-1)) + np.minimum(beyond.max(-1), 0.0)
