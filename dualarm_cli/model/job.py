"""Job: tasks of a cell, with their arms and order."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import field, replace
from functools import cached_property
from typing import Literal

import pinocchio as pin

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray, readonly
from dualarm_cli.model.budget import Budget
from dualarm_cli.model.cell import Cell, Held
from dualarm_cli.model.dwell import Dwell, TimeRange
from dualarm_cli.model.lines import Line, LineDirections
from dualarm_cli.model.part_flow import NO_CARE, Buffer, Care, Grasp, Handover, OnBelt, PoseRange
from dualarm_cli.model.place import NOWHERE, Place, tasks_name
from dualarm_cli.model.process_work import PathWork, SeamWork
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.side_by_side import section_stages
from dualarm_cli.records import ShownInNotebooks, dataclass
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
"""Key of a stop: arm, task and action."""
TAKES: frozenset[str] = frozenset({"pick", "take", "take_tool"})
"""Actions after which the arm holds the task's part or tool."""
GIVES: frozenset[str] = frozenset({"place", "give", "leave_tool"})
"""Actions after which the arm no longer holds the task's part or tool."""
AFTER_DWELL: frozenset[str] = frozenset({"place", "take", "leave_tool"})
"""Actions that take effect at the end of the dwell, not at the event.

In a hand-over the giver's event is the end of the taker's dwell, so that one of them holds the part at any time.
"""
LYING: frozenset[str] = frozenset({"pick", "place"})
"""Actions on whose lines the part may be close to its support."""
CHANGES = TAKES | GIVES
"""Actions that change the held object."""
AT_STANDS: frozenset[str] = frozenset({"take_tool", "leave_tool"})
"""Actions of tool changes; the planner inserts them, files have none."""
WITHIN_TOLERANCE: frozenset[str] = frozenset({"path"})
"""Actions that reach their target within the task's own tolerance."""


@dataclass(frozen=True)
class PoseTarget:
    """Pose of the tool centre point, with its free yaw or symmetry."""

    pose: pin.SE3
    """World pose of the fixed tool centre point, also for changed tools."""
    free_yaw: bool = False
    """Whether the yaw about the tool's z axis is free."""
    symmetry: int = 1
    """Order of rotational symmetry: yaws that differ by 2π/symmetry are equivalent."""


@dataclass(frozen=True)
class JointTarget:
    """Joint configurations of one arm to choose from."""

    configurations: FloatArray
    """Alternatives [rad], shape (m, n) over the arm's joints."""

    def __post_init__(self) -> None:
        """Freeze the array."""
        object.__setattr__(self, "configurations", readonly(self.configurations))


@dataclass(frozen=True)
class SeamTarget:
    """Poses of both tools on a seam, which its solver decides."""

    work: SeamWork
    """The seam."""


Target = PoseTarget | JointTarget | SeamTarget


@dataclass(frozen=True)
class Stop:
    """Target of a task, with its approach, dwell and retract."""

    action: Action
    """Action at the target."""
    target: Target
    """Pose, configurations or seam to reach."""
    approach: float
    """Length of the straight approach [m]; 0 for none."""
    retract: float
    """Length of the straight retract [m]; 0 for none."""
    dwell: Dwell
    """Time at rest at the target."""
    place: Place
    """Place of the stop in its file."""
    buffer: str = ""
    """Name of the buffer that the part enters or leaves; empty for none."""
    belt: OnBelt | None = None
    """Conveyor that carries the target, lines and dwell; None for a stationary target."""
    signal: str = ""
    """Signal that is set when the tool grips or releases; empty for none."""
    straight: float = math.inf
    """Straight part of approach and retract that blending keeps, from the target [m]."""
    blend: float = 0.0
    """Largest tool distance from a target passed in motion [m], 0 for stops."""
    varying: tuple[TimeRange, ...] = ()
    """Parts of the dwell whose time varies."""
    ranges: tuple[PoseRange, ...] = ()
    """Ranges of the target's pose, its own first, then those of its frames."""
    directions: LineDirections = LineDirections()
    """Directions of approach and retract, from the target outward."""

    @property
    def lines(self) -> tuple[Line, Line]:
        """Length and direction of approach and retract."""
        towards, away = self.directions.approach, self.directions.retract
        return (self.approach, towards), (self.retract, away)

    @property
    def moves(self) -> bool:
        """Whether the target moves."""
        return self.belt is not None

    @property
    def velocity(self) -> tuple[float, float, float]:
        """Velocity of the target in the world [m/s]; zero if it stands still."""
        x, y, z = (0.0,) * 3 if self.belt is None else self.belt.conveyor.velocity.tolist()
        return x, y, z

    @property
    def window(self) -> tuple[float, float]:
        """Earliest and latest time of reaching the target [s]; any if stationary."""
        return (0.0, math.inf) if self.belt is None else (self.belt.passes, self.belt.last)

    def straight_part(self) -> Stop:
        """Shorten approach and retract to their straight parts; stops on belts are unchanged."""
        if self.moves:
            return self
        approach, retract = (min(length, self.straight) for length in (self.approach, self.retract))
        return replace(self, approach=approach, retract=retract)

    def met(self, time: float) -> Stop:
        """Move the target with its conveyor to a time [s]."""
        if self.belt is None:
            return self
        assert isinstance(self.target, PoseTarget)  # the reader refuses others on conveyors
        pose, belt = self.belt.moved(self.target.pose, time)
        return replace(self, target=replace(self.target, pose=pose), belt=belt)

    @property
    def stored(self) -> int:
        """Change of the number of parts in its buffer: 1, -1 or 0."""
        return (self.action in GIVES) - (self.action in TAKES) if self.buffer else 0


