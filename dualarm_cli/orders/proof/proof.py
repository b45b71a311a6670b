"""Lower bound of all orders of stages, with better orders that the search meets."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from dualarm_cli.effort import ProofEffort
from dualarm_cli.geometry.arrays import IntArray
from dualarm_cli.orders.paired.problem import IDLE, StageOrder, StageProblem
from dualarm_cli.orders.paired.times import with_angles
from dualarm_cli.orders.proof.graph import StageGraph, count_nodes, followers
from dualarm_cli.orders.proof.labels import MOST_STOPS, LabelSearch
from dualarm_cli.orders.proof.prices import Prices, good_prices, needed
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class StageProof:
    """Result of a proof."""

    bound: float
    """Lower bound of all orders [s]."""
    order: StageOrder
    """Best order so far."""
    graph: StageGraph | None
    """Graph of the proof; None if it was stopped."""
    prices: Prices | None
    """Prices with a tight bound; None if the proof was stopped."""


def can_prove(problem: StageProblem, nodes: int) -> bool:
    """Test provability: two arms, few stops, at most `nodes` nodes."""
    few = len(problem.length) == 2 and 0 < problem.stops <= MOST_STOPS
    return few and count_nodes(problem) <= nodes


def prove_order(
    problem: StageProblem,
    best: StageOrder,
    effort: ProofEffort,
    stop: Callable[[], bool] = lambda: False,
    better: Callable[[float], None] = lambda _: None,
    bounded: Callable[[float], None] = lambda _: None,
) -> StageProof:
    """Compute a lower bound of all orders, and improve the best order.

    Args:
        problem: the stage problem; `can_prove`.
        best: first order, in time.
        effort: limits of the proof.
        stop: whether to stop early.
        better: receives the total of every better order [s].
        bounded: receives every better bound [s].
    """
    best = with_angles(problem, best.slots)
    # A late order has a large penalty; an order in time is not that much longer.
    unlimited = with_angles(replace(problem, not_after=None), best.slots)
    upper = min(best.total, effort.late * unlimited.total)
    price = None
    if problem.stops % 2 == 0:
        graph = StageGraph.of(problem, singles=False)
        prices = good_prices(graph, upper, effort.steps, stop=stop)
        if np.isfinite(prices.bound):
            price = prices.price
            max_labels = min(effort.first_labels, effort.labels)
            labels_result = LabelSearch(graph, prices, upper, max_labels, stop).run()
            best = _better(graph, labels_result.orders, best, better)
    if stop():
        return StageProof(0.0, best, None, None)
    graph, upper = StageGraph.of(problem, singles=True), min(upper, best.total)
    # If arms are never idle in a good order, its prices are a good start here.
    steps = effort.steps if price is None else max(1, effort.steps // 5)
    prices = good_prices(graph, upper, steps, price, stop)
    bound = min(prices.bound, upper)
    bounded(bound)
    # Smaller differences of totals are rounding errors.
    if not stop() and bound < upper - 1e-4:
        fewer = graph.subgraph(needed(graph, prices, upper))
        labels_result = LabelSearch(fewer, prices, upper, effort.labels, stop).run()
        best = _better(fewer, labels_result.orders, best, better)
        bound = max(bound, min(labels_result.bound, best.total))
        bounded(bound)
    return StageProof(bound, best, graph, prices)


def _better(
    graph: StageGraph,
    orders: Sequence[IntArray],
    best: StageOrder,
    better: Callable[[float], None],
) -> StageOrder:
    """Select the best of an order and those of nodes that satisfy the rules."""
    for nodes in orders:
        order = with_angles(graph.problem, graph.stops[nodes])
        if order.total < best.total and keeps_rules(graph.problem, order.slots):
            better(order.total)
            best = order
    return best


def keeps_rules(problem: StageProblem, slots: IntArray) -> bool:
    """Test whether an order satisfies sequences, tasks of two stops and the file's order."""
    after, before = followers(problem)
    first = {task[0]: t for t, task in enumerate(problem.tasks)}
    for column in slots.T:
        made = column[column != IDLE]
        next_stops = np.append(made[1:], IDLE)
        previous_stops = np.append(IDLE, made[:-1])
        due, required = after[made], before[made]
        if ((due != IDLE) & (next_stops != due)).any() or (
            (required != IDLE) & (previous_stops != required)
        ).any():
            return False
        if problem.in_file_order:
            tasks = [first[stop] for stop in made.tolist() if stop in first]
            if tasks != sorted(tasks):
                return False
    return True
