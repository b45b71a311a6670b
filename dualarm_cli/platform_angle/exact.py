"""Exactly equal elbow displacements, in closed form; where there are none, the exact best."""

from __future__ import annotations

from typing import Any

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.platform_angle.balance import ROOT_TOLERANCE, balanced_angles
from dualarm_cli.platform_angle.fallback import unbalanced_angles
from dualarm_cli.platform_angle.problem import Kind, PlatformProblem, cosine_coefficients
from dualarm_cli.platform_angle.solution import PlatformSolution, build_solution

CHUNK = 4096
"""Moves solved at a time: their arrays stay in the processor's cache."""
FALLBACKS = 4
"""Candidates kept for a move without a reachable root, the best balanced first."""
ROOTS = (int(Kind.ROOT_SAME), int(Kind.ROOT_OPPOSITE))
ROOT_KINDS = np.repeat(np.array(ROOTS, dtype=np.int64), 4)
FIELDS = ("angle", "kind", "valid", "reachable", "delta")
"""Arrays of a solution with one column per candidate."""


def solve_exact(problem: PlatformProblem) -> PlatformSolution:
    """Returns all angles at which the elbows move equally; where there is none, what is nearest.

    With K = q4_1,0 - s q4_2,0 and s = ±1 we want q4_1 - s q4_2 = K. The cosine of both sides, the root squared away:

        x_1² + x_2² - 2 cos(K) x_1 x_2 - sin²(K) = 0,

    a trigonometric polynomial of order two in the platform angle, because every x_i is of order one. Its
    zeros (at most four) are polished by Newton steps on the unsquared equation and kept only if they solve it.
    A move without a reachable root gets the stationary points of q4_1 - s q4_2 and the angles at which an arm is
    just stretched or folded, best balanced first. Where every angle is a root, the start is given, or the edges of the
    reach if the start is out of it. Within 1e-6 rad of a stretched or folded elbow the last digit of a platform
    angle can move the elbow by more than a root may be off; a root there is not told from the boundary, which is
    listed where no other root is reachable. Our own derivation, after [Bottin2021] Eq. 3.
    """
    n = len(problem.angle_0)
    chunks = [_solve_chunk(problem.rows(slice(k, k + CHUNK))) for k in range(0, max(n, 1), CHUNK)]
    if len(chunks) == 1:
        return chunks[0]

    def joined(name: str) -> Any:
        return np.concatenate([getattr(chunk, name) for chunk in chunks])

    return PlatformSolution(
        problem,
        **{name: joined(name) for name in (*FIELDS, "degenerate", "alike")},
        balanced_first=True,
    )


def _solve_chunk(problem: PlatformProblem) -> PlatformSolution:
    """Returns the candidates of a few thousand moves: eight columns of roots, then the fallbacks."""
    n, coefficients = len(problem.angle_0), cosine_coefficients(problem)
    angle, valid, alike = balanced_angles(coefficients, problem.elbow_0, problem.angle_0)
    angle = np.hstack([angle, np.zeros((n, FALLBACKS))])
    valid = np.hstack([valid, np.zeros((n, FALLBACKS), dtype=np.bool_)])
    kind = np.zeros(angle.shape, dtype=np.int64)
    kind[:, : ROOT_KINDS.size] = ROOT_KINDS
    # A start out of reach cannot stand for all angles: then the edges of the reach do.
    lost = alike & ~(angle == problem.angle_0[:, None]).any(axis=1, where=valid)
    missing = np.flatnonzero((~valid.any(axis=1) | lost) & _each_reaches(coefficients))
    if missing.size:
        rest = build_solution(
            problem.rows(missing),
            *unbalanced_angles(coefficients[missing], problem.angle_0[missing]),
            balanced_first=True,
            coefficients=coefficients[missing],
        )
        best = rest.order[:, :FALLBACKS]
        level = (rest.imbalance <= ROOT_TOLERANCE) & alike[missing, None]
        way = np.where((rest.delta[..., 0] * rest.delta[..., 1]) >= 0.0, *ROOTS)
        kinds = np.where(level, way, rest.kind)
        for values, found in ((angle, rest.angle), (valid, rest.valid), (kind, kinds)):
            values[missing, ROOT_KINDS.size :] = np.take_along_axis(found, best, axis=1)
    return build_solution(
        problem, angle, kind, valid, balanced_first=True, alike=alike, coefficients=coefficients
    )


def _each_reaches(coefficients: FloatArray) -> BoolArray:
    """Returns the moves in which each arm has an angle within its reach: else none serves both."""
    swing = np.hypot(coefficients[..., 1], coefficients[..., 2])
    return np.asarray((np.abs(coefficients[..., 0]) - swing <= 1.0 + 1e-9).all(axis=1))
