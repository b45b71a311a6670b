"""Problem and solution of a calibration."""

from __future__ import annotations

import numpy as np

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray, readonly
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal


@dataclass(frozen=True)
class CalibrationSolution:
    """Pose of the right base in the left: p_left = R p_right + t."""

    rotation: FloatArray
    """R_left_right, shape (3, 3)."""
    translation: FloatArray
    """Origin t of the right base in the left base frame [m], shape (3,)."""
    covariance: FloatArray | None
    """Covariance of (t, rotation vector) in the left frame [m, rad], shape (6, 6).

    None if unknown.
    """
    degrees: int | None
    """Degrees of freedom of the noise estimate; None for stated noise."""

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for name in ("rotation", "translation", "covariance"):
            value = getattr(self, name)
            object.__setattr__(self, name, None if value is None else readonly(value))

    @property
    def matrix(self) -> FloatArray:
        """T_left_right, shape (4, 4)."""
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = self.rotation, self.translation
        return readonly(T)

    def residuals(self, left: FloatArray, right: FloatArray) -> FloatArray:
        """Compute the residuals [m] of points (n, 3) [m], shape (n, 3)."""
        residuals: FloatArray = left - (right @ self.rotation.T + self.translation)
        return residuals


LEAST_POINTS = 3
"""Minimum number of points that determine a pose."""


@dataclass(frozen=True)
class CalibrationProblem:
    """Points touched by both robots, in both base frames."""

    left: FloatArray
    """Points in the left robot's base frame [m], shape (n, 3)."""
    right: FloatArray
    """The same points in the right robot's base frame [m], shape (n, 3)."""
    names: tuple[str, ...]
    """Names of the points."""
    noise: float | None = None
    """Standard deviation of each measured coordinate [m], or None if unknown."""
    origin: int = 1
    """Index of the frame method's origin among the first three points.

    [Qin2024] computed with P2.
    """

    def __post_init__(self) -> None:
        """Freeze the arrays.

        Raises:
            ValueError: shapes do not match, a number is not finite, or the noise or origin is invalid.
            InfeasibleError: fewer than three points.
        """
        for name in ("left", "right"):
            object.__setattr__(self, name, readonly(getattr(self, name)))
            values: FloatArray = getattr(self, name)
            if values.shape != (len(self.names), 3):
                raise ValueError(f"{name} has shape {values.shape}; needs ({len(self.names)}, 3)")
            if not np.isfinite(values).all():
                raise ValueError(f"{name} must be finite")
        if self.noise is not None and not self.noise > 0.0:
            raise ValueError(f"noise must be above 0, not {self.noise}")
        if self.origin not in range(LEAST_POINTS):
            raise ValueError(f"origin must be 0, 1 or 2, not {self.origin}")
        refuse_few(len(self.names))


def refuse_few(count: int) -> None:
    """Raise unless there are enough points to determine a pose.

    Raises:
        InfeasibleError: fewer than three.
    """
    if count < LEAST_POINTS:
        data = {"points": range(count)}
        raise InfeasibleError(
            Refusal("few_points", measured=count, allowed=LEAST_POINTS, data=data)
        )
