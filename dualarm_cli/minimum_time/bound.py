"""A lower bound on every rest-to-rest plan of a sequence: dynamic programming over cells that cover all postures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.minimum_time.bound_cells import Resolution
from dualarm_cli.minimum_time.bound_layers import StopBoxes, Times, stop_boxes
from dualarm_cli.minimum_time.potentials import LAST_JOINT, platform_columns, transfer_table
from dualarm_cli.minimum_time.problem import SequenceProblem
from dualarm_cli.minimum_time.stops import StopTable
from dualarm_cli.minimum_time.times import Chain
from dualarm_cli.minimum_time.transfer_table import TransferTable

ASSUMPTIONS = (
    "lower bound: holds for every plan that keeps the order and pairing of the stages, is at rest at the ends of all "
    "transfers and lines, keeps the platform still during lines and dwells, and follows the lines exactly and without "
    "turning back, whatever platform angles, postures, yaws and timing it takes",
)
RESOLUTIONS = {
    "quick": Resolution(np.radians(20.0), 9, 2),
    "normal": Resolution(np.radians(15.0), 9, 3),
    "thorough": Resolution(np.radians(5.0), 36, 3),
}
"""By effort."""
ROUNDED_DOWN = 1.0 - 1e-5
"""What a bound in single precision is multiplied by."""
ROWS = 64
"""Rows of a block of pairs of cells: small enough for the cache."""


@dataclass(frozen=True)
class LowerBound:
    """No plan is faster."""

    value: float
    """Least cycle time [s]; infinite where the cells prove that a stop cannot be reached."""
    assumptions: tuple[str, ...]
    """What a plan must be like for the bound to hold, in sentences."""


@dataclass
class _Arm:
    """One arm while the stages are gone through backwards."""

    table: TransferTable
    chain: Chain
    stops: StopTable
    left: Times | None = None
    """Least time from each cell in which the later stop's transfer ends, that transfer's end included [s]."""
    later: StopBoxes | None = None
    """The later stop, whose transfer is still to come."""
    rest: float = 0.0
    """Least time of the stages after the arm's last stop [s]."""


def lower_bound(problem: SequenceProblem, effort: str) -> LowerBound:
    """Returns a bound on the cycle time of every rest-to-rest plan that keeps the stages.

    All postures of a stop are covered by cells of platform angle, arm angle and branch with enclosures of all joints
    (`bound_cells`). A transfer between two cells takes at least the time of its slowest joint over the gap between
    the enclosures, the platform's likewise; lines take at least `line_bounds` and, between the cells at their outer
    ends, the rest-to-rest time of the joints (times are concave in the distance, so that two moves in a row take no
    less than one over both ways). Backward dynamic programming per arm; in every stage the other arm counts with its
    least time for the same two platform cells. The larger of both arms' results holds for every plan.

    Args:
        problem: the sequence.
        effort: one of RESOLUTIONS: finer cells give a better bound.
    """
    resolution = RESOLUTIONS[effort]
    edges = platform_edges(problem, resolution.step)
    arms = [
        _Arm(transfer_table(problem, work), Chain.of(work), StopTable.of(work))
        for work in problem.arms
    ]
    value = 0.0
    if problem.stages:
        value = _backward(problem, arms, edges, resolution)
    return LowerBound(max(0.0, value * ROUNDED_DOWN), ASSUMPTIONS)


def platform_edges(problem: SequenceProblem, step: float) -> FloatArray:
    """Returns the borders of the platform's cells [rad], shape (g + 1,), over all angles that it may have."""
    if not problem.turns:
        return np.zeros(2)
    low, high = problem.platform_range
    here = float(problem.platform_start[0])
    # Without limits, a turn to either side shows all there is to reach.
    low, high = max(low, here - 2.0 * np.pi), min(high, here + 2.0 * np.pi)
    return np.linspace(low, high, max(1, int(np.ceil((high - low) / step - 1e-9))) + 1)


