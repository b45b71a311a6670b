"""Stages as the nodes of a graph: an order is a path through it that has every stop once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from itertools import pairwise
from typing import Protocol

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray, SingleArray
from dualarm_cli.orders.paired.problem import IDLE, StageProblem
from dualarm_cli.records import dataclass

SPARSE = 0.25
"""Where fewer of all ways are possible only those are kept."""


class StageEdges(Protocol):
    """Lengths of ways [s] from m nodes to n nodes, infinite where there is none; in single precision."""

    def least(self, values: SingleArray) -> SingleArray:
        """Returns the least of length and a value of the node that is come from, (m,), by node gone to, (n,)."""
        ...

    def rows(self, came: IntArray) -> SingleArray:
        """Returns the lengths from some nodes, shape (k, n)."""
        ...

    def into(self, node: int) -> SingleArray:
        """Returns the lengths to one node, shape (m,)."""
        ...

    def one_by_one(self, came: IntArray, goes: IntArray) -> SingleArray:
        """Returns the lengths from nodes to nodes, pair by pair, shape (k,)."""
        ...

    def part(self, came: IntArray, goes: IntArray) -> StageEdges:
        """Returns the ways from some nodes to some others."""
        ...

    def turned(self) -> StageEdges:
        """Returns the same ways backwards."""
        ...

    def longer(self, came: IntArray, goes: IntArray, more: FloatArray) -> StageEdges:
        """Returns ways of which some, all of them there, take longer [s], pair by pair; no pair is named twice."""
        ...


@dataclass(frozen=True)
class DenseEdges:
    """Every way."""

    table: SingleArray
    """By node gone to and node come from, so that `least` goes through memory in its order, shape (n, m)."""

    def least(self, values: SingleArray) -> SingleArray:
        """See `StageEdges`."""
        return np.asarray((self.table + values).min(axis=1))

    def rows(self, came: IntArray) -> SingleArray:
        """See `StageEdges`."""
        return np.asarray(self.table[:, came].T)

    def into(self, node: int) -> SingleArray:
        """See `StageEdges`."""
        return np.asarray(self.table[node])

    def one_by_one(self, came: IntArray, goes: IntArray) -> SingleArray:
        """See `StageEdges`."""
        return np.asarray(self.table[goes, came])

    def part(self, came: IntArray, goes: IntArray) -> DenseEdges:
        """See `StageEdges`."""
        return DenseEdges(np.ascontiguousarray(self.table[goes][:, came]))

    def turned(self) -> DenseEdges:
        """See `StageEdges`."""
        return DenseEdges(np.ascontiguousarray(self.table.T))

    def longer(self, came: IntArray, goes: IntArray, more: FloatArray) -> DenseEdges:
        """See `StageEdges`."""
        table = self.table.copy()
        table[goes, came] += more
        return DenseEdges(table)


@dataclass(frozen=True)
class SparseEdges:
    """Only the ways that there are, by node gone to."""

    begin: IntArray
    """Where the ways to each node begin, and where all end, shape (n + 1,)."""
    came: IntArray
    """The node that each comes from, shape (ways,)."""
    length: SingleArray
    """Its length [s], shape (ways,)."""
    count: int
    """How many nodes there are to come from."""

    def least(self, values: SingleArray) -> SingleArray:
        """See `StageEdges`."""
        found = np.full(len(self.begin) - 1, np.inf, dtype=np.float32)
        some = np.flatnonzero(np.diff(self.begin))
        if len(some):
            whole = self.length + values[self.came]
            found[some] = np.minimum.reduceat(whole, self.begin[some])
        return found

    def rows(self, came: IntArray) -> SingleArray:
        """See `StageEdges`."""
        found = np.full((len(came), len(self.begin) - 1), np.inf, dtype=np.float32)
        row = np.full(self.count, -1)
        row[came] = np.arange(len(came))
        own = row[self.came]
        there = own >= 0
        found[own[there], self._goes[there]] = self.length[there]
        return found

    def into(self, node: int) -> SingleArray:
        """See `StageEdges`."""
        found = np.full(self.count, np.inf, dtype=np.float32)
        own = slice(self.begin[node], self.begin[node + 1])
        found[self.came[own]] = self.length[own]
        return found

    def one_by_one(self, came: IntArray, goes: IntArray) -> SingleArray:
        """See `StageEdges`."""
        found = np.full(len(goes), np.inf, dtype=np.float32)
        at, there = self._at(came, goes)
        found[there] = self.length[at[there]]
        return found

    def part(self, came: IntArray, goes: IntArray) -> SparseEdges:
        """See `StageEdges`."""
        number, place = np.full(self.count, -1), np.full(len(self.begin) - 1, -1)
        number[came], place[goes] = np.arange(len(came)), np.arange(len(goes))
        own = place[self._goes]
        kept = (own >= 0) & (number[self.came] >= 0)
        return sparse_edges(
            own[kept], number[self.came[kept]], self.length[kept], len(goes), len(came)
        )

    def turned(self) -> SparseEdges:
        """See `StageEdges`."""
        return sparse_edges(self.came, self._goes, self.length, self.count, len(self.begin) - 1)

    def longer(self, came: IntArray, goes: IntArray, more: FloatArray) -> SparseEdges:
        """See `StageEdges`."""
        length = self.length.copy()
        at, there = self._at(came, goes)
        length[at[there]] += more[there]
        return replace(self, length=length)

    def _at(self, came: IntArray, goes: IntArray) -> tuple[IntArray, BoolArray]:
        """Returns where pairs are among the ways, and whether they are."""
        wanted = goes * self.count + came
        at = np.searchsorted(self._key, wanted)
        there = at < len(self._key)
        there[there] = self._key[at[there]] == wanted[there]
        return at, there

    @cached_property
    def _goes(self) -> IntArray:
        return np.repeat(np.arange(len(self.begin) - 1), np.diff(self.begin))

    @cached_property
    def _key(self) -> IntArray:
        # Ways are sorted by node gone to, then by node come from.
        return self._goes * self.count + self.came


def sparse_edges(
    goes: IntArray, came: IntArray, length: SingleArray, n: int, m: int
) -> SparseEdges:
    """Returns ways that are in any order, shape (ways,) each, to n nodes from m nodes."""
    order = np.lexsort((came, goes))
    begin = np.concatenate([[0], np.cumsum(np.bincount(goes, minlength=n))])
    return SparseEdges(begin, came[order], length[order], m)


def edges_from_rows(rows: Iterator[SingleArray], nodes: int) -> StageEdges:
    """Returns ways given by the nodes they go to, some rows (k, m) at a time, for as many nodes in all."""
    none = np.zeros(0, dtype=np.int64)
    goes, came, length, done = [none], [none], [np.zeros(0, dtype=np.float32)], 0
    for some in rows:
        there = np.isfinite(some)
        u, v = np.nonzero(there)
        goes.append(u + done)
        came.append(v)
        length.append(some[there].astype(np.float32))
        done += len(some)
    where, whence, lasts = np.concatenate(goes), np.concatenate(came), np.concatenate(length)
    if len(where) < SPARSE * nodes * nodes:
        return sparse_edges(where, whence, lasts, nodes, nodes)
    table = np.full((nodes, nodes), np.inf, dtype=np.float32)
    table[where, whence] = lasts
    return DenseEdges(table)


ENDS = -1
"""Stands for the start and the end of a path."""
ROWS_AT_ONCE = 256
"""Nodes whose ways to all others are computed at once."""


@dataclass(frozen=True)
class StageGraph:
    """What may be done in one stage at one platform angle, and how long it takes right after something else.

    Where an arm is idle in a stage, what it did before is forgotten: it then comes from wherever it likes. So no path
    takes longer than its order, and a path without idle arms takes as long. Windows, stores and the order that
    `before` asks for are left out but for what comes right after one another.
    """

    problem: StageProblem
    """What is asked; two arms."""
    stops: IntArray
    """Stops of each node by arm, IDLE for none, shape (m, 2)."""
    angle: IntArray
    """Number of each node's platform angle, shape (m,)."""
    weight: IntArray
    """How many stops are made, shape (m,)."""
    first: FloatArray
    """Length of a stage that comes first [s], shape (m,)."""
    last: FloatArray
    """Length of the way back after a stage that comes last [s], shape (m,)."""
    edges: StageEdges
    """Lengths of stages right after other ones [s], infinite where rules forbid it."""

    @classmethod
    def of(cls, problem: StageProblem, *, singles: bool) -> StageGraph:
        """Returns the graph of a problem.

        Args:
            problem: what is asked; two arms.
            singles: whether an arm may be idle in a stage; without, only orders in which none ever is are paths.
        """
        stops, angle = _nodes(problem, singles=singles)
        came = np.where(stops == IDLE, problem.stops + 1, stops)
        lengths = [_with_forgotten(length) for length in problem.length]
        beside: FloatArray = np.zeros(len(angle))
        if problem.pair_cost is not None:
            beside += problem.pair_cost[stops[:, 0], stops[:, 1], angle]
        begun = [
            length[problem.stops, own, :, angle]
            for length, own in zip(lengths, stops.T, strict=True)
        ]
        whole = np.maximum(begun[0], begun[1])
        first = (whole.min(axis=1) if problem.free_start else whole[:, 0]) + beside
        first[~_may_be_first(problem, stops)] = np.inf

        def rows() -> Iterator[SingleArray]:
            for k in range(0, len(angle), ROWS_AT_ONCE):
                v = slice(k, k + ROWS_AT_ONCE)
                own = [
                    length[came[None, :, a], stops[v, a, None], angle[None], angle[v, None]]
                    for a, length in enumerate(lengths)
                ]
                whole = np.maximum(own[0], own[1]) + beside[v, None]
                whole[~_may_follow(problem, stops, stops[v]).T] = np.inf
                yield whole.astype(np.float32)

        weight = (stops != IDLE).sum(axis=1)
        back = _way_back(problem, lengths, stops, angle)
        ways = edges_from_rows(rows(), len(angle))
        return cls(problem, stops, angle, weight, first, back, ways)

    @property
    def nodes(self) -> int:
        """How many."""
        return len(self.angle)

    def kept(self, which: IntArray) -> StageGraph:
        """Returns the graph of some of its nodes, by their numbers."""
        return replace(
            self,
            stops=self.stops[which],
            angle=self.angle[which],
            weight=self.weight[which],
            first=self.first[which],
            last=self.last[which],
            edges=self.edges.part(which, which),
        )

    def longer(self, moves: IntArray, more: FloatArray) -> StageGraph:
        """Returns the graph in which some moves take longer.

        Args:
            moves: node come from and node gone to, ENDS for the start or the end; no move twice, shape (k, 2).
            more: how much longer [s], shape (k,).
        """
        first, last = self.first.copy(), self.last.copy()
        begins, ends = moves[:, 0] == ENDS, moves[:, 1] == ENDS
        first[moves[begins, 1]] += more[begins]
        last[moves[ends, 0]] += more[ends]
        inner = ~(begins | ends)
        ways = self.edges.longer(moves[inner, 0], moves[inner, 1], more[inner])
        return replace(self, first=first, last=last, edges=ways)

    def length(self, nodes: IntArray) -> float:
        """Returns how long a path takes, the way back counted in [s]."""
        ways = self.edges.one_by_one(nodes[:-1], nodes[1:])
        return float(self.first[nodes[0]] + ways.sum() + self.last[nodes[-1]])


