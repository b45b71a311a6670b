"""Lower bound of stage orders: shortest paths with stop prices, repeats allowed.

Lagrangian relaxation [Held1971] of paths with as many stops as there are [Christofides1981].
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dualarm_cli.geometry import products
from dualarm_cli.geometry.arrays import FloatArray, IntArray, SingleArray
from dualarm_cli.orders.paired.problem import IDLE
from dualarm_cli.orders.proof.graph import StageGraph
from dualarm_cli.records import dataclass

ROUNDING = 1e-4
"""Rounding error bound of single-precision path lengths [s]."""


@dataclass(frozen=True)
class PriceSettings:
    """Settings of the prices of stops."""

    patience: int = 6
    """Number of steps without a better bound after which steps become shorter."""
    shorter: float = 0.6
    """Shrink factor of the steps."""
    little: float = 1e-3
    """Least counted improvement of the bound at the first step length [s].

    It shrinks with the steps.
    """
    few_nodes: int = 3000
    """Largest number of nodes for which prices are computed at once.

    Above it they are first computed for a subset of this size.
    """
    shortest: float = 2e-3
    """Step length below which the search for prices ends, relative to the first one."""


PRICES = PriceSettings()


@dataclass(frozen=True)
class Prices:
    """Prices of stops with the bound they prove."""

    price: FloatArray
    """Price of each stop [s], shape (s,)."""
    bound: float
    """Lower bound of all paths [s]; infinite if there is no path."""


class Paths:
    """Shortest paths to and from every node of a graph, at any prices."""

    def __init__(self, graph: StageGraph) -> None:
        """Sort edges by the number of stops of their target."""
        self.graph, self.count = graph, graph.problem.stops
        every = np.arange(graph.nodes)
        self._groups = [
            (int(weight), np.flatnonzero(graph.weight == weight))
            for weight in np.unique(graph.weight)
        ]
        self._into = [graph.edges.part(every, rows) for _, rows in self._groups]

    def paid(self, price: FloatArray) -> SingleArray:
        """Sum the prices of each node's stops [s], shape (m,).

        Args:
            price: price of each stop [s], shape (s,).
        """
        return np.append(price, 0.0)[self.graph.stops].sum(axis=1).astype(np.float32)

    def forward(self, price: FloatArray) -> SingleArray:
        """Compute least lengths to nodes, less prices, by finished stops, (s + 1, m)."""
        paid = self.paid(price)
        lengths = np.full((self.count + 1, self.graph.nodes), np.inf, dtype=np.float32)
        for weight, rows in self._groups:
            lengths[weight, rows] = (self.graph.first - paid)[rows]
        for k in range(1, self.count + 1):
            for (weight, rows), edges in zip(self._groups, self._into, strict=True):
                if k > weight and np.isfinite(lengths[k - weight]).any():
                    lengths[k, rows] = edges.least(lengths[k - weight]) - paid[rows]
        return lengths

    def backward(self, price: FloatArray) -> SingleArray:
        """Compute least lengths from nodes, less prices, by remaining stops, (s + 1, m)."""
        paid = self.paid(price)
        lengths = np.full((self.count + 1, self.graph.nodes), np.inf, dtype=np.float32)
        lengths[0] = self.graph.last
        onto = [edges.turned() for edges in self._into]
        for k in range(1, self.count + 1):
            for (weight, rows), edges in zip(self._groups, onto, strict=True):
                if k >= weight and np.isfinite(lengths[k - weight]).any():
                    remaining = lengths[k - weight, rows] - paid[rows]
                    np.minimum(lengths[k], edges.least(remaining), out=lengths[k])
        return lengths

    def path(self, to: SingleArray) -> IntArray:
        """Trace a shortest path from the result of `forward`."""
        graph, k = self.graph, self.count
        u = int((to[k] + graph.last).argmin())
        nodes = [u]
        while (k := k - int(graph.weight[u])) > 0:
            u = int((to[k] + graph.edges.into(u)).argmin())
            nodes.append(u)
        return np.array(nodes[::-1])


def best_prices(
    graph: StageGraph,
    upper: float,
    steps: int,
    begin: FloatArray | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> Prices:
    """Maximise the bound over prices by subgradient steps.

    Args:
        graph: graph of stages.
        upper: length of a known order [s].
        steps: maximum number of steps.
        begin: first prices [s], shape (s,).
        stop: whether to stop early.
    """
    paths = Paths(graph)
    price = np.full(paths.count, upper / paths.count) if begin is None else begin
    best = Prices(price, -np.inf)
    step_length, stalled = 1.0, 0
    for _ in range(steps):
        to = paths.forward(price)
        value = float((to[-1] + graph.last).min(initial=np.inf)) + float(price.sum()) - ROUNDING
        if not np.isfinite(value):
            return Prices(price, np.inf)
        # Improvements below the threshold do not count.
        stalled = 0 if value > best.bound + PRICES.little * step_length else stalled + 1
        if value > best.bound:
            best = Prices(price, value)
        if stalled >= PRICES.patience:
            step_length, stalled = step_length * PRICES.shorter, 0
            if step_length < PRICES.shortest:
                break
            if best.price is not price:
                price = best.price
                continue
        visited = graph.stops[paths.path(to)].ravel()
        slope = 1.0 - np.bincount(visited[visited != IDLE], minlength=paths.count)
        norm = float(products.product(slope, slope))
        if norm == 0.0 or value >= upper or stop():
            break
        price = price + step_length * (upper - value) / norm * slope
    return best


def good_prices(
    graph: StageGraph,
    upper: float,
    steps: int,
    begin: FloatArray | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> Prices:
    """Compute prices with a tight bound; for many nodes first on a subset.

    The subset is first a regular sample of the nodes, then twice the nodes that matter most at the last prices.

    Args:
        graph: graph of stages.
        upper: length of a known order [s].
        steps: maximum number of steps per subset.
        begin: first prices [s], shape (s,).
        stop: whether to stop early.
    """
    if graph.nodes <= PRICES.few_nodes:
        return best_prices(graph, upper, steps, begin, stop)
    paths = Paths(graph)
    subset = np.arange(0, graph.nodes, -(-graph.nodes // PRICES.few_nodes))
    best = Prices(np.full(paths.count, upper / paths.count), -np.inf)
    price = begin
    for remaining_rounds in (2, 1, 0):
        prices = best_prices(graph.subgraph(subset), upper, steps, price, stop)
        # The subset may have no path.
        price = prices.price if np.isfinite(prices.bound) else best.price
        to = paths.forward(price)
        value = float((to[-1] + graph.last).min()) + float(price.sum()) - ROUNDING
        if value > best.bound:
            best = Prices(price, value)
        if not remaining_rounds or stop() or value >= upper:
            break
        least = (to + paths.backward(price)[::-1]).min(axis=0)
        subset = np.sort(np.argsort(least, kind="stable")[: PRICES.few_nodes])
    return best


def needed(graph: StageGraph, prices: Prices, upper: float) -> IntArray:
    """List the nodes possible in an order quicker than a known one."""
    paths = Paths(graph)
    to, on = paths.forward(prices.price), paths.backward(prices.price)
    least = (to + on[::-1]).min(axis=0) + prices.price.sum() - ROUNDING
    return np.flatnonzero(least < upper)
