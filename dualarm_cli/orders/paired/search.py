"""Ruin and recreate of stages: tasks removed, then inserted at least makespan."""

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
    """Place of inserted stops: a range of stages and its replacement."""

    arms: tuple[int, ...]
    """Arms that make the stops."""
    first: int
    """First stage that is replaced."""
    last: int
    """Stage after the last one that is replaced."""
    rows: tuple[tuple[int, ...], ...]
    """Stages that replace the range."""

    def done(self, slots: IntArray) -> IntArray:
        """Insert the stops into an order."""
        rows = np.array(self.rows, dtype=np.int64).reshape(-1, slots.shape[1])
        return np.concatenate([slots[: self.first], rows, slots[self.last :]])


def places(
    slots: IntArray, arm: int, stops: tuple[int, ...], first: int, last: int, middle: BoolArray
) -> list[InsertionPlace]:
    """List every place for stops that one arm makes directly one after the other.

    In idle slots as far as possible, or in new stages.

    Args:
        slots: an order, shape (n, arms).
        arm: number of the arm.
        stops: stops in their order.
        first: earliest stage.
        last: stage before which the stops have to be finished.
        middle: whether the arm is in the middle of a unit before each stage, shape (n + 1,).
    """
    arms, m = slots.shape[1], len(stops)
    new = [tuple(stop if a == arm else IDLE for a in range(arms)) for stop in stops]
    rows = [tuple(row) for row in slots.tolist()]
    idle = (slots[:, arm] == IDLE).tolist()
    options = []
    for k in range(first, last + 1):
        if middle[k]:
            continue
        options.append(InsertionPlace((arm,), k, k, tuple(new)))
        filled_count = 0
        while filled_count < m and k + filled_count < last and idle[k + filled_count]:
            filled_count += 1
        if not filled_count:
            continue
        filled = tuple(_with(rows[k + i], arm, stops[i]) for i in range(filled_count))
        options.append(InsertionPlace((arm,), k, k + filled_count, (*filled, *new[filled_count:])))
        if m > 1:
            options.append(
                InsertionPlace((arm,), k, k + 1, (*new[:-1], _with(rows[k], arm, stops[-1])))
            )
    return options


def meeting_places(
    slots: IntArray,
    giver: int,
    stops: tuple[int, ...],
    span: tuple[int, int],
    middle: Sequence[BoolArray],
) -> list[InsertionPlace]:
    """List a hand-over's places: a common stage, with stages around it.

    The giver's first stop comes before the meeting and the taker's last one after it, in new stages or in adjacent
    stages in which the arm is idle.

    Args:
        slots: an order, shape (n, 2).
        giver: number of the giving arm.
        stops: two stops of the giver, then two of the taker.
        span: earliest stage, and stage before which all has to be finished.
        middle: by arm, whether it is in the middle of a unit before each stage, shape (n + 1,).
    """
    pick, give, take, put = stops
    taker, (first, last) = 1 - giver, span
    rows = [tuple(row) for row in slots.tolist()]
    idle = (IDLE, IDLE)
    meeting = _with(_with(idle, giver, give), taker, take)
    options = []
    for k in range(first, last + 1):
        if middle[taker][k]:
            continue
        before: list[tuple[int, tuple[int, ...]]] = []
        if not middle[giver][k]:
            before.append((k, _with(idle, giver, pick)))
        if k > first and rows[k - 1][giver] == IDLE and not middle[giver][k - 1]:
            before.append((k - 1, _with(rows[k - 1], giver, pick)))
        after = [(k, _with(idle, taker, put))]
        if k < last and rows[k][taker] == IDLE:
            after.append((k + 1, _with(rows[k], taker, put)))
        options += [
            InsertionPlace((giver, taker), begin, end, (row, meeting, next_row))
            for begin, row in before
            for end, next_row in after
        ]
    return options


def _with(row: tuple[int, ...], arm: int, stop: int) -> tuple[int, ...]:
    return (*row[:arm], stop, *row[arm + 1 :])


