"""Binding of `src/posture_cells.c`: cells that enclose every posture of a flange pose."""

from __future__ import annotations

import ctypes
from ctypes import byref

import numpy as np
from numpy.typing import NDArray

from dualarm_cli.geometry.arrays import FloatArray, IntArray, distinct
from dualarm_cli.native import library, numbers, pointer, whole

_pointer, _int64 = ctypes.c_void_p, ctypes.c_int64
CELLS_PER_PART = 4
"""Initial capacity in cells per platform cell, branch and part of the circle."""


class _Intervals(ctypes.Structure):
    """Intervals of the platform angle: `Intervals` in C."""

    _fields_ = (
        *((name, _pointer) for name in ("cell", "low", "high", "line")),
        ("count", _int64),
    )


class _LineLaw(ctypes.Structure):
    """Least times of joints on lines: `LineLaw` in C."""

    _fields_ = (
        ("time", _pointer),
        ("steps_per_rad", ctypes.c_double),
        ("steps", _int64),
        ("late", ctypes.c_double),
    )


class _Cells(ctypes.Structure):
    """Output cells: `Cells` in C."""

    _fields_ = (
        *((name, _pointer) for name in ("cell", "branch", "low", "high", "line", "least", "most")),
        ("capacity", _int64),
        ("count", _int64),
    )


def posture_cells(
    arm: FloatArray,
    pose: tuple[FloatArray, FloatArray],
    line: tuple[FloatArray, float, NDArray[np.float32], float] | None,
    intervals: tuple[IntArray, FloatArray, FloatArray, FloatArray],
    circle: tuple[int, int],
    free_last: bool,
) -> tuple[IntArray, IntArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Compute n cells around all postures, ordered by platform cell, branch and part of the circle.

    Args:
        arm: `SrsArm.numbers`.
        pose: flange rotation, (3, 3), and position [m], (3,), in the carried frame at platform angle zero.
        line: flange position at the other end of the line [m], (3,), `RestToRest.time_table`, and the time beyond the
            least up to which displacements are enclosed [s]; None without a line.
        intervals: platform cells of c intervals of the platform angle, ascending, their starts and ends [rad], and
            lower bounds of the line's time [s], shape (c,) each.
        circle: number of parts of the circle of arm angles, and of fine cells per part.
        free_last: whether joint 7 is free.

    Returns:
        Platform cells and branches, shape (n,) each; lowest and highest joints, and platform angle [rad], shape
        (n, 8) each; least times of the line [s], shape (n,); least and greatest displacements of the joints on the line
        [rad], shape (n, 7) each: bounds for joints that must rise or fall, others have 0 between.

    Raises:
        MemoryError: out of memory.
    """
    target, steps_per_rad, times, late = line or (
        pose[1],
        1.0,
        np.zeros((7, 0), dtype=np.float32),
        0.0,
    )
    geometry = [numbers(x) for x in (arm, *pose, target)]
    law = _LineLaw(pointer(times), steps_per_rad, times.shape[1], late)
    held = whole(intervals[0]), *map(numbers, intervals[1:])
    platform = _Intervals(*map(pointer, held), len(held[0]))
    parts = *map(_int64, circle), _int64(free_last)
    capacity = CELLS_PER_PART * len(distinct(intervals[0])) * 8 * circle[0]
    while True:
        index, branch = (np.empty(capacity, dtype=np.int64) for _ in range(2))
        low, high, least = np.empty((capacity, 8)), np.empty((capacity, 8)), np.empty(capacity)
        shifts = np.empty((2, capacity, 7))
        arrays = (index, branch, low, high, least, *shifts)
        cells = _Cells(*map(pointer, arrays), capacity, 0)
        call = *map(pointer, geometry), byref(law), byref(platform), *parts, byref(cells)
        if library().posture_cells(*call):
            raise MemoryError
        if cells.count <= capacity:
            return tuple(x[: cells.count].copy() for x in arrays)
        capacity = cells.count
