"""Splines through values and rotations with the same bits on every processor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.linear_systems import inverse, solve_banded
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.geometry.rotations import exp_rotation, log_rotation, right_jacobian
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class SplineTolerances:
    """Numerical settings of splines."""

    degree: int = 5
    around: int = 48
    """Number of values repeated beyond each end of a closed spline.

    The influence of the outermost values is below the last digit.
    """
    rounds: int = 30
    """Maximum number of iterations for angular rates."""
    settled: float = 1e-12
    """Relative change of angular rates at which the iteration ends."""
    step: float = 1e-4
    """Step of finite differences [rad]."""


SPLINES = SplineTolerances()

Rates = Sequence[tuple[int, FloatArray]]
"""Orders of the derivatives at an end, ascending, with their values (d,)."""


def quintic_spline(x: FloatArray, y: FloatArray, first: Rates = (), last: Rates = ()) -> Any:
    """Compute a quintic spline (scipy's BSpline) through values (n, d) at knots.

    Args:
        x: knots, rising.
        y: values there.
        first: two derivatives at the first knot; without them, the first pieces are a single polynomial.
        last: the same at the last knot.
    """
    # Slow to import, and needed for splines alone.
    from scipy.interpolate import BSpline

    inner = x[1:-1] if len(first) else x[3:-3]
    ends = np.full(SPLINES.degree + 1, x[0]), np.full(SPLINES.degree + 1, x[-1])
    t = np.concatenate([ends[0], inner, ends[1]])
    count, first_count = len(t) - SPLINES.degree - 1, len(first)
    rows = np.zeros((count, 2 * SPLINES.degree + 1))
    values = np.empty((count, y.shape[1]))
    collocation = BSpline.design_matrix(x, t, SPLINES.degree).tocoo()
    # Derivatives come after the first value and before the last one: so no pivot is zero.
    row_of = np.arange(len(x)) + np.where(np.arange(len(x)) > 0, first_count, 0)
    row_of[-1] = count - 1
    rows[row_of[collocation.row], collocation.col - row_of[collocation.row] + SPLINES.degree] = (
        collocation.data
    )
    values[row_of] = y
    basis, columns = np.eye(SPLINES.degree + 1), np.arange(SPLINES.degree + 1)
    for row, (order, value) in enumerate(first, start=1):
        rows[row, columns - row + SPLINES.degree] = BSpline(t[:12], basis, SPLINES.degree)(
            x[0], order
        )
        values[row] = value
    for offset, (order, value) in enumerate(last, start=1):
        row = count - 1 - offset
        rows[row, columns + count - 6 - row + SPLINES.degree] = BSpline(
            t[-12:], basis, SPLINES.degree
        )(x[-1], order)
        values[row] = value
    return BSpline(t, solve_banded(rows, values), SPLINES.degree)


def closed_quintic_spline(x: FloatArray, y: FloatArray) -> Any:
    """Compute a periodic quintic spline (scipy's BSpline) through values (n + 1, d).

    Args:
        x: knots, rising.
        y: values there, the last one equal to the first.
    """
    from scipy.interpolate import BSpline

    n = len(x) - 1
    turns, place = np.divmod(np.arange(-SPLINES.around, n + SPLINES.around + 1), n)
    unrolled = quintic_spline(x[place] + turns * (x[-1] - x[0]), y[place])
    t = unrolled.t[SPLINES.around - 2 : SPLINES.around + n + 9]
    # Coefficients repeat after a period, to the last digit.
    c = unrolled.c[SPLINES.around - 2 + np.arange(n + SPLINES.degree) % n]
    return BSpline(t, c, SPLINES.degree, extrapolate="periodic")


@dataclass(frozen=True)
class CubicSteps:
    """Natural cubic spline as polynomials from knot to knot, each from zero."""

    knots: FloatArray
    """Parameters of the knots, rising, shape (n,)."""
    powers: FloatArray
    """Coefficients of t, t² and t³ by step, shape (3, n - 1, d)."""

    def at(self, u: FloatArray) -> tuple[Any, FloatArray, FloatArray]:
        """Evaluate steps (k,), displacements since their first knots and rates, both (k, d)."""
        step = np.clip(np.searchsorted(self.knots, u, side="right") - 1, 0, len(self.knots) - 2)
        t = (u - self.knots[step])[:, None]
        linear, quadratic, cubic = self.powers[:, step]
        displacement = t * (linear + t * (quadratic + t * cubic))
        return step, displacement, linear + t * (2.0 * quadratic + 3.0 * t * cubic)


@dataclass(frozen=True)
class PoseSpline:
    """Natural cubic spline through poses, C2 in position and in rotation."""

    rotations: FloatArray
    """Rotations at the knots, shape (n, 3, 3)."""
    positions: FloatArray
    """Positions at the knots [m], shape (n, 3)."""
    turning: CubicSteps
    """Rotation vectors from knot to knot [rad]."""
    moving: CubicSteps
    """Displacements from knot to knot [m]."""

    @classmethod
    def through(cls, knots: FloatArray, R: FloatArray, p: FloatArray) -> PoseSpline:
        """Compute the spline through rotations (n, 3, 3) and positions (n, 3)."""
        turns = log_rotation(product(np.swapaxes(R[:-1], -1, -2), R[1:]))
        moving = _natural(knots, np.diff(p, axis=0), turning=False)
        return cls(R, p, _natural(knots, turns, turning=True), moving)

    def at(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute rotations (k, 3, 3) and positions (k, 3) [m] at parameters (k,)."""
        step, turn, _ = self.turning.at(u)
        R = product(self.rotations[step], exp_rotation(turn))
        return R, self.positions[step] + self.moving.at(u)[1]

    def rates(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute angular velocities in the turned frame, and velocities, both (k, 3)."""
        _, turn, rate = self.turning.at(u)
        return np.einsum("kij,kj->ki", right_jacobian(turn), rate), self.moving.at(u)[2]


def _natural(knots: FloatArray, displacements: FloatArray, *, turning: bool) -> CubicSteps:
    """Compute a natural spline from its rates at the knots.

    Acceleration is continuous at inner knots and zero at both ends. Angular acceleration at the end of a step is not
    linear in the rates: its nonlinear part is that of the previous iteration.

    Args:
        knots: rising, shape (n,).
        displacements: from knot to knot, shape (n - 1, 3); rotation vectors in the frame of the first one.
        turning: whether they are rotation vectors.
    """
    h, n, eye = np.diff(knots)[:, None], len(knots), np.eye(3)
    J = right_jacobian(displacements) if turning else np.broadcast_to(eye, (n - 1, 3, 3))
    J_inverse = inverse(J)
    lower, diagonal, upper = np.zeros((3, n, 3, 3))
    lower[1:], upper[:-1] = 2.0 * J / h[..., None], 2.0 * J_inverse / h[..., None]
    constant = np.zeros((n, 3))
    for side in (slice(1, n), slice(0, n - 1)):
        diagonal[side] += 4.0 * eye / h[..., None]
        constant[side] += 6.0 * displacements / np.square(h)
    rows = np.zeros((3 * n, 11))
    for a, b in np.ndindex(3, 3):
        for offset, block in ((2, lower), (5, diagonal), (8, upper)):
            rows[a::3, offset + b - a] = block[:, a, b]
    rate, last = np.zeros((n, 3)), np.zeros((n - 1, 3))
    for _ in range(SPLINES.rounds if turning else 1):
        right_side = constant.copy()
        if turning:
            step = SPLINES.step / max(float(norm(last)), SPLINES.step)
            change = right_jacobian(displacements + step * last) - right_jacobian(
                displacements - step * last
            )
            right_side[1:] -= np.einsum("kij,kj->ki", change, last) / (2.0 * step)
        before, rate = rate, solve_banded(rows, right_side.reshape(-1, 1)).reshape(n, 3)
        last = np.einsum("kij,kj->ki", J_inverse, rate[1:])
        if norm(rate - before) <= SPLINES.settled * norm(rate):
            break
    quadratic = (3.0 * displacements / h - 2.0 * rate[:-1] - last) / h
    cubic = (rate[:-1] + last - 2.0 * displacements / h) / np.square(h)
    return CubicSteps(knots, np.stack([rate[:-1], quadratic, cubic]))
