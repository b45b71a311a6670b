"""Search for the best stage orders: enumeration, or ruin and recreate.

Few tasks are enumerated; ruin and recreate begins with several orders.

Orders of many stages without rules are improved by simulated annealing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from dualarm_cli.compiled.stage_annealing import (
    AnnealedOrder,
    AnnealedTasks,
    AnnealingSettings,
    PairedStageTimes,
    anneal_stages,
)
from dualarm_cli.effort import StageEffort
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.geometry.elementary import power
from dualarm_cli.orders.paired.exact import FEW, FEW_WITH_BUFFERS, best_of_all, side_by_side
from dualarm_cli.orders.paired.problem import (
    IDLE,
    StageOrder,
    StageProblem,
    StopUnit,
    split_pairs,
    stage_units,
)
from dualarm_cli.orders.paired.search import StageSearch
from dualarm_cli.orders.paired.times import with_angles
from dualarm_cli.records import dataclass


def nearest_stages(problem: StageProblem) -> IntArray | None:
    """Build stages of two arms greedily by nearest neighbour; None in a dead end.

    In each stage one arm takes its nearest stop, and the other one the nearest remaining stop that it can make at the
    same time. Of both choices of the first arm and all platform angles the shortest stage is taken; among equals that
    with the least sum of both times. An arm that has picked places next.
    """
    last_stops, at = [problem.stops, problem.stops], 0
    due: list[tuple[int, ...]] = [(), ()]
    remaining = [tuple(task) for task in problem.tasks]
    rows: list[tuple[int, ...]] = []
    while remaining or any(due):
        options: list[tuple[float, float, int, tuple[int, ...]]] = []
        candidates = [_candidates(remaining, due[a]) for a in range(2)]
        for first in range(2):
            options += _stages(problem, last_stops, at, candidates, first)
        if not options:
            return None
        _, _, at, row = min(options)
        for a, stop in enumerate(row):
            if stop == IDLE:
                continue
            last_stops[a] = stop
            task = due[a] or next(task for task in remaining if task[0] == stop)
            remaining = [task for task in remaining if task[0] != stop]
            due[a] = task[1:]
        rows.append(row)
    return np.array(rows, dtype=np.int64)


def _candidates(remaining: list[tuple[int, ...]], due: tuple[int, ...]) -> IntArray:
    stops = [due[0]] if due else [task[0] for task in remaining]
    return np.array(stops, dtype=np.int64)


def _stages(
    problem: StageProblem, last: list[int], at: int, choices: list[IntArray], first: int
) -> list[tuple[float, float, int, tuple[int, ...]]]:
    """List each angle's best stage, given the arm that chooses first.

    Entries are rating, sum, angle and stops.
    """
    second, stages = 1 - first, []
    for g in range(len(problem.turn)):
        times = problem.length[first][last[first], choices[first], at, g]
        if not np.isfinite(times).any():
            continue
        k = int(times.argmin())
        stop, time = int(choices[first][k]), float(times[k])
        others = choices[second][choices[second] != stop]
        lengths: FloatArray = np.array(problem.length[second][last[second], others, at, g])
        if problem.pair_cost is not None:
            pair = (stop, others) if first == 0 else (others, stop)
            lengths = lengths + problem.pair_cost[(*pair, g)]
        row = [IDLE, IDLE]
        row[first] = stop
        if len(others) and np.isfinite(lengths).any():
            m = int(lengths.argmin())
            row[second] = int(others[m])
            # Stages are rated by time per stop, which favours stages of both arms.
            second_time = float(lengths[m])
            stages.append((0.5 * max(time, second_time), time + second_time, g, tuple(row)))
        else:
            stages.append((time, time, g, tuple(row)))
    return stages


@dataclass(frozen=True)
class StageSearchSettings:
    """Settings of the search for orders of stages."""

    near: float = 0.02
    """Largest relative excess of near-optimal orders over the best one."""
    many: int = 100
    """Number of units above which insertion makes no first order.

    It is still made if no simpler order is feasible.
    """
    first_tries: int = 6
    """Maximum number of insertions that are tried for a first feasible order."""
    hot: float = 0.06
    """First temperature of annealing, as a share of a stage's mean length."""
    cold: float = 0.0015
    """Last temperature of annealing, as a share of a stage's mean length."""
    nearest_tasks: int = 24
    """Maximum number of near tasks of a task."""
    refreshed: int = 20
    """Number of annealing rounds after which all platform angles are chosen again."""


SEARCH = StageSearchSettings()


