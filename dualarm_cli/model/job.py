"""Job: what is to be done in a cell, by which arm, in which order."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import pinocchio as pin

from dualarm_cli.geometry.arrays import FloatArray, readonly
from dualarm_cli.model.cell import Cell

Action = Literal["pick", "place", "move"]
StopKey = tuple[str, str, str]
"""Arm, task and action: what names a stop."""


@dataclass(frozen=True)
class Place:
    """Where something is written, for messages."""

    file: str
    """File as the user names it."""
    line: int
    """Line, from 1."""
    column: int
    """Column, from 1."""

    def __str__(self) -> str:
        """Returns `file:line:column`."""
        return f"{self.file}:{self.line}:{self.column}"


@dataclass(frozen=True)
class PoseTarget:
    """A pose of the tool centre point, with the freedoms that the part really has."""

    pose: pin.SE3
    """Tool centre point in the world."""
    free_yaw: bool = False
    """Whether any turn about the tool's z axis will do."""
    symmetry: int = 1
    """Turns by 2π/symmetry about the tool's z axis are equally good."""


@dataclass(frozen=True)
class JointTarget:
    """Joint configurations of one arm to choose from."""

    configurations: FloatArray
    """Alternatives [rad], shape (m, n) over the arm's joints."""

    def __post_init__(self) -> None:
        """Freezes the array."""
        object.__setattr__(self, "configurations", readonly(self.configurations))


Target = PoseTarget | JointTarget


@dataclass(frozen=True)
class Dwell:
    """How long a tool stands still at a target, and for what."""

    gripper: float = 0.0
    """Time of the gripper [s]."""
    settle: float = 0.0
    """Time for the arm to come to rest [s]."""
    handshake: float = 0.0
    """Time for signals to and from the cell's controller [s]."""

    @property
    def total(self) -> float:
        """Whole time [s]."""
        return self.gripper + self.settle + self.handshake


@dataclass(frozen=True)
class Stop:
    """One target of a task: approach, dwell, retract."""

    action: Action
    """What happens there."""
    target: Target
    """Where."""
    approach: float
    """Length of the straight approach along the tool's +z axis [m]; 0 for none."""
    retract: float
    """Length of the straight retract along the tool's -z axis [m]; 0 for none."""
    dwell: Dwell
    """Time at the target."""
    place: Place
    """Where it is written."""


@dataclass(frozen=True)
class Task:
    """One thing to be done by one arm: a pick and a place, or a bare move."""

    id: str
    """Unique name."""
    arm: str
    """left or right."""
    stops: tuple[Stop, ...]
    """Its targets in their order."""
    after: tuple[str, ...] = ()
    """Tasks that must be done before, where the planner chooses the order."""
    part: str = ""
    """Name of the part that is carried from pick to place; empty where it has no shape."""


@dataclass(frozen=True)
class Job:
    """A cell and what is to be done in it."""

    cell: Cell
    """The fixed world."""
    tasks: tuple[Task, ...]
    """In file order."""
    start: str
    """Name of the posture in which the motion starts, or `free`."""
    returns: bool
    """Whether the motion ends in its start posture, so that its duration is a period."""
    speed: float = 1.0
    """Fraction of full speed at which everything moves; dwells keep their length."""
    tool_speed: float | None = None
    """Cap on the speed of every tool centre point in the world [m/s], or None."""
    inputs: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of every file that was read, by its name within the project."""
    notes: tuple[str, ...] = ()
    """What the reader should know of how the files were understood."""

    def stops_of(self, arm: str) -> list[tuple[Task, Stop]]:
        """Returns the targets of one arm in file order, each with its task."""
        return [(task, stop) for task in self.tasks if task.arm == arm for stop in task.stops]

    def stops_by_key(self) -> dict[StopKey, Stop]:
        """Returns every target by its arm, task and action."""
        return {
            (task.arm, task.id, stop.action): stop for task in self.tasks for stop in task.stops
        }

    def stages(self) -> list[dict[str, tuple[Task, Stop]]]:
        """Returns the paired stages: the k-th target of each arm, by arm name.

        An arm that has run out of targets is missing from the later stages.
        """
        per_arm = {arm.name: self.stops_of(arm.name) for arm in self.cell.robot.arms}
        count = max((len(stops) for stops in per_arm.values()), default=0)
        return [
            {name: stops[k] for name, stops in per_arm.items() if k < len(stops)}
            for k in range(count)
        ]