Mode = Literal["paired", "free"]
Order = Literal["given", "optimise"]
ANY = "any"
"""Arm of a task whose arm the planner chooses."""


@dataclass(frozen=True)
class Task:
    """Work of an arm: pick and place, move, path, seam or hand-over."""

    id: str
    """Unique name; both arms' parts of joint work have the same one."""
    arm: str
    """Arm: left, right, or ANY if the planner chooses."""
    stops: tuple[Stop, ...]
    """Stops in order."""
    after: tuple[str, ...] = ()
    """Tasks that finish, with last dwell and retract, before this one's first line."""
    part: str = ""
    """Name of the carried part; empty if it has no shape."""
    path: PathWork | None = None
    """Path to follow, shared by both arms; its one stop is the path's end."""
    seam: SeamWork | None = None
    """Seam to work, shared by both arms; its two stops are start and end."""
    handover: Handover | None = None
    """Hand-over: pick and give of the giver, take and place of the taker."""
    not_before: float = 0.0
    """Earliest time at the first target [s]."""
    not_after: float = math.inf
    """Latest time at the last target [s]."""
    place: Place = NOWHERE
    """Place of the task in its file."""
    tool: str = ""
    """Changed tool that the task needs, takes or leaves; empty for none."""
    touches: tuple[str, ...] = ()
    """Tasks whose parts its part may touch, waiting, carried or lying."""
    leaves: bool = False
    """Whether the part leaves the cell after it is placed."""
    grasp: Grasp | None = None
    """Grasp of its part at every stop, or None."""
    grasps: tuple[Task, ...] = ()
    """Task with each of its grasps, or pairs of them, itself first, if the planner chooses."""
    care: Care = NO_CARE
    """Limits of the arm's motion throughout the task."""
    holding: Care = NO_CARE
    """Limits of the arm's motion while it holds the part."""

    def care_before(self, action: str) -> Care:
        """Return the limits of the transfer to a stop and of its approach."""
        return self.care.stricter(self.holding) if action in GIVES else self.care

    def care_after(self, action: str) -> Care:
        """Return the limits of the retract from a stop."""
        return self.care.stricter(self.holding) if action in TAKES else self.care

    @property
    def tilt(self) -> float:
        """Largest angle by which its part may lean while it is held [rad]."""
        return min(self.care.tilt, self.holding.tilt)

    @property
    def upright(self) -> tuple[float, float, float] | None:
        """Vertical at the pick in the fixed tool's frame; None without a picked pose."""
        stop = self.stops[0]
        if stop.action == "take" and self.handover is not None:
            return self.handover.upright
        if stop.action != "pick" or not isinstance(stop.target, PoseTarget):
            return None
        x, y, z = stop.target.pose.rotation[2].tolist()
        return x, y, z

    def by_grasp(self, task: Task) -> Task:
        """Replace what depends on the grasp by that of one of `grasps`; a decided arm stays."""
        arm = task.arm if self.arm == ANY else self.arm
        decided = replace(self, stops=task.stops, part=task.part, grasp=task.grasp, grasps=())
        return replace(decided, arm=arm, handover=task.handover)

    def held_before(self, action: str) -> str:
        """Name the object that the arm holds on arrival; empty for nothing."""
        return self._held(action, action in GIVES)

    def held_after(self, action: str) -> str:
        """Name the object that the arm holds on departure; empty for nothing."""
        return self._held(action, action in TAKES)

    def _held(self, action: str, holds: bool) -> str:
        if action in AT_STANDS:
            return Held(self.tool, docking=True).name if holds else ""
        return Held(self.tool, self.part if holds else "").name

    @property
    def is_change(self) -> bool:
        """Whether this is a tool change, inserted by the planner."""
        return any(stop.action in AT_STANDS for stop in self.stops)

    def allows(self, arm: str) -> bool:
        """Check whether an arm may do the task."""
        return self.arm in (arm, ANY)

    @property
    def shared(self) -> bool:
        """Whether both arms may take part: the other arm's task has the same id."""
        return self.alone or self.handover is not None

    @property
    def alone(self) -> bool:
        """Whether no other work is done at the same time: a path or a seam."""
        return self.path is not None or self.seam is not None

    def goes_with(self, task: Task) -> bool:
        """Check whether both tasks belong to the same path, seam or section between them."""
        return self.path is task.path and self.seam is task.seam


