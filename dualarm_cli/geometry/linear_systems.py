"""Small dense systems, determinants and singular values with the same bits on every processor.

Matrices may be stacks (..., m, n). Methods: Gauss elimination with pivots and one-sided Jacobi rotations
(Hestenes 1958). For matrices of this size both are as accurate as LAPACK.
"""

from __future__ import annotations

from ctypes import c_int64

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.native import function, numbers, pointer

ZERO = 1e-14
"""Singular value, relative to the largest one, that counts as zero."""


class SingularMatrixError(ArithmeticError):
    """Error: a matrix has no inverse."""


def solve(A: FloatArray, right: FloatArray) -> FloatArray:
    """Solve systems A x = right, for vectors (n,) or matrices (..., n, m).

    Raises:
        SingularMatrixError: a matrix is singular to the last digit.
    """
    columns = right[:, None] if right.ndim == 1 else right
    if columns.ndim != A.ndim:
        columns = np.broadcast_to(columns, (*A.shape[:-2], *columns.shape[-2:]))
    x, determinants = _eliminated(A, columns)
    if not determinants.all():
        raise SingularMatrixError("a matrix is singular")
    return x[..., 0] if right.ndim == 1 else x


def inverse(A: FloatArray) -> FloatArray:
    """Invert square matrices.

    Raises:
        SingularMatrixError: a matrix is singular to the last digit.
    """
    return solve(A, np.eye(A.shape[-1]))


def determinant(A: FloatArray) -> FloatArray:
    """Compute the determinants of square matrices, shape (...)."""
    return _eliminated(A, np.empty((*A.shape[:-1], 0)))[1]


def _eliminated(A: FloatArray, right: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compute solutions (..., n, m) and determinants (...) of systems."""
    used, x = np.array(A, dtype=np.float64, order="C"), np.array(right, np.float64, order="C")
    determinants = np.empty(A.shape[:-2])
    function("solve", *[c_int64] * 3)(
        determinants.size, *x.shape[-2:], *map(pointer, (used, x, determinants))
    )
    return x, determinants


def singular_values(A: FloatArray) -> FloatArray:
    """Compute the singular values of matrices (..., m, n), descending."""
    rows = A if A.shape[-2] <= A.shape[-1] else np.swapaxes(A, -1, -2)
    return np.sort(norm(_orthogonal(rows)[0], axis=-1), axis=-1)[..., ::-1]


def null_space(A: FloatArray) -> FloatArray:
    """Compute orthonormal rows of the null spaces of matrices (..., m, n)."""
    turned, V = _orthogonal(np.swapaxes(A, -1, -2))
    order = np.argsort(norm(turned, axis=-1), axis=-1, kind="stable")
    rows = np.sort(order[..., : A.shape[-1] - A.shape[-2]], axis=-1)
    return np.take_along_axis(V, rows[..., None], axis=-2)


def least_squares(A: FloatArray, right: FloatArray) -> FloatArray:
    """Compute the shortest least-squares solution (n,) of A x = right (m,)."""
    turned, V = _orthogonal(A.T)
    squares = np.sum(turned * turned, axis=1)
    large = squares > ZERO * ZERO * squares.max(initial=0.0)
    solution: FloatArray = product(product(turned[large], right) / squares[large], V[large])
    return solution


def _orthogonal(rows: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compute rotations V (..., n, n) and orthogonal rows V A (..., n, m)."""
    turned = np.array(rows, dtype=np.float64, order="C")
    n, m = turned.shape[-2:]
    V = np.array(np.broadcast_to(np.eye(n), (*turned.shape[:-2], n, n)), order="C")
    function("orthogonalise", *[c_int64] * 3)(
        V.size // max(1, n * n), n, m, *map(pointer, (turned, V))
    )
    return turned, V


def zeros_of(coefficients: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compute all zeros of monic polynomials: real and imaginary parts, both (b, n).

    Aberth's method (1973) iterates all zeros of a polynomial together.

    Args:
        coefficients: of t^0 to t^(n-1), shape (b, n).
    """
    real, imaginary = np.empty(coefficients.shape), np.empty(coefficients.shape)
    given = numbers(coefficients)
    function("zeros", *[c_int64] * 2)(*coefficients.shape, *map(pointer, (given, real, imaginary)))
    return real, imaginary


def solve_banded(rows: FloatArray, right: FloatArray) -> FloatArray:
    """Solve a banded system without pivots, as of splines or positive definite.

    Args:
        rows: row i has columns i - k to i + k, shape (n, 2k + 1); entries outside the matrix are not read.
        right: right sides, shape (n, m).
    """
    used, x = np.array(rows, np.float64, order="C"), np.array(right, np.float64, order="C")
    k = rows.shape[1] // 2
    function("solve_banded", *[c_int64] * 4)(len(rows), k, k, x.shape[1], *map(pointer, (used, x)))
    return x
