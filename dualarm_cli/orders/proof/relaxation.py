"""Least times between tasks, whatever ways and platform angles are taken: what bounds are proven with."""

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
    """Returns what no order takes less than [s], for one arm or two.

    Every stop is made in one stage, alone or with one other: stops are given partners so that the least lengths of all
    stages together are least, as an assignment [Kuhn1955] in which the partner of a partner may be a third one.
    """
    every = np.arange(problem.stops)
    least = [_least(length, problem.stops) for length in problem.length]
    alone = np.min([own.min(axis=(1, 2)) for own in least], axis=0)
    cost: FloatArray = np.full((problem.stops, problem.stops), np.inf)
    if len(least) == 2:
        size = 64
        for k in range(0, problem.stops, size):
            one = least[0][k : k + size]
            whole: FloatArray = np.full((len(one), problem.stops), np.inf)
            for f, g in np.ndindex(*problem.turn.shape):
                both = np.maximum(one[:, None, f, g], least[1][None, :, f, g])
                np.minimum(whole, both, out=whole)
            cost[k : k + size] = whole
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


@dataclass(frozen=True)
class Relaxation:
    """Tasks with the least time from the end of each to the end of each other, by arm; no order takes less."""

    cost: tuple[FloatArray, ...]
    """By arm, the least time from the end of task i to the end of task j [s], infinite where an arm cannot do one,
    whatever the rules; the last row is from the start, the last column the way back, shape (n + 1, n + 1)."""
    least: FloatArray
    """Least time of each task itself on any arm [s], shape (n,)."""
    before: tuple[tuple[int, int], ...] = ()
    """Pairs of tasks of which the first is over before the second begins."""
    sequences: tuple[tuple[int, ...], ...] = ()
    """Tasks that one arm does one right after the other."""
    not_before: FloatArray | None = None
    """Earliest instant at which a task may begin [s], shape (n,)."""
    not_after: FloatArray | None = None
    """Latest instant at which a task may be over [s], shape (n,)."""
    in_file_order: bool = False
    """Whether each arm does its tasks in the order of their numbers."""
    stores: Stores | None = None
    """Buffers; row 2 t of what is changed is the first stop of task t, row 2 t + 1 its last one, 0 for the same."""

    @property
    def tasks(self) -> int:
        """How many."""
        return len(self.least)

    @property
    def timed(self) -> bool:
        """Whether it matters when a task is done."""
        windows = self.not_before is not None or self.not_after is not None
        return bool(self.before) or windows or self.stores is not None

    def kept(self, arm: int) -> FloatArray:
        """Returns an arm's costs, infinite too where rules forbid that one task comes right after another."""
        n = self.tasks
        found = self.cost[arm].astype(np.float64)
        found[np.arange(n), np.arange(n)] = np.inf
        if self.in_file_order:
            found[:n, :n][np.tril_indices(n)] = np.inf
        for one, other in self.before:
            found[other, one] = np.inf
        for row in self.sequences:
            for one, other in pairwise(row):
                keep = found[one, other]
                found[one, :] = np.inf
                found[:, other] = np.inf
                found[one, other] = keep
        return found

    def allowed(self, arm: int) -> BoolArray:
        """Returns which tasks an arm can do, shape (n,)."""
        return np.asarray(np.isfinite(self.cost[arm][:, : self.tasks]).any(axis=0))


def relax_options(problem: SequencingProblem) -> Relaxation:
    """Returns the least times of tasks that can be done in several ways with the platform standing still."""
    n, w = problem.tasks, problem.options
    costs, least = [], np.full(n, np.inf)
    for a in range(len(problem.arms)):
        whole = problem.between[a] + problem.length[a][None, :]
        pad = np.full((whole.shape[0] + w - 1,) * 2, np.inf)
        pad[: n * w + 1, : n * w + 1] = whole
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
    """Returns buffers with two rows for each task, its first stop's and its last one's, 0 where it is the same."""
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
    """Returns the least times of tasks over all platform angles, each arm as if the platform served it alone."""
    n = len(problem.tasks)
    first = np.array([own[0] for own in problem.tasks])
    last = np.array([*(own[-1] for own in problem.tasks), problem.stops])
    costs, least = [], np.full(n, np.inf)
    for a, length in enumerate(problem.length):
        cost = np.full((n + 1, n + 1), np.inf)
        cost[:, :n] = length[last[:, None], first[None, :]].min(axis=(2, 3))
        if not problem.free_start:
            cost[n, :n] = length[problem.stops, first][:, 0].min(axis=1)
        cost[:n, n] = length[last[:n], problem.stops].min(axis=(1, 2))
        inside = np.array(
            [sum(float(length[i, j].min()) for i, j in pairwise(own)) for own in problem.tasks]
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
        _by_task(problem.stores, [len(own) for own in problem.tasks]),
    )
