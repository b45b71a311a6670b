"""How good an order of stages is: a bound on all orders, and a better order where the way there meets one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dualarm_cli.geometry.arrays import IntArray
from dualarm_cli.sequencing.stage_graph import StageGraph, count_nodes, followers
from dualarm_cli.sequencing.stage_labels import MOST_STOPS, LabelSearch
from dualarm_cli.sequencing.stage_prices import Prices, best_prices, needed
from dualarm_cli.sequencing.stage_problem import IDLE, StageOrder, StageProblem
from dualarm_cli.sequencing.stage_times import with_angles

MOST_NODES = 8000
"""Of so many nodes at most a table of all ways from node to node has room."""
FIRST_LOOK = 4000
"""Labels that are kept to find a better order before anything else is done."""
NEAR = 0.02
"""By less than this share an order is longer than another one that is nearly as good."""
SAME = 1e-4
"""Totals that differ by less are the same [s]."""


@dataclass(frozen=True)
class ProofEffort:
    """How hard a proof is tried."""

    steps: int
    """Steps for better prices."""
    labels: int
    """Labels that are kept."""
    near: int = 0
    """How many other orders to find that are nearly as good."""


@dataclass(frozen=True)
class StageProof:
    """What is proven."""

    bound: float
    """No order takes less [s]."""
    orders: tuple[StageOrder, ...]
    """The best order known, and others that are nearly as good."""


def can_prove(problem: StageProblem) -> bool:
    """Returns whether there is room for a proof: two arms, few enough stops and nodes."""
    few = len(problem.length) == 2 and 0 < problem.stops <= MOST_STOPS
    return few and count_nodes(problem) <= MOST_NODES


def prove_order(
    problem: StageProblem,
    best: StageOrder,
    effort: ProofEffort,
    stop: Callable[[], bool] = lambda: False,
    better: Callable[[float], None] = lambda _: None,
    bounded: Callable[[float], None] = lambda _: None,
) -> StageProof:
    """Returns a bound on all orders, and the best ones known then.

    Args:
        problem: what is asked; `can_prove`.
        best: an order to begin with, in time.
        effort: how hard to try.
        stop: whether to stop early.
        better: is told the total of every better order [s].
        bounded: is told every better bound [s].
    """
    best = with_angles(problem, best.slots)
    price = None
    if problem.stops % 2 == 0:
        graph = StageGraph.of(problem, singles=False)
        prices = best_prices(graph, best.total, effort.steps, stop=stop)
        if np.isfinite(prices.bound):
            price = prices.price
            looked = LabelSearch(graph, prices, best.total, min(FIRST_LOOK, effort.labels)).run()
            best = _best(problem, best, looked.orders, better)
    if stop():
        return StageProof(0.0, (best,))
    graph = StageGraph.of(problem, singles=True)
    # Where no arm is ever idle in a good order its prices serve here too.
    steps = effort.steps if price is None else max(1, effort.steps // 5)
    prices = best_prices(graph, best.total, steps, price, stop)
    bound = min(prices.bound, best.total)
    bounded(bound)
    if not stop() and bound < best.total - SAME:
        fewer = graph.kept(needed(graph, prices, best.total))
        looked = LabelSearch(fewer, prices, best.total, effort.labels).run()
        best = _best(problem, best, looked.orders, better)
        bound = max(bound, min(looked.bound, best.total))
        bounded(bound)
    if stop() or not effort.near:
        return StageProof(bound, (best,))
    return StageProof(bound, _near(graph, prices, best, effort))


def _best(
    problem: StageProblem,
    best: StageOrder,
    found: tuple[IntArray, ...],
    better: Callable[[float], None],
) -> StageOrder:
    """Returns the best one of an order and those found that keep all rules."""
    for slots in found:
        order = with_angles(problem, slots)
        if order.total < best.total and _keeps_rules(problem, slots):
            better(order.total)
            best = order
    return best


def _near(
    graph: StageGraph, prices: Prices, best: StageOrder, effort: ProofEffort
) -> tuple[StageOrder, ...]:
    """Returns the best order and others that are nearly as good."""
    upper = (1.0 + NEAR) * best.total
    graph = graph.kept(needed(graph, prices, upper))
    looked = LabelSearch(graph, prices, upper, min(FIRST_LOOK, effort.labels)).run(effort.near)
    others = [
        with_angles(graph.problem, slots)
        for slots in looked.orders
        if _keeps_rules(graph.problem, slots) and not np.array_equal(slots, best.slots)
    ]
    others.sort(key=lambda one: one.total)
    return (best, *others)


def _keeps_rules(problem: StageProblem, slots: IntArray) -> bool:
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
