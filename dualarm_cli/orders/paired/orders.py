"""The best orders of stages found: all of them where tasks are few, else searches from several orders.

Good orders of many stages without rules: simulated annealing.
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
    """Returns stages made one after the other, shape (n, arms), of two arms; None where it comes to no end.

    In each, one arm takes the stop that it has done soonest, and the other one the soonest done of those that are left
    and that it can make beside it; whichever arm chooses first, and at whichever platform angle, the stage that is over
    first is taken, and among equals that in which the arms need less together. An arm that has picked places next.
    """
    came, at = [problem.stops, problem.stops], 0
    due: list[tuple[int, ...]] = [(), ()]
    left = [tuple(own) for own in problem.tasks]
    rows: list[tuple[int, ...]] = []
    while left or any(due):
        options: list[tuple[float, float, int, tuple[int, ...]]] = []
        can = [_candidates(left, due[a]) for a in range(2)]
        for first in range(2):
            options += _stages(problem, came, at, can, first)
        if not options:
            return None
        _, _, at, row = min(options)
        for a, stop in enumerate(row):
            if stop == IDLE:
                continue
            came[a] = stop
            own = due[a] or next(one for one in left if one[0] == stop)
            left = [one for one in left if one[0] != stop]
            due[a] = own[1:]
        rows.append(row)
    return np.array(rows, dtype=np.int64)


def _candidates(left: list[tuple[int, ...]], due: tuple[int, ...]) -> IntArray:
    stops = [due[0]] if due else [own[0] for own in left]
    return np.array(stops, dtype=np.int64)


def _stages(
    problem: StageProblem, came: list[int], at: int, can: list[IntArray], first: int
) -> list[tuple[float, float, int, tuple[int, ...]]]:
    """Returns length, sum, angle and stops of the best stage at each angle, one arm choosing first."""
    other, found = 1 - first, []
    for g in range(len(problem.turn)):
        own = problem.length[first][came[first], can[first], at, g]
        if not np.isfinite(own).any():
            continue
        k = int(own.argmin())
        stop, one = int(can[first][k]), float(own[k])
        rest = can[other][can[other] != stop]
        lengths: FloatArray = np.array(problem.length[other][came[other], rest, at, g])
        if problem.pair_cost is not None:
            pair = (stop, rest) if first == 0 else (rest, stop)
            lengths = lengths + problem.pair_cost[(*pair, g)]
        row = [IDLE, IDLE]
        row[first] = stop
        if len(rest) and np.isfinite(lengths).any():
            m = int(lengths.argmin())
            row[other] = int(rest[m])
            # What is done in one stage is worth more than what is done alone: by the stop.
            two = float(lengths[m])
            found.append((0.5 * max(one, two), one + two, g, tuple(row)))
        else:
            found.append((one, one, g, tuple(row)))
    return found


@dataclass(frozen=True)
class StageSearchSettings:
    """Numbers that steer the search for orders of stages."""

    whole: int = 30
    """Maximum number of stages of an order that is improved as a whole. Longer orders are improved in stretches as
    well."""
    least: int = 120
    """Minimum number of ruin-and-recreate steps."""
    short: int = 20
    """Number of ruin-and-recreate steps in a short search. In long orders it is the number of stretches that are
    improved."""
    full: int = 60
    """Number of stages of an order that gets all rounds of annealing. Shorter orders get fewer rounds, longer ones
    more."""
    least_share: float = 0.15
    """Least share of the annealing rounds, for short orders."""
    most_share: float = 1.6
    """Largest share of the annealing rounds, for long orders."""
    sooner: int = 8
    """Ratio of the rounds of successive coolings. The last cooling, the slowest, has all rounds."""
    shortest: int = 100
    """Minimum number of rounds of the quick coolings before the last one."""
    near: float = 0.02
    """Largest relative excess of near-optimal orders over the best one."""
    warm: float = 0.02
    """First temperature from a known order, as a share of a stage's mean length."""
    again: float = 0.4
    """Share of the annealing rounds from a known order."""
    many: int = 100
    """Number of units above which insertion makes no first order. It still does where no simpler order is possible."""
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
    """Collects different orders that are nearly as good as the best one."""

    def __init__(self, most: int) -> None:
        """Keeps so many at most."""
        self._most = most
        self._kept: dict[bytes, StageOrder] = {}

    def add(self, one: StageOrder) -> None:
        """Keeps an order if there is room for it, or a worse one to leave."""
        if not self._most:
            return
        self._kept.setdefault(one.slots.tobytes(), one)
        if len(self._kept) > self._most:
            del self._kept[max(self._kept, key=lambda key: self._kept[key].total)]

    def of(self, best: float) -> list[StageOrder]:
        """Select the orders that are longer than the best one by less than `near`."""
        return [one for one in self._kept.values() if one.total < (1.0 + SEARCH.near) * best]


