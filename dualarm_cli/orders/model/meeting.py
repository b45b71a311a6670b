"""Stops of two arms that collide in every posture, and so cannot share a stage."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.model.cell import Held
from dualarm_cli.orders.model.order_model import OrderModel


def handovers_of(order: OrderModel) -> tuple[tuple[int, int], ...]:
    """List the giver's and the taker's task of each hand-over."""
    tasks = order.job.tasks
    taking = {task.id: t for t, task in enumerate(tasks) if task.stops[0].action == "take"}
    return tuple(
        (t, taking[task.id]) for t, task in enumerate(tasks) if task.stops[-1].action == "give"
    )


def handover_margins(
    order: OrderModel, shares: tuple[int, int], giver: int, places: Sequence[FloatArray]
) -> FloatArray:
    """Compute the least margin between the arms during a hand-over [m], shape (n,).

    The held part changes: before the meeting, during it, and after the giver's retract.

    Args:
        order: the job's tasks, with collision checks.
        shares: numbers of the giver's and of the taker's task.
        giver: number of the giving arm.
        places: joints of each arm at approach starts, targets and retract ends [rad], shape (3, n, joints).
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


def pair_handover_postures(
    order: OrderModel,
    stops: Sequence[tuple[int, int]],
    angles: IntArray,
    cheapest: Sequence[IntArray],
) -> list[IntArray]:
    """Choose hand-over postures in pairs: rows by arm, (s, f), -1 for none.

    Args:
        order: the job's tasks.
        stops: task and number of every stop.
        angles: numbers of the platform angles, shape (f,).
        cheapest: by arm, the row of the cheapest posture of each stop and angle.
    """
    rows_by_arm, names = [np.array(table) for table in cheapest], list(order.model.arms)
    if order.clearance is None:
        return rows_by_arm
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
                    rows_by_arm[a][i, k] = row
    return rows_by_arm


def _pair(
    order: OrderModel, shares: tuple[int, int], giver: int, f: int, names: Sequence[str]
) -> tuple[int, int]:
    """Select the cheapest collision-free giver and taker postures: rows, -1 for none."""
    keys = [(names[0], shares[0], 1), (names[1], shares[1], 0)]
    rows = [order.rows(*key, f) for key in keys]
    nodes = [order.nodes[key] for key in keys]
    i, j = (x.ravel() for x in np.meshgrid(*rows, indexing="ij"))
    if not len(i):
        return -1, -1
    places = [
        np.stack([n.q_approach[r], n.q_target[r], n.q_retract[r]])
        for n, r in zip(nodes, (i, j), strict=True)
    ]
    by_arm = places if giver == 0 else places[::-1]
    clear = handover_margins(order, shares, giver, by_arm) >= 0.0
    if not clear.any():
        return -1, -1
    costs = [order.costs(name, n) for name, n in zip(names, nodes, strict=True)]
    total_costs = np.where(clear, costs[0][i] + costs[1][j], np.inf)
    best = int(total_costs.argmin())
    return int(i[best]), int(j[best])


MOST_PAIRS = 2_000_000
"""Maximum number of pairs of postures that are all tested; beyond it representatives are."""
AT_ONCE = 100_000
"""Maximum number of pairs tested at once."""
FAR = 0.4
"""Margin at the targets above which lines need no test [m]."""
REPRESENTATIVES = 350
"""Maximum number of representative postures of each arm."""
ON_LINES = np.array([[0, 1, 0], [1, 0, 0], [0.5, 0.5, 0], [0, 0, 1], [0, 0.5, 0.5]])
"""Weights of the sampled points on lines, for approach start, target and retract end."""


def meeting_costs(
    order: OrderModel, stops: Sequence[tuple[int, int]], chosen: Sequence[FloatArray]
) -> FloatArray | None:
    """Compute the cost of simultaneous stops: infinity if the arms collide, else 0.

    Sampled are both arms at their targets, at the starts of their approaches, at the ends of their retracts, and about
    midway.

    Args:
        order: the job's tasks.
        stops: task and number of every stop.
        chosen: joints of each arm at approach starts, targets and retract ends, shape (3, s, f, joints); NaN for stops
            out of reach.

    Returns:
        Costs as in StageProblem.pair_cost, shape (s + 2, s + 2, f); None for one arm or without collision checks.
    """
    if order.clearance is None or len(chosen) != 2:
        return None
    count, f = chosen[0].shape[1:3]
    costs = np.zeros((count + 2, count + 2, f), dtype=np.float32)
    held = _held(order, stops)
    reachable = [np.isfinite(arm[0, :, :, 0]) for arm in chosen]
    if (reachable[0].sum(axis=0) * reachable[1].sum(axis=0)).sum() <= MOST_PAIRS:
        for k in range(f):
            i, j = np.nonzero(reachable[0][:, k, None] & reachable[1][None, :, k])
            for first in range(0, len(i), AT_ONCE):
                pair = i[first : first + AT_ONCE], j[first : first + AT_ONCE]
                angle = np.full(len(pair[0]), k)
                touch = _touch(order, chosen, pair, (angle, angle), held)
                costs[pair[0][touch], pair[1][touch], k] = np.inf
        return _with_handovers(order, stops, chosen, costs)
    picked, nearest = zip(*(_representatives(arm) for arm in chosen), strict=True)
    i, j = (x.ravel() for x in np.meshgrid(*(np.arange(len(p)) for p in picked), indexing="ij"))
    rows = [picked[0][i], picked[1][j]]
    touch = _touch(order, chosen, tuple(r[:, 0] for r in rows), tuple(r[:, 1] for r in rows), held)
    table = touch.reshape(len(picked[0]), len(picked[1]))
    for k in range(f):
        nearest_first, nearest_second = nearest[0][:, k], nearest[1][:, k]
        both = (nearest_first[:, None] >= 0) & (nearest_second[None, :] >= 0)
        costs[:count, :count, k][both & table[nearest_first[:, None], nearest_second[None, :]]] = (
            np.inf
        )
    return _with_handovers(order, stops, chosen, costs)


