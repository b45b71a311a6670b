"""Which stops of two arms cannot be made side by side, because the arms would touch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from dualarm_cli.collision.clearance import SLACK
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.model.cell import Held
from dualarm_cli.planning.handover_postures import handover_margins, handovers_of
from dualarm_cli.planning.order_model import OrderModel
from dualarm_cli.sequencing.stage_problem import IDLE

MOST_PAIRS = 300_000
"""Pairs of postures that are tested one by one; of more, representatives are."""
REPRESENTATIVES = 350
"""So many postures of each arm stand for all others."""


def meeting_costs(
    order: OrderModel, stops: Sequence[tuple[int, int]], chosen: Sequence[FloatArray]
) -> FloatArray | None:
    """Returns infinity for every pair of stops at which two arms would touch, 0 for all others.

    Both at their targets, and both where their approaches begin, are looked at.

    Args:
        order: the job's tasks.
        stops: task and number of every stop.
        chosen: by arm the joints where approaches begin, at targets and where retracts end, shape (3, s, f, joints);
            NaN where a stop cannot be made.

    Returns:
        Shape (s + 2, s + 2, f), see StageProblem.apart; None for one arm or where nothing has to keep clear.
    """
    if order.clearance is None or len(chosen) != 2:
        return None
    count, f = chosen[0].shape[1:3]
    found = np.zeros((count + 2, count + 2, f), dtype=np.float32)
    held = _held(order, stops)
    if count * count * f <= MOST_PAIRS:
        for k in range(f):
            own = [np.flatnonzero(np.isfinite(arm[0, :, k, 0])) for arm in chosen]
            i, j = (x.ravel() for x in np.meshgrid(*own, indexing="ij"))
            touch = _touch(order, chosen, (i, j), (np.full(len(i), k),) * 2, held)
            found[i[touch], j[touch], k] = np.inf
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


@dataclass(frozen=True)
class Meetings:
    """Closer looks at pairs of stops that an order makes side by side, for tables that know only representatives."""

    order: OrderModel
    """The job's tasks."""
    held: IntArray
    """What an arm holds at each stop, at most, shape (s,)."""
    chosen: tuple[FloatArray, ...]
    """By arm the joints where approaches begin, at targets and where retracts end, shape (3, s, f, joints)."""
    known: dict[tuple[int, int], BoolArray] = field(default_factory=dict)
    """At which angles pairs of stops touch that were looked at so far, shape (f,) each."""

    @classmethod
    def of(
        cls, order: OrderModel, stops: Sequence[tuple[int, int]], chosen: Sequence[FloatArray]
    ) -> Meetings | None:
        """Prepares looks; None for one arm, with hand-overs, or where nothing has to keep clear.

        Args:
            order: the job's tasks.
            stops: task and number of every stop.
            chosen: by arm the joints at stops, see `meeting_costs`.
        """
        if order.clearance is None or len(chosen) != 2 or handovers_of(order):
            return None
        return cls(order, _held(order, stops), tuple(chosen))

    def touching(self, slots: IntArray, angles: IntArray) -> list[tuple[int, int]]:
        """Returns the pairs of stops at which arms touch in an order (n, 2) at its angles (n,); `known` has more."""
        both = np.flatnonzero((slots != IDLE).all(axis=1))
        pairs = [(int(i), int(j)) for i, j in slots[both]]
        self._look([pair for pair in pairs if pair not in self.known])
        return [
            pair
            for pair, f in zip(pairs, angles[both].tolist(), strict=True)
            if self.known[pair][f]
        ]

    def _look(self, pairs: list[tuple[int, int]]) -> None:
        """Looks at pairs of stops at all angles: both arms at the same places of their lines, and where these end."""
        if not pairs:
            return
        f = self.chosen[0].shape[2]
        i, j = np.repeat(np.array(pairs), f, axis=0).T
        angle = np.tile(np.arange(f), len(pairs))
        ways = [
            _on_lines(arm[:, stop, angle]) for arm, stop in zip(self.chosen, (i, j), strict=True)
        ]
        rows = np.flatnonzero(
            np.isfinite(ways[0]).all(axis=(0, 2)) & np.isfinite(ways[1]).all(axis=(0, 2))
        )
        places = len(ways[0])
        position = np.tile(self.order.start, (places * len(rows), 1))
        for name, way in zip(self.order.model.arms, ways, strict=True):
            columns = self.order.model.arms[name].columns
            position[:, columns] = way[:, rows].reshape(places * len(rows), -1)
        assert self.order.clearance is not None  # `of` has looked
        held = np.tile(np.stack([self.held[i[rows]], self.held[j[rows]]], axis=1), (places, 1))
        margin = self.order.clearance.cross_margins(position, held).reshape(places, -1).min(axis=0)
        touch = np.zeros(len(i), dtype=np.bool_)
        touch[rows] = margin < SLACK
        for pair, row in zip(pairs, touch.reshape(-1, f), strict=True):
            self.known[pair] = row

    def kept_apart(self, table: FloatArray, cost: float = np.inf) -> FloatArray:
        """Returns a table of costs (s + 2, s + 2, f) with those of the pairs that were looked at, [s] for a touch."""
        found = np.array(table)
        if self.known:
            i, j = np.array(list(self.known)).T
            touch = np.where(np.array(list(self.known.values())), cost, 0.0)
            found[i, j] = np.maximum(found[i, j], touch)
        return found


def _on_lines(ends: FloatArray) -> FloatArray:
    """Returns joints where lines begin and end, and about half-way, shape (5, ..), of the former alone (3, ..)."""
    entry, target, leaving = ends
    return np.stack([entry, 0.5 * (entry + target), target, 0.5 * (target + leaving), leaving])


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
                own[:, k, 0] = [nodes.entry[rows[0]], nodes.target[rows[0]], nodes.leaving[rows[0]]]
        chosen.append(own)
    table = meeting_costs(order, stops, chosen)
    assert table is not None  # there are two arms, and something has to keep clear
    return np.asarray(np.isinf(table[: len(stops), : len(stops), 0]))


def _held(order: OrderModel, stops: Sequence[tuple[int, int]]) -> IntArray:
    """Returns what an arm holds at each stop, at most, shape (s,)."""
    assert order.clearance is not None  # callers have looked
    cell = order.clearance
    held = (Held(order.tasks[t].tool, order.tasks[t].part).name for t, _ in stops)
    return np.array([cell.held(name) for name in held], dtype=np.int64)


def _touch(
    order: OrderModel,
    chosen: Sequence[FloatArray],
    stop: tuple[IntArray, ...],
    angle: tuple[IntArray, ...],
    held: IntArray,
) -> FloatArray:
    """Returns whether the arms touch at pairs of stops, each as seen from an angle, shape (n,)."""
    assert order.clearance is not None  # callers have looked
    both = np.stack([held[stop[0]], held[stop[1]]], axis=1)
    least = np.full(len(stop[0]), np.inf)
    names = list(order.model.arms)
    for place in (0, 1):
        position = np.tile(order.start, (len(stop[0]), 1))
        for a, name in enumerate(names):
            position[:, order.model.arms[name].columns] = chosen[a][place, stop[a], angle[a]]
        least = np.minimum(least, order.clearance.cross_margins(position, both))
    return np.asarray(least < 0.0)


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
