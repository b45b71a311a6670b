"""Good orders of stages: tasks are removed and put back into the stage where all is then done soonest."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, IntArray
from dualarm_cli.sequencing.stage_insertion import Insertions, Place, meeting_places, places
from dualarm_cli.sequencing.stage_problem import IDLE, StageOrder, StageProblem
from dualarm_cli.sequencing.stage_times import Ends, Stretches, totals, with_angles
from dualarm_cli.sequencing.stage_units import near_units, stage_units

REMOVED = (2, 7)
"""Fewest and most units that are removed at a time."""
HOT, COLD = 0.25, 0.002
"""First and last temperature of the annealing, in shares of a unit's mean share of the first order's total."""
BLINK = 0.03
"""Share of the places that are overlooked when a unit is put back."""
STRETCH = 12
"""Stages of a long order that are improved together."""
PER_STRETCH = 25
"""How often something is removed and put back in each."""


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
            better: is told every new best one; its angles are left out.
            stop: whether to stop early.
        """
        share = start.total / len(self.units) if np.isfinite(start.total) else 1.0
        heat = HOT * share, COLD * share

        def found(slots: IntArray, total: float) -> None:
            better(StageOrder(slots, np.zeros(0, dtype=np.int64), total))

        slots, _ = self._annealed(start.slots, start.total, iterations, heat, None, found, stop)
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
            better: is told every new best one.
            stop: whether to stop early.
        """
        slots, total = start.slots, start.total
        share = start.total / len(self.units) if np.isfinite(start.total) else 1.0
        for k in range(stretches):
            if stop():
                break
            values = Stretches(self.problem, slots)
            span = min(len(slots), STRETCH)
            begin = int(self._random.integers(len(slots) - span + 1))
            ends = values.ends(begin, begin + span)
            own = slots[begin : begin + span]
            before = float(totals(self.problem, own[None], ends)[0])
            warm = HOT * share * (1.0 - k / stretches)
            found, after = self._annealed(
                own, before, PER_STRETCH, (warm, COLD * share), ends, lambda *_: None, stop
            )
            if after < before - 1e-9:
                slots = np.concatenate([slots[:begin], found, slots[begin + span :]])
                total = after
                better(StageOrder(slots, np.zeros(0, dtype=np.int64), total))
        return with_angles(self.problem, slots)

    def _annealed(
        self,
        slots: IntArray,
        total: float,
        iterations: int,
        heat: tuple[float, float],
        ends: Ends | None,
        better: Callable[[IntArray, float], None],
        stop: Callable[[], bool],
    ) -> tuple[IntArray, float]:
        """Returns the best stages found, and their total."""
        best, current = (slots, total), (slots, total)
        warm, cooling = heat[0], (heat[1] / max(heat)) ** (1.0 / max(1, iterations))
        for _ in range(iterations):
            warm *= cooling
            if stop():
                break
            left, gone = self._ruined(current[0])
            tried = self.inserted(left, self._sorted(gone), BLINK, ends) if gone else None
            if tried is None:
                continue
            found = float(totals(self.problem, tried[None], ends)[0])
            if found >= current[1] - warm * np.log(1.0 - self._random.random()):
                continue
            current = tried, found
            if found < best[1] - 1e-9:
                best = current
                better(*best)
        return best

    def _ruined(self, slots: IntArray) -> tuple[IntArray, list[int]]:
        """Returns an order without some units that are near to one another, or stages that follow one another."""
        count = int(self._random.integers(REMOVED[0], REMOVED[1] + 1))
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

    def _places(self, slots: IntArray, u: int, ends: Ends | None) -> list[Place]:
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
        at = IDLE if ends is None else int(ends.came[a])
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
