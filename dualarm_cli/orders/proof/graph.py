"""Graph of stages, with orders as paths that have each stop once."""

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
"""Fraction of feasible edges below which only those are stored."""


class StageEdges(Protocol):
    """Edge lengths [s] from m to n nodes, infinite without an edge.

    They are in single precision.
    """

    def least(self, values: SingleArray) -> SingleArray:
        """Compute targets' least sums of edge length and source value (m,), (n,)."""
        ...

    def rows(self, source: IntArray) -> SingleArray:
        """Look up the lengths from some nodes, shape (k, n)."""
        ...

    def into(self, node: int) -> SingleArray:
        """Look up the lengths to one node, shape (m,)."""
        ...

    def one_by_one(self, source: IntArray, target: IntArray) -> SingleArray:
        """Look up the lengths of given pairs of nodes, shape (k,)."""
        ...

    def part(self, source: IntArray, target: IntArray) -> StageEdges:
        """Select the edges between some nodes."""
        ...

    def turned(self) -> StageEdges:
        """Reverse all edges."""
        ...

    def longer(self, source: IntArray, target: IntArray, more: FloatArray) -> StageEdges:
        """Lengthen given existing edges [s]; no pair of nodes is given twice."""
        ...


@dataclass(frozen=True)
class DenseEdges:
    """Lengths of all edges."""

    table: SingleArray
    """Lengths by target and source [s], shape (n, m).

    `least` then reads memory in its order.
    """

    def least(self, values: SingleArray) -> SingleArray:
        """See `StageEdges`."""
        return np.asarray((self.table + values).min(axis=1))

    def rows(self, source: IntArray) -> SingleArray:
        """See `StageEdges`."""
        return np.asarray(self.table[:, source].T)

    def into(self, node: int) -> SingleArray:
        """See `StageEdges`."""
        return np.asarray(self.table[node])

    def one_by_one(self, source: IntArray, target: IntArray) -> SingleArray:
        """See `StageEdges`."""
        return np.asarray(self.table[target, source])

    def part(self, source: IntArray, target: IntArray) -> DenseEdges:
        """See `StageEdges`."""
        return DenseEdges(np.ascontiguousarray(self.table[target][:, source]))

    def turned(self) -> DenseEdges:
        """See `StageEdges`."""
        return DenseEdges(np.ascontiguousarray(self.table.T))

    def longer(self, source: IntArray, target: IntArray, more: FloatArray) -> DenseEdges:
        """See `StageEdges`."""
        table = self.table.copy()
        table[target, source] += more
        return DenseEdges(table)