@dataclass(frozen=True, eq=False)
class Job(ShownInNotebooks):
    """Cell and tasks. A job equals only itself."""

    cell: Cell
    """Robot, tools and obstacles."""
    tasks: tuple[Task, ...]
    """Tasks in file order."""
    start: str
    """Name of the start posture, or `free`."""
    returns: bool
    """Whether the motion ends in its start posture; then its duration is a period."""
    speed: float = 1.0
    """Fraction of full speed; dwells keep their length."""
    tool_speed: float | None = None
    """Speed limit of all tool centre points in the world [m/s], or None."""
    inputs: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of every file that was read, by name within the project."""
    notes: tuple[str, ...] = ()
    """Remarks on how the files were understood."""
    mode: Mode = "paired"
    """Synchronous (`paired`) or asynchronous (`free`) arms."""
    order: Order = "given"
    """Whether the file gives the order of the tasks or the planner chooses it."""
    sequences: tuple[tuple[str, ...], ...] = ()
    """Ids of tasks that one arm does directly one after the other."""
    pairing: tuple[tuple[StopKey, ...], ...] | None = None
    """Stops of each stage; None for the k-th stop of each arm in stage k."""
    buffers: Mapping[str, Buffer] = field(default_factory=dict)
    """Buffers by name."""
    budget: Budget | None = None
    """Required cycle time, clearance and skew, or None."""
    skew: float = 0.0
    """Delay of either arm that every plan must tolerate [s]."""
    lying: tuple[tuple[Task, Stop], ...] = ()
    """Stops of parts that lie in the cell throughout a part of a job."""
    begin: FloatArray | None = field(default=None, compare=False)
    """Start configuration for part of a job [rad or m], shape (n,).

    With it, `start` is only a name.
    """
    start_place: Place = field(default=NOWHERE, compare=False)
    """Place of the start in its file, or the file that omits it."""

    def __repr__(self) -> str:
        """Describe the job in a line."""
        name, count = tasks_name(self.inputs), len({task.id for task in self.tasks})
        return f"<Job {name and name + ' '}of {self.cell.robot.name}: {count} tasks>"

    @cached_property
    def limits(self) -> JointLimits:
        """Limits of all joints at the job's fraction of full speed."""
        return self.cell.robot.limits.scaled(self.speed)

    def blended(self) -> Job:
        """Shorten lines to their straight parts and round the corners of paths."""
        # Both tools of a path share its work.
        works = {id(t.path): t.path.rounded() for t in self.tasks if t.path is not None}

        def straight(task: Task) -> Task:
            return replace(
                task,
                stops=tuple(stop.straight_part() for stop in task.stops),
                path=None if task.path is None else works[id(task.path)],
                grasps=tuple(map(straight, task.grasps)),
            )

        return replace(self, tasks=tuple(map(straight, self.tasks)))

    def with_grasps(self, names: Mapping[str, str]) -> Job:
        """Decide the grasps of tasks that leave them open.

        Args:
            names: `choice` of the grasp by task id; without one the first grasp is taken.
        """

        def decided(task: Task) -> Task:
            named = (t for t in task.grasps if t.grasp and t.grasp.choice == names.get(task.id))
            return task.by_grasp(next(named, task)) if task.grasps else task

        return replace(self, tasks=tuple(map(decided, self.tasks)))

    @cached_property
    def slows(self) -> bool:
        """Whether any task or held part slows the motion."""
        return any(task.care.slows or task.holding.slows for task in self.tasks)

    def under(self, care: Care) -> Job:
        """Lower rates and tool speed to the limits of a path or seam."""
        speed, cap = self.speed * care.speed, min(care.tool_speed, self.tool_speed or math.inf)
        cell = self.cell.with_accelerations(care.acceleration)
        slowed = replace(self, cell=cell, speed=speed, tool_speed=cap if cap < math.inf else None)
        return slowed if care.slows else self

    @property
    def start_posture(self) -> str:
        """Name of the start posture; home for a free start."""
        return "home" if self.start == "free" else self.start

    @property
    def start_joints(self) -> FloatArray:
        """Joint values at the start [rad or m], shape (n,)."""
        return self.cell.robot.postures[self.start_posture] if self.begin is None else self.begin

    @property
    def chooses_grasps(self) -> bool:
        """Whether the planner chooses the grasp of any task."""
        return any(task.grasps for task in self.tasks)

    @property
    def is_decided(self) -> bool:
        """Check whether arms and order of all tasks are given."""
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
        """Whether any part is handed over."""
        return any(task.handover is not None for task in self.tasks)

    @property
    def moves(self) -> bool:
        """Whether any target moves."""
        return any(stop.moves for task in self.tasks for stop in task.stops)

    @property
    def in_sections(self) -> bool:
        """Whether the job has paths or seams, which are planned as separate sections."""
        return any(task.alone for task in self.tasks)

    def carried(self) -> list[tuple[str, str]]:
        """List (arm, name) of every object that may be held, tools first.

        Names are those of `Held`. Tools of arms that change tools are included, whether or not the tasks name them yet.
        They come first because the object with the part is the more complete of those before and after a stop.
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
        """Name the object that an arm holds at the start; empty for nothing."""
        return Held(self.cell.start_tool(arm)).name

    def stops_of(self, arm: str) -> list[tuple[Task, Stop]]:
        """List the stops of one arm in file order, each with its task."""
        return [(task, stop) for task in self.tasks if task.arm == arm for stop in task.stops]

    def stops_by_key(self) -> dict[StopKey, Stop]:
        """Return every stop by its key, for every arm that may go there."""
        return {
            (arm.name, task.id, stop.action): stop
            for task in self.tasks
            for arm in self.cell.robot.arms
            if task.allows(arm.name)
            for stop in task.stops
        }

    def sections(self) -> list[tuple[Task, ...]]:
        """Split the tasks into sections: each path or seam, and the tasks between them."""
        sections: list[tuple[Task, ...]] = []
        for task in self.tasks:
            if sections and task.goes_with(sections[-1][0]):
                sections[-1] = (*sections[-1], task)
            else:
                sections.append((task,))
        return sections

    def stages(self) -> list[dict[str, tuple[Task, Stop]]]:
        """Group the stops into synchronous stages, by arm name.

        A stop is in the first stage after its prerequisites are finished; without any, stage k has the k-th stop of
        each arm in the section. A task is finished with its last stage, including dwell and retract. An arm is missing
        from a stage if it waits or has no more stops. A hand-over is one stage of both arms. An explicit `pairing` is
        returned as it is.

        Raises:
            InfeasibleError: tasks wait for each other.
        """
        if self.pairing is not None:
            stops: dict[StopKey, tuple[Task, Stop]] = {
                (t.arm, t.id, s.action): (t, s) for t in self.tasks for s in t.stops
            }
            return [{key[0]: stops[key] for key in stage} for stage in self.pairing]
        stages: list[dict[str, tuple[Task, Stop]]] = []
        for section in self.sections():
            of_section, deadlocked = section_stages(section, self.cell.robot)
            if deadlocked:
                tasks = [task for task, _ in deadlocked]
                names = list(dict.fromkeys(task.id for task in tasks))
                first = next(task for task in tasks if task.after)
                data = {"names": names, "tasks": tasks}
                raise InfeasibleError(Refusal("waits_forever", first.place, first.id, data=data))
            stages += of_section
        return stages
