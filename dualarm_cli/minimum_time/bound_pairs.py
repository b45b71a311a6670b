"""Least transfers between all pairs of cells, as minima: pairs that cannot be among them are not looked at."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, IntArray
from dualarm_cli.minimum_time.bound_layers import Boxes, Times
from dualarm_cli.minimum_time.transfer_table import TransferTable

FEW = 4_000_000
"""So many pairs are looked at one and all, and kept."""
RUN = 32
"""Most cells of one run."""
ROWS = 64
"""Rows of a block of pairs: small enough for the cache."""
FIRST = 24
"""Runs with the least bounds are looked at first: a share of 1/FIRST of all."""


@dataclass(frozen=True)
class Runs:
    """Cells next to each other in platform cell, branch and arm angle, and the boxes around them; b of them."""

    first: IntArray
    """Number of the first cell of each, shape (b,)."""
    size: IntArray
    """How many cells it has, shape (b,)."""
    boxes: Boxes
    """Around each."""

    @classmethod
    def of(cls, cells: Boxes) -> Runs:
        """Returns the runs of cells that are in order."""
        n = len(cells.index)
        change = (np.diff(cells.index) != 0) | (np.diff(cells.kind) != 0)
        begins = np.concatenate([[True], change])
        start = np.maximum.accumulate(np.where(begins, np.arange(n), 0))
        first = np.flatnonzero((np.arange(n) - start) % RUN == 0)
        boxes = Boxes(
            cells.index[first],
            cells.kind[first],
            np.minimum.reduceat(cells.low, first, axis=1),
            np.maximum.reduceat(cells.high, first, axis=1),
            np.minimum.reduceat(cells.line, first),
        )
        return cls(first, np.diff(np.append(first, n)), boxes)

    def rows(self, number: int) -> slice:
        """Returns where the cells of one run are."""
        first = int(self.first[number])
        return slice(first, first + int(self.size[number]))

    def cells(self, chosen: BoolArray) -> IntArray:
        """Returns the numbers of the cells of chosen runs."""
        return np.flatnonzero(np.repeat(chosen, self.size))

    def least(self, values: Times) -> Times:
        """Returns the least value in each run, shape (b,)."""
        least: Times = np.minimum.reduceat(values, self.first)
        return least


@dataclass(frozen=True)
class Pairs:
    """Transfers from some cells (n) to others (m)."""

    table: TransferTable
    """Their times."""
    before: Boxes
    """Where they begin."""
    after: Boxes
    """Where they end."""
    without: tuple[int, ...]
    """Coordinates that do not count."""

    @cached_property
    def few(self) -> bool:
        """Whether all pairs are looked at."""
        return len(self.before.index) * len(self.after.index) <= FEW

    @cached_property
    def every(self) -> Times:
        """Least time of every pair [s], shape (n, m)."""
        return self._times(slice(None), slice(None))

    @cached_property
    def runs(self) -> tuple[Runs, Runs, Times]:
        """Runs of both sides, and the least time between any two [s]."""
        rows, columns = Runs.of(self.before), Runs.of(self.after)
        a, b = rows.boxes, columns.boxes
        return (
            rows,
            columns,
            self.table.gap_times(a.low, a.high, b.low, b.high, self.without),
        )

    def _times(self, rows: slice, columns: IntArray | slice) -> Times:
        a, b = self.before, self.after
        return self.table.gap_times(
            a.low[:, rows], a.high[:, rows], b.low[:, columns], b.high[:, columns], self.without
        )

    def by_cells(self, work: Times, cells: int) -> Times:
        """Returns the least of transfer and work for every pair of platform cells [s], (g, g), infinite for none.

        Args:
            work: least work of each cell where a transfer ends [s], shape (m,).
            cells: number g of platform cells.
        """
        table = np.full((cells, cells), np.inf, dtype=np.float32)
        if self.few:
            columns, first = np.unique(self.after.index, return_index=True)
            least = np.minimum.reduceat(self.every + work, first, axis=1)
            rows, first = np.unique(self.before.index, return_index=True)
            table[np.ix_(rows, columns)] = np.minimum.reduceat(least, first, axis=0)
            return table
        origins, goals, times = self.runs
        least_work = goals.least(work)
        index = goals.boxes.index
        _, group = np.unique(index, return_index=True)
        sizes = np.diff(np.append(group, len(index)))
        for k, cell in enumerate(origins.boxes.index):
            best = table[cell]
            bound = times[k] + least_work
            # The most promising run of every platform cell first, then all that may still be better.
            promising = bound <= np.repeat(np.minimum.reduceat(bound, group), sizes)
            promising &= bound < best[index]
            self._lower(best, origins.rows(k), goals.cells(promising), work)
            rest = (bound < best[index]) & ~promising
            self._lower(best, origins.rows(k), goals.cells(rest), work)
        return table

    def _lower(self, best: Times, rows: slice, columns: IntArray, work: Times) -> None:
        """Lowers one row of `by_cells` to the least of some pairs."""
        if len(columns):
            least = self._times(rows, columns).min(axis=0) + work[columns]
            index, first = np.unique(self.after.index[columns], return_index=True)
            best[index] = np.minimum(best[index], np.minimum.reduceat(least, first))

    def least_from(self, own: Times, floor: Times, beyond: Times) -> Times:
        """Returns min over the pairs of max(transfer + own, floor + beyond), shape (n,).

        Args:
            own: from each cell where a transfer ends, the arm's work and all the rest [s], shape (m,).
            floor: least length of the stage for every pair of platform cells [s], shape (g, g).
            beyond: from each cell where a transfer ends, all the rest alone [s], shape (m,).
        """
        index = self.after.index
        result = np.empty(len(self.before.index), dtype=np.float32)
        if self.few:
            for k in range(0, len(result), ROWS):
                rows = slice(k, k + ROWS)
                floors = floor[self.before.index[rows]][:, index] + beyond
                result[rows] = np.maximum(self.every[rows] + own, floors).min(axis=1)
            return result
        origins, goals, times = self.runs
        least_own, least_beyond = goals.least(own), goals.least(beyond)
        number = len(goals.first) // FIRST
        for k, cell in enumerate(origins.boxes.index):
            rows, floors = origins.rows(k), floor[cell]
            bound = np.maximum(times[k] + least_own, floors[goals.boxes.index] + least_beyond)
            promising = bound <= np.partition(bound, number)[number]
            best = np.full(origins.size[k], np.inf, dtype=np.float32)
            for chosen in (promising, ~promising):
                some = goals.cells(chosen & (bound < best.max()))
                if len(some):
                    sums = self._times(rows, some)
                    sums += own[some]
                    np.maximum(sums, floors[index[some]] + beyond[some], out=sums)
                    best = np.minimum(best, sums.min(axis=1))
            result[rows] = best
        return result