@dataclass(frozen=True)
class SparseEdges:
    """Lengths of the existing edges, sorted by target."""

    begin: IntArray
    """First edge of each target, and the number of edges, shape (n + 1,)."""
    source: IntArray
    """Source node of each edge, shape (edges,)."""
    length: SingleArray
    """Length of each edge [s], shape (edges,)."""
    count: int
    """Number of possible source nodes."""

    def least(self, values: SingleArray) -> SingleArray:
        """See `StageEdges`."""
        lengths = np.full(len(self.begin) - 1, np.inf, dtype=np.float32)
        reached = np.flatnonzero(np.diff(self.begin))
        if len(reached):
            sums = self.length + values[self.source]
            lengths[reached] = np.minimum.reduceat(sums, self.begin[reached])
        return lengths

    def rows(self, source: IntArray) -> SingleArray:
        """See `StageEdges`."""
        lengths = np.full((len(source), len(self.begin) - 1), np.inf, dtype=np.float32)
        row = np.full(self.count, -1)
        row[source] = np.arange(len(source))
        row_of_edge = row[self.source]
        selected = row_of_edge >= 0
        lengths[row_of_edge[selected], self._target[selected]] = self.length[selected]
        return lengths

    def into(self, node: int) -> SingleArray:
        """See `StageEdges`."""
        lengths = np.full(self.count, np.inf, dtype=np.float32)
        edges = slice(self.begin[node], self.begin[node + 1])
        lengths[self.source[edges]] = self.length[edges]
        return lengths

    def one_by_one(self, source: IntArray, target: IntArray) -> SingleArray:
        """See `StageEdges`."""
        lengths = np.full(len(target), np.inf, dtype=np.float32)
        at, exists = self._at(source, target)
        lengths[exists] = self.length[at[exists]]
        return lengths

    def part(self, source: IntArray, target: IntArray) -> SparseEdges:
        """See `StageEdges`."""
        number, place = np.full(self.count, -1), np.full(len(self.begin) - 1, -1)
        number[source], place[target] = np.arange(len(source)), np.arange(len(target))
        target_of_edge = place[self._target]
        selected = (target_of_edge >= 0) & (number[self.source] >= 0)
        return sparse_edges(
            target_of_edge[selected],
            number[self.source[selected]],
            self.length[selected],
            len(target),
            len(source),
        )

    def turned(self) -> SparseEdges:
        """See `StageEdges`."""
        return sparse_edges(self.source, self._target, self.length, self.count, len(self.begin) - 1)

    def longer(self, source: IntArray, target: IntArray, more: FloatArray) -> SparseEdges:
        """See `StageEdges`."""
        length = self.length.copy()
        at, exists = self._at(source, target)
        length[at[exists]] += more[exists]
        return replace(self, length=length)

    def _at(self, source: IntArray, target: IntArray) -> tuple[IntArray, BoolArray]:
        """Find the edges of pairs of nodes, and whether they exist."""
        keys = target * self.count + source
        at = np.searchsorted(self._key, keys)
        exists = at < len(self._key)
        exists[exists] = self._key[at[exists]] == keys[exists]
        return at, exists

    @cached_property
    def _target(self) -> IntArray:
        return np.repeat(np.arange(len(self.begin) - 1), np.diff(self.begin))

    @cached_property
    def _key(self) -> IntArray:
        # Edges are sorted by target, then by source.
        return self._target * self.count + self.source


def sparse_edges(
    target: IntArray, source: IntArray, length: SingleArray, n: int, m: int
) -> SparseEdges:
    """Sort edges, shape (edges,) each, to n nodes from m nodes."""
    order = np.lexsort((source, target))
    begin = np.concatenate([[0], np.cumsum(np.bincount(target, minlength=n))])
    return SparseEdges(begin, source[order], length[order], m)


def edges_from_rows(rows: Iterator[SingleArray], nodes: int) -> StageEdges:
    """Build edges from blocks of rows (k, m), one row per target node."""
    none = np.zeros(0, dtype=np.int64)
    target, source, length, row_count = [none], [none], [np.zeros(0, dtype=np.float32)], 0
    for block in rows:
        finite = np.isfinite(block)
        u, v = np.nonzero(finite)
        target.append(u + row_count)
        source.append(v)
        length.append(block[finite].astype(np.float32))
        row_count += len(block)
    targets, sources, lengths = (
        np.concatenate(target),
        np.concatenate(source),
        np.concatenate(length),
    )
    if len(targets) < SPARSE * nodes * nodes:
        return sparse_edges(targets, sources, lengths, nodes, nodes)
    table = np.full((nodes, nodes), np.inf, dtype=np.float32)
    table[targets, sources] = lengths
    return DenseEdges(table)


ENDS = -1
"""Node number of the start and the end of a path."""
ROWS_AT_ONCE = 256
"""Number of nodes whose edges are computed at once."""