def _with_handovers(
    order: OrderModel,
    stops: Sequence[tuple[int, int]],
    chosen: Sequence[FloatArray],
    costs: FloatArray,
) -> FloatArray:
    """Insert the costs of hand-overs, with arguments as in `pair_handover_postures`.

    Tools may touch the part there.
    """
    for shares in handovers_of(order):
        give, take = stops.index((shares[0], 1)), stops.index((shares[1], 0))
        for giver, pair in enumerate(((give, take), (take, give))):
            both = [arm[:, stop] for arm, stop in zip(chosen, pair, strict=True)]
            rows = np.flatnonzero(
                np.isfinite(both[0][0]).all(axis=1) & np.isfinite(both[1][0]).all(axis=1)
            )
            margin = handover_margins(order, shares, giver, [arm[:, rows] for arm in both])
            costs[pair[0], pair[1], rows] = np.where(margin < 0.0, np.inf, 0.0)
    return costs


def stop_conflicts(order: OrderModel, f: int) -> BoolArray:
    """Test which stop pairs of the arms collide at an angle, (s, s).

    The angle is that of the platform.

    Tested at targets and at the starts of approaches, in the cheapest postures. Stops are numbered task by task.

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
        arm_places = np.full((3, len(stops), 1, joints), np.nan)
        for k, (t, s) in enumerate(stops):
            if not tasks[t].allows(name):
                continue
            rows = order.rows(name, t, s, f)
            if len(rows):
                nodes = order.nodes[name, t, s]
                places = nodes.q_approach, nodes.q_target, nodes.q_retract
                arm_places[:, k, 0] = [place[rows[0]] for place in places]
        chosen.append(arm_places)
    table = meeting_costs(order, stops, chosen)
    assert table is not None  # there are two arms, and something has to be collision-free
    return np.asarray(np.isinf(table[: len(stops), : len(stops), 0]))


def _held(order: OrderModel, stops: Sequence[tuple[int, int]]) -> IntArray:
    """List the largest load an arm holds at each stop, shape (s,)."""
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
    """Test whether arms collide at stop pairs, each with its angle, (n,).

    Targets are tested first, then the sampled points of lines unless the arms are far apart.
    """
    assert order.clearance is not None  # callers have looked
    clearance, names = order.clearance, list(order.model.arms)
    both = np.stack([held[stop[0]], held[stop[1]]], axis=1)
    # Approach starts, targets and retract ends, shape (3, n, joints) each.
    ends = [arm[:, s, f] for arm, s, f in zip(chosen, stop, angle, strict=True)]

    def margins(rows: IntArray, weights: FloatArray) -> FloatArray:
        position = np.tile(order.start, (len(rows), 1))
        for arm_ends, name in zip(ends, names, strict=True):
            places = np.einsum("s,snj->nj", weights, arm_ends[:, rows])
            position[:, order.model.arms[name].columns] = places
        return clearance.cross_margins(position, both[rows])

    rows = np.arange(len(both))
    at_target = margins(rows, ON_LINES[0])
    touch = at_target < 0.0
    remaining = np.flatnonzero(~touch & (at_target < FAR))
    # Most retracts are reversed approaches.
    symmetric = all(np.array_equal(arm[0], arm[2], equal_nan=True) for arm in ends)
    for weights in ON_LINES[1:3] if symmetric else ON_LINES[1:]:
        touch[remaining] |= margins(remaining, weights) < 0.0
        remaining = remaining[~touch[remaining]]
    return touch


def _representatives(arm: FloatArray) -> tuple[IntArray, IntArray]:
    """Select representative stops and angles (m, 2), and each posture's number, (s, f).

    The number is that of the posture's representative.
    """
    _, count, f, _ = arm.shape
    index = np.argwhere(np.isfinite(arm[1, :, :, 0]))
    q = arm[1, index[:, 0], index[:, 1]]
    nearest = np.full((count, f), -1)
    if not len(q):
        return index, nearest
    # Farthest-first traversal: every posture is then near a representative.
    distance = np.abs(q - q[0]).max(axis=1)
    taken, representative = [0], np.zeros(len(q), dtype=np.int64)
    while len(taken) < min(REPRESENTATIVES, len(q)) and distance.max() > 0.0:
        farthest = int(distance.argmax())
        new_distance = np.abs(q - q[farthest]).max(axis=1)
        nearer = new_distance < distance
        representative[nearer], distance = len(taken), np.minimum(distance, new_distance)
        taken.append(farthest)
    nearest[index[:, 0], index[:, 1]] = representative
    return index[taken], nearest
