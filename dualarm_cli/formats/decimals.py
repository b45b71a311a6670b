"""Tables of decimal numbers as text."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from dualarm_cli.compiled import decimals
from dualarm_cli.geometry.arrays import FloatArray

ZEROS = re.compile(r"\.?0+(?=[,\n])")
"""What a number with a decimal point ends with and does not need."""


def table_text(rows: FloatArray, digits: Sequence[int]) -> bytes:
    """Returns numbers as lines, with commas between them, without zeros at the end and without -0.

    Args:
        rows: the numbers, shape (m, n).
        digits: of each column, how many are written after the point, from 1 to `decimals.PLACES`, shape (n,).
    """
    if (np.abs(rows) <= decimals.LARGEST).all():
        return decimals.table_text(rows, digits)
    # Of any size, or none: as of a schedule that the verifier would refuse.
    row = ",".join(f"%.{count}f" for count in digits) + "\n"
    # Rounded first, so that there is no -0.
    rounded = np.column_stack(
        [np.round(column, count) + 0.0 for column, count in zip(rows.T, digits, strict=True)]
    )
    return ZEROS.sub("", "".join(row % tuple(values) for values in rounded.tolist())).encode()
