"""Job: what is to be done in a cell, by which arm, in which order."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import pinocchio as pin

from dualarm_cli.geometry.arrays import FloatArray, readonly
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.conveyor import OnBelt
from dualarm_cli.model.place import NOWHERE, Place
from dualarm_cli.model.seam import SeamWork
from dualarm_cli.model.tool_path import ToolPath

Action = Literal["pick", "place", "move", "path", "seam_start", "seam_end"]
Mode = Literal["paired", "free"]
Order = Literal["given", "optimise"]
StopKey = tuple[str, str, str]
"""Arm, task and action: what names a stop."""
ANY = "any"
"""What stands for an arm where the planner chooses it."""
TAKES: frozenset[str] = frozenset({"pick"})
"""Actions after which an arm holds its task's part: from the event on."""
GIVES: frozenset[str] = frozenset({"place"})
"""Actions after which it no longer does: from the end of the dwell on."""
CHANGES = TAKES | GIVES
"""Actions that change what an arm holds."""
SAME_SHARE = 1e-9
"""Difference of two shares of a way that count as one."""


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


@dataclass(frozen=True)
class PathWork:
    """Paths that one tool or both follow together, and how."""

    paths: Mapping[str, ToolPath]
    """By arm. Both tools have gone the same share of their paths at every instant."""
    speed: float
    """Largest speed of the tool with the longer path along it [m/s]."""
    acceleration: float | None = None
    """Largest acceleration along that path [m/s²]; None leaves the ramps to the planner."""
    jerk: float | None = None
    """Largest jerk along that path [m/s³]; None leaves it to the planner."""
    redundancy: str | None = None
    """Name of the path follower; None for the default one."""
    posture: str | None = None
    """Name of the posture that the motion begins near; None leaves it to the planner."""
    slower: bool = False
    """Whether it may be followed slower where the joints' limits ask for it."""
    tolerance: float = 1e-4
    """How far the tools may leave their paths [m], and turn away by tolerance over TURN_LENGTH [rad]."""
    critical_points: Mapping[str, FloatArray] = field(default_factory=dict)
    """By arm, where a virtual spring pulls the elbow, in the frame of the last platform joint [m], shape (3,)."""
    stiffness: float = 10.0
    """Of the virtual springs: K of [Choi2020] Eq. 9."""
    torque: bool = False
    """Whether the joints' torques are kept within the limits of the URDF."""
    place: Place = NOWHERE
    """Where it is written."""

    @property
    def length(self) -> float:
        """Length of the longest path [m]."""
        return max(path.length for path in self.paths.values())

    def corners(self) -> tuple[float, ...]:
        """Returns the shares of the way at which the tools have to stop, without 0 and 1."""
        found: list[float] = []
        for share in sorted(c / path.length for path in self.paths.values() for c in path.corners):
            # What both tools' shares differ by rounding is one corner.
            if not found or share - found[-1] > SAME_SHARE:
                found.append(share)
        return tuple(found)


