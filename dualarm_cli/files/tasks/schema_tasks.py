"""Schema of task files (`dualarm: tasks/1`)."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator
from pydantic.config import JsonDict

from dualarm_cli.files.cells.schema_cell import LimitsSection
from dualarm_cli.files.source import quantities
from dualarm_cli.files.source.fields import (
    SMALLEST_POSITIVE,
    Distance,
    Duration,
    FramedPose,
    Name,
    Pose,
    Quantity,
    Section,
    Size,
    SpeedFraction,
    refuse,
)
from dualarm_cli.files.source.yaml_source import Document
from dualarm_cli.files.tasks.schema_paths import PathSection
from dualarm_cli.files.tasks.schema_seams import CoordinateSection
from dualarm_cli.model.budget import Budget
from dualarm_cli.model.place import Place

_LongestTime = Annotated[float, Quantity(quantities.TIME, SMALLEST_POSITIVE)]


class BudgetSection(Section):
    """What every plan of the job must keep: a plan that does not is told, and ends with exit code 1."""

    cycle_time: _LongestTime | None = Field(default=None, description="Longest cycle time [s].")
    clearance: Distance | None = Field(
        default=None,
        description="Least distance of any two bodies that must keep apart [m].",
    )

    @model_validator(mode="after")
    def _something(self) -> BudgetSection:
        if self.cycle_time is None and self.clearance is None:
            raise refuse("an empty budget; give cycle_time, clearance or both, or remove it")
        return self


def read_budget(document: Document, section: BudgetSection | None) -> Budget | None:
    """Returns the budget of a task file with the places of its figures; None where it has none."""
    if section is None:
        return None
    places = {
        name: Place(document.source.name, *document.place(("budget", name)))
        for name in ("cycle_time", "clearance")
    }
    return Budget(section.cycle_time, section.clearance, places["cycle_time"], places["clearance"])


MOST_PARTS = 1_000_000
"""Most parts of a buffer."""


class BufferSection(Section):
    """Room for parts that are all alike, on the way from one task to another."""

    capacity: Annotated[int, Field(ge=1, le=MOST_PARTS)] = Field(
        description="How many parts it has room for."
    )
    initial: Annotated[int, Field(ge=0, le=MOST_PARTS)] = Field(
        default=0, description="How many parts are in it at the start."
    )

    @model_validator(mode="after")
    def _room_for_all(self) -> BufferSection:
        if self.initial > self.capacity:
            text = (
                f"{self.initial} parts at the start; there is room for {self.capacity} (capacity)"
            )
            raise refuse(text, "initial")
        return self


CONFIGURATIONS: JsonDict = {
    "description": "Joint positions [rad] of one configuration, or a list of alternatives.",
    "type": "array",
}
_KINDS = ("pick", "handover", "place", "move", "coordinate", "path")
_HANDOVER = ["pick", "handover", "place"]
_NO_FREEDOM = {
    "joints": "two tools meet there, so it has to be a pose; give xyz, with rpy or quat",
    "free": "the taking tool's pose follows from the giving one's, so that both are fixed",
    "symmetry": "the taking tool's pose follows from the giving one's, so that both are fixed",
}


class DwellSection(Section):
    """How long the tool stands still, and for what."""

    gripper: Duration = Field(default=0.0, description="Time of the gripper [s].")
    settle: Duration = Field(default=0.0, description="Time for the arm to come to rest [s].")
    handshake: Duration = Field(
        default=0.0, description="Time for signals of the cell's controller [s]."
    )


def _one_number(value: object) -> object:
    return {"gripper": value} if isinstance(value, int | float | str) else value


Dwell = Annotated[DwellSection, BeforeValidator(_one_number)]


class TargetSection(FramedPose):
    """Where the tool centre point shall be: a pose, or joint configurations of the arm."""

    at: Name | None = Field(
        default=None, description="Named frame that the pose is given in; same as `in`."
    )
    free: Literal["yaw"] | None = Field(
        default=None, description="yaw: any turn about the tool's z axis will do."
    )
    symmetry: Annotated[int, Field(ge=1, le=360)] | None = Field(
        default=None, description="Turns by a full turn divided by this number are equally good."
    )
    joints: Annotated[list[Any], Field(min_length=1, max_length=1000)] | None = Field(
        default=None,
        description="Joint configurations instead of a pose.",
        json_schema_extra=CONFIGURATIONS,
    )
    buffer: Name | None = Field(
        default=None,
        description="Buffer that a place puts its part into, or a pick takes one out of.",
    )
    conveyor: Name | None = Field(
        default=None, description="Conveyor of the cell that the target moves with."
    )
    passes: Duration | None = Field(
        default=None,
        description="When what is on the conveyor passes this pose, after the start [s].",
    )
    within: Size | None = Field(
        default=None,
        description="How far beyond this pose along the conveyor the tool may still come to it [m].",
    )

    @model_validator(mode="after")
    def _whole_conveyor(self) -> TargetSection:
        given = [key for key in ("passes", "within") if getattr(self, key) is not None]
        if self.conveyor is None:
            if given:
                raise refuse(f"'{given[0]}' is of a target on a conveyor; add 'conveyor'", given[0])
            return self
        if self.joints is not None:
            raise refuse(
                "'conveyor' does not go with 'joints', which stand still; give xyz, with rpy or quat",
                "conveyor",
            )
        missing = [key for key in ("passes", "within") if key not in given]
        if missing:
            what = {
                "passes": "when the part passes this pose",
                "within": "how far beyond it it may be met",
            }
            raise refuse(f"'{missing[0]}' is missing: {what[missing[0]]}", "conveyor", code="E202")
        return self

    @model_validator(mode="after")
    def _pose_or_joints(self) -> TargetSection:
        if self.joints is not None:
            for key in ("xyz", "rpy", "quat", "in", "at", "free", "symmetry"):
                if getattr(self, "in_" if key == "in" else key) is not None:
                    raise refuse(f"'{key}' does not go with 'joints', which say everything", key)
        elif self.xyz is None:
            raise refuse("no target; give xyz, with rpy or quat, or joints")
        if self.in_ is not None and self.at is not None:
            raise refuse("'in' and 'at' both name the frame; keep one", "in")
        return self


class HandoverSection(FramedPose):
    """Where a part goes from one arm's tool into the other's."""

    at: Name | None = Field(
        default=None, description="Named frame that the pose is given in; same as `in`."
    )
    grip: Pose = Field(
        description="Pose of the taking tool's centre point in the frame of the giving tool's."
    )

    @model_validator(mode="before")
    @classmethod
    def _a_pose(cls, value: Any) -> Any:
        for key, why in _NO_FREEDOM.items():
            if isinstance(value, dict) and key in value:
                raise refuse(f"'{key}' does not go with 'handover': {why}", key)
        return value

    @model_validator(mode="after")
    def _whole(self) -> HandoverSection:
        if self.xyz is None:
            raise refuse("no place to meet; give xyz, with rpy or quat, of the giving tool")
        if self.in_ is not None and self.at is not None:
            raise refuse("'in' and 'at' both name the frame; keep one", "in")
        if self.grip.xyz is None and self.grip.rpy is None and self.grip.quat is None:
            raise refuse(
                "both tools in the same pose; give xyz, rpy or quat of the taking tool in the giving one's frame",
                "grip",
            )
        return self


class TaskSection(Section):
    """One thing to be done: a pick and a place, a part handed from arm to arm, or a bare move."""

    id: Name = Field(description="Unique name.")
    arm: Literal["left", "right", "any"] | None = Field(
        default=None, description="The arm that does it; of a hand-over the giving one."
    )
    after: list[Name] = Field(
        default_factory=list, description="Tasks to be done before, for order: optimise."
    )
    not_before: Duration | None = Field(
        default=None,
        description="The tool is at the first target no earlier than this after the start [s].",
    )
    not_after: Duration | None = Field(
        default=None,
        description="The tool is at the last target no later than this after the start [s].",
    )
    pick: TargetSection | None = Field(default=None, description="Where the part is taken.")
    handover: HandoverSection | None = Field(
        default=None,
        description="Where the part goes into the other arm's tool: the giving tool's pose, and the grip.",
    )
    place: TargetSection | None = Field(default=None, description="Where the part is put.")
    move: TargetSection | None = Field(default=None, description="Where the tool just goes.")
    coordinate: CoordinateSection | None = Field(
        default=None,
        description="Both arms on one part: one holds it, the other works along a curve.",
    )
    path: PathSection | None = Field(
        default=None, description="A path that one tool or both follow at a speed."
    )
    part: Name | None = Field(
        default=None, description="Kind of part carried from pick to place, as the cell names it."
    )
    approach: Distance | None = Field(
        default=None, description="Straight approach along the tool's z axis [m]."
    )
    retract: Distance | None = Field(
        default=None, description="Straight retract along the tool's z axis [m]."
    )
    dwell: Dwell | None = Field(
        default=None, description="Time at each target [s], one number or its shares."
    )
    tool: Name | None = Field(
        default=None,
        description="The tool that it is done with, of those that the cell's tool_changes name; none for no tool.",
    )

    @model_validator(mode="after")
    def _one_kind(self) -> TaskSection:
        given = [key for key in _KINDS if getattr(self, key) is not None]
        if not given:
            raise refuse("nothing to do; give pick and place, move, path, or coordinate")
        if self.handover is not None and given != _HANDOVER:
            missing = [key for key in _HANDOVER if key not in given]
            if missing:
                raise refuse(
                    f"'{missing[0]}' is missing: a hand-over has pick, handover and place",
                    code="E202",
                )
            raise refuse(f"'{given[-1]}' does not go with 'handover'; make two tasks", given[-1])
        if len(given) > 1 and given not in (["pick", "place"], _HANDOVER):
            raise refuse(f"'{given[1]}' does not go with '{given[0]}'; make two tasks", given[1])
        if (
            self.path is not None
            and (self.arm or self.path.arm) is None
            and self.path.both is False
        ):
            raise refuse("'arm' is missing", code="E202")
        if self.arm is None and given[0] not in ("coordinate", "path"):
            raise refuse("'arm' is missing", code="E202")
        return self


class DefaultsSection(Section):
    """What holds for every pick and place that does not say otherwise."""

    approach: Distance = Field(
        default=0.0, description="Straight approach along the tool's z axis [m]."
    )
    retract: Distance = Field(
        default=0.0, description="Straight retract along the tool's z axis [m]."
    )
    dwell: Dwell = Field(default=DwellSection(), description="Time at each target [s].")
    part: Name | None = Field(
        default=None, description="Kind of part carried from pick to place, as the cell names it."
    )
    tool: Name | None = Field(
        default=None, description="The tool that tasks are done with; none for no tool."
    )
    straight: Distance | None = Field(
        default=None, description="How much of a line must be straight [m]."
    )
    dwell_motion: Literal["allowed", "forbidden"] | None = Field(
        default=None, description="Whether the platform may turn while tools dwell."
    )
    line_motion: Literal["allowed", "forbidden"] | None = Field(
        default=None, description="Whether the platform may turn during lines."
    )


class TasksFile(Section):
    """What is to be done in a cell, by which arm, in which order."""

    dualarm: Literal["tasks/1"] = Field(description="Kind and version of the file.")
    cell: Name = Field(description="Path of the cell file, relative to this file.")
    mode: Literal["paired", "free"] = Field(
        default="paired",
        description="paired: both arms start each stage together; free: each on its own clock.",
    )
    order: Literal["given", "optimise"] = Field(
        default="given", description="Who chooses the order of the tasks."
    )
    start: Name = Field(default="home", description="Posture in which the motion starts, or free.")
    return_: bool = Field(
        default=False, alias="return", description="Whether the motion ends where it started."
    )
    speed: SpeedFraction = Field(
        default=1.0, description="Fraction of full speed for the whole plan."
    )
    limits: LimitsSection = Field(default=LimitsSection(), description="Caps for these tasks.")
    defaults: DefaultsSection = Field(
        default=DefaultsSection(), description="What tasks have that do not say otherwise."
    )
    budget: BudgetSection | None = Field(
        default=None, description="What every plan of these tasks must keep."
    )
    sequences: list[Annotated[list[Name], Field(min_length=2)]] = Field(
        default_factory=list,
        description="Lists of tasks that one arm does one right after the other, for order: optimise.",
    )
    buffers: dict[Name, BufferSection] = Field(
        default_factory=dict,
        description="Room for parts on the way from one task to another, by name.",
    )
    tasks: Annotated[list[TaskSection], Field(min_length=1)] = Field(
        description="The tasks, in order."
    )
