"""Stop: one target of a task, what is done there, and how a tool comes and leaves."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import pinocchio as pin

from dualarm_cli.geometry.arrays import FloatArray, readonly
from dualarm_cli.model.conveyor import OnBelt
from dualarm_cli.model.place import Place
from dualarm_cli.model.seam import SeamWork

Action = Literal[
    "pick",
    "place",
    "give",
    "take",
    "move",
    "path",
    "seam_start",
    "seam_end",
    "take_tool",
    "leave_tool",
]
StopKey = tuple[str, str, str]
"""Arm, task and action: what names a stop."""
TAKES: frozenset[str] = frozenset({"pick", "take", "take_tool"})
"""Actions after which an arm holds its task's part, or tool."""
GIVES: frozenset[str] = frozenset({"place", "give", "leave_tool"})
"""Actions after which it no longer does."""
AFTER_DWELL: frozenset[str] = frozenset({"place", "take", "leave_tool"})
"""Those of them that take effect at the end of the dwell, the others at the event itself.

In a hand-over the giving arm's event is the end of the taking arm's dwell, so that somebody holds the part at any time.
"""
LYING: frozenset[str] = frozenset({"pick", "place"})
"""Actions at which a part may lie on something, and on whose lines it may be near it."""
CHANGES = TAKES | GIVES
"""Actions that change what an arm holds."""
AT_STANDS: frozenset[str] = frozenset({"take_tool", "leave_tool"})
"""Actions of tool changes, which no file asks for."""


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


@dataclass(frozen=True)
class SeamTarget:
    """Where a seam has both tools: wherever it is worked."""

    work: SeamWork
    """The seam."""


Target = PoseTarget | JointTarget | SeamTarget


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
    buffer: str = ""
    """Name of the buffer that a part is put into or taken out of; empty for none."""
    belt: OnBelt | None = None
    """The conveyor that its pose moves with, None where it stands; approach, dwell and retract are in the belt's
    frame."""

    def met(self, time: float) -> Stop:
        """Returns the stop with its target where the conveyor has it at a time [s]; the same where nothing moves."""
        if self.belt is None:
            return self
        assert isinstance(self.target, PoseTarget)  # the reader refuses others on conveyors
        pose, belt = self.belt.moved(self.target.pose, time)
        return replace(self, target=replace(self.target, pose=pose), belt=belt)

    @property
    def stored(self) -> int:
        """By how much it changes the number of parts in its buffer: 1 for a place, -1 for a pick, 0 without."""
        return (self.action in GIVES) - (self.action in TAKES) if self.buffer else 0
