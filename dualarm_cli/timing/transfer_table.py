"""Tabulated transfer times between all pairs of postures, for hundreds of millions of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dualarm_cli.compiled.transfer_times import (
    CellRuns,
    JointChains,
    Laws,
    LineEnds,
    boxes,
    gap_times,
    least_by_groups,
    least_from,
    least_work,
)
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.model.motion.rest_to_rest import PassingLaw, RestToRest
from dualarm_cli.records import dataclass

SAME_LAW = 0.03
"""Relative difference below which timing laws share a table, that of the fastest."""
STEPS = 32_000
"""Steps of the table over the widest joint range; differences then fit 16 bits."""
WIDEST = 4.0 * np.pi
"""Tabulated range of a joint without position limits [rad]."""

Coordinates = NDArray[np.int16]
"""Joint values in steps of a table, coordinate first."""
Times = NDArray[np.float32]
REST_TO_ANY = 2
"""Row of the motions from rest to any speed in the tables of chains."""
STEPS_PER_ENTRY = 4
"""Steps per entry of the tables of chains, in compiled code as well."""
RUN = 32
"""Maximum number of cells of one run."""


@dataclass(frozen=True)
class _Class:
    """Joints that share a timing law in units of their speed."""

    columns: tuple[int, ...]
    """Columns of the coordinates."""
    time: NDArray[np.float32]
    """Time [s] of a distance in steps, rounded down by one step, shape (STEPS + 1,)."""


@dataclass(frozen=True)
class ChainLaws:
    """Laws of joints that pass line ends in motion, in units of their speed."""

    law: PassingLaw
    """Limits of each law."""
    times: Times
    """Times of the motions of chains by distance [s], shape (laws, 5, entries)."""
    number: NDArray[np.int32]
    """Law of each joint, -1 for those that do not count, shape (c,)."""

    def speeds(self, line: Times) -> Times:
        """Compute the greatest shares of full speed after times from rest [s], shape (laws, n)."""
        speed = self.law.reachable_speed(line[:, None].astype(np.float64))
        return np.ascontiguousarray(speed.T, dtype=np.float32)


@dataclass(frozen=True)
class TransferTable:
    """Tabulated transfer times of joints that move together.

    A joint's displacement in units of its speed needs T(d / v), the same T for all joints whose limits stand in the
    same proportions; the slowest joint is then the one with the largest d / v, and one look-up is enough. Because
    rounding two coordinates can add one step, a step less is looked up: times are never above the closed form.
    """

    scale: FloatArray
    """Steps per radian of each joint, shape (c,)."""
    middle: FloatArray
    """Middle of each joint's range [rad], shape (c,)."""
    classes: tuple[_Class, ...]
    """Joints by law."""
    step: float
    """Time of a step at full speed [s]."""
    chains: ChainLaws | None
    """Laws of the chains of joints; None for motions from rest to rest."""
    _laws: dict[tuple[int, ...], Laws] = field(default_factory=dict, compare=False, repr=False)
    """Table for the compiled functions, by excluded coordinates."""
    _line_laws: dict[tuple[int, ...], Laws] = field(default_factory=dict, compare=False, repr=False)
    """The same of lines from rest."""

    @classmethod
    def of(cls, laws: list[RestToRest], lower: FloatArray, upper: FloatArray) -> TransferTable:
        """Build the table of several groups of joints, with consecutive columns.

        Args:
            laws: timing law of each group.
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
        limits = list(zip(acceleration.tolist(), jerk.tolist(), strict=True))
        classes = []
        remaining = list(range(len(velocity)))
        while remaining:
            first = remaining[0]
            same_law = [c for c in remaining if _is_same_law(limits[c], limits[first])]
            law = RestToRest(
                np.ones(1),
                acceleration[same_law].max(keepdims=True),
                jerk[same_law].max(keepdims=True),
            )
            distance = np.maximum(np.arange(STEPS + 1) - 1.0, 0.0) * step
            classes.append(
                _Class(tuple(same_law), law.duration(distance[:, None]).astype(np.float32))
            )
            remaining = [c for c in remaining if c not in same_law]
        return cls(1.0 / (velocity * step), middle, tuple(classes), step, _chain_laws(laws, step))

    def coordinates(self, joints: FloatArray) -> Coordinates:
        """Convert joints (n, c) [rad] to steps, coordinate first, shape (c, n)."""
        steps = np.round((joints - self.middle) * self.scale).T
        half = STEPS // 2
        return np.ascontiguousarray(np.clip(steps, -half, half).astype(np.int16))

    def joints(self, coordinates: Coordinates) -> FloatArray:
        """Convert steps (c, n) to joints (n, c) [rad], within half a step."""
        return coordinates.T / self.scale + self.middle

    def box(self, low: FloatArray, high: FloatArray) -> tuple[Coordinates, Coordinates]:
        """Convert boxes of joints to steps, rounded outward, shape (c, n) each.

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
        """Compute the minimum times between all pairs of boxes [s], shape (n, m).

        They are those between nearest points.

        Args:
            low: lowest coordinates of the start boxes, shape (c, n).
            high: highest coordinates of the start boxes, shape (c, n).
            goal_low: lowest coordinates of the goal boxes, shape (c, m).
            goal_high: highest coordinates of the goal boxes, shape (c, m).
            without: coordinates to exclude.
        """
        return gap_times(self.laws(without), boxes(low, high), boxes(goal_low, goal_high))

    def times(
        self, start: Coordinates, goal: Coordinates, without: tuple[int, ...] = ()
    ) -> NDArray[np.float32]:
        """Compute the times of all pairs [s], shape (n, m).

        Args:
            start: in steps, shape (c, n).
            goal: in steps, shape (c, m).
            without: coordinates to exclude.
        """
        return self.gap_times(start, start, goal, goal, without)

    def laws(self, without: tuple[int, ...] = ()) -> Laws:
        """Prepare the table for the compiled functions.

        Args:
            without: coordinates to exclude.
        """
        if without not in self._laws:
            times = np.stack([group.time for group in self.classes])
            groups = [group.columns for group in self.classes]
            self._laws[without] = _laws_without(times, groups, without)
        return self._laws[without]

    def line_laws(self, without: tuple[int, ...]) -> Laws:
        """Prepare the least times of lines from rest for the compiled functions.

        To any speed where lines are passed in motion, else to rest. They are not above a distance at full speed less
        than that of the longest one: travel then grows ever faster with time.

        Args:
            without: coordinates to exclude.
        """
        if without not in self._line_laws:
            times = np.stack([group.time for group in self.classes])
            groups: list[Sequence[int]] = [group.columns for group in self.classes]
            if self.chains is not None:
                times = np.repeat(self.chains.times[:, REST_TO_ANY], STEPS_PER_ENTRY, axis=1)
                times = times[:, : STEPS + 1]
                numbers = range(len(times))
                groups = [np.flatnonzero(self.chains.number == k).tolist() for k in numbers]
            shorter = np.float32(self.step) * np.arange(STEPS, -1, -1, dtype=np.float32)
            least = np.ascontiguousarray(np.minimum(times, times[:, -1:] - shorter))
            self._line_laws[without] = _laws_without(least, groups, without)
        return self._line_laws[without]


