"""Optimal order of few tasks: dynamic programming over subsets, or enumeration.

Orders are enumerated where arms wait for each other.
"""

from __future__ import annotations

from itertools import pairwise, permutations

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.orders.asynchronous.problem import Order, SequencingProblem
from dualarm_cli.orders.asynchronous.times import (
    Timed,
    best_options,
    busy_times,
    keeps_rules,
    timed,
)


def is_small(problem: SequencingProblem) -> bool:
    """Test whether a problem is small enough for `exact_order`."""
    if problem.coupled:
        # Orders are enumerated, which takes longer with buffers.
        return problem.tasks <= (7 if problem.stores is None else 5)
    nodes = problem.tasks * problem.options
    # Subsets times nodes times nodes: beyond this dynamic programming takes too long.
    return problem.tasks <= 13 and nodes * nodes * 2**problem.tasks // 2 <= 700_000_000


def exact_order(problem: SequencingProblem) -> Timed | None:
    """Compute the optimal order, or None if no order is feasible.

    If the arms are independent: the least time of every arm for every subset of tasks [Held1962], and the partition
    with the least makespan. Otherwise that is a lower bound for every partition, and partitions that may improve on the
    best order are enumerated, each arm's tasks with the options that minimise its busy time.

    Args:
        problem: for which `is_small` holds.
    """
    tables = [_Subsets(problem, a) for a in range(len(problem.arms))]
    everything = 2**problem.tasks - 1
    subsets = np.arange(everything + 1)
    if len(tables) == 1:
        subsets = subsets[-1:]
    values = [tables[0].value[subsets]]
    if len(tables) == 2:
        values.append(tables[1].value[everything - subsets])
    bounds = np.max(values, axis=0)
    rank = np.lexsort((subsets, np.sum(values, axis=0), bounds))
    if not np.isfinite(bounds[rank[0]]):
        return None
    parts = [(s, everything - s)[: len(tables)] for s in subsets[rank].tolist()]
    if not problem.coupled:
        nodes = tuple(t.nodes(s) for t, s in zip(tables, parts[0], strict=True))
        return timed(problem, Order(nodes))
    return _enumerated(problem, parts, bounds[rank])


def _enumerated(
    problem: SequencingProblem, parts: list[tuple[int, ...]], bounds: FloatArray
) -> Timed | None:
    best: Timed | None = None
    for part, bound in zip(parts, bounds.tolist(), strict=True):
        if not np.isfinite(bound) or (best is not None and bound >= best.total):
            break
        each = [_orders(problem, a, subset, len(part)) for a, subset in enumerate(part)]
        for first in each[0]:
            for second in each[1] if len(each) == 2 else [((), 0.0)]:
                if best is not None and max(first[1], second[1]) >= best.total:
                    break
                tasks = (first[0], second[0])[: len(each)]
                candidate = timed(problem, best_options(problem, tasks))
                if candidate.is_possible and (best is None or candidate.total < best.total):
                    best = candidate
    return best


def _orders(
    problem: SequencingProblem, a: int, subset: int, arms: int
) -> list[tuple[tuple[int, ...], float]]:
    """List one arm's feasible orders of a subset with their busy times, shortest first."""
    tasks = [t for t in range(problem.tasks) if subset >> t & 1]
    orders = []
    for row in permutations(tasks):
        rows: list[tuple[int, ...]] = [()] * arms
        rows[a] = row
        if keeps_rules(problem, [row]):
            orders.append((row, busy_times(problem, best_options(problem, rows))[a]))
    return sorted(orders, key=lambda order: (order[1], order[0]))


class _Subsets:
    """Least time of one arm for every subset of tasks, with the return [Held1962]."""

    value: FloatArray
    """Least time [s], shape (2^n,); infinite for infeasible subsets."""

    def __init__(self, problem: SequencingProblem, a: int) -> None:
        self._problem, self._a = problem, a
        n, w = problem.tasks, problem.options
        between, length = problem.between[a], problem.length[a]
        start, nodes = problem.start_node, np.arange(n * w)
        step = between[: n * w, : n * w] + length[None, : n * w]
        step = np.where(self._may_follow(), step, np.inf)
        # Least time of a subset that ends with a node; `nodes` traces the predecessors.
        self._table = table = np.full((2**n, n * w), np.inf)
        first = between[start, : n * w] + length[: n * w]
        table[1 << nodes // w, nodes] = np.where(self._may_begin(), first, np.inf)
        self._step = step
        for task_count in range(2, n + 1):
            for subset in _subsets(n, task_count):
                self._fill(subset)
        ending = np.where(self._may_end(), between[: n * w, start], np.inf)
        self._ending = ending
        closed = table + ending
        self.value = closed.min(axis=1) if n else np.zeros(1)
        self.value[0] = 0.0

    def _fill(self, subset: int) -> None:
        problem, table, w = self._problem, self._table, self._problem.options
        for task in range(problem.tasks):
            bit = 1 << task
            # A task cannot end a subset that has a task which it must precede.
            if not subset & bit or any(
                earlier == task and subset >> later & 1 for earlier, later in problem.before
            ):
                continue
            if problem.in_file_order and subset >> (task + 1):
                continue
            columns = slice(task * w, (task + 1) * w)
            table[subset, columns] = (table[subset ^ bit][:, None] + self._step[:, columns]).min(
                axis=0
            )

    def _may_follow(self) -> BoolArray:
        """Test which nodes may directly follow each other, shape (n w, n w)."""
        n, w = self._problem.tasks, self._problem.options
        task = np.arange(n * w) // w
        allowed = task[:, None] != task[None, :]
        for row in self._problem.sequences:
            for earlier, later in pairwise(row):
                allowed &= (task[:, None] == earlier) == (task[None, :] == later)
        return allowed

    def _may_begin(self) -> BoolArray:
        task = np.arange(self._problem.tasks * self._problem.options) // self._problem.options
        later = [t for row in self._problem.sequences for t in row[1:]]
        return ~np.isin(task, later)

    def _may_end(self) -> BoolArray:
        task = np.arange(self._problem.tasks * self._problem.options) // self._problem.options
        sooner = [t for row in self._problem.sequences for t in row[:-1]]
        return ~np.isin(task, sooner)

    def nodes(self, subset: int) -> tuple[int, ...]:
        """Trace the best order of a subset."""
        if subset == 0:
            return ()
        w = self._problem.options
        node = int((self._table[subset] + self._ending).argmin())
        route = [node]
        while subset != 1 << node // w:
            subset ^= 1 << node // w
            node = int((self._table[subset] + self._step[:, node]).argmin())
            route.append(node)
        return tuple(reversed(route))


def _subsets(n: int, count: int) -> IntArray:
    numbers = np.arange(2**n)
    bits = np.zeros(2**n, dtype=np.int64)
    for k in range(n):
        bits += numbers >> k & 1
    return numbers[bits == count]
