"""One arm's cheapest posture that keeps clear, at every stop and platform angle: of all of them together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.planning.order_model import OrderModel
from dualarm_cli.planning.stop_nodes import StopNodes

WIDTHS = (1, 1, 2, 4, 8, 16)
"""So many more postures of every stop and angle are looked at in each round; in the end the last number again."""


def cheapest_postures(
    order: OrderModel, name: str, stops: Sequence[tuple[int, int]], angles: IntArray
) -> IntArray:
    """Returns the row of the cheapest posture that keeps clear among each stop's nodes, -1 for none, shape (s, f).

    The first of `OrderModel.rows` each; what these find for one stop and one angle is looked for in rounds for all.

    Args:
        order: the job's tasks.
        name: the arm.
        stops: task and number of every stop.
        angles: numbers of the platform angles, shape (f,).
    """
    nodes = [order.nodes.get((name, t, s)) for t, s in stops]
    rows, first, last = _by_cost(order, name, nodes, angles)
    found = np.full(len(stops) * len(angles), -1)
    stop, angle = (x.ravel() for x in np.indices((len(stops), len(angles))))
    left = np.flatnonzero(first < last)
    done = first.copy()
    for width in (*WIDTHS, *[WIDTHS[-1]] * (int((last - first).max(initial=0)) // WIDTHS[-1])):
        count = np.minimum(width, last[left] - done[left])
        place = np.repeat(left, count)
        nth = np.arange(len(place)) - np.repeat(np.cumsum(count) - count, count)
        tried = rows[done[place] + nth]
        clear = _clear(order, name, stops, nodes, stop[place], angles[angle[place]], tried)
        # Backwards, so that the cheapest one of each is what remains.
        found[place[clear][::-1]] = tried[clear][::-1]
        done[left] += count
        left = left[(found[left] < 0) & (done[left] < last[left])]
        if not len(left):
            break
    return found.reshape(len(stops), len(angles))


def _by_cost(
    order: OrderModel, name: str, nodes: Sequence[StopNodes | None], angles: IntArray
) -> tuple[IntArray, IntArray, IntArray]:
    """Returns rows of nodes by stop, angle and cost, and which of them are each stop's and angle's, (s f,) each."""
    rows, first, last = [np.zeros(0, dtype=np.int64)], [], []
    begin = 0
    for own in nodes:
        if own is None:
            first.append(np.full(len(angles), begin))
            last.append(np.full(len(angles), begin))
            continue
        ranked = np.lexsort((order.costs(name, own), own.angle))
        sorted_angles = own.angle[ranked]
        rows.append(ranked)
        first.append(begin + np.searchsorted(sorted_angles, angles, side="left"))
        last.append(begin + np.searchsorted(sorted_angles, angles, side="right"))
        begin += len(ranked)
    return np.concatenate(rows), np.concatenate(first), np.concatenate(last)


def _clear(
    order: OrderModel,
    name: str,
    stops: Sequence[tuple[int, int]],
    nodes: Sequence[StopNodes | None],
    stop: IntArray,
    angle: IntArray,
    rows: IntArray,
) -> BoolArray:
    """Returns whether postures of stops keep clear; `stop` is in rising order."""
    if order.clearance is None or not len(rows):
        return np.ones(len(rows), dtype=np.bool_)
    places: list[list[FloatArray]] = [[], [], []]
    held = np.zeros((3, len(rows)), dtype=np.int64)
    edges = np.flatnonzero(np.diff(stop, prepend=-1, append=len(stops)))
    for begin, end in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        k = int(stop[begin])
        own = nodes[k]
        assert own is not None  # it has rows
        for place, table in zip(places, (own.entry, own.target, own.leaving), strict=True):
            place.append(table[rows[begin:end]])
        held[:, begin:end] = np.array(order.held(*stops[k]))[:, None]
    joined = np.concatenate([table for place in places for table in place])
    return order.keeps_clear(name, joined, np.tile(angle, 3), held.ravel())