@dataclass(frozen=True)
class StageGraph:
    """Graph of stages at platform angles, with their lengths after other stages.

    The last stop of an idle arm is not part of a node: the arm then comes from its most favourable stop. So no path is
    longer than its order, and a path without idle arms has the same length. Windows, buffers and precedence are left
    out, except between consecutive stages.
    """

    problem: StageProblem
    """Stage problem with two arms."""
    stops: IntArray
    """Stops of each node by arm, shape (m, 2); IDLE for none."""
    angle: IntArray
    """Number of each node's platform angle, shape (m,)."""
    weight: IntArray
    """Number of stops of each node, shape (m,)."""
    first: FloatArray
    """Length of each node as the first stage [s], shape (m,)."""
    last: FloatArray
    """Duration of the return after each node as the last stage [s], shape (m,)."""
    edges: StageEdges
    """Lengths of stages directly after others [s]; infinite if rules forbid it."""

    @classmethod
    def of(cls, problem: StageProblem, *, singles: bool) -> StageGraph:
        """Build the graph of a problem.

        Args:
            problem: stage problem with two arms.
            singles: whether an arm may be idle in a stage.
        """
        stops, angle = _nodes(problem, singles=singles)
        source = np.where(stops == IDLE, problem.stops + 1, stops)
        lengths = [_with_best_source(length) for length in problem.length]
        pair_cost: FloatArray = np.zeros(len(angle))
        if problem.pair_cost is not None:
            pair_cost += problem.pair_cost[stops[:, 0], stops[:, 1], angle]
        first_parts = [
            length[problem.stops, column, :, angle]
            for length, column in zip(lengths, stops.T, strict=True)
        ]
        stage_lengths = np.maximum(first_parts[0], first_parts[1])
        first = (
            stage_lengths.min(axis=1) if problem.free_start else stage_lengths[:, 0]
        ) + pair_cost
        first[~_may_be_first(problem, stops)] = np.inf

        def rows() -> Iterator[SingleArray]:
            for k in range(0, len(angle), ROWS_AT_ONCE):
                v = slice(k, k + ROWS_AT_ONCE)
                parts = [
                    length[source[None, :, a], stops[v, a, None], angle[None], angle[v, None]]
                    for a, length in enumerate(lengths)
                ]
                stage_lengths = np.maximum(parts[0], parts[1]) + pair_cost[v, None]
                stage_lengths[~_may_follow(problem, stops, stops[v]).T] = np.inf
                yield stage_lengths.astype(np.float32)

        weight = (stops != IDLE).sum(axis=1)
        returning = _return_time(problem, lengths, stops, angle)
        edges = edges_from_rows(rows(), len(angle))
        return cls(problem, stops, angle, weight, first, returning, edges)

    @property
    def nodes(self) -> int:
        """Number of nodes."""
        return len(self.angle)

    def subgraph(self, which: IntArray) -> StageGraph:
        """Select nodes by their numbers."""
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
        """Lengthen given moves.

        Args:
            moves: source and target nodes, ENDS for the start or the end; no move twice, shape (k, 2).
            more: extra time of each move [s], shape (k,).
        """
        first, last = self.first.copy(), self.last.copy()
        begins, ends = moves[:, 0] == ENDS, moves[:, 1] == ENDS
        first[moves[begins, 1]] += more[begins]
        last[moves[ends, 0]] += more[ends]
        inner = ~(begins | ends)
        edges = self.edges.longer(moves[inner, 0], moves[inner, 1], more[inner])
        return replace(self, first=first, last=last, edges=edges)

    def length(self, nodes: IntArray) -> float:
        """Compute the length of a path with the return [s]."""
        edges = self.edges.one_by_one(nodes[:-1], nodes[1:])
        return float(self.first[nodes[0]] + edges.sum() + self.last[nodes[-1]])


def count_nodes(problem: StageProblem) -> int:
    """Compute an upper bound of the number of nodes of a problem's graph."""
    first, second = (np.isfinite(work).sum(axis=0) for work in problem.work)
    return int((first * second + first + second).sum())


def followers(problem: StageProblem) -> tuple[IntArray, IntArray]:
    """List each stop's required next and previous stops, (s,), IDLE for any."""
    after = np.full(problem.stops, IDLE)
    before = np.full(problem.stops, IDLE)
    within = {t for row in problem.sequences for t in row}
    rows = [*problem.sequences, *((t,) for t in range(len(problem.tasks)) if t not in within)]
    for row in rows:
        for previous, following in pairwise(stop for t in row for stop in problem.tasks[t]):
            after[previous], before[following] = following, previous
    return after, before


def task_of(problem: StageProblem) -> IntArray:
    """List the task of each stop, shape (s,)."""
    task = np.zeros(problem.stops, dtype=np.int64)
    for t, stops in enumerate(problem.tasks):
        task[list(stops)] = t
    return task


