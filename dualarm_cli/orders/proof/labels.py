"""Label setting over orders of stages, with lower bounds.

It is dynamic programming over the finished stops.

Labels that cannot become quicker than a known order are dropped, so that few enough remain to prove orders of some
twenty stops optimal. If too many remain, the labels with the least bounds are kept, and the others give the bound.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from heapq import heapify, heappop, heappush

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray, SingleArray
from dualarm_cli.orders.paired.problem import IDLE
from dualarm_cli.orders.proof.graph import StageGraph, followers, task_of
from dualarm_cli.orders.proof.prices import ROUNDING, Paths, Prices
from dualarm_cli.records import dataclass


class StageSteps:
    """Lengths and rules of steps from known last stops.

    The number of stops stands for the start.
    """

    def __init__(self, graph: StageGraph) -> None:
        """Prepare the required neighbours of each stop."""
        self.graph, problem = graph, graph.problem
        after, before = followers(problem)
        # The last entry is that of the start and of IDLE.
        self._after, self._before = np.append(after, IDLE), np.append(before, IDLE)
        self._task = np.append(task_of(problem), -1)

    def last_stops(self, node: IntArray, idle: IntArray) -> IntArray:
        """Compute each arm's last stop after stages, shape (n, 2).

        Args:
            node: the stages, shape (n,).
            idle: last stop of the idle arm, any number if none is idle, shape (n,).
        """
        stops = self.graph.stops[node]
        return np.where(stops == IDLE, idle[:, None], stops)

    def idle(self, last_stops: IntArray, node: IntArray) -> IntArray:
        """Compute the idle arm's last stop in stages, shape (n,).

        IDLE if none is idle.

        Args:
            last_stops: each arm's last stop before them, shape (n, 2).
            node: the stages, shape (n,).
        """
        rests = self.graph.stops[node] == IDLE
        return np.where(rests.any(axis=1), np.where(rests, last_stops, 0).sum(axis=1), IDLE)

    def lengths(self, last_stops: IntArray, angle: IntArray, node: IntArray) -> FloatArray:
        """Compute the lengths of stages after each arm's last stop [s], shape (n,).

        Infinite if rules forbid them.

        Args:
            last_stops: each arm's last stop before them, shape (n, 2).
            angle: number of the platform angle before them, shape (n,).
            node: the stages, shape (n,).
        """
        problem, stops, next_angle = (
            self.graph.problem,
            self.graph.stops[node],
            self.graph.angle[node],
        )
        parts = [
            length[last_stops[:, a], stops[:, a], angle, next_angle]
            for a, length in enumerate(problem.length)
        ]
        lengths = np.maximum(parts[0], parts[1]).astype(np.float64)
        if problem.pair_cost is not None:
            lengths += problem.pair_cost[stops[:, 0], stops[:, 1], next_angle]
        due, required = self._after[last_stops], self._before[stops]
        violated = (due != IDLE) & (stops != due) & (stops != IDLE)
        violated |= (required != IDLE) & (last_stops != required)
        if problem.in_file_order:
            violated |= (stops != IDLE) & (self._task[stops] < self._task[last_stops])
        lengths[violated.any(axis=1)] = np.inf
        return lengths

    def return_time(self, node: IntArray, idle: IntArray) -> FloatArray:
        """Compute the duration of the return after stages [s], shape (n,); as of `last_stops`."""
        problem, durations = self.graph.problem, np.array(self.graph.last[node])
        if not problem.returns:
            return durations
        stops, angle = self.graph.stops[node], self.graph.angle[node]
        for a, length in enumerate(problem.length):
            is_idle = (stops[:, a] == IDLE) & (idle != problem.stops)
            returning = length[idle[is_idle], problem.stops, angle[is_idle], 0]
            durations[is_idle] = np.maximum(durations[is_idle], returning)
        return durations


@dataclass(frozen=True)
class LabelSettings:
    """Settings of the extension of labels."""

    continuations: int = 12
    """Maximum number of continuations per kept label."""
    halvings: int = 16
    """Number of bisections of the threshold that limits the number of continuations."""
    most_looked_at: int = 20_000
    """Maximum number of labels traced back to find different orders."""
    same_ends: int = 2
    """Maximum number of labels traced back per sequence of last stops. The quickest come first.

    Platform angles do not
    distinguish sequences."""


LABELS = LabelSettings()


@dataclass(frozen=True)
class Continuations:
    """Continuations of nodes, row by row, cheapest first."""

    begin: IntArray
    """First continuation of each row, and the number of continuations, shape (rows + 1,)."""
    column: IntArray
    """Numbers of the continuations, shape (k,)."""
    line: FloatArray
    """Cost of each continuation plus `step` times its row [s], ascending, shape (k,)."""
    step: float

    @classmethod
    def of(cls, costs: FloatArray, limits: FloatArray) -> Continuations:
        """Sort the continuations below a limit.

        Args:
            costs: cost of continuations [s], shape (rows, m).
            limits: largest cost [s], shape (rows,).
        """
        row, column = np.nonzero(costs < limits[:, None])
        value = costs[row, column].astype(np.float64)
        order = np.lexsort((value, row))
        begin = np.searchsorted(row, np.arange(len(costs) + 1))
        step = 4.0 * (1.0 + float(np.abs(value).max(initial=0.0)))
        return cls(begin, column[order], value[order] + step * row, step)

    def counts(self, budget: FloatArray, row: IntArray, limit: int) -> tuple[IntArray, float]:
        """Count each label's affordable cheapest continuations, (n,), and its budget's cut.

        Args:
            budget: budget of each label [s], shape (n,).
            row: row of each label, shape (n,).
            limit: maximum number for all labels together; beyond it all budgets are cut by the same amount.
        """

        def counts_below(cut: float) -> IntArray:
            keys = np.clip(budget - cut, -0.5 * self.step, 0.5 * self.step) + self.step * row
            return np.searchsorted(self.line, keys) - self.begin[row]

        counts = counts_below(0.0)
        if counts.sum() <= limit:
            return counts, 0.0
        low, high = 0.0, float(budget.max()) + self.step
        for _ in range(LABELS.halvings):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if counts_below(middle).sum() > limit else (low, middle)
        return counts_below(high), high


MOST_STOPS = 62
"""Maximum number of stops: finished stops are bits of one integer."""
MIXED = np.uint64(0x9E3779B97F4A7C15)
"""Odd multiplier of the hash; multiplication by it modulo 2^64 is injective."""


@dataclass(frozen=True)
class Searched:
    """Result of the label search."""

    orders: tuple[IntArray, ...]
    """Nodes of the best orders, (n,) each, best first.

    Only orders quicker than the known one.
    """
    bound: float
    """Lower bound of all orders [s]."""


@dataclass(frozen=True)
class _Labels:
    """Partial orders with the same number of stops."""

    made: IntArray
    """Finished stops as bits, shape (n,)."""
    node: IntArray
    """Node of the last stage, shape (n,)."""
    idle: IntArray
    """Idle arm's last stop, by label, shape (n,).

    The arm is the one that is idle in the last stage. The number of stops stands for none yet, IDLE for no idle arm.
    """
    over: FloatArray
    """Earliest end of the last stage [s], shape (n,)."""

    def __len__(self) -> int:
        return len(self.node)

    def take(self, rows: IntArray | BoolArray) -> _Labels:
        """Select labels."""
        return _Labels(self.made[rows], self.node[rows], self.idle[rows], self.over[rows])


class LabelSearch:
    """Label setting search on one graph."""

    def __init__(
        self,
        graph: StageGraph,
        prices: Prices,
        upper: float,
        most: int,
        stop: Callable[[], bool] = lambda: False,
    ) -> None:
        """Prepare lower bounds.

        Args:
            graph: graph of stages with at most MOST_STOPS stops.
            prices: prices with a tight bound.
            upper: length of a known order [s]; only quicker ones are searched.
            most: maximum number of labels with the same number of stops.
            stop: whether to stop early, without result.
        """
        self.graph, self.upper, self.most, self._stop = graph, upper, most, stop
        self._count = graph.problem.stops
        paths = Paths(graph)
        self._paid = paths.paid(prices.price)
        self._whole = float(prices.price.sum()) - ROUNDING
        self._remaining = paths.backward(prices.price)
        self._price = prices.price
        stop_bits = np.append(np.int64(1) << np.arange(self._count, dtype=np.int64), 0)
        self._bits = stop_bits[graph.stops].sum(axis=1)
        self._needs = self._needed_before()
        self._steps = StageSteps(graph)
        self._dropped = np.inf
        self._layers: list[_Labels] = [_none() for _ in range(self._count + 1)]

    def run(self, count: int = 1) -> Searched:
        """Search the best orders quicker than the known one, with a lower bound.

        Args:
            count: maximum number of different orders.
        """
        layers = self._layers
        for k in range(1, self._count + 1):
            if self._stop():
                return Searched((), -np.inf)
            groups = [self._first_labels(k)]
            groups += [
                self._extended(layers[k - w], k - w, w)
                for w in (1, 2)
                if k > w and len(layers[k - w])
            ]
            layers[k] = self._fewer(_joined(groups), k)
        last = layers[self._count]
        lengths = last.over + self._steps.return_time(last.node, last.idle)
        bound = min(self.upper, self._dropped, float(lengths.min(initial=np.inf)))
        return Searched(tuple(self._orders(lengths, count)), bound)

    def _first_labels(self, k: int) -> _Labels:
        """List the first stages of k stops as labels."""
        graph = self.graph
        rows = np.flatnonzero((graph.weight == k) & np.isfinite(graph.first))
        start = np.full((len(rows), 2), self._count)
        idle = self._steps.idle(start, rows)
        return self._on_time(_Labels(self._bits[rows], rows, idle, graph.first[rows]))

    def _extended(self, labels: _Labels, k: int, weight: int) -> _Labels:
        """Extend labels by a stage of `weight` stops, if possibly quicker.

        They may still become a quicker order than the known one.
        """
        graph, remaining = self.graph, self._count - k - weight
        next_nodes = np.flatnonzero(
            (graph.weight == weight) & np.isfinite(self._remaining[remaining])
        )
        if not len(next_nodes):
            return _none()
        labels = labels.take(np.argsort(labels.node, kind="stable"))
        last_stops, begin = np.unique(labels.node, return_index=True)
        row = np.repeat(np.arange(len(last_stops)), np.diff([*begin, len(labels)]))
        lengths = graph.edges.rows(last_stops)
        # Increase of a label's lower bound by each continuation.
        increases = (
            lengths[:, next_nodes] - self._paid[next_nodes] + self._remaining[remaining, next_nodes]
        )
        budget = self.upper - self._whole - (labels.over - self._prices_of(labels.made))
        continuations = Continuations.of(increases, np.maximum.reduceat(budget, begin))
        counts, cut = continuations.counts(budget, row, LABELS.continuations * self.most)
        self._dropped = min(self._dropped, self.upper - cut)
        label = np.repeat(np.arange(len(labels)), counts)
        rank = np.arange(len(label)) - np.repeat(np.cumsum(counts) - counts, counts)
        row = row[label]
        node = next_nodes[continuations.column[continuations.begin[row] + rank]]
        is_feasible = (labels.made[label] & self._bits[node]) == 0
        is_feasible &= (self._needs[node] & ~labels.made[label]) == 0
        label, node, row = label[is_feasible], node[is_feasible], row[is_feasible]
        return self._on_time(self._after(labels.take(label), node, lengths[row, node]))

    def _after(self, labels: _Labels, node: IntArray, edges: SingleArray) -> _Labels:
        """Append one stage to each label, before any wait for windows.

        Args:
            labels: n labels.
            node: the stages, shape (n,).
            edges: lengths of their edges in the graph [s], shape (n,).
        """
        last_stops, lengths = (
            self._steps.last_stops(labels.node, labels.idle),
            edges.astype(np.float64),
        )
        # The graph has no last stops of idle arms.
        after_idle = np.flatnonzero(labels.idle != IDLE)
        angle = self.graph.angle[labels.node[after_idle]]
        lengths[after_idle] = self._steps.lengths(last_stops[after_idle], angle, node[after_idle])
        made = labels.made | self._bits[node]
        return _Labels(made, node, self._steps.idle(last_stops, node), labels.over + lengths)

    def _fewer(self, labels: _Labels, k: int) -> _Labels:
        """Select labels: the best by node and stops, then by bound.

        Stops are the set of finished stops; the least bounds remain.
        """
        labels = _best_of_same(labels)
        bound = self._bound(labels, k)
        below = bound < self.upper
        labels, bound = labels.take(below), bound[below]
        if len(labels) > self.most:
            order = np.argsort(bound, kind="stable")
            self._dropped = min(self._dropped, float(bound[order[self.most :]].min()))
            labels = labels.take(order[: self.most])
        return labels.take(np.lexsort((labels.node, labels.made)))

    def _bound(self, labels: _Labels, k: int) -> FloatArray:
        """Compute the lower bounds of labels of k stops [s], shape (n,)."""
        remaining = self._remaining[self._count - k, labels.node]
        return np.asarray(labels.over - self._prices_of(labels.made) + remaining + self._whole)

    def _prices_of(self, made: IntArray) -> FloatArray:
        """Sum the prices of the finished stops [s], shape (n,)."""
        total: FloatArray = np.zeros(len(made))
        for stop, price in enumerate(self._price.tolist()):
            total += price * ((made >> stop) & 1)
        return total

    def _on_time(self, labels: _Labels) -> _Labels:
        """Add the waits for windows to labels, and drop late labels."""
        over = self._waited(labels)
        return replace(labels, over=over).take(np.isfinite(over))

    def _waited(self, labels: _Labels) -> FloatArray:
        """Compute label ends after window waits [s], shape (n,), infinite if late."""
        problem, over = self.graph.problem, np.array(labels.over)
        stops, angle = self.graph.stops[labels.node], self.graph.angle[labels.node]
        for a in range(2):
            active = stops[:, a] != IDLE
            arm_stops, f = stops[active, a], angle[active]
            if problem.not_before is not None:
                opens = problem.not_before[arm_stops]
                waits = np.where(opens > 0.0, opens + problem.work[a][arm_stops, f], 0.0)
                over[active] = np.maximum(over[active], waits)
        if problem.not_after is not None:
            closes = np.append(problem.not_after, np.inf)[stops].min(axis=1)
            over[over > closes + ROUNDING] = np.inf
        return over

    def _needed_before(self) -> IntArray:
        """Compute the required predecessors of each node as bits, shape (m,)."""
        problem = self.graph.problem
        needs = np.zeros(problem.stops + 1, dtype=np.int64)
        for earlier, later in problem.before:
            needs[problem.tasks[later][0]] |= np.int64(1) << np.int64(problem.tasks[earlier][-1])
        return np.asarray(needs[self.graph.stops[:, 0]] | needs[self.graph.stops[:, 1]])

    def _orders(self, whole: FloatArray, count: int) -> Iterator[IntArray]:
        """Yield the nodes of different orders, quickest first, traced back from the last labels.

        Args:
            whole: lengths of the orders of the last labels [s].
            count: maximum number of orders.
        """
        # Length of the order, number of stops up to the label, label, and nodes from there on.
        heap: list[tuple[float, int, int, tuple[int, ...]]] = [
            (float(whole[row]), self._count, row, (int(self._layers[-1].node[row]),))
            for row in np.flatnonzero(whole < self.upper).tolist()
        ]
        heapify(heap)
        seen: set[bytes] = set()
        ends: dict[bytes, int] = {}
        for _ in range(LABELS.most_looked_at):
            if not heap or len(seen) == count:
                return
            total, k, row, nodes = heappop(heap)
            # The same stops at other angles are the same order, so few ends of it are enough.
            end = self.graph.stops[list(nodes)].tobytes()
            ends[end] = ends.get(end, 0) + 1
            if ends[end] > LABELS.same_ends:
                continue
            last_stops = k - int(self.graph.weight[nodes[0]])
            if last_stops == 0:
                if end not in seen:
                    seen.add(end)
                    yield np.array(nodes)
                continue
            for before, later in self._came_from(k, row):
                if total + later < self.upper:
                    node = int(self._layers[last_stops].node[before])
                    heappush(heap, (total + later, last_stops, before, (node, *nodes)))

    def _came_from(self, k: int, row: int) -> Iterator[tuple[int, float]]:
        """Yield the predecessors of a label, with its delay after each [s]."""
        labels = self._layers[k]
        node, made = int(labels.node[row]), labels.made[row] ^ self._bits[labels.node[row]]
        previous_layer = self._layers[k - int(self.graph.weight[node])]
        # Labels are sorted by the finished stops.
        begin, end = np.searchsorted(previous_layer.made, [made, made + 1])
        last_stops = previous_layer.take(np.arange(begin, end))
        then = np.full(len(last_stops), node)
        extended = self._after(last_stops, then, self.graph.edges.one_by_one(last_stops.node, then))
        delays = self._waited(extended) - labels.over[row]
        delays[extended.idle != labels.idle[row]] = np.inf
        for number in np.flatnonzero(np.isfinite(delays)).tolist():
            yield int(begin) + number, max(0.0, float(delays[number]))


def _none() -> _Labels:
    none = np.zeros(0, dtype=np.int64)
    return _Labels(none, none, none, np.zeros(0))


def _joined(groups: list[_Labels]) -> _Labels:
    return _Labels(
        np.concatenate([labels.made for labels in groups]),
        np.concatenate([labels.node for labels in groups]),
        np.concatenate([labels.idle for labels in groups]),
        np.concatenate([labels.over for labels in groups]),
    )


def _best_of_same(labels: _Labels) -> _Labels:
    """Select the earliest of the labels with equal finished stops, node and idle arm."""
    if not len(labels):
        return labels
    # Idle arms' last stops are 62 at most, IDLE is -1.
    place = 64 * labels.node + labels.idle + 1
    key = labels.made.astype(np.uint64) * MIXED ^ place.astype(np.uint64)
    order = np.argsort(key, kind="stable")
    key, made, place = key[order], labels.made[order], place[order]
    # If two keys collide, both labels stay.
    new = (key[1:] != key[:-1]) | (made[1:] != made[:-1]) | (place[1:] != place[:-1])
    begin = np.flatnonzero(np.append(True, new))
    over = np.minimum.reduceat(labels.over[order], begin)
    return replace(labels.take(order[begin]), over=over)
