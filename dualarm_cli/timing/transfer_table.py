"""Transfer times of all pairs of postures, looked up: fast enough for hundreds of millions of them."""

from __future__ import annotations

from dataclasses import field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dualarm_cli.compiled.transfer_times import (
    CellRuns,
    Laws,
    LineEnds,
    boxes,
    gap_times,
    least_by_groups,
    least_from,
    least_work,
)
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.model.rest_to_rest import RestToRest
from dualarm_cli.records import dataclass

SAME_LAW = 0.03
"""Laws whose constants differ by less than this share are taken as one, the quickest."""
STEPS = 32_000
"""Steps of the table over the widest joint's range; differences of coordinates then fit 16 bits."""
WIDEST = 4.0 * np.pi
"""Range of a joint without position limits beyond which the table does not distinguish [rad]."""

Coordinates = NDArray[np.int16]
"""Joints in steps of a table, coordinate first."""
Times = NDArray[np.float32]
RUN = 32
"""Most cells of one run."""


@dataclass(frozen=True)
class _Class:
    """Joints with one law in units of their speed."""

    columns: tuple[int, ...]
    """Which coordinates."""
    time: NDArray[np.float32]
    """Time [s] of a distance of so many steps, one step less, shape (STEPS + 1,)."""


@dataclass(frozen=True)
class TransferTable:
    """Times of a group of joints that move together, at the resolution of a table.

    A joint's displacement in units of its speed needs T(d / v), the same T for all joints whose limits stand in the
    same proportions; the slowest joint is then the one with the largest d / v, and one look-up serves all. As
    rounding two coordinates can make one step, a step less is looked up: times are never above the closed form.
    """

    scale: FloatArray
    """Steps per radian of each joint, shape (c,)."""
    middle: FloatArray
    """Middle of each joint's range [rad], shape (c,)."""
    classes: tuple[_Class, ...]
    """Joints by law."""
    _laws: dict[tuple[int, ...], Laws] = field(default_factory=dict, compare=False, repr=False)
    """The table for the compiled functions, by the coordinates that do not count."""

    @classmethod
    def of(cls, laws: list[RestToRest], lower: FloatArray, upper: FloatArray) -> TransferTable:
        """Returns the table of several groups of joints, their columns one after the other.

        Args:
            laws: of each group.
            lower: lowest position of every joint [rad], shape (c,), -inf allowed.
            upper: highest position [rad], shape (c,), inf allowed.
        """
        bounded = np.isfinite(lower) & np.isfinite(upper)
        low, high = np.where(bounded, lower, -0.5 * WIDEST), np.where(bounded, upper, 0.5 * WIDEST)
        span, middle = high - low, 0.5 * (low + high)
        velocity = np.concatenate([law.velocity for law in laws])
        acceleration = np.concatenate([law.acceleration for law in laws]) / velocity
        jerk = np.concatenate([law.jerk for law in laws]) / velocity
        step = float((span / velocity).max()) / STEPS
        classes = []
        left = list(range(len(velocity)))
        while left:
            first = left[0]
            alike = [
                c
                for c in left
                if abs(acceleration[c] / acceleration[first] - 1.0) <= SAME_LAW
                and (jerk[c] == jerk[first] or abs(jerk[c] / jerk[first] - 1.0) <= SAME_LAW)
            ]
            law = RestToRest(
                np.ones(1), acceleration[alike].max(keepdims=True), jerk[alike].max(keepdims=True)
            )
            distance = np.maximum(np.arange(STEPS + 1) - 1.0, 0.0) * step
            classes.append(_Class(tuple(alike), law.duration(distance[:, None]).astype(np.float32)))
            left = [c for c in left if c not in alike]
        return cls(1.0 / (velocity * step), middle, tuple(classes))

    def coordinates(self, joints: FloatArray) -> Coordinates:
        """Returns joints (n, c) [rad] in steps, coordinate first, shape (c, n)."""
        steps = np.round((joints - self.middle) * self.scale).T
        half = STEPS // 2
        return np.ascontiguousarray(np.clip(steps, -half, half).astype(np.int16))

    def joints(self, coordinates: Coordinates) -> FloatArray:
        """Returns joints (n, c) [rad] from steps (c, n), to half a step."""
        return coordinates.T / self.scale + self.middle

    def box(self, low: FloatArray, high: FloatArray) -> tuple[Coordinates, Coordinates]:
        """Returns boxes of joints in steps, rounded outward, coordinate first, shape (c, n) each.

        Args:
            low: lowest joints [rad], shape (n, c), -inf allowed.
            high: highest joints [rad], shape (n, c), inf allowed.
        """
        half = STEPS // 2
        bottom, top = ((x - self.middle) * self.scale for x in (low, high))
        steps = np.floor(np.clip(bottom, -half, half)), np.ceil(np.clip(top, -half, half))
        return tuple(np.ascontiguousarray(x.T.astype(np.int16)) for x in steps)  # type: ignore[return-value]

    def gap_times(
        self,
        low: Coordinates,
        high: Coordinates,
        goal_low: Coordinates,
        goal_high: Coordinates,
        without: tuple[int, ...] = (),
    ) -> NDArray[np.float32]:
        """Returns the least times between all pairs of boxes [s], shape (n, m): from the nearest points of each.

        Args:
            low: lowest coordinates of the boxes where transfers begin, shape (c, n).
            high: highest ones.
            goal_low: lowest coordinates of the boxes where they end, shape (c, m).
            goal_high: highest ones.
            without: coordinates that do not count.
        """
        return gap_times(self.laws(without), boxes(low, high), boxes(goal_low, goal_high))

    def times(
        self, start: Coordinates, goal: Coordinates, without: tuple[int, ...] = ()
    ) -> NDArray[np.float32]:
        """Returns the times of all pairs [s], shape (n, m).

        Args:
            start: in steps, shape (c, n).
            goal: in steps, shape (c, m).
            without: coordinates that do not count.
        """
        return self.gap_times(start, start, goal, goal, without)

    def laws(self, without: tuple[int, ...] = ()) -> Laws:
        """Returns the table for the compiled functions.

        Args:
            without: coordinates that do not count.
        """
        if without not in self._laws:
            kept = [[c for c in group.columns if c not in without] for group in self.classes]
            tables = np.stack([group.time for group in self.classes])
            columns = np.array([c for own in kept for c in own], dtype=np.int32)
            ends = np.cumsum([len(own) for own in kept], dtype=np.int32)
            self._laws[without] = Laws.of(tables, columns, ends)
        return self._laws[without]


