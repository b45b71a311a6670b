"""The nearest neighbour: of two paired arms' stops what is done soonest comes next."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.sequencing.stage_problem import IDLE, StageProblem


def nearest_stages(problem: StageProblem) -> IntArray | None:
    """Returns stages made one after the other, shape (n, arms), of two arms; None where it comes to no end.

    In each, one arm takes the stop that it has done soonest, and the other one the soonest done of those that are left
    and that it can make beside it; whichever arm chooses first, and at whichever platform angle, the stage that is over
    first is taken, and among equals that in which the arms need less together. An arm that has picked places next.
    """
    came, at = [problem.stops, problem.stops], 0
    due: list[tuple[int, ...]] = [(), ()]
    left = [tuple(own) for own in problem.tasks]
    rows: list[tuple[int, ...]] = []
    while left or any(due):
        options: list[tuple[float, float, int, tuple[int, ...]]] = []
        can = [_candidates(left, due[a]) for a in range(2)]
        for first in range(2):
            options += _stages(problem, came, at, can, first)
        if not options:
            return None
        _, _, at, row = min(options)
        for a, stop in enumerate(row):
            if stop == IDLE:
                continue
            came[a] = stop
            own = due[a] or next(one for one in left if one[0] == stop)
            left = [one for one in left if one[0] != stop]
            due[a] = own[1:]
        rows.append(row)
    return np.array(rows, dtype=np.int64)


def _candidates(left: list[tuple[int, ...]], due: tuple[int, ...]) -> IntArray:
    stops = [due[0]] if due else [own[0] for own in left]
    return np.array(stops, dtype=np.int64)


def _stages(
    problem: StageProblem, came: list[int], at: int, can: list[IntArray], first: int
) -> list[tuple[float, float, int, tuple[int, ...]]]:
    """Returns length, sum, angle and stops of the best stage at each angle, one arm choosing first."""
    other, found = 1 - first, []
    for g in range(len(problem.turn)):
        own = problem.length[first][came[first], can[first], at, g]
        if not np.isfinite(own).any():
            continue
        k = int(own.argmin())
        stop, one = int(can[first][k]), float(own[k])
        rest = can[other][can[other] != stop]
        lengths: FloatArray = np.array(problem.length[other][came[other], rest, at, g])
        if problem.apart is not None:
            pair = (stop, rest) if first == 0 else (rest, stop)
            lengths = lengths + problem.apart[(*pair, g)]
        row = [IDLE, IDLE]
        row[first] = stop
        if len(rest) and np.isfinite(lengths).any():
            m = int(lengths.argmin())
            row[other] = int(rest[m])
            # What is done side by side is worth more than what is done alone: by the stop.
            two = float(lengths[m])
            found.append((0.5 * max(one, two), one + two, g, tuple(row)))
        else:
            found.append((one, one, g, tuple(row)))
    return found
