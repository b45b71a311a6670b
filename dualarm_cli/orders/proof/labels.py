"""Orders of stages by dynamic programming over the stops made so far, with bounds for what is yet to come.

Of what cannot become an order that is quicker than a known one nothing is kept, so that few enough remain for orders of
some twenty stops to be proven best. Where too many remain only the most promising are kept, and what the others might
have become is the bound.
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
    """Lengths and rules of steps whose arms' last stops are known; the number of stops stands for the start."""

    def __init__(self, graph: StageGraph) -> None:
        """Keeps what rules ask of each stop."""
        self.graph, problem = graph, graph.problem
        after, before = followers(problem)
        # The last entry is both the start's and that of nothing to do.
        self._after, self._before = np.append(after, IDLE), np.append(before, IDLE)
        self._task = np.append(task_of(problem), -1)

    def came(self, node: IntArray, idle: IntArray) -> IntArray:
        """Returns each arm's last stop after stages, shape (n, 2).

        Args:
            node: the stages, shape (n,).
            idle: the last stop of the arm that is idle in them, anything where none is, shape (n,).
        """
        stops = self.graph.stops[node]
        return np.where(stops == IDLE, idle[:, None], stops)

    def idle(self, came: IntArray, node: IntArray) -> IntArray:
        """Returns the last stop of the arm that is idle in stages, IDLE where none is, shape (n,).

        Args:
            came: each arm's last stop before them, shape (n, 2).
            node: the stages, shape (n,).
        """
        rests = self.graph.stops[node] == IDLE
        return np.where(rests.any(axis=1), np.where(rests, came, 0).sum(axis=1), IDLE)

    def lengths(self, came: IntArray, angle: IntArray, node: IntArray) -> FloatArray:
        """Returns how long stages take after what each arm did last [s], infinite where rules forbid them, shape (n,).

        Args:
            came: each arm's last stop before them, shape (n, 2).
            angle: number of the platform angle before them, shape (n,).
            node: the stages, shape (n,).
        """
        problem, stops, then = self.graph.problem, self.graph.stops[node], self.graph.angle[node]
        ways = [
            length[came[:, a], stops[:, a], angle, then] for a, length in enumerate(problem.length)
        ]
        found = np.maximum(ways[0], ways[1]).astype(np.float64)
        if problem.pair_cost is not None:
            found += problem.pair_cost[stops[:, 0], stops[:, 1], then]
        due, needs = self._after[came], self._before[stops]
        wrong = (due != IDLE) & (stops != due) & (stops != IDLE)
        wrong |= (needs != IDLE) & (came != needs)
        if problem.in_file_order:
            wrong |= (stops != IDLE) & (self._task[stops] < self._task[came])
        found[wrong.any(axis=1)] = np.inf
        return found

    def way_back(self, node: IntArray, idle: IntArray) -> FloatArray:
        """Returns how long the way back takes after stages [s], shape (n,); arguments as of `came`."""
        problem, found = self.graph.problem, np.array(self.graph.last[node])
        if not problem.returns:
            return found
        stops, angle = self.graph.stops[node], self.graph.angle[node]
        for a, length in enumerate(problem.length):
            rests = (stops[:, a] == IDLE) & (idle != problem.stops)
            back = length[idle[rests], problem.stops, angle[rests], 0]
            found[rests] = np.maximum(found[rests], back)
        return found


@dataclass(frozen=True)
class LabelSettings:
    """Numbers that steer the extension of partial orders."""

    continuations: int = 12
    """Maximum number of continuations per label that is kept."""
    halvings: int = 16
    """Number of bisections of the threshold that limits the number of continuations."""
    most_looked_at: int = 20_000
    """Maximum number of labels that are traced back to the start for different orders."""
    same_ends: int = 2
    """Maximum number of labels traced back per sequence of last stops. The quickest come first; platform angles do not
    distinguish sequences."""


LABELS = LabelSettings()


