"""How far places are beyond what three axes reach with the point that they carry."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.kinematics.three_axes import ThreeAxes

COARSE = 32
"""Samples of joints 2 and 3 from which the nearest places are looked for."""
VALLEYS = 4
"""So many of the grid's local minima are gone into."""
STEPS, LARGEST_STEP = 60, 0.3
"""Newton steps at most, and the longest one [rad]."""
STILL = 1e-10
"""Steps shorter than this are the last ones [rad]."""
BLOCK = 500
"""Places that are looked at together."""


def point_miss(axes: ThreeAxes, p: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Returns the distance of places from the nearest one that the point reaches [m], shape (b,).

    Joint 1 turns a place about axis 1 and is taken as free, so that distances from axis 1 and along it are compared,
    over joints 2 and 3: on a grid, then by Newton's method from its valleys. Our own derivation.

    Args:
        axes: what carries the point.
        p: places in the frame that carries the arm [m], shape (b, 3).
        lower: lowest positions of joints 2 and 3 [rad], shape (2,), -inf allowed.
        upper: highest positions [rad], shape (2,), inf allowed.
    """
    free = ~(upper - lower < 2.0 * np.pi)
    low, high = np.where(free, -np.pi, lower), np.where(free, np.pi, upper)
    grid = np.stack(
        np.meshgrid(*(np.linspace(low[k], high[k], COARSE) for k in (0, 1)), indexing="ij"), axis=-1
    ).reshape(-1, 2)
    reached = axes.section(grid)[0]
    local = (p - axes.p1) @ axes.R1
    wanted = np.stack([np.hypot(local[:, 0], local[:, 1]), local[:, 2]], axis=1)
    # What is free goes on beyond the ends of its turn.
    low, high = np.where(free, -np.inf, low), np.where(free, np.inf, high)
    found = np.empty(len(p))
    for first in range(0, len(p), BLOCK):
        some = wanted[first : first + BLOCK]
        away = np.hypot(*np.moveaxis(reached - some[:, None], -1, 0))
        q = grid[_valleys(away.reshape(-1, COARSE, COARSE))].reshape(-1, 2)
        least = _descended(axes, q, np.repeat(some, VALLEYS, axis=0), low, high)
        found[first : first + BLOCK] = least.reshape(-1, VALLEYS).min(axis=1)
    return found


def _valleys(distance: FloatArray) -> IntArray:
    """Returns the lowest local minima of grids (b, n, n) as flat indices, shape (b, VALLEYS)."""
    b, n, _ = distance.shape
    walled = np.pad(distance, ((0, 0), (1, 1), (1, 1)), constant_values=np.inf)
    lowest = np.ones(distance.shape, dtype=np.bool_)
    for i in range(3):
        for j in range(3):
            lowest &= distance <= walled[:, i : i + n, j : j + n]
    height = np.where(lowest, distance, np.inf).reshape(b, -1)
    return np.asarray(np.argpartition(height, VALLEYS, axis=1)[:, :VALLEYS], dtype=np.int64)


def _descended(
    axes: ThreeAxes, q: FloatArray, wanted: FloatArray, low: FloatArray, high: FloatArray
) -> FloatArray:
    """Returns the least distances (b,) that Newton's method with trust in its steps finds from joints (b, 2)."""
    active = np.arange(len(q))
    least = np.hypot(*(axes.section(q)[0] - wanted).T)
    trust = np.full(len(q), LARGEST_STEP)
    for _ in range(STEPS):
        here = q[active]
        step = _newton_step(axes, here, wanted[active], low, high)
        longest = np.abs(step).max(axis=1)
        step *= np.minimum(1.0, trust[active] / np.maximum(longest, 1e-300))[:, None]
        tried = np.clip(here + step, low, high)
        away = np.hypot(*(axes.section(tried)[0] - wanted[active]).T)
        better = away < least[active]
        q[active[better]], least[active[better]] = tried[better], away[better]
        size = np.abs(tried - here).max(axis=1)
        trust[active] = np.where(better, np.minimum(2.0 * trust[active], LARGEST_STEP), 0.25 * size)
        active = active[size > STILL]
        if not len(active):
            break
    return least


def _newton_step(
    axes: ThreeAxes, q: FloatArray, wanted: FloatArray, low: FloatArray, high: FloatArray
) -> FloatArray:
    """Returns steps (b, 2) downhill on half the squared distance; joints that a limit stops are held."""
    at, slope, bend = axes.section(q)
    e = at - wanted
    gradient = (slope * e[:, :, None]).sum(axis=1)
    H = np.swapaxes(slope, 1, 2) @ slope + (bend * e[:, :, None, None]).sum(axis=1)
    held = ((q <= low) & (gradient > 0.0)) | ((q >= high) & (gradient < 0.0))
    gradient = np.where(held, 0.0, gradient)
    H[held[:, 0] | held[:, 1], 0, 1] = H[held[:, 0] | held[:, 1], 1, 0] = 0.0
    values, vectors = np.linalg.eigh(H)
    # Where it curves downwards the step goes downhill all the same.
    values = np.maximum(np.abs(values), 1e-9)
    along = (gradient[:, None] @ vectors)[:, 0] / values
    return -(vectors @ along[..., None])[..., 0]
