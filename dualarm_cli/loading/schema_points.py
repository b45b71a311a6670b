"""Schema of files of touched points (`dualarm: points/1`) and of what comes of them (`dualarm: base/1`)."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from dualarm_cli.loading.fields import Name, Pose, Quantity, Section, Vector3, refuse
from dualarm_cli.loading.quantities import LENGTH

Noise = Annotated[float, Quantity(LENGTH, 1e-9, 0.1)]


class TipSection(Section):
    """The touching tip of a tool."""

    xyz: Vector3 = Field(description="Tip in the flange frame [m].")


class ToucherSection(Section):
    """A robot that touches."""

    robot: Name = Field(description="Bundled robot's name, or path of a robot file; one arm.")
    tcp: TipSection = Field(
        default=TipSection(xyz=[0.0, 0.0, 0.0]),
        description="Tip of its tool; default: the flange's origin.",
    )


class ReadingSection(Section):
    """What one robot says of one point: coordinates, joints, or both."""

    xyz: Vector3 | None = Field(
        default=None, description="Coordinates in the robot's base frame [m]."
    )
    joints: list[Any] | None = Field(
        default=None, description="Joint readings, base to flange [rad]; needs the robot above."
    )

    @model_validator(mode="after")
    def _something(self) -> ReadingSection:
        if self.xyz is None and self.joints is None:
            raise refuse("no reading; give xyz, joints or both", code="E202")
        return self


class PointSection(Section):
    """A point that both robots have touched."""

    name: Name = Field(description="What it is called.")
    left: ReadingSection = Field(description="What the left robot says of it.")
    right: ReadingSection = Field(description="What the right robot says of it.")


class PointsFile(Section):
    """Points that two robots have touched, for `dualarm calibrate`."""

    dualarm: Literal["points/1"] = Field(description="Kind and version of the file.")
    left: ToucherSection | None = Field(
        default=None, description="The left robot; needed for joint readings."
    )
    right: ToucherSection | None = Field(
        default=None, description="The right robot; needed for joint readings."
    )
    noise: Noise | None = Field(
        default=None,
        description="Standard deviation of each coordinate of a touched point [m]; without it the residuals tell.",
    )
    origin: Name | None = Field(
        default=None,
        description="Which of the first three points is the origin of the frame method; the second by default.",
    )
    fit: list[Literal["tool", "base_height"]] = Field(
        default_factory=list,
        max_length=2,
        description="What is unknown of the robots and found along with the transform.",
    )
    points: list[PointSection] = Field(min_length=1, max_length=1000, description="The points.")


class BaseFile(Section):
    """Where a robot's base stands, as `dualarm calibrate --out` writes it."""

    dualarm: Literal["base/1"] = Field(description="Kind and version of the file.")
    relative_to: Literal["left", "right"] | None = Field(
        default=None,
        description="The robot of the pair in whose base frame the pose is given; without it: in the cell.",
    )
    base: Pose = Field(description="The root link's pose.")
