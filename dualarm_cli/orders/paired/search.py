"""Good orders of stages: tasks are removed and put back into the stage where all is then done soonest."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.geometry.elementary import log, power
from dualarm_cli.orders.paired.problem import (
    IDLE,
    StageOrder,
    StageProblem,
    near_units,
    stage_units,
)
from dualarm_cli.orders.paired.times import (
    Ends,
    Stretches,
    closing,
    missing_parts,
    previous,
    totals,
    with_angles,
)
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class InsertionPlace:
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
) -> list[InsertionPlace]:
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
        found.append(InsertionPlace((arm,), k, k, tuple(new)))
        run = 0
        while run < m and k + run < last and idle[k + run]:
            run += 1
        if not run:
            continue
        filled = tuple(_with(rows[k + i], arm, stops[i]) for i in range(run))
        found.append(InsertionPlace((arm,), k, k + run, (*filled, *new[run:])))
        if m > 1:
            found.append(
                InsertionPlace((arm,), k, k + 1, (*new[:-1], _with(rows[k], arm, stops[-1])))
            )
    return found


def meeting_places(
    slots: IntArray,
    giver: int,
    stops: tuple[int, ...],
    span: tuple[int, int],
    middle: Sequence[BoolArray],
) -> list[InsertionPlace]:
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
            InsertionPlace((giver, taker), begin, end, (one, both, other))
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
        self._whole = slots if ends is None else np.concatenate([slots, ends.next_stages])
        # Windows ask for the time at which everything is done.
        self._plain = problem.not_before is None and problem.not_after is None
        if self._plain:
            self._prepare()

    def _prepare(self) -> None:
        problem, ends, n = self._problem, self._ends, len(self._whole)
        f = len(problem.turn)
        start = None if ends is None else ends.last_stops
        self._came = previous(self._whole[None], problem.stops, start)[0]
        rows = np.arange(n)
        steps: FloatArray = np.full((n, f, f), -np.inf)
        for a, length in enumerate(problem.length):
            steps = np.maximum(steps, length[self._came[rows, a], self._whole[:, a]])
        if problem.pair_cost is not None:
            steps += problem.pair_cost[self._whole[:, 0], self._whole[:, 1]][:, None]
        self._values = np.full((n + 1, f), np.inf)
        self._rest = np.zeros((n + 1, f))
        if ends is not None:
            self._values[0] = ends.values
        else:
            self._values[0, slice(None) if problem.free_start else 0] = 0.0
        rest = None if ends is None else ends.remaining
        self._rest[n] = closing(problem, self._came[n][None])[0] if rest is None else rest
        self._closes = rest is None
        for k in range(n):
            self._values[k + 1] = (self._values[k][:, None] + steps[k]).min(axis=0)
        for k in range(n - 1, -1, -1):
            self._rest[k] = (steps[k] + self._rest[k + 1]).min(axis=1)

    def totals(self, tries: list[InsertionPlace]) -> FloatArray:
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

    def _orders(self, tries: list[InsertionPlace], slots: IntArray) -> IntArray:
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


@dataclass(frozen=True)
class InsertionSettings:
    """Numbers that steer removal and insertion of tasks."""

    removed: tuple[int, ...] = (2, 7)
    """Fewest and most units that are removed at a time."""
    hot: float = 0.25
    """First temperature of the annealing, relative to a unit's mean time.

    That time is the first order's total divided by its number of units.
    """
    cold: float = 0.002
    """Last temperature of the annealing, relative to a unit's mean time."""
    blink: float = 0.03
    """Share of the places that are overlooked when a unit is put back."""
    stretch: int = 12
    """Stages of a long order that are improved together."""
    per_stretch: int = 25
    """Number of removals and insertions per stretch of a long order."""


INSERTION = InsertionSettings()


