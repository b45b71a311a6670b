"""Points that two robots have touched, as values."""

from __future__ import annotations

from typing import Literal

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, readonly
from dualarm_cli.model.robot import Robot
from dualarm_cli.records import dataclass

Fitted = Literal["tool", "base_height"]
"""What may be unknown of a robot besides where it stands."""


@dataclass(frozen=True)
class TouchSide:
    """What one robot has to say of n points."""

    robot: Robot | None
    """The robot; None where its points are given as coordinates only."""
    tcp: FloatArray
    """Tip of its tool in the flange frame [m], shape (3,)."""
    joints: FloatArray
    """Joint readings in the arm's order [rad], NaN where a point has none, shape (n, k)."""
    xyz: FloatArray
    """Coordinates in its base frame [m], NaN where a point has none, shape (n, 3)."""

    def __post_init__(self) -> None:
        """Freezes the arrays."""
        for name in ("tcp", "joints", "xyz"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    @property
    def read(self) -> BoolArray:
        """Which points have joint readings, shape (n,)."""
        found: BoolArray = (self.joints == self.joints).all(axis=1) & (self.joints.shape[1] > 0)
        return found

    @property
    def measured(self) -> BoolArray:
        """Which points have coordinates, shape (n,)."""
        found: BoolArray = (self.xyz == self.xyz).all(axis=1)
        return found


@dataclass(frozen=True)
class Touches:
    """n points, each touched by both robots."""

    names: tuple[str, ...]
    """What the points are called."""
    left: TouchSide
    """The left robot's."""
    right: TouchSide
    """The right robot's."""
    noise: float | None
    """Standard deviation of each coordinate of a touched point [m]; None where it is not known."""
    origin: int
    """Which of the first three points is the origin of the frame method."""
    fit: tuple[Fitted, ...]
    """What is found along with the transform."""

    @property
    def sides(self) -> dict[str, TouchSide]:
        """Both robots', left before right."""
        return {"left": self.left, "right": self.right}
