"""What a platform solver is asked and what it answers, for many moves at once."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray, readonly

REACH_SLACK = 1e-9
"""How far |x| = |cos q4| may exceed one by rounding before an arm counts as too short."""
DEGENERATE = 1e-12
"""Below this change of x over a whole turn the platform angle does not matter to an arm."""


class Kind(IntEnum):
    """What a candidate angle is."""

    START = 0
    """The platform stays."""
    ROOT_SAME = 1
    """Equal elbow displacements in the same direction (upper sign of Eq. 5)."""
    ROOT_OPPOSITE = 2
    """Equal elbow displacements in opposite directions (lower sign of Eq. 5)."""
    STATIONARY_SAME = 3
    """Stationary difference of the displacements (Eq. 15, upper sign)."""
    STATIONARY_OPPOSITE = 4
    """Stationary sum of the displacements (Eq. 15, lower sign)."""
    BOUNDARY = 5
    """An arm is just stretched or folded."""


@dataclass(frozen=True)
class PlatformProblem:
    """n moves of two arms on one turning platform, in the platform's axis frame (z along it)."""

    radius: FloatArray
    """Distance R0 of each shoulder from the axis [m], shape (n, 2)."""
    offset: FloatArray
    """Azimuth of each shoulder at platform angle 0 [rad], shape (n, 2)."""
    height: FloatArray
    """Height of each shoulder along the axis [m], shape (n, 2)."""
    upper: FloatArray
    """Upper arm a1 [m], shape (n, 2)."""
    fore: FloatArray
    """Forearm a2 [m], shape (n, 2)."""
    wrist: FloatArray
    """Wrist centres at the end of the move [m], shape (n, 2, 3)."""
    angle_0: FloatArray
    """Platform angle before the move [rad], shape (n,)."""
    elbow_0: FloatArray
    """Interior elbow angle q4 of each arm before the move [rad], pi where stretched, shape (n, 2)."""

    def __post_init__(self) -> None:
        """Freezes the arrays.

        Raises:
            ValueError: wrong shapes, numbers that are not finite, or impossible lengths.
        """
        for name in self.__dataclass_fields__:
            object.__setattr__(self, name, readonly(getattr(self, name)))
        n = self.angle_0.size
        shapes: dict[str, tuple[int, ...]] = {
            name: (n, 2) for name in ("radius", "offset", "height", "upper", "fore")
        }
        shapes |= {"elbow_0": (n, 2), "wrist": (n, 2, 3), "angle_0": (n,)}
        for name, shape in shapes.items():
            values = getattr(self, name)
            if values.shape != shape or not np.isfinite(values).all():
                raise ValueError(f"{name} must be finite and of shape {shape}, not {values.shape}")
        if n and (self.upper.min() <= 0 or self.fore.min() <= 0 or self.radius.min() < 0):
            raise ValueError("links must be longer than 0 and radii not negative")

    @classmethod
    def broadcast(
        cls,
        *,
        radius: ArrayLike,
        offset: ArrayLike,
        height: ArrayLike,
        upper: ArrayLike,
        fore: ArrayLike,
        wrist: ArrayLike,
        angle_0: ArrayLike,
        elbow_0: ArrayLike,
    ) -> PlatformProblem:
        """Builds n moves from arrays that may be one number or one pair for all of them."""
        wrist = np.atleast_3d(np.asarray(wrist, dtype=np.float64))
        n = len(wrist)

        def pairs(values: ArrayLike) -> FloatArray:
            return np.broadcast_to(np.asarray(values, dtype=np.float64), (n, 2))

        return cls(
            pairs(radius),
            pairs(offset),
            pairs(height),
            pairs(upper),
            pairs(fore),
            wrist,
            np.broadcast_to(np.asarray(angle_0, dtype=np.float64), (n,)),
            pairs(elbow_0),
        )

    @classmethod
    def planar(
        cls,
        *,
        radius: float,
        alpha: float,
        links: tuple[float, float],
        angle_0: float,
        start: ArrayLike,
        goal: ArrayLike,
    ) -> PlatformProblem:
        """Builds one move of the paper's planar robot (Eq. 1 and 2).

        Args:
            radius: R0 [m].
            alpha: azimuth of the second shoulder from the first [rad].
            links: a1 and a2 [m].
            angle_0: phi_0 [rad].
            start: points P_1,0 and P_2,0 [m], shape (2, 2).
            goal: points P_1,f and P_2,f [m], shape (2, 2).

        Raises:
            ValueError: an arm cannot reach its start point.
        """
        wrist = np.zeros((1, 2, 3))
        wrist[0, :, :2] = start

        def moves(elbow_0: ArrayLike) -> PlatformProblem:
            return cls.broadcast(
                radius=radius,
                offset=[0.0, alpha],
                height=0.0,
                upper=links[0],
                fore=links[1],
                wrist=wrist,
                angle_0=angle_0,
                elbow_0=elbow_0,
            )

        before = moves(np.pi)
        x = elbow_cosine(before, np.array([[angle_0]]))[0, 0]
        if (np.abs(x) > 1.0 + REACH_SLACK).any():
            raise ValueError(f"arm {int(np.argmax(np.abs(x))) + 1} cannot reach its start point")
        wrist[0, :, :2] = goal
        elbow_0 = np.arccos(np.clip(x, -1.0, 1.0))
        return moves(elbow_0[None])

    def rows(self, index: slice | IntArray | BoolArray) -> PlatformProblem:
        """Returns some of the moves."""
        return PlatformProblem(*(getattr(self, name)[index] for name in self.__dataclass_fields__))


