"""Quintic splines through values, with the same bits on every processor; scipy's own solves them by LAPACK."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.linear_systems import solve_banded

DEGREE = 5
AROUND = 48
"""Values repeated beyond each end of a closed spline: what happens at their ends is below the last digit within."""
Rates = Sequence[tuple[int, FloatArray]]
"""Orders of derivatives at an end, ascending, and their values (d,)."""


def quintic_spline(x: FloatArray, y: FloatArray, first: Rates = (), last: Rates = ()) -> Any:
    """Compute the spline of degree five (scipy's BSpline) through values (n, d) at knots (n,).

    Args:
        x: knots, rising.
        y: values there.
        first: two derivatives at the first knot; without, the polynomials beside the first knots are one.
        last: the same at the last knot.
    """
    # Slow to import, and needed for splines alone.
    from scipy.interpolate import BSpline

    inner = x[1:-1] if len(first) else x[3:-3]
    ends = np.full(DEGREE + 1, x[0]), np.full(DEGREE + 1, x[-1])
    t = np.concatenate([ends[0], inner, ends[1]])
    count, begin = len(t) - DEGREE - 1, len(first)
    rows = np.zeros((count, 2 * DEGREE + 1))
    values = np.empty((count, y.shape[1]))
    given = BSpline.design_matrix(x, t, DEGREE).tocoo()
    # Derivatives come after the first value and before the last one: so no pivot is zero.
    place = np.arange(len(x)) + np.where(np.arange(len(x)) > 0, begin, 0)
    place[-1] = count - 1
    rows[place[given.row], given.col - place[given.row] + DEGREE] = given.data
    values[place] = y
    six, columns = np.eye(DEGREE + 1), np.arange(DEGREE + 1)
    for row, (order, value) in enumerate(first, start=1):
        rows[row, columns - row + DEGREE] = BSpline(t[:12], six, DEGREE)(x[0], order)
        values[row] = value
    for away, (order, value) in enumerate(last, start=1):
        row = count - 1 - away
        rows[row, columns + count - 6 - row + DEGREE] = BSpline(t[-12:], six, DEGREE)(x[-1], order)
        values[row] = value
    return BSpline(t, solve_banded(rows, values), DEGREE)


def closed_quintic_spline(x: FloatArray, y: FloatArray) -> Any:
    """Compute the periodic spline of degree five (scipy's BSpline) through values (n + 1, d) at knots (n + 1,).

    Args:
        x: knots, rising.
        y: values there, the last one equal to the first.
    """
    from scipy.interpolate import BSpline

    n = len(x) - 1
    turns, place = np.divmod(np.arange(-AROUND, n + AROUND + 1), n)
    unrolled = quintic_spline(x[place] + turns * (x[-1] - x[0]), y[place])
    t = unrolled.t[AROUND - 2 : AROUND + n + 9]
    # The last digits too are the same a turn later.
    c = unrolled.c[AROUND - 2 + np.arange(n + DEGREE) % n]
    return BSpline(t, c, DEGREE, extrapolate="periodic")