@dataclass(frozen=True)
class Continuations:
    """What nodes may be continued with, row by row, the cheapest first."""

    begin: IntArray
    """Where each row begins, and where all end, shape (rows + 1,)."""
    column: IntArray
    """Numbers of what they may be continued with, shape (k,)."""
    line: FloatArray
    """What that adds [s], each row by `step` above the one before it, so that all are in rising order, shape (k,)."""
    step: float

    @classmethod
    def of(cls, more: FloatArray, most: FloatArray) -> Continuations:
        """Sorts what is worth it.

        Args:
            more: what continuations add [s], shape (rows, m).
            most: how much they may add [s], shape (rows,).
        """
        row, column = np.nonzero(more < most[:, None])
        value = more[row, column].astype(np.float64)
        order = np.lexsort((value, row))
        begin = np.searchsorted(row, np.arange(len(more) + 1))
        step = 4.0 * (1.0 + float(np.abs(value).max(initial=0.0)))
        return cls(begin, column[order], value[order] + step * row, step)

    def counts(self, room: FloatArray, row: IntArray, most: int) -> tuple[IntArray, float]:
        """Returns how many of its cheapest continuations each label has room for, (n,), and how much less than it has.

        Args:
            room: what continuations may add to each label [s], shape (n,).
            row: the row of each label, shape (n,).
            most: how many there may be of all labels together; where there are more, all have less room.
        """

        def found(less: float) -> IntArray:
            wanted = np.clip(room - less, -0.5 * self.step, 0.5 * self.step) + self.step * row
            return np.searchsorted(self.line, wanted) - self.begin[row]

        counts = found(0.0)
        if counts.sum() <= most:
            return counts, 0.0
        low, high = 0.0, float(room.max()) + self.step
        for _ in range(LABELS.halvings):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if found(middle).sum() > most else (low, middle)
        return found(high), high


MOST_STOPS = 62
"""Stops made are bits of one integer."""
MIXED = np.uint64(0x9E3779B97F4A7C15)
"""An odd number: times it, modulo 2^64, no two integers become one."""


@dataclass(frozen=True)
class Searched:
    """What the search among labels found."""

    orders: tuple[IntArray, ...]
    """Nodes of the best orders, shape (n,) each, the best one first; none where none is quicker than what was known."""
    bound: float
    """No order takes less [s]."""


@dataclass(frozen=True)
class _Labels:
    """Beginnings of orders that have as many stops."""

    made: IntArray
    """Stops made, as bits, shape (n,)."""
    node: IntArray
    """The node of the last stage, shape (n,)."""
    idle: IntArray
    """The last stop of the arm that is idle in it, the number of stops for none yet; IDLE where none is, shape (n,)."""
    over: FloatArray
    """When that is over at the earliest [s], shape (n,)."""

    def __len__(self) -> int:
        return len(self.node)

    def take(self, rows: IntArray | BoolArray) -> _Labels:
        """Returns some of them."""
        return _Labels(self.made[rows], self.node[rows], self.idle[rows], self.over[rows])