def count_nodes(problem: StageProblem) -> int:
    """Returns how many nodes a problem's graph has at most."""
    one, other = (np.isfinite(work).sum(axis=0) for work in problem.work)
    return int((one * other + one + other).sum())


def followers(problem: StageProblem) -> tuple[IntArray, IntArray]:
    """Returns what the same arm makes right after each stop, and right before it, IDLE for anything, shape (s,)."""
    after = np.full(problem.stops, IDLE)
    before = np.full(problem.stops, IDLE)
    within = {t for row in problem.sequences for t in row}
    rows = [*problem.sequences, *((t,) for t in range(len(problem.tasks)) if t not in within)]
    for row in rows:
        for one, other in pairwise(stop for t in row for stop in problem.tasks[t]):
            after[one], before[other] = other, one
    return after, before


def task_of(problem: StageProblem) -> IntArray:
    """Returns the task of each stop, shape (s,)."""
    found = np.zeros(problem.stops, dtype=np.int64)
    for t, own in enumerate(problem.tasks):
        found[list(own)] = t
    return found


def _nodes(problem: StageProblem, *, singles: bool) -> tuple[IntArray, IntArray]:
    """Returns stops (m, 2) and angles (m,) of all stages that may be, those of both arms first."""
    can = [np.isfinite(work) for work in problem.work]
    both = can[0][:, None, :] & can[1][None, :, :]
    task = task_of(problem)
    both &= (task[:, None] != task[None, :])[:, :, None]
    if problem.pair_cost is not None:
        both &= np.isfinite(problem.pair_cost[: problem.stops, : problem.stops])
    meets = np.zeros(problem.stops, dtype=np.bool_)
    for one, other in problem.handovers:
        give, take = problem.tasks[one][-1], problem.tasks[other][0]
        for stop, partner in ((give, take), (take, give)):
            meets[stop] = True
            others = np.arange(problem.stops) != partner
            both[stop, others] = both[others, stop] = False
    found = np.argwhere(both)
    stops, angle = [found[:, :2]], [found[:, 2]]
    if singles:
        for a, own in enumerate(can):
            found = np.argwhere(own & ~meets[:, None])
            alone = np.full((len(found), 2), IDLE)
            alone[:, a] = found[:, 0]
            stops.append(alone)
            angle.append(found[:, 1])
    return np.concatenate(stops), np.concatenate(angle)