def is_few(problem: StageProblem) -> bool:
    """Returns whether all orders are timed."""
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
    """Select the best of all orders of few tasks; search orders of more with `searched_orders`.

    Of few tasks the k-th stops of both arms are together.
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
    """Search different orders, the best one first; none where none was found.

    Ruin and recreate from the order of the tasks' numbers, and from others.

    Args:
        problem: what is asked.
        effort: how hard to try.
        seed: of all randomness.
        start: an order that is known to be good, to begin with, shape (n, arms).
        better: receives the total of every better order [s].
        stop: whether to stop early; one order is made in any case.
    """
    found: list[StageOrder] = []

    def told(one: StageOrder) -> None:
        if _has_all_parts(problem, one):
            better(one.total)

    for k in range(effort.starts):
        if found and stop():
            break
        search = StageSearch(problem, seed + k)
        first = _first(search, start if k == 0 else None, in_order=k == 0)
        if first is None:
            continue
        told(first)
        if effort.rounds and is_supported(problem) and np.isfinite(first.total):
            found += _annealed(search, first, effort, told, stop, known=start is not None)
            break
        steps = max(SEARCH.least, effort.steps // len(first.slots))
        one = search.improve(first, steps, told, stop)
        if len(one.slots) > SEARCH.whole:
            count = round(effort.stretches * len(one.slots))
            one = search.improve_stretches(one, count, told, stop)
        found.append(one)
        if len(one.slots) > SEARCH.whole:
            break
    given = in_file_order(problem, stage_units(problem))
    if given is not None and start is None:
        # What the file says is an answer as well, and may turn out to be the quickest one.
        plain = with_angles(problem, given)
        found += [plain] if np.isfinite(plain.total) else []
    return different_orders([one for one in found if _has_all_parts(problem, one)])


def short_search(problem: StageProblem, seed: int) -> float | None:
    """Returns the total of a good order by ruin and recreate [s], None where none was found: what takes no time."""
    search = StageSearch(problem, seed)
    first = _first(search, None, in_order=True)
    if first is None:
        return None
    improve = search.improve if len(first.slots) <= SEARCH.whole else search.improve_stretches
    return improve(first, SEARCH.short).total


def different_orders(found: Sequence[StageOrder]) -> list[StageOrder]:
    """Returns orders without those that are there already, the best one first."""
    kept: dict[bytes, StageOrder] = {}
    for one in sorted(found, key=lambda one: one.total):
        kept.setdefault(one.slots.tobytes(), one)
    return list(kept.values())


def _annealed(
    search: StageSearch,
    first: StageOrder,
    effort: StageEffort,
    told: Callable[[StageOrder], None],
    stop: Callable[[], bool],
    *,
    known: bool,
) -> list[StageOrder]:
    """Returns the best orders found by annealing; `known` is whether the first one is a good one already."""
    problem, one = search.problem, first
    if len(first.slots) <= SEARCH.whole:
        # Annealing exchanges what is there: where arms are idle for long, tasks are put together first.
        one = search.improve(first, SEARCH.least, told, stop)
    share = min(SEARCH.most_share, max(SEARCH.least_share, len(first.slots) / SEARCH.full))
    rounds = round(effort.rounds * share)
    annealing = StageAnnealing(problem, search.seed)
    if known:
        return [annealing.improve(one, round(SEARCH.again * rounds), told, stop, SEARCH.warm)]
    # While it is hot nothing is found: whoever ends it early then has what came of quicker coolings.
    coolings = [rounds]
    while coolings[0] >= SEARCH.sooner * SEARCH.shortest:
        coolings.insert(0, coolings[0] // SEARCH.sooner)
    for count in coolings[:-1]:
        if stop():
            return [one]
        one = annealing.improve(one, count, told, stop)
    found = [one]
    times = effort.coolings * min(1.0, SEARCH.whole / len(one.slots))
    for k in range(max(1, round(times))):
        if stop():
            break
        near = NearOptimalOrders(effort.near)
        annealing = annealing if k == 0 else StageAnnealing(problem, search.seed + k)
        best = annealing.improve(one, rounds, told, stop, met=near.add)
        found += [best, *near.of(best.total)]
    return found


def _has_all_parts(problem: StageProblem, order: StageOrder) -> bool:
    """Returns whether buffers have every part that is taken, and room for every one that is put."""
    return problem.stores is None or problem.stores.missing(order.slots[None])[0] == 0.0


def _first(search: StageSearch, start: IntArray | None, *, in_order: bool) -> StageOrder | None:
    """Returns an order to begin with, None where none was found."""
    if start is not None:
        return with_angles(search.problem, start)
    tries: list[StageOrder] = []
    for plain in (in_file_order, by_suited_arms, by_nearest) if in_order else ():
        given = plain(search.problem, search.units)
        if given is not None:
            tries.append(with_angles(search.problem, never_touching(search.problem, given)))
    # Insertion takes long there, and is no better than what is refined anyway.
    enough = len(search.units) > SEARCH.many and any(np.isfinite(one.total) for one in tries)
    for _ in range(0 if enough else SEARCH.first_tries):
        one = search.first()
        if one is not None:
            tries.append(one)
        if any(np.isfinite(one.total) for one in tries):
            break
    good = [one for one in tries if np.isfinite(one.total)]
    return min(good, key=lambda one: one.total) if good else None


def in_file_order(problem: StageProblem, units: list[StopUnit]) -> IntArray | None:
    """Returns the tasks in the order of their numbers, those of any arm by the one that has less to do until then.

    None where that keeps no rule.
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
    """Returns the tasks in the order of their numbers, each by the arm that gets to its first stop soonest from home.

    None where that keeps no rule.
    """
    rows: list[list[StopUnit]] = [[] for _ in problem.length]
    for unit in sorted(units, key=lambda unit: unit.tasks):
        if not unit.arms:
            return None
        soonest = {a: problem.length[a][problem.stops, unit.stops[0]].min() for a in unit.arms}
        _append(rows, unit, min(soonest, key=lambda a: (soonest[a], a)))
    return side_by_side(problem, rows)


