"""Good orders of many tasks: pieces of an order are removed and put back where they cost least [Christiaens2020]."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.geometry.elementary import log, power
from dualarm_cli.orders.asynchronous.problem import Order, SequencingProblem
from dualarm_cli.orders.asynchronous.times import Timed, best_options, timed
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class RecreateSettings:
    """Numbers that steer ruin and recreate of asynchronous orders."""

    neighbours: int = 40
    """Maximum number of nearest neighbours of a task that its removal considers."""
    tries: int = 6
    """So often all is begun anew where it leads nowhere."""
    looks: int = 8
    """Remaining units that are tried first where an order is built unit by unit.

    The others are tried where none of these fits.
    """
    removed: float = 8.0
    """Tasks that are removed at a time, on average."""
    longest: int = 10
    """Longest piece that is removed from one arm's order."""
    blink: float = 0.02
    """Share of the places that are overlooked when a task is put back."""
    hot: float = 0.3
    """First annealing temperature, as a fraction of the first order's time per unit."""
    cold: float = 0.001
    """Last annealing temperature, as a fraction of the first order's time per unit."""
    weights: tuple[float, ...] = (0.02, 0.3, 1.0)
    """Weights of the sum of the arms' times against the slower arm's time.

    One of them is drawn for each removal.
    """
    varied: float = 0.3
    """Mean random addition to a place's cost, relative to the mean task time.

    Only in jobs with buffers.
    """
    overlooked: float = 1e6
    """Cost that is added to an overlooked place [s]."""


RECREATE = RecreateSettings()


@dataclass(frozen=True)
class TaskUnit:
    """Tasks that go together: one, or a sequence."""

    tasks: tuple[int, ...]
    """In their order."""
    nodes: tuple[IntArray, ...]
    """By arm the ways to do it, each a row of nodes, shape (ways, tasks)."""
    inside: tuple[FloatArray, ...]
    """By arm the time of each way, transfers between its tasks included [s], infinite where there is none."""


@dataclass(frozen=True)
class UnitNodes:
    """One arm's units in arrays, shape (units, ways) each."""

    first: IntArray
    """First nodes."""
    last: IntArray
    """Last nodes."""
    inside: FloatArray
    """Times [s], infinite where there is no such way."""

    @classmethod
    def of(cls, units: list[TaskUnit], a: int) -> UnitNodes:
        """Returns the arrays of arm a."""
        return cls(
            np.array([unit.nodes[a][:, 0] for unit in units]),
            np.array([unit.nodes[a][:, -1] for unit in units]),
            np.array([unit.inside[a] for unit in units]),
        )


def route_units(problem: SequencingProblem) -> list[TaskUnit]:
    """Returns sequences, and all other tasks by themselves."""
    in_sequence = {t for row in problem.sequences for t in row}
    rows = [*problem.sequences, *((t,) for t in range(problem.tasks) if t not in in_sequence)]
    return [_unit(problem, row) for row in sorted(rows)]


def _unit(problem: SequencingProblem, tasks: tuple[int, ...]) -> TaskUnit:
    w, nodes, inside = problem.options, [], []
    for a in range(len(problem.arms)):
        between, length = problem.between[a], problem.length[a]
        # Every way to begin with; from there on what is quickest by itself.
        value = length[tasks[0] * w : (tasks[0] + 1) * w].copy()
        rows = np.arange(tasks[0] * w, (tasks[0] + 1) * w)[:, None]
        for task in tasks[1:]:
            own = np.arange(task * w, (task + 1) * w)
            total = value[:, None] + between[rows[:, -1][:, None], own] + length[own]
            way = total.argmin(axis=1)
            value = total[np.arange(w), way]
            rows = np.concatenate([rows, own[way][:, None]], axis=1)
        nodes.append(rows)
        inside.append(value)
    return TaskUnit(tasks, tuple(nodes), tuple(inside))


