"""Joint angles modulo whole turns, and turns within joint limits."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.geometry.elementary import TURN

LIMIT_SLACK = 1e-10
"""Rounding tolerance of position limits [rad]."""


def wrap(angle: FloatArray) -> FloatArray:
    """Wrap angles to (-pi, pi], shape (...).

    Args:
        angle: [rad], shape (...).
    """
    wrapped = angle - TURN * np.ceil(angle / TURN - 0.5)
    # Rounding may leave a value just outside the half-open interval.
    wrapped = np.where(wrapped <= -np.pi, np.pi, wrapped)
    return np.minimum(wrapped, np.pi)


def within_limits(q: FloatArray, lower: FloatArray, upper: FloatArray) -> BoolArray:
    """Return whether all joints are within their limits, shape (...).

    Args:
        q: joints [rad], shape (..., n).
        lower: lowest positions [rad], shape (n,), -inf allowed.
        upper: highest positions [rad], shape (n,), inf allowed.
    """
    inside: BoolArray = np.ones(q.shape[:-1], dtype=np.bool_)
    for i in range(q.shape[-1]):
        inside &= (q[..., i] >= lower[i] - LIMIT_SLACK) & (q[..., i] <= upper[i] + LIMIT_SLACK)
    return inside


def some_turn_within(angle: FloatArray, lower: float, upper: float) -> BoolArray:
    """Return whether an angle modulo whole turns can lie within limits, shape (...).

    Args:
        angle: [rad], shape (...).
        lower: lowest position [rad].
        upper: highest position [rad].
    """
    if upper - lower >= TURN - LIMIT_SLACK:
        return np.ones(np.shape(angle), dtype=np.bool_)
    middle = 0.5 * (lower + upper)
    return np.abs(wrap(angle - middle)) <= 0.5 * (upper - lower) + LIMIT_SLACK


def nearest_turns(
    q: FloatArray, reference: FloatArray, lower: FloatArray, upper: FloatArray
) -> FloatArray:
    """Add whole turns to q: nearest to the reference among those within limits.

    A joint that no turn brings within its limits keeps its value.

    Args:
        q: joints in [-pi, pi] [rad], shape (..., n).
        reference: joints to be near to [rad], broadcast against q.
        lower: lowest positions [rad], shape (n,), -inf allowed.
        upper: highest positions [rad], shape (n,), inf allowed.
    """
    reference = np.asarray(reference)
    shape = np.broadcast_shapes(q.shape, reference.shape)
    result = np.broadcast_to(q, shape).copy(order="K")
    for i in range(shape[-1]):
        # Well inside half a turn on both sides there is one turn to choose from: none.
        if lower[i] > -np.pi + LIMIT_SLACK and upper[i] < np.pi - LIMIT_SLACK:
            continue
        angle = q[..., i]
        least = np.ceil((lower[i] - LIMIT_SLACK - angle) / TURN)
        most = np.floor((upper[i] + LIMIT_SLACK - angle) / TURN)
        turns = np.clip(np.round((reference[..., i] - angle) / TURN), least, most)
        result[..., i] = angle + TURN * np.where(least <= most, turns, 0.0)
    return result
