"""How far places are beyond what three axes reach with the point that they carry."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.three_axes import ThreeAxes

COARSE = 48
"""Samples of joints 2 and 3 from which the nearest place is looked for."""
FINE = np.linspace(-1.0, 1.0, 7)
"""Samples about the nearest one so far, in its width."""
SHRINK, LEVELS = 0.4, 16
"""The width is multiplied by this so many times: to below 1e-7 rad, of which distances see the square."""
BLOCK = 1000
"""Places that are looked at together."""


def point_miss(axes: ThreeAxes, p: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Returns the distance of places from the nearest one that the point reaches [m], shape (b,).

    Joint 1 turns a place about axis 1 and is taken as free, so that distances from axis 1 and along it are compared,
    over joints 2 and 3: on a grid, then on ever finer ones about the best. Our own derivation.

    Args:
        axes: what carries the point.
        p: places in the frame that carries the arm [m], shape (b, 3).
        lower: lowest positions of joints 2 and 3 [rad], shape (2,), -inf allowed.
        upper: highest positions [rad], shape (2,), inf allowed.
    """
    turn = 2.0 * np.pi
    free = ~(upper - lower < turn)
    low, high = np.where(free, -np.pi, lower), np.where(free, np.pi, upper)
    width = (high - low) / (COARSE - 1)
    grid = np.stack(
        np.meshgrid(*(np.linspace(low[k], high[k], COARSE) for k in (0, 1)), indexing="ij"), axis=-1
    ).reshape(-1, 2)
    # What is free goes on beyond the ends of its turn.
    low, high = np.where(free, -np.inf, low), np.where(free, np.inf, high)
    wanted = _section((p - axes.p1) @ axes.R1)
    reached = _section(axes.place(grid))
    found = np.empty(len(p))
    fine = np.stack(np.meshgrid(FINE, FINE, indexing="ij"), axis=-1).reshape(-1, 2)
    for first in range(0, len(p), BLOCK):
        some = wanted[first : first + BLOCK]
        q = grid[_distance(reached[None], some).argmin(axis=1)]
        distance = np.empty(len(q))
        for level in range(LEVELS):
            tried = np.clip(q[:, None] + fine * (width * SHRINK**level), low, high)
            away = _distance(_section(axes.place(tried)), some)
            best = away.argmin(axis=1)
            q, distance = tried[np.arange(len(q)), best], away[np.arange(len(q)), best]
        found[first : first + BLOCK] = distance
    return found


def _section(place: FloatArray) -> FloatArray:
    """Returns distances from axis 1 and along it (..., 2) of places in frame 1 (..., 3)."""
    return np.stack([np.hypot(place[..., 0], place[..., 1]), place[..., 2]], axis=-1)


def _distance(reached: FloatArray, wanted: FloatArray) -> FloatArray:
    away = reached - wanted[:, None]
    return np.hypot(away[..., 0], away[..., 1])
