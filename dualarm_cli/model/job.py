"""Job: what is to be done in a cell, by which arm, in which order."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import field, replace
from functools import cached_property
from typing import Literal, TypeVar

import pinocchio as pin

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray, readonly
from dualarm_cli.model.budget import Budget
from dualarm_cli.model.cell import Buffer, Cell, Held, OnBelt
from dualarm_cli.model.handover import Handover
from dualarm_cli.model.path_work import PathWork
from dualarm_cli.model.place import NOWHERE, Place
from dualarm_cli.model.robot import JointLimits, Robot
from dualarm_cli.model.seam import SeamWork
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal

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
WITHIN_TOLERANCE: frozenset[str] = frozenset({"path"})
"""Actions whose tool is at its target within a tolerance that the task has of its own."""


@dataclass(frozen=True)
class PoseTarget:
    """A pose of the tool centre point, with the freedoms that the part really has."""

    pose: pin.SE3
    """The arm's own tool centre point in the world, also where a changed tool works."""
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
    signal: str = ""
    """Name of the signal that is set when the tool is there, as it grips or lets go; empty for none."""
    straight: float = math.inf
    """How much of approach and retract, next to the target, has to be straight where tools do not stop at their outer
    ends [m]."""
    blend: float = 0.0
    """How far the tool may leave its target, so that it need not stop there [m]; 0: it stops."""

    @property
    def moves(self) -> bool:
        """Whether its target moves."""
        return self.belt is not None

    @property
    def velocity(self) -> tuple[float, float, float]:
        """Of its target in the world [m/s]; zero where it stands."""
        x, y, z = (0.0,) * 3 if self.belt is None else self.belt.conveyor.velocity.tolist()
        return x, y, z

    @property
    def window(self) -> tuple[float, float]:
        """The first and the last instant at which the tool may come to it [s], by itself: any where it stands."""
        return (0.0, math.inf) if self.belt is None else (self.belt.passes, self.belt.last)

    def straight_part(self) -> Stop:
        """Returns the stop with only as much of its lines as has to be straight; what moves with a belt stays."""
        if self.moves:
            return self
        approach, retract = (min(way, self.straight) for way in (self.approach, self.retract))
        return replace(self, approach=approach, retract=retract)

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


T = TypeVar("T")


def side_by_side(
    rows: Mapping[str, Sequence[T]],
    meets: Callable[[T], bool],
    needs: Callable[[T], Collection[str]],
    ends: Callable[[T], str],
) -> tuple[list[dict[str, T]], list[T]]:
    """Returns stages, and what is left as arms wait for one another forever.

    In every stage each arm does its next thing as soon as what that needs has ended in an earlier stage: without needs
    the k-th things of all arms between two meetings. Each meeting is a stage of its own. An arm that has run out of
    things, waits, or is early at a meeting is missing from a stage.

    Args:
        rows: what each arm does, in its order; every arm that meets others does so as often.
        meets: whether a thing is done by all arms at once.
        needs: what has to have ended before a thing, by name.
        ends: the name of what ends with a thing; empty for nothing.
    """
    place, over = dict.fromkeys(rows, 0), set[str]()
    stages: list[dict[str, T]] = []
    while True:
        heads = {name: row[place[name]] for name, row in rows.items() if place[name] < len(row)}
        now = heads
        if not all(meets(one) for one in heads.values()) or len(heads) < len(rows):
            now = {name: one for name, one in heads.items() if not meets(one)}
        now = {name: one for name, one in now.items() if over.issuperset(needs(one))}
        if not now:
            return stages, list(heads.values())
        stages.append(now)
        over.update(ends(one) for one in now.values())
        for name in now:
            place[name] += 1


Mode = Literal["paired", "free"]
Order = Literal["given", "optimise"]
ANY = "any"
"""What stands for an arm where the planner chooses it."""


