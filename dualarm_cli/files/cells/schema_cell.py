"""Schema of cell files (`dualarm: cell/1`)."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, GetJsonSchemaHandler, model_validator
from pydantic_core import core_schema

from dualarm_cli.files.cells.grids import FrameSection
from dualarm_cli.files.source import quantities
from dualarm_cli.files.source.fields import (
    BodyPair,
    Clearance,
    Density,
    FramedPose,
    LineSection,
    Mass,
    Name,
    Pose,
    Quantity,
    Scale,
    Section,
    Size,
    SmallSize,
    SpeedFraction,
    Symmetry,
    Tilt,
    ToolPose,
    ToolSpeed,
    ToolVector3,
    refuse,
)
from dualarm_cli.files.source.short_forms import ByName, ShortForm
from dualarm_cli.model.cell import TorqueRule

Line = Annotated[LineSection, ShortForm("distance")]
SHAPE_KINDS = ("box", "sphere", "cylinder", "capsule", "half_space", "mesh")
"""Kinds of solids in a file."""


class RoundSection(Section):
    """A cylinder or capsule about its z axis."""

    radius: Size = Field(description="Radius [m].")
    length: Size = Field(description="Length [m]; a capsule's between the centres of its caps.")


class SphereSection(Section):
    """A ball."""

    radius: Size = Field(description="Radius [m].")


class MeshSection(Section):
    """A triangle mesh from a file."""

    file: Name = Field(description="Path of an STL, OBJ, PLY or DAE file, relative to this file.")
    scale: Scale = Field(default=1.0, description="Factor from the file's unit to m.")


def _half_space(value: object) -> object:
    if value == {}:
        return True
    if value is not True:
        raise refuse(
            "a half_space is everything below the plane z = 0 of its own pose; allowed: "
            "`half_space: true`, with `xyz` and `rpy` for the pose of the plane"
        )
    return value


class ShapeSection(FramedPose):
    """A solid and its pose; exactly one kind of solid."""

    box: Annotated[list[Size], Field(min_length=3, max_length=3)] | None = Field(
        default=None, description="Full sides along x, y, z [m]."
    )
    sphere: Annotated[SphereSection, ShortForm("radius")] | None = Field(
        default=None, description="Radius [m], alone or as {radius: …}."
    )
    cylinder: RoundSection | None = Field(default=None, description="Cylinder about z.")
    capsule: RoundSection | None = Field(default=None, description="Capsule about z.")
    half_space: Annotated[Literal[True], BeforeValidator(_half_space)] | None = Field(
        default=None,
        description="true: everything below the plane z = 0 of its pose.",
        json_schema_extra={
            "anyOf": [{"const": True}, {"type": "object", "maxProperties": 0}, {"type": "null"}]
        },
    )
    mesh: Annotated[MeshSection, ShortForm("file")] | None = Field(
        default=None, description="Mesh file, alone or as {file: …, scale: …}."
    )

    @model_validator(mode="after")
    def _one_kind(self) -> ShapeSection:
        given = [kind for kind in SHAPE_KINDS if getattr(self, kind) is not None]
        if not given:
            raise refuse(f"no shape; give one of {', '.join(SHAPE_KINDS)}")
        if len(given) > 1:
            raise refuse(f"more than one shape: {', '.join(given)}; keep one", given[1])
        return self


class ToolShapeSection(ShapeSection):
    """Moving solid of a tool (flange frame) or of a part (TCP frame)."""

    @model_validator(mode="after")
    def _on_flange(self) -> ToolShapeSection:
        if self.in_ is not None:
            raise refuse("the shape moves with the tool, not with a frame; remove 'in'", "in")
        if self.half_space is not None:
            raise refuse(
                "a half_space is infinite and cannot move with a tool; use another shape",
                "half_space",
            )
        return self


class ObstacleSection(ShapeSection):
    """A fixed solid of the cell."""


Moments = Annotated[
    list[Annotated[float, Quantity(quantities.INERTIA)]], Field(min_length=3, max_length=6)
]


class WeighedSection(Section):
    """A body with a mass; centre and moments may follow from its solids."""

    mass: Mass | None = Field(default=None, description="Mass [kg]; default: none.")
    density: Density | None = Field(
        default=None, description="Density of its solids [kg/m³], in place of a mass."
    )
    center_of_mass: ToolVector3 | None = Field(
        default=None,
        description="Centre of mass in the frame of its solids [m]; default: that of its solids, or the tool centre "
        "point without any.",
    )
    inertia: Moments | None = Field(
        default=None,
        description="Moments of inertia about the centre of mass [kg m²]: [ixx, iyy, izz], or these with ixy, ixz "
        "and iyz; default: those of its solids.",
    )

    @model_validator(mode="after")
    def _weight(self) -> WeighedSection:
        if self.mass is not None and self.density is not None:
            raise refuse("the mass follows from the density; keep one of the two", "density")
        for key in ("center_of_mass", "inertia"):
            if getattr(self, key) is not None and not (self.mass or self.density):
                raise refuse("it needs a mass; give mass or density, too", key)
        if self.inertia is not None:
            _check_moments(self.inertia)
        return self


def _check_moments(moments: list[float]) -> None:
    """Refuse moments of inertia that no body has."""
    if len(moments) not in (3, 6):
        raise refuse(f"takes 3 or 6 numbers, not {len(moments)}", "inertia")
    xx, yy, zz, xy, xz, yz = [*moments, 0.0, 0.0, 0.0][:6]
    # Second moments of mass: no principal minor of their matrix is negative.
    a, b, c = (yy + zz - xx) / 2.0, (xx + zz - yy) / 2.0, (xx + yy - zz) / 2.0
    pairs = (a * b - xy * xy, a * c - xz * xz, b * c - yz * yz)
    determinant = a * pairs[2] - c * xy * xy - b * xz * xz - 2.0 * xy * xz * yz
    size = max(abs(moment) for moment in moments)
    slack = 1e-9 * size
    if min(a, b, c) < -slack or min(pairs) < -slack * size or determinant < -slack * size * size:
        raise refuse(
            "no body has these moments: of the principal ones none exceeds the sum of the other two",
            "inertia",
        )


class FreeSection(Section):
    """Freedom of a tool at a target, or that grips a part."""

    turn: Literal["yaw"] | None = Field(
        default=None, description="yaw: any rotation about the tool's z axis, as of a round part."
    )
    tilt: Annotated[float, Quantity(quantities.ANGLE, 0.0, math.pi / 3.0)] = Field(
        default=0.0,
        description="Largest tilt of the tool about its x or y axis [rad]: grasps with it are added.",
    )
    area: Annotated[list[SmallSize], Field(min_length=2, max_length=2)] | None = Field(
        default=None,
        description="Sides of the area along the tool's x and y axes in which it may grip [m], such as of a suction "
        "cup on a lid: grasps at its corners are added.",
    )

    @property
    def leans(self) -> bool:
        """Whether the tool may have other poses than the stated one and its turns."""
        return self.tilt > 0.0 or self.area is not None


class GraspSection(ToolPose):
    """Position of a tool on a part, with the part's symmetry about the tool's z axis."""

    free: Annotated[FreeSection, ShortForm("turn")] | None = Field(
        default=None,
        description="yaw: the part is round about the tool's z axis; or more freedom, as a mapping.",
    )
    symmetry: Symmetry | None = Field(
        default=None,
        description="Number of turns about the tool's z axis after which the part looks the same.",
    )
    approach: Line | None = Field(
        default=None,
        description="Straight approach [m], with its direction if that is not the tool's z axis; default: that of "
        "the task.",
    )
    retract: Line | None = Field(
        default=None,
        description="Straight retract [m], with its direction if that is not the tool's z axis; default: that of "
        "the task.",
    )
    width: SmallSize | None = Field(
        default=None,
        description="Distance of the tool's jaws on the part [m]; default: the part's.",
    )

    @model_validator(mode="after")
    def _one_freedom(self) -> GraspSection:
        if self.free is not None and self.free.turn is not None and self.symmetry is not None:
            raise refuse(
                "a part that is round looks the same at every turn; keep 'free'", "symmetry"
            )
        return self


class CareSection(Section):
    """Limits of an arm's motion during a task, or while it holds a part."""

    speed: SpeedFraction | None = Field(
        default=None, description="Fraction of the speed of joints: 0.5 takes twice as long."
    )
    acceleration: SpeedFraction | None = Field(
        default=None, description="Fraction of the accelerations of joints at that speed."
    )
    tool_speed: ToolSpeed | None = Field(
        default=None, description="Maximum speed of the arm's tool centre point [m/s]."
    )
    tilt: Tilt | None = Field(
        default=None,
        description="Largest angle between the vertical and the axis of the held part that was vertical at the pick "
        "[rad], on a path or seam that of the tool at its start; turns about the vertical are free.",
    )