class StageSearch:
    """Ruin and recreate [Schrimpf2000] on one problem."""

    def __init__(self, problem: StageProblem, seed: int) -> None:
        """Prepares units and what is near to what."""
        self.problem, self.seed = problem, seed
        self._random = np.random.default_rng(seed)
        self.units = stage_units(problem)
        self._unit_of = {stop: u for u, unit in enumerate(self.units) for stop in unit.stops}
        self._near = near_units(problem, self.units)
        of_task = {t: u for u, unit in enumerate(self.units) for t in unit.tasks}
        self._before: list[set[int]] = [set() for _ in self.units]
        self._after: list[set[int]] = [set() for _ in self.units]
        for one, other in problem.before:
            u, v = of_task[one], of_task[other]
            if u != v:
                self._before[v].add(u)
                self._after[u].add(v)
        self._inner = np.zeros(problem.stops + 1, dtype=np.bool_)
        for unit in self.units:
            rows = unit.shares(0) if unit.meets else (unit,)
            for row in rows:
                self._inner[list(row.stops[:-1])] = True

    def first(self) -> StageOrder | None:
        """Returns an order by insertion, those first that come before others; None where none was found."""
        slots = np.full((0, len(self.problem.length)), IDLE, dtype=np.int64)
        order = list(range(len(self.units)))
        if not self.problem.in_file_order:
            order = [order[k] for k in self._random.permutation(len(order))]
        found = self.inserted(slots, self._sorted(order), 0.0, None)
        return None if found is None else with_angles(self.problem, found)

    def improve(
        self,
        start: StageOrder,
        iterations: int,
        better: Callable[[StageOrder], None] = lambda _: None,
        stop: Callable[[], bool] = lambda: False,
    ) -> StageOrder:
        """Returns the best order found from one to begin with.

        Args:
            start: an order.
            iterations: how often something is removed and put back.
            better: receives every new best one; its angles are left out.
            stop: whether to stop early.
        """
        share = start.total / len(self.units) if np.isfinite(start.total) else 1.0
        heat = INSERTION.hot * share, INSERTION.cold * share

        def found(slots: IntArray, total: float) -> None:
            better(StageOrder(slots, np.zeros(0, dtype=np.int64), total))

        first = start.slots, start.total
        slots, _ = self._annealed(first, iterations, heat, None, found, stop)
        return with_angles(self.problem, slots)

    def improve_stretches(
        self,
        start: StageOrder,
        stretches: int,
        better: Callable[[StageOrder], None] = lambda _: None,
        stop: Callable[[], bool] = lambda: False,
    ) -> StageOrder:
        """Returns the best order found by improving stretches of a long one, each by itself.

        Args:
            start: an order.
            stretches: how many.
            better: receives every new best one.
            stop: whether to stop early.
        """
        slots, total = start.slots, start.total
        share = start.total / len(self.units) if np.isfinite(start.total) else 1.0
        for k in range(stretches):
            if stop():
                break
            values = Stretches(self.problem, slots)
            span = min(len(slots), INSERTION.stretch)
            begin = int(self._random.integers(len(slots) - span + 1))
            ends = values.ends(begin, begin + span)
            own = slots[begin : begin + span]
            before = float(totals(self.problem, own[None], ends)[0])
            warm = INSERTION.hot * share * (1.0 - k / stretches)
            found, after = self._annealed(
                (own, before),
                INSERTION.per_stretch,
                (warm, INSERTION.cold * share),
                ends,
                lambda *_: None,
                stop,
            )
            if after < before - 1e-9:
                slots = np.concatenate([slots[:begin], found, slots[begin + span :]])
                total = after
                better(StageOrder(slots, np.zeros(0, dtype=np.int64), total))
        return with_angles(self.problem, slots)

    def _annealed(
        self,
        start: tuple[IntArray, float],
        iterations: int,
        heat: tuple[float, float],
        ends: Ends | None,
        better: Callable[[IntArray, float], None],
        stop: Callable[[], bool],
    ) -> tuple[IntArray, float]:
        """Improve stages with their total [s] by annealing; return the best found, with theirs."""
        best = current = start
        warm, cooling = heat[0], power(heat[1] / max(heat), 1.0 / max(1, iterations))
        for _ in range(iterations):
            warm *= cooling
            if stop():
                break
            left, gone = self._ruined(current[0])
            tried = self.inserted(left, self._sorted(gone), INSERTION.blink, ends) if gone else None
            if tried is None:
                continue
            found = float(totals(self.problem, tried[None], ends)[0])
            if found >= current[1] - warm * log(1.0 - self._random.random()):
                continue
            current = tried, found
            if found < best[1] - 1e-9:
                best = current
                better(*best)
        return best

    def _ruined(self, slots: IntArray) -> tuple[IntArray, list[int]]:
        """Returns an order without some units that are near to one another, or stages that follow one another."""
        count = int(self._random.integers(INSERTION.removed[0], INSERTION.removed[1] + 1))
        there = self._whole(slots)
        if not there:
            return slots, []
        if self._random.random() < 0.5:
            seed = there[int(self._random.integers(len(there)))]
            inside = set(there)
            near = [u for u in self._near[seed] if u in inside]
            picked = self._random.permutation(len(near))[: count - 1]
            gone = {seed, *(near[k] for k in picked)}
        else:
            begin = int(self._random.integers(len(slots)))
            stops = slots[begin : begin + (count + 1) // 2].ravel().tolist()
            gone = {self._unit_of[s] for s in stops if s != IDLE} & set(there)
        return self.without(slots, gone), sorted(gone)

    def _whole(self, slots: IntArray) -> list[int]:
        """Returns the units all of whose stops are among some stages."""
        stops = slots[slots != IDLE].tolist()
        count: dict[int, int] = {}
        for stop in stops:
            u = self._unit_of[stop]
            count[u] = count.get(u, 0) + 1
        return sorted(u for u, m in count.items() if m == len(self.units[u].stops))

    def without(self, slots: IntArray, gone: set[int]) -> IntArray:
        """Returns an order without some units, and without stages in which nothing is left to do."""
        removed = [stop for u in gone for stop in self.units[u].stops]
        left = np.where(np.isin(slots, removed), IDLE, slots)
        return left[(left != IDLE).any(axis=1)]

    def _sorted(self, gone: list[int]) -> list[int]:
        order = [gone[k] for k in self._random.permutation(len(gone))]
        if self.problem.before:
            rank = self._ranks(order)
            order.sort(key=lambda u: rank[u])
        if self.problem.in_file_order:
            order.sort(key=lambda u: self.units[u].tasks[0])
        return order

    def _ranks(self, order: list[int]) -> dict[int, int]:
        """Returns how many units have to be over one after the other before each."""
        rank = dict.fromkeys(order, 0)
        for _ in order:
            for u in order:
                rank[u] = max([rank[v] + 1 for v in self._before[u] if v in rank], default=0)
        return rank

    def inserted(
        self, slots: IntArray, units: list[int], blink: float, ends: Ends | None
    ) -> IntArray | None:
        """Returns an order with more units, each where all is then done soonest; None where one has no place."""
        for u in units:
            tries = self._places(slots, u, ends)
            if not tries:
                return None
            cost = Insertions(self.problem, slots, ends).totals(tries)
            if blink and len(tries) > 1:
                cost[self._random.random(len(tries)) < blink] += 1e6
            k = int(cost.argmin())
            if not np.isfinite(cost[k]):
                return None
            slots = tries[k].done(slots)
        return slots

    def _places(self, slots: IntArray, u: int, ends: Ends | None) -> list[InsertionPlace]:
        """Returns every place at which a unit keeps the rules."""
        found = []
        low, high = self._range(slots, u)
        unit = self.units[u]
        for a in unit.arms:
            first, last = self._file_range(slots[:, a], u, low, high)
            if not unit.meets:
                middle = self._middle(slots, a, ends)
                found += places(slots, a, unit.stops, first, last, middle)
                continue
            span = self._file_range(slots[:, 1 - a], u, first, last)
            both = [self._middle(slots, arm, ends) for arm in range(slots.shape[1])]
            found += meeting_places(slots, a, unit.stops, span, both)
        return found

    def _middle(self, slots: IntArray, a: int, ends: Ends | None) -> BoolArray:
        """Returns before which stages an arm is in the middle of other work, shape (n + 1,)."""
        at = IDLE if ends is None else int(ends.last_stops[a])
        middle = [bool(at != IDLE and self._inner[at])]
        for stop in slots[:, a].tolist():
            at = stop if stop != IDLE else at
            middle.append(bool(at != IDLE and self._inner[at]))
        return np.array(middle)

    def _range(self, slots: IntArray, u: int) -> tuple[int, int]:
        """Returns between which stages a unit has to be for what comes before and after it."""
        low, high = 0, len(slots)
        if self._before[u] or self._after[u]:
            for k, row in enumerate(slots.tolist()):
                for stop in row:
                    if stop == IDLE:
                        continue
                    v = self._unit_of[stop]
                    if v in self._before[u]:
                        low = max(low, k + 1)
                    elif v in self._after[u]:
                        high = min(high, k)
        return low, high

    def _file_range(self, own: IntArray, u: int, low: int, high: int) -> tuple[int, int]:
        """Returns a range of stages within which one arm keeps the file's order."""
        if not self.problem.in_file_order:
            return low, high
        first = self.units[u].tasks[0]
        for k, stop in enumerate(own.tolist()):
            if stop == IDLE:
                continue
            if self.units[self._unit_of[stop]].tasks[0] < first:
                low = max(low, k + 1)
            else:
                high = min(high, k)
        return low, high
