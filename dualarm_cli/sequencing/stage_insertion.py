"""What it costs to put more stops into an order of stages, at every place at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.sequencing.stage_problem import IDLE, StageProblem
from dualarm_cli.sequencing.stage_times import Ends, closing, missing_parts, previous, totals


@dataclass(frozen=True)
class Place:
    """Where stops are put: some stages are replaced by others."""

    arms: tuple[int, ...]
    """The arms that make them."""
    first: int
    """First stage that is replaced."""
    last: int
    """Stage after the last one that is replaced."""
    rows: tuple[tuple[int, ...], ...]
    """What replaces them."""

    def done(self, slots: IntArray) -> IntArray:
        """Returns the order with the stops."""
        rows = np.array(self.rows, dtype=np.int64).reshape(-1, slots.shape[1])
        return np.concatenate([slots[: self.first], rows, slots[self.last :]])


def places(
    slots: IntArray, arm: int, stops: tuple[int, ...], first: int, last: int, middle: BoolArray
) -> list[Place]:
    """Returns every place for stops that one arm makes one right after the other.

    In idle slots as far as there are any, or in new stages.

    Args:
        slots: an order, shape (n, arms).
        arm: which arm.
        stops: in their order.
        first: earliest stage.
        last: stage before which they have to be over.
        middle: before which stages the arm is in the middle of other work, shape (n + 1,).
    """
    arms, m = slots.shape[1], len(stops)
    new = [tuple(stop if a == arm else IDLE for a in range(arms)) for stop in stops]
    rows = [tuple(row) for row in slots.tolist()]
    idle = (slots[:, arm] == IDLE).tolist()
    found = []
    for k in range(first, last + 1):
        if middle[k]:
            continue
        found.append(Place((arm,), k, k, tuple(new)))
        run = 0
        while run < m and k + run < last and idle[k + run]:
            run += 1
        if not run:
            continue
        filled = tuple(_with(rows[k + i], arm, stops[i]) for i in range(run))
        found.append(Place((arm,), k, k + run, (*filled, *new[run:])))
        if m > 1:
            found.append(Place((arm,), k, k + 1, (*new[:-1], _with(rows[k], arm, stops[-1]))))
    return found


def meeting_places(
    slots: IntArray,
    giver: int,
    stops: tuple[int, ...],
    span: tuple[int, int],
    middle: Sequence[BoolArray],
) -> list[Place]:
    """Returns every place for a hand-over: a new stage for both arms, the giver's stop before it, the taker's after it.

    Those two are in new stages or where the stages next to it leave their arm idle.

    Args:
        slots: an order, shape (n, 2).
        giver: the arm that gives.
        stops: the giver's two, then the taker's two.
        span: earliest stage, and stage before which all has to be over.
        middle: by arm, before which stages it is in the middle of other work, shape (n + 1,).
    """
    pick, give, take, put = stops
    taker, (first, last) = 1 - giver, span
    rows = [tuple(row) for row in slots.tolist()]
    nothing = (IDLE, IDLE)
    both = _with(_with(nothing, giver, give), taker, take)
    found = []
    for k in range(first, last + 1):
        if middle[taker][k]:
            continue
        before: list[tuple[int, tuple[int, ...]]] = []
        if not middle[giver][k]:
            before.append((k, _with(nothing, giver, pick)))
        if k > first and rows[k - 1][giver] == IDLE and not middle[giver][k - 1]:
            before.append((k - 1, _with(rows[k - 1], giver, pick)))
        after = [(k, _with(nothing, taker, put))]
        if k < last and rows[k][taker] == IDLE:
            after.append((k + 1, _with(rows[k], taker, put)))
        found += [
            Place((giver, taker), begin, end, (one, both, other))
            for begin, one in before
            for end, other in after
        ]
    return found


def _with(row: tuple[int, ...], arm: int, stop: int) -> tuple[int, ...]:
    return (*row[:arm], stop, *row[arm + 1 :])


class Insertions:
    """An order that more is put into."""

    def __init__(self, problem: StageProblem, slots: IntArray, ends: Ends | None) -> None:
        """Computes what all costs up to every stage, and from there on.

        Args:
            problem: what is asked.
            slots: the order, shape (n, arms).
            ends: what comes before and after it, where it is a stretch.
        """
        self._problem, self._ends = problem, ends
        self._slots = slots
        self._whole = slots if ends is None else np.concatenate([slots, ends.then])
        # Windows ask for the time at which everything is done.
        self._plain = problem.not_before is None and problem.not_after is None
        if self._plain:
            self._prepare()

    def _prepare(self) -> None:
        problem, ends, n = self._problem, self._ends, len(self._whole)
        f = len(problem.turn)
        start = None if ends is None else ends.came
        self._came = previous(self._whole[None], problem.stops, start)[0]
        rows = np.arange(n)
        steps: FloatArray = np.full((n, f, f), -np.inf)
        for a, length in enumerate(problem.length):
            steps = np.maximum(steps, length[self._came[rows, a], self._whole[:, a]])
        if problem.apart is not None:
            steps += problem.apart[self._whole[:, 0], self._whole[:, 1]][:, None]
        self._values = np.full((n + 1, f), np.inf)
        self._rest = np.zeros((n + 1, f))
        if ends is not None:
            self._values[0] = ends.values
        else:
            self._values[0, slice(None) if problem.free_start else 0] = 0.0
        rest = None if ends is None else ends.rest
        self._rest[n] = closing(problem, self._came[n][None])[0] if rest is None else rest
        self._closes = rest is None
        for k in range(n):
            self._values[k + 1] = (self._values[k][:, None] + steps[k]).min(axis=0)
        for k in range(n - 1, -1, -1):
            self._rest[k] = (steps[k] + self._rest[k + 1]).min(axis=1)

    def totals(self, tries: list[Place]) -> FloatArray:
        """Returns when all is done with stops at each of some places [s], shape (b,)."""
        if not self._plain:
            return totals(self._problem, self._orders(tries, self._slots), self._ends)
        n, rows = len(self._whole), [tuple(row) for row in self._whole.tolist()]
        following = self._next_active()
        first = np.array([place.first for place in tries])
        # Up to the arms' next stops it matters where they come from.
        until = np.array([max(following[a][place.last] for a in place.arms) for place in tries])
        some = [(*place.rows, *rows[place.last : u]) for place, u in zip(tries, until, strict=True)]
        arms = self._whole.shape[1]
        batch = np.full((len(some), max(len(one) for one in some), arms), IDLE, dtype=np.int64)
        for k, stages in enumerate(some):
            batch[k, : len(stages)] = stages
        came = self._came[first]
        rest = self._rest[until]
        last = until == n
        if last.any() and self._closes:
            rest = rest.copy()
            after = previous(batch[last], self._problem.stops, came[last])[:, -1]
            rest[last] = closing(self._problem, after)
        none = np.zeros((0, arms), dtype=np.int64)
        found = totals(self._problem, batch, Ends(came, self._values[first], none, rest))
        if self._problem.stores is None:
            return found
        whole = self._orders(tries, self._whole)
        return found + missing_parts(self._problem, whole, self._ends)

    def _orders(self, tries: list[Place], slots: IntArray) -> IntArray:
        """Returns an order with stops at each of some places, shape (b, stages, arms); IDLE stages at shorter ends."""
        orders = [place.done(slots) for place in tries]
        batch = np.full((len(orders), max(len(one) for one in orders), slots.shape[1]), IDLE)
        for k, one in enumerate(orders):
            batch[k, : len(one)] = one
        return batch

    def _next_active(self) -> list[list[int]]:
        """Returns, by arm and stage, the stage after the arm's next stop from there on, or the number of stages."""
        n = len(self._whole)
        found = []
        for a in range(self._whole.shape[1]):
            own, following = [n] * (n + 1), n
            for k in range(n - 1, -1, -1):
                if self._whole[k, a] != IDLE:
                    following = k + 1
                own[k] = following
            found.append(own)
        return found
