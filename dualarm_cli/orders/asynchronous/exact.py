"""The best order of few tasks, proven: dynamic programming over subsets, enumeration where arms wait for each other."""

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
    """Returns whether `exact_order` serves a problem."""
    if problem.coupled:
        # Few are enumerated, and fewer where buffers make arms wait.
        return problem.tasks <= (7 if problem.stores is None else 5)
    nodes = problem.tasks * problem.options
    # Subsets times nodes times nodes: beyond this dynamic programming takes too long.
    return problem.tasks <= 13 and nodes * nodes * 2**problem.tasks // 2 <= 700_000_000


def exact_order(problem: SequencingProblem) -> Timed | None:
    """Returns the best order of all, None where there is none.

    Where the arms do not depend on each other, every arm's least time for every subset of tasks [Held1962], and the
    subset whose slower arm is quickest. Otherwise that is a bound for every assignment: those that could be better than
    the best so far are enumerated, each arm's tasks in the ways that make its own time least.

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
    most = np.max(values, axis=0)
    rank = np.lexsort((subsets, np.sum(values, axis=0), most))
    if not np.isfinite(most[rank[0]]):
        return None
    parts = [(s, everything - s)[: len(tables)] for s in subsets[rank].tolist()]
    if not problem.coupled:
        nodes = tuple(t.nodes(s) for t, s in zip(tables, parts[0], strict=True))
        return timed(problem, Order(nodes))
    return _enumerated(problem, parts, most[rank])


def _enumerated(
    problem: SequencingProblem, parts: list[tuple[int, ...]], bounds: FloatArray
) -> Timed | None:
    best: Timed | None = None
    for part, bound in zip(parts, bounds.tolist(), strict=True):
        if not np.isfinite(bound) or (best is not None and bound >= best.total):
            break
        each = [_orders(problem, a, subset, len(part)) for a, subset in enumerate(part)]
        for one in each[0]:
            for other in each[1] if len(each) == 2 else [((), 0.0)]:
                if best is not None and max(one[1], other[1]) >= best.total:
                    break
                tasks = (one[0], other[0])[: len(each)]
                found = timed(problem, best_options(problem, tasks))
                if found.is_possible and (best is None or found.total < best.total):
                    best = found
    return best


def _orders(
    problem: SequencingProblem, a: int, subset: int, arms: int
) -> list[tuple[tuple[int, ...], float]]:
    """Returns one arm's orders of a subset that keep the rules, each with the arm's own time, quickest first."""
    tasks = [t for t in range(problem.tasks) if subset >> t & 1]
    found = []
    for own in permutations(tasks):
        every: list[tuple[int, ...]] = [()] * arms
        every[a] = own
        if keeps_rules(problem, [own]):
            found.append((own, busy_times(problem, best_options(problem, every))[a]))
    return sorted(found, key=lambda one: (one[1], one[0]))


class _Subsets:
    """One arm's least time for every subset of tasks, the way back included [Held1962]."""

    value: FloatArray
    """Least time [s], infinite where the subset cannot be done, shape (2^n,)."""

    def __init__(self, problem: SequencingProblem, a: int) -> None:
        self._problem, self._a = problem, a
        n, w = problem.tasks, problem.options
        between, length = problem.between[a], problem.length[a]
        start, nodes = problem.start_node, np.arange(n * w)
        step = between[: n * w, : n * w] + length[None, : n * w]
        step = np.where(self._may_follow(), step, np.inf)
        # Least time of a subset that ends with a node; its node before is found again when asked for.
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
            # What comes before another task of the same arm is not done after it.
            if not subset & bit or any(
                one == task and subset >> other & 1 for one, other in problem.before
            ):
                continue
            if problem.in_file_order and subset >> (task + 1):
                continue
            own = slice(task * w, (task + 1) * w)
            table[subset, own] = (table[subset ^ bit][:, None] + self._step[:, own]).min(axis=0)

    def _may_follow(self) -> BoolArray:
        """Returns which node may come right after which, shape (n w, n w)."""
        n, w = self._problem.tasks, self._problem.options
        task = np.arange(n * w) // w
        may = task[:, None] != task[None, :]
        for row in self._problem.sequences:
            for one, other in pairwise(row):
                may &= (task[:, None] == one) == (task[None, :] == other)
        return may

    def _may_begin(self) -> BoolArray:
        task = np.arange(self._problem.tasks * self._problem.options) // self._problem.options
        later = [t for row in self._problem.sequences for t in row[1:]]
        return ~np.isin(task, later)

    def _may_end(self) -> BoolArray:
        task = np.arange(self._problem.tasks * self._problem.options) // self._problem.options
        sooner = [t for row in self._problem.sequences for t in row[:-1]]
        return ~np.isin(task, sooner)

    def nodes(self, subset: int) -> tuple[int, ...]:
        """Returns the best order of a subset."""
        if subset == 0:
            return ()
        w = self._problem.options
        node = int((self._table[subset] + self._ending).argmin())
        found = [node]
        while subset != 1 << node // w:
            subset ^= 1 << node // w
            node = int((self._table[subset] + self._step[:, node]).argmin())
            found.append(node)
        return tuple(reversed(found))


def _subsets(n: int, count: int) -> IntArray:
    numbers = np.arange(2**n)
    bits = np.zeros(2**n, dtype=np.int64)
    for k in range(n):
        bits += numbers >> k & 1
    return numbers[bits == count]
