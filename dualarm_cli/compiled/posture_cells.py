"""The compiled function of `src/posture_cells.c`: cells that hold every posture of a flange pose."""

from __future__ import annotations

import ctypes
from ctypes import byref

import numpy as np
from numpy.typing import NDArray

from dualarm_cli.geometry.arrays import FloatArray, IntArray, distinct
from dualarm_cli.native import library, numbers, pointer, whole

_pointer, _int64 = ctypes.c_void_p, ctypes.c_int64
PER_PART = 4
"""So many cells of each platform cell, branch and part of the circle there is room for at first."""


class _Intervals(ctypes.Structure):
    """`Intervals` in C."""

    _fields_ = (
        *((name, _pointer) for name in ("cell", "low", "high", "line")),
        ("count", _int64),
    )


class _LineLaw(ctypes.Structure):
    """`LineLaw` in C."""

    _fields_ = (("time", _pointer), ("per_step", ctypes.c_double), ("steps", _int64))


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
    line: tuple[FloatArray, float, NDArray[np.float32]] | None,
    intervals: tuple[IntArray, FloatArray, FloatArray, FloatArray],
    circle: tuple[int, int],
    free_last: bool,
) -> tuple[IntArray, IntArray, FloatArray, FloatArray, FloatArray]:
    """Returns cells around all postures, in order of their platform cell, branch and part of the circle; n of them.

    Args:
        arm: `SrsArm.numbers`.
        pose: flange rotation, (3, 3), and position [m], (3,), in the carried frame at platform angle zero.
        line: flange position at the other end of the line [m], (3,), and `RestToRest.time_table`; None without a line.
        intervals: platform cell of each of c intervals of its angle, ascending, where they begin and end [rad], and a
            floor of the line's time over each of them [s], shape (c,) each.
        circle: into how many parts the circle of elbows is cut, and each of these for enclosures.
        free_last: whether joint 7 is free.

    Returns:
        Platform cell and branch, shape (n,) each; lowest and highest joints and, last, platform angle [rad], shape
        (n, 8) each; least time of the line [s], shape (n,).

    Raises:
        MemoryError: there is none.
    """
    target, per_step, times = line or (pose[1], 1.0, np.zeros((7, 0), dtype=np.float32))
    whose = [numbers(x) for x in (arm, *pose, target)]
    law = _LineLaw(pointer(times), per_step, times.shape[1])
    held = whole(intervals[0]), *map(numbers, intervals[1:])
    given = _Intervals(*map(pointer, held), len(held[0]))
    parts = *map(_int64, circle), _int64(free_last)
    most = PER_PART * len(distinct(intervals[0])) * 8 * circle[0]
    while True:
        index, branch = (np.empty(most, dtype=np.int64) for _ in range(2))
        low, high, least = np.empty((most, 8)), np.empty((most, 8)), np.empty(most)
        arrays = (index, branch, low, high, least)
        found = _Cells(*map(pointer, arrays), most, 0)
        call = *map(pointer, whose), byref(law), byref(given), *parts, byref(found)
        if library().posture_cells(*call):
            raise MemoryError
        if found.count <= most:
            return tuple(x[: found.count].copy() for x in arrays)  # type: ignore[return-value]
        most = found.count
