"""What a calibration is asked: the same points, touched by two robots."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray, readonly

LEAST_POINTS = 3
"""Fewest points that can determine a pose."""


@dataclass(frozen=True)
class CalibrationProblem:
    """n points in the base frames of both robots."""

    left: FloatArray
    """Points in the left robot's base frame [m], shape (n, 3)."""
    right: FloatArray
    """The same points in the right robot's base frame [m], shape (n, 3)."""
    names: tuple[str, ...]
    """What the points are called."""
    noise: float | None = None
    """Standard deviation of each measured coordinate of either robot [m]; None where it is not known."""
    origin: int = 1
    """Which of the first three points is the origin of the frame method; P2, as [Qin2024] computed."""

    def __post_init__(self) -> None:
        """Freezes the arrays.

        Raises:
            ValueError: shapes that do not fit, numbers that are not finite, an impossible noise or origin.
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
    """Raises where there are fewer points than can determine a pose.

    Raises:
        InfeasibleError: fewer than three.
    """
    if count < LEAST_POINTS:
        raise InfeasibleError(
            f"{count} point{'s do' if count != 1 else ' does'} not determine where one robot "
            "stands from another; touch at least "
            f"{LEAST_POINTS} that are not on a line, better 4 to 8 that are well spread"
        )