def neighbours(problem: SequencingProblem, units: list[TaskUnit]) -> list[list[int]]:
    """Returns the nearest other units of each, by the least transfer of any arm in the ways that are quickest."""
    n = len(units)
    least = np.full((n, n), np.inf)
    for a in range(len(problem.arms)):
        way = [int(unit.inside[a].argmin()) for unit in units]
        first = np.array([unit.nodes[a][k][0] for unit, k in zip(units, way, strict=True)])
        last = np.array([unit.nodes[a][k][-1] for unit, k in zip(units, way, strict=True)])
        one = problem.between[a][last[:, None], first[None, :]]
        possible = np.array([np.isfinite(unit.inside[a]).any() for unit in units])
        one = np.where(possible[:, None] & possible[None, :], np.minimum(one, one.T), np.inf)
        least = np.minimum(least, one)
    order = np.argsort(least, axis=1, kind="stable")[:, : RECREATE.neighbours + 1]
    return [[int(v) for v in row if v != u] for u, row in enumerate(order)]


def ranks(before: list[set[int]]) -> list[int]:
    """Returns the largest number of units that have to be over one after the other before each."""
    rank = [0] * len(before)
    for _ in before:
        changed = False
        for u, firsts in enumerate(before):
            new = max((rank[v] + 1 for v in firsts), default=0)
            if new > rank[u]:
                rank[u], changed = min(new, len(before)), True
        if not changed:
            break
    return rank


def order_without_deadlock(
    problem: SequencingProblem, units: list[TaskUnit], random: np.random.Generator
) -> Timed | None:
    """Returns an order in which no arm waits forever, None where none was found.

    Units are put behind what is there, where all is over soonest among those for which there are parts and room.

    Args:
        problem: with buffers.
        units: tasks that go together.
        random: for the order in which units are looked at.
    """
    for _ in range(RECREATE.tries):
        found = _tried(problem, units, random)
        if found is not None:
            return found
    return None


def _tried(
    problem: SequencingProblem, units: list[TaskUnit], random: np.random.Generator
) -> Timed | None:
    rows: list[tuple[int, ...]] = [() for _ in problem.arms]
    left = random.permutation(len(units)).tolist()
    if problem.in_file_order:
        left.sort(key=lambda u: units[u].tasks)
    best: Timed | None = None
    while left:
        best = None
        taken = (0, 0)
        for some in (left[: RECREATE.looks], left[RECREATE.looks :]):
            for u in some:
                for a in range(len(rows)):
                    if not _may_be_next(problem, units, left, u, a):
                        continue
                    way = int(units[u].inside[a].argmin())
                    more = tuple(units[u].nodes[a][way].tolist())
                    order = Order(tuple(r + more * (b == a) for b, r in enumerate(rows)))
                    one = timed(problem, order)
                    if np.isfinite(one.total) and (best is None or one.objective < best.objective):
                        best, taken = one, (u, a)
            if best is not None:
                break
        if best is None:
            return None
        rows = list(best.order.nodes)
        left.remove(taken[0])
    return best


def _may_be_next(
    problem: SequencingProblem, units: list[TaskUnit], left: list[int], u: int, a: int
) -> bool:
    """Returns whether an arm can do a unit, and keeps the file's order with it where it has to."""
    if not np.isfinite(units[u].inside[a]).any():
        return False
    if not problem.in_file_order:
        return True
    return u == next(v for v in left if np.isfinite(units[v].inside[a]).any())


