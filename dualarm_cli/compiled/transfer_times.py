"""Interface of the compiled functions in `src/transfer_times.c`."""

from __future__ import annotations

import ctypes
from ctypes import byref

import numpy as np
from numpy.typing import NDArray

from dualarm_cli.native import PointerStruct, library, pointer, whole

_pointer, _int32, _int64 = ctypes.c_void_p, ctypes.c_int32, ctypes.c_int64


class Laws(PointerStruct):
    """Tables of times: `Laws` in C."""

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
        """Returns the tables of classes of joints.

        Args:
            table: time of every number of steps [s], class by class, shape (classes, steps).
            column: coordinates of all classes, one class after the other.
            end: where each class ends in `column`, shape (classes,).
        """
        own = cls(pointer(table), pointer(column), pointer(end), *table.shape)
        own.held = table, column, end
        return own


class CoordinateBoxes(PointerStruct):
    """Boxes of coordinates: `Boxes` in C."""

    _fields_ = (("low", _pointer), ("high", _pointer), ("count", _int64))


def boxes(low: NDArray[np.int16], high: NDArray[np.int16]) -> CoordinateBoxes:
    """Returns boxes.

    Args:
        low: lowest coordinates, shape (c, n).
        high: highest ones, shape (c, n).
    """
    held = tuple(np.ascontiguousarray(x, dtype=np.int16) for x in (low, high))
    own = CoordinateBoxes(pointer(held[0]), pointer(held[1]), low.shape[1])
    own.held = held
    return own


class CellRuns(PointerStruct):
    """Cells in runs, where transfers begin or end: `Side` in C."""

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
        """Returns cells in runs.

        Args:
            cells: n boxes.
            group: group of each of them, ascending, shape (n,).
            runs: b boxes around cells next to each other, each within one group.
            first: first cell of each run, and n, shape (b + 1,).
        """
        own = cls(cells, pointer(group), runs, pointer(first))
        own.held = cells, group, runs, first
        return own


class LineEnds(PointerStruct):
    """Cells at one end of a stop's lines: `End` in C."""

    _fields_ = (("cells", CoordinateBoxes), ("first", _pointer), ("line", _pointer))

    @classmethod
    def of(
        cls, cells: CoordinateBoxes, first: NDArray[np.int64], line: NDArray[np.float32]
    ) -> LineEnds:
        """Returns cells in groups.

        Args:
            cells: n boxes, in order of their groups.
            first: first cell of each of g groups, and n, shape (g + 1,).
            line: least time of the line at each cell [s], shape (n,).
        """
        own = cls(cells, pointer(first), pointer(line))
        own.held = cells, first, line
        return own


