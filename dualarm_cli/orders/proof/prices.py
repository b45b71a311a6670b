"""A lower bound on all orders of stages: paths through the graph that may have stops twice, each at a price.

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
"""What single precision may add to the length of a path [s]."""


@dataclass(frozen=True)
class PriceSettings:
    """Numbers that steer the prices of stops."""

    patience: int = 6
    """Number of steps without a better bound after which steps become shorter."""
    shorter: float = 0.6
    """Shrink factor of the steps."""
    little: float = 1e-3
    """Least improvement of the bound at the first step length [s]. It shrinks with the steps."""
    few_nodes: int = 3000
    """Number of nodes above which prices are first found for a subset. It is the size of the subset, too."""
    shortest: float = 2e-3
    """Step length below which the search for prices ends, relative to the first one."""


PRICES = PriceSettings()


@dataclass(frozen=True)
class Prices:
    """Prices of stops, and what they prove."""

    price: FloatArray
    """Of each stop [s], shape (s,)."""
    bound: float
    """No path takes less [s]; infinite where there is none."""


class Paths:
    """All paths through a graph: what they take at least up to each node, and from there on, at any prices."""

    def __init__(self, graph: StageGraph) -> None:
        """Sorts ways by how many stops are made at their ends."""
        self.graph, self.count = graph, graph.problem.stops
        every = np.arange(graph.nodes)
        self._groups = [
            (int(weight), np.flatnonzero(graph.weight == weight))
            for weight in np.unique(graph.weight)
        ]
        self._into = [graph.edges.part(every, rows) for _, rows in self._groups]

    def paid(self, price: FloatArray) -> SingleArray:
        """Returns the prices of each node's stops together [s], shape (m,).

        Args:
            price: of each stop [s], shape (s,).
        """
        return np.append(price, 0.0)[self.graph.stops].sum(axis=1).astype(np.float32)

    def forward(self, price: FloatArray) -> SingleArray:
        """Returns the least length of paths to each node, less prices, by stops made up to there, shape (s + 1, m)."""
        paid = self.paid(price)
        found = np.full((self.count + 1, self.graph.nodes), np.inf, dtype=np.float32)
        for weight, rows in self._groups:
            found[weight, rows] = (self.graph.first - paid)[rows]
        for k in range(1, self.count + 1):
            for (weight, rows), ways in zip(self._groups, self._into, strict=True):
                if k > weight and np.isfinite(found[k - weight]).any():
                    found[k, rows] = ways.least(found[k - weight]) - paid[rows]
        return found

    def backward(self, price: FloatArray) -> SingleArray:
        """Returns the least length of paths from each node on, less prices, by stops yet to be made, (s + 1, m)."""
        paid = self.paid(price)
        found = np.full((self.count + 1, self.graph.nodes), np.inf, dtype=np.float32)
        found[0] = self.graph.last
        onto = [ways.turned() for ways in self._into]
        for k in range(1, self.count + 1):
            for (weight, rows), ways in zip(self._groups, onto, strict=True):
                if k >= weight and np.isfinite(found[k - weight]).any():
                    rest = found[k - weight, rows] - paid[rows]
                    np.minimum(found[k], ways.least(rest), out=found[k])
        return found

    def path(self, to: SingleArray) -> IntArray:
        """Returns the nodes of a least path, given all of `forward`."""
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
    """Returns the prices that prove most, by subgradient steps.

    Args:
        graph: stages.
        upper: length of a known order [s].
        steps: how many at most.
        begin: prices to begin with [s], shape (s,).
        stop: whether to stop early.
    """
    paths = Paths(graph)
    price = np.full(paths.count, upper / paths.count) if begin is None else begin
    best = Prices(price, -np.inf)
    share, waited = 1.0, 0
    for _ in range(steps):
        to = paths.forward(price)
        value = float((to[-1] + graph.last).min(initial=np.inf)) + float(price.sum()) - ROUNDING
        if not np.isfinite(value):
            return Prices(price, np.inf)
        # A little better is as good as not better.
        waited = 0 if value > best.bound + PRICES.little * share else waited + 1
        if value > best.bound:
            best = Prices(price, value)
        if waited >= PRICES.patience:
            share, waited = share * PRICES.shorter, 0
            if share < PRICES.shortest:
                break
            if best.price is not price:
                price = best.price
                continue
        made = graph.stops[paths.path(to)].ravel()
        slope = 1.0 - np.bincount(made[made != IDLE], minlength=paths.count)
        norm = float(products.product(slope, slope))
        if norm == 0.0 or value >= upper or stop():
            break
        price = price + share * (upper - value) / norm * slope
    return best


def good_prices(
    graph: StageGraph,
    upper: float,
    steps: int,
    begin: FloatArray | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> Prices:
    """Returns prices that prove much, as `best_prices` does; of many nodes by way of some of them.

    Prices are found for every so-manieth node, then twice for those that matter most at the last prices.

    Args:
        graph: stages.
        upper: length of a known order [s].
        steps: how many at most with the same nodes.
        begin: prices to begin with [s], shape (s,).
        stop: whether to stop early.
    """
    if graph.nodes <= PRICES.few_nodes:
        return best_prices(graph, upper, steps, begin, stop)
    paths = Paths(graph)
    some = np.arange(0, graph.nodes, -(-graph.nodes // PRICES.few_nodes))
    best = Prices(np.full(paths.count, upper / paths.count), -np.inf)
    price = begin
    for left in (2, 1, 0):
        found = best_prices(graph.kept(some), upper, steps, price, stop)
        # Of some of the nodes there may be no path.
        price = found.price if np.isfinite(found.bound) else best.price
        to = paths.forward(price)
        value = float((to[-1] + graph.last).min()) + float(price.sum()) - ROUNDING
        if value > best.bound:
            best = Prices(price, value)
        if not left or stop() or value >= upper:
            break
        least = (to + paths.backward(price)[::-1]).min(axis=0)
        some = np.sort(np.argsort(least, kind="stable")[: PRICES.few_nodes])
    return best


def needed(graph: StageGraph, prices: Prices, upper: float) -> IntArray:
    """Returns the numbers of the nodes that may be in an order that is quicker than a known one."""
    paths = Paths(graph)
    to, on = paths.forward(prices.price), paths.backward(prices.price)
    least = (to + on[::-1]).min(axis=0) + prices.price.sum() - ROUNDING
    return np.flatnonzero(least < upper)
