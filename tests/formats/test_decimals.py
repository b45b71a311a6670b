"""Tables of numbers as text: the same characters as number by number."""

from __future__ import annotations

import numpy as np
import pytest

from dualarm_cli.formats.tables import table_text

DIGITS = (9, 9, 7, 5, 1)


def plain(value, digits):
    """Returns a number as Python formats it, without zeros at the end and without -0."""
    text = f"{np.round(value, digits) + 0.0:.{digits}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def lines(rows):
    """Returns a table made number by number."""
    cells = [[plain(v, count) for v, count in zip(row, DIGITS, strict=True)] for row in rows]
    return "".join(",".join(row) + "\n" for row in cells).encode()


@pytest.mark.parametrize("size", [1e-10, 1e-9, 1e-5, 1e-3, 1.0, 12.0, 1e3, 3e5])
def test_all_at_once_is_as_number_by_number(size):
    """Of numbers of every size and sign, of those with few digits, and of halves of the last digit."""
    drawn = np.random.default_rng(0)
    rows = np.clip(drawn.normal(size=(400, 5)) * size, -9e5, 9e5)
    rows[::3] = np.round(rows[::3], 2)
    rows[1::3] = (np.rint(rows[1::3]) + 0.5) / 10.0 ** np.array(DIGITS)
    assert table_text(rows, DIGITS) == lines(rows)


@pytest.mark.parametrize("value", [0.0, -0.0, -4e-10, 999.9999999996, 999_999.999999999, -1000.0])
def test_ends_of_groups_of_digits(value):
    """Zero has no sign; a number that is rounded up to the next thousand has its digits."""
    rows = np.full((2, 5), value)
    assert table_text(rows, DIGITS) == lines(rows)


@pytest.mark.parametrize("value", [1e6, -1e250, np.inf, np.nan])
def test_numbers_of_any_size_are_written(value):
    """As of a schedule that the verifier would refuse."""
    rows = np.full((1, 5), value)
    first = table_text(rows, DIGITS).decode().split(",")[0]
    assert float(first) == pytest.approx(value, nan_ok=True)


def test_no_rows_are_no_text():
    """Of a table that has none."""
    assert table_text(np.empty((0, 5)), DIGITS) == b""
