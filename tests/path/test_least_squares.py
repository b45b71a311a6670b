"""The quadratic program against its optimality conditions, and what it refuses."""

from __future__ import annotations

import numpy as np

from dualarm_cli.kinds.path.following.velocity import LeastSquares


def test_solutions_meet_the_optimality_conditions() -> None:
    """Random programs: feasible, and the gradient is a combination of the rows and of bounds that are active."""
    random = np.random.default_rng(0)
    program = LeastSquares()
    for _ in range(50):
        n, m = 8, 5
        A, x0 = random.normal(size=(m, n)), random.uniform(-0.9, 0.9, n)
        wish = random.normal(size=n) * 2.0
        x = program.solve(wish, A, A @ x0, -np.ones(n), np.ones(n))
        assert x is not None
        np.testing.assert_allclose(A @ x, A @ x0, atol=1e-7)
        assert np.abs(x).max() <= 1.0 + 1e-7
        inner = np.abs(x) < 1.0 - 1e-5
        # x - wish = A^T y + bounds: on joints off their bounds the row space alone.
        y = np.linalg.lstsq(A[:, inner].T, (x - wish)[inner], rcond=None)[0]
        rest = (x - wish) - A.T @ y
        np.testing.assert_allclose(rest[inner], 0.0, atol=1e-5)


def test_impossible_programs_and_no_numbers_have_no_solution() -> None:
    """Rows beyond the bounds, and NaN anywhere, which the solver itself would take for no bound."""
    program, A = LeastSquares(), np.ones((1, 3))
    one = np.ones(3)
    assert program.solve(np.zeros(3), A, np.array([4.0]), -one, one) is None
    assert (
        program.solve(np.zeros(3), A, np.array([1.0]), -one, np.array([1.0, np.nan, 1.0])) is None
    )
    assert program.solve(np.array([np.nan, 0.0, 0.0]), A, np.array([1.0]), -one, one) is None
    x = program.solve(np.zeros(3), A, np.array([1.5]), -one, one)
    np.testing.assert_allclose(x, 0.5, atol=1e-7)
