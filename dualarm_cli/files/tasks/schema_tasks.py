"""Schema of task files (`dualarm: tasks/1`)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import (
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    WithJsonSchema,
    field_validator,
    model_validator,
)
from pydantic_core import core_schema

from dualarm_cli.files.cells.grids import MOST_PLACES
from dualarm_cli.files.cells.schema_cell import CareSection, FreeSection, LimitsSection, Line
from dualarm_cli.files.source import quantities
from dualarm_cli.files.source.fields import (
    SMALLEST_POSITIVE,
    Clearance,
    Duration,
    FramedPose,
    LineSection,
    Name,
    Quantity,
    Section,
    SpeedFraction,
    Symmetry,
    VariesSection,
    Vector3,
    WithinReach,
    quantity_schema,
    refuse,
)
from dualarm_cli.files.source.quantities import parse_quantity
from dualarm_cli.files.source.short_forms import OneOrMore, ShortForm
from dualarm_cli.files.source.text_source import quote
from dualarm_cli.files.source.yaml_source import Document
from dualarm_cli.model.budget import Budget, CycleKind
from dualarm_cli.model.dwell import TimeRange
from dualarm_cli.model.part_flow import PlaceOrder
from dualarm_cli.model.place import Place

_LongestTime = Annotated[float, Quantity(quantities.TIME, SMALLEST_POSITIVE)]
Skew = Annotated[float, Quantity(quantities.TIME, SMALLEST_POSITIVE, 1.0)]


class BudgetSection(Section):
    """Limits that every plan of the job must meet: otherwise the exit code is 1."""

    cycle_time: _LongestTime | None = Field(default=None, description="Longest cycle time [s].")
    cycle: CycleKind | None = Field(
        default=None,
        description="Cycle time that is compared where dwells vary: nominal (default), 95% (of all cycles), or worst.",
    )
    clearance: Clearance | None = Field(
        default=None,
        description="Minimum distance of bodies that must not touch, near links of one arm excepted [m].",
    )
    skew: Skew | None = Field(
        default=None,
        description="Minimum delay of one arm at which plans must keep their clearance [s].",
    )

    @field_validator("cycle", mode="before")
    @classmethod
    def _kind(cls, value: object) -> object:
        if not isinstance(value, str):
            return value
        try:
            parse_quantity(value, quantities.TIME)
        except quantities.QuantityError:
            return value
        raise refuse(f"{quote(value)} is a time; write cycle_time: {value}")

    @model_validator(mode="after")
    def _something(self) -> BudgetSection:
        if self.cycle is not None and self.cycle_time is None:
            raise refuse("'cycle' says which cycle time is compared; give cycle_time, too", "cycle")
        if self.cycle_time is None and self.clearance is None and self.skew is None:
            raise refuse("an empty budget; give cycle_time, clearance or skew, or remove it")
        return self


class TimingSection(Section):
    """Delay between the arms that plans must tolerate without losing clearance."""

    skew: Skew = Field(
        description="Delay of either arm against the other, up to which plans keep their clearance [s]."
    )


def read_budget(document: Document, section: BudgetSection | None) -> Budget | None:
    """Read the budget with the places of its limits, or None."""
    if section is None:
        return None
    places = {
        name: Place(document.source.name, *document.place(("budget", name)))
        for name in ("cycle_time", "clearance", "skew")
    }
    return Budget(
        section.cycle_time,
        section.clearance,
        places["cycle_time"],
        places["clearance"],
        section.skew,
        places["skew"],
        section.cycle or "nominal",
    )


_POSITION = quantity_schema([quantities.ANGLE, quantities.LENGTH], -50.0, 50.0)
PositionOrRow = Annotated[
    Any, WithJsonSchema({"anyOf": [_POSITION, {"type": "array", "items": _POSITION}]})
]
"""Joint position, or one of several configurations; read once the arm is known."""


class VariedTime:
    """Field annotation of a time, or of its least, nominal and greatest value; read as `TimeRange`."""

    def read(self, value: object) -> TimeRange:
        """Parse the times [s]; raises an error for pydantic."""
        if isinstance(value, TimeRange):
            return value
        values = value if isinstance(value, list) else [value] * 3
        if len(values) != 3:
            raise refuse(f"a list of {len(values)}; give least, nominal and greatest time")
        least, nominal, most = (Quantity(quantities.TIME, 0.0).read(entry) for entry in values)
        if not least <= nominal <= most:
            raise refuse(
                f"{least:g}, {nominal:g}, {most:g} s: give least, nominal and greatest time"
            )
        return TimeRange(least, nominal, most)

    def __get_pydantic_core_schema__(
        self, source: type[Any], handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        """Read the times before pydantic checks them."""
        return core_schema.no_info_plain_validator_function(self.read)

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Build the JSON Schema of a time, or of three."""
        time = Quantity(quantities.TIME, 0.0).__get_pydantic_json_schema__(schema, handler)
        return {"anyOf": [time, {"type": "array", "items": time, "minItems": 3, "maxItems": 3}]}


