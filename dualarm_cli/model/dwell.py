"""Dwells, and times that vary."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dualarm_cli.records import dataclass

if TYPE_CHECKING:
    from dualarm_cli.geometry.arrays import FloatArray


@dataclass(frozen=True)
class Dwell:
    """Time at rest at a target, by purpose."""

    gripper: float = 0.0
    """Gripper time [s]."""
    settle: float = 0.0
    """Settling time of the arm [s]."""
    handshake: float = 0.0
    """Time for signals to and from the cell controller [s]."""

    @property
    def total(self) -> float:
        """Total time [s]."""
        return self.gripper + self.settle + self.handshake


@dataclass(frozen=True)
class TimeRange:
    """Time that varies between a least and a most."""

    least: float
    """Least time [s]."""
    nominal: float
    """Most frequent time, which is planned [s]."""
    most: float
    """Greatest time [s]."""

    def drawn(self, shares: FloatArray) -> FloatArray:
        """Compute the times that shares (k,) of all do not exceed, of a triangular distribution [s]."""
        import numpy as np  # stored answers need none

        width, rise = self.most - self.least, self.nominal - self.least
        rising = self.least + np.sqrt(shares * width * rise)
        falling = self.most - np.sqrt((1.0 - shares) * width * (self.most - self.nominal))
        return np.where(shares * width < rise, rising, falling)