def _laws_without(times: Times, groups: Sequence[Sequence[int]], without: tuple[int, ...]) -> Laws:
    """Give tables of times their columns, except for some.

    Args:
        times: a table for each group [s], shape (groups, STEPS + 1).
        groups: columns of each table.
        without: coordinates to exclude.
    """
    kept = [[c for c in group if c not in without] for group in groups]
    columns = np.array([c for group in kept for c in group], dtype=np.int32)
    return Laws.of(times, columns, np.cumsum([len(group) for group in kept], dtype=np.int32))


def _is_same_law(limits: tuple[float, float], shared: tuple[float, float]) -> bool:
    """Check whether limits of acceleration and jerk per speed are nearly the same."""
    return all(x == y or abs(x / y - 1.0) <= SAME_LAW for x, y in zip(limits, shared, strict=True))


def _chain_laws(laws: list[RestToRest], step: float) -> ChainLaws | None:
    """Tabulate the motions of chains; joints whose limits stand in the same proportions share a table."""
    keys, numbers = list[tuple[float, float]](), []
    for law in laws:
        if not isinstance(law, PassingLaw):
            numbers += [-1] * len(law.velocity)
            continue
        rest = law.rest_law
        a, j = rest.acceleration / rest.velocity, rest.jerk / rest.velocity
        for key in zip(a.tolist(), j.tolist(), strict=True):
            k = next((k for k, limits in enumerate(keys) if _is_same_law(key, limits)), len(keys))
            fastest = np.maximum(key, keys[k]) if k < len(keys) else np.array(key)
            keys[k : k + 1] = [(float(fastest[0]), float(fastest[1]))]
            numbers.append(k)
    if not keys:
        return None
    distance: FloatArray = np.arange(STEPS // STEPS_PER_ENTRY + 1.0) * (STEPS_PER_ENTRY * step)
    scaled = PassingLaw.of(RestToRest(np.ones(len(keys)), *np.array(keys).T))
    times = scaled.chain_times(np.tile(distance[:, None], (1, len(keys)))).transpose(2, 0, 1)
    rounded = np.ascontiguousarray(np.nextafter(times.astype(np.float32), np.float32(0.0)))
    return ChainLaws(scaled, rounded, np.array(numbers, dtype=np.int32))


def rows_of(coordinates: Coordinates, rows: IntArray) -> Coordinates:
    """Select the coordinates of the given postures."""
    return np.ascontiguousarray(coordinates[:, rows])


@dataclass(frozen=True)
class PostureBoxes:
    """Boxes of postures in steps of a table, rounded outward; n of them."""

    index: IntArray
    """Platform cell of each box, ascending, shape (n,)."""
    kind: IntArray
    """Class of each box, such as its branch; runs have one class, shape (n,)."""
    low: Coordinates
    """Lowest joint and platform values, shape (c, n)."""
    high: Coordinates
    """Highest joint and platform values, shape (c, n)."""
    line: Times
    """Minimum time of the line at this end [s], shape (n,)."""
    displacement: Coordinates | None = None
    """Least displacements on the line towards the target [steps]: rises, then falls; shape (2, c, n).

    -1 for joints that need not rise or fall. None if nothing passes in motion.
    """
    late: float = 0.0
    """Time beyond `line` from which on displacements need not hold [s]; infinite without a line."""

    @property
    def at_target(self) -> bool:
        """Flag of ends without lines, where joints are at rest at the target."""
        return self.displacement is not None and np.isinf(self.late)

    def ends(self, groups: int, laws: Laws) -> LineEnds:
        """Group the boxes by platform cell, as one end of lines."""
        first = np.searchsorted(self.index, np.arange(groups + 1)).astype(np.int64)
        travel = np.stack([np.searchsorted(times, self.line, "right") for times in laws.held[0]])
        return LineEnds.of(boxes(self.low, self.high), first, self.line, travel.astype(np.int16))

    @cached_property
    def first_of_runs(self) -> IntArray:
        """First box of each run."""
        n = len(self.index)
        change = (np.diff(self.index) != 0) | (np.diff(self.kind) != 0)
        begins = np.concatenate([[True], change])
        start = np.maximum.accumulate(np.where(begins, np.arange(n), 0))
        return np.flatnonzero((np.arange(n) - start) % RUN == 0)

    @cached_property
    def runs(self) -> CellRuns:
        """Runs of boxes that are neighbours in platform cell, branch and arm angle."""
        first = self.first_of_runs
        low = np.minimum.reduceat(self.low, first, axis=1)
        high = np.maximum.reduceat(self.high, first, axis=1)
        index = np.ascontiguousarray(self.index, dtype=np.int64)
        cells = boxes(self.low, self.high)
        return CellRuns.of(cells, index, boxes(low, high), np.append(first, len(self.index)))


@dataclass(frozen=True)
class Pairs:
    """Transfers or lines from n cells to m others, of g platform cells.

    Pairs of runs are examined in order of their lower bounds, and their cells only while they may improve the result.
    """

    table: TransferTable
    """Table of times."""
    before: PostureBoxes
    """Boxes of postures at the starts of motions, n of them."""
    after: PostureBoxes
    """Boxes of postures at the ends of motions, m of them."""
    without: tuple[int, ...]
    """Coordinates to exclude."""

    @property
    def _laws(self) -> Laws:
        return self.table.laws(self.without)

    @cached_property
    def _speeds(self) -> tuple[Times, ...]:
        """Greatest shares of full speed at the ends of lines, shape (laws, n) each.

        Before transfers, after them, and over the runs of those after.
        """
        chains, line = self.table.chains, self.after.line
        assert chains is not None  # only motions that pass have speeds
        of_runs = np.maximum.reduceat(line, self.after.first_of_runs)
        return tuple(map(chains.speeds, (self.before.line, line, of_runs)))

    @cached_property
    def _line_ends(self) -> tuple[LineEnds, LineEnds]:
        """Both ends of lines in the same platform cell."""
        laws = self.table.line_laws(self.without)
        return self.before.ends(self._cells, laws), self.after.ends(self._cells, laws)

    @property
    def _cells(self) -> int:
        """Number of platform cells up to the last one with boxes."""
        return 1 + int(max(self.before.index[-1], self.after.index[-1]))

    def _chains(self, onward: Times, from_target: bool) -> JointChains | None:
        """Prepare the chains of joints for the compiled functions, or None."""
        before, after, chains = self.before, self.after, self.table.chains
        if after.displacement is None or before.displacement is None or chains is None:
            return None
        displacements = before.displacement if from_target else None, after.displacement
        lines = (before.line, before.late), (after.line, after.late)
        rate = chains.law.rest_law.acceleration.astype(np.float32)
        laws = chains.times, rate, chains.number, self.table.step
        return JointChains.of(displacements, lines, self._speeds, onward, laws)

    def by_cells(self, work: Times, cells: int) -> Times:
        """Compute the minimum transfer plus work between platform cells [s], shape (g, g).

        Joints may turn back at once. A pair of platform cells without a transfer has an infinite sum.

        Args:
            work: minimum work of each cell at a transfer's end [s], shape (m,).
            cells: number g of platform cells.
        """
        least = np.full((cells, cells), np.inf, dtype=np.float32)
        chains = self._chains(work, from_target=self.before.at_target)
        least_by_groups(self._laws, self.before.runs, self.after.runs, work, least, chains)
        return least

    def least_from(
        self, arm_rest: Times, onward: Times, floor: Times, beyond: Times
    ) -> tuple[Times, Times]:
        """Minimise max(transfer + arm_rest, floor + beyond) over each cell's pairs, shape (n,) each.

        After the retract from the target before, and after any motion.

        Args:
            arm_rest: remaining time with the arm's own work, from each cell at a transfer's end [s], shape (m,).
            onward: remaining time from the target on for each of these cells [s], shape (m,).
            floor: minimum duration of the stage for each pair of platform cells [s], shape (g, g).
            beyond: remaining time without it, from each cell at a transfer's end [s], shape (m,).
        """
        ends = arm_rest, self._chains(onward, from_target=True)
        runs = self.before.runs, self.after.runs
        least, plain = least_from(self._laws, *runs, ends, floor, beyond)
        return least, least if self.before.at_target else plain

    def least_within(self, rest: Times, turned: Times) -> Times:
        """Minimise line plus rest in one platform cell [s], shape (n,).

        Args:
            rest: remaining time after each cell at a line's end [s], shape (m,).
            turned: the same, no less than `rest`, where both lines take their least times.
        """
        longer = np.subtract(turned, rest, out=np.zeros_like(rest), where=np.isfinite(rest))
        laws, rests = self.table.line_laws(self.without), (self.after.line + longer, rest)
        return least_work(laws, *self._line_ends, self._cells, rests)

    def least_in_cell(self, times: Times) -> Times:
        """Select the least time in the platform cell of each begin [s], shape (n,).

        Args:
            times: time of each cell at a motion's end [s], shape (m,).
        """
        present, first = np.unique(self.after.index, return_index=True)
        least = np.full(self._cells, np.inf, dtype=np.float32)
        least[present] = np.minimum.reduceat(times, first)
        return least[self.before.index]
