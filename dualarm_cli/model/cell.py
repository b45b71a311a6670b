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
    """Tool that is fixed to the flange of an arm."""

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
    """Tool; its frames and solids are in the flange frame."""
    stand: pin.SE3
    """Pose of the arm's fixed tool frame in the world at the stand."""


@dataclass(frozen=True)
class ToolChanges:
    """Tools that one arm changes by itself."""

    tools: Mapping[str, ChangedTool]
    """Tools by name."""
    start: str = ""
    """Tool that is on at the start, and at the end of a cycle; empty for none."""
    time: float = 0.0
    """Time at rest at a stand while a tool is taken or left [s]."""
    approach: float = 0.0
    """Length of the straight approach to a stand, along the fixed tool [m]."""
    retract: float = 0.0
    """Length of the straight retract from a stand, along the fixed tool [m]."""
    place: Place = NOWHERE
    """Place of the tool changes in the cell file."""


@dataclass(frozen=True)
class Held:
    """Changed tool and part that an arm holds."""

    tool: str = ""
    """Changed tool that is on; empty for none."""
    part: str = ""
    """Part in the tool; empty for none."""
    docking: bool = False
    """Whether the tool is being taken or left.

    On the lines at its stand it may then touch bodies that stand still.
    """

    @property
    def name(self) -> str:
        """Name of tool and part; empty for nothing."""
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
    """Fixed world of a job."""

    robot: Robot
    """Robot, or both robots as one tree."""
    base: pin.SE3
    """Pose of the robot's root link in the world."""
    tools: Mapping[str, Tool] = field(default_factory=dict)
    """Tool of each arm, for every arm."""
    frames: Mapping[str, pin.SE3] = field(default_factory=dict)
    """Named frames, in the world."""
    obstacles: tuple[Obstacle, ...] = ()
    """Fixed solids that must not be touched."""
    clearance: float = 0.0
    """Required distance of all bodies that may not touch [m]."""
    tool_speed: float | None = None
    """Speed limit of all tool centre points in the world [m/s], or None."""
    clearances: tuple[tuple[str, str, float], ...] = ()
    """Required distance of single pairs of bodies (links, `left_tool`, parts, obstacles) [m]."""
    allowed_contacts: tuple[tuple[str, str], ...] = ()
    """Pairs of bodies that may touch, in addition to those of the robot."""
    parts: Mapping[str, tuple[Shape, ...]] = field(default_factory=dict)
    """Solids of each kind of part, in the frame of its tool."""
    tool_changes: Mapping[str, ToolChanges] = field(default_factory=dict)
    """Tool changes by arm; arms that change no tools are missing."""
    conveyors: Mapping[str, Conveyor] = field(default_factory=dict)
    """Conveyors by name."""

    def tool_names(self, arm: str) -> tuple[str, ...]:
        """List the names of the tools that an arm may have on; the empty name is none."""
        changes = self.tool_changes.get(arm)
        return ("", *changes.tools) if changes is not None else ("",)

    def start_tool(self, arm: str) -> str:
        """Return the tool that an arm has on at the start; empty for none."""
        changes = self.tool_changes.get(arm)
        return changes.start if changes is not None else ""

    def all_held(self, arm: str) -> dict[str, Held]:
        """List every combination of tool and part that an arm may hold, by name."""
        held = [Held(tool, part) for tool in self.tool_names(arm) for part in ("", *self.parts)]
        held += [Held(tool, docking=True) for tool in self.tool_names(arm) if tool]
        return {item.name: item for item in held}

    def T_own_tool(self, arm: str, tool: str) -> pin.SE3:
        """Return a changed tool's centre point in the fixed tool's frame.

        The identity for no tool.
        """
        if not tool:
            return pin.SE3.Identity()
        return self.tools[arm].tcp.actInv(self.tool_changes[arm].tools[tool].tool.tcp)

    def held_shapes(self, arm: str, held: Held) -> tuple[tuple[Shape, ...], tuple[Shape, ...]]:
        """Return the solids of a held tool and part, in the fixed tool's frame."""
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
    """Time at which the target passes the file's pose [s]; it may be reached from then on."""
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
