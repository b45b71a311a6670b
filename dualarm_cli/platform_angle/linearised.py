"""The paper's linearised solver: equal elbow displacements with a first-order arccos."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import arctan2, cos
from dualarm_cli.geometry.roots import first_order_zeros
from dualarm_cli.platform_angle.problem import Kind, PlatformProblem, cosine_coefficients
from dualarm_cli.platform_angle.solution import (
    DEGENERATE,
    PlatformSolution,
    build_solution,
    is_degenerate,
)

KINDS = np.array(
    [Kind.ROOT_SAME] * 2
    + [Kind.ROOT_OPPOSITE] * 2
    + [Kind.STATIONARY_SAME] * 2
    + [Kind.STATIONARY_OPPOSITE] * 2
    + [Kind.START],
    dtype=np.int64,
)
"""Kinds of the candidates: Eq. 14 for both signs of Eq. 5, Eq.

15 for both, and the start.
"""


def solve_linearised(problem: PlatformProblem) -> PlatformSolution:
    """Compute the paper's candidates: roots of Eq. 14 and stationary points of Eq. 15.

    To first order q4 = pi/2 - x, so that equal displacements mean x_1,f - x_1,0 = ±(x_2,f - x_2,0) ([Bottin2021]
    Eq. 4 and 5; arms with different links keep this form, because the paper's common 2 a1 a2 is divided out). The
    reachable root nearest the start is preferred; without one, the nearest reachable stationary point. If Eq. 12 has no
    term in the angle for a sign and holds (A = B = C = 0), or if the angle changes no elbow, every angle is equal: then
    the start is a candidate.
    """
    coefficients = cosine_coefficients(problem)
    x_0 = cos(problem.elbow_0)
    roots, stationary = [], []
    exists, bends, always_balanced = [], [], []
    for sign in (1.0, -1.0):
        first, second = coefficients[:, 0], coefficients[:, 1]
        A = first[:, 0] - x_0[:, 0] - sign * (second[:, 0] - x_0[:, 1])  # Eq. 13
        B, C = first[:, 1] - sign * second[:, 1], first[:, 2] - sign * second[:, 2]
        bent = np.hypot(B, C) > DEGENERATE
        angle, real = first_order_zeros(A, B, C)  # Eq. 12 to 14
        roots.append(angle)
        exists.append(real & bent[:, None])
        stationary.append(_stationary(B, C))  # Eq. 15
        bends.append(np.column_stack([bent, bent]))
        always_balanced.append(~bent & (np.abs(A) <= DEGENERATE))
    start = (always_balanced[0] | always_balanced[1] | is_degenerate(coefficients))[:, None]
    kind = np.tile(KINDS, (len(x_0), 1))
    for always, root in zip(always_balanced, (Kind.ROOT_SAME, Kind.ROOT_OPPOSITE), strict=True):
        kind[always, -1] = root
    return build_solution(
        problem,
        np.hstack([*roots, *stationary, problem.angle_0[:, None]]),
        kind,
        np.hstack([*exists, *bends, start]),
        always_balanced=always_balanced[0] | always_balanced[1],
        coefficients=coefficients,
    )


def _stationary(B: FloatArray, C: FloatArray) -> FloatArray:
    """Compute both stationary points of the difference, shape (n, 2)."""
    second = arctan2(C, B)
    return np.column_stack([second + np.pi, second])
