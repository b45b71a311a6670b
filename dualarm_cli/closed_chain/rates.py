"""How fast a seam can be at a steady speed, by the differences of its joints from node to node."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.robot import JointLimits


def steady_times(position: FloatArray, limits: JointLimits) -> FloatArray:
    """Returns the least times for whole seams at a steady speed, from velocity, acceleration and jerk, (..., 3) [s].

    A seam of time T has the rates q' / T, q'' / T², q''' / T³, primes by the share.

    Args:
        position: joints at equidistant nodes [rad], shape (..., k, n), k at least 4.
        limits: of the n joints.
    """
    step = 1.0 / (position.shape[-2] - 1)
    found = []
    for order, limit in enumerate((limits.velocity, limits.acceleration, limits.jerk), start=1):
        rates = np.abs(np.diff(position, order, axis=-2)) / step**order / limit
        found.append(rates.max(axis=(-2, -1)) ** (1.0 / order))
    return np.stack(found, axis=-1)


def steady_time(position: FloatArray, limits: JointLimits) -> float:
    """Returns the largest of them for one seam [s]."""
    return float(steady_times(position, limits).max())
