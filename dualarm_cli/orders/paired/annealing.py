"""Good orders of many stages without rules: simulated annealing that tries hundreds of small changes at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dualarm_cli.compiled.stage_changes import PairedLengths, change_worths
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.orders.paired.problem import IDLE, StageOrder, StageProblem
from dualarm_cli.orders.paired.times import previous, with_angles

NEVER = 1e6
"""More than anything takes [s]."""


@dataclass(frozen=True)
class Window:
    """Some stages in a row with other stops, b times over."""

    first: IntArray
    """The first of them, counted from 1, shape (b,)."""
    rows: IntArray
    """Their stops then, shape (b, w, 2)."""


@dataclass(frozen=True)
class Worth:
    """What windows are worth, b of them."""

    delta: FloatArray
    """By how much all is done later [s], infinite where it cannot be, shape (b,)."""
    angles: IntArray
    """The platform angles that suit the stages best between those before and after them, shape (b, w)."""
    last: IntArray
    """The last stage whose length is another one then, shape (b,)."""


class StageLine:
    """Two arms' stages with an angle for each. Stage 0 stands for the start and the last one for the way back.

    All other angles stay as they are when a change is priced, so that an order is never worse than its changes say.
    """

    def __init__(self, problem: StageProblem, slots: IntArray) -> None:
        """Takes an order (n, 2) with the best angles for it; n is 1 or more, and no stage is empty."""
        self._problem = problem
        self.home = problem.stops
        turns = problem.returns and not problem.free_start
        self._turns_back = problem.turn[:, 0] if turns else np.zeros(len(problem.turn))
        ends = np.full((1, 2), self.home)
        self.rows: IntArray = np.concatenate([ends, slots, ends])
        self.angles: IntArray = np.zeros(len(self.rows), dtype=np.int64)
        self.place = np.zeros((problem.stops, 2), dtype=np.int64)
        one, other = problem.length
        self._lengths = PairedLengths.of((one, other), problem.apart, self._turns_back)
        self.choose_angles()

    @property
    def stages(self) -> int:
        """How many stages there are."""
        return len(self.rows) - 2

    @property
    def slots(self) -> IntArray:
        """The order, shape (n, 2)."""
        return np.array(self.rows[1:-1])

    @property
    def total(self) -> float:
        """When all is done [s]."""
        return float(self.costs.sum())

    def choose_angles(self) -> None:
        """Takes the best angles for the stages as they are."""
        self.angles[1:-1] = with_angles(self._problem, self.rows[1:-1]).angles
        if self._problem.free_start:
            start = np.full((1, 2), self.home)
            first = self.length_to(start, self.rows[1:2], self.angles[1:2])
            self.angles[0] = int(first[0].argmin())
        self.measure()

    def measure(self) -> None:
        """Computes what follows from stops and angles, without stages in which nothing is left to do."""
        some = (self.rows != IDLE).any(axis=1)
        if not some.all():
            self.rows, self.angles = self.rows[some], self.angles[some]
        n = len(self.rows)
        self.came = np.concatenate(
            [np.full((1, 2), self.home), previous(self.rows[None, 1:], self.home)[0, :-1]]
        )
        active = self.rows != IDLE
        number = np.where(active, np.arange(n)[:, None], n)
        self.next = np.minimum.accumulate(number[::-1], axis=0)[::-1]
        self.both = active.all(axis=1)
        self.costs = np.zeros(n)
        self.costs[1:] = self.length(
            self.came[1:], self.rows[1:], self.angles[:-1], self.angles[1:]
        )
        self._sums = np.concatenate([[0.0], np.cumsum(self.costs)])
        k, a = np.nonzero(active[1:-1])
        self.place[self.rows[k + 1, a]] = np.stack([k + 1, a], axis=1)

    def put(self, first: int, rows: IntArray, angles: IntArray) -> None:
        """Puts stops and angles in the place of some stages; `measure` after all of them."""
        self.rows[first : first + len(rows)] = rows
        self.angles[first : first + len(rows)] = angles

    def rearranged(self, order: IntArray) -> None:
        """Puts the stages, start and way back included, into another order, each with its angle."""
        self.rows, self.angles = self.rows[order], self.angles[order]
        self.measure()

    def sum_of(self, first: IntArray, last: IntArray) -> FloatArray:
        """Returns how long stages `first` to `last`, both included, take [s]."""
        found: FloatArray = self._sums[last + 1] - self._sums[first]
        return found

    def length(self, came: IntArray, stops: IntArray, f: IntArray, g: IntArray) -> FloatArray:
        """Returns how long stages take from one angle to another [s], shape (b,).

        Args:
            came: what each arm made before, shape (b, 2).
            stops: of the stages, shape (b, 2); `home` for the way back.
            f: the angles before, shape (b,).
            g: their own angles, shape (b,).
        """
        one, other = self._problem.length
        back, (i, j) = self._ways(came, stops)
        found: FloatArray = np.maximum(one[came[:, 0], i, f, g], other[came[:, 1], j, f, g]).astype(
            np.float64
        )
        found += self._apart(stops, g)
        if back.any():
            found[back] = np.maximum(found[back], self._turns_back[f[back]])
        return found

    def length_to(self, came: IntArray, stops: IntArray, g: IntArray) -> FloatArray:
        """Returns how long stages take from every angle, shape (b, f); the rest as in `length`."""
        one, other = self._problem.length
        back, (i, j) = self._ways(came, stops)
        found: FloatArray = np.maximum(one[came[:, 0], i, :, g], other[came[:, 1], j, :, g]).astype(
            np.float64
        )
        found += self._apart(stops, g)[:, None]
        if back.any():
            found[back] = np.maximum(found[back], self._turns_back)
        return found

    def _ways(self, came: IntArray, stops: IntArray) -> tuple[BoolArray, tuple[IntArray, IntArray]]:
        """Returns which stages are the way back, and columns of lengths: an arm that never left has no way back."""
        back = stops[:, 0] == self.home
        stays = back[:, None] & (came == self.home)
        one, other = np.where(stays, IDLE, stops).T
        return back, (one, other)

    def _apart(self, stops: IntArray, g: IntArray) -> FloatArray:
        if self._problem.apart is None:
            return np.zeros(len(stops))
        found: FloatArray = self._problem.apart[stops[:, 0], stops[:, 1], g]
        return np.where(stops[:, 0] == self.home, 0.0, found)

    def worth(self, window: Window) -> Worth:
        """Returns what it is worth to do other stops in some stages, at the angles that suit these best."""
        line = (self.rows, self.came, self.next, self.angles, self.costs, self._sums)
        return Worth(*change_worths(self._lengths, line, window.first, window.rows))

    def reversals(self, begin: IntArray, end: IntArray) -> FloatArray:
        """Returns by how much all is done later with stages [begin, end) in the opposite order [s], shape (b,).

        Every stage keeps its angle. Infinite where an arm is idle in one of them or in those before and after.
        """
        links = np.zeros(len(self.rows))
        links[1:-2] = self.length(
            self.rows[2:-1], self.rows[1:-2], self.angles[2:-1], self.angles[1:-2]
        )
        # What cannot be must not spoil the sums behind it.
        links = np.where(self.both & (links < NEVER), links, NEVER)
        links = np.concatenate([[0.0], np.cumsum(links)])
        idle = np.concatenate([[0], np.cumsum(~self.both)])
        rows, at = self.rows, self.angles
        found: FloatArray = (
            self.length(rows[begin - 1], rows[end - 1], at[begin - 1], at[end - 1])
            + self.length(rows[begin], rows[end], at[begin], at[end])
            + (links[end - 1] - links[begin])
            - self.sum_of(begin, end)
        )
        possible = (idle[end + 1] == idle[begin - 1]) & (found < 0.5 * NEVER)
        return np.where(possible, found, np.inf)

    def exchanges(self, i: IntArray, j: IntArray, p: IntArray) -> FloatArray:
        """Returns by how much all is done later if stages [i, j) and [j, p) change places [s], shape (b,).

        Every stage keeps its angle; both arms go on in stages i, j and p.
        """
        rows, at, came = self.rows, self.angles, self.came
        found: FloatArray = (
            self.length(came[i], rows[j], at[i - 1], at[j])
            + self.length(came[p], rows[i], at[p - 1], at[i])
            + self.length(came[j], rows[p], at[j - 1], at[p])
            - self.costs[i]
            - self.costs[j]
            - self.costs[p]
        )
        return found

    def cuts(self, inner: BoolArray) -> BoolArray:
        """Returns before which stages a run may begin or end: both arms go on there, and neither is amid a task.

        Args:
            inner: which stops are followed by another one of the same task, False for `home`, shape (s + 1,).
        """
        found: BoolArray = self.both & ~inner[self.came].any(axis=1)
        found[0] = False
        return found


HOT, COLD = 0.06, 0.0015
"""First and last temperature, in shares of a stage's mean length."""
SWAPS = 384
"""Exchanges that are tried at once."""
CHANGES = 48
"""Changes within a few stages that are tried at once."""
WIDTHS = (1, 2, 3, 2, 4, 2, 3, 5)
"""So many stages these are, round after round."""
MOVED = 128
"""Moves of runs of stages, and reversals of such, that are tried at once."""
NEAR = 24
"""Tasks that are near another one."""
FAR = 0.15
"""Share of exchanges with a task that is not."""
REFRESHED = 20
"""After so many rounds all platform angles are chosen anew."""


