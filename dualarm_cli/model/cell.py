"""Cell: a robot at its place, with tools, named frames and the things it must not touch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import pinocchio as pin

from dualarm_cli.model.conveyor import Conveyor
from dualarm_cli.model.robot import Robot

ShapeKind = Literal["box", "sphere", "cylinder", "capsule", "mesh", "half_space"]


@dataclass(frozen=True)
class Shape:
    """A solid: its kind, its sizes and where it sits in the frame that holds it."""

    kind: ShapeKind
    """Which solid; a capsule's or cylinder's axis is z."""
    size: tuple[float, ...]
    """Box: full sides x, y, z; sphere: radius; cylinder and capsule: radius, length (a capsule's
    between the centres of its caps); mesh: scale; half_space: none (it fills z below 0) [m]."""
    pose: pin.SE3
    """Pose in the holding frame."""
    mesh: str = ""
    """Path of the mesh file, for a mesh."""


@dataclass(frozen=True)
class Tool:
    """What an arm carries on its flange."""

    tcp: pin.SE3
    """Tool centre point in the flange frame."""
    mass: float = 0.0
    """Mass [kg]."""
    shapes: tuple[Shape, ...] = ()
    """Solids in the flange frame."""


@dataclass(frozen=True)
class Obstacle:
    """A fixed solid of the cell."""

    name: str
    """Unique name."""
    shape: Shape
    """The solid, posed in the world."""


@dataclass(frozen=True)
class Cell:
    """The fixed world of a job."""

    robot: Robot
    """The robot, or both robots as one tree."""
    base: pin.SE3
    """Pose of the robot's root link in the world."""
    tools: Mapping[str, Tool] = field(default_factory=dict)
    """Tool of each arm, for every arm."""
    frames: Mapping[str, pin.SE3] = field(default_factory=dict)
    """Named frames, in the world."""
    obstacles: tuple[Obstacle, ...] = ()
    """What must not be touched."""
    clearance: float = 0.0
    """Least distance demanded between everything that may not touch [m]."""
    tool_speed: float | None = None
    """Cap on the speed of every tool centre point in the world [m/s], or None."""
    clearances: tuple[tuple[str, str, float], ...] = ()
    """Pairs of bodies (links, `left_tool`, parts, obstacles) with a least distance of their own [m]."""
    allowed_contacts: tuple[tuple[str, str], ...] = ()
    """Pairs of bodies that may touch, besides those of the robot."""
    parts: Mapping[str, tuple[Shape, ...]] = field(default_factory=dict)
    """Solids of each kind of part in the frame of the tool centre point that carries it."""
    conveyors: Mapping[str, Conveyor] = field(default_factory=dict)
    """Belts that carry targets, by name."""
