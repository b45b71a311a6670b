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
        at_least, better = (costs <= own).all(axis=2), (costs < own).any(axis=2)
        kept[start : start + _BLOCK] = ~(at_least & better).any(axis=1)
    return kept
