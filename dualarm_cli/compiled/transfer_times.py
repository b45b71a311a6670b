"""Binding of `src/transfer_times.c`: least transfer times between boxes of joint coordinates."""

from __future__ import annotations

import ctypes
from ctypes import byref
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dualarm_cli.native import PointerStruct, library, pointer, whole

_pointer, _int32, _int64 = ctypes.c_void_p, ctypes.c_int32, ctypes.c_int64


class Laws(PointerStruct):
    """Tables of rest-to-rest times: `Laws` in C."""

    _fields_ = (
        ("table", _pointer),
        ("column", _pointer),
        ("end", _pointer),
        ("classes", _int32),
        ("steps", _int32),
    )

    @classmethod
    def of(
        cls, table: NDArray[np.float32], column: NDArray[np.int32], end: NDArray[np.int32]
    ) -> Laws:
        """Build the structure of tables, one per class of joints.

        Args:
            table: times by number of steps [s], shape (classes, steps).
            column: coordinates of all classes, in order of the classes.
            end: end of each class in `column`, shape (classes,).
        """
        laws = cls(pointer(table), pointer(column), pointer(end), *table.shape)
        laws.held = table, column, end
        return laws


class CoordinateBoxes(PointerStruct):
    """Boxes of coordinates: `Boxes` in C."""

    _fields_ = (("low", _pointer), ("high", _pointer), ("count", _int64))


def boxes(low: NDArray[np.int16], high: NDArray[np.int16]) -> CoordinateBoxes:
    """Build the structure of n boxes in c coordinates.

    Args:
        low: lowest coordinates, shape (c, n).
        high: highest coordinates, shape (c, n).
    """
    held = tuple(np.ascontiguousarray(x, dtype=np.int16) for x in (low, high))
    structure = CoordinateBoxes(pointer(held[0]), pointer(held[1]), low.shape[1])
    structure.held = held
    return structure


class CellRuns(PointerStruct):
    """Cells at which transfers begin or end, in runs: `CellRuns` in C."""

    _fields_ = (
        ("cells", CoordinateBoxes),
        ("group", _pointer),
        ("runs", CoordinateBoxes),
        ("first", _pointer),
    )

    @classmethod
    def of(
        cls,
        cells: CoordinateBoxes,
        group: NDArray[np.int64],
        runs: CoordinateBoxes,
        first: NDArray[np.int64],
    ) -> CellRuns:
        """Build the structure of n cells in b runs.

        Args:
            cells: n boxes.
            group: platform cell of each cell, ascending, shape (n,).
            runs: b boxes around consecutive cells, each within one group.
            first: first cell of each run, and n, shape (b + 1,).
        """
        structure = cls(cells, pointer(group), runs, pointer(first))
        structure.held = cells, group, runs, first
        return structure


class JointChains(PointerStruct):
    """Chains of joints from target to target: `Chains` in C."""

    _fields_ = (
        *((name, _pointer) for name in ("before", "after", "retract", "approach", "onward")),
        ("speed", _pointer * 3),
        ("table", _pointer),
        ("rate", _pointer),
        ("law", _pointer),
        ("step", ctypes.c_double),
        ("laws", _int64),
        ("coordinates", _int64),
        ("entries", _int64),
        ("late", ctypes.c_float * 2),
    )

    @classmethod
    def of(
        cls,
        displacements: tuple[NDArray[np.int16] | None, NDArray[np.int16]],
        lines: tuple[tuple[NDArray[np.float32], float], tuple[NDArray[np.float32], float]],
        speeds: tuple[NDArray[np.float32], ...],
        onward: NDArray[np.float32],
        laws: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int32], float],
    ) -> JointChains:
        """Build the structure of transfers from n cells to m in c coordinates.

        Args:
            displacements: least displacements towards the targets on retracts, (2, c, n), and approaches, (2, c, m):
                rises, then falls, in steps; -1 if unknown. None for transfers from any motion.
            lines: least times of retracts, (n,), and approaches, (m,), each with the time beyond these up to which
                the displacements hold [s].
            speeds: greatest shares of full speed at the outer ends of the fastest of these lines, (laws, n) and
                (laws, m), and over the runs of approaches, (laws, runs).
            onward: least time from the target on for each approach [s], (m,).
            laws: times of motions [s], shape (laws, 5, entries), accelerations per speed limit [1/s], (laws,), law of
                each coordinate or -1, shape (c,), and time of a step at full speed [s].
        """
        before, after = displacements
        (retract, *late), (approach, until) = lines
        table, rate, law, step = laws
        held: tuple[NDArray[Any], ...] = after, retract, approach, onward
        first = None if before is None else pointer(before)
        ends = (_pointer * 3)(*map(pointer, speeds))
        sizes = len(rate), after.shape[1], table.shape[2], (ctypes.c_float * 2)(*late, until)
        numbers = *map(pointer, (table, rate, law)), step
        structure = cls(first, *map(pointer, held), ends, *numbers, *sizes)
        structure.held = before, held, speeds, laws
        return structure