@dataclass(frozen=True)
class PlatformSolution:
    """Candidate platform angles of n moves, at most k each."""

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
    balanced_first: bool = False
    """Whether candidates that are no roots are ordered by imbalance, not by the platform's way."""

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
        root = (self.kind == Kind.ROOT_SAME) | (self.kind == Kind.ROOT_OPPOSITE)
        way = np.abs(self.angle - self.problem.angle_0[:, None])
        tier = np.where(self.reachable & root, 0.0, np.where(self.reachable, 1.0, 2.0))
        within = way
        if self.balanced_first:
            within = np.where(self.reachable & ~root, self.imbalance, way)
        return np.lexsort((within, tier + ~self.valid), axis=1)

    @property
    def best(self) -> IntArray:
        """Column of the preferred candidate, or -1 where none is reachable, shape (n,)."""
        first = self.order[:, 0]
        return np.where(self.reachable[np.arange(len(first)), first], first, -1)

    def preferred(self, row: int) -> list[float]:
        """Returns the reachable angles of one move by preference [rad]."""
        columns = [k for k in self.order[row] if self.reachable[row, k]]
        return [float(self.angle[row, k]) for k in columns]

    def reason(self, row: int) -> str | None:
        """Returns why a move has no reachable angle, or why any will do; None if all is well."""
        if self.degenerate[row]:
            return "both shoulders or wrists lie on the platform axis: every angle is equal"
        if self.best[row] < 0:
            return "no candidate angle brings both wrists within reach"
        return None


def cosine_coefficients(problem: PlatformProblem) -> FloatArray:
    """Returns u, v, w of x_i(phi) = cos q4_i = u + v cos phi + w sin phi, shape (n, 2, 3).

    r_i² = rho² + R0² + (z - h)² - 2 R0 rho cos(phi + offset - theta) and x_i = (a1² + a2² - r_i²) / 2 a1 a2
    ([Bottin2021] Eq. 2 with heights and arms of their own).
    """
    x, y, z = np.moveaxis(problem.wrist, -1, 0)
    twice = 2.0 * problem.upper * problem.fore
    fixed = x * x + y * y + problem.radius**2 + (z - problem.height) ** 2
    u = (problem.upper**2 + problem.fore**2 - fixed) / twice
    reach = 2.0 * problem.radius / twice
    c, s = np.cos(problem.offset), np.sin(problem.offset)
    # rho cos(phi + offset - theta) = x cos(phi + offset) + y sin(phi + offset)
    return np.stack([u, reach * (x * c + y * s), reach * (y * c - x * s)], axis=-1)


def elbow_cosine(problem: PlatformProblem, angle: FloatArray) -> FloatArray:
    """Returns x_i = cos q4_i at platform angles [rad] (n, k), shape (n, k, 2); |x| > 1 out of reach."""
    u, v, w = np.moveaxis(cosine_coefficients(problem), -1, 0)
    c, s = np.cos(angle)[..., None], np.sin(angle)[..., None]
    return u[:, None] + v[:, None] * c + w[:, None] * s


def build_solution(
    problem: PlatformProblem,
    angle: FloatArray,
    kind: IntArray,
    valid: BoolArray,
    balanced_first: bool = False,
) -> PlatformSolution:
    """Returns the candidates with reach and elbow displacements.

    Args:
        problem: the moves.
        angle: candidate angles of any turn [rad], shape (n, k).
        kind: what each is, shape (n, k) or (k,).
        valid: which entries are candidates, shape (n, k).
        balanced_first: how candidates that are no roots are ordered.
    """
    start = problem.angle_0[:, None]
    # Whole turns only are taken off, so that an angle within half a turn keeps all its digits.
    turned = angle - 2.0 * np.pi * np.round((angle - start) / (2.0 * np.pi))
    angle = np.where(valid, turned, 0.0)
    coefficients = cosine_coefficients(problem)
    x = elbow_cosine(problem, angle)
    reachable = valid & (np.abs(x) <= 1.0 + REACH_SLACK).all(axis=-1)
    delta = np.arccos(np.clip(x, -1.0, 1.0)) - problem.elbow_0[:, None]
    swing = np.hypot(coefficients[..., 1], coefficients[..., 2])
    return PlatformSolution(
        problem,
        angle,
        np.broadcast_to(kind, angle.shape),
        valid,
        reachable,
        np.where(reachable[..., None], delta, 0.0),
        np.asarray((swing <= DEGENERATE).all(axis=-1)),
        balanced_first,
    )