class Recreator:
    """Ruin and recreate with simulated annealing on one problem."""

    def __init__(self, problem: SequencingProblem, seed: int) -> None:
        """Prepares units, neighbours and the first order."""
        self.problem = problem
        self._random = np.random.default_rng(seed)
        self._units = route_units(problem)
        self._unit_of = {t: u for u, unit in enumerate(self._units) for t in unit.tasks}
        self._table = [UnitNodes.of(self._units, a) for a in range(len(problem.arms))]
        self._near = neighbours(problem, self._units)
        self._after: list[set[int]] = [set() for _ in self._units]
        self._before: list[set[int]] = [set() for _ in self._units]
        for one, other in problem.before:
            u, v = self._unit_of[one], self._unit_of[other]
            if u != v:
                self._before[v].add(u)
                self._after[u].add(v)
        self._rank = ranks(self._before)
        least = [min(float(i.min()) for i in unit.inside) for unit in self._units]
        self._spread = RECREATE.varied * float(np.mean(least)) if least else 0.0

    def first(self) -> Timed | None:
        """Returns an order by insertion of the longest tasks first, None where none was found.

        Where an arm would wait for a buffer forever, one that is put together task after task.
        """
        routes = [np.zeros((0, 2), dtype=np.int64) for _ in self.problem.arms]
        dear = [-min(float(np.min(one)) for one in unit.inside) for unit in self._units]
        order = sorted(range(len(self._units)), key=lambda u: (self._rank[u], dear[u]))
        found = None
        if self._insert(routes, order, RECREATE.weights[0], 0.0):
            found = self._polished(routes)
        if self.problem.stores is not None and (found is None or found.left):
            found = order_without_deadlock(self.problem, self._units, self._random) or found
        return found

    def improve(
        self,
        start: Timed,
        iterations: int,
        better: Callable[[Timed], None] = lambda _: None,
        stop: Callable[[], bool] = lambda: False,
    ) -> Timed:
        """Returns the best order found from one to begin with.

        Args:
            start: an order.
            iterations: how often something is removed and put back.
            better: receives every new best one.
            stop: whether to stop early.
        """
        best = current = start
        routes = self._routes(start.order)
        scale = start.total / len(self._units) if np.isfinite(start.total) else 1.0
        cooling = power(RECREATE.cold / RECREATE.hot, 1.0 / max(1, iterations))
        heat = RECREATE.hot * scale
        for _ in range(iterations):
            heat *= cooling
            if stop():
                break
            tried = list(routes)
            gone = self._ruin(tried)
            weight = RECREATE.weights[int(self._random.integers(len(RECREATE.weights)))]
            if not self._insert(tried, self._sorted(gone), weight, RECREATE.blink):
                continue
            # Ways that suit the neighbours they were put between need not suit the whole order.
            found = self._polished(tried)
            if found.objective >= current.objective - heat * log(1.0 - self._random.random()):
                continue
            routes, current = self._routes(found.order), found
            if found.objective < best.objective - 1e-12:
                best = found
                if best.is_possible:
                    better(best)
        return best

    def _polished(self, routes: list[IntArray]) -> Timed:
        """Returns routes with the best ways along them."""
        plain = timed(self.problem, self._order(routes))
        if self.problem.options == 1:
            return plain
        tasks = plain.order.tasks(self.problem.options)
        ways = timed(self.problem, best_options(self.problem, tasks))
        return min(plain, ways, key=lambda one: one.objective)

    def _order(self, routes: list[IntArray]) -> Order:
        return Order(
            tuple(
                tuple(int(n) for u, way in route.tolist() for n in self._units[u].nodes[a][way])
                for a, route in enumerate(routes)
            )
        )

    def _routes(self, order: Order) -> list[IntArray]:
        """Returns an order as units, each with the number of its way; ways of sequences may be new ones."""
        routes: list[IntArray] = []
        for a, nodes in enumerate(order.nodes):
            route, k = list[tuple[int, int]](), 0
            while k < len(nodes):
                u = self._unit_of[nodes[k] // self.problem.options]
                unit = self._units[u]
                own = np.array(nodes[k : k + len(unit.tasks)])
                same = np.flatnonzero((unit.nodes[a] == own).all(axis=1))
                route.append((u, int(same[0]) if len(same) else int(unit.inside[a].argmin())))
                k += len(unit.tasks)
            routes.append(np.array(route, dtype=np.int64).reshape(-1, 2))
        return routes

    def _ruin(self, routes: list[IntArray]) -> list[int]:
        """Removes strings of neighbouring units from the routes; returns what was removed."""
        count = len(self._units)
        longest = min(RECREATE.longest, max(1.0, count / max(1, len(routes))))
        strings = int(
            self._random.uniform(1.0, max(1.0, 4.0 * RECREATE.removed / (1.0 + longest) - 1.0) + 1)
        )
        where = {
            u: (a, k) for a, route in enumerate(routes) for k, u in enumerate(route[:, 0].tolist())
        }
        seed = int(self._random.integers(count))
        gone: set[int] = set()
        cut = 0
        for u in (seed, *self._near[seed]):
            if cut >= strings:
                break
            if u in gone:
                continue
            a, k = where[u]
            route = routes[a]
            size = min(int(self._random.uniform(1.0, longest + 1.0)), len(route))
            low = max(0, k - size + 1)
            begin = int(self._random.integers(low, min(k, len(route) - size) + 1))
            gone.update(route[begin : begin + size, 0].tolist())
            cut += 1
        left = np.ones(count, dtype=np.bool_)
        left[list(gone)] = False
        for a, route in enumerate(routes):
            routes[a] = route[left[route[:, 0]]]
        return sorted(gone)

    def _sorted(self, gone: list[int]) -> list[int]:
        """Returns units in the order in which they are put back: at random, or those first that take longest."""
        kind = self._random.random()
        keys = self._random.random(len(gone))
        if kind < 0.3:
            keys = np.array([-min(float(i.min()) for i in self._units[u].inside) for u in gone])
        order = [gone[k] for k in np.argsort(keys, kind="stable")]
        if self.problem.before:
            order.sort(key=lambda u: self._rank[u])
        return order

    def _insert(
        self, routes: list[IntArray], units: list[int], weight: float, blink: float
    ) -> bool:
        """Puts units back one after the other where they cost least; returns whether each has a place."""
        own = [self._own(a, route) for a, route in enumerate(routes)]
        for u in units:
            best: tuple[float, int, int, int, float] | None = None
            for a, route in enumerate(routes):
                if not np.isfinite(self._units[u].inside[a]).any():
                    continue
                low, high = self._range(u, route)
                if low > high:
                    continue
                delta, way = self._deltas(a, route, u, low, high)
                if blink and self.problem.stores is not None:
                    # What is waited for is not priced here: places that look dearer are tried as well.
                    delta += self._random.exponential(self._spread, len(delta))
                if blink and len(delta) > 1:
                    delta[self._random.random(len(delta)) < blink] += RECREATE.overlooked
                k = int(delta.argmin())
                cost = float(delta[k])
                others = max((t for b, t in enumerate(own) if b != a), default=0.0)
                score = max(own[a] + cost, others) + weight * cost
                if np.isfinite(score) and (best is None or score < best[0]):
                    best = score, a, low + k, int(way[k]), cost
            if best is None:
                return False
            _, a, k, chosen, cost = best
            if cost > 0.5 * RECREATE.overlooked:
                return False
            routes[a] = np.insert(routes[a], k, (u, chosen), axis=0)
            own[a] += cost
        return True

    def _own(self, a: int, route: IntArray) -> float:
        """Returns the time of one arm's route [s]."""
        if not len(route):
            return 0.0
        start, table = self.problem.start_node, self._table[a]
        u, way = route.T
        came = np.append(start, table.last[u, way])
        goes = np.append(table.first[u, way], start)
        return float(self.problem.between[a][came, goes].sum() + table.inside[u, way].sum())

    def _deltas(
        self, a: int, route: IntArray, u: int, low: int, high: int
    ) -> tuple[FloatArray, IntArray]:
        """Returns what putting a unit at each place from low to high costs [s], and the way to do it there."""
        start, between, table = self.problem.start_node, self.problem.between[a], self._table[a]
        came = goes = np.array([start])
        if len(route):
            v, ways = route.T
            came = np.append(start, table.last[v, ways])[low : high + 1]
            goes = np.append(table.first[v, ways], start)[low : high + 1]
        cost = between[came[:, None], table.first[u]] + between[table.last[u], goes[:, None]]
        cost = cost + table.inside[u]
        way = cost.argmin(axis=1)
        gone = between[came, goes] if len(route) else 0.0
        return cost[np.arange(len(way)), way] - gone, way

    def _range(self, u: int, route: IntArray) -> tuple[int, int]:
        """Returns the first and the last place at which a unit keeps all rules on one arm; the last first for none."""
        low, high = 0, len(route)
        if self.problem.in_file_order:
            first = self._units[u].tasks[0]
            low = high = sum(self._units[v].tasks[0] < first for v in route[:, 0].tolist())
        if self._before[u] or self._after[u]:
            for k, v in enumerate(route[:, 0].tolist()):
                if v in self._before[u]:
                    low = max(low, k + 1)
                elif v in self._after[u]:
                    high = min(high, k)
        return low, high
