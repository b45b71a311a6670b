"""Ruin and recreate of many tasks: removals, and insertions at least cost [Christiaens2020]."""

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
    """Maximum number of attempts to build an order without deadlock."""
    looks: int = 8
    """Number of remaining units tried first, when building orders unit by unit.

    The others are tried if none of these fits.
    """
    removed: float = 8.0
    """Mean number of tasks removed per step."""
    longest: int = 10
    """Maximum length of a string of tasks that is removed from one arm's order."""
    blink: float = 0.02
    """Fraction of the places that are skipped in an insertion."""
    hot: float = 0.3
    """First annealing temperature, as a fraction of the first order's time per unit."""
    cold: float = 0.001
    """Last annealing temperature, as a fraction of the first order's time per unit."""
    weights: tuple[float, ...] = (0.02, 0.3, 1.0)
    """Weights of the sum of the arms' times against the makespan.

    A weight is drawn for each removal.
    """
    varied: float = 0.3
    """Mean random addition to a place's cost, relative to mean task time.

    Only in jobs with buffers.
    """
    overlooked: float = 1e6
    """Cost that is added to a skipped place [s]."""


RECREATE = RecreateSettings()


@dataclass(frozen=True)
class TaskUnit:
    """Tasks that stay together: a single task or a sequence."""

    tasks: tuple[int, ...]
    """Tasks in their order."""
    nodes: tuple[IntArray, ...]
    """Options of each arm, each a row of nodes, shape (options, tasks)."""
    inside: tuple[FloatArray, ...]
    """Times of options by arm with inner transfers [s], infinite if infeasible.

    An inner transfer is one between the tasks of an option.
    """


@dataclass(frozen=True)
class UnitNodes:
    """Units of one arm as arrays, shape (units, options) each."""

    first: IntArray
    """First nodes."""
    last: IntArray
    """Last nodes."""
    inside: FloatArray
    """Times [s]; infinite if infeasible."""

    @classmethod
    def of(cls, units: list[TaskUnit], a: int) -> UnitNodes:
        """Build the arrays of arm a."""
        return cls(
            np.array([unit.nodes[a][:, 0] for unit in units]),
            np.array([unit.nodes[a][:, -1] for unit in units]),
            np.array([unit.inside[a] for unit in units]),
        )


def route_units(problem: SequencingProblem) -> list[TaskUnit]:
    """List sequences, and all other tasks as single units."""
    in_sequence = {t for row in problem.sequences for t in row}
    rows = [*problem.sequences, *((t,) for t in range(problem.tasks) if t not in in_sequence)]
    return [_unit(problem, row) for row in sorted(rows)]


def _unit(problem: SequencingProblem, tasks: tuple[int, ...]) -> TaskUnit:
    w, nodes, inside = problem.options, [], []
    for a in range(len(problem.arms)):
        between, length = problem.between[a], problem.length[a]
        # Every option of the first task, each continued greedily.
        value = length[tasks[0] * w : (tasks[0] + 1) * w].copy()
        rows = np.arange(tasks[0] * w, (tasks[0] + 1) * w)[:, None]
        for task in tasks[1:]:
            columns = np.arange(task * w, (task + 1) * w)
            total = value[:, None] + between[rows[:, -1][:, None], columns] + length[columns]
            choice = total.argmin(axis=1)
            value = total[np.arange(w), choice]
            rows = np.concatenate([rows, columns[choice][:, None]], axis=1)
        nodes.append(rows)
        inside.append(value)
    return TaskUnit(tasks, tuple(nodes), tuple(inside))