@dataclass(frozen=True)
class Task:
    """One thing to be done by one arm: a pick and a place, a bare move, or its share of a path."""

    id: str
    """Unique name."""
    arm: str
    """left or right; ANY where the planner chooses."""
    stops: tuple[Stop, ...]
    """Its targets in their order."""
    after: tuple[str, ...] = ()
    """Tasks that must be done before it begins, where the planner chooses the order."""
    part: str = ""
    """Name of the part that is carried from pick to place; empty where it has no shape."""
    path: PathWork | None = None
    """The path that is followed, the same for both arms where both follow; its one stop is where the tool ends."""
    seam: SeamWork | None = None
    """The seam that is worked, the same for both arms; its two stops are where it begins and where it ends."""
    not_before: float = 0.0
    """Its tool is at the first target no earlier than this after the start [s]."""
    not_after: float = math.inf
    """Its tool is at the last target no later than this after the start [s]."""
    place: Place = NOWHERE
    """Where it is written."""

    def held_before(self, action: str) -> str:
        """Returns the part that its arm holds when it comes to the stop of an action; empty for none."""
        return self.part if action in GIVES else ""

    def held_after(self, action: str) -> str:
        """Returns the part that its arm holds when it leaves the stop of an action; empty for none."""
        return self.part if action in TAKES else ""

    def allows(self, arm: str) -> bool:
        """Returns whether an arm may do it."""
        return self.arm in (arm, ANY)

    @property
    def alone(self) -> bool:
        """Whether nothing else is done meanwhile: a path or a seam."""
        return self.path is not None or self.seam is not None

    def goes_with(self, other: Task) -> bool:
        """Returns whether both belong to one section: the same path or seam, or none of either."""
        return self.path is other.path and self.seam is other.seam


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
    mode: Mode = "paired"
    """Whether both arms start every stage together, or each goes by its own clock."""
    order: Order = "given"
    """Who chooses the order of the tasks."""
    sequences: tuple[tuple[str, ...], ...] = ()
    """Tasks that one arm does one right after the other, by their ids."""
    pairing: tuple[tuple[StopKey, ...], ...] | None = None
    """What is done in each stage; None for the k-th target of each arm in stage k."""

    @property
    def is_decided(self) -> bool:
        """Returns whether it says which arm does what in which order."""
        return self.order == "given" and all(task.arm != ANY for task in self.tasks)

    @property
    def has_paths(self) -> bool:
        """Whether any task follows a path."""
        return any(task.path is not None for task in self.tasks)

    @property
    def has_seams(self) -> bool:
        """Whether any task works a seam."""
        return any(task.seam is not None for task in self.tasks)

    @property
    def has_conveyors(self) -> bool:
        """Whether any target moves with a conveyor."""
        return any(stop.belt is not None for task in self.tasks for stop in task.stops)

    @property
    def in_sections(self) -> bool:
        """Whether it is planned section after section: paths and seams are done alone."""
        return any(task.alone for task in self.tasks)

    def carried(self) -> list[tuple[str, str]]:
        """Returns arm and part for every part that an arm may ever hold, each once."""
        arms = [arm.name for arm in self.cell.robot.arms]
        return list(
            dict.fromkeys(
                (arm, task.part)
                for task in self.tasks
                if task.part
                for arm in arms
                if task.allows(arm)
            )
        )

    def stops_of(self, arm: str) -> list[tuple[Task, Stop]]:
        """Returns the targets of one arm in file order, each with its task."""
        return [(task, stop) for task in self.tasks if task.arm == arm for stop in task.stops]

    def stops_by_key(self) -> dict[StopKey, Stop]:
        """Returns every target by its arm, task and action; by every arm that may go there."""
        return {
            (arm.name, task.id, stop.action): stop
            for task in self.tasks
            for arm in self.cell.robot.arms
            if task.allows(arm.name)
            for stop in task.stops
        }

    def sections(self) -> list[tuple[Task, ...]]:
        """Returns the tasks in runs that follow one another: a path or seam by itself, all between them together."""
        found: list[tuple[Task, ...]] = []
        for task in self.tasks:
            if found and task.goes_with(found[-1][0]):
                found[-1] = (*found[-1], task)
            else:
                found.append((task,))
        return found

    def stages(self) -> list[dict[str, tuple[Task, Stop]]]:
        """Returns the paired stages: within each section the k-th target of each arm, by arm name.

        An arm that has run out of targets is missing from the later stages of the section. Where the job says itself
        what is paired with what, these are its stages.
        """
        if self.pairing is not None:
            stops: dict[StopKey, tuple[Task, Stop]] = {
                (t.arm, t.id, s.action): (t, s) for t in self.tasks for s in t.stops
            }
            return [{key[0]: stops[key] for key in stage} for stage in self.pairing]
        found = []
        for section in self.sections():
            per_arm = {
                arm.name: [(t, stop) for t in section if t.arm == arm.name for stop in t.stops]
                for arm in self.cell.robot.arms
            }
            count = max((len(stops) for stops in per_arm.values()), default=0)
            found += [
                {name: stops[k] for name, stops in per_arm.items() if k < len(stops)}
                for k in range(count)
            ]
        return found
