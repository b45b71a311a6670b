"""Cell: a robot with tools, named frames, parts and obstacles."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import field, replace
from typing import Literal

import pinocchio as pin

from dualarm_cli.model.part_flow import Care, Conveyor, Grasp, Pattern, PoseRange, part_as_held
from dualarm_cli.model.place import NOWHERE, Place
from dualarm_cli.model.robot import Robot
from dualarm_cli.model.shape import Shape
from dualarm_cli.records import dataclass

TorqueRule = Literal["limited", "checked", "ignored"]
"""Rule for joint torques: a limit, measured and reported, or not computed."""


@dataclass(frozen=True)
class Tool:
    """Tool that is fixed to the flange of an arm."""

    tcp: pin.SE3
    """Tool centre point in the flange frame."""
    inertia: pin.Inertia = field(default_factory=pin.Inertia.Zero)
    """Mass, centre of mass and rotational inertia in the flange frame [kg, m, kg m²]."""
    shapes: tuple[Shape, ...] = ()
    """Solids in the flange frame."""
    opening: tuple[float, float] = (0.0, math.inf)
    """Least and greatest distance of its jaws [m]."""


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
    """Tool that is on at the start, and at the end of a cycle.

    Empty for none.
    """
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
    """Solids of each kind of part in its tool's frame; with grasps in its own."""
    tool_changes: Mapping[str, ToolChanges] = field(default_factory=dict)
    """Tool changes by arm; arms that change no tools are missing."""
    conveyors: Mapping[str, Conveyor] = field(default_factory=dict)
    """Conveyors by name."""
    part_inertias: Mapping[str, pin.Inertia] = field(default_factory=dict)
    """Mass, centre and rotational inertia of each kind of part, in the frame of its solids."""
    grasps: Mapping[str, Mapping[str, Grasp]] = field(default_factory=dict)
    """Grasps of parts by name; parts without any are missing."""
    widths: Mapping[str, float] = field(default_factory=dict)
    """Distance of the jaws on each part, however it is held [m]; missing if unknown."""
    care: Mapping[str, Care] = field(default_factory=dict)
    """Limits of the motion while a part is held, by part; parts without any are missing."""
    torque: TorqueRule = "limited"
    """Rule for joint torques."""
    patterns: Mapping[str, Pattern] = field(default_factory=dict)
    """Places of parts in frames, by frame."""
    varying: Mapping[str, tuple[PoseRange, ...]] = field(default_factory=dict)
    """Ranges of frames that vary, each with those of the frames that it is in."""

    def tool_names(self, arm: str) -> tuple[str, ...]:
        """List the names of the tools that an arm may have on.

        The empty name is none.
        """
        changes = self.tool_changes.get(arm)
        return ("", *changes.tools) if changes is not None else ("",)

    def start_tool(self, arm: str) -> str:
        """Return the tool that an arm has on at the start; empty for none."""
        changes = self.tool_changes.get(arm)
        return changes.start if changes is not None else ""

    def opening(self, arm: str, tool: str) -> tuple[float, float]:
        """Return the least and greatest distance of the jaws of an arm's tool [m].

        Args:
            arm: its name.
            tool: changed tool that is on; empty for none.
        """
        return (self.tool_changes[arm].tools[tool].tool if tool else self.tools[arm]).opening

    def opens_to(self, arm: str, tool: str, width: float) -> bool:
        """Check whether the jaws of an arm's tool open to a width [m].

        They open to an unknown one, 0.

        Args:
            arm: its name.
            tool: changed tool that is on; empty for none.
            width: distance of the jaws.
        """
        least, most = self.opening(arm, tool)
        return not width or least <= width <= most

    def width(self, part: str) -> float:
        """Return the distance of the jaws on a part [m]; 0 if unknown.

        Args:
            part: its name, or that of the part as it is held.
        """
        while part and part not in self.widths:
            part = part.rpartition("@")[0]
        return self.widths.get(part, 0.0)

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

    def load_inertia(self, arm: str, load: Held) -> pin.Inertia:
        """Return the inertia of a held part or, without a part, tool, in the flange frame."""
        if not load.part:
            return self.tool_changes[arm].tools[load.tool].tool.inertia
        tcp = self.tools[arm].tcp * self.T_own_tool(arm, load.tool)
        return tcp.act(self.part_inertias.get(load.part, pin.Inertia.Zero()))

    def with_accelerations(self, share: float) -> Cell:
        """Return the cell with a fraction of the robot's accelerations."""
        limits = self.robot.limits.scaled(1.0, share)
        return replace(self, robot=replace(self.robot, limits=limits))

    def with_held_part(self, part: str, how: str, grip: pin.SE3) -> Cell:
        """Add a part as held by a grasp, or by the taking tool of a hand-over.

        It has the same solids, clearances and allowed contacts as before.

        Args:
            part: its name.
            how: the grasp's name, or the hand-over's task.
            grip: the holding tool's centre point in the frame of the part, or in the giving tool's.
        """
        name, back = part_as_held(part, how), grip.inverse()
        weight = self.part_inertias.get(part, pin.Inertia.Zero())
        shapes = tuple(replace(shape, pose=back * shape.pose) for shape in self.parts[part])
        clearances = [pair for pair in self.clearances if part in pair[:2]]
        contacts = [pair for pair in self.allowed_contacts if part in pair]

        def renamed(body: str) -> str:
            return name if body == part else body

        return replace(
            self,
            clearances=(
                *self.clearances,
                *((renamed(a), renamed(b), least) for a, b, least in clearances),
            ),
            allowed_contacts=(
                *self.allowed_contacts,
                *((renamed(a), renamed(b)) for a, b in contacts),
            ),
            parts={**self.parts, name: shapes},
            part_inertias={**self.part_inertias, name: back.act(weight)},
        )