def by_nearest(problem: StageProblem, _units: list[StopUnit]) -> IntArray | None:
    """Returns the tasks by the nearest neighbour; None where there are rules, which it knows nothing of."""
    windows = problem.not_before is not None or problem.not_after is not None
    rules = problem.before or problem.sequences or problem.in_file_order or problem.handovers
    if len(problem.length) != 2 or rules or windows or problem.stores is not None:
        return None
    return nearest_stages(problem)


def _append(rows: list[list[StopUnit]], unit: StopUnit, a: int) -> None:
    """Appends a unit to what an arm does; of a hand-over the taker's share to what the other one does."""
    if not unit.meets:
        rows[a].append(unit)
        return
    giving, taking = unit.shares(a)
    rows[a].append(giving)
    rows[1 - a].append(taking)


def never_touching(problem: StageProblem, slots: IntArray) -> IntArray:
    """Returns an order in which stops that no angle allows in one stage are made one after the other."""
    if len(problem.work) != 2:
        return slots
    both = (slots != IDLE).all(axis=1)
    one, other = slots[both].T
    possible = np.isfinite(problem.work[0][one]) & np.isfinite(problem.work[1][other])
    if problem.pair_cost is not None:
        possible &= np.isfinite(problem.pair_cost[one, other])
    never = {(int(i), int(j)) for i, j in slots[both][~possible.any(axis=1)]}
    # A hand-over cannot be made one after the other.
    for giving, taking in problem.handovers:
        give, take = problem.tasks[giving][-1], problem.tasks[taking][0]
        never -= {(give, take), (take, give)}
    return split_pairs(slots, never)


