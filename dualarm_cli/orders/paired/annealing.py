"""Good orders of many stages without rules: simulated annealing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dualarm_cli.compiled.stage_annealing import (
    AnnealedTasks,
    AnnealingShares,
    PairedLengths,
    StageLine,
    anneal_stages,
)
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.geometry.elementary import power
from dualarm_cli.orders.paired.problem import StageOrder, StageProblem
from dualarm_cli.orders.paired.times import with_angles

HOT, COLD = 0.06, 0.0015
"""First and last temperature, in shares of a stage's mean length."""
SHARES = AnnealingShares.of((384, 48, 128), (1, 2, 3, 2, 4, 2, 3, 5), (0.15, 0.1, 0.02))
"""Exchanges, changes within a few stages and moves of runs in each round; how many stages those are, round after round;
shares of exchanges with a task that is not near, with an idle arm, and with stages of its own."""
NEAR = 24
"""Tasks that are near another one."""
REFRESHED = 20
"""After so many rounds all platform angles are chosen anew."""


def is_served(problem: StageProblem) -> bool:
    """Returns whether a problem is two arms', without any rule of order, windows, hand-overs and buffers."""
    rules = problem.before or problem.sequences or problem.in_file_order or problem.handovers
    windows = problem.not_before is not None or problem.not_after is not None
    return len(problem.length) == 2 and not rules and not windows and problem.stores is None


class StageAnnealing:
    """Simulated annealing [Kirkpatrick1983] on one order.

    A change is priced with the angles that suit its stages best between those around it, which stay. Tasks change
    places, or go to where an arm is idle, or to stages of their own; stops of a few stages in a row are shifted, turned
    round or change places; runs of stages go to another place, or are made in the opposite order.
    """

    def __init__(self, problem: StageProblem, seed: int) -> None:
        """Prepares what is near to what."""
        assert is_served(problem)  # callers have looked
        self._problem = problem
        self._random = np.random.default_rng(seed)
        one, other = problem.length
        least = one.min(axis=(2, 3)), other.min(axis=(2, 3))
        turns = problem.returns and not problem.free_start
        back = problem.turn[:, 0] if turns else np.zeros(len(problem.turn))
        start = problem.free_start
        self._lengths = PairedLengths.of((one, other), least, problem.apart, back, free_start=start)
        self._tasks = AnnealedTasks.of(problem.tasks, _near_tasks(problem, least))

    def line(self, slots: IntArray) -> StageLine:
        """Returns an order with the best angles for it."""
        seed = int(self._random.integers(2**64, dtype=np.uint64))
        line = StageLine.of(self._lengths, slots, seed)
        self.anneal(line, range(0), (0.0, 1.0))
        return line

    def anneal(self, line: StageLine, rounds: range, heat: tuple[float, float]) -> None:
        """Makes some rounds, see `anneal_stages`."""
        anneal_stages(self._lengths, self._tasks, SHARES, line, rounds, heat)

    def improve(
        self,
        start: StageOrder,
        rounds: int,
        better: Callable[[StageOrder], None] = lambda _: None,
        stop: Callable[[], bool] = lambda: False,
        heat: float = HOT,
        met: Callable[[StageOrder], None] = lambda _: None,
    ) -> StageOrder:
        """Returns the best order found from one to begin with, never a worse one.

        Args:
            start: an order that can be.
            rounds: how many.
            better: receives every new best one, once in a while; its angles are left out.
            stop: whether to stop early.
            heat: first temperature, in shares of a stage's mean length.
            met: receives, once in a while, what order the annealing is at, with the best angles for it.
        """
        line = self.line(start.slots)
        total, warm = line.best, heat * line.total / len(line.slots)
        cooling = power(COLD / heat, 1.0 / max(1, rounds))
        for k in range(0, rounds, REFRESHED):
            if stop():
                break
            some = range(k, min(rounds, k + REFRESHED))
            self.anneal(line, some, (warm * power(cooling, k + 1), cooling))
            met(StageOrder(line.slots, line.angles[1:], line.total))
            if line.best < total:
                total = line.best
                better(StageOrder(line.best_slots, np.zeros(0, dtype=np.int64), total))
        found = with_angles(self._problem, line.best_slots)
        if found.total < total - 1e-9:
            better(found)
        return found if found.total < start.total else start


def _near_tasks(problem: StageProblem, lengths: tuple[FloatArray, FloatArray]) -> IntArray:
    """Returns the nearest other tasks of each: those that follow it soonest on any arm, shape (t, NEAR or fewer).

    Args:
        problem: what is asked.
        lengths: by arm, from stop to stop at the best angles [s], shape (s + 1, s + 2).
    """
    first = np.array([own[0] for own in problem.tasks])
    last = np.array([own[-1] for own in problem.tasks])
    least: FloatArray = np.full((len(first), len(first)), np.inf)
    for length in lengths:
        quickest = length[np.ix_(last, first)]
        least = np.minimum(least, np.minimum(quickest, quickest.T))
    np.fill_diagonal(least, np.inf)
    return np.argsort(least, axis=1, kind="stable")[:, : max(1, min(NEAR, len(first) - 1))]
