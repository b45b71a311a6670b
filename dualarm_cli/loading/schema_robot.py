"""Schema of robot files (`dualarm: robot/1`)."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field
from pydantic.config import JsonDict

from dualarm_cli.loading import quantities
from dualarm_cli.loading.fields import BodyPair, Name, Section

RATE: JsonDict = {"anyOf": [{"type": "number"}, {"type": "string"}]}


class ArmSection(Section):
    """One arm of the robot."""

    joints: Annotated[list[Name], Field(min_length=1, max_length=12)] = Field(
        description="Its joints from base to flange, by their names in the URDF."
    )
    flange: Name = Field(description="Link of the URDF to which the tool is bolted.")
    kind: Literal["srs", "spherical_wrist", "general"] = Field(
        description="How its inverse kinematics is solved; checked against the URDF."
    )


class ArmsSection(Section):
    """The robot's arms: two, or one."""

    left: ArmSection | None = Field(default=None, description="The left arm.")
    right: ArmSection | None = Field(default=None, description="The right arm.")


class LimitSection(Section):
    """What a joint may do besides position and velocity, which come from the URDF."""

    acceleration: Any = Field(
        default=None,
        description=f"Largest acceleration; a number is in {quantities.ANGULAR_ACCELERATION.unit}.",
        json_schema_extra=RATE,
    )
    jerk: Any = Field(
        default=None,
        description=f"Largest jerk; a plain number is {quantities.ANGULAR_JERK.unit}; "
        "without it jerk is not limited.",
        json_schema_extra=RATE,
    )
    source: Literal["datasheet", "measured", "assumed"] = Field(
        description="Where the numbers come from; assumed ones are said so in every report."
    )


class RobotFile(Section):
    """A robot: its URDF, platform, arms, limits and named postures."""

    dualarm: Literal["robot/1"] = Field(description="Kind and version of the file.")
    name: Name = Field(description="What people call the robot.")
    urdf: Name = Field(description="Path of its URDF, relative to this file.")
    platform: Annotated[list[Name], Field(max_length=2)] = Field(
        default_factory=list,
        description="Joints that carry both arms, world side first: none, one or two.",
    )
    arms: ArmsSection = Field(description="Its arms: left, right or both.")
    limits: dict[Name, LimitSection] = Field(
        default_factory=dict, description="Acceleration and jerk of every moving joint, by name."
    )
    postures: dict[Name, dict[Name, Any]] = Field(
        default_factory=dict,
        description="Named postures: joint positions [rad, or m]; joints not named are 0.",
    )
    allowed_contacts: list[BodyPair] = Field(
        default_factory=list,
        description="Pairs of links whose shapes may touch, as the shapes are wider than the links.",
    )