def is_served(problem: StageProblem) -> bool:
    """Returns whether a problem is two arms', without any rule of order, windows, hand-overs and buffers."""
    rules = problem.before or problem.sequences or problem.in_file_order or problem.handovers
    windows = problem.not_before is not None or problem.not_after is not None
    return len(problem.length) == 2 and not rules and not windows and problem.stores is None


class StageAnnealing:
    """Simulated annealing [Kirkpatrick1983] on one order.

    A round prices many changes to the same order at once and takes those that the temperature lets pass, as far as
    they do not meddle with one another.
    """

    def __init__(self, problem: StageProblem, seed: int) -> None:
        """Prepares what is near to what."""
        assert is_served(problem)  # callers have looked
        self._problem = problem
        self._random = np.random.default_rng(seed)
        sizes = np.array([len(own) for own in problem.tasks])
        self._of_size = {int(m): np.flatnonzero(sizes == m) for m in np.unique(sizes)}
        self._stops = {
            m: np.array([problem.tasks[t] for t in own]) for m, own in self._of_size.items()
        }
        self._size, self._rank = sizes, np.zeros(len(sizes), dtype=np.int64)
        for own in self._of_size.values():
            self._rank[own] = np.arange(len(own))
        self._task = np.zeros(problem.stops + 1, dtype=np.int64)
        self._inner = np.zeros(problem.stops + 1, dtype=np.bool_)
        for t, own_stops in enumerate(problem.tasks):
            self._task[list(own_stops)] = t
            self._inner[list(own_stops[:-1])] = True
        self._near = _near_tasks(problem)

    def improve(
        self,
        start: StageOrder,
        rounds: int,
        better: Callable[[StageOrder], None] = lambda _: None,
        stop: Callable[[], bool] = lambda: False,
        heat: float = HOT,
        met: Callable[[StageOrder], None] = lambda _: None,
    ) -> StageOrder:
        """Returns the best order found from one to begin with, never a worse one.

        Args:
            start: an order that can be.
            rounds: how many.
            better: receives every new best one; its angles are left out.
            stop: whether to stop early.
            heat: first temperature, in shares of a stage's mean length.
            met: receives, once in a while, what order the annealing is at, with the best angles for it.
        """
        line = StageLine(self._problem, start.slots)
        best, total = line.slots, line.total
        share = line.total / line.stages
        cooling = (COLD / heat) ** (1.0 / max(1, rounds))
        warm = heat * share
        for k in range(rounds):
            if stop():
                break
            warm *= cooling
            self._round(line, k, warm)
            if k % REFRESHED == REFRESHED - 1:
                line.choose_angles()
                met(StageOrder(line.slots, np.array(line.angles[1:-1]), line.total))
            if line.total < total - 1e-9:
                best, total = line.slots, line.total
                better(StageOrder(best, np.zeros(0, dtype=np.int64), total))
        found = with_angles(self._problem, best)
        if found.total < total - 1e-9:
            better(found)
        return found if found.total < start.total else start

    def _round(self, line: StageLine, k: int, warm: float) -> None:
        for m in self._of_size:
            self._exchange(line, m, warm)
        if len(self._of_size) == 1 and 1 in self._of_size:
            self._change(line, WIDTHS[k % len(WIDTHS)], warm)
            self._reverse(line, warm)
        self._move(line, warm)

    def _passes(self, delta: FloatArray, warm: float) -> IntArray:
        """Returns which changes the temperature lets pass, in the order in which they were drawn."""
        return np.flatnonzero(delta < -warm * np.log(1.0 - self._random.random(len(delta))))

    def _exchange(self, line: StageLine, m: int, warm: float) -> None:
        """Tasks of m stops each change places, or go to where an arm is idle."""
        random, own, stops = self._random, self._of_size[m], self._stops[m]
        one = random.integers(len(own), size=SWAPS)
        first = line.place[stops[one, 0]]
        # What comes in is near to what comes before, or after.
        side = random.random(SWAPS) < 0.5
        end = np.minimum(first[:, 0] + m, line.stages + 1)
        beside = np.where(side, line.came[first[:, 0], first[:, 1]], line.rows[end, first[:, 1]])
        beside = np.where(beside == IDLE, line.home, beside)
        near = self._near[self._task[beside], random.integers(self._near.shape[1], size=SWAPS)]
        far = (beside == line.home) | (random.random(SWAPS) < FAR) | (self._size[near] != m)
        other = np.where(far, random.integers(len(own), size=SWAPS), self._rank[near])
        second = line.place[stops[other, 0]]
        after = stops[other]
        if m == 1:
            # Not amid a task of the arm that is idle there.
            idle = np.argwhere((line.rows == IDLE) & ~self._inner[line.came])
            if len(idle):
                some = np.flatnonzero(random.random(SWAPS) < 0.1)
                second[some] = idle[random.integers(len(idle), size=len(some))]
                after[some] = IDLE
        # The earlier one first.
        before = stops[one]
        turned = first[:, 0] > second[:, 0]
        first, second = (
            np.where(turned[:, None], second, first),
            np.where(turned[:, None], first, second),
        )
        before, after = (
            np.where(turned[:, None], after, before),
            np.where(turned[:, None], before, after),
        )
        rows = np.flatnonzero(
            (first[:, 0] + m < second[:, 0])
            & self._in_a_row(line, before, first)
            & self._in_a_row(line, after, second)
        )
        if not len(rows):
            return
        windows = [
            self._window(line, first[rows], after[rows]),
            self._window(line, second[rows], before[rows]),
        ]
        worths = [line.worth(window) for window in windows]
        delta = worths[0].delta + worths[1].delta
        delta[worths[0].last >= windows[1].first] = np.inf
        taken = np.zeros(len(line.rows), dtype=np.bool_)
        for k in self._passes(delta, warm).tolist():
            spans = [
                slice(int(w.first[k]), int(found.last[k]) + 1)
                for w, found in zip(windows, worths, strict=True)
            ]
            if any(taken[span].any() for span in spans):
                continue
            for span, w, found in zip(spans, windows, worths, strict=True):
                taken[span] = True
                line.put(span.start, w.rows[k], found.angles[k])
        if taken.any():
            line.measure()

    def _in_a_row(self, line: StageLine, stops: IntArray, place: IntArray) -> BoolArray:
        """Returns whether the stops of tasks are made in stages that follow one another, shape (b,)."""
        found: BoolArray = np.ones(len(stops), dtype=np.bool_)
        for i in range(1, stops.shape[1]):
            found &= line.place[stops[:, i], 0] == place[:, 0] + i
        return found

    @staticmethod
    def _window(line: StageLine, place: IntArray, stops: IntArray) -> Window:
        """Returns stages in which arms make other stops, shape (b, m), from places (b, 2) on."""
        b, m = stops.shape
        each = np.arange(b)[:, None]
        rows = line.rows[place[:, :1] + np.arange(m)]
        rows[each, np.arange(m)[None], place[:, 1:]] = stops
        return Window(place[:, 0], rows)

    def _change(self, line: StageLine, w: int, warm: float) -> None:
        """In some stages in a row stops are shifted, turned round or change places; of tasks of one stop each."""
        if line.stages < w:
            return
        random, b = self._random, CHANGES
        first = random.integers(1, line.stages - w + 2, size=b)
        rows = line.rows[first[:, None] + np.arange(w)]
        # A stage by itself: its arms change what they do. More: every kind of change in turn.
        kinds = [rows[: b // 6], *np.array_split(rows[b // 6 :], 5)]
        kinds[0] = kinds[0][:, :, ::-1]
        if w > 1:
            kinds[1] = np.roll(kinds[1], 1, axis=1)
            kinds[2] = np.concatenate(
                [np.roll(kinds[2][:, :, :1], 1, axis=1), kinds[2][:, :, 1:]], axis=2
            )
            kinds[3] = np.concatenate(
                [kinds[3][:, :, :1], np.roll(kinds[3][:, :, 1:], 1, axis=1)], axis=2
            )
            kinds[4] = np.roll(kinds[4], -1, axis=1)
            # All stops of the stages anyhow.
            flat = kinds[5].reshape(len(kinds[5]), 2 * w)
            order = np.argsort(random.random(flat.shape), axis=1)
            kinds[5] = np.take_along_axis(flat, order, axis=1).reshape(-1, w, 2)
        window = Window(first, np.concatenate(kinds))
        self._take(line, window, warm)

    def _take(self, line: StageLine, window: Window, warm: float) -> None:
        found = line.worth(window)
        taken = np.zeros(len(line.rows), dtype=np.bool_)
        for k in self._passes(found.delta, warm).tolist():
            span = slice(int(window.first[k]), int(found.last[k]) + 1)
            if not taken[span].any():
                taken[span] = True
                line.put(span.start, window.rows[k], found.angles[k])
        if taken.any():
            line.measure()

    def _reverse(self, line: StageLine, warm: float) -> None:
        """A run of stages is made in the opposite order."""
        random, n = self._random, line.stages
        begin = random.integers(1, n + 1, size=MOVED)
        end = np.minimum(begin + 1 + random.integers(1, n + 1, size=MOVED), n + 1)
        good = end - begin > 1
        begin, end = begin[good], end[good]
        passed = self._passes(line.reversals(begin, end), warm)
        if len(passed):
            k = passed[0]
            order = np.arange(n + 2)
            order[begin[k] : end[k]] = order[begin[k] : end[k]][::-1]
            line.rearranged(order)

    def _move(self, line: StageLine, warm: float) -> None:
        """A run of stages goes to another place, as it is."""
        random, n = self._random, line.stages
        cuts = np.flatnonzero(line.cuts(self._inner))
        if len(cuts) < 3:
            return
        # Two runs that follow one another change places.
        where = np.sort(cuts[random.integers(len(cuts), size=(MOVED, 3))], axis=1)
        short = random.random(MOVED) < 0.5
        where[short, 1] = np.minimum(where[short, 0] + random.integers(1, 4, int(short.sum())), n)
        good = (where[:, 0] < where[:, 1]) & (where[:, 1] < where[:, 2])
        good &= np.isin(where[:, 1], cuts)
        i, j, p = where[good].T
        if not len(i):
            return
        passed = self._passes(line.exchanges(i, j, p), warm)
        if len(passed):
            k = passed[0]
            order = np.arange(n + 2)
            line.rearranged(
                np.concatenate(
                    [order[: i[k]], order[j[k] : p[k]], order[i[k] : j[k]], order[p[k] :]]
                )
            )


def _near_tasks(problem: StageProblem) -> IntArray:
    """Returns the nearest other tasks of each: those that follow it soonest on any arm, shape (t, NEAR or fewer)."""
    first = np.array([own[0] for own in problem.tasks])
    last = np.array([own[-1] for own in problem.tasks])
    least: FloatArray = np.full((len(first), len(first)), np.inf)
    for length in problem.length:
        quickest = length[:-1, :-2].min(axis=(2, 3))[np.ix_(last, first)]
        least = np.minimum(least, np.minimum(quickest, quickest.T))
    np.fill_diagonal(least, np.inf)
    return np.argsort(least, axis=1, kind="stable")[:, : max(1, min(NEAR, len(first) - 1))]
