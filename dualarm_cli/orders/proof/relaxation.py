"""Relaxation of order search: least times between tasks.

Options and platform angles are all free.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.orders.asynchronous.problem import SequencingProblem
from dualarm_cli.orders.paired.problem import StageProblem
from dualarm_cli.orders.rules.stores import Stores
from dualarm_cli.records import dataclass


def pair_bound(problem: StageProblem) -> float:
    """Compute a lower bound of all orders from pairs of stops [s].

    Every stop is in one stage, alone or with one other stop. Stops are assigned partners so that the sum of the least
    stage lengths is minimal, as an assignment [Kuhn1955] in which the partner of a partner may be a third stop.
    """
    diagonal = np.arange(problem.stops)
    least = [_least(length, problem.stops) for length in problem.length]
    alone = np.min([lengths.min(axis=(1, 2)) for lengths in least], axis=0)
    cost: FloatArray = np.full((problem.stops, problem.stops), np.inf)
    if len(least) == 2:
        size = 64
        for k in range(0, problem.stops, size):
            block = least[0][k : k + size]
            stage_lengths: FloatArray = np.full((len(block), problem.stops), np.inf)
            for f, g in np.ndindex(*problem.turn.shape):
                both = np.maximum(block[:, None, f, g], least[1][None, :, f, g])
                np.minimum(stage_lengths, both, out=stage_lengths)
            cost[k : k + size] = stage_lengths
        cost = np.minimum(cost, cost.T)
    cost[diagonal, diagonal] = 2.0 * alone
    finite = np.isfinite(cost)
    if not finite.any(axis=1).all():
        return np.inf
    from scipy.optimize import linear_sum_assignment

    large = 4.0 * problem.stops * float(cost[finite].max())
    rows, columns = linear_sum_assignment(np.where(finite, cost, large))
    return 0.5 * float(cost[rows, columns].sum()) + _least_return(problem)


def _least(length: FloatArray, stops: int) -> FloatArray:
    """Compute an arm's least stage lengths by stop, angles [s], (s, f, f)."""
    lengths: FloatArray = np.full((stops, *length.shape[2:]), np.inf)
    for k, row in enumerate(length):
        # A stop does not follow itself.
        others = np.arange(stops) != k
        lengths[others] = np.minimum(lengths[others], row[:stops][others])
    return lengths


def _least_return(problem: StageProblem) -> float:
    """Compute the least duration of the return [s]."""
    if not problem.returns:
        return 0.0
    returns = [length[: problem.stops, problem.stops, :, 0] for length in problem.length]
    finite = [times[np.isfinite(times)] for times in returns]
    return float(min(times.min(initial=np.inf) for times in finite))


@dataclass(frozen=True)
class Relaxation:
    """Tasks with least times by arm between ends: a bound of all orders."""

    cost: tuple[FloatArray, ...]
    """Least times between task ends by arm [s], (n + 1, n + 1).

    Entry (i, j) is between the ends of tasks i and j. Infinite if the arm cannot do one of them, whatever the rules.
    The last row is from the start, the last column the return.
    """
    least: FloatArray
    """Least time of each task on any arm [s], shape (n,)."""
    before: tuple[tuple[int, int], ...] = ()
    """Precedence: pairs of tasks, the first finished before the second begins."""
    sequences: tuple[tuple[int, ...], ...] = ()
    """Tasks that one arm does directly one after the other."""
    not_before: FloatArray | None = None
    """Earliest start of each task [s], shape (n,)."""
    not_after: FloatArray | None = None
    """Latest end of each task [s], shape (n,)."""
    in_file_order: bool = False
    """Whether each arm does its tasks in the order of their numbers."""
    stores: Stores | None = None
    """Buffers, with two rows of changes per task.

    Row 2 t is the first stop of task t, row 2 t + 1 the last one, 0 if that is the same.
    """

    @property
    def tasks(self) -> int:
        """Number of tasks."""
        return len(self.least)

    @property
    def timed(self) -> bool:
        """Whether the times of tasks matter."""
        windows = self.not_before is not None or self.not_after is not None
        return bool(self.before) or windows or self.stores is not None

    def costs_with_rules(self, arm: int) -> FloatArray:
        """Compute an arm's costs, infinite for successions that rules forbid."""
        n = self.tasks
        costs = self.cost[arm].astype(np.float64)
        costs[np.arange(n), np.arange(n)] = np.inf
        if self.in_file_order:
            costs[:n, :n][np.tril_indices(n)] = np.inf
        for earlier, later in self.before:
            costs[later, earlier] = np.inf
        for row in self.sequences:
            for task, successor in pairwise(row):
                cost = costs[task, successor]
                costs[task, :] = np.inf
                costs[:, successor] = np.inf
                costs[task, successor] = cost
        return costs

    def allowed(self, arm: int) -> BoolArray:
        """Test which tasks an arm can do, shape (n,)."""
        return np.asarray(np.isfinite(self.cost[arm][:, : self.tasks]).any(axis=0))