class HoldingSection(CareSection):
    """Limits of the motion while an arm holds a part; the platform keeps them, too."""

    @model_validator(mode="after")
    def _something(self) -> HoldingSection:
        if not self.model_fields_set:
            raise refuse(
                "no limit; give speed, acceleration, tool_speed or tilt, or remove 'while_holding'"
            )
        return self


class PartSection(WeighedSection):
    """A kind of part that a tool carries."""

    shapes: Annotated[list[ToolShapeSection], Field(min_length=1)] = Field(
        description="Solids in the frame of the tool centre point; with `grasps` in the part's frame."
    )
    grasps: Annotated[dict[Name, GraspSection], ByName("grasp")] = Field(
        default_factory=dict,
        description="Poses of the tool centre point in the part's frame, by name; with them, targets of tasks "
        "with the part are poses of the part.",
    )
    symmetry: Symmetry | None = Field(
        default=None,
        description="Number of turns about the part's z axis after which it looks the same; grasps off that axis "
        "are repeated for each.",
    )
    width: SmallSize | None = Field(
        default=None,
        description="Distance of the jaws that hold it [m], in grasps that do not state their own: only arms whose "
        "tool opens that far take it.",
    )
    while_holding: HoldingSection | None = Field(
        default=None, description="Limits of the motion of an arm that holds the part."
    )

    @model_validator(mode="after")
    def _with_grasps(self) -> PartSection:
        if self.symmetry is not None and not self.grasps:
            raise refuse("it repeats grasps; name 'grasps', or remove it", "symmetry")
        return self


