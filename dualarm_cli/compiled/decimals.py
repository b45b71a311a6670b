"""The compiled function of `src/decimals.c`: tables of decimal numbers as text."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.native import library, numbers, pointer, whole

PLACES = 9
"""Most digits after the point."""
LARGEST = 999_999.0
"""Larger numbers are not written: up to it they have six digits before the point, and a double holds all."""
WIDTH = 18
"""Most characters of a number, with what follows it."""


def table_text(rows: FloatArray, digits: Sequence[int]) -> bytes:
    """Returns numbers as lines, with commas between them, without zeros at the end and without -0.

    Args:
        rows: the numbers, of LARGEST at most, shape (m, n).
        digits: of each column, how many are written after the point, from 1 to PLACES, shape (n,).
    """
    m, n = rows.shape
    text = np.empty(m * n * WIDTH, dtype=np.uint8)
    places = np.array(digits, dtype=np.int64)
    given, scale, rest = numbers(rows), 10.0**places, whole(10 ** (PLACES - places))
    write = library().table_text
    write.restype = ctypes.c_int64
    size = write(
        pointer(given),
        pointer(scale),
        pointer(rest),
        ctypes.c_int64(m),
        ctypes.c_int64(n),
        pointer(text),
    )
    return text[:size].tobytes()