class Insertions:
    """Insertion of stops into an order."""

    def __init__(self, problem: StageProblem, slots: IntArray, ends: Ends | None) -> None:
        """Compute the values up to every stage, and from there on.

        Args:
            problem: the stage problem.
            slots: the order, shape (n, arms).
            ends: state before and after, if the order is a stretch.
        """
        self._problem, self._ends, self._slots = problem, ends, slots
        self._whole = slots if ends is None else np.concatenate([slots, ends.next_stages])
        # With windows the values depend on time, so that each order is timed as a whole.
        self._plain = problem.not_before is None and problem.not_after is None
        if self._plain:
            self._prepare()

    def _prepare(self) -> None:
        problem, ends, n = self._problem, self._ends, len(self._whole)
        f = len(problem.turn)
        start = None if ends is None else ends.last_stops
        self._last_stops = previous(self._whole[None], problem.stops, start)[0]
        rows = np.arange(n)
        steps: FloatArray = np.full((n, f, f), -np.inf)
        for a, length in enumerate(problem.length):
            steps = np.maximum(steps, length[self._last_stops[rows, a], self._whole[:, a]])
        if problem.pair_cost is not None:
            steps += problem.pair_cost[self._whole[:, 0], self._whole[:, 1]][:, None]
        self._values = np.full((n + 1, f), np.inf)
        self._remaining = np.zeros((n + 1, f))
        if ends is not None:
            self._values[0] = ends.values
        else:
            self._values[0, slice(None) if problem.free_start else 0] = 0.0
        remaining = None if ends is None else ends.remaining
        self._closes = remaining is None
        last = closing(problem, self._last_stops[n][None])[0] if remaining is None else remaining
        self._remaining[n] = last
        for k in range(n):
            self._values[k + 1] = (self._values[k][:, None] + steps[k]).min(axis=0)
        for k in range(n - 1, -1, -1):
            self._remaining[k] = (steps[k] + self._remaining[k + 1]).min(axis=1)

    def totals(self, tries: list[InsertionPlace]) -> FloatArray:
        """Compute the makespans with stops at each of some places [s], shape (b,)."""
        if not self._plain:
            return totals(self._problem, self._orders(tries, self._slots), self._ends)
        n, rows = len(self._whole), [tuple(row) for row in self._whole.tolist()]
        following = self._next_active()
        first = np.array([place.first for place in tries])
        # The inserted stops change the stages up to the next stop of each arm.
        resume = np.array([max(following[a][place.last] for a in place.arms) for place in tries])
        ends = zip(tries, resume, strict=True)
        changed = [(*place.rows, *rows[place.last : u]) for place, u in ends]
        arms = self._whole.shape[1]
        batch = np.full((len(changed), max(map(len, changed)), arms), IDLE, dtype=np.int64)
        for k, stages in enumerate(changed):
            batch[k, : len(stages)] = stages
        stops = self._last_stops[first]
        remaining = self._remaining[resume]
        last = resume == n
        if last.any() and self._closes:
            remaining = remaining.copy()
            after = previous(batch[last], self._problem.stops, stops[last])[:, -1]
            remaining[last] = closing(self._problem, after)
        none = np.zeros((0, arms), dtype=np.int64)
        times = totals(self._problem, batch, Ends(stops, self._values[first], none, remaining))
        if self._problem.stores is None:
            return times
        whole = self._orders(tries, self._whole)
        return times + missing_parts(self._problem, whole, self._ends)

    def _orders(self, tries: list[InsertionPlace], slots: IntArray) -> IntArray:
        """Insert stops at given places, shape (b, stages, arms), padded with IDLE."""
        orders = [place.done(slots) for place in tries]
        batch = np.full((len(orders), max(len(order) for order in orders), slots.shape[1]), IDLE)
        for k, order in enumerate(orders):
            batch[k, : len(order)] = order
        return batch

    def _next_active(self) -> list[list[int]]:
        """List arms' next stops after each stage, or the number of stages."""
        n = len(self._whole)
        stages_by_arm = []
        for a in range(self._whole.shape[1]):
            arm_stages, following = [n] * (n + 1), n
            for k in range(n - 1, -1, -1):
                if self._whole[k, a] != IDLE:
                    following = k + 1
                arm_stages[k] = following
            stages_by_arm.append(arm_stages)
        return stages_by_arm


@dataclass(frozen=True)
class InsertionSettings:
    """Settings of removal and insertion."""

    removed: tuple[int, ...] = (2, 7)
    """Minimum and maximum number of units removed at a time."""
    hot: float = 0.25
    """First temperature of the annealing, relative to the first order's total per unit."""
    cold: float = 0.002
    """Last temperature of the annealing, relative to the first order's total per unit."""
    blink: float = 0.03
    """Fraction of the places that are skipped in an insertion."""
    stretch: int = 12
    """Number of stages of a long order that are improved together."""
    per_stretch: int = 25
    """Number of removals and insertions per stretch of a long order."""


INSERTION = InsertionSettings()


