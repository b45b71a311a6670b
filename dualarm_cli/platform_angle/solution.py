"""Solution of a platform solver: candidate angles of a batch of moves, and their order.

`solve_fixed` keeps the platform at its start angle, the baseline of every comparison.
"""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.geometry.elementary import TURN, arccos, cos, sin
from dualarm_cli.platform_angle.problem import (
    REACH_SLACK,
    Kind,
    PlatformProblem,
    cosine_coefficients,
)
from dualarm_cli.records import dataclass

DEGENERATE = 1e-12
"""Change of x per turn below which the platform angle has no effect."""
EVEN = 1e-8
"""Tolerance for equal imbalances, where the shorter platform motion decides [rad]."""


@dataclass(frozen=True)
class PlatformSolution:
    """Candidate platform angles of n moves, at most k each, as read-only arrays."""

    problem: PlatformProblem
    """The moves."""
    angle: FloatArray
    """Platform angles within half a turn of the start [rad], shape (n, k); 0 if invalid."""
    kind: IntArray
    """Kinds of the candidates (`Kind`), shape (n, k)."""
    valid: BoolArray
    """Mask of the entries that are candidates, shape (n, k)."""
    reachable: BoolArray
    """Mask of candidates within reach of both arms, shape (n, k)."""
    delta: FloatArray
    """Elbow displacement of each arm [rad], shape (n, k, 2); 0 out of reach."""
    degenerate: BoolArray
    """Mask of moves on which the platform angle has no effect, shape (n,)."""
    always_balanced: BoolArray
    """Mask of moves with equal displacements at every angle, shape (n,); the start is a root."""
    balanced_first: bool = False
    """Flag: candidates other than roots are ordered by imbalance, not by platform travel."""

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for name in (
            "angle",
            "kind",
            "valid",
            "reachable",
            "delta",
            "degenerate",
            "always_balanced",
        ):
            getattr(self, name).setflags(write=False)

    @property
    def is_root(self) -> BoolArray:
        """Mask of reachable roots, shape (n, k)."""
        root = (self.kind == Kind.ROOT_SAME) | (self.kind == Kind.ROOT_OPPOSITE)
        return np.asarray(self.reachable & root)

    @property
    def imbalance(self) -> FloatArray:
        """Imbalance | |delta_1| - |delta_2| | [rad], shape (n, k); infinite out of reach."""
        size = np.abs(self.delta)
        return np.where(self.reachable, np.abs(size[..., 0] - size[..., 1]), np.inf)

    @property
    def order(self) -> IntArray:
        """Column numbers by preference, shape (n, k): reachable first, roots before others.

        Roots are ordered by platform travel, the others by `balanced_first`.
        """
        root = self.is_root
        travel = np.abs(self.angle - self.problem.angle_0[:, None])
        tier = np.where(root, 0, np.where(self.reachable, 1, np.where(self.valid, 2, 3)))
        if not self.balanced_first:
            return np.lexsort((travel, tier), axis=1)
        # Imbalances within EVEN of the least are equal, because they may differ by rounding alone.
        imbalance = np.where(root, np.inf, self.imbalance)
        least = imbalance.min(axis=1, keepdims=True, initial=np.inf)
        uneven = np.where(imbalance <= least + EVEN, 0.0, self.imbalance)
        return np.lexsort((travel, uneven, tier), axis=1)

    @property
    def best(self) -> IntArray:
        """Column of the preferred candidate, or -1 if none is in reach, shape (n,)."""
        if self.angle.shape[1] == 1:
            return np.where(self.reachable[:, 0], 0, -1)
        first = self.order[:, 0]
        return np.where(self.reachable[np.arange(len(first)), first], first, -1)

    def rows(self, index: slice | IntArray | BoolArray) -> PlatformSolution:
        """Select moves with their candidates."""
        names = [name for name in self.__dataclass_fields__ if name != "balanced_first"]
        parts = {name: getattr(self, name)[index] for name in names if name != "problem"}
        return PlatformSolution(
            self.problem.rows(index), **parts, balanced_first=self.balanced_first
        )

    def preferred(self, row: int) -> list[float]:
        """Return the reachable angles of a move by preference [rad]."""
        move = self.rows(np.array([row]))
        return [float(move.angle[0, k]) for k in move.order[0] if move.reachable[0, k]]

    def reason(self, row: int) -> str | None:
        """Explain why a move has no reachable angle, or an arbitrary one; else None."""
        if self.degenerate[row]:
            text = "both shoulders or wrists lie on the platform axis: every angle is equal"
            return text if self.reachable[row].any() else f"{text}, and out of reach"
        if not self.reachable[row].any():
            return "no candidate angle brings both wrists within reach"
        if self.always_balanced[row]:
            return "both elbows turn alike at every angle: the platform can stay at rest"
        return None


def build_solution(
    problem: PlatformProblem,
    angle: FloatArray,
    kind: IntArray,
    valid: BoolArray,
    always_balanced: BoolArray | None = None,
    coefficients: FloatArray | None = None,
) -> PlatformSolution:
    """Complete candidate angles with reach and elbow displacements.

    Args:
        problem: the moves.
        angle: candidate angles of any turn [rad], shape (n, k).
        kind: `Kind` of each candidate, shape (n, k) or (k,).
        valid: mask of the entries that are candidates, shape (n, k).
        always_balanced: mask of moves with equal displacements at every angle, shape (n,); None for none.
        coefficients: of the problem's `cosine_coefficients`, if the caller has them.
    """
    if coefficients is None:
        coefficients = cosine_coefficients(problem)
    turned = np.where(valid, nearest_turn(angle, problem.angle_0[:, None]), 0.0)
    reachable = np.zeros(valid.shape, dtype=np.bool_)
    delta = np.zeros((*valid.shape, 2))
    # Most entries are no candidates: cosines are computed for candidates only.
    row, column = np.nonzero(valid)
    phi = turned[row, column]
    c, s = cos(phi)[:, None], sin(phi)[:, None]
    u, v, w = (coefficients[..., k][row] for k in range(3))
    x = u + v * c + w * s
    reached: BoolArray = np.asarray((np.abs(x) <= 1.0 + REACH_SLACK).all(axis=1))
    reachable[row, column] = reached
    moved = arccos(np.clip(x, -1.0, 1.0)) - problem.elbow_0[row]
    delta[row, column] = np.where(reached[:, None], moved, 0.0)
    return PlatformSolution(
        problem,
        turned,
        np.broadcast_to(kind, turned.shape),
        valid,
        reachable,
        delta,
        is_degenerate(coefficients),
        np.zeros(len(turned), dtype=np.bool_) if always_balanced is None else always_balanced,
    )


def nearest_turn(angle: FloatArray, start: FloatArray) -> FloatArray:
    """Shift angles by whole turns to within half a turn of the start [rad].

    An angle within half a turn keeps all its digits.
    """
    return angle - TURN * np.round((angle - start) / TURN)


def is_degenerate(coefficients: FloatArray) -> BoolArray:
    """Select the moves in which the platform angle changes no elbow: a mask, shape (n,)."""
    swing = np.hypot(coefficients[..., 1], coefficients[..., 2])
    return np.asarray((swing <= DEGENERATE).all(axis=-1))


def solve_fixed(problem: PlatformProblem) -> PlatformSolution:
    """Keep the platform at its start angle, the only candidate of every move."""
    angle = problem.angle_0[:, None]
    kind = np.full(angle.shape, Kind.START, dtype=np.int64)
    return build_solution(problem, angle, kind, np.ones(angle.shape, dtype=np.bool_))
