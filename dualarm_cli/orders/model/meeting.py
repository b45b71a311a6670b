"""Stops of two arms that collide in every posture, and so cannot share a stage."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.model.cell import Held
from dualarm_cli.orders.model.order_model import OrderModel


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
        order: the job's tasks; something has to be collision-free.
        shares: numbers of the giver's and of the taker's task.
        giver: number of the giving arm.
        places: by arm its joints where its lines begin, at the target and where they end [rad], shape (3, n, joints).
    """
    cell, names = order.clearance, list(order.model.arms)
    assert cell is not None  # callers have looked
    loads = cell.loads
    given, taken = (loads.number(order.job.tasks[t].part) for t in shares)
    before, after = loads.nothing(2, 2)
    before[giver], after[1 - giver] = given, taken
    met = loads.at_stops(loads.fuller(before, after), np.array(True))
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
    """Returns the rows of the cheapest postures of giver and taker that are clear of each other, -1 for none."""
    keys = [(names[0], shares[0], 1), (names[1], shares[1], 0)]
    rows = [order.rows(*key, f) for key in keys]
    nodes = [order.nodes[key] for key in keys]
    i, j = (x.ravel() for x in np.meshgrid(*rows, indexing="ij"))
    if not len(i):
        return -1, -1
    ways = [
        np.stack([n.q_approach[r], n.q_target[r], n.q_retract[r]])
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


MOST_PAIRS = 2_000_000
"""Pairs of postures that are tested one by one; of more, representatives are."""
AT_ONCE = 100_000
"""So many are tested at once."""
FAR = 0.4
"""Arms that are so far apart at their targets are apart all along their lines [m]."""
REPRESENTATIVES = 350
"""So many postures of each arm stand for all others."""
ON_LINES = np.array([[0, 1, 0], [1, 0, 0], [0.5, 0.5, 0], [0, 0, 1], [0, 0.5, 0.5]])
"""Places that are looked at: shares of the joints where approaches begin, at targets and where retracts end."""


def meeting_costs(
    order: OrderModel, stops: Sequence[tuple[int, int]], chosen: Sequence[FloatArray]
) -> FloatArray | None:
    """Returns infinity for every pair of stops at which two arms would touch, 0 for all others.

    Both at their targets, both where their approaches begin and where their retracts end, and both about half-way are
    looked at.

    Args:
        order: the job's tasks.
        stops: task and number of every stop.
        chosen: by arm the joints where approaches begin, at targets and where retracts end, shape (3, s, f, joints);
            NaN where a stop cannot be made.

    Returns:
        Shape (s + 2, s + 2, f), see StageProblem.pair_cost; None for one arm or where nothing has to be collision-free.
    """
    if order.clearance is None or len(chosen) != 2:
        return None
    count, f = chosen[0].shape[1:3]
    found = np.zeros((count + 2, count + 2, f), dtype=np.float32)
    held = _held(order, stops)
    made = [np.isfinite(arm[0, :, :, 0]) for arm in chosen]
    if (made[0].sum(axis=0) * made[1].sum(axis=0)).sum() <= MOST_PAIRS:
        for k in range(f):
            i, j = np.nonzero(made[0][:, k, None] & made[1][None, :, k])
            for first in range(0, len(i), AT_ONCE):
                pair = i[first : first + AT_ONCE], j[first : first + AT_ONCE]
                angle = np.full(len(pair[0]), k)
                touch = _touch(order, chosen, pair, (angle, angle), held)
                found[pair[0][touch], pair[1][touch], k] = np.inf
        return _with_handovers(order, stops, chosen, found)
    picked, nearest = zip(*(_representatives(arm) for arm in chosen), strict=True)
    i, j = (x.ravel() for x in np.meshgrid(*(np.arange(len(p)) for p in picked), indexing="ij"))
    rows = [picked[0][i], picked[1][j]]
    touch = _touch(order, chosen, tuple(r[:, 0] for r in rows), tuple(r[:, 1] for r in rows), held)
    table = touch.reshape(len(picked[0]), len(picked[1]))
    for k in range(f):
        one, other = nearest[0][:, k], nearest[1][:, k]
        both = (one[:, None] >= 0) & (other[None, :] >= 0)
        found[:count, :count, k][both & table[one[:, None], other[None, :]]] = np.inf
    return _with_handovers(order, stops, chosen, found)


def _with_handovers(
    order: OrderModel,
    stops: Sequence[tuple[int, int]],
    chosen: Sequence[FloatArray],
    found: FloatArray,
) -> FloatArray:
    """Returns the costs with those of hand-overs, in which tools may touch the part; arguments as there."""
    for shares in handovers_of(order):
        give, take = stops.index((shares[0], 1)), stops.index((shares[1], 0))
        for giver, pair in enumerate(((give, take), (take, give))):
            both = [arm[:, stop] for arm, stop in zip(chosen, pair, strict=True)]
            rows = np.flatnonzero(
                np.isfinite(both[0][0]).all(axis=1) & np.isfinite(both[1][0]).all(axis=1)
            )
            margin = handover_margins(order, shares, giver, [arm[:, rows] for arm in both])
            found[pair[0], pair[1], rows] = np.where(margin < 0.0, np.inf, 0.0)
    return found


def stop_conflicts(order: OrderModel, f: int) -> BoolArray:
    """Returns whether the arms touch while the first makes one stop and the second another, shape (s, s).

    Both at targets, and both where approaches begin, in their cheapest postures, with the platform at one angle. Stops
    are those of all tasks, one after the other.

    Args:
        order: the job's tasks.
        f: number of the platform angle.
    """
    names, tasks = list(order.model.arms), order.job.tasks
    stops = [(t, s) for t, task in enumerate(tasks) for s in range(len(task.stops))]
    if order.clearance is None or len(names) != 2:
        return np.zeros((len(stops), len(stops)), dtype=np.bool_)
    chosen = []
    for name in names:
        joints = len(order.model.arms[name].columns)
        own = np.full((3, len(stops), 1, joints), np.nan)
        for k, (t, s) in enumerate(stops):
            if not tasks[t].allows(name):
                continue
            rows = order.rows(name, t, s, f)
            if len(rows):
                nodes = order.nodes[name, t, s]
                places = nodes.q_approach, nodes.q_target, nodes.q_retract
                own[:, k, 0] = [place[rows[0]] for place in places]
        chosen.append(own)
    table = meeting_costs(order, stops, chosen)
    assert table is not None  # there are two arms, and something has to be collision-free
    return np.asarray(np.isinf(table[: len(stops), : len(stops), 0]))


def _held(order: OrderModel, stops: Sequence[tuple[int, int]]) -> IntArray:
    """Returns what an arm holds at each stop, at most, shape (s,)."""
    assert order.clearance is not None  # callers have looked
    number = order.clearance.loads.number
    held = (Held(order.tasks[t].tool, order.tasks[t].part).name for t, _ in stops)
    return np.array([number(name) for name in held], dtype=np.int64)


def _touch(
    order: OrderModel,
    chosen: Sequence[FloatArray],
    stop: tuple[IntArray, ...],
    angle: tuple[IntArray, ...],
    held: IntArray,
) -> BoolArray:
    """Returns whether the arms touch at pairs of stops, each as seen from an angle, shape (n,).

    Both at their targets first, then at the same places of their lines, unless they are far apart.
    """
    assert order.clearance is not None  # callers have looked
    clearance, names = order.clearance, list(order.model.arms)
    both = np.stack([held[stop[0]], held[stop[1]]], axis=1)
    # Where approaches begin, at targets and where retracts end, shape (3, n, joints) each.
    ends = [arm[:, s, f] for arm, s, f in zip(chosen, stop, angle, strict=True)]

    def margins(rows: IntArray, share: FloatArray) -> FloatArray:
        position = np.tile(order.start, (len(rows), 1))
        for own, name in zip(ends, names, strict=True):
            places = np.einsum("s,snj->nj", share, own[:, rows])
            position[:, order.model.arms[name].columns] = places
        return clearance.cross_margins(position, both[rows])

    rows = np.arange(len(both))
    at_target = margins(rows, ON_LINES[0])
    touch = at_target < 0.0
    left = np.flatnonzero(~touch & (at_target < FAR))
    # Most arms leave as they came.
    back = all(np.array_equal(own[0], own[2], equal_nan=True) for own in ends)
    for share in ON_LINES[1:3] if back else ON_LINES[1:]:
        touch[left] |= margins(left, share) < 0.0
        left = left[~touch[left]]
    return touch


def _representatives(arm: FloatArray) -> tuple[IntArray, IntArray]:
    """Returns stops and angles (m, 2) whose postures stand for all, and the one for each, -1 for none, (s, f)."""
    _, count, f, _ = arm.shape
    index = np.argwhere(np.isfinite(arm[1, :, :, 0]))
    q = arm[1, index[:, 0], index[:, 1]]
    nearest = np.full((count, f), -1)
    if not len(q):
        return index, nearest
    # Farthest first: every posture is then near to one of those that were taken.
    distance = np.abs(q - q[0]).max(axis=1)
    taken, of = [0], np.zeros(len(q), dtype=np.int64)
    while len(taken) < min(REPRESENTATIVES, len(q)) and distance.max() > 0.0:
        far = int(distance.argmax())
        own = np.abs(q - q[far]).max(axis=1)
        nearer = own < distance
        of[nearer], distance = len(taken), np.minimum(distance, own)
        taken.append(far)
    nearest[index[:, 0], index[:, 1]] = of
    return index[taken], nearest