class NearOptimalOrders:
    """Collection of different near-optimal orders."""

    def __init__(self, most: int) -> None:
        """Limit the number of orders."""
        self._most = most
        self._kept: dict[bytes, StageOrder] = {}

    def add(self, order: StageOrder) -> None:
        """Add an order; of too many orders the longest one is dropped."""
        if not self._most:
            return
        self._kept.setdefault(order.slots.tobytes(), order)
        if len(self._kept) > self._most:
            del self._kept[max(self._kept, key=lambda key: self._kept[key].total)]

    def of(self, best: float) -> list[StageOrder]:
        """Select the orders within the relative excess `near` of the best one."""
        return [order for order in self._kept.values() if order.total < (1.0 + SEARCH.near) * best]


def is_few(problem: StageProblem) -> bool:
    """Test whether all orders are timed."""
    few = FEW if problem.stores is None else FEW_WITH_BUFFERS
    return len(problem.tasks) <= few and not problem.handovers


def good_orders(
    problem: StageProblem,
    effort: StageEffort,
    seed: int,
    start: IntArray | None = None,
    better: Callable[[float], None] = lambda _: None,
    stop: Callable[[], bool] = lambda: False,
) -> list[StageOrder]:
    """Compute the best order of few tasks, or search orders of more.

    Of few tasks the k-th stops of both arms are in one stage.
    """
    if is_few(problem) and start is None:
        best = best_of_all(problem, better, stop)
        return [] if best is None else [best]
    return searched_orders(problem, effort, seed, start, better, stop)


