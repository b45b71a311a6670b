"""Bound on all orders of stages, and a better order where the search meets one."""

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
    """What is proven."""

    bound: float
    """No order takes less [s]."""
    order: StageOrder
    """The best order known."""
    graph: StageGraph | None
    """What it was proven with; None where that was stopped."""
    prices: Prices | None
    """Prices that prove much; None where that was stopped."""


def can_prove(problem: StageProblem, nodes: int) -> bool:
    """Returns whether there is room for a proof: two arms, few enough stops, and at most so many nodes."""
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
    """Returns a bound on all orders, and the best one known then.

    Args:
        problem: what is asked; `can_prove`.
        best: an order to begin with, in time.
        effort: how hard to try.
        stop: whether to stop early.
        better: receives the total of every better order [s].
        bounded: receives every better bound [s].
    """
    best = with_angles(problem, best.slots)
    # An order that is late counts far more than it takes: one that is in time does not take so much longer.
    plain = with_angles(replace(problem, not_after=None), best.slots)
    upper = min(best.total, effort.late * plain.total)
    price = None
    if problem.stops % 2 == 0:
        graph = StageGraph.of(problem, singles=False)
        prices = good_prices(graph, upper, effort.steps, stop=stop)
        if np.isfinite(prices.bound):
            price = prices.price
            most = min(effort.first_labels, effort.labels)
            found = LabelSearch(graph, prices, upper, most, stop).run()
            best = _better(graph, found.orders, best, better)
    if stop():
        return StageProof(0.0, best, None, None)
    graph, upper = StageGraph.of(problem, singles=True), min(upper, best.total)
    # Where no arm is ever idle in a good order its prices serve here too.
    steps = effort.steps if price is None else max(1, effort.steps // 5)
    prices = good_prices(graph, upper, steps, price, stop)
    bound = min(prices.bound, upper)
    bounded(bound)
    # Totals that differ by less are the same.
    if not stop() and bound < upper - 1e-4:
        fewer = graph.kept(needed(graph, prices, upper))
        found = LabelSearch(fewer, prices, upper, effort.labels, stop).run()
        best = _better(fewer, found.orders, best, better)
        bound = max(bound, min(found.bound, best.total))
        bounded(bound)
    return StageProof(bound, best, graph, prices)


def _better(
    graph: StageGraph,
    orders: Sequence[IntArray],
    best: StageOrder,
    better: Callable[[float], None],
) -> StageOrder:
    """Select the best of an order and those of nodes that keep the rules."""
    for nodes in orders:
        order = with_angles(graph.problem, graph.stops[nodes])
        if order.total < best.total and keeps_rules(graph.problem, order.slots):
            better(order.total)
            best = order
    return best


def keeps_rules(problem: StageProblem, slots: IntArray) -> bool:
    """Returns whether an order has together what one arm makes one right after the other, and the file's order."""
    after, before = followers(problem)
    first = {own[0]: t for t, own in enumerate(problem.tasks)}
    for own in slots.T:
        made = own[own != IDLE]
        then = np.append(made[1:], IDLE)
        came = np.append(IDLE, made[:-1])
        due, needs = after[made], before[made]
        if ((due != IDLE) & (then != due)).any() or ((needs != IDLE) & (came != needs)).any():
            return False
        if problem.in_file_order:
            tasks = [first[stop] for stop in made.tolist() if stop in first]
            if tasks != sorted(tasks):
                return False
    return True
