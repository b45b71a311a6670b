"""Postures of two arms that hand a part over, chosen together: the cheapest that keep clear of each other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.planning.order_model import OrderModel


def handovers_of(order: OrderModel) -> tuple[tuple[int, int], ...]:
    """Returns the numbers of the tasks that are the giver's and the taker's share of each hand-over."""
    tasks = order.job.tasks
    taking = {task.id: t for t, task in enumerate(tasks) if task.stops[0].action == "take"}
    return tuple(
        (t, taking[task.id]) for t, task in enumerate(tasks) if task.stops[-1].action == "give"
    )


def handover_margins(
    order: OrderModel, shares: tuple[int, int], giver: int, places: Sequence[FloatArray]
) -> FloatArray:
    """Returns the least margin of two arms from each other while one hands a part to the other [m], shape (n,).

    What each holds changes: where both come, while they meet, and where the giver's retract ends.

    Args:
        order: the job's tasks; something has to keep clear.
        shares: numbers of the giver's and of the taker's task.
        giver: number of the giving arm.
        places: by arm its joints where its lines begin, at the target and where they end [rad], shape (3, n, joints).
    """
    cell, names = order.clearance, list(order.model.arms)
    assert cell is not None  # callers have looked
    given, taken = (cell.held(order.job.tasks[t].part) for t in shares)
    before, after = np.zeros((2, 2), dtype=np.int64)
    before[giver], after[1 - giver] = given, taken
    met = cell.at_stops(before + after, np.array(True))
    n = places[0].shape[1]
    least = np.full(n, np.inf)
    for place, held in enumerate((before, met, after)):
        position = np.tile(order.start, (n, 1))
        for a, name in enumerate(names):
            position[:, order.model.arms[name].columns] = places[a][place]
        least = np.minimum(least, cell.cross_margins(position, np.tile(held, (n, 1))))
    return least


def met_postures(
    order: OrderModel,
    stops: Sequence[tuple[int, int]],
    angles: IntArray,
    cheapest: Sequence[IntArray],
) -> list[IntArray]:
    """Returns the rows of each arm's postures (s, f) with those of hand-overs chosen in pairs, -1 for none.

    Args:
        order: the job's tasks.
        stops: task and number of every stop.
        angles: numbers of the platform angles, shape (f,).
        cheapest: by arm the row of the cheapest posture of each stop and angle by itself.
    """
    found, names = [np.array(rows) for rows in cheapest], list(order.model.arms)
    if order.clearance is None:
        return found
    for shares in handovers_of(order):
        keys = [(shares[0], 1), (shares[1], 0)]
        for giver in (0, 1):
            arms = (giver, 1 - giver)
            for k, f in enumerate(angles.tolist()):
                places = [stops.index(key) for key in keys]
                if any(cheapest[a][i, k] < 0 for a, i in zip(arms, places, strict=True)):
                    continue
                pair = _pair(order, shares, giver, f, [names[a] for a in arms])
                for a, i, row in zip(arms, places, pair, strict=True):
                    found[a][i, k] = row
    return found


def _pair(
    order: OrderModel, shares: tuple[int, int], giver: int, f: int, names: Sequence[str]
) -> tuple[int, int]:
    """Returns the rows of the cheapest postures of giver and taker that keep clear of each other, -1 for none."""
    keys = [(names[0], shares[0], 1), (names[1], shares[1], 0)]
    rows = [order.rows(*key, f) for key in keys]
    nodes = [order.nodes[key] for key in keys]
    i, j = (x.ravel() for x in np.meshgrid(*rows, indexing="ij"))
    if not len(i):
        return -1, -1
    ways = [
        np.stack([n.entry[r], n.target[r], n.leaving[r]])
        for n, r in zip(nodes, (i, j), strict=True)
    ]
    by_arm = ways if giver == 0 else ways[::-1]
    clear = handover_margins(order, shares, giver, by_arm) >= 0.0
    if not clear.any():
        return -1, -1
    costs = [order.costs(name, n) for name, n in zip(names, nodes, strict=True)]
    both = np.where(clear, costs[0][i] + costs[1][j], np.inf)
    best = int(both.argmin())
    return int(i[best]), int(j[best])