class LabelSearch:
    """One search."""

    def __init__(
        self,
        graph: StageGraph,
        prices: Prices,
        upper: float,
        most: int,
        stop: Callable[[], bool] = lambda: False,
    ) -> None:
        """Prepares bounds.

        Args:
            graph: stages; at most MOST_STOPS stops.
            prices: prices of stops that prove much.
            upper: length of a known order [s]; only quicker ones are looked for.
            most: labels with the same number of stops that are kept.
            stop: whether to stop early, with nothing found and nothing proven.
        """
        self.graph, self.upper, self.most, self._stop = graph, upper, most, stop
        self._count = graph.problem.stops
        paths = Paths(graph)
        self._paid = paths.paid(prices.price)
        self._whole = float(prices.price.sum()) - ROUNDING
        self._rest = paths.backward(prices.price)
        self._price = prices.price
        stop_bits = np.append(np.int64(1) << np.arange(self._count, dtype=np.int64), 0)
        self._bits = stop_bits[graph.stops].sum(axis=1)
        self._needs = self._needed_before()
        self._steps = StageSteps(graph)
        self._dropped = np.inf
        self._layers: list[_Labels] = [_none() for _ in range(self._count + 1)]

    def run(self, count: int = 1) -> Searched:
        """Returns the best orders that are quicker than the known one, and what is proven.

        Args:
            count: how many different orders to return at most.
        """
        layers = self._layers
        for k in range(1, self._count + 1):
            if self._stop():
                return Searched((), -np.inf)
            found = [self._begun(k)]
            found += [
                self._grown(layers[k - w], k - w, w) for w in (1, 2) if k > w and len(layers[k - w])
            ]
            layers[k] = self._fewer(_joined(found), k)
        last = layers[self._count]
        whole = last.over + self._steps.way_back(last.node, last.idle)
        bound = min(self.upper, self._dropped, float(whole.min(initial=np.inf)))
        return Searched(tuple(self._orders(whole, count)), bound)

    def _begun(self, k: int) -> _Labels:
        """Returns first stages of k stops."""
        graph = self.graph
        rows = np.flatnonzero((graph.weight == k) & np.isfinite(graph.first))
        start = np.full((len(rows), 2), self._count)
        idle = self._steps.idle(start, rows)
        return self._on_time(_Labels(self._bits[rows], rows, idle, graph.first[rows]))

    def _grown(self, labels: _Labels, k: int, weight: int) -> _Labels:
        """Returns labels with one more stage of so many stops that may still become a quicker order."""
        graph, left = self.graph, self._count - k - weight
        then = np.flatnonzero((graph.weight == weight) & np.isfinite(self._rest[left]))
        if not len(then):
            return _none()
        labels = labels.take(np.argsort(labels.node, kind="stable"))
        came, begin = np.unique(labels.node, return_index=True)
        row = np.repeat(np.arange(len(came)), np.diff([*begin, len(labels)]))
        onto = graph.edges.rows(came)
        # What a continuation adds to the least that a label may become.
        more = onto[:, then] - self._paid[then] + self._rest[left, then]
        room = self.upper - self._whole - (labels.over - self._paid_for(labels.made))
        cheap = Continuations.of(more, np.maximum.reduceat(room, begin))
        counts, lost = cheap.counts(room, row, LABELS.continuations * self.most)
        self._dropped = min(self._dropped, self.upper - lost)
        label = np.repeat(np.arange(len(labels)), counts)
        rank = np.arange(len(label)) - np.repeat(np.cumsum(counts) - counts, counts)
        row = row[label]
        node = then[cheap.column[cheap.begin[row] + rank]]
        fits = (labels.made[label] & self._bits[node]) == 0
        fits &= (self._needs[node] & ~labels.made[label]) == 0
        label, node, row = label[fits], node[fits], row[fits]
        return self._on_time(self._after(labels.take(label), node, onto[row, node]))

    def _after(self, labels: _Labels, node: IntArray, ways: SingleArray) -> _Labels:
        """Returns labels with one more stage each, before any wait for windows.

        Args:
            labels: n of them.
            node: the stages, shape (n,).
            ways: their lengths in the graph [s], shape (n,).
        """
        came, lengths = self._steps.came(labels.node, labels.idle), ways.astype(np.float64)
        # What an arm did before it was idle the graph has forgotten.
        rested = np.flatnonzero(labels.idle != IDLE)
        angle = self.graph.angle[labels.node[rested]]
        lengths[rested] = self._steps.lengths(came[rested], angle, node[rested])
        made = labels.made | self._bits[node]
        return _Labels(made, node, self._steps.idle(came, node), labels.over + lengths)

    def _fewer(self, labels: _Labels, k: int) -> _Labels:
        """Returns the best label of each node and stops made, and of these the most promising."""
        labels = _best_of_same(labels)
        bound = self._bound(labels, k)
        kept = bound < self.upper
        labels, bound = labels.take(kept), bound[kept]
        if len(labels) > self.most:
            order = np.argsort(bound, kind="stable")
            self._dropped = min(self._dropped, float(bound[order[self.most :]].min()))
            labels = labels.take(order[: self.most])
        return labels.take(np.lexsort((labels.node, labels.made)))

    def _bound(self, labels: _Labels, k: int) -> FloatArray:
        """Returns the least that labels of k stops may become [s], shape (n,)."""
        rest = self._rest[self._count - k, labels.node]
        return np.asarray(labels.over - self._paid_for(labels.made) + rest + self._whole)

    def _paid_for(self, made: IntArray) -> FloatArray:
        """Returns the prices of all stops made [s], shape (n,)."""
        found: FloatArray = np.zeros(len(made))
        for stop, price in enumerate(self._price.tolist()):
            found += price * ((made >> stop) & 1)
        return found

    def _on_time(self, labels: _Labels) -> _Labels:
        """Returns labels after their stops have waited for windows, without those that are late."""
        over = self._waited(labels)
        return replace(labels, over=over).take(np.isfinite(over))

    def _waited(self, labels: _Labels) -> FloatArray:
        """Returns when labels are over after their stops have waited for windows [s], infinite where too late, (n,)."""
        problem, over = self.graph.problem, np.array(labels.over)
        stops, angle = self.graph.stops[labels.node], self.graph.angle[labels.node]
        for a in range(2):
            does = stops[:, a] != IDLE
            own, f = stops[does, a], angle[does]
            if problem.not_before is not None:
                opens = problem.not_before[own]
                waits = np.where(opens > 0.0, opens + problem.work[a][own, f], 0.0)
                over[does] = np.maximum(over[does], waits)
        if problem.not_after is not None:
            closes = np.append(problem.not_after, np.inf)[stops].min(axis=1)
            over[over > closes + ROUNDING] = np.inf
        return over

    def _needed_before(self) -> IntArray:
        """Returns which stops have to be made before each node, as bits, shape (m,)."""
        problem = self.graph.problem
        needs = np.zeros(problem.stops + 1, dtype=np.int64)
        for one, other in problem.before:
            needs[problem.tasks[other][0]] |= np.int64(1) << np.int64(problem.tasks[one][-1])
        return np.asarray(needs[self.graph.stops[:, 0]] | needs[self.graph.stops[:, 1]])

    def _orders(self, whole: FloatArray, count: int) -> Iterator[IntArray]:
        """Yields the nodes of different orders, the quickest first: every way that leads to the last labels.

        Args:
            whole: how long the orders take that the last labels are [s].
            count: how many to yield at most.
        """
        # What an order takes, its number of stops up to the label, the label, and its nodes from there on.
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
            # The same stops at other angles are the same order: few ways to end it are enough.
            end = self.graph.stops[list(nodes)].tobytes()
            ends[end] = ends.get(end, 0) + 1
            if ends[end] > LABELS.same_ends:
                continue
            came = k - int(self.graph.weight[nodes[0]])
            if came == 0:
                if end not in seen:
                    seen.add(end)
                    yield np.array(nodes)
                continue
            for before, later in self._came_from(k, row):
                if total + later < self.upper:
                    node = int(self._layers[came].node[before])
                    heappush(heap, (total + later, came, before, (node, *nodes)))

    def _came_from(self, k: int, row: int) -> Iterator[tuple[int, float]]:
        """Yields the labels that a label may come from, and how much later it is over from each [s]."""
        labels = self._layers[k]
        node, made = int(labels.node[row]), labels.made[row] ^ self._bits[labels.node[row]]
        others = self._layers[k - int(self.graph.weight[node])]
        # Labels are sorted by the stops made.
        begin, end = np.searchsorted(others.made, [made, made + 1])
        came = others.take(np.arange(begin, end))
        then = np.full(len(came), node)
        every = self._after(came, then, self.graph.edges.one_by_one(came.node, then))
        later = self._waited(every) - labels.over[row]
        later[every.idle != labels.idle[row]] = np.inf
        for number in np.flatnonzero(np.isfinite(later)).tolist():
            yield int(begin) + number, max(0.0, float(later[number]))


def _none() -> _Labels:
    none = np.zeros(0, dtype=np.int64)
    return _Labels(none, none, none, np.zeros(0))


def _joined(found: list[_Labels]) -> _Labels:
    return _Labels(
        np.concatenate([one.made for one in found]),
        np.concatenate([one.node for one in found]),
        np.concatenate([one.idle for one in found]),
        np.concatenate([one.over for one in found]),
    )


def _best_of_same(labels: _Labels) -> _Labels:
    """Returns the one that is over soonest of those with the same stops made, the same node and the same idle arm."""
    if not len(labels):
        return labels
    # Idle arms' last stops are 62 at most, IDLE is -1.
    place = 64 * labels.node + labels.idle + 1
    key = labels.made.astype(np.uint64) * MIXED ^ place.astype(np.uint64)
    order = np.argsort(key, kind="stable")
    key, made, place = key[order], labels.made[order], place[order]
    # Where two keys happen to be the same both labels stay.
    new = (key[1:] != key[:-1]) | (made[1:] != made[:-1]) | (place[1:] != place[:-1])
    begin = np.flatnonzero(np.append(True, new))
    over = np.minimum.reduceat(labels.over[order], begin)
    return replace(labels.take(order[begin]), over=over)