class ClearanceSection(Section):
    """Clearance of one pair of bodies."""

    between: BodyPair = Field(
        description="Two bodies: links, left_tool, right_tool, parts or obstacles."
    )
    clearance: Clearance = Field(description="Required distance between them [m].")


class ToolSection(WeighedSection):
    """Tool on the flange of an arm."""

    tcp: ToolPose = Field(
        default=ToolPose.model_construct(), description="Tool centre point in the flange frame."
    )
    shapes: list[ToolShapeSection] = Field(
        default_factory=list, description="Solids in the flange frame."
    )
    opening: Annotated[list[Clearance], Field(min_length=2, max_length=2)] | None = Field(
        default=None,
        description="Least and greatest distance of the tool's jaws [m]; default: any.",
    )

    @model_validator(mode="after")
    def _opens(self) -> ToolSection:
        if self.opening is not None and self.opening[0] >= self.opening[1]:
            least, most = (f"{1e3 * value:g} mm" for value in self.opening)
            raise refuse(
                f"[{least}, {most}]: give the least distance first, then the greatest", "opening"
            )
        return self


class ToolsSection(Section):
    """The tool of each arm."""

    left: ToolSection | None = Field(default=None, description="Tool of the left arm.")
    right: ToolSection | None = Field(default=None, description="Tool of the right arm.")


class LimitsSection(Section):
    """Limits of motion, in addition to those of the joints."""

    tool_speed: ToolSpeed | None = Field(
        default=None, description="Maximum speed of every tool centre point [m/s]."
    )


class BaseReference:
    """Field annotation of a pose or a path.

    It is validated by hand, because errors of a union lose their place.
    """

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Build the JSON Schema of a pose or a path."""
        return {"anyOf": [{"type": "string"}, handler(Pose.__pydantic_core_schema__)]}


class PairMemberSection(Section):
    """Robot of a pair that forms the cell."""

    robot: Name = Field(description="Bundled robot's name, or path of a robot file.")
    base: Annotated[Any, BaseReference()] = Field(
        default_factory=dict,
        description="Pose of its root link in the cell, or the path of a `dualarm: base/1` file from "
        "`dualarm calibrate --out`.",
    )


class PairSection(Section):
    """Two robots of one arm each."""

    left: PairMemberSection = Field(description="The robot that is the left arm.")
    right: PairMemberSection = Field(description="The robot that is the right arm.")


class RobotReference:
    """Field annotation of text or a pair.

    It is validated by hand, because errors of a union lose their place.
    """

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Build the JSON Schema of a name, a path or two robots."""
        return {"anyOf": [{"type": "string"}, handler(PairSection.__pydantic_core_schema__)]}


class CellFile(Section):
    """A cell: a robot with its base, tools, named frames and obstacles."""

    dualarm: Literal["cell/1"] = Field(description="Kind and version of the file.")
    robot: Annotated[Any, RobotReference()] = Field(
        description="Bundled robot's name, path of a robot file, or {left: …, right: …} for two.",
    )
    base: Pose = Field(
        default=Pose.model_construct(), description="Pose of the robot's root link in the world."
    )
    tools: Annotated[ToolsSection, ByName("tool")] = Field(
        default=ToolsSection.model_construct(), description="Tools by arm."
    )
    frames: Annotated[dict[Name, FrameSection], ByName("frame")] = Field(
        default_factory=dict, description="Named frames, in the world or in each other."
    )
    obstacles: Annotated[dict[Name, ObstacleSection], ByName("obstacle")] = Field(
        default_factory=dict, description="Fixed obstacles, by name."
    )
    clearance: Clearance = Field(
        default=0.0, description="Required distance between bodies that may not touch [m]."
    )
    clearances: list[ClearanceSection] = Field(
        default_factory=list, description="Clearances of single pairs of bodies."
    )
    allowed_contacts: list[BodyPair] = Field(
        default_factory=list,
        description="Pairs of bodies that may touch, in addition to the robot's.",
    )
    parts: dict[Name, PartSection] = Field(
        default_factory=dict, description="Kinds of parts that tools carry, by name."
    )
    limits: LimitsSection = Field(
        default=LimitsSection.model_construct(), description="Limits for the whole cell."
    )
    torque: TorqueRule = Field(
        default="limited",
        description="Joint torques, where the robot's masses and efforts are known: limited (beyond its effort a joint "
        "fails the plan), checked (measured and reported), or ignored.",
    )