SHARES = AnnealingSettings.of((384, 48, 128), (1, 2, 3, 2, 4, 2, 3, 5), (0.15, 0.1, 0.02))
"""Exchanges, changes within a few stages and moves of runs in each round; how many stages those are, round after round;
shares of exchanges with a task that is not near, with an idle arm, and with stages of its own."""


def is_supported(problem: StageProblem) -> bool:
    """Test whether annealing supports a problem.

    It has to have two arms, and no rules of order, windows, hand-overs or buffers.
    """
    rules = problem.before or problem.sequences or problem.in_file_order or problem.handovers
    windows = problem.not_before is not None or problem.not_after is not None
    return len(problem.length) == 2 and not rules and not windows and problem.stores is None


class StageAnnealing:
    """Simulated annealing [Kirkpatrick1983] on one order.

    A change is priced with the angles that suit its stages best between those around it, which stay. Tasks change
    places, or go to where an arm is idle, or to stages of their own; stops of a few stages in a row are shifted, turned
    round or change places; runs of stages go to another place, or are made in the opposite order.
    """

    def __init__(self, problem: StageProblem, seed: int) -> None:
        """Prepares what is near to what."""
        assert is_supported(problem)  # callers have looked
        self._problem = problem
        self._random = np.random.default_rng(seed)
        one, other = problem.length
        least = one.min(axis=(2, 3)), other.min(axis=(2, 3))
        turns = problem.returns and not problem.free_start
        back = problem.turn[:, 0] if turns else np.zeros(len(problem.turn))
        start = problem.free_start
        self._lengths = PairedStageTimes.of(
            (one, other), least, problem.pair_cost, back, free_start=start
        )
        self._tasks = AnnealedTasks.of(problem.tasks, _near_tasks(problem, least))

    def line(self, slots: IntArray) -> AnnealedOrder:
        """Prepare an order for annealing, with the best angles for it."""
        seed = int(self._random.integers(2**64, dtype=np.uint64))
        line = AnnealedOrder.of(self._lengths, slots, seed)
        self.anneal(line, range(0), (0.0, 1.0))
        return line

    def anneal(self, line: AnnealedOrder, rounds: range, heat: tuple[float, float]) -> None:
        """Makes some rounds, see `anneal_stages`."""
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
            start: an order that can be.
            rounds: how many.
            better: receives every new best one, once in a while; its angles are left out.
            stop: whether to stop early.
            heat: first temperature, in shares of a stage's mean length.
            met: receives, once in a while, what order the annealing is at, with the best angles for it.
        """
        line = self.line(start.slots)
        total, warm = line.best, heat * line.total / len(line.slots)
        cooling = power(SEARCH.cold / heat, 1.0 / max(1, rounds))
        for k in range(0, rounds, SEARCH.refreshed):
            if stop():
                break
            some = range(k, min(rounds, k + SEARCH.refreshed))
            self.anneal(line, some, (warm * power(cooling, k + 1), cooling))
            met(StageOrder(line.slots, line.angles[1:], line.total))
            if line.best < total:
                total = line.best
                better(StageOrder(line.best_slots, np.zeros(0, dtype=np.int64), total))
        found = with_angles(self._problem, line.best_slots)
        if found.total < total - 1e-9:
            better(found)
        return found if found.total < start.total else start


def _near_tasks(problem: StageProblem, lengths: tuple[FloatArray, FloatArray]) -> IntArray:
    """Select the nearest other tasks of each, shape (t, `nearest_tasks` or fewer).

    Near tasks follow one another soonest, in either order.

    Args:
        problem: what is asked.
        lengths: by arm, from stop to stop at the best angles [s], shape (s + 1, s + 2).
    """
    first = np.array([own[0] for own in problem.tasks])
    last = np.array([own[-1] for own in problem.tasks])
    least: FloatArray = np.full((len(first), len(first)), np.inf)
    for length in lengths:
        quickest = length[np.ix_(last, first)]
        least = np.minimum(least, np.minimum(quickest, quickest.T))
    np.fill_diagonal(least, np.inf)
    return np.argsort(least, axis=1, kind="stable")[
        :, : max(1, min(SEARCH.nearest_tasks, len(first) - 1))
    ]
