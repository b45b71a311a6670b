"""Two arms that go their ways by their own clocks and wait for each other where they must: the quickest way together.

The state is how far each arm has got on its own timeline. Both go on, or one waits where it stands anyway; pairs of
places at which the arms would touch, or at which one is ahead of a task that it has to wait for, are obstacles in that
plane [ODonnell1989]. Dynamic programming over the plane finds the quickest way from start to end.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class Diagram:
    """The plane of two timelines in equal steps."""

    steps: tuple[int, int]
    """How many steps each timeline has."""
    rests: tuple[tuple[int, ...], tuple[int, ...]]
    """By arm, after how many steps it may wait; at its end it may anyway."""
    blocked: BoolArray
    """Where they must not be together, shape (steps + 1, 2 band + 1): column c of row i is step i + c - band of the
    second arm."""
    opens: tuple[tuple[tuple[int, int], ...], tuple[tuple[int, int], ...]] = ((), ())
    """By arm, pairs of a place to rest and the number of steps of time before which it must not leave it."""
    needs: tuple[tuple[tuple[int, int], ...], tuple[tuple[int, int], ...]] = ((), ())
    """By arm, pairs of a place to rest and the place that the other arm has to have reached before it leaves it."""

    @property
    def band(self) -> int:
        """How many steps one arm may be ahead of the other at most."""
        return (self.blocked.shape[1] - 1) // 2

    @cached_property
    def may_wait(self) -> list[BoolArray]:
        """Places of each arm where it may wait, shape (steps + 1,)."""
        return [_marks(k, r) for k, r in zip(self.steps, self.rests, strict=True)]

    @cached_property
    def opening(self) -> list[FloatArray]:
        """Times before which each arm must not leave its places [steps], shape (steps + 1,)."""
        return [_largest(k, r) for k, r in zip(self.steps, self.opens, strict=True)]

    @cached_property
    def needed(self) -> list[FloatArray]:
        """Places that the other arm must reach before each arm moves on.

        One array for each arm, shape (steps + 1,), by its own places.
        """
        return [_largest(k, r) for k, r in zip(self.steps, self.needs, strict=True)]

    def leaving(
        self, time: FloatArray, i: int, j: IntArray, moves: tuple[bool, bool]
    ) -> FloatArray:
        """Compute when states are left at the earliest [steps]: arms wait until they may move on, if both can wait.

        Infinite where the other arm has to get farther first.

        Args:
            time: when the states are reached, shape (c,).
            i: place of the first arm.
            j: places of the second arm, shape (c,).
            moves: which arms move on.
        """
        may_wait, opens, needs = self.may_wait, self.opening, self.needed
        jj = np.clip(j, 0, len(opens[1]) - 1)
        until = np.zeros(len(time))
        if moves[0]:
            until = np.maximum(until, opens[0][i])
        if moves[1]:
            until = np.maximum(until, opens[1][jj])
        held = (moves[0] & (j < needs[0][i])) | (moves[1] & (i < needs[1][jj]))
        both_wait = may_wait[0][i] & may_wait[1][jj]
        found = np.where(time >= until, time, np.where(both_wait, np.maximum(time, until), np.inf))
        return np.where(held, np.inf, found)


@dataclass(frozen=True)
class DiagramPath:
    """A way through the plane."""

    length: int
    """Its steps of time."""
    waits: tuple[tuple[tuple[int, int], ...], tuple[tuple[int, int], ...]]
    """By arm, pairs of a place to rest and how many steps the arm waits there."""

    def place(self, a: int, time: int) -> int:
        """Returns where an arm is after so many steps of time, as if it never came to its end."""
        gone = 0
        for at, wait in self.waits[a]:
            if time <= at + gone:
                break
            if time <= at + gone + wait:
                return at
            gone += wait
        return time - gone

    def arrival(self, a: int, place: int) -> int:
        """Returns after how many steps of time an arm comes to a place of its way."""
        return place + sum(wait for at, wait in self.waits[a] if at < place)

    def departure(self, a: int, place: int) -> int:
        """Returns after how many steps of time an arm goes on from a place of its way."""
        return place + sum(wait for at, wait in self.waits[a] if at <= place)


def quickest_path(diagram: Diagram) -> DiagramPath | None:
    """Returns the quickest way through the plane, None where there is none within the band."""
    n, m = diagram.steps
    band = diagram.band
    may_wait, opens, needs = diagram.may_wait, diagram.opening, diagram.needed
    # time[i, c] for the second arm at j = i + c - band.
    time = np.full((n + 1, 2 * band + 1), np.inf)
    columns = np.arange(2 * band + 1)
    waits_b = np.zeros(m + 1, dtype=np.bool_)
    waits_b[:] = may_wait[1]
    for i in range(n + 1):
        j = i + columns - band
        inside = (j >= 0) & (j <= m)
        row = np.full(2 * band + 1, np.inf)
        jj = np.clip(j, 0, m)
        if i == 0:
            row[band] = 0.0
        else:
            # Both go on; or the first goes on while the second waits (one column to the right, as i grows).
            row = diagram.leaving(time[i - 1], i - 1, j - 1, (True, True)) + 1.0
            ahead = np.append(time[i - 1][1:], np.inf)
            wait = diagram.leaving(ahead, i - 1, j, (True, False)) + 1.0
            row = np.minimum(row, np.where(waits_b[jj], wait, np.inf))
        row = np.where(inside & ~diagram.blocked[i], row, np.inf)
        if may_wait[0][i]:
            free = inside & ~diagram.blocked[i]
            row = _along(row, free, waits_b[jj], opens[1][jj], needs[1][jj] > i)
        time[i] = row
    end = band + m - n
    if not 0 <= end <= 2 * band or not np.isfinite(time[n, end]):
        return None
    return _traced(diagram, time)


def _along(
    row: FloatArray, free: BoolArray, may_wait: BoolArray, opens: FloatArray, held: BoolArray
) -> FloatArray:
    """Returns a row of times in which the first arm waits while the second goes on.

    Args:
        row: when the states are reached without that, shape (c,).
        free: which states are not blocked, shape (c,).
        may_wait: where the second arm may wait, shape (c,).
        opens: the time before which it must not go on, shape (c,).
        held: where it must not go on as the first arm has not got far enough, shape (c,).
    """
    if not opens.any():
        # The least of what is reached before in the same run of free states, and a step for each state since.
        ends = ~free
        ends[1:] |= held[:-1]
        columns, run, far = np.arange(len(row)), np.cumsum(ends), 1e7  # longer than any way
        lowered = np.where(free, row - columns, np.inf) - far * run
        found: FloatArray = np.minimum.accumulate(lowered) + far * run + columns
        return np.where(free & (found < 0.5 * far), np.minimum(row, found), row)
    row = row.copy()
    for c in range(1, len(row)):
        before = row[c - 1]
        if not free[c] or held[c - 1] or not np.isfinite(before):
            continue
        if before < opens[c - 1]:
            if not may_wait[c - 1]:
                continue
            before = opens[c - 1]
        row[c] = min(row[c], before + 1.0)
    return row


def _marks(steps: int, rests: Sequence[int]) -> BoolArray:
    found = np.zeros(steps + 1, dtype=np.bool_)
    found[list(rests)] = True
    found[steps] = True
    return found


def _largest(steps: int, rows: Sequence[tuple[int, int]]) -> FloatArray:
    """Returns the largest number that pairs of a place and a number have for each place, 0 for none."""
    found = np.zeros(steps + 1)
    for place, number in rows:
        found[place] = max(found[place], number)
    return found


def _traced(diagram: Diagram, time: FloatArray) -> DiagramPath:
    """Returns the way that leads to the end, backwards step by step."""
    (n, m), band = diagram.steps, diagram.band
    i, j = n, m
    waits: tuple[dict[int, int], dict[int, int]] = ({}, {})

    def at(i: int, j: int) -> float:
        c = j - i + band
        inside = i >= 0 and j >= 0 and 0 <= c <= 2 * band
        return float(time[i, c]) if inside else np.inf

    def left(i: int, j: int, moves: tuple[bool, bool]) -> float:
        own = np.array([at(i, j)])
        return float(diagram.leaving(own, i, np.array([j]), moves)[0]) + 1.0

    while i or j:
        now = at(i, j)
        tries = []
        # Of ways that are as quick the one on which an arm waits at its end, where it is in nobody's way.
        at_end = [(1, 0)] * (j == m) + [(0, 1)] * (i == n)
        for di, dj in (*at_end, (1, 1), (1, 0), (0, 1)):
            may = (di or diagram.may_wait[0][i]) and (dj or diagram.may_wait[1][j])
            if may and np.isfinite(at(i - di, j - dj)):
                tries.append((left(i - di, j - dj, (bool(di), bool(dj))), i - di, j - dj))
        _, before_i, before_j = min(tries, key=lambda one: abs(one[0] - now))
        length = round(now - at(before_i, before_j))
        for a, (place, before) in enumerate(((i, before_i), (j, before_j))):
            moved = place - before
            if length > moved:
                waits[a][before] = waits[a].get(before, 0) + length - moved
        i, j = before_i, before_j
    ends = tuple(
        tuple(sorted((place, wait) for place, wait in own.items() if place < steps))
        for own, steps in zip(waits, (n, m), strict=True)
    )
    return DiagramPath(int(time[n, m - n + band]), (ends[0], ends[1]))