def neighbours(problem: SequencingProblem, units: list[TaskUnit]) -> list[list[int]]:
    """Rank the nearest units of each unit by the shortest transfer of any arm.

    The options are those that take least time by themselves.
    """
    n = len(units)
    least = np.full((n, n), np.inf)
    for a in range(len(problem.arms)):
        options = [int(unit.inside[a].argmin()) for unit in units]
        first = np.array([unit.nodes[a][k][0] for unit, k in zip(units, options, strict=True)])
        last = np.array([unit.nodes[a][k][-1] for unit, k in zip(units, options, strict=True)])
        transfers = problem.between[a][last[:, None], first[None, :]]
        possible = np.array([np.isfinite(unit.inside[a]).any() for unit in units])
        transfers = np.where(
            possible[:, None] & possible[None, :], np.minimum(transfers, transfers.T), np.inf
        )
        least = np.minimum(least, transfers)
    order = np.argsort(least, axis=1, kind="stable")[:, : RECREATE.neighbours + 1]
    return [[int(v) for v in row if v != u] for u, row in enumerate(order)]


def ranks(predecessors: list[set[int]]) -> list[int]:
    """Compute the longest chain of predecessors of each unit."""
    rank = [0] * len(predecessors)
    for _ in predecessors:
        changed = False
        for u, earlier in enumerate(predecessors):
            new = max((rank[v] + 1 for v in earlier), default=0)
            if new > rank[u]:
                rank[u], changed = min(new, len(predecessors)), True
        if not changed:
            break
    return rank


def order_without_deadlock(
    problem: SequencingProblem, units: list[TaskUnit], random: np.random.Generator
) -> Timed | None:
    """Build an order without deadlock, or None if none was found.

    Units are appended one by one: of those with available parts and room the one with the least makespan.

    Args:
        problem: with buffers.
        units: tasks that stay together.
        random: generator that permutes the units.
    """
    for _ in range(RECREATE.tries):
        order = _greedy_order(problem, units, random)
        if order is not None:
            return order
    return None


def _greedy_order(
    problem: SequencingProblem, units: list[TaskUnit], random: np.random.Generator
) -> Timed | None:
    rows: list[tuple[int, ...]] = [() for _ in problem.arms]
    remaining = random.permutation(len(units)).tolist()
    if problem.in_file_order:
        remaining.sort(key=lambda u: units[u].tasks)
    best: Timed | None = None
    while remaining:
        best = None
        taken = (0, 0)
        for batch in (remaining[: RECREATE.looks], remaining[RECREATE.looks :]):
            for u in batch:
                for a in range(len(rows)):
                    if not _may_be_next(problem, units, remaining, u, a):
                        continue
                    option = int(units[u].inside[a].argmin())
                    nodes = tuple(units[u].nodes[a][option].tolist())
                    order = Order(tuple(r + nodes * (b == a) for b, r in enumerate(rows)))
                    candidate = timed(problem, order)
                    if np.isfinite(candidate.total) and (
                        best is None or candidate.objective < best.objective
                    ):
                        best, taken = candidate, (u, a)
            if best is not None:
                break
        if best is None:
            return None
        rows = list(best.order.nodes)
        remaining.remove(taken[0])
    return best


def _may_be_next(
    problem: SequencingProblem, units: list[TaskUnit], remaining: list[int], u: int, a: int
) -> bool:
    """Test whether an arm can do a unit next, also in the file's order."""
    if not np.isfinite(units[u].inside[a]).any():
        return False
    if not problem.in_file_order:
        return True
    return u == next(v for v in remaining if np.isfinite(units[v].inside[a]).any())


