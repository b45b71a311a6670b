"""Coordination of two arms on fixed paths: the shortest path through their coordination diagram.

The state is the progress of each arm on its own timeline. Both advance, or one waits at a place where it rests. Pairs
of places at which the arms would collide, or at which one arm is ahead of a task that it has to wait for, are obstacles
in that plane [ODonnell1989]. Dynamic programming finds the shortest path from start to end.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class Diagram:
    """Coordination diagram of two timelines in equal steps."""

    steps: tuple[int, int]
    """Number of steps of each timeline."""
    rests: tuple[tuple[int, ...], tuple[int, ...]]
    """Places of each arm where it may wait, in steps.

    It may also wait at its end.
    """
    blocked: BoolArray
    """Forbidden pairs of places, shape (steps + 1, 2 band + 1).

    Column c of row i is step i + c - band of the second arm.
    """
    opens: tuple[tuple[tuple[int, int], ...], tuple[tuple[int, int], ...]] = ((), ())
    """Earliest departures of each arm: pairs (place, time) in steps."""
    needs: tuple[tuple[tuple[int, int], ...], tuple[tuple[int, int], ...]] = ((), ())
    """Places that the other arm must reach before an arm leaves.

    Pairs (place to leave, place to reach).
    """

    @property
    def band(self) -> int:
        """Maximum number of steps by which one arm may be ahead."""
        return (self.blocked.shape[1] - 1) // 2

    @cached_property
    def may_wait(self) -> list[BoolArray]:
        """Whether each arm may wait at its places, shape (steps + 1,)."""
        return [_marks(k, r) for k, r in zip(self.steps, self.rests, strict=True)]

    @cached_property
    def opening(self) -> list[FloatArray]:
        """Earliest departures from each arm's places [steps], shape (steps + 1,)."""
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
        """Compute the earliest departures from states [steps].

        Arms wait until they may move on, if both can wait. Infinite if the other arm has to advance first.

        Args:
            time: when the states are reached, shape (c,).
            i: place of the first arm.
            j: places of the second arm, shape (c,).
            moves: which arms move on.
        """
        may_wait, opens, needs = self.may_wait, self.opening, self.needed
        jj = np.clip(j, 0, len(opens[1]) - 1)
        earliest = np.zeros(len(time))
        if moves[0]:
            earliest = np.maximum(earliest, opens[0][i])
        if moves[1]:
            earliest = np.maximum(earliest, opens[1][jj])
        blocked = (moves[0] & (j < needs[0][i])) | (moves[1] & (i < needs[1][jj]))
        both_wait = may_wait[0][i] & may_wait[1][jj]
        departures = np.where(
            time >= earliest, time, np.where(both_wait, np.maximum(time, earliest), np.inf)
        )
        return np.where(blocked, np.inf, departures)


@dataclass(frozen=True)
class DiagramPath:
    """Path through the coordination diagram."""

    length: int
    """Duration [steps]."""
    waits: tuple[tuple[tuple[int, int], ...], tuple[tuple[int, int], ...]]
    """Waits of each arm, as pairs (place, number of steps)."""

    def place(self, a: int, time: int) -> int:
        """Compute an arm's place at a time, as if its timeline had no end."""
        waited = 0
        for at, wait in self.waits[a]:
            if time <= at + waited:
                break
            if time <= at + waited + wait:
                return at
            waited += wait
        return time - waited

    def arrival(self, a: int, place: int) -> int:
        """Compute the time of an arm's arrival at a place [steps]."""
        return place + sum(wait for at, wait in self.waits[a] if at < place)

    def departure(self, a: int, place: int) -> int:
        """Compute the time of an arm's departure from a place [steps]."""
        return place + sum(wait for at, wait in self.waits[a] if at <= place)


def quickest_path(diagram: Diagram) -> DiagramPath | None:
    """Compute the shortest path through the diagram, or None within its band."""
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
            # Both advance, or the first advances while the second waits (one column to the right, because i grows).
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
    row: FloatArray, free: BoolArray, may_wait: BoolArray, opens: FloatArray, blocked: BoolArray
) -> FloatArray:
    """Extend a row of times by steps in which the first arm waits.

    Args:
        row: times at which states are reached without such steps, shape (c,).
        free: whether states are not forbidden, shape (c,).
        may_wait: whether the second arm may wait, shape (c,).
        opens: earliest departures of the second arm, shape (c,).
        blocked: whether the second arm has to wait until the first one advances, shape (c,).
    """
    if not opens.any():
        # Prefix minima within each run of free states, plus one step for each state.
        ends = ~free
        ends[1:] |= blocked[:-1]
        columns, run, offset = np.arange(len(row)), np.cumsum(ends), 1e7  # longer than any path
        lowered = np.where(free, row - columns, np.inf) - offset * run
        reached: FloatArray = np.minimum.accumulate(lowered) + offset * run + columns
        return np.where(free & (reached < 0.5 * offset), np.minimum(row, reached), row)
    row = row.copy()
    for c in range(1, len(row)):
        before = row[c - 1]
        if not free[c] or blocked[c - 1] or not np.isfinite(before):
            continue
        if before < opens[c - 1]:
            if not may_wait[c - 1]:
                continue
            before = opens[c - 1]
        row[c] = min(row[c], before + 1.0)
    return row


def _marks(steps: int, rests: Sequence[int]) -> BoolArray:
    marks = np.zeros(steps + 1, dtype=np.bool_)
    marks[list(rests)] = True
    marks[steps] = True
    return marks


def _largest(steps: int, rows: Sequence[tuple[int, int]]) -> FloatArray:
    """Compute the largest number given for each place, 0 for none."""
    numbers = np.zeros(steps + 1)
    for place, number in rows:
        numbers[place] = max(numbers[place], number)
    return numbers


def _traced(diagram: Diagram, time: FloatArray) -> DiagramPath:
    """Trace the shortest path back from the end."""
    (n, m), band = diagram.steps, diagram.band
    i, j = n, m
    waits: tuple[dict[int, int], dict[int, int]] = ({}, {})

    def at(i: int, j: int) -> float:
        c = j - i + band
        inside = i >= 0 and j >= 0 and 0 <= c <= 2 * band
        return float(time[i, c]) if inside else np.inf

    def left(i: int, j: int, moves: tuple[bool, bool]) -> float:
        times = np.array([at(i, j)])
        return float(diagram.leaving(times, i, np.array([j]), moves)[0]) + 1.0

    while i or j:
        now = at(i, j)
        candidates = []
        # Among equal paths an arm waits at its end, where it does not obstruct the other one.
        at_end = [(1, 0)] * (j == m) + [(0, 1)] * (i == n)
        for di, dj in (*at_end, (1, 1), (1, 0), (0, 1)):
            may = (di or diagram.may_wait[0][i]) and (dj or diagram.may_wait[1][j])
            if may and np.isfinite(at(i - di, j - dj)):
                candidates.append((left(i - di, j - dj, (bool(di), bool(dj))), i - di, j - dj))
        _, before_i, before_j = min(candidates, key=lambda step: abs(step[0] - now))
        length = round(now - at(before_i, before_j))
        for a, (place, before) in enumerate(((i, before_i), (j, before_j))):
            moved = place - before
            if length > moved:
                waits[a][before] = waits[a].get(before, 0) + length - moved
        i, j = before_i, before_j
    ends = tuple(
        tuple(sorted((place, wait) for place, wait in arm_waits.items() if place < steps))
        for arm_waits, steps in zip(waits, (n, m), strict=True)
    )
    return DiagramPath(int(time[n, m - n + band]), (ends[0], ends[1]))
