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
"""Roles of files in a job, by the fields of a target."""
NUMBER = quantity_schema(DIMENSIONS)
Number = Annotated[Any, WithJsonSchema(NUMBER)]
"""A number with any unit; its dimension is that of the value that it changes."""
Level = Annotated[Any, WithJsonSchema({"type": ["number", "string", "boolean"]})]
MOST_LEVELS = 10_000
"""Maximum number of values of one parameter."""


class StudyTargetSection(Section):
    """A value of one of a job's files, and how it is changed."""

    tasks: str | None = Field(default=None, description="Path to a value of the task file.")
    cell: str | None = Field(
        default=None, description="Path to a value of the cell file, such as base.xyz[2]."
    )
    robot: str | None = Field(
        default=None,
        description="Path to a value of the robot file, such as limits.torso_b1.acceleration; a pair: in both.",
    )
    robot_left: str | None = Field(
        default=None,
        alias="robot.left",
        description="Path in the robot file of the left robot of a pair.",
    )
    robot_right: str | None = Field(
        default=None,
        alias="robot.right",
        description="Path in the robot file of the right robot of a pair.",
    )
    base_left: str | None = Field(
        default=None, alias="base.left", description="Path in the base file of the left robot."
    )
    base_right: str | None = Field(
        default=None, alias="base.right", description="Path in the base file of the right robot."
    )
    apply: Literal["set", "shift", "scale"] | None = Field(
        default=None,
        description="Change of the file's value. set (default): replaced by the parameter; "
        "shift: the parameter is added; scale: multiplied by it.",
    )

    def given(self) -> list[tuple[str, str]]:
        """List the given files, each with the path into it."""
        pairs = ((role, getattr(self, field)) for field, role in ROLE_KEYS.items())
        return [(role, path) for role, path in pairs if path is not None]


class OneTargetSection(StudyTargetSection):
    """Member of a group of values that change together."""

    @model_validator(mode="after")
    def _check_one_target(self) -> OneTargetSection:
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
    """A range of numbers; without step and count it is sampled and searched continuously."""

    from_: Number = Field(alias="from", description="First value: a number, with or without unit.")
    to: Number = Field(description="Last value.")
    step: Annotated[Any, WithJsonSchema({"anyOf": [NUMBER, {"type": "null"}]})] = Field(
        default=None, description="Increment; it must reach the last value exactly."
    )
    count: Annotated[int, Field(ge=2, le=MOST_LEVELS)] | None = Field(
        default=None, description="Number of values, evenly spaced, including both ends."
    )

    @model_validator(mode="after")
    def _check_at_most_one(self) -> RangeSection:
        if self.step is not None and self.count is not None:
            raise refuse("step and count both set the number of values; keep one", "count")
        return self


class ParameterSection(StudyTargetSection):
    """A varied parameter: its place in the files and its values."""

    targets: Annotated[list[OneTargetSection], Field(min_length=1, max_length=100)] | None = Field(
        default=None, description="Several values of the files that change together."
    )
    range: RangeSection | None = Field(default=None, description="Range of numbers.")
    values: Annotated[list[Level], Field(min_length=1, max_length=MOST_LEVELS)] | None = Field(
        default=None,
        description="List of values: quantities, names, true or false.",
    )

    @model_validator(mode="after")
    def _whole(self) -> ParameterSection:
        given = self.given()
        if self.targets is not None and given:
            raise refuse(
                f"{given[0][0]} and targets both select the varied value; keep one", "targets"
            )
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
    """Sampling of ranges without step and count."""

    method: Literal["latin_hypercube", "halton"] = Field(
        default="latin_hypercube",
        description="Method. latin_hypercube: every parameter evenly spread; "
        "halton: a longer study contains the points of a shorter one.",
    )
    count: Annotated[int, Field(ge=2, le=MOST_LEVELS)] = Field(description="Number of points.")
    seed: Annotated[int, Field(ge=0, le=2**32 - 1)] = Field(
        default=0, description="Seed of the points."
    )


class SettingsSection(Section):
    """Settings of planning, as in `dualarm plan`."""

    platform: Name | None = Field(
        default=None, description="Method that chooses the platform angles."
    )
    redundancy: Name | None = Field(
        default=None, description="Redundancy solver of stops or paths."
    )
    timing: Name | None = Field(default=None, description="Timing solver.")
    effort: Literal["quick", "normal", "thorough"] | None = Field(
        default=None, description="Search effort."
    )
    seed: Annotated[int, Field(ge=0, le=2**32 - 1)] | None = Field(
        default=None, description="Random seed of planning."
    )


class StudyFile(Section):
    """A layout study: the varied parameters, their values and the objectives."""

    dualarm: Literal["study/1"] = Field(description="Kind and version of the file.")
    tasks: Annotated[list[Name], Field(min_length=1, max_length=100), OneOrMore()] = Field(
        description="Path of a task file, relative to this file, or a list of them; every layout is planned for all."
    )
    parameters: Annotated[dict[Name, ParameterSection], Field(min_length=1, max_length=50)] = Field(
        description="The parameters, by name."
    )
    objectives: Annotated[
        list[Literal["cycle_time", "gap", "clearance", "travel", "torque"]],
        Field(min_length=1, max_length=5),
    ] = Field(
        default=["cycle_time"],
        description="Most important first: cycle_time, gap, travel and torque (minimised), clearance (maximised).",
    )
    sample: SampleSection | None = Field(
        default=None, description="Sampling of ranges without step and count."
    )
    settings: SettingsSection = Field(
        default=SettingsSection.model_construct(), description="Settings of planning."
    )
