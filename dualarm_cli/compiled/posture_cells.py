"""The compiled function of `src/posture_cells.c`: cells that hold every posture of a flange pose."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from ctypes import byref

import numpy as np

from dualarm_cli.compiled import library, numbers, pointer, whole
from dualarm_cli.geometry.arrays import FloatArray, IntArray, distinct

_pointer, _int64 = ctypes.c_void_p, ctypes.c_int64
PER_PART = 4
"""So many cells of each platform cell, branch and part of the circle there is room for at first."""


class _Intervals(ctypes.Structure):
    """`Intervals` in C."""

    _fields_ = (
        ("cell", _pointer),
        ("low", _pointer),
        ("high", _pointer),
        ("rates", _pointer * 8),
        ("line", _pointer),
        ("count", _int64),
    )


class _Cells(ctypes.Structure):
    """`Cells` in C."""

    _fields_ = (
        *((name, _pointer) for name in ("cell", "branch", "low", "high", "line")),
        ("most", _int64),
        ("count", _int64),
    )


def posture_cells(
    arm: FloatArray,
    pose: tuple[FloatArray, FloatArray],
    intervals: tuple[IntArray, FloatArray, FloatArray],
    rates: Sequence[FloatArray],
    line: FloatArray,
    circle: tuple[int, int],
    free_last: bool,
) -> tuple[IntArray, IntArray, FloatArray, FloatArray, FloatArray]:
    """Returns cells around all postures, in order of their platform cell, branch and part of the circle; n of them.

    Args:
        arm: `SrsArm.numbers`.
        pose: flange rotation, (3, 3), and position [m], (3,), in the carried frame at platform angle zero.
        intervals: platform cell of each of c intervals of its angle, ascending, and where they begin and end [rad],
            shape (c,) each.
        rates: the fields of `ShapeRates`, shape (c,) each.
        line: what comes with each interval's postures, the least of which a cell gets, shape (c,).
        circle: into how many parts the circle of elbows is cut, and each of these for enclosures.
        free_last: whether joint 7 is free.

    Returns:
        Platform cell and branch, shape (n,) each; lowest and highest joints and, last, platform angle [rad], shape
        (n, 8) each; least of `line`, shape (n,).

    Raises:
        MemoryError: there is none.
    """
    held = [whole(intervals[0]), *map(numbers, (*intervals[1:], *rates, line))]
    pointers = [pointer(x) for x in held]
    rows = (_pointer * 8)(*(x.value for x in pointers[3:11]))
    given = _Intervals(*pointers[:3], rows, pointers[11], len(line))
    whose = [numbers(x) for x in (arm, *pose)]
    parts = *map(_int64, circle), _int64(free_last)
    most = PER_PART * len(distinct(intervals[0])) * 8 * circle[0]
    while True:
        index, branch = (np.empty(most, dtype=np.int64) for _ in range(2))
        low, high, least = np.empty((most, 8)), np.empty((most, 8)), np.empty(most)
        arrays = (index, branch, low, high, least)
        found = _Cells(*map(pointer, arrays), most, 0)
        call = *map(pointer, whose), byref(given), *parts, byref(found)
        if library().posture_cells(*call):
            raise MemoryError
        if found.count <= most:
            return tuple(x[: found.count].copy() for x in arrays)  # type: ignore[return-value]
        most = found.count