class StageSearch:
    """Ruin and recreate [Schrimpf2000]."""

    def __init__(self, problem: StageProblem, seed: int) -> None:
        """Prepare units, neighbours and precedence."""
        self.problem, self.seed = problem, seed
        self._random = np.random.default_rng(seed)
        self.units = stage_units(problem)
        self._unit_of = {stop: u for u, unit in enumerate(self.units) for stop in unit.stops}
        self._neighbours = near_units(problem, self.units)
        of_task = {t: u for u, unit in enumerate(self.units) for t in unit.tasks}
        self._before: list[set[int]] = [set() for _ in self.units]
        self._after: list[set[int]] = [set() for _ in self.units]
        for earlier, later in problem.before:
            u, v = of_task[earlier], of_task[later]
            if u != v:
                self._before[v].add(u)
                self._after[u].add(v)
        self._inner = np.zeros(problem.stops + 1, dtype=np.bool_)
        for unit in self.units:
            rows = unit.shares(0) if unit.meets else (unit,)
            for row in rows:
                self._inner[list(row.stops[:-1])] = True

    def first(self) -> StageOrder | None:
        """Build an order by insertion, predecessors first, or None."""
        slots = np.full((0, len(self.problem.length)), IDLE, dtype=np.int64)
        order = list(range(len(self.units)))
        if not self.problem.in_file_order:
            order = [order[k] for k in self._random.permutation(len(order))]
        inserted = self.inserted(slots, self._sorted(order), 0.0, None)
        return None if inserted is None else with_angles(self.problem, inserted)

    def improve(
        self,
        start: StageOrder,
        iterations: int,
        better: Callable[[StageOrder], None] = lambda _: None,
        stop: Callable[[], bool] = lambda: False,
    ) -> StageOrder:
        """Anneal an order and return the best one.

        Args:
            start: first order.
            iterations: number of removals and insertions.
            better: receives every new best order, without angles.
            stop: whether to stop early.
        """
        unit_time = start.total / len(self.units) if np.isfinite(start.total) else 1.0
        heat = INSERTION.hot * unit_time, INSERTION.cold * unit_time

        def report(slots: IntArray, total: float) -> None:
            better(StageOrder(slots, np.zeros(0, dtype=np.int64), total))

        first = start.slots, start.total
        slots, _ = self._annealed(first, iterations, heat, None, report, stop)
        return with_angles(self.problem, slots)

    def improve_stretches(
        self,
        start: StageOrder,
        stretches: int,
        better: Callable[[StageOrder], None] = lambda _: None,
        stop: Callable[[], bool] = lambda: False,
    ) -> StageOrder:
        """Improve stretches of a long order one after the other.

        Args:
            start: first order.
            stretches: number of stretches.
            better: receives every new best order.
            stop: whether to stop early.
        """
        slots, total = start.slots, start.total
        unit_time = start.total / len(self.units) if np.isfinite(start.total) else 1.0
        for k in range(stretches):
            if stop():
                break
            values = Stretches(self.problem, slots)
            span = min(len(slots), INSERTION.stretch)
            begin = int(self._random.integers(len(slots) - span + 1))
            ends = values.ends(begin, begin + span)
            stretch = slots[begin : begin + span]
            before = float(totals(self.problem, stretch[None], ends)[0])
            warm = INSERTION.hot * unit_time * (1.0 - k / stretches)
            improved, after = self._annealed(
                (stretch, before),
                INSERTION.per_stretch,
                (warm, INSERTION.cold * unit_time),
                ends,
                lambda *_: None,
                stop,
            )
            if after < before - 1e-9:
                slots = np.concatenate([slots[:begin], improved, slots[begin + span :]])
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
        """Anneal stages with their total [s]; return the best stages and total."""
        best = current = start
        warm, cooling = heat[0], power(heat[1] / max(heat), 1.0 / max(1, iterations))
        for _ in range(iterations):
            warm *= cooling
            if stop():
                break
            remains, removed = self._ruined(current[0])
            if not removed:
                continue
            candidate = self.inserted(remains, self._sorted(removed), INSERTION.blink, ends)
            if candidate is None:
                continue
            total = float(totals(self.problem, candidate[None], ends)[0])
            if total >= current[1] - warm * log(1.0 - self._random.random()):
                continue
            current = candidate, total
            if total < best[1] - 1e-9:
                best = current
                better(*best)
        return best

    def _ruined(self, slots: IntArray) -> tuple[IntArray, list[int]]:
        """Remove some neighbouring units, or some consecutive stages, from an order."""
        count = int(self._random.integers(INSERTION.removed[0], INSERTION.removed[1] + 1))
        present = self._whole(slots)
        if not present:
            return slots, []
        if self._random.random() < 0.5:
            seed = present[int(self._random.integers(len(present)))]
            present_set = set(present)
            neighbours = [u for u in self._neighbours[seed] if u in present_set]
            picked = self._random.permutation(len(neighbours))[: count - 1]
            removed = {seed, *(neighbours[k] for k in picked)}
        else:
            begin = int(self._random.integers(len(slots)))
            stops = slots[begin : begin + (count + 1) // 2].ravel().tolist()
            removed = {self._unit_of[s] for s in stops if s != IDLE} & set(present)
        return self.without(slots, removed), sorted(removed)

    def _whole(self, slots: IntArray) -> list[int]:
        """List the units whose stops are all in some stages."""
        stops = slots[slots != IDLE].tolist()
        count: dict[int, int] = {}
        for stop in stops:
            u = self._unit_of[stop]
            count[u] = count.get(u, 0) + 1
        return sorted(u for u, m in count.items() if m == len(self.units[u].stops))

    def without(self, slots: IntArray, units: set[int]) -> IntArray:
        """Remove units from an order, and stages without any stop left."""
        removed = [stop for u in units for stop in self.units[u].stops]
        remains = np.where(np.isin(slots, removed), IDLE, slots)
        return remains[(remains != IDLE).any(axis=1)]

    def _sorted(self, removed: list[int]) -> list[int]:
        order = [removed[k] for k in self._random.permutation(len(removed))]
        if self.problem.before:
            rank = self._ranks(order)
            order.sort(key=lambda u: rank[u])
        if self.problem.in_file_order:
            order.sort(key=lambda u: self.units[u].tasks[0])
        return order

    def _ranks(self, order: list[int]) -> dict[int, int]:
        """Compute the longest chain of predecessors of each unit."""
        rank = dict.fromkeys(order, 0)
        for _ in order:
            for u in order:
                rank[u] = max([rank[v] + 1 for v in self._before[u] if v in rank], default=0)
        return rank

    def inserted(
        self, slots: IntArray, units: list[int], blink: float, ends: Ends | None
    ) -> IntArray | None:
        """Insert units singly at least makespan; None if a unit has no place."""
        for u in units:
            options = self._places(slots, u, ends)
            if not options:
                return None
            cost = Insertions(self.problem, slots, ends).totals(options)
            if blink and len(options) > 1:
                cost[self._random.random(len(options)) < blink] += 1e6
            k = int(cost.argmin())
            if not np.isfinite(cost[k]):
                return None
            slots = options[k].done(slots)
        return slots

    def _places(self, slots: IntArray, u: int, ends: Ends | None) -> list[InsertionPlace]:
        """List every feasible place of a unit."""
        options = []
        low, high = self._range(slots, u)
        unit = self.units[u]
        for a in unit.arms:
            first, last = self._file_range(slots[:, a], u, low, high)
            if not unit.meets:
                middle = self._middle(slots, a, ends)
                options += places(slots, a, unit.stops, first, last, middle)
                continue
            span = self._file_range(slots[:, 1 - a], u, first, last)
            middles = [self._middle(slots, arm, ends) for arm in range(slots.shape[1])]
            options += meeting_places(slots, a, unit.stops, span, middles)
        return options

    def _middle(self, slots: IntArray, a: int, ends: Ends | None) -> BoolArray:
        """Test whether an arm is in the middle of a unit before each stage."""
        at = IDLE if ends is None else int(ends.last_stops[a])
        middle = [bool(at != IDLE and self._inner[at])]
        for stop in slots[:, a].tolist():
            at = stop if stop != IDLE else at
            middle.append(bool(at != IDLE and self._inner[at]))
        return np.array(middle)

    def _range(self, slots: IntArray, u: int) -> tuple[int, int]:
        """Compute the stages between a unit's predecessors and successors."""
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

    def _file_range(self, column: IntArray, u: int, low: int, high: int) -> tuple[int, int]:
        """Compute the range of stages in which one arm keeps the file's order."""
        if not self.problem.in_file_order:
            return low, high
        first = self.units[u].tasks[0]
        for k, stop in enumerate(column.tolist()):
            if stop == IDLE:
                continue
            if self.units[self._unit_of[stop]].tasks[0] < first:
                low = max(low, k + 1)
            else:
                high = min(high, k)
        return low, high