@dataclass(frozen=True)
class Task:
    """One thing to be done by one arm: a pick and a place, a bare move, or its share of what both do together."""

    id: str
    """Unique name; the shares of both arms in a path, a seam or a hand-over have the same one."""
    arm: str
    """left or right; ANY where the planner chooses."""
    stops: tuple[Stop, ...]
    """Its targets in their order."""
    after: tuple[str, ...] = ()
    """Tasks that are over, with their last dwell and retract, before it begins with its first line."""
    part: str = ""
    """Name of the part that is carried from pick to place; empty where it has no shape."""
    path: PathWork | None = None
    """The path that is followed, the same for both arms where both follow; its one stop is where the tool ends."""
    seam: SeamWork | None = None
    """The seam that is worked, the same for both arms; its two stops are where it begins and where it ends."""
    handover: Handover | None = None
    """The hand-over, the same for both arms: the giver's stops are pick and give, the taker's take and place."""
    not_before: float = 0.0
    """Its tool is at the first target no earlier than this after the start [s]."""
    not_after: float = math.inf
    """Its tool is at the last target no later than this after the start [s]."""
    place: Place = NOWHERE
    """Where it is written."""
    tool: str = ""
    """The changed tool that it is done with, or that is taken or left; empty for none."""
    touches: tuple[str, ...] = ()
    """Tasks whose parts its part may touch, where they wait, are carried or lie."""
    leaves: bool = False
    """Flag of parts that leave the cell once placed."""

    def held_before(self, action: str) -> str:
        """Returns the name of what its arm holds when it comes to the stop of an action; empty for nothing."""
        return self._held(action, action in GIVES)

    def held_after(self, action: str) -> str:
        """Returns the name of what its arm holds when it leaves the stop of an action; empty for nothing."""
        return self._held(action, action in TAKES)

    def _held(self, action: str, holds: bool) -> str:
        if action in AT_STANDS:
            return Held(self.tool, docking=True).name if holds else ""
        return Held(self.tool, self.part if holds else "").name

    @property
    def is_change(self) -> bool:
        """Whether it takes a tool or leaves one: no file has such a task, it comes between two."""
        return any(stop.action in AT_STANDS for stop in self.stops)

    def allows(self, arm: str) -> bool:
        """Returns whether an arm may do it."""
        return self.arm in (arm, ANY)

    @property
    def shared(self) -> bool:
        """Whether it is one arm's share of what both may do together: the other one's has the same id."""
        return self.alone or self.handover is not None

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
    """Whether the file or the planner orders the tasks."""
    sequences: tuple[tuple[str, ...], ...] = ()
    """Tasks that one arm does one right after the other, by their ids."""
    pairing: tuple[tuple[StopKey, ...], ...] | None = None
    """What is done in each stage; None for the k-th target of each arm in stage k."""
    buffers: Mapping[str, Buffer] = field(default_factory=dict)
    """Places for parts between tasks, by name."""
    budget: Budget | None = None
    """What its plans must keep besides, or None."""
    skew: float = 0.0
    """Delay of either arm that every plan has to tolerate [s]."""
    beside: tuple[tuple[Task, Stop], ...] = ()
    """Tasks and stops whose parts lie there all the time; of a part of a job."""
    begin: FloatArray | None = field(default=None, compare=False)
    """All joints where the motion starts [rad or m], shape (n,), where that is no posture of the robot; of a part of a
    job, whose start is then only a name."""
    start_place: Place = field(default=NOWHERE, compare=False)
    """Place of the start in its file, or the file that leaves it out."""

    @cached_property
    def limits(self) -> JointLimits:
        """Limits of all joints at the job's pace."""
        return self.cell.robot.limits.scaled(self.speed)

    def blended(self) -> Job:
        """Returns the job for tools that stop where they have to only.

        Its lines are as long as they have to be straight, and corners of paths are rounded.
        """
        # Both tools of a path share its work.
        works = {id(t.path): t.path.rounded() for t in self.tasks if t.path is not None}
        tasks = tuple(
            replace(
                task,
                stops=tuple(stop.straight_part() for stop in task.stops),
                path=None if task.path is None else works[id(task.path)],
            )
            for task in self.tasks
        )
        return replace(self, tasks=tasks)

    @property
    def start_posture(self) -> str:
        """Name of the posture in which the motion starts; where it may start anywhere, that from which turns count."""
        return "home" if self.start == "free" else self.start

    @property
    def start_joints(self) -> FloatArray:
        """All joints there [rad or m], shape (n,)."""
        return self.cell.robot.postures[self.start_posture] if self.begin is None else self.begin

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
    def has_handovers(self) -> bool:
        """Whether any part goes from arm to arm."""
        return any(task.handover is not None for task in self.tasks)

    @property
    def moves(self) -> bool:
        """Whether any target moves."""
        return any(stop.moves for task in self.tasks for stop in task.stops)

    @property
    def in_sections(self) -> bool:
        """Whether it is planned section after section: paths and seams are done alone."""
        return any(task.alone for task in self.tasks)

    def carried(self) -> list[tuple[str, str]]:
        """Returns arm and name of everything that an arm may ever hold, each once, tools before parts; see `Held.name`.

        Of an arm that changes tools these are among it, whether its tasks say so yet or not. They come first: of what
        is held before and after a stop the later one is the fuller one.
        """
        arms = [arm.name for arm in self.cell.robot.arms]
        tools = [
            (arm, held)
            for arm, changes in self.cell.tool_changes.items()
            for tool in changes.tools
            for held in (Held(tool).name, Held(tool, docking=True).name)
        ]
        parts = [
            (arm, Held(task.tool, task.part).name)
            for task in self.tasks
            if task.part
            for arm in arms
            if task.allows(arm)
        ]
        return list(dict.fromkeys([*tools, *parts]))

    def held_at_start(self, arm: str) -> str:
        """Returns the name of what an arm holds when the motion starts; empty for nothing."""
        return Held(self.cell.start_tool(arm)).name

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
        """Returns the paired stages: within each section the next target of each arm, by arm name.

        A target is made as soon as the tasks are over that its task comes after, in an earlier stage; without any the
        k-th targets of both arms are a stage. A task is over when its last stage is, with its last dwell and retract.
        An arm that has run out of targets, or that waits, is missing from a stage. Hand-overs are where the arms meet:
        each is a stage of both. Where the job says itself what is paired with what, these are its stages.

        Raises:
            InfeasibleError: tasks wait for one another forever.
        """
        if self.pairing is not None:
            stops: dict[StopKey, tuple[Task, Stop]] = {
                (t.arm, t.id, s.action): (t, s) for t in self.tasks for s in t.stops
            }
            return [{key[0]: stops[key] for key in stage} for stage in self.pairing]
        found: list[dict[str, tuple[Task, Stop]]] = []
        for section in self.sections():
            stages, left = _section_stages(section, self.cell.robot)
            if left:
                raise InfeasibleError(_waiting_forever([task for task, _ in left]))
            found += stages
        return found


