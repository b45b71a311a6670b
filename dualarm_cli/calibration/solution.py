"""What a calibration answers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, readonly


@dataclass(frozen=True)
class CalibrationSolution:
    """Where the right robot's base stands in the left one's: p_left = R p_right + t."""

    rotation: FloatArray
    """R_left_right, shape (3, 3)."""
    translation: FloatArray
    """t: the right base's origin in the left base frame [m], shape (3,)."""
    covariance: FloatArray | None
    """Covariance of (t, rotation vector in the left base frame) [m, rad], shape (6, 6); None where not known."""
    degrees: int | None
    """Degrees of freedom of the residuals that the noise was estimated from; None where it was stated."""

    def __post_init__(self) -> None:
        """Freezes the arrays."""
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
        """Returns what is left of points (n, 3) [m] at each point [m], shape (n, 3)."""
        found: FloatArray = left - (right @ self.rotation.T + self.translation)
        return found