def relax_options(problem: SequencingProblem) -> Relaxation:
    """Relax the options of asynchronous tasks at one platform angle."""
    n, w = problem.tasks, problem.options
    costs, least = [], np.full(n, np.inf)
    for a in range(len(problem.arms)):
        times = problem.between[a] + problem.length[a][None, :]
        pad = np.full((times.shape[0] + w - 1,) * 2, np.inf)
        pad[: n * w + 1, : n * w + 1] = times
        costs.append(pad.reshape(n + 1, w, n + 1, w).min(axis=(1, 3)))
        least = np.minimum(least, problem.length[a][: n * w].reshape(n, w).min(axis=1))
    return Relaxation(
        tuple(costs),
        least,
        problem.before,
        problem.sequences,
        problem.not_before if problem.windows else None,
        problem.not_after if problem.windows else None,
        problem.in_file_order,
        _by_task(problem.stores, problem.stops),
    )


def _by_task(stores: Stores | None, stops: Sequence[int]) -> Stores | None:
    """Reduce buffers to two rows per task: first and last stop.

    The last one is 0 if they are the same.
    """
    if stores is None:
        return None
    change = np.zeros((2 * len(stops) + 1, len(stores.initial)), dtype=np.int64)
    first = np.concatenate([[0], np.cumsum(stops)])
    for t, count in enumerate(stops):
        change[2 * t] = stores.change[first[t]]
        if count > 1:
            change[2 * t + 1] = stores.change[first[t + 1] - 1]
    return replace(stores, change=change)


def relax_stages(problem: StageProblem) -> Relaxation:
    """Relax the platform angles of stages.

    Each arm's times are as if the platform moved for it alone.
    """
    n = len(problem.tasks)
    first = np.array([task[0] for task in problem.tasks])
    last = np.array([*(task[-1] for task in problem.tasks), problem.stops])
    costs, least = [], np.full(n, np.inf)
    for a, length in enumerate(problem.length):
        cost = np.full((n + 1, n + 1), np.inf)
        cost[:, :n] = length[last[:, None], first[None, :]].min(axis=(2, 3))
        if not problem.free_start:
            cost[n, :n] = length[problem.stops, first][:, 0].min(axis=1)
        cost[:n, n] = length[last[:n], problem.stops].min(axis=(1, 2))
        inside = np.array(
            [sum(float(length[i, j].min()) for i, j in pairwise(task)) for task in problem.tasks]
        )
        cost[:, :n] += inside
        costs.append(cost)
        least = np.minimum(least, problem.work[a][first].min(axis=1) + inside)
    early, late = problem.not_before, problem.not_after
    return Relaxation(
        tuple(costs),
        least,
        problem.before,
        problem.sequences,
        None if early is None else early[first],
        None if late is None else late[last[:n]],
        problem.in_file_order,
        _by_task(problem.stores, [len(task) for task in problem.tasks]),
    )
