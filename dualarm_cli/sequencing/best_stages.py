"""Which stops of two arms are made side by side where each arm's own order is given: exact, at all platform angles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.sequencing.stage_problem import IDLE, StageProblem
from dualarm_cli.sequencing.stage_times import closing, in_windows

EARLY = 1e-5
"""What it counts that an arm with stops left is idle for a stage [s]: of equal orders the early one is taken."""
MOVES = ((1, 1), (1, 0), (0, 1))
"""Who makes a stop in a stage: both arms, or one of them."""


def best_stages(problem: StageProblem, rows: Sequence[Sequence[int]]) -> IntArray:
    """Returns the quickest stages of two arms whose orders are given, or of one, shape (n, arms).

    A dynamic programme over how many stops each arm has made and the platform's angle. Where no stages are possible,
    those of one arm after those of the other.

    Args:
        problem: what is asked; its own rules of order are kept but for precedence on one arm, which the rows say;
            so are its buffers.
        rows: by arm, its stops one after the other.
    """
    if len(rows) == 1:
        return np.array(rows[0], dtype=np.int64).reshape(-1, 1)
    n, m, f = len(rows[0]), len(rows[1]), len(problem.turn)
    needs, levels = _needs(problem, rows), _levels(problem, rows)
    values = np.full((n + 1, m + 1, f), np.inf)
    values[0, 0, slice(None) if problem.free_start else 0] = 0.0
    move = np.full((n + 1, m + 1, f), -1)
    came = np.zeros((n + 1, m + 1, f), dtype=np.int64)
    for i in range(n + 1):
        for j in range(m + 1):
            if not np.isfinite(values[i, j]).any():
                continue
            for number, (one, other) in enumerate(MOVES):
                if i + one > n or j + other > m:
                    continue
                if (one and needs[0][i] > j) or (other and needs[1][j] > i):
                    continue
                stops = np.array([[rows[0][i] if one else IDLE, rows[1][j] if other else IDLE]])
                if problem.stores is not None and problem.stores.fits(levels[i, j], stops[0]):
                    continue
                over = _over(problem, rows, (i, j), (one, other), values[i, j])
                best, start = over.min(axis=0), over.argmin(axis=0)
                best = in_windows(problem, stops, best[None])[0]
                better = best < values[i + one, j + other]
                values[i + one, j + other][better] = best[better]
                move[i + one, j + other][better] = number
                came[i + one, j + other][better] = start[better]
    last = np.array([[row[-1] if row else problem.length[0].shape[0] - 1 for row in rows]])
    total = values[n, m] + closing(problem, last)[0]
    if not np.isfinite(total).any():
        return np.array(
            [*([stop, IDLE] for stop in rows[0]), *([IDLE, stop] for stop in rows[1])],
            dtype=np.int64,
        ).reshape(-1, 2)
    return _traced(rows, move, came, int(total.argmin()))


def _over(
    problem: StageProblem,
    rows: Sequence[Sequence[int]],
    made: tuple[int, int],
    moves: tuple[int, int],
    value: FloatArray,
) -> FloatArray:
    """Returns when a stage is over, by the angle before and its own [s], shape (f, f)."""
    whole: FloatArray = np.full((len(value), len(value)), -np.inf)
    stops = []
    for length, row, k, moves_on in zip(problem.length, rows, made, moves, strict=True):
        here = row[k - 1] if k else length.shape[0] - 1
        stops.append(row[k] if moves_on else IDLE)
        if moves_on:
            whole = np.maximum(whole, length[here, row[k]])
    if problem.apart is not None:
        whole = whole + problem.apart[stops[0], stops[1]][None]
    idle = [not on and k < len(row) for on, k, row in zip(moves, made, rows, strict=True)]
    return value[:, None] + whole + EARLY * sum(idle)


def _needs(problem: StageProblem, rows: Sequence[Sequence[int]]) -> list[list[int]]:
    """Returns, by arm and stop, how many stops of the other arm have to be over before it begins."""
    places = [{stop: k for k, stop in enumerate(row)} for row in rows]
    found = [[0] * len(row) for row in rows]
    for before, after in problem.before:
        first, last = problem.tasks[after][0], problem.tasks[before][-1]
        for a in (0, 1):
            if first in places[a] and last in places[1 - a]:
                k = places[a][first]
                found[a][k] = max(found[a][k], places[1 - a][last] + 1)
    return found


def _levels(problem: StageProblem, rows: Sequence[Sequence[int]]) -> IntArray:
    """Returns how many parts are in each of K buffers after so many stops of each arm, shape (n + 1, m + 1, K)."""
    if problem.stores is None:
        return np.zeros((len(rows[0]) + 1, len(rows[1]) + 1, 0), dtype=np.int64)
    changes = [problem.stores.change[np.array([IDLE, *row])].cumsum(axis=0) for row in rows]
    found: IntArray = problem.stores.initial + changes[0][:, None] + changes[1][None]
    return found


def _traced(rows: Sequence[Sequence[int]], move: IntArray, came: IntArray, angle: int) -> IntArray:
    """Returns the stages that lead to an angle at the end."""
    i, j = len(rows[0]), len(rows[1])
    found = []
    while i or j:
        one, other = MOVES[int(move[i, j, angle])]
        before = int(came[i, j, angle])
        i, j = i - one, j - other
        found.append([rows[0][i] if one else IDLE, rows[1][j] if other else IDLE])
        angle = before
    return np.array(found[::-1], dtype=np.int64).reshape(-1, 2)
