"""Binding of `src/decimals.c`: formatting of tables of decimal numbers."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.native import library, numbers, pointer, whole

PLACES = 9
"""Maximum number of decimal places."""
LARGEST = 999_999.0
"""Largest magnitude that is written: a double holds all of its digits."""
WIDTH = 18
"""Maximum number of characters of a number with its separator."""


def table_text(rows: FloatArray, digits: Sequence[int]) -> bytes:
    """Format numbers as comma-separated lines, without trailing zeros and without -0.

    Args:
        rows: numbers of magnitude up to LARGEST, shape (m, n).
        digits: decimal places of each column, from 1 to PLACES, shape (n,).
    """
    m, n = rows.shape
    text = np.empty(m * n * WIDTH, dtype=np.uint8)
    places = np.array(digits, dtype=np.int64)
    table, scale, to_units = numbers(rows), 10.0**places, whole(10 ** (PLACES - places))
    write = library().table_text
    write.restype = ctypes.c_int64
    size = write(
        pointer(table),
        pointer(scale),
        pointer(to_units),
        ctypes.c_int64(m),
        ctypes.c_int64(n),
        pointer(text),
    )
    return text[:size].tobytes()
