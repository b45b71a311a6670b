"""Pareto sets: what nothing else is at least as good as in everything and better in something."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray

_BLOCK = 256


def pareto_set(costs: FloatArray) -> BoolArray:
    """Returns which rows no other row dominates, shape (n,).

    Equal rows do not dominate each other.

    Args:
        costs: shape (n, k), the smaller the better; finite.
    """
    count = len(costs)
    kept = np.ones(count, dtype=bool)
    for start in range(0, count, _BLOCK):
        own = costs[start : start + _BLOCK, None, :]
        at_least = np.all(costs <= own, axis=2)
        better = np.any(costs < own, axis=2)
        kept[start : start + _BLOCK] = ~np.any(at_least & better, axis=1)
    return kept