def _backward(
    problem: SequenceProblem, arms: list[_Arm], edges: FloatArray, resolution: Resolution
) -> float:
    cells = len(edges) - 1
    boxes: list[StopBoxes | None] = [None] * len(arms)
    results = [0.0] * len(arms)
    for a, arm in enumerate(arms):
        if len(arm.chain.active):
            last = int(arm.chain.active[-1])
            boxes[a] = stop_boxes(problem, a, arm.stops, arm.table, last, edges, resolution)
    for k in range(problem.stages - 1, -1, -1):
        edges_of = {}
        for a, arm in enumerate(arms):
            here = boxes[a]
            if problem.arms[a].stops[k] is None or here is None:
                continue
            if not here.possible:
                return np.inf
            came = int(arm.chain.previous[k])
            before = None
            if came >= 0:
                before = stop_boxes(problem, a, arm.stops, arm.table, came, edges, resolution)
            edges_of[a] = _Transfers.into(problem, a, arm, k, came, before, here, edges, cells)
            boxes[a] = before
        for a, arm in enumerate(arms):
            if a not in edges_of:
                least = min(edge.least for edge in edges_of.values())
                if arm.left is None:
                    arm.rest += least
                else:
                    arm.left = arm.left + np.float32(least)
                continue
            transfers = edges_of[a]
            left = arm.left
            if left is None:
                left = _return_times(problem, a, arm, transfers.stop) + np.float32(arm.rest)
            others = [edge.by_cells for b, edge in edges_of.items() if b != a]
            arm.left = transfers.least_from(left, others)
            results[a] = float(arm.left.min())
    for a, arm in enumerate(arms):
        if arm.left is not None:
            results[a] = float(arm.left.min())
    return max(results)


def _return_times(problem: SequenceProblem, a: int, arm: _Arm, stop: StopBoxes) -> Times:
    """Returns how long the return takes at least from each cell of the last stop [s], 0 where there is none."""
    if not problem.returns or problem.free_start:
        return np.zeros(len(stop.retract.index), dtype=np.float32)
    low, high = _start(problem, a, arm.table)
    without = (LAST_JOINT,) if stop.free_last else ()
    return arm.table.gap_times(stop.retract.low, stop.retract.high, low, high, without)[:, 0]


def _start(problem: SequenceProblem, a: int, table: TransferTable) -> tuple[np.ndarray, np.ndarray]:
    q = problem.arms[a].start[None]
    if problem.turns:
        q = np.column_stack([q, problem.platform_start[None]])
    return table.box(q, q)


