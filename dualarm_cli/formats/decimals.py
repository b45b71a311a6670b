"""Tables of decimal numbers as text, made by array operations instead of number by number."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from dualarm_cli.geometry.arrays import FloatArray

PLACES = 9
"""Most digits after the point."""
LARGEST = 999_999.0
"""Larger numbers are formatted one by one: up to it they have six digits before the point, and a double holds all."""
ZEROS = re.compile(r"\.?0+(?=[,\n])")
"""What a number with a decimal point ends with and does not need."""

Words = NDArray[np.uint32]
"""Four characters each; NUL stands for none."""


def table_text(rows: FloatArray, digits: Sequence[int]) -> bytes:
    """Returns numbers as lines, with commas between them, without zeros at the end and without -0.

    Args:
        rows: the numbers, shape (m, n).
        digits: of each column, how many are written after the point, from 1 to PLACES, shape (n,).
    """
    if not (np.abs(rows) <= LARGEST).all():
        return _one_by_one(rows, digits)
    units = np.rint(rows * 10.0 ** np.array(digits)).astype(np.int64)
    units *= 10 ** (PLACES - np.array(digits, dtype=np.int64))
    whole, part = _split(np.abs(units), 10**PLACES)
    thousands, ones = _split(whole, 1000)
    first, rest = _split(part, 10**6)
    second, third = _split(rest, 1000)
    ends = np.zeros(len(digits), dtype=np.uint32)
    ends[-1] = 1
    text = np.empty((*rows.shape, 5), dtype=np.uint32)
    tables = _tables()
    text[..., 0] = tables["thousands"][thousands + 1000 * (units < 0)]
    text[..., 1] = tables["ones"][ones + 1000 * (thousands > 0) + 2000 * (part > 0)]
    text[..., 2] = tables["decimals"][first + 1000 * (rest > 0)]
    text[..., 3] = tables["decimals"][second + 1000 * (third > 0)]
    text[..., 4] = tables["last"][third + 1000 * ends]
    return text.tobytes().translate(None, b"\0")


def _split(values: NDArray[np.integer], size: int) -> tuple[Words, Words]:
    """Returns quotient and remainder of integers that are not negative."""
    quotient = values // size
    return quotient.astype(np.uint32), (values - quotient * size).astype(np.uint32)


@cache
def _tables() -> dict[str, Words]:
    """Returns the words of a number's parts by the three digits of a part, each followed by its variants."""
    full = [f"{k:03}" for k in range(1000)]
    headless = [text.lstrip("0") for text in full]
    tailless = [text.rstrip("0") for text in full]
    ones = [*(text or "0" for text in headless), *full]
    return {
        # Not negative; negative.
        "thousands": _words([*headless, *("-" + text for text in headless)]),
        # Whole numbers without thousands, with them; the same with digits after the point.
        "ones": _words([*ones, *(text + "." for text in ones)]),
        # The last digits that are not 0; followed by others.
        "decimals": _words([*tailless, *full]),
        # In the middle of a line; at its end.
        "last": _words([text + end for end in ",\n" for text in tailless]),
    }


def _words(texts: Iterable[str]) -> Words:
    return np.frombuffer(b"".join(text.encode().ljust(4, b"\0") for text in texts), np.uint32)


def _one_by_one(rows: FloatArray, digits: Sequence[int]) -> bytes:
    """Returns what `table_text` does, of numbers of any size, or that are none."""
    row = ",".join(f"%.{count}f" for count in digits) + "\n"
    # Rounded first, so that there is no -0.
    rounded = np.column_stack(
        [np.round(column, count) + 0.0 for column, count in zip(rows.T, digits, strict=True)]
    )
    return ZEROS.sub("", "".join(row % tuple(values) for values in rounded.tolist())).encode()
