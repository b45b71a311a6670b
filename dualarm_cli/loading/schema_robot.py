"""Schema of robot files (`dualarm: robot/1`)."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator
from pydantic.config import JsonDict

from dualarm_cli.loading import quantities
from dualarm_cli.loading.fields import BodyPair, Name, Section
from dualarm_cli.loading.schema_dh import DhSection

RATE: JsonDict = {"anyOf": [{"type": "number"}, {"type": "string"}]}


class ArmSection(Section):
    """One arm of the robot."""

    joints: Annotated[list[Name], Field(min_length=1, max_length=12)] = Field(
        description="Its joints from base to flange, by their names in the URDF; with dh: by default its rows'."
    )
    flange: Name = Field(
        description="Link to which the tool is bolted; with dh: what it is called, by default `flange` "
        "of one arm, `left_flange` and `right_flange` of two."
    )
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
    """A robot: its URDF or its tables of parameters, platform, arms, limits and named postures."""

    dualarm: Literal["robot/1"] = Field(description="Kind and version of the file.")
    name: Name = Field(description="What people call the robot.")
    urdf: Name | None = Field(
        default=None, description="Path of its URDF, relative to this file; or dh instead."
    )
    dh: DhSection | None = Field(
        default=None,
        description="Tables of Denavit and Hartenberg's parameters in place of a URDF.",
    )
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

    @model_validator(mode="before")
    @classmethod
    def _names_of_tables(cls, data: Any) -> Any:
        return _with_table_names(data) if isinstance(data, dict) and "dh" in data else data


def _with_table_names(data: dict[str, Any]) -> dict[str, Any]:
    """Returns the data of a file with the joints and flanges that its tables make plain.

    Tables that are wrong are told of where they stand; here they must only not be blamed twice.
    """
    tables, arms = data["dh"], data.get("arms")
    if not isinstance(tables, dict) or not isinstance(arms, dict):
        return data
    sides = [side for side in ("left", "right") if side in tables]
    filled = dict(arms)
    for side, arm in arms.items():
        if side not in ("left", "right") or not isinstance(arm, dict):
            continue
        rows = tables.get(side)
        rows = rows if isinstance(rows, list) else []
        names = [row.get("joint") for row in rows if isinstance(row, dict)]
        joints = [name for name in names if isinstance(name, str) and name.strip()]
        flange = "flange" if len(sides) < 2 else f"{side}_flange"
        filled[side] = {"joints": joints[:12] or ["joint"], "flange": flange, **arm}
    return {**data, "arms": filled}
