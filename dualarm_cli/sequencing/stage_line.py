"""One order of two arms' stages with an angle for each: what small changes to it are worth, many of them at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.sequencing.stage_problem import IDLE, StageProblem
from dualarm_cli.sequencing.stage_times import previous, with_angles

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
        problem, (b, w, _) = self._problem, window.rows.shape
        first, rows = window.first, window.rows
        one, other = problem.length
        came, before = self.came[first], self.angles[first - 1]
        chosen: list[IntArray] = []
        value: FloatArray = np.zeros(0)
        for i in range(w):
            stops = rows[:, i]
            nothing = (stops == IDLE).all(axis=1)
            if i == 0:
                now = np.maximum(
                    one[came[:, 0], stops[:, 0], before], other[came[:, 1], stops[:, 1], before]
                ).astype(np.float64)
                stays = np.where(np.arange(now.shape[1]) == before[:, None], 0.0, np.inf)
            else:
                step = np.maximum(one[came[:, 0], stops[:, 0]], other[came[:, 1], stops[:, 1]])
                # Where nobody does anything the platform stays; what is infinite then is put right.
                with np.errstate(invalid="ignore"):
                    both = value[:, :, None] + step
                best = both.argmin(axis=1)
                best[nothing] = np.arange(best.shape[1])
                chosen.append(best)
                now, stays = both.min(axis=1), value
            if problem.apart is not None:
                now += problem.apart[stops[:, 0], stops[:, 1]]
            value = np.where(nothing[:, None], stays, now)
            came = np.where(stops == IDLE, came, stops)
        end = first + w
        value = value + self.length_to(came, self.rows[end], self.angles[end])
        at = value.argmin(axis=1)
        angles = np.empty((b, w), dtype=np.int64)
        angles[:, w - 1] = at
        each = np.arange(b)
        for i in range(w - 2, -1, -1):
            angles[:, i] = chosen[i][each, angles[:, i + 1]]
        delta = value[each, at] - self.sum_of(first, end)
        last = end.copy()
        for a in range(2):
            # An arm that is idle right after comes from elsewhere when it goes on.
            later = np.flatnonzero(self.rows[end, a] == IDLE)
            if len(later):
                k = self.next[end[later], a]
                from_there = self.came[k].copy()
                from_there[:, a] = came[later, a]
                anew = self.length(from_there, self.rows[k], self.angles[k - 1], self.angles[k])
                delta[later] += anew - self.costs[k]
                last[later] = k
        return Worth(delta, angles, last)

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
