"""Schema of study files (`dualarm: study/1`)."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, WithJsonSchema, model_validator

from dualarm_cli.files.source.amounts import DIMENSIONS
from dualarm_cli.files.source.fields import Name, Section, quantity_schema, refuse
from dualarm_cli.files.source.short_forms import OneOrMore

ROLE_KEYS = {
    "tasks": "tasks",
    "cell": "cell",
    "robot": "robot",
    "robot_left": "robot.left",
    "robot_right": "robot.right",
    "base_left": "base.left",
    "base_right": "base.right",
}
"""Fields of a target to what the files are to a job."""
NUMBER = quantity_schema(DIMENSIONS)
Number = Annotated[Any, WithJsonSchema(NUMBER)]
"""A number with any unit; its dimension is that of the value that it changes."""
Level = Annotated[Any, WithJsonSchema({"type": ["number", "string", "boolean"]})]
MOST_LEVELS = 10_000
"""Most values of one parameter."""


class StudyTargetSection(Section):
    """One value of one of a job's files, and how it is changed."""

    tasks: str | None = Field(default=None, description="Path to a value of the task file.")
    cell: str | None = Field(
        default=None, description="Path to a value of the cell file, such as base.xyz[2]."
    )
    robot: str | None = Field(
        default=None,
        description="Path to a value of the robot file, such as limits.torso_b1.acceleration; of two robots in both.",
    )
    robot_left: str | None = Field(
        default=None, alias="robot.left", description="Path in the file of the left one of two."
    )
    robot_right: str | None = Field(
        default=None, alias="robot.right", description="Path in the file of the right one of two."
    )
    base_left: str | None = Field(
        default=None, alias="base.left", description="Path in the base file of the left robot."
    )
    base_right: str | None = Field(
        default=None, alias="base.right", description="Path in the base file of the right robot."
    )
    apply: Literal["set", "shift", "scale"] | None = Field(
        default=None,
        description="set: the file's value becomes the parameter's (default); shift: it is moved by it; "
        "scale: it is multiplied by it.",
    )

    def given(self) -> list[tuple[str, str]]:
        """Return the files that are named, each with the path into it."""
        pairs = ((role, getattr(self, field)) for field, role in ROLE_KEYS.items())
        return [(role, path) for role, path in pairs if path is not None]


class OneTargetSection(StudyTargetSection):
    """One of several targets that move together."""

    @model_validator(mode="after")
    def _one(self) -> OneTargetSection:
        given = self.given()
        if not given:
            raise refuse(
                "no target; give cell, robot or tasks with the path of a value", code="E202"
            )
        if len(given) > 1:
            raise refuse(
                f"{given[0][0]} and {given[1][0]} are two targets; write two entries", given[1][0]
            )
        return self


class RangeSection(Section):
    """Numbers from one to another; without step and count all between, for sampling and searching."""

    from_: Number = Field(
        alias="from", description="First value; a number, with its unit if need be."
    )
    to: Number = Field(description="Last value.")
    step: Annotated[Any, WithJsonSchema({"anyOf": [NUMBER, {"type": "null"}]})] = Field(
        default=None, description="From one value to the next; must lead to the last one."
    )
    count: Annotated[int, Field(ge=2, le=MOST_LEVELS)] | None = Field(
        default=None, description="How many values, evenly spread, both ends among them."
    )

    @model_validator(mode="after")
    def _one_way(self) -> RangeSection:
        if self.step is not None and self.count is not None:
            raise refuse("step and count both say how many values; keep one", "count")
        return self


class ParameterSection(StudyTargetSection):
    """Something that is varied: where it stands in the files, and its values."""

    targets: Annotated[list[OneTargetSection], Field(min_length=1, max_length=100)] | None = Field(
        default=None, description="Several values of the files that move together."
    )
    range: RangeSection | None = Field(default=None, description="Numbers from one to another.")
    values: Annotated[list[Level], Field(min_length=1, max_length=MOST_LEVELS)] | None = Field(
        default=None,
        description="The values themselves: quantities, names, true or false.",
    )

    @model_validator(mode="after")
    def _whole(self) -> ParameterSection:
        given = self.given()
        if self.targets is not None and given:
            raise refuse(f"{given[0][0]} and targets both say what is varied; keep one", "targets")
        if self.targets is None and not given:
            raise refuse(
                "no target; give cell, robot or tasks with the path of a value", code="E202"
            )
        if len(given) > 1:
            message = f"{given[0][0]} and {given[1][0]} are two targets; write them as a list: `targets: …`"
            raise refuse(message, given[1][0])
        if self.range is None and self.values is None:
            raise refuse("no values; give range or values", code="E202")
        if self.range is not None and self.values is not None:
            raise refuse("range and values both give the values; keep one", "values")
        return self


class SampleSection(Section):
    """How ranges without step and count are sampled."""

    method: Literal["latin_hypercube", "halton"] = Field(
        default="latin_hypercube",
        description="latin_hypercube: every parameter evenly spread; halton: a longer study has the points of a "
        "shorter one.",
    )
    count: Annotated[int, Field(ge=2, le=MOST_LEVELS)] = Field(description="How many points.")
    seed: Annotated[int, Field(ge=0, le=2**32 - 1)] = Field(
        default=0, description="Seed of the points."
    )


class SettingsSection(Section):
    """Settings of planning, as `dualarm plan` has them."""

    platform: Name | None = Field(
        default=None, description="Method that chooses the platform angles."
    )
    redundancy: Name | None = Field(
        default=None, description="Redundancy solver of stops, or of paths."
    )
    timing: Name | None = Field(default=None, description="Timing solver.")
    effort: Literal["quick", "normal", "thorough"] | None = Field(
        default=None, description="How hard to try."
    )
    seed: Annotated[int, Field(ge=0, le=2**32 - 1)] | None = Field(
        default=None, description="Seed of all randomness of planning."
    )


class StudyFile(Section):
    """A layout study: what is varied over which values, and what is to become good."""

    dualarm: Literal["study/1"] = Field(description="Kind and version of the file.")
    tasks: Annotated[list[Name], Field(min_length=1, max_length=100), OneOrMore()] = Field(
        description="Path of a task file, relative to this file, or a list of them: every layout is planned for all."
    )
    parameters: Annotated[dict[Name, ParameterSection], Field(min_length=1, max_length=50)] = Field(
        description="The parameters, by name."
    )
    objectives: Annotated[
        list[Literal["cycle_time", "gap", "clearance", "travel"]],
        Field(min_length=1, max_length=4),
    ] = Field(
        default=["cycle_time"],
        description="The objectives, most important first: cycle_time, gap and travel small, clearance large.",
    )
    sample: SampleSection | None = Field(
        default=None, description="How ranges without step and count are sampled."
    )
    settings: SettingsSection = Field(
        default=SettingsSection.model_construct(), description="Settings of planning."
    )