TimeOrRange = Annotated[TimeRange, VariedTime()]
_AT_ONCE = TimeRange(0.0, 0.0, 0.0)


class DwellSection(Section):
    """Parts of a dwell at a target [s]: gripper, settling, handshake."""

    gripper: TimeOrRange = Field(
        default=_AT_ONCE,
        description="Time of the gripper [s], or least, nominal and greatest time.",
    )
    settle: TimeOrRange = Field(
        default=_AT_ONCE, description="Settling time of the arm [s], or three."
    )
    handshake: TimeOrRange = Field(
        default=_AT_ONCE, description="Time for signals of the cell's controller [s], or three."
    )

    @property
    def parts(self) -> tuple[TimeRange, TimeRange, TimeRange]:
        """Gripper, settling and handshake [s]."""
        return self.gripper, self.settle, self.handshake


Dwell = Annotated[DwellSection, ShortForm("gripper", (int, float, str, list))]


Range = Annotated[
    list[Annotated[int, Field(ge=1, le=MOST_PLACES)]], Field(min_length=2, max_length=2)
]


class EachSection(Section):
    """Selection of places of a frame's grid."""

    x: Range | None = Field(default=None, description="First and last place along x, from 1.")
    y: Range | None = Field(default=None, description="First and last place along y, from 1.")
    layer: Range | None = Field(default=None, description="First and last layer, from 1.")
    first: Annotated[int, Field(ge=1, le=MOST_PLACES)] | None = Field(
        default=None, description="Number of places that are used; default: all."
    )
    order: PlaceOrder | None = Field(
        default=None, description="Order of the places; default: that of the grid."
    )


