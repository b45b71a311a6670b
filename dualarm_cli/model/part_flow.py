"""Flow of parts: patterns of places, poses that vary, conveyors, buffers, hand-overs, care."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
import pinocchio as pin

from dualarm_cli.geometry.arrays import FloatArray, readonly
from dualarm_cli.geometry.products import norm
from dualarm_cli.model.lines import Line
from dualarm_cli.model.place import NOWHERE, Place
from dualarm_cli.records import dataclass

ON_AXIS = 1e-6
"""Largest distance between the z axes of tool and part for common turns [m, rad]."""
PlaceIndex = tuple[int, int, int]
"""Numbers of a place along x, along y and upwards, from 1."""
PlaceOrder = Literal["rows", "columns", "snake"]


@dataclass(frozen=True)
class Pattern:
    """Places of parts in a frame."""

    places: Mapping[PlaceIndex, pin.SE3]
    """Pose of each place in the frame."""
    order: PlaceOrder = "rows"
    """Order of the places within a layer."""
    pitch: tuple[float, float] = (0.0, 0.0)
    """Distances of neighbouring places along x and y [m]."""
    in_layers: bool = False
    """Whether places lie above each other."""

    def ordered(self, order: PlaceOrder | None = None) -> list[PlaceIndex]:
        """List the places from the lowest layer up, in the pattern's or a given order."""
        order = order or self.order

        def key(index: PlaceIndex) -> tuple[int, int, int]:
            x, y, layer = index
            if order == "columns":
                return layer, x, y
            return layer, y, -x if order == "snake" and y % 2 == 0 else x

        return sorted(self.places, key=key)

    def below(self, index: PlaceIndex) -> list[PlaceIndex]:
        """List the places of the next layer down that carry a part at a place.

        These are the places less than a pitch away along both axes.
        """
        x, y, _ = self.places[index].translation
        return [
            lower
            for lower, pose in self.places.items()
            if lower[2] == index[2] - 1
            and abs(pose.translation[0] - x) < (1.0 - 1e-9) * self.pitch[0]
            and abs(pose.translation[1] - y) < (1.0 - 1e-9) * self.pitch[1]
        ]


@dataclass(frozen=True)
class PoseRange:
    """Pose that varies evenly about its place, such as of a part in a tray."""

    of: str
    """Name of what varies; ranges with the same name vary together."""
    centre: pin.SE3
    """Pose in the world along and about whose axes the pose varies."""
    xy: float
    """Largest deviation along x, and along y [m]."""
    z: float
    """Largest deviation along z [m]."""
    yaw: float
    """Largest turn about z [rad]."""

    def moved(self, pose: pin.SE3, shares: Sequence[float]) -> pin.SE3:
        """Move a pose by shares of the range.

        Args:
            pose: in the world.
            shares: of x, y, z and yaw, each from -1 to 1.
        """
        x, y, z, yaw = shares
        turn = pin.rpy.rpyToMatrix(0.0, 0.0, yaw * self.yaw)
        shift = pin.SE3(turn, np.array([x * self.xy, y * self.xy, z * self.z]))
        return self.centre * shift * self.centre.inverse() * pose


@dataclass(frozen=True)
class Conveyor:
    """Belt with constant velocity."""

    name: str
    """Name in the cell file."""
    velocity: FloatArray
    """Velocity in the world [m/s], shape (3,); not zero."""

    def __post_init__(self) -> None:
        """Freeze the array."""
        object.__setattr__(self, "velocity", readonly(self.velocity))

    @property
    def speed(self) -> float:
        """Length of the velocity [m/s]."""
        return float(norm(self.velocity))


