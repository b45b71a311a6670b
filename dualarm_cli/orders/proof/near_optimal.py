"""Orders of stages that are nearly as good as the best one, with what only a closer look at their moves tells."""

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
"""Returns how much longer moves between nodes take, looked at closely [s], shape (k,); arguments as of
`StageGraph.longer`."""


def near_optimal_orders(
    graph: StageGraph,
    prices: Prices,
    best: StageOrder,
    look: Look,
    *,
    sizes: CloseOrders,
    stop: Callable[[], bool] = lambda: False,
) -> list[StageOrder]:
    """Returns orders that are nearly as good as the best one, those first that are best after a close look.

    The best orders are looked at closely; what their moves then take longer is kept in mind, and so on until the best
    ones are known through and through. Moves from or to stages in which an arm is idle are not looked at.

    Args:
        graph: stages.
        prices: prices of stops that prove much.
        best: the best order known.
        look: looks closely at moves.
        sizes: labels and orders of each round, and the number of rounds.
        stop: whether to stop early.
    """
    upper = (1.0 + sizes.excess) * best.total
    plain, known = graph, np.zeros(0, dtype=np.int64)
    seen: dict[bytes, IntArray] = {}
    for _ in range(sizes.rounds):
        own = needed(graph, prices, upper)
        looked = LabelSearch(graph.kept(own), prices, upper, sizes.labels, stop).run(sizes.orders)
        some = [own[nodes] for nodes in looked.orders]
        if stop():
            break
        if not some:
            # All that was nearly as good takes longer.
            upper *= 1.0 + sizes.excess
            continue
        seen |= {nodes.tobytes(): nodes for nodes in some}
        moves = np.unique(np.concatenate([_moves(nodes) for nodes in some]), axis=0)
        # ENDS is -1.
        key = (moves[:, 0] + 1) * (graph.nodes + 1) + moves[:, 1] + 1
        new = ~np.isin(key, known)
        if not new.any():
            break
        known = np.append(known, key[new])
        graph = graph.longer(moves[new], look(graph, moves[new]))
    found = []
    for nodes in seen.values():
        slots, total = graph.stops[nodes], plain.length(nodes)
        if not keeps_rules(graph.problem, slots):
            continue
        one = StageOrder(slots, graph.angle[nodes], total)
        if (slots == IDLE).any():
            # What an idle arm did before it is forgotten in paths.
            one = with_angles(graph.problem, slots)
        found.append((one.total + graph.length(nodes) - total, one))
    answers: dict[bytes, StageOrder] = {}
    for _, one in sorted(found, key=lambda rated: rated[0]):
        answers.setdefault(one.slots.tobytes(), one)
    return list(answers.values())[: sizes.orders]


def _moves(nodes: IntArray) -> IntArray:
    """Returns the moves of a path, shape (n + 1, 2)."""
    return np.stack([np.append(ENDS, nodes), np.append(nodes, ENDS)], axis=1)