def rows_of(coordinates: Coordinates, rows: IntArray) -> Coordinates:
    """Returns the coordinates of some postures."""
    return np.ascontiguousarray(coordinates[:, rows])


@dataclass(frozen=True)
class PostureBoxes:
    """Boxes of postures in steps of a table, rounded outward; n of them."""

    index: IntArray
    """Platform cell of each, ascending, shape (n,)."""
    kind: IntArray
    """Branch or the like: only boxes of one kind share a run, shape (n,)."""
    low: Coordinates
    """Lowest joints and platform, shape (c, n)."""
    high: Coordinates
    """Highest ones, shape (c, n)."""
    line: Times
    """Least time of the line at this end [s], shape (n,)."""

    def ends(self, groups: int) -> LineEnds:
        """Return the boxes as one end of lines, in so many platform cells."""
        first = np.searchsorted(self.index, np.arange(groups + 1)).astype(np.int64)
        return LineEnds.of(boxes(self.low, self.high), first, self.line)

    @cached_property
    def runs(self) -> CellRuns:
        """The boxes in runs of neighbours in platform cell, branch and arm angle."""
        n = len(self.index)
        change = (np.diff(self.index) != 0) | (np.diff(self.kind) != 0)
        begins = np.concatenate([[True], change])
        start = np.maximum.accumulate(np.where(begins, np.arange(n), 0))
        first = np.flatnonzero((np.arange(n) - start) % RUN == 0)
        low = np.minimum.reduceat(self.low, first, axis=1)
        high = np.maximum.reduceat(self.high, first, axis=1)
        index = np.ascontiguousarray(self.index, dtype=np.int64)
        cells = boxes(self.low, self.high)
        return CellRuns.of(cells, index, boxes(low, high), np.append(first, n))


@dataclass(frozen=True)
class Pairs:
    """Transfers or lines from some cells (n) to others (m), of g platform cells.

    Pairs of runs are looked at in order of what they can give at best, and their cells only while that may be better
    than what is found.
    """

    table: TransferTable
    """Their times."""
    before: PostureBoxes
    """Posture boxes where the motions begin, n of them."""
    after: PostureBoxes
    """Posture boxes where the motions end, m of them."""
    without: tuple[int, ...]
    """Coordinates that do not count."""

    @property
    def _laws(self) -> Laws:
        return self.table.laws(self.without)

    def by_cells(self, work: Times, cells: int) -> Times:
        """Compute the least transfer plus work between platform cells [s], shape (g, g).

        A pair of platform cells without a transfer has an infinite sum.

        Args:
            work: least work of each cell where a transfer ends [s], shape (m,).
            cells: number g of platform cells.
        """
        least = np.full((cells, cells), np.inf, dtype=np.float32)
        least_by_groups(self._laws, self.before.runs, self.after.runs, work, least)
        return least

    def least_from(self, own: Times, floor: Times, beyond: Times) -> Times:
        """Minimise max(transfer + own, floor + beyond) over each cell's pairs, shape (n,).

        Args:
            own: from each cell where a transfer ends, the arm's work and all the rest [s], shape (m,).
            floor: least length of the stage for every pair of platform cells [s], shape (g, g).
            beyond: from each cell where a transfer ends, all the rest alone [s], shape (m,).
        """
        return least_from(self._laws, self.before.runs, self.after.runs, own, floor, beyond)

    @cached_property
    def _line_ends(self) -> tuple[int, LineEnds, LineEnds]:
        """Number of platform cells, and both ends for the compiled function."""
        cells = 1 + int(max(self.before.index[-1], self.after.index[-1]))
        return cells, self.before.ends(cells), self.after.ends(cells)

    def least_within(self, rest: Times) -> tuple[Times, Times]:
        """Compute least sums within one platform cell: of line and rest, and of the rest alone [s], shape (n,) each.

        Args:
            rest: after each cell where a line ends [s], shape (m,).
        """
        cells, before, after = self._line_ends
        present, first = np.unique(self.after.index, return_index=True)
        alone = np.full(cells, np.inf, dtype=np.float32)
        alone[present] = np.minimum.reduceat(rest, first)
        sums = least_work(self._laws, before, after, cells, rest)
        return sums, alone[self.before.index]
