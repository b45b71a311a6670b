"""Manipulability of all tools, its gradient and the gradient's rate, from joint screws."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.geometry.linear_systems import determinant, inverse
from dualarm_cli.geometry.products import product
from dualarm_cli.kinematics.whole_body import WholeBody, cobracket, screw_rates
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class ManipulabilityRates:
    """Gradient of the logarithm of manipulability at one configuration, and its rate."""

    gradient: FloatArray
    """d log M / dq [1/rad], shape (n,)."""
    inner: FloatArray
    """Part of the gradient that moves no tool [1/rad], shape (n,)."""
    rate: FloatArray
    """d gradient / dt at the given velocity [1/(rad s)], shape (n,)."""


def manipulability(J: FloatArray) -> FloatArray:
    """Compute M = sqrt(det(J J^T)) of Jacobians (..., r, n), see [Zhang2024] Eq. 10.

    Its unit is m^3/rad^3 for one tool (three singular directions in m/rad, three in rad/rad), the product for two. M of
    [Zhang2024]'s J_G, whose rows are the mean of both tools' and right minus left (Eq. 4; the print of J_r has the
    signs turned), and of [J_R; J_L] are equal, because they differ by a factor of determinant ±1.
    """
    values: FloatArray = np.sqrt(np.maximum(determinant(product(J, np.swapaxes(J, -1, -2))), 0.0))
    return values


def manipulability_rates(
    body: WholeBody, S: FloatArray, qd: FloatArray, follows: BoolArray | None = None
) -> ManipulabilityRates:
    """Compute the gradient of log M of stacked tool Jacobians, and its rate.

    M does not depend on the points of the tools that the Jacobians are for. Here that is the world's origin, so that
    the columns are the screws themselves, and their derivatives are Lie brackets, dS_j/dq_i = [S_i, S_j] for a joint i
    that carries joint j and 0 else (the kinematic Hessian in closed form). With the pseudo-inverse J+ of n rows W_j,
    d log M / dq_i = tr(dJ/dq_i J+) (half of [Zhang2024] Eq. 11's first line, which is twice the true derivative)
    = S_i . sum over j carried by i of P_j, P_j = -ad(S_j)^T W_j. The rate is its total derivative, with dJ+/dt of
    Eq. 16.

    Args:
        body: kinematics of the robot.
        S: screws, shape (n, 6).
        qd: joint velocities [rad/s], shape (n,).
        follows: flags of arms whose tools count, shape (a,); None for all.

    Raises:
        SingularMatrixError: the Jacobian is singular to the last digit.
    """
    moves, before = body.moves if follows is None else body.moves[follows], body.before
    Sd = screw_rates(S, before, qd)
    J, Jd = _stacked(S, moves), _stacked(Sd, moves)
    gram = product(J, J.T)
    gram_inverse = inverse(gram)
    plus = product(J.T, gram_inverse)
    # d/dt J+ = (I - J+ J) dJ^T (J J^T)^-1 - J+ dJ J+ (Eq. 16).
    back = product(Jd.T, gram_inverse)
    plus_rate = back - product(plus, product(J, back)) - product(plus, product(Jd, plus))
    W, Wd = _folded(plus, moves), _folded(plus_rate, moves)
    P = -cobracket(S, W)
    Pd = -cobracket(Sd, W) - cobracket(S, Wd)
    carried = before.astype(np.float64)
    sum_P, sum_Pd = product(carried, P), product(carried, Pd)
    gradient = np.einsum("ij,ij->i", S, sum_P)
    rate = np.einsum("ij,ij->i", Sd, sum_P) + np.einsum("ij,ij->i", S, sum_Pd)
    inner = gradient - product(plus, product(J, gradient))
    return ManipulabilityRates(gradient, inner, rate)


def _stacked(S: FloatArray, moves: BoolArray) -> FloatArray:
    """Stack the tools' Jacobians for the world's origin, shape (6 a, n)."""
    stacked: FloatArray = (moves[:, None, :] * S.T).reshape(-1, len(S))
    return stacked


def _folded(plus: FloatArray, moves: BoolArray) -> FloatArray:
    """Sum rows of J+ (n, 6 a) over each joint's tools, (n, 6)."""
    folded: FloatArray = (plus.reshape(len(plus), len(moves), 6) * moves.T[:, :, None]).sum(axis=1)
    return folded