def _section_stages(
    section: Sequence[Task], robot: Robot
) -> tuple[list[dict[str, tuple[Task, Stop]]], list[tuple[Task, Stop]]]:
    """Returns the paired stages of one section, and the targets that wait for one another forever."""
    ids = {task.id for task in section}
    rows = {
        arm.name: [(task, stop) for task in section if task.arm == arm.name for stop in task.stops]
        for arm in robot.arms
    }

    def needs(one: tuple[Task, Stop]) -> Sequence[str]:
        # What is in another section is over before this one begins, or comes after all of it.
        task, stop = one
        return [name for name in task.after if name in ids] if stop is task.stops[0] else ()

    def ends(one: tuple[Task, Stop]) -> str:
        # What is handed over is over when it is placed.
        task, stop = one
        return task.id if stop is task.stops[-1] and stop.action != "give" else ""

    return side_by_side(
        {name: row for name, row in rows.items() if row},
        lambda one: one[1].action in ("give", "take"),
        needs,
        ends,
    )


def _waiting_forever(tasks: Sequence[Task]) -> Refusal:
    """Refuse tasks that wait for one another in the order that is given."""
    names, stuck = dict.fromkeys(task.id for task in tasks), next(t for t in tasks if t.after)
    more = {"names": list(names), "tasks": tasks}
    return Refusal("waits_forever", stuck.place, stuck.id, more=more)