class Recreator:
    """Ruin and recreate with simulated annealing."""

    def __init__(self, problem: SequencingProblem, seed: int) -> None:
        """Prepare units, neighbours and precedence."""
        self.problem = problem
        self._random = np.random.default_rng(seed)
        self._units = route_units(problem)
        self._unit_of = {t: u for u, unit in enumerate(self._units) for t in unit.tasks}
        self._table = [UnitNodes.of(self._units, a) for a in range(len(problem.arms))]
        self._neighbours = neighbours(problem, self._units)
        self._after: list[set[int]] = [set() for _ in self._units]
        self._before: list[set[int]] = [set() for _ in self._units]
        for earlier, later in problem.before:
            u, v = self._unit_of[earlier], self._unit_of[later]
            if u != v:
                self._before[v].add(u)
                self._after[u].add(v)
        self._rank = ranks(self._before)
        least = [min(float(i.min()) for i in unit.inside) for unit in self._units]
        self._spread = RECREATE.varied * float(np.mean(least)) if least else 0.0

    def first(self) -> Timed | None:
        """Build a first order by insertion of the longest tasks first, or None.

        In jobs with buffers, an order without deadlock is built unit by unit if the insertion ends in a deadlock.
        """
        routes = [np.zeros((0, 2), dtype=np.int64) for _ in self.problem.arms]
        negative_times = [
            -min(float(np.min(times)) for times in unit.inside) for unit in self._units
        ]
        order = sorted(range(len(self._units)), key=lambda u: (self._rank[u], negative_times[u]))
        timed_order = None
        if self._insert(routes, order, RECREATE.weights[0], 0.0):
            timed_order = self._polished(routes)
        if self.problem.stores is not None and (timed_order is None or timed_order.left):
            timed_order = (
                order_without_deadlock(self.problem, self._units, self._random) or timed_order
            )
        return timed_order

    def improve(
        self,
        start: Timed,
        iterations: int,
        better: Callable[[Timed], None] = lambda _: None,
        stop: Callable[[], bool] = lambda: False,
    ) -> Timed:
        """Anneal an order and return the best one.

        Args:
            start: first order.
            iterations: number of removals and insertions.
            better: receives every new best order.
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
            candidate = list(routes)
            removed = self._ruin(candidate)
            weight = RECREATE.weights[int(self._random.integers(len(RECREATE.weights)))]
            if not self._insert(candidate, self._sorted(removed), weight, RECREATE.blink):
                continue
            # Options that were best at insertion may not be best in the whole order.
            timed_order = self._polished(candidate)
            if timed_order.objective >= current.objective - heat * log(1.0 - self._random.random()):
                continue
            routes, current = self._routes(timed_order.order), timed_order
            if timed_order.objective < best.objective - 1e-12:
                best = timed_order
                if best.is_possible:
                    better(best)
        return best

    def _polished(self, routes: list[IntArray]) -> Timed:
        """Time routes with their best options."""
        unrefined = timed(self.problem, self._order(routes))
        if self.problem.options == 1:
            return unrefined
        tasks = unrefined.order.tasks(self.problem.options)
        refined = timed(self.problem, best_options(self.problem, tasks))
        return min(unrefined, refined, key=lambda order: order.objective)

    def _order(self, routes: list[IntArray]) -> Order:
        return Order(
            tuple(
                tuple(
                    int(n) for u, option in route.tolist() for n in self._units[u].nodes[a][option]
                )
                for a, route in enumerate(routes)
            )
        )

    def _routes(self, order: Order) -> list[IntArray]:
        """Convert an order to units with the numbers of their options.

        An option of a sequence that is not listed is replaced by the shortest one.
        """
        routes: list[IntArray] = []
        for a, nodes in enumerate(order.nodes):
            route, k = list[tuple[int, int]](), 0
            while k < len(nodes):
                u = self._unit_of[nodes[k] // self.problem.options]
                unit = self._units[u]
                unit_nodes = np.array(nodes[k : k + len(unit.tasks)])
                same = np.flatnonzero((unit.nodes[a] == unit_nodes).all(axis=1))
                route.append((u, int(same[0]) if len(same) else int(unit.inside[a].argmin())))
                k += len(unit.tasks)
            routes.append(np.array(route, dtype=np.int64).reshape(-1, 2))
        return routes

    def _ruin(self, routes: list[IntArray]) -> list[int]:
        """Remove strings of neighbouring units from the routes, and return the units."""
        count = len(self._units)
        longest = min(RECREATE.longest, max(1.0, count / max(1, len(routes))))
        strings = int(
            self._random.uniform(1.0, max(1.0, 4.0 * RECREATE.removed / (1.0 + longest) - 1.0) + 1)
        )
        positions = {
            u: (a, k) for a, route in enumerate(routes) for k, u in enumerate(route[:, 0].tolist())
        }
        seed = int(self._random.integers(count))
        removed: set[int] = set()
        cut = 0
        for u in (seed, *self._neighbours[seed]):
            if cut >= strings:
                break
            if u in removed:
                continue
            a, k = positions[u]
            route = routes[a]
            size = min(int(self._random.uniform(1.0, longest + 1.0)), len(route))
            low = max(0, k - size + 1)
            begin = int(self._random.integers(low, min(k, len(route) - size) + 1))
            removed.update(route[begin : begin + size, 0].tolist())
            cut += 1
        remains = np.ones(count, dtype=np.bool_)
        remains[list(removed)] = False
        for a, route in enumerate(routes):
            routes[a] = route[remains[route[:, 0]]]
        return sorted(removed)

    def _sorted(self, removed: list[int]) -> list[int]:
        """Shuffle units for insertion, or sort the longest first."""
        kind = self._random.random()
        keys = self._random.random(len(removed))
        if kind < 0.3:
            keys = np.array([-min(float(i.min()) for i in self._units[u].inside) for u in removed])
        order = [removed[k] for k in np.argsort(keys, kind="stable")]
        if self.problem.before:
            order.sort(key=lambda u: self._rank[u])
        return order

    def _insert(
        self, routes: list[IntArray], units: list[int], weight: float, blink: float
    ) -> bool:
        """Insert units singly at least cost.

        Returns whether each has a place.
        """
        times = [self._route_time(a, route) for a, route in enumerate(routes)]
        for u in units:
            best: tuple[float, int, int, int, float] | None = None
            for a, route in enumerate(routes):
                if not np.isfinite(self._units[u].inside[a]).any():
                    continue
                low, high = self._range(u, route)
                if low > high:
                    continue
                delta, options = self._deltas(a, route, u, low, high)
                if blink and self.problem.stores is not None:
                    # The cost ignores waits for buffers, so more expensive places are tried as well.
                    delta += self._random.exponential(self._spread, len(delta))
                if blink and len(delta) > 1:
                    delta[self._random.random(len(delta)) < blink] += RECREATE.overlooked
                k = int(delta.argmin())
                cost = float(delta[k])
                others = max((t for b, t in enumerate(times) if b != a), default=0.0)
                score = max(times[a] + cost, others) + weight * cost
                if np.isfinite(score) and (best is None or score < best[0]):
                    best = score, a, low + k, int(options[k]), cost
            if best is None:
                return False
            _, a, k, chosen, cost = best
            if cost > 0.5 * RECREATE.overlooked:
                return False
            routes[a] = np.insert(routes[a], k, (u, chosen), axis=0)
            times[a] += cost
        return True

    def _route_time(self, a: int, route: IntArray) -> float:
        """Compute the time of one arm's route [s]."""
        if not len(route):
            return 0.0
        start, table = self.problem.start_node, self._table[a]
        u, option = route.T
        sources = np.append(start, table.last[u, option])
        targets = np.append(table.first[u, option], start)
        return float(
            self.problem.between[a][sources, targets].sum() + table.inside[u, option].sum()
        )

    def _deltas(
        self, a: int, route: IntArray, u: int, low: int, high: int
    ) -> tuple[FloatArray, IntArray]:
        """Compute a unit's least insertion cost at each place [s], with its option."""
        start, between, table = self.problem.start_node, self.problem.between[a], self._table[a]
        sources = targets = np.array([start])
        if len(route):
            v, options = route.T
            sources = np.append(start, table.last[v, options])[low : high + 1]
            targets = np.append(table.first[v, options], start)[low : high + 1]
        cost = between[sources[:, None], table.first[u]] + between[table.last[u], targets[:, None]]
        cost = cost + table.inside[u]
        choice = cost.argmin(axis=1)
        removed = between[sources, targets] if len(route) else 0.0
        return cost[np.arange(len(choice)), choice] - removed, choice

    def _range(self, u: int, route: IntArray) -> tuple[int, int]:
        """Compute the first and last feasible place of a unit on an arm.

        The last place is before the first one if there is none.
        """
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
