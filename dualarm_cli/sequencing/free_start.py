"""Orders that begin anywhere and go back there: what they take with the way back that they really have."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.sequencing.stage_problem import IDLE, StageOrder, StageProblem


def closed(problem: StageProblem, found: StageOrder) -> StageOrder:
    """Returns an order with a total in which every arm goes back to where its first stop is begun.

    The search counts the least way back to any stop there is; the angles stay as it chose them.

    Args:
        problem: what is asked; with a free start, and there and back.
        found: an order, with its angles.
    """
    if not len(found.angles) or not np.isfinite(found.total):
        return found
    begin, end = int(found.angles[0]), int(found.angles[-1])
    counted, real = 0.0, float(problem.turn[end, begin])
    for length, work, own in zip(problem.length, problem.work, found.slots.T, strict=True):
        stops = own[own != IDLE]
        if not len(stops):
            continue
        first, last = int(stops[0]), int(stops[-1])
        least = float(length[last, problem.stops, end, 0])
        counted = max(counted, least)
        way = float(length[last, first, end, begin]) - float(work[first, begin])
        # An arm whose first stop comes later begins somewhere else.
        real = max(real, way if np.isfinite(way) else least)
    return replace(found, total=found.total + max(0.0, real - counted))
