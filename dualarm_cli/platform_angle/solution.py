"""Solution of a platform solver: candidate angles of many moves, and their order.

`solve_fixed`, which keeps the platform where it is, is the baseline of every comparison.
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
"""Below this change of x over a whole turn the platform angle does not matter to an arm."""
EVEN = 1e-8
"""An imbalance this near to the least of a move is as good; then the shorter way of the platform decides [rad]."""


@dataclass(frozen=True)
class PlatformSolution:
    """Candidate platform angles of n moves, at most k each; its arrays are read-only."""

    problem: PlatformProblem
    """The moves."""
    angle: FloatArray
    """Platform angles, at most half a turn from the start [rad], shape (n, k); 0 where not valid."""
    kind: IntArray
    """What each is (`Kind`), shape (n, k)."""
    valid: BoolArray
    """Which entries are candidates, shape (n, k)."""
    reachable: BoolArray
    """Which candidates both arms can reach, shape (n, k)."""
    delta: FloatArray
    """Elbow displacement of each arm [rad], shape (n, k, 2); 0 where not reachable."""
    degenerate: BoolArray
    """Moves to which the platform angle does not matter, shape (n,)."""
    alike: BoolArray
    """Moves whose elbows turn equally at every angle, so that the start is a root, shape (n,)."""
    balanced_first: bool = False
    """Whether candidates that are no roots are ordered by imbalance, not by the platform's way."""

    def __post_init__(self) -> None:
        """Freezes the arrays."""
        for name in ("angle", "kind", "valid", "reachable", "delta", "degenerate", "alike"):
            getattr(self, name).setflags(write=False)

    @property
    def is_root(self) -> BoolArray:
        """Which candidates are reachable roots, shape (n, k)."""
        root = (self.kind == Kind.ROOT_SAME) | (self.kind == Kind.ROOT_OPPOSITE)
        return np.asarray(self.reachable & root)

    @property
    def imbalance(self) -> FloatArray:
        """| |delta_1| - |delta_2| | [rad], shape (n, k); infinite where not reachable."""
        size = np.abs(self.delta)
        return np.where(self.reachable, np.abs(size[..., 0] - size[..., 1]), np.inf)

    @property
    def order(self) -> IntArray:
        """Candidates by preference, shape (n, k): reachable before not; roots before the rest.

        Roots are ordered by the way of the platform, the others as `balanced_first` says.
        """
        root = self.is_root
        way = np.abs(self.angle - self.problem.angle_0[:, None])
        tier = np.where(root, 0, np.where(self.reachable, 1, np.where(self.valid, 2, 3)))
        if not self.balanced_first:
            return np.lexsort((way, tier), axis=1)
        # Equal to the best within EVEN is as good as the best: a comparison of rounding errors decides nothing.
        imbalance = np.where(root, np.inf, self.imbalance)
        least = imbalance.min(axis=1, keepdims=True, initial=np.inf)
        uneven = np.where(imbalance <= least + EVEN, 0.0, self.imbalance)
        return np.lexsort((way, uneven, tier), axis=1)

    @property
    def best(self) -> IntArray:
        """Column of the preferred candidate, or -1 where none is reachable, shape (n,)."""
        if self.angle.shape[1] == 1:
            return np.where(self.reachable[:, 0], 0, -1)
        first = self.order[:, 0]
        return np.where(self.reachable[np.arange(len(first)), first], first, -1)

    def rows(self, index: slice | IntArray | BoolArray) -> PlatformSolution:
        """Returns the candidates of some of the moves."""
        names = [name for name in self.__dataclass_fields__ if name != "balanced_first"]
        parts = {name: getattr(self, name)[index] for name in names if name != "problem"}
        return PlatformSolution(
            self.problem.rows(index), **parts, balanced_first=self.balanced_first
        )

    def preferred(self, row: int) -> list[float]:
        """Returns the reachable angles of one move by preference [rad]."""
        one = self.rows(np.array([row]))
        return [float(one.angle[0, k]) for k in one.order[0] if one.reachable[0, k]]

    def reason(self, row: int) -> str | None:
        """Returns why a move has no reachable angle, or why any will do; None if all is well."""
        if self.degenerate[row]:
            text = "both shoulders or wrists lie on the platform axis: every angle is equal"
            return text if self.reachable[row].any() else f"{text}, and out of reach"
        if not self.reachable[row].any():
            return "no candidate angle brings both wrists within reach"
        if self.alike[row]:
            return "both elbows turn alike at every angle: the platform can stay at rest"
        return None


def build_solution(
    problem: PlatformProblem,
    angle: FloatArray,
    kind: IntArray,
    valid: BoolArray,
    alike: BoolArray | None = None,
    coefficients: FloatArray | None = None,
) -> PlatformSolution:
    """Returns the candidates with reach and elbow displacements.

    Args:
        problem: the moves.
        angle: candidate angles of any turn [rad], shape (n, k).
        kind: what each is, shape (n, k) or (k,).
        valid: which entries are candidates, shape (n, k).
        alike: moves whose elbows turn equally at every angle, shape (n,); none if not given.
        coefficients: of the problem's `cosine_coefficients`, if the caller has them.
    """
    if coefficients is None:
        coefficients = cosine_coefficients(problem)
    turned = np.where(valid, nearest_turn(angle, problem.angle_0[:, None]), 0.0)
    reachable = np.zeros(valid.shape, dtype=np.bool_)
    delta = np.zeros((*valid.shape, 2))
    # Most entries are no candidates: only those that are cost a cosine.
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
        np.zeros(len(turned), dtype=np.bool_) if alike is None else alike,
    )


def nearest_turn(angle: FloatArray, start: FloatArray) -> FloatArray:
    """Returns angles [rad] less the whole turns that bring them within half a turn of the start.

    Nothing else is taken off, so that an angle within half a turn keeps all its digits.
    """
    return angle - TURN * np.round((angle - start) / TURN)


def is_degenerate(coefficients: FloatArray) -> BoolArray:
    """Returns the moves in which the platform angle changes no elbow, shape (n,)."""
    swing = np.hypot(coefficients[..., 1], coefficients[..., 2])
    return np.asarray((swing <= DEGENERATE).all(axis=-1))


def solve_fixed(problem: PlatformProblem) -> PlatformSolution:
    """Keep the platform at its start angle, the only candidate of every move."""
    angle = problem.angle_0[:, None]
    kind = np.full(angle.shape, Kind.START, dtype=np.int64)
    return build_solution(problem, angle, kind, np.ones(angle.shape, dtype=np.bool_))
