"""The paper's method: equal elbow displacements with arccos replaced by its first-order series."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.roots import first_order_zeros
from dualarm_cli.platform_angle.problem import (
    Kind,
    PlatformProblem,
    PlatformSolution,
    build_solution,
    cosine_coefficients,
)

KINDS = np.array(
    [Kind.ROOT_SAME] * 2
    + [Kind.ROOT_OPPOSITE] * 2
    + [Kind.STATIONARY_SAME] * 2
    + [Kind.STATIONARY_OPPOSITE] * 2,
    dtype=np.int64,
)
"""Kinds of the eight candidates: Eq. 14 for both signs of Eq. 5, then Eq. 15 for both."""


def solve_linearised(problem: PlatformProblem) -> PlatformSolution:
    """Returns the paper's candidates: roots of Eq. 14 and stationary points of Eq. 15.

    To first order q4 = pi/2 - x, so that equal displacements mean x_1,f - x_1,0 = ±(x_2,f - x_2,0) ([Bottin2021]
    Eq. 4 and 5; arms with links of their own keep this form, in which the paper's common 2 a1 a2 has been divided
    out). Of several reachable roots the one nearest the start is preferred; where no root is reachable, the
    nearest reachable stationary point.
    """
    coefficients = cosine_coefficients(problem)
    x_0 = np.cos(problem.elbow_0)
    angles, exists = [], []
    stationary = []
    for sign in (1.0, -1.0):
        A = coefficients[:, 0, 0] - x_0[:, 0] - sign * (coefficients[:, 1, 0] - x_0[:, 1])
        B = coefficients[:, 0, 1] - sign * coefficients[:, 1, 1]
        C = coefficients[:, 0, 2] - sign * coefficients[:, 1, 2]
        angle, found = first_order_zeros(A, B, C)  # Eq. 12 to 14
        angles.append(angle)
        exists.append(found)
        stationary.append(_stationary(B, C))  # Eq. 15
    flat = np.column_stack([np.hypot(*pair) > 0 for pair in _amplitudes(coefficients)])
    valid = np.hstack([*exists, np.repeat(flat, 2, axis=1)])
    return build_solution(problem, np.hstack([*angles, *stationary]), KINDS, valid)


def _stationary(B: FloatArray, C: FloatArray) -> FloatArray:
    """Returns both stationary points of A + B cos + C sin, in the order of Eq. 15, shape (n, 2)."""
    second = np.arctan2(C, B)
    return np.column_stack([second + np.pi, second])


def _amplitudes(coefficients: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
    """Returns B and C for both signs."""
    one, two = coefficients[:, 0], coefficients[:, 1]
    return [(one[:, 1] - s * two[:, 1], one[:, 2] - s * two[:, 2]) for s in (1.0, -1.0)]
