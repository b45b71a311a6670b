"""The one quadratic program that followers solve: nearest to a wish, on a linear task, within bounds."""

from __future__ import annotations

from typing import Any

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray

ABSOLUTE, RELATIVE = 1e-9, 1e-10
"""Tolerances of the solver."""


class LeastSquares:
    """min |x - wish|² subject to A x = b, least <= x <= most, and low <= G x <= high.

    Set up once, then updated: an interior-point method, which does not start from the solution before. An augmented
    Lagrangian one that does (proxsuite's, warm) took half of its 25 us, but left one instant in a hundred unsolved at
    this accuracy.
    """

    def __init__(self) -> None:
        """Loads the solver."""
        import piqp

        self._solver: Any = piqp.DenseSolver()
        self._solver.settings.eps_abs = ABSOLUTE
        self._solver.settings.eps_rel = RELATIVE
        self._solved = piqp.PIQP_SOLVED
        self._ready = False

    def solve(
        self,
        wish: FloatArray,
        A: FloatArray,
        b: FloatArray,
        least: FloatArray,
        most: FloatArray,
        rows: tuple[FloatArray, FloatArray, FloatArray] | None = None,
    ) -> FloatArray | None:
        """Returns x, shape (n,), or None where the solver finds none.

        Args:
            wish: shape (n,).
            A: of the equations, shape (m, n).
            b: their right sides, shape (m,).
            least: lower bounds, shape (n,).
            most: upper bounds, shape (n,).
            rows: G (k, n), low (k,) and high (k,), the same k every time; None for none.
        """
        given = (wish, A, b, least, most, *(rows or ()))
        # A NaN would be read as no bound, or as a solution.
        if not all(np.isfinite(part).all() for part in given):
            return None
        if not self._ready:
            G, low, high = rows or (None, None, None)
            self._solver.setup(np.eye(len(wish)), -wish, A, b, G, low, high, least, most)
            self._ready = True
        elif rows:
            G, low, high = rows
            self._solver.update(c=-wish, A=A, b=b, G=G, h_l=low, h_u=high, x_l=least, x_u=most)
        else:
            self._solver.update(c=-wish, A=A, b=b, x_l=least, x_u=most)
        if self._solver.solve() != self._solved:
            return None
        return np.array(self._solver.result.x)