def _with_forgotten(length: FloatArray) -> FloatArray:
    """Returns lengths with one more row, from wherever is best: shape (s + 2, s + 2, f, f)."""
    best: FloatArray = np.full(length.shape[1:], np.inf, dtype=length.dtype)
    for k, row in enumerate(length):
        # No stop comes after itself; the last columns are the way back and nothing to do.
        others = np.arange(len(row)) != k
        best[others] = np.minimum(best[others], row[others])
    return np.concatenate([length, best[None]])


def _way_back(
    problem: StageProblem, lengths: list[FloatArray], stops: IntArray, angle: IntArray
) -> FloatArray:
    """Returns the least length of the way back after each node [s], shape (m,)."""
    found: FloatArray = np.zeros(len(angle))
    if not problem.returns:
        return found
    if not problem.free_start:
        found = problem.turn[angle, 0].astype(np.float64)
    for a, length in enumerate(lengths):
        there = stops[:, a] != IDLE
        back = length[stops[there, a], problem.stops, angle[there], 0]
        found[there] = np.maximum(found[there], back)
    return found


def _may_be_first(problem: StageProblem, stops: IntArray) -> BoolArray:
    """Returns which nodes an order may begin with, shape (m,)."""
    _, before = followers(problem)
    begins = np.append(before == IDLE, True)
    free = np.ones(problem.stops + 1, dtype=np.bool_)
    for _, other in problem.before:
        free[problem.tasks[other][0]] = False
    return np.asarray((begins & free)[stops].all(axis=1))


def _may_follow(problem: StageProblem, came: IntArray, goes: IntArray) -> BoolArray:
    """Returns which nodes (n, 2) may come right after which (m, 2), shape (m, n)."""
    after, before = (np.append(row, IDLE) for row in followers(problem))
    task = np.append(task_of(problem), IDLE)
    found = np.ones((len(came), len(goes)), dtype=np.bool_)
    for a in range(2):
        own, then = came[:, a, None], goes[None, :, a]
        for b in range(2):
            made = came[:, b, None]
            found &= (then == IDLE) | (made != then)
        due, needed = after[own], before[then]
        found &= (due == IDLE) | (then == due) | (then == IDLE)
        found &= (needed == IDLE) | (own == needed) | (own == IDLE)
        if problem.in_file_order:
            found &= (own == IDLE) | (then == IDLE) | (task[then] >= task[own])
    if problem.before:
        wrong = np.zeros((len(problem.tasks) + 1,) * 2, dtype=np.bool_)
        for one, other in problem.before:
            wrong[other, one] = True
        for a in range(2):
            for b in range(2):
                found &= ~wrong[task[came[:, a, None]], task[goes[None, :, b]]]
    return found
