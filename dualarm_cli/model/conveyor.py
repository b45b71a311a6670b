"""Conveyors of a cell, and targets that they carry past the robot."""

from __future__ import annotations

from dataclasses import replace

import pinocchio as pin

from dualarm_cli.geometry.arrays import FloatArray, readonly
from dualarm_cli.geometry.products import norm
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class Conveyor:
    """A belt that moves at one velocity all the time."""

    name: str
    """What the cell calls it."""
    velocity: FloatArray
    """In the world [m/s], shape (3,); not zero."""

    def __post_init__(self) -> None:
        """Freezes the array."""
        object.__setattr__(self, "velocity", readonly(self.velocity))

    @property
    def speed(self) -> float:
        """Length of the velocity [m/s]."""
        return float(norm(self.velocity))


@dataclass(frozen=True)
class OnBelt:
    """How a target moves: with a conveyor, without turning, and on which stretch of its way it may be served."""

    conveyor: Conveyor
    """What carries it."""
    passes: float
    """When it passes the pose that the file gives [s] after the start; it may be served from then on."""
    within: float
    """How far it may have gone from there at most when it is served [m]."""
    at: float
    """When it is where the stop's own target has it [s]: at first `passes`, later when the planner means to meet it."""

    @property
    def last(self) -> float:
        """When it is `within` past the pose of the file [s]."""
        return self.passes + self.within / self.conveyor.speed

    def gone(self, time: float) -> float:
        """Returns how far it has gone at a time from the pose of the file [m]; negative before it passes there."""
        return self.conveyor.speed * (time - self.passes)

    def moved(self, pose: pin.SE3, time: float) -> tuple[pin.SE3, OnBelt]:
        """Returns where a pose that holds now is at a time [s], and the target with that time as its own."""
        shift = self.conveyor.velocity * (time - self.at)
        return pin.SE3(pose.rotation, pose.translation + shift), replace(self, at=time)