def _nodes(problem: StageProblem, *, singles: bool) -> tuple[IntArray, IntArray]:
    """List feasible stages' stops (m, 2) and angles (m,), both arms first."""
    reachable_by_arm = [np.isfinite(work) for work in problem.work]
    both = reachable_by_arm[0][:, None, :] & reachable_by_arm[1][None, :, :]
    task = task_of(problem)
    both &= (task[:, None] != task[None, :])[:, :, None]
    if problem.pair_cost is not None:
        both &= np.isfinite(problem.pair_cost[: problem.stops, : problem.stops])
    meets = np.zeros(problem.stops, dtype=np.bool_)
    for giving, taking in problem.handovers:
        give, take = problem.tasks[giving][-1], problem.tasks[taking][0]
        for stop, partner in ((give, take), (take, give)):
            meets[stop] = True
            others = np.arange(problem.stops) != partner
            both[stop, others] = both[others, stop] = False
    indices = np.argwhere(both)
    stops, angle = [indices[:, :2]], [indices[:, 2]]
    if singles:
        for a, reachable in enumerate(reachable_by_arm):
            indices = np.argwhere(reachable & ~meets[:, None])
            alone = np.full((len(indices), 2), IDLE)
            alone[:, a] = indices[:, 0]
            stops.append(alone)
            angle.append(indices[:, 1])
    return np.concatenate(stops), np.concatenate(angle)


def _with_best_source(length: FloatArray) -> FloatArray:
    """Append a row with the best source of each stop.

    The result has shape (s + 2, s + 2, f, f).
    """
    best: FloatArray = np.full(length.shape[1:], np.inf, dtype=length.dtype)
    for k, row in enumerate(length):
        # A stop does not follow itself; the last columns are the return and IDLE.
        others = np.arange(len(row)) != k
        best[others] = np.minimum(best[others], row[others])
    return np.concatenate([length, best[None]])


def _return_time(
    problem: StageProblem, lengths: list[FloatArray], stops: IntArray, angle: IntArray
) -> FloatArray:
    """Compute the least duration of the return after each node [s], shape (m,)."""
    durations: FloatArray = np.zeros(len(angle))
    if not problem.returns:
        return durations
    if not problem.free_start:
        durations = problem.turn[angle, 0].astype(np.float64)
    for a, length in enumerate(lengths):
        active = stops[:, a] != IDLE
        returning = length[stops[active, a], problem.stops, angle[active], 0]
        durations[active] = np.maximum(durations[active], returning)
    return durations


def _may_be_first(problem: StageProblem, stops: IntArray) -> BoolArray:
    """Test which nodes an order may begin with, shape (m,)."""
    _, before = followers(problem)
    begins = np.append(before == IDLE, True)
    free = np.ones(problem.stops + 1, dtype=np.bool_)
    for _, later in problem.before:
        free[problem.tasks[later][0]] = False
    return np.asarray((begins & free)[stops].all(axis=1))


def _may_follow(problem: StageProblem, source: IntArray, target: IntArray) -> BoolArray:
    """Test which nodes (n, 2) may directly follow which (m, 2), shape (m, n)."""
    after, before = (np.append(row, IDLE) for row in followers(problem))
    task = np.append(task_of(problem), IDLE)
    allowed = np.ones((len(source), len(target)), dtype=np.bool_)
    for a in range(2):
        previous_stop, next_stop = source[:, a, None], target[None, :, a]
        for b in range(2):
            earlier_stop = source[:, b, None]
            allowed &= (next_stop == IDLE) | (earlier_stop != next_stop)
        due, required = after[previous_stop], before[next_stop]
        allowed &= (due == IDLE) | (next_stop == due) | (next_stop == IDLE)
        allowed &= (required == IDLE) | (previous_stop == required) | (previous_stop == IDLE)
        if problem.in_file_order:
            allowed &= (
                (previous_stop == IDLE)
                | (next_stop == IDLE)
                | (task[next_stop] >= task[previous_stop])
            )
    if problem.before:
        wrong = np.zeros((len(problem.tasks) + 1,) * 2, dtype=np.bool_)
        for earlier, later in problem.before:
            wrong[later, earlier] = True
        for a in range(2):
            for b in range(2):
                allowed &= ~wrong[task[source[:, a, None]], task[target[None, :, b]]]
    return allowed