class LineEnds(PointerStruct):
    """Cells at one end of a stop's lines: `LineEnds` in C."""

    _fields_ = (
        ("cells", CoordinateBoxes),
        *((name, _pointer) for name in ("first", "line", "travel")),
    )

    @classmethod
    def of(
        cls,
        cells: CoordinateBoxes,
        first: NDArray[np.int64],
        line: NDArray[np.float32],
        travel: NDArray[np.int16],
    ) -> LineEnds:
        """Build the structure of n cells in g groups.

        Args:
            cells: n boxes, in order of their groups.
            first: first cell of each group, and n, shape (g + 1,).
            line: least time of the line at each cell [s], shape (n,).
            travel: largest travel of the joints of each class in this time [steps], shape (classes, n).
        """
        structure = cls(cells, pointer(first), pointer(line), pointer(travel))
        structure.held = cells, first, line, travel
        return structure


def least_work(
    laws: Laws,
    approach: LineEnds,
    retract: LineEnds,
    groups: int,
    rest: tuple[NDArray[np.float32], NDArray[np.float32]],
) -> NDArray[np.float32]:
    """Minimise both lines + remaining over the retract cells of each group [s], shape (n,).

    Args:
        laws: tables of times.
        approach: n cells at which the approach begins.
        retract: m cells at which the retract ends.
        groups: number of groups.
        rest: least time of each retract with the delay of what follows [s], shape (m,), and the time after each retract
            cell without it [s], shape (m,).

    Raises:
        MemoryError: out of memory.
    """
    least = np.full(approach.cells.count, np.inf, dtype=np.float32)
    arguments = *map(byref, (laws, approach, retract)), _int64(groups), *map(pointer, rest)
    _check(library().least_work(*arguments, pointer(least)))
    return least


def gap_times(laws: Laws, before: CoordinateBoxes, after: CoordinateBoxes) -> NDArray[np.float32]:
    """Compute the least times between all pairs of boxes [s], shape (n, m).

    Args:
        laws: tables of times.
        before: n boxes at which transfers begin.
        after: m boxes at which they end.
    """
    times = np.empty((before.count, after.count), dtype=np.float32)
    library().gap_times(byref(laws), byref(before), byref(after), pointer(times))
    return times


