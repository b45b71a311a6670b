"""Cell: a robot with tools, named frames, parts and obstacles.

Conveyors of a cell, and targets that they carry past the robot.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, replace

import pinocchio as pin

from dualarm_cli.geometry.arrays import FloatArray, readonly
from dualarm_cli.geometry.products import norm
from dualarm_cli.model.place import NOWHERE, Place
from dualarm_cli.model.robot import Robot
from dualarm_cli.model.shape import Shape
from dualarm_cli.records import dataclass


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
class ChangedTool:
    """A tool that an arm takes from a stand and leaves there."""

    tool: Tool
    """What it is; its tool centre point and solids are in the flange frame, as those of what is always on the arm."""
    stand: pin.SE3
    """Where the arm's own tool frame is in the world while it takes it or leaves it."""


@dataclass(frozen=True)
class ToolChanges:
    """The tools that one arm changes by itself."""

    tools: Mapping[str, ChangedTool]
    """By their names."""
    start: str = ""
    """The one that is on when the motion starts, and at the end of a cycle; empty for none."""
    time: float = 0.0
    """How long the arm stands still at a stand to take a tool or to leave it [s]."""
    approach: float = 0.0
    """Length of the straight approach to a stand along the own tool's +z axis [m]."""
    retract: float = 0.0
    """Length of the straight retract from it along the own tool's -z axis [m]."""
    place: Place = NOWHERE
    """Where it is written."""


@dataclass(frozen=True)
class Held:
    """What an arm holds besides the tool that is always on it."""

    tool: str = ""
    """The changed tool that is on; empty for none."""
    part: str = ""
    """The part in it; empty for none."""
    docking: bool = False
    """Whether the tool is being taken or left: on the lines at its stand it may touch what stands still."""

    @property
    def name(self) -> str:
        """What it is called; empty for nothing."""
        whole = " with ".join(name for name in (self.tool, self.part) if name)
        return f"{whole} at its stand" if self.docking else whole


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
    tool_changes: Mapping[str, ToolChanges] = field(default_factory=dict)
    """By arm, the tools that it changes by itself; arms that change none are missing."""
    conveyors: Mapping[str, Conveyor] = field(default_factory=dict)
    """Belts that carry targets, by name."""

    def tool_names(self, arm: str) -> tuple[str, ...]:
        """Returns the tools that an arm may have on, the empty name of none among them."""
        changes = self.tool_changes.get(arm)
        return ("", *changes.tools) if changes is not None else ("",)

    def start_tool(self, arm: str) -> str:
        """Returns the changed tool that an arm has on when the motion starts; empty for none."""
        changes = self.tool_changes.get(arm)
        return changes.start if changes is not None else ""

    def all_held(self, arm: str) -> dict[str, Held]:
        """Returns everything that an arm may ever hold, by its name."""
        found = [Held(tool, part) for tool in self.tool_names(arm) for part in ("", *self.parts)]
        found += [Held(tool, docking=True) for tool in self.tool_names(arm) if tool]
        return {one.name: one for one in found}

    def T_own_tool(self, arm: str, tool: str) -> pin.SE3:
        """Returns a changed tool's centre point in the frame of the arm's own; the identity for no tool."""
        if not tool:
            return pin.SE3.Identity()
        return self.tools[arm].tcp.actInv(self.tool_changes[arm].tools[tool].tool.tcp)

    def held_shapes(self, arm: str, held: Held) -> tuple[tuple[Shape, ...], tuple[Shape, ...]]:
        """Returns the solids of a held tool and of a held part, in the frame of the arm's own tool centre point."""
        T_flange_own, of_tool = self.tools[arm].tcp, tuple[Shape, ...]()
        if held.tool:
            of_tool = tuple(
                replace(shape, pose=T_flange_own.actInv(shape.pose))
                for shape in self.tool_changes[arm].tools[held.tool].tool.shapes
            )
        T_own_tool = self.T_own_tool(arm, held.tool)
        part = self.parts[held.part] if held.part else ()
        return of_tool, tuple(replace(shape, pose=T_own_tool * shape.pose) for shape in part)


@dataclass(frozen=True)
class Buffer:
    """Places for parts that are all alike: whoever takes one takes any.

    A place takes its room from its event on, the tool at the target; its part can be taken once its dwell is over. A
    pick takes its part at its event, and frees the room once its dwell is over.
    """

    capacity: int
    """Maximum number of parts in it."""
    initial: int = 0
    """Number of parts in it at the start."""
    place: Place = NOWHERE
    """Where it is written."""


@dataclass(frozen=True)
class Conveyor:
    """A belt that moves at one velocity all the time."""

    name: str
    """Name in the cell file."""
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
    """Motion of a target with a conveyor, and where it may be served.

    The target does not turn.
    """

    conveyor: Conveyor
    """Conveyor that carries the target."""
    passes: float
    """Time after the start at which the target passes the file's pose [s]. It may be served from then on."""
    within: float
    """Largest distance past the file's pose at which the target may be served [m]."""
    at: float
    """Time at which the target is at the stop's own pose [s]. It is `passes` at first, later the time at which the
    planner means to meet the target."""

    @property
    def last(self) -> float:
        """Time at which the target is `within` past the file's pose [s]."""
        return self.passes + self.within / self.conveyor.speed

    def gone(self, time: float) -> float:
        """Compute the distance past the file's pose at a time [m], negative before it."""
        return self.conveyor.speed * (time - self.passes)

    def moved(self, pose: pin.SE3, time: float) -> tuple[pin.SE3, OnBelt]:
        """Move a pose with the belt to a time [s].

        The pose holds at the time `at`. It comes back with the target whose `at` is the new time.
        """
        shift = self.conveyor.velocity * (time - self.at)
        return pin.SE3(pose.rotation, pose.translation + shift), replace(self, at=time)
