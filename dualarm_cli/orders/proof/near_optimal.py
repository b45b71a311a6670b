"""Near-optimal orders of stages, rated with the estimated extra time of their transfers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dualarm_cli.effort import CloseOrders
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.orders.paired.problem import IDLE, StageOrder
from dualarm_cli.orders.paired.times import with_angles
from dualarm_cli.orders.proof.graph import ENDS, StageGraph
from dualarm_cli.orders.proof.labels import LabelSearch
from dualarm_cli.orders.proof.prices import Prices, needed
from dualarm_cli.orders.proof.proof import keeps_rules

Look = Callable[[StageGraph, IntArray], FloatArray]
"""Estimate of extra time of moves between nodes [s], shape (k,).

A callback with the arguments of `StageGraph.longer`.
"""


def near_optimal_orders(
    graph: StageGraph,
    prices: Prices,
    best: StageOrder,
    look: Look,
    *,
    sizes: CloseOrders,
    stop: Callable[[], bool] = lambda: False,
) -> list[StageOrder]:
    """List near-optimal orders, best first by a close look at their moves.

    The moves of the best orders are rated by `look`, their extra times are added to the graph, and so on until all
    moves of the best orders are rated. Moves from or to stages with an idle arm are not rated.

    Args:
        graph: graph of stages.
        prices: prices with a tight bound.
        best: best order so far.
        look: callback that rates moves.
        sizes: labels and orders of each round, and the number of rounds.
        stop: whether to stop early.
    """
    upper = (1.0 + sizes.excess) * best.total
    unrated, rated_moves = graph, np.zeros(0, dtype=np.int64)
    seen: dict[bytes, IntArray] = {}
    for _ in range(sizes.rounds):
        needed_nodes = needed(graph, prices, upper)
        candidates = LabelSearch(
            graph.subgraph(needed_nodes), prices, upper, sizes.labels, stop
        ).run(sizes.orders)
        paths = [needed_nodes[nodes] for nodes in candidates.orders]
        if stop():
            break
        if not paths:
            # All near-optimal orders take longer by now.
            upper *= 1.0 + sizes.excess
            continue
        seen |= {nodes.tobytes(): nodes for nodes in paths}
        moves = np.unique(np.concatenate([_moves(nodes) for nodes in paths]), axis=0)
        # ENDS is -1.
        key = (moves[:, 0] + 1) * (graph.nodes + 1) + moves[:, 1] + 1
        new = ~np.isin(key, rated_moves)
        if not new.any():
            break
        rated_moves = np.append(rated_moves, key[new])
        graph = graph.longer(moves[new], look(graph, moves[new]))
    rated_orders = []
    for nodes in seen.values():
        slots, total = graph.stops[nodes], unrated.length(nodes)
        if not keeps_rules(graph.problem, slots):
            continue
        order = StageOrder(slots, graph.angle[nodes], total)
        if (slots == IDLE).any():
            # Paths do not include an idle arm's last stop.
            order = with_angles(graph.problem, slots)
        rated_orders.append((order.total + graph.length(nodes) - total, order))
    answers: dict[bytes, StageOrder] = {}
    for _, order in sorted(rated_orders, key=lambda rated: rated[0]):
        answers.setdefault(order.slots.tobytes(), order)
    return list(answers.values())[: sizes.orders]


def _moves(nodes: IntArray) -> IntArray:
    """List the moves of a path, shape (n + 1, 2)."""
    return np.stack([np.append(ENDS, nodes), np.append(nodes, ENDS)], axis=1)
