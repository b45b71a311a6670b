"""Good orders of many stages without rules: simulated annealing that tries hundreds of small changes at once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.sequencing.stage_line import StageLine, Window
from dualarm_cli.sequencing.stage_problem import IDLE, StageOrder, StageProblem
from dualarm_cli.sequencing.stage_times import with_angles

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
            better: is told every new best one; its angles are left out.
            stop: whether to stop early.
            heat: first temperature, in shares of a stage's mean length.
            met: is told, once in a while, what order the annealing is at, with the best angles for it.
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