def work_times(
    laws: Laws,
    before: NDArray[np.int16],
    after: NDArray[np.int16],
    work: NDArray[np.float32],
    groups: tuple[NDArray[np.int64], NDArray[np.int64], int],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Compute the times of all transfers with work, and their minima by groups [s].

    Args:
        laws: tables of times.
        before: coordinates at which transfers begin, shape (c, n).
        after: coordinates at which they end, shape (c, m).
        work: time added at each end [s], shape (m,).
        groups: groups of the begins, (n,), and of the ends, ascending, (m,), and their number g.

    Returns:
        Times, shape (n, m); minima, infinite for pairs of groups without transfers, shape (g, g).
    """
    *both, count = groups
    rows, columns = (_groups(group, count) for group in both)
    first = np.searchsorted(columns, np.arange(count + 1)).astype(np.int64)
    added = np.ascontiguousarray(work, dtype=np.float32)
    times = np.empty((before.shape[1], after.shape[1]), dtype=np.float32)
    assert (len(rows), len(columns), len(added)) == (*times.shape, times.shape[1])
    least = np.full((count, count), np.inf, dtype=np.float32)
    ends = *map(byref, (boxes(before, before), boxes(after, after))), pointer(added)
    cells = pointer(rows), pointer(first), _int64(count)
    library().work_times(byref(laws), *ends, *cells, pointer(times), pointer(least))
    return times, least


def least_through(
    times: NDArray[np.float32],
    groups: tuple[NDArray[np.int64], NDArray[np.int64]],
    floor: NDArray[np.float32],
    remaining: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Minimise max(time, floor) + remaining over the columns of each row [s], shape (n,).

    Args:
        times: stage times [s], shape (n, m).
        groups: groups of the rows, equal ones consecutive, (n,), and of the columns, (m,).
        floor: least stage time of each pair of groups [s], shape (g, g).
        remaining: time after each column [s], shape (m,).

    Raises:
        MemoryError: out of memory.
    """
    rows, columns = (_groups(group, len(floor)) for group in groups)
    time, table, after = (
        np.ascontiguousarray(x, dtype=np.float32) for x in (times, floor, remaining)
    )
    assert (len(rows), len(columns), len(after)) == (*time.shape, time.shape[1])
    least = np.empty(len(time), dtype=np.float32)
    pairs = pointer(time), *map(_int64, time.shape), pointer(rows), pointer(columns)
    others = _int64(len(table)), pointer(table), pointer(after)
    _check(library().least_through(*pairs, *others, pointer(least)))
    return least


def _groups(index: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Convert group indices below `count` for compiled functions."""
    groups = whole(index)
    assert not len(groups) or (groups.min() >= 0 and groups.max() < count)
    return groups


def least_by_groups(
    laws: Laws,
    before: CellRuns,
    after: CellRuns,
    work: NDArray[np.float32],
    least: NDArray[np.float32],
    chains: JointChains | None = None,
) -> None:
    """Lower `least` to the minima of transfer plus work for each pair of groups.

    Args:
        laws: tables of times.
        before: cells at which transfers begin.
        after: m cells at which they end.
        work: time added at each end [s], shape (m,).
        least: times [s], shape (g, g).
        chains: laws of joints that pass line ends in motion; None for none.

    Raises:
        MemoryError: out of memory.
    """
    work = np.ascontiguousarray(work, dtype=np.float32)
    arguments = byref(laws), byref(before), byref(after), pointer(work), chains and byref(chains)
    _check(library().least_by_groups(*arguments, _int64(len(least)), pointer(least)))


def least_from(
    laws: Laws,
    before: CellRuns,
    after: CellRuns,
    ends: tuple[NDArray[np.float32], JointChains | None],
    floor: NDArray[np.float32],
    remaining: NDArray[np.float32],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Minimise max(transfer + arrival, floor + remaining) over the cells of `after` [s], shape (n,).

    After retracts that the chains begin with, and after any motion.

    Args:
        laws: tables of times.
        before: n cells at which transfers begin.
        after: m cells at which they end.
        ends: time added to a transfer to each end [s], shape (m,), and the chains of joints to its target, or None.
        floor: least stage time of each pair of groups [s], shape (g, g).
        remaining: time after the stage at each end [s], shape (m,).

    Raises:
        MemoryError: out of memory.
    """
    arrival, chains = ends
    held = tuple(np.ascontiguousarray(x, dtype=np.float32) for x in (arrival, floor, remaining))
    added, *others = map(pointer, held)
    cells = *map(byref, (laws, before, after)), added, chains and byref(chains)
    arguments = *cells, *others, _int64(len(floor))
    least, plain = np.empty((2, before.cells.count), dtype=np.float32)
    _check(library().least_from(*arguments, pointer(least), pointer(plain)))
    return least, plain


def _check(failed: int) -> None:
    """Raise a MemoryError if a compiled function reports it."""
    if failed:
        raise MemoryError