@dataclass(frozen=True)
class OnBelt:
    """Motion of a target with a conveyor, and its reachable range.

    The target does not turn.
    """

    conveyor: Conveyor
    """Conveyor that carries the target."""
    passes: float
    """Time at which the target passes the file's pose [s].

    It may be reached from then on.
    """
    within: float
    """Largest distance past the file's pose at which the target may be reached [m]."""
    at: float
    """Time at which the target is at the stop's own pose [s].

    At first this is `passes`, later the planned time of the event.
    """

    @property
    def last(self) -> float:
        """Time at which the target is `within` past the file's pose [s]."""
        return self.passes + self.within / self.conveyor.speed

    def gone(self, time: float) -> float:
        """Compute the distance past the file's pose at a time [m], negative before it."""
        return self.conveyor.speed * (time - self.passes)

    def moved(self, pose: pin.SE3, time: float) -> tuple[pin.SE3, OnBelt]:
        """Move a pose at time `at` with the belt to another time [s].

        The target comes back with the new time as `at`.
        """
        shift = self.conveyor.velocity * (time - self.at)
        return pin.SE3(pose.rotation, pose.translation + shift), replace(self, at=time)


@dataclass(frozen=True)
class Buffer:
    """Storage for a limited number of equal parts.

    A place takes its room from its event on, the tool at the target; its part can be taken once its dwell is over. A
    pick takes its part at its event, and frees the room once its dwell is over.
    """

    capacity: int
    """Maximum number of parts."""
    initial: int = 0
    """Number of parts at the start."""
    place: Place = NOWHERE
    """Place of the buffer in its file."""


@dataclass(frozen=True)
class Handover:
    """Arms and grip of a hand-over."""

    giver: str
    """Arm that picks and gives."""
    taker: str
    """Arm that takes and places."""
    grip: pin.SE3
    """Taking tool centre point in the frame of the giving one."""
    place: Place = NOWHERE
    """Place of the hand-over in its file."""
    upright: tuple[float, float, float] | None = None
    """Vertical at the pick in the taking tool's frame; None without a picked pose."""


@dataclass(frozen=True)
class Grasp:
    """Position of a tool on a part while it holds it."""

    name: str
    """Name in the cell file, with tilt, area or turn."""
    pose: pin.SE3
    """Fixed tool centre point in the part's frame."""
    free_yaw: bool = False
    """Whether the part is round about the tool's z axis."""
    symmetry: int = 1
    """Order of the part's rotational symmetry about the tool's z axis."""
    approach: Line | None = None
    """Straight approach to a target; None for the task's."""
    retract: Line | None = None
    """Straight retract from a target; None for the task's."""
    width: float = 0.0
    """Distance of the tool's jaws on the part [m]; 0 if unknown."""
    of: str = ""
    """Name in the cell file, without tilt, area or turn."""
    pair: str = ""
    """Names of the giving and the taking tool's grasps in a hand-over, else empty."""

    @property
    def choice(self) -> str:
        """Name that decides it: its own, or that of the pair."""
        return self.pair or self.name

    @property
    def is_on_axis(self) -> bool:
        """Whether the tool's z axis is that of the part, up to its direction."""
        offsets = (*self.pose.rotation[:2, 2], *self.pose.translation[:2])
        return all(abs(offset) <= ON_AXIS for offset in offsets)


@dataclass(frozen=True)
class Care:
    """Limits of an arm's motion during a task, or while it holds a part."""

    speed: float = 1.0
    """Fraction of the speed of joints; their times become 1/speed times as long."""
    acceleration: float = 1.0
    """Fraction of the accelerations of joints at that speed."""
    tool_speed: float = math.inf
    """Largest speed of the tool centre point in the world [m/s]."""
    tilt: float = math.inf
    """Largest angle between the vertical and the part's axis that was vertical [rad]."""

    def stricter(self, care: Care) -> Care:
        """Take the lower one of each limit."""
        return Care(
            min(self.speed, care.speed),
            min(self.acceleration, care.acceleration),
            min(self.tool_speed, care.tool_speed),
            min(self.tilt, care.tilt),
        )

    @property
    def slows(self) -> bool:
        """Whether motions take longer."""
        return self.speed < 1.0 or self.acceleration < 1.0 or self.tool_speed < math.inf


NO_CARE = Care()
"""No limits beyond those of the job."""
TILT_SPARE = 0.0087
"""Margin below limits of tilt at targets and along paths, for motions near them [rad]."""


def part_as_held(part: str, how: str) -> str:
    """Name a part as held by a grasp or by a taking tool; empty for none."""
    return f"{part}@{how}" if part else ""


def kind_of_part(body: str) -> str:
    """Name the kind of a part, however it is held."""
    return body.partition("@")[0]