class EachReference:
    """Field annotation of `place`, a path or a selection.

    It is validated when tasks are expanded, before the file is.
    """

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Build the JSON Schema of a word, a path or a selection."""
        return {"anyOf": [{"type": "string"}, handler(EachSection.__pydantic_core_schema__)]}


class TargetSection(FramedPose):
    """Target of the tool centre point: a pose, or joint configurations of the arm."""

    xyz: Vector3 | None = Field(
        default=None, description="Translation [m]; every pose has one, [0, 0, 0] at the frame."
    )
    at: Name | None = Field(
        default=None, description="Named reference frame of the pose; same as `in`."
    )
    each: Annotated[Any, EachReference()] = Field(
        default=None,
        description="Repeats the task: `place` for every place of the frame's grid, a selection such as "
        "{x: [1, 2], layer: [1, 1]}, or the path of a CSV file with the columns x, y, z, roll, pitch, yaw, id "
        "and part. The pose is then in the frame of each place.",
    )
    free: Annotated[FreeSection, ShortForm("turn")] | None = Field(
        default=None,
        description="yaw: any rotation about the tool's z axis is allowed; or more freedom, as a mapping, alike at "
        "pick and place.",
    )
    symmetry: Symmetry | None = Field(
        default=None,
        description="Number of equivalent rotations about the tool's z axis in a full turn.",
    )
    approach: Line | None = Field(
        default=None, description="Straight approach to this target [m]; default: that of the task."
    )
    retract: Line | None = Field(
        default=None,
        description="Straight retract from this target [m]; default: that of the task.",
    )
    varies: Annotated[VariesSection, ShortForm("xy")] | None = Field(
        default=None,
        description="Deviations of the pose along and about the axes of its frame [m], as of a part in its place; "
        "`dualarm sweep --perturb` draws them, plans have the pose itself.",
    )
    joints: Annotated[list[PositionOrRow], Field(min_length=1, max_length=1000)] | None = Field(
        default=None,
        description="Joint positions [rad] of one configuration, or a list of alternatives, instead of a pose.",
    )
    posture: Name | None = Field(
        default=None,
        description="Posture of the robot whose joint positions the arm takes, instead of a pose; the platform is "
        "not part of the target. `move: home` is short for `move: {posture: home}`.",
    )

    @property
    def by_joints(self) -> Literal["joints", "posture"] | None:
        """Key that gives joint positions instead of a pose; None for a pose."""
        return "joints" if self.joints is not None else "posture" if self.posture else None

    @model_validator(mode="after")
    def _pose_or_joints(self) -> TargetSection:
        if self.by_joints is not None:
            others = ("xyz", "rpy", "quat", "in", "at", "free", "symmetry", "varies", "posture")
            for key in others if self.by_joints == "joints" else others[:-1]:
                if getattr(self, "in_" if key == "in" else key) is not None:
                    raise refuse(f"'{key}' does not go with '{self.by_joints}'; keep one", key)
        elif self.xyz is None:
            raise refuse(
                "no target; give xyz ([0, 0, 0] at the frame), with rpy or quat, joints or posture"
            )
        if self.in_ is not None and self.at is not None:
            raise refuse("'in' and 'at' both name the frame; keep one", "in")
        if self.free is not None and self.free.turn is not None and self.symmetry is not None:
            raise refuse(
                "'free: yaw' and 'symmetry' both give the allowed turns; keep one", "symmetry"
            )
        return self


class SignalsSection(Section):
    """Names of signals, such as outputs of a robot controller, by action."""

    grip: Name | None = Field(
        default=None, description="Signal of gripping: at a pick, and when a part is taken over."
    )
    release: Name | None = Field(
        default=None, description="Signal of releasing: at a place, and when a part is given."
    )
    pick: Name | None = Field(default=None, description="Signal at a pick, instead of `grip`.")
    take: Name | None = Field(
        default=None, description="Signal when a part is taken over, instead of `grip`."
    )
    place: Name | None = Field(default=None, description="Signal at a place, instead of `release`.")
    give: Name | None = Field(
        default=None, description="Signal when a part is given, instead of `release`."
    )
    move: Name | None = Field(default=None, description="Signal at the target of a bare move.")

    @model_validator(mode="after")
    def _something(self) -> SignalsSection:
        if not self.model_fields_set:
            raise refuse("no signal; give grip, release or both, or remove 'signals'")
        return self


SIGNAL_KEYS: Mapping[str, tuple[str, ...]] = {
    "pick": ("pick", "grip"),
    "take": ("take", "grip"),
    "place": ("place", "release"),
    "give": ("give", "release"),
    "move": ("move",),
}
"""Keys of signals by action; the first given one applies."""


class TaskHead(Section):
    """Keys of a task that messages list before those of other kinds."""

    id: Name = Field(description="Unique name.")
    arm: Literal["left", "right", "any"] | None = Field(
        default=None, description="Arm of the task; of a hand-over the giving one."
    )
    after: list[Name] = Field(
        default_factory=list,
        description="Tasks that must be finished before this one begins, in every mode and order.",
    )
    not_before: Duration | None = Field(
        default=None,
        description="Earliest time of the tool at the first target, after the start [s].",
    )
    not_after: Duration | None = Field(
        default=None,
        description="Latest time of the tool at the last target, after the start [s].",
    )
    pick: TargetSection | None = Field(
        default=None, description="Target at which the part is taken."
    )
    place: TargetSection | None = Field(
        default=None, description="Target at which the part is placed."
    )
    move: Annotated[TargetSection, ShortForm("posture")] | None = Field(
        default=None,
        description="Target of a move without gripping; or the name of a posture of the robot.",
    )


class TaskSection(CareSection, TaskHead):
    """A task: a pick and a place, a bare move, or work of another kind."""

    part: Name | None = Field(
        default=None, description="Kind of part carried from pick to place, as the cell names it."
    )
    grasp: Annotated[list[Name], OneOrMore(), Field(min_length=1)] | None = Field(
        default=None,
        description="Grasp of the part, or a list of grasps to choose from; default: all of the part in the cell file.",
    )
    touches: list[Name] = Field(
        default_factory=list,
        description="Tasks whose parts may touch this one's part: it lies on them or against them.",
    )
    leaves: bool | None = Field(
        default=None,
        description="Whether the part leaves the cell once it is placed, as by a chute or a person; default: "
        "that of the defaults.",
    )
    approach: Line | None = Field(
        default=None,
        description="Straight approach [m], with its direction if that is not the tool's z axis.",
    )
    retract: Line | None = Field(
        default=None,
        description="Straight retract [m], with its direction if that is not the tool's z axis.",
    )
    straight: WithinReach | None = Field(
        default=None,
        description="Straight length of approach and retract next to the target [m].",
    )
    blend: WithinReach | None = Field(
        default=None,
        description="Allowed deviation from the target of a `move` for passing it without stop [m]; "
        "default: that of the defaults.",
    )
    dwell: Dwell | None = Field(
        default=None, description="Time at each target [s]: one number or its parts."
    )
    signals: SignalsSection | None = Field(
        default=None, description="Names of signals at gripping and releasing."
    )

    @model_validator(mode="after")
    def _passes(self) -> TaskSection:
        if self.blend is None:
            return self
        if self.move is None:
            raise refuse("'blend' goes with a move, or into a path; remove it", "blend")
        for key in ("approach", "retract", "dwell"):
            given = getattr(self.move, key, None) or getattr(self, key)
            if isinstance(given, LineSection):
                given = given.distance
            if isinstance(given, DwellSection):
                given = any(part.most for part in given.parts)
            if given:
                raise refuse(
                    f"'blend' does not go with '{key}': the tool passes its target; keep one",
                    "blend",
                )
        return self


class DefaultsSection(Section):
    """Default values of picks and places."""

    approach: Line = Field(
        default=LineSection.model_construct(distance=0.0),
        description="Straight approach [m], with its direction if that is not the tool's z axis.",
    )
    retract: Line = Field(
        default=LineSection.model_construct(distance=0.0),
        description="Straight retract [m], with its direction if that is not the tool's z axis.",
    )
    dwell: Dwell = Field(
        default=DwellSection.model_construct(), description="Time at each target [s]."
    )
    part: Name | None = Field(
        default=None, description="Kind of part carried from pick to place, as the cell names it."
    )
    leaves: bool = Field(
        default=False,
        description="Whether parts leave the cell once they are placed; default: they stay where they are "
        "placed.",
    )
    signals: SignalsSection | None = Field(
        default=None, description="Names of signals of tasks without their own."
    )
    straight: WithinReach | None = Field(
        default=None,
        description="Straight length of approach and retract next to the target [m]; default and "
        "maximum: the whole line.",
    )
    blend: WithinReach | None = Field(
        default=None,
        description="Allowed deviation from targets of moves and corners of paths for passing them without stop [m]; "
        "default: stop.",
    )


class TasksFile(Section):
    """Tasks of a job: the cell, the arms and the order."""

    dualarm: Literal["tasks/1"] = Field(description="Kind and version of the file.")
    cell: Name = Field(description="Path of the cell file, relative to this file.")
    mode: Literal["paired", "free"] = Field(
        default="paired",
        description="paired: both arms start each stage together; free: the arms run asynchronously.",
    )
    order: Literal["given", "optimise"] = Field(
        default="given", description="Whether the file or the planner orders the tasks."
    )
    start: Name = Field(default="home", description="Posture at the start of the motion, or free.")
    return_: bool = Field(
        default=False, alias="return", description="Whether the motion ends where it started."
    )
    speed: SpeedFraction = Field(
        default=1.0, description="Fraction of full speed for the whole plan."
    )
    limits: LimitsSection = Field(
        default=LimitsSection.model_construct(), description="Limits for these tasks."
    )
    defaults: DefaultsSection = Field(
        default=DefaultsSection.model_construct(), description="Default values for all tasks."
    )
    budget: BudgetSection | None = Field(
        default=None, description="Limits that every plan of these tasks must meet."
    )
    timing: TimingSection | None = Field(
        default=None, description="Timing accuracy of the arms; default: exact."
    )
    sequences: list[Annotated[list[Name], Field(min_length=2)]] = Field(
        default_factory=list,
        description="Lists of tasks that one arm does in direct succession, for order: optimise.",
    )
    tasks: Annotated[list[TaskSection], Field(min_length=1)] = Field(
        description="The tasks, in order."
    )