@dataclass(frozen=True)
class _Transfers:
    """One arm's transfers into one stage, and its work there."""

    stop: StopBoxes
    """Where they lead."""
    times: Times
    """Least transfer time of every pair of cells [s], shape (n before, n)."""
    cell_before: IntArray | None
    """Platform cell of each cell before; None if it is not known, another stage being between."""
    inner: list[tuple[slice, slice, Times]]
    """Per platform cell: approach cells, retract cells, and the least work between them [s]."""
    work: Times
    """Least work from each approach cell, whatever follows [s], shape (n,)."""
    by_cells: Times
    """Least time of the stage for every pair of platform cells [s], shape (g, g), infinite for none."""

    @property
    def least(self) -> float:
        """Least time of the stage [s]."""
        return float(self.by_cells.min())

    @classmethod
    def into(
        cls,
        problem: SequenceProblem,
        a: int,
        arm: _Arm,
        k: int,
        came: int,
        before: StopBoxes | None,
        stop: StopBoxes,
        edges: FloatArray,
        cells: int,
    ) -> _Transfers:
        """Returns an arm's transfers into stage k."""
        n = len(stop.approach.index)
        free = stop.free_last or (before is not None and before.free_last)
        without: tuple[int, ...] = (LAST_JOINT,) if free else ()
        cell_before = None
        if came < 0 and k == 0 and problem.free_start:
            times = np.zeros((1, n), dtype=np.float32)
        else:
            adjacent = came == k - 1
            if not adjacent:
                without = (*without, *platform_columns(problem))
            if before is None:
                low, high = _start(problem, a, arm.table)
                here = float(problem.platform_start[0]) if problem.turns else 0.0
                cell = np.clip(np.searchsorted(edges, here, side="right") - 1, 0, cells - 1)
                start_cell = np.array([cell])
            else:
                low, high, start_cell = (
                    before.retract.low,
                    before.retract.high,
                    before.retract.index,
                )
            times = arm.table.gap_times(low, high, stop.approach.low, stop.approach.high, without)
            cell_before = start_cell if adjacent else None
        inner = _inner(arm.table, stop)
        work = np.full(n, np.inf, dtype=np.float32)
        for approach, _, least in inner:
            work[approach] = least.min(axis=1)
        by_cells = _by_cells(times + work, cell_before, stop.approach.index, cells)
        return cls(stop, times, cell_before, inner, work, by_cells)

    def least_from(self, left: Times, others: list[Times]) -> Times:
        """Returns the least time from every cell before to the end, shape (n before,).

        max(transfer + work, other) + left over all retract cells is at least the larger of the two sums' minima.

        Args:
            left: least time from each retract cell to the end [s].
            others: least times of the other arm for every pair of platform cells.
        """
        n = len(self.work)
        own, beyond = (np.full(n, np.inf, dtype=np.float32) for _ in range(2))
        for approach, retract, least in self.inner:
            own[approach] = (least + left[retract]).min(axis=1)
            beyond[approach] = np.where(np.isfinite(least), left[retract], np.float32(np.inf)).min(
                axis=1
            )
        result = np.empty(len(self.times), dtype=np.float32)
        floor = None
        for other in others:
            floor = other if self.cell_before is not None else other.min(axis=0, keepdims=True)
            floor = floor[:, self.stop.approach.index] + beyond
        for k in range(0, len(result), ROWS):
            times = self.times[k : k + ROWS] + own
            if floor is not None:
                rows = self.cell_before
                np.maximum(times, floor if rows is None else floor[rows[k : k + ROWS]], out=times)
            result[k : k + ROWS] = times.min(axis=1)
        return result


def _inner(table: TransferTable, stop: StopBoxes) -> list[tuple[slice, slice, Times]]:
    """Returns, per platform cell, the least time of approach, dwell and retract between its cells."""
    approach, retract = stop.approach, stop.retract
    found = []
    dwell = np.float32(stop.dwell)
    for cell in np.intersect1d(approach.index, retract.index):
        a, r = (slice(*np.searchsorted(x.index, [cell, cell + 1])) for x in (approach, retract))
        if stop.same:
            least = np.full((a.stop - a.start,) * 2, np.inf, dtype=np.float32)
            np.fill_diagonal(least, dwell)
        else:
            moved = table.gap_times(
                approach.low[:, a],
                approach.high[:, a],
                retract.low[:, r],
                retract.high[:, r],
                (LAST_JOINT,) if stop.free_last else (),
            )
            lines = approach.line[a][:, None] + retract.line[r][None, :]
            least = np.maximum(moved, lines) + dwell
        found.append((a, r, least))
    return found


def _by_cells(times: Times, before: IntArray | None, index: IntArray, cells: int) -> Times:
    """Returns the least time of every pair of platform cells, shape (g, g); cells are in their order."""
    table = np.full((cells, cells), np.inf, dtype=np.float32)
    if not times.size:
        return table
    columns, first = np.unique(index, return_index=True)
    least = np.minimum.reduceat(times, first, axis=1)
    if before is None:
        table[:, columns] = least.min(axis=0)
        return table
    rows, first = np.unique(before, return_index=True)
    table[np.ix_(rows, columns)] = np.minimum.reduceat(least, first, axis=0)
    return table