def searched_orders(
    problem: StageProblem,
    effort: StageEffort,
    seed: int,
    start: IntArray | None,
    better: Callable[[float], None],
    stop: Callable[[], bool],
) -> list[StageOrder]:
    """Search different orders, best first; empty if none is feasible.

    Ruin and recreate from the order of the tasks' numbers, and from others.

    Args:
        problem: the stage problem.
        effort: limits of the search.
        seed: random seed.
        start: known good order, shape (n, arms), or None.
        better: receives the total of every better order [s].
        stop: whether to stop early; one order is made in any case.
    """
    orders: list[StageOrder] = []

    def report(order: StageOrder) -> None:
        if _has_all_parts(problem, order):
            better(order.total)

    for k in range(effort.starts):
        if orders and stop():
            break
        search = StageSearch(problem, seed + k)
        first = _first(search, start if k == 0 else None, in_order=k == 0)
        if first is None:
            continue
        report(first)
        if effort.rounds and is_supported(problem) and np.isfinite(first.total):
            orders += _annealed(search, first, effort, report, stop, is_good=start is not None)
            break
        steps = max(effort.least_steps, effort.steps // len(first.slots))
        improved = search.improve(first, steps, report, stop)
        if len(improved.slots) > effort.whole:
            count = round(effort.stretches * len(improved.slots))
            improved = search.improve_stretches(improved, count, report, stop)
        orders.append(improved)
        if len(improved.slots) > effort.whole:
            break
    given = in_file_order(problem, stage_units(problem))
    if given is not None and start is None:
        # The file's order is a candidate as well: its plan may be the quickest.
        file_order = with_angles(problem, given)
        orders += [file_order] if np.isfinite(file_order.total) else []
    return different_orders([order for order in orders if _has_all_parts(problem, order)])


def short_search(problem: StageProblem, effort: StageEffort, seed: int) -> float | None:
    """Compute the total of an order by a short search [s], or None."""
    search = StageSearch(problem, seed)
    first = _first(search, None, in_order=True)
    if first is None:
        return None
    improve = search.improve if len(first.slots) <= effort.whole else search.improve_stretches
    return improve(first, effort.short_steps).total


def different_orders(orders: Sequence[StageOrder]) -> list[StageOrder]:
    """Remove duplicate orders and sort the others, best first."""
    distinct: dict[bytes, StageOrder] = {}
    for order in sorted(orders, key=lambda order: order.total):
        distinct.setdefault(order.slots.tobytes(), order)
    return list(distinct.values())


def _annealed(
    search: StageSearch,
    first: StageOrder,
    effort: StageEffort,
    report: Callable[[StageOrder], None],
    stop: Callable[[], bool],
    *,
    is_good: bool,
) -> list[StageOrder]:
    """Search the best orders by annealing; `is_good` shortens it for a good first order."""
    problem, order = search.problem, first
    if len(first.slots) <= effort.whole:
        # Annealing exchanges stops but does not merge stages, so idle arms get tasks by insertion first.
        order = search.improve(first, effort.least_steps, report, stop)
    fraction = min(
        effort.most_share, max(effort.least_share, len(first.slots) / effort.full_stages)
    )
    rounds = round(effort.rounds * fraction)
    annealing = StageAnnealing(problem, search.seed)
    if is_good:
        return [
            annealing.improve(order, round(effort.warm_share * rounds), report, stop, effort.warm)
        ]
    # A slow cooling finds nothing while hot. Quick coolings before it provide results for an early end.
    coolings = [rounds]
    while coolings[0] >= effort.cooling_ratio * effort.least_rounds:
        coolings.insert(0, coolings[0] // effort.cooling_ratio)
    for count in coolings[:-1]:
        if stop():
            return [order]
        order = annealing.improve(order, count, report, stop)
    orders = [order]
    coolings_count = effort.coolings * min(1.0, effort.whole / len(order.slots))
    for k in range(max(1, round(coolings_count))):
        if stop():
            break
        near_optimal = NearOptimalOrders(effort.near)
        annealing = annealing if k == 0 else StageAnnealing(problem, search.seed + k)
        best = annealing.improve(order, rounds, report, stop, met=near_optimal.add)
        orders += [best, *near_optimal.of(best.total)]
    return orders


def _has_all_parts(problem: StageProblem, order: StageOrder) -> bool:
    """Test whether no part is missing and no buffer overflows."""
    return problem.stores is None or problem.stores.missing(order.slots[None])[0] == 0.0


def _first(search: StageSearch, start: IntArray | None, *, in_order: bool) -> StageOrder | None:
    """Select the best first order, or None if none is feasible."""
    if start is not None:
        return with_angles(search.problem, start)
    trials: list[StageOrder] = []
    for heuristic in (in_file_order, by_suited_arms, by_nearest) if in_order else ():
        given = heuristic(search.problem, search.units)
        if given is not None:
            trials.append(with_angles(search.problem, never_touching(search.problem, given)))
    # For many units insertion takes long, and is no better after the improvement.
    enough = len(search.units) > SEARCH.many and any(np.isfinite(order.total) for order in trials)
    for _ in range(0 if enough else SEARCH.first_tries):
        first = search.first()
        if first is not None:
            trials.append(first)
        if any(np.isfinite(order.total) for order in trials):
            break
    feasible = [order for order in trials if np.isfinite(order.total)]
    return min(feasible, key=lambda order: order.total) if feasible else None


def in_file_order(problem: StageProblem, units: list[StopUnit]) -> IntArray | None:
    """Build stages in file order, open tasks by the less busy arm.

    That arm has fewer stops so far.

    None if that violates a rule.
    """
    rows: list[list[StopUnit]] = [[] for _ in problem.length]
    stops = [0] * len(rows)
    for unit in sorted(units, key=lambda unit: unit.tasks):
        if not unit.arms:
            return None
        a = min(unit.arms, key=lambda a: (stops[a], a))
        _append(rows, unit, a)
        stops[a] += len(unit.stops)
    return side_by_side(problem, rows)


def by_suited_arms(problem: StageProblem, units: list[StopUnit]) -> IntArray | None:
    """Build stages in the file's order, each task by the arm nearest from home.

    None if that violates a rule.
    """
    rows: list[list[StopUnit]] = [[] for _ in problem.length]
    for unit in sorted(units, key=lambda unit: unit.tasks):
        if not unit.arms:
            return None
        soonest = {a: problem.length[a][problem.stops, unit.stops[0]].min() for a in unit.arms}
        _append(rows, unit, min(soonest, key=lambda a: (soonest[a], a)))
    return side_by_side(problem, rows)


def by_nearest(problem: StageProblem, _units: list[StopUnit]) -> IntArray | None:
    """Build stages by nearest neighbour; None for problems with rules, which it ignores."""
    windows = problem.not_before is not None or problem.not_after is not None
    rules = problem.before or problem.sequences or problem.in_file_order or problem.handovers
    if len(problem.length) != 2 or rules or windows or problem.stores is not None:
        return None
    return nearest_stages(problem)


def _append(rows: list[list[StopUnit]], unit: StopUnit, a: int) -> None:
    """Append a unit to an arm's row.

    Of a hand-over the taker's part goes to the other row.
    """
    if not unit.meets:
        rows[a].append(unit)
        return
    giving, taking = unit.shares(a)
    rows[a].append(giving)
    rows[1 - a].append(taking)


def never_touching(problem: StageProblem, slots: IntArray) -> IntArray:
    """Split the stages of an order that are infeasible at every angle."""
    if len(problem.work) != 2:
        return slots
    both = (slots != IDLE).all(axis=1)
    first, second = slots[both].T
    possible = np.isfinite(problem.work[0][first]) & np.isfinite(problem.work[1][second])
    if problem.pair_cost is not None:
        possible &= np.isfinite(problem.pair_cost[first, second])
    infeasible = {(int(i), int(j)) for i, j in slots[both][~possible.any(axis=1)]}
    # Both arms are needed at once in a hand-over.
    for giving, taking in problem.handovers:
        give, take = problem.tasks[giving][-1], problem.tasks[taking][0]
        infeasible -= {(give, take), (take, give)}
    return split_pairs(slots, infeasible)


SHARES = AnnealingSettings.of((384, 48, 128), (1, 2, 3, 2, 4, 2, 3, 5), (0.15, 0.1, 0.02))
"""Annealing moves per round, stage ranges by round, and shares of special exchanges.

Numbers of exchanges, of changes within a few stages, and of moves of runs. Numbers of those stages, round after round.
Fractions of exchanges with a task that is not near, with an idle arm, and with new stages.
"""


def is_supported(problem: StageProblem) -> bool:
    """Test whether annealing supports a problem.

    It needs two arms and no rules of order, windows, hand-overs or buffers.
    """
    rules = problem.before or problem.sequences or problem.in_file_order or problem.handovers
    windows = problem.not_before is not None or problem.not_after is not None
    return len(problem.length) == 2 and not rules and not windows and problem.stores is None


class StageAnnealing:
    """Simulated annealing [Kirkpatrick1983] of one order.

    A change is rated with the best angles of its stages between those around it, which stay. Tasks are exchanged, or
    moved to an idle arm or to new stages. Stops of a few consecutive stages are shifted, reversed or exchanged. Runs of
    stages are moved or reversed.
    """

    def __init__(self, problem: StageProblem, seed: int) -> None:
        """Prepare stage times and near tasks."""
        assert is_supported(problem)  # callers have looked
        self._problem = problem
        self._random = np.random.default_rng(seed)
        first, second = problem.length
        least = first.min(axis=(2, 3)), second.min(axis=(2, 3))
        turns = problem.returns and not problem.free_start
        returning = problem.turn[:, 0] if turns else np.zeros(len(problem.turn))
        start = problem.free_start
        self._lengths = PairedStageTimes.of(
            (first, second), least, problem.pair_cost, returning, free_start=start
        )
        self._tasks = AnnealedTasks.of(problem.tasks, _near_tasks(problem, least))

    def line(self, slots: IntArray) -> AnnealedOrder:
        """Prepare an order for annealing, with the best angles for it."""
        seed = int(self._random.integers(2**64, dtype=np.uint64))
        line = AnnealedOrder.of(self._lengths, slots, seed)
        self.anneal(line, range(0), (0.0, 1.0))
        return line

    def anneal(self, line: AnnealedOrder, rounds: range, heat: tuple[float, float]) -> None:
        """Run some rounds, see `anneal_stages`."""
        anneal_stages(self._lengths, self._tasks, SHARES, line, rounds, heat)

    def improve(
        self,
        start: StageOrder,
        rounds: int,
        better: Callable[[StageOrder], None] = lambda _: None,
        stop: Callable[[], bool] = lambda: False,
        heat: float = SEARCH.hot,
        met: Callable[[StageOrder], None] = lambda _: None,
    ) -> StageOrder:
        """Anneal an order and return the best one found, never a worse one.

        Args:
            start: feasible order.
            rounds: number of rounds.
            better: receives new best orders from time to time, without angles.
            stop: whether to stop early.
            heat: first temperature, relative to the mean length of a stage.
            met: receives the current order from time to time, with its best angles.
        """
        line = self.line(start.slots)
        total, warm = line.best, heat * line.total / len(line.slots)
        cooling = power(SEARCH.cold / heat, 1.0 / max(1, rounds))
        for k in range(0, rounds, SEARCH.refreshed):
            if stop():
                break
            block = range(k, min(rounds, k + SEARCH.refreshed))
            self.anneal(line, block, (warm * power(cooling, k + 1), cooling))
            met(StageOrder(line.slots, line.angles[1:], line.total))
            if line.best < total:
                total = line.best
                better(StageOrder(line.best_slots, np.zeros(0, dtype=np.int64), total))
        best = with_angles(self._problem, line.best_slots)
        if best.total < total - 1e-9:
            better(best)
        return best if best.total < start.total else start


def _near_tasks(problem: StageProblem, lengths: tuple[FloatArray, FloatArray]) -> IntArray:
    """Select the nearest other tasks of each, shape (t, `nearest_tasks` or fewer).

    Near tasks follow one another soonest, in either order.

    Args:
        problem: the stage problem.
        lengths: by arm, from stop to stop at the best angles [s], shape (s + 1, s + 2).
    """
    first = np.array([task[0] for task in problem.tasks])
    last = np.array([task[-1] for task in problem.tasks])
    least: FloatArray = np.full((len(first), len(first)), np.inf)
    for length in lengths:
        quickest = length[np.ix_(last, first)]
        least = np.minimum(least, np.minimum(quickest, quickest.T))
    np.fill_diagonal(least, np.inf)
    return np.argsort(least, axis=1, kind="stable")[
        :, : max(1, min(SEARCH.nearest_tasks, len(first) - 1))
    ]
