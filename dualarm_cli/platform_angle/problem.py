"""Problem of a platform solver for a batch of moves, and its elbow angles."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray, readonly
from dualarm_cli.geometry.elementary import arccos, cos, sin
from dualarm_cli.records import dataclass

REACH_SLACK = 1e-9
"""Excess of |x| = |cos q4| over 1 that counts as rounding."""


class Kind(IntEnum):
    """Kind of a candidate angle."""

    START = 0
    """Start angle: the platform does not move."""
    ROOT_SAME = 1
    """Equal elbow displacements in the same direction (upper sign of Eq. 5)."""
    ROOT_OPPOSITE = 2
    """Equal elbow displacements in opposite directions (lower sign of Eq. 5)."""
    STATIONARY_SAME = 3
    """Stationary difference of the displacements (Eq. 15, upper sign)."""
    STATIONARY_OPPOSITE = 4
    """Stationary sum of the displacements (Eq. 15, lower sign)."""
    BOUNDARY = 5
    """Boundary of reach: an arm is just stretched or folded."""


@dataclass(frozen=True)
class PlatformProblem:
    """Batch of n moves of two arms on a turning platform.

    In the platform's axis frame, whose z axis is the axis of rotation.
    """

    radius: FloatArray
    """Distance R0 of each shoulder from the axis [m], shape (n, 2)."""
    offset: FloatArray
    """Azimuth of each shoulder at platform angle 0 [rad], shape (n, 2)."""
    height: FloatArray
    """Height of each shoulder along the axis [m], shape (n, 2)."""
    upper: FloatArray
    """Upper arm lengths a1 [m], shape (n, 2)."""
    fore: FloatArray
    """Forearm lengths a2 [m], shape (n, 2)."""
    wrist: FloatArray
    """Wrist centres at the end of the move [m], shape (n, 2, 3)."""
    angle_0: FloatArray
    """Platform angle before the move [rad], shape (n,)."""
    elbow_0: FloatArray
    """Interior elbow angles q4 before the move [rad], pi if stretched, shape (n, 2)."""

    def __post_init__(self) -> None:
        """Freeze and check the arrays.

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
            _check(name, getattr(self, name), shape)

    @classmethod
    def broadcast(
        cls,
        *,
        shoulder: tuple[ArrayLike, ArrayLike, ArrayLike],
        links: tuple[ArrayLike, ArrayLike],
        wrist: ArrayLike,
        angle_0: ArrayLike,
        elbow_0: ArrayLike,
    ) -> PlatformProblem:
        """Build a batch of n moves by broadcasting its fields.

        Args:
            shoulder: radius R0 [m], azimuth at platform angle 0 [rad] and height along the axis [m], each a number,
                (2,) or (n, 2).
            links: upper arm a1 and forearm a2 [m], each a number, (2,) or (n, 2).
            wrist: wrist centres after the move [m], (n, 2, 3), or (2, 3) for one move.
            angle_0: phi_0 [rad], a number or (n,).
            elbow_0: interior elbow angles before [rad], a number, (2,) or (n, 2).

        Raises:
            ValueError: shapes that do not fit, or values that `PlatformProblem` refuses.
        """
        wrist = np.asarray(wrist, dtype=np.float64)
        wrist = wrist[None] if wrist.ndim == 2 else wrist
        n = len(wrist) if wrist.ndim else 0

        def pairs(values: ArrayLike) -> FloatArray:
            return np.broadcast_to(np.asarray(values, dtype=np.float64), (n, 2))

        return cls(
            pairs(shoulder[0]),
            pairs(shoulder[1]),
            pairs(shoulder[2]),
            pairs(links[0]),
            pairs(links[1]),
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
        """Build a move of the paper's planar robot (Eq. 1 and 2).

        Args:
            radius: R0 [m].
            alpha: azimuth of the second shoulder from the first [rad].
            links: a1 and a2 [m].
            angle_0: phi_0 [rad].
            start: points P_1,0 and P_2,0 [m], shape (2, 2).
            goal: points P_1,f and P_2,f [m], shape (2, 2).

        Raises:
            ValueError: an arm cannot reach its start point, or values that no robot has.
        """
        wrist = np.zeros((1, 2, 3))
        wrist[0, :, :2] = start

        def moves(elbow_0: ArrayLike) -> PlatformProblem:
            return cls.broadcast(
                shoulder=(radius, [0.0, alpha], 0.0),
                links=links,
                wrist=wrist,
                angle_0=angle_0,
                elbow_0=elbow_0,
            )

        before = moves(np.pi)
        x = elbow_cosine(before, np.array([[angle_0]]))[0, 0]
        if (np.abs(x) > 1.0 + REACH_SLACK).any():
            arm = int(np.argmax(np.abs(x)))
            distance = np.sqrt(
                np.square(links[0]) + np.square(links[1]) - 2.0 * links[0] * links[1] * x[arm]
            )
            raise ValueError(
                f"arm {arm + 1} cannot reach its start point: {distance:.6g} m from its shoulder, "
                f"reach {abs(links[0] - links[1]):.6g} to {links[0] + links[1]:.6g} m"
            )
        wrist[0, :, :2] = goal
        elbow_0 = arccos(np.clip(x, -1.0, 1.0))
        return moves(elbow_0[None])

    def rows(self, index: slice | IntArray | BoolArray) -> PlatformProblem:
        """Select moves."""
        return PlatformProblem(*(getattr(self, name)[index] for name in self.__dataclass_fields__))


def cosine_coefficients(problem: PlatformProblem) -> FloatArray:
    """Compute the coefficients of elbow cosines over the platform angle, shape (n, 2, 3).

    They are u, v, w of x_i(phi) = cos q4_i = u + v cos phi + w sin phi, with r_i² = rho² + R0² + (z - h)²
    - 2 R0 rho cos(phi + offset - theta) and x_i = (a1² + a2² - r_i²) / 2 a1 a2 ([Bottin2021] Eq. 2 with heights, and
    links of each arm).
    """
    x, y, z = np.moveaxis(problem.wrist, -1, 0)
    twice = 2.0 * problem.upper * problem.fore
    fixed = x * x + y * y + np.square(problem.radius) + np.square(z - problem.height)
    u = (np.square(problem.upper) + np.square(problem.fore) - fixed) / twice
    reach = 2.0 * problem.radius / twice
    c, s = cos(problem.offset), sin(problem.offset)
    # rho cos(phi + offset - theta) = x cos(phi + offset) + y sin(phi + offset)
    return np.stack([u, reach * (x * c + y * s), reach * (y * c - x * s)], axis=-1)


def elbow_cosine(problem: PlatformProblem, angle: FloatArray) -> FloatArray:
    """Compute elbow cosines x_i at platform angles (n, k) [rad], shape (n, k, 2).

    Out of reach |x| > 1.
    """
    u, v, w = np.moveaxis(cosine_coefficients(problem), -1, 0)
    c, s = cos(angle)[..., None], sin(angle)[..., None]
    return u[:, None] + v[:, None] * c + w[:, None] * s


def elbow_angles(problem: PlatformProblem, angle: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Compute interior elbow angles q4 at platform angles, and the mask in reach.

    Args:
        problem: n moves.
        angle: platform angles [rad], shape (n, k).

    Returns:
        Angles [rad], pi if stretched, 0 out of reach, and the mask, both of shape (n, k, 2).
    """
    x = elbow_cosine(problem, angle)
    reached: BoolArray = np.abs(x) <= 1.0 + REACH_SLACK
    return np.where(reached, arccos(np.clip(x, -1.0, 1.0)), 0.0), reached


def _check(name: str, values: FloatArray, shape: tuple[int, ...]) -> None:
    """Check the shape and values of a problem's field; raises a ValueError."""
    if values.shape != shape:
        raise ValueError(f"{name} has shape {values.shape}; needs {shape}, one row per move")
    rules = [(~np.isfinite(values), f"{name} must be finite")]
    if name in ("upper", "fore"):
        rules.append((values <= 0.0, "links must be longer than 0 m"))
    if name == "radius":
        rules.append((values < 0.0, "radii not negative"))
    for broken, rule in rules:
        if broken.any():
            place = tuple(int(k) for k in np.argwhere(broken)[0])
            indices = ", ".join(str(k) for k in place)
            raise ValueError(f"{name}[{indices}] = {values[place]}: {rule}")
