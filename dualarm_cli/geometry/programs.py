"""Small linear programs by HiGHS, and piqp's portable variant for quadratic programs."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import Any

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray


def least_cost(
    cost: FloatArray,
    matrix: tuple[IntArray, IntArray, FloatArray],
    bound: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
) -> FloatArray | None:
    """Solve a linear program: minimise cost @ x with matrix @ x <= bound.

    Args:
        cost: shape (n,).
        matrix: row, column and value of each entry; entries of the same row and column are added.
        bound: shape (m,).
        lower: shape (n,), -inf allowed.
        upper: shape (n,), inf allowed.

    Returns:
        The solution with lower <= x <= upper, shape (n,); None if the program has no optimum.
    """
    import highspy

    m, n = len(bound), len(cost)
    place, same = np.unique(matrix[0] * n + matrix[1], return_inverse=True)
    solver = highspy.Highs()
    # The simplex method needs no presolve for programs that it solves in milliseconds.
    for name, value in (("output_flag", False), ("presolve", "off"), ("threads", 1)):
        solver.setOptionValue(name, value)
    program = highspy.HighsLp()
    program.num_col_, program.num_row_ = n, m
    program.col_cost_, program.col_lower_, program.col_upper_ = cost, lower, upper
    program.row_lower_, program.row_upper_ = np.full(m, -np.inf), bound
    program.a_matrix_.format_ = highspy.MatrixFormat.kRowwise
    program.a_matrix_.start_ = np.searchsorted(place, n * np.arange(m + 1))
    program.a_matrix_.index_ = place % n
    program.a_matrix_.value_ = np.bincount(same, weights=matrix[2], minlength=len(place))
    solver.passModel(program)
    solver.run()
    if solver.getModelStatus() != highspy.HighsModelStatus.kOptimal:
        return None
    return np.array(solver.getSolution().col_value)


@cache
def plain_piqp() -> Any:
    """Load piqp's variant for any processor instead of this machine's."""
    return import_module("piqp.piqp_python")
