"""A lower bound on orders of any number of stops: what each stage takes at least, whatever comes before it."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.sequencing.stage_problem import StageProblem

AT_ONCE = 64
"""Stops of one arm that are looked at together."""


def pair_bound(problem: StageProblem) -> float:
    """Returns what no order takes less than [s], for one arm or two.

    Every stop is made in one stage, alone or with one other: stops are given partners so that the least lengths of all
    stages together are least, as an assignment [Kuhn1955] in which the partner of a partner may be a third one.
    """
    every = np.arange(problem.stops)
    least = [_least(length, problem.stops) for length in problem.length]
    alone = np.min([own.min(axis=(1, 2)) for own in least], axis=0)
    cost: FloatArray = np.full((problem.stops, problem.stops), np.inf)
    if len(least) == 2:
        for k in range(0, problem.stops, AT_ONCE):
            one = least[0][k : k + AT_ONCE]
            whole: FloatArray = np.full((len(one), problem.stops), np.inf)
            for f, g in np.ndindex(*problem.turn.shape):
                both = np.maximum(one[:, None, f, g], least[1][None, :, f, g])
                np.minimum(whole, both, out=whole)
            cost[k : k + AT_ONCE] = whole
        cost = np.minimum(cost, cost.T)
    cost[every, every] = 2.0 * alone
    finite = np.isfinite(cost)
    if not finite.any(axis=1).all():
        return np.inf
    from scipy.optimize import linear_sum_assignment

    large = 4.0 * problem.stops * float(cost[finite].max())
    rows, columns = linear_sum_assignment(np.where(finite, cost, large))
    return 0.5 * float(cost[rows, columns].sum()) + _least_way_back(problem)


def _least(length: FloatArray, stops: int) -> FloatArray:
    """Returns an arm's least length of a stage by stop and angles before and in it [s], shape (s, f, f)."""
    found: FloatArray = np.full((stops, *length.shape[2:]), np.inf)
    for k, row in enumerate(length):
        # No stop comes after itself.
        others = np.arange(stops) != k
        found[others] = np.minimum(found[others], row[:stops][others])
    return found


def _least_way_back(problem: StageProblem) -> float:
    """Returns what the way back takes at least [s]."""
    if not problem.returns:
        return 0.0
    ways = [length[: problem.stops, problem.stops, :, 0] for length in problem.length]
    finite = [way[np.isfinite(way)] for way in ways]
    return float(min(way.min(initial=np.inf) for way in finite))
