"""Touch points: points that two robots have touched, as data."""

from __future__ import annotations

from typing import Literal

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, readonly
from dualarm_cli.model.robot import Robot
from dualarm_cli.records import dataclass

Fitted = Literal["tool", "base_height"]
"""Unknown quantities of a robot in addition to its base pose."""


@dataclass(frozen=True)
class TouchSide:
    """Measurements of one robot at n points."""

    robot: Robot | None
    """Robot; None if its points are only given as coordinates."""
    tcp: FloatArray
    """Tool tip in the flange frame [m], shape (3,)."""
    joints: FloatArray
    """Joint readings [rad], NaN for points without, shape (n, k)."""
    xyz: FloatArray
    """Coordinates in the base frame [m], NaN for points without, shape (n, 3)."""

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for name in ("tcp", "joints", "xyz"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    @property
    def read(self) -> BoolArray:
        """Mask of points with joint readings, shape (n,)."""
        mask: BoolArray = (self.joints == self.joints).all(axis=1) & (self.joints.shape[1] > 0)
        return mask

    @property
    def measured(self) -> BoolArray:
        """Mask of points with coordinates, shape (n,)."""
        mask: BoolArray = (self.xyz == self.xyz).all(axis=1)
        return mask


@dataclass(frozen=True)
class Touches:
    """Points that both robots touched."""

    names: tuple[str, ...]
    """Names of the n points."""
    left: TouchSide
    """Measurements of the left robot."""
    right: TouchSide
    """Measurements of the right robot."""
    noise: float | None
    """Standard deviation of each measured coordinate [m], or None."""
    origin: int
    """Index of the frame method's origin among the first three points."""
    fit: tuple[Fitted, ...]
    """Unknowns to estimate along with the transform."""

    @property
    def sides(self) -> dict[str, TouchSide]:
        """Measurements of both robots, left before right."""
        return {"left": self.left, "right": self.right}