def least_work(
    laws: Laws, approach: LineEnds, retract: LineEnds, groups: int, rest: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Returns the least of max(way, both lines) + rest from every cell to all others of its group [s], shape (n,).

    Args:
        laws: tables of times.
        approach: n cells where the approach begins.
        retract: m cells where the retract ends.
        groups: number of groups.
        rest: from each of the latter [s], shape (m,).

    Raises:
        MemoryError: there is none.
    """
    least = np.full(approach.cells.count, np.inf, dtype=np.float32)
    arguments = *map(byref, (laws, approach, retract)), _int64(groups), pointer(rest)
    _checked(library().least_work(*arguments, pointer(least)))
    return least


def gap_times(laws: Laws, before: CoordinateBoxes, after: CoordinateBoxes) -> NDArray[np.float32]:
    """Returns the least times between all pairs of boxes [s], shape (n, m).

    Args:
        laws: tables of times.
        before: n boxes where transfers begin.
        after: m boxes where they end.
    """
    found = np.empty((before.count, after.count), dtype=np.float32)
    library().gap_times(byref(laws), byref(before), byref(after), pointer(found))
    return found


def work_times(
    laws: Laws,
    before: NDArray[np.int16],
    after: NDArray[np.int16],
    work: NDArray[np.float32],
    groups: tuple[NDArray[np.int64], NDArray[np.int64], int],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Returns the times of all transfers with the work after them [s], (n, m), and the least for every pair of groups.

    Args:
        laws: tables of times.
        before: coordinates where transfers begin, shape (c, n).
        after: where they end, shape (c, m).
        work: of each of these [s], shape (m,).
        groups: group of each coordinate where transfers begin, (n,), and end, ascending, (m,), and their number g; the
            second answer is of shape (g, g), infinite for none.
    """
    *each, count = groups
    rows, columns = (_groups(own, count) for own in each)
    first = np.searchsorted(columns, np.arange(count + 1)).astype(np.int64)
    own = np.ascontiguousarray(work, dtype=np.float32)
    times = np.empty((before.shape[1], after.shape[1]), dtype=np.float32)
    assert (len(rows), len(columns), len(own)) == (*times.shape, times.shape[1])
    least = np.full((count, count), np.inf, dtype=np.float32)
    ends = *map(byref, (boxes(before, before), boxes(after, after))), pointer(own)
    cells = pointer(rows), pointer(first), _int64(count)
    library().work_times(byref(laws), *ends, *cells, pointer(times), pointer(least))
    return times, least


def least_through(
    times: NDArray[np.float32],
    groups: tuple[NDArray[np.int64], NDArray[np.int64]],
    floor: NDArray[np.float32],
    left: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Returns the least of max(time, floor) + left from every row [s], shape (n,).

    Args:
        times: of stages [s], shape (n, m).
        groups: of the rows, those of one next to each other, (n,), and of the columns, (m,).
        floor: least length of the stage for every pair of groups [s], shape (g, g).
        left: what is left after every column [s], shape (m,).

    Raises:
        MemoryError: there is none.
    """
    rows, columns = (_groups(own, len(floor)) for own in groups)
    time, table, rest = (np.ascontiguousarray(x, dtype=np.float32) for x in (times, floor, left))
    assert (len(rows), len(columns), len(rest)) == (*time.shape, time.shape[1])
    least = np.empty(len(time), dtype=np.float32)
    pairs = pointer(time), *map(_int64, time.shape), pointer(rows), pointer(columns)
    others = _int64(len(table)), pointer(table), pointer(rest)
    _checked(library().least_through(*pairs, *others, pointer(least)))
    return least


def _groups(given: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Returns groups, of so many, as compiled functions read them."""
    found = whole(given)
    assert not len(found) or (found.min() >= 0 and found.max() < count)
    return found


def least_by_groups(
    laws: Laws,
    before: CellRuns,
    after: CellRuns,
    work: NDArray[np.float32],
    least: NDArray[np.float32],
) -> None:
    """Lowers `least` to the least of transfer and work for every pair of groups.

    Args:
        laws: tables of times.
        before: where transfers begin.
        after: where they end, m cells.
        work: of each of these [s], shape (m,).
        least: [s], shape (g, g).

    Raises:
        MemoryError: there is none.
    """
    work = np.ascontiguousarray(work, dtype=np.float32)
    arguments = byref(laws), byref(before), byref(after), pointer(work), _int64(len(least))
    _checked(library().least_by_groups(*arguments, pointer(least)))


def least_from(
    laws: Laws,
    before: CellRuns,
    after: CellRuns,
    own: NDArray[np.float32],
    floor: NDArray[np.float32],
    beyond: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Minimise max(transfer + own, floor + beyond) over the cells of `after` [s], shape (n,).

    Args:
        laws: tables of times.
        before: where transfers begin, n cells.
        after: where they end, m cells.
        own: of each of these [s], shape (m,).
        floor: of each pair of groups [s], shape (g, g).
        beyond: of each cell of `after` [s], shape (m,).

    Raises:
        MemoryError: there is none.
    """
    held = tuple(np.ascontiguousarray(x, dtype=np.float32) for x in (own, floor, beyond))
    arguments = *map(byref, (laws, before, after)), *map(pointer, held), _int64(len(floor))
    least = np.empty(before.cells.count, dtype=np.float32)
    _checked(library().least_from(*arguments, pointer(least)))
    return least


def _checked(failed: int) -> None:
    if failed:
        raise MemoryError
