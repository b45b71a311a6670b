"""Schema of paths in task files: what one tool or both follow, how fast, and how."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from dualarm_cli.files.source import quantities
from dualarm_cli.files.source.fields import (
    Angle,
    Distance,
    FramedPose,
    Length,
    Name,
    Quantity,
    Section,
    Size,
    ToolSpeed,
    Vector3,
    refuse,
)
from dualarm_cli.files.source.quantities import Dimension

PathAcceleration = Annotated[float, Quantity(quantities.ACCELERATION, 1e-6)]
PathJerk = Annotated[float, Quantity(quantities.JERK, 1e-6)]
Component = Annotated[float, Quantity(Dimension("component", {"": 1.0}, 1e6))]
Stiffness = Annotated[float, Quantity(Dimension("stiffness", {"": 1.0}, 1e3), 0.0)]
PATH_PIECES = ("arc", "turn", "spline")
"""Pieces of a path besides straight lines to a pose."""


class PointSection(Section):
    """A point in the world or in a named frame."""

    xyz: Vector3 = Field(description="Where it is [m].")
    in_: Name | None = Field(
        default=None, alias="in", description="Named frame that it is given in; default world."
    )


class ArcSection(Section):
    """A circular arc from where the path is by a point to a pose."""

    via: PointSection = Field(description="A point on the arc.")
    to: FramedPose = Field(
        description="Where it ends; without rpy or quat the tool keeps its rotation."
    )


class TurnSection(Section):
    """A turn about a fixed axis: a circle of the tool about it."""

    about: Vector3 = Field(description="A point of the axis [m].")
    axis: Annotated[list[Component], Field(min_length=3, max_length=3)] = Field(
        description="Direction of the axis."
    )
    angle: Angle = Field(description="By how much it turns, positive by the right hand [rad].")
    tool: Literal["turns", "keeps"] = Field(
        default="turns",
        description="turns: the tool turns with it, as on a rigid part; keeps: it keeps its rotation.",
    )
    in_: Name | None = Field(
        default=None, alias="in", description="Named frame of point and axis; default world."
    )

    @model_validator(mode="after")
    def _axis_has_length(self) -> TurnSection:
        if sum(value**2 for value in self.axis) < 1e-12:
            raise refuse("an axis needs a direction; allowed: for example [0, 0, 1]", "axis")
        return self


class PieceSection(FramedPose):
    """The next piece of a path: a pose to go straight to, or an arc, a turn, or a spline."""

    arc: ArcSection | None = Field(default=None, description="A circular arc.")
    turn: TurnSection | None = Field(default=None, description="A turn about an axis.")
    spline: Annotated[list[FramedPose], Field(min_length=1, max_length=10_000)] | None = Field(
        default=None, description="Poses that a smooth curve goes through, from where the path is."
    )

    @model_validator(mode="after")
    def _one_kind(self) -> PieceSection:
        given = [kind for kind in PATH_PIECES if getattr(self, kind) is not None]
        if len(given) > 1:
            raise refuse(f"'{given[1]}' does not go with '{given[0]}'; make two pieces", given[1])
        if given:
            for key in ("xyz", "rpy", "quat", "in_"):
                if getattr(self, key) is not None:
                    name = key.rstrip("_")
                    raise refuse(f"'{name}' does not go with '{given[0]}'", name)
        elif self.xyz is None:
            raise refuse(f"no pose; give xyz, with rpy or quat, or one of {', '.join(PATH_PIECES)}")
        return self


class CurveSection(Section):
    """The path of one tool: pieces, or poses from a file."""

    through: Annotated[list[PieceSection], Field(min_length=1, max_length=10_000)] | None = Field(
        default=None, description="Where it starts, then piece by piece."
    )
    poses: Name | None = Field(
        default=None,
        description="CSV file of poses that a smooth curve goes through: columns x, y, z [m], qx, qy, qz, qw.",
    )

    @model_validator(mode="after")
    def _one_way(self) -> CurveSection:
        if self.through is not None and self.poses is not None:
            raise refuse("'poses' does not go with 'through'; keep one", "poses")
        return self


class CriticalPoint(Section):
    """Where a virtual spring pulls an elbow, carried by the platform or waist: a point, or a place on a circle."""

    xyz: Vector3 | None = Field(default=None, description="The point [m].")
    radius: Distance | None = Field(default=None, description="Radius of the circle [m].")
    height: Length | None = Field(
        default=None, description="Height of the circle above the last platform joint [m]."
    )
    angle: Angle | None = Field(
        default=None, description="Where on the circle, from x towards y [rad]."
    )

    @model_validator(mode="after")
    def _one_way(self) -> CriticalPoint:
        circle = [getattr(self, key) for key in ("radius", "height", "angle")]
        if self.xyz is not None and any(value is not None for value in circle):
            raise refuse("a critical point is given by xyz, or by radius, height and angle", "xyz")
        if self.xyz is None and any(value is None for value in circle):
            raise refuse("a critical point needs xyz, or radius, height and angle")
        return self


class CriticalPoints(Section):
    """The critical point of each arm."""

    left: CriticalPoint | None = Field(default=None, description="Of the left elbow.")
    right: CriticalPoint | None = Field(default=None, description="Of the right elbow.")


class PathSection(CurveSection):
    """What one tool or both follow, how fast, and which method finds the joints."""

    arm: Literal["left", "right"] | None = Field(default=None, description="The arm that follows.")
    left: CurveSection | None = Field(
        default=None, description="Path of the left tool, where both follow together."
    )
    right: CurveSection | None = Field(
        default=None, description="Path of the right tool, where both follow together."
    )
    in_: Name | None = Field(
        default=None, alias="in", description="Named frame of all poses that name none."
    )
    speed: ToolSpeed = Field(
        description="Speed of the tool with the longer path [m/s]; a turn by 1 rad counts as 0.1 m at least. "
        "The tool stops at corners."
    )
    acceleration: PathAcceleration | None = Field(
        default=None, description="Acceleration along the path [m/s²]; default: speed / 0.2 s."
    )
    jerk: PathJerk | None = Field(
        default=None, description="Jerk along the path [m/s³]; default: reached in 0.1 s."
    )
    slower: Literal["allowed", "forbidden"] = Field(
        default="forbidden",
        description="Whether it may be followed slower where the joints' limits ask for it.",
    )
    tolerance: Size = Field(default=1e-4, description="How far the tools may leave the path [m].")
    redundancy: Name | None = Field(default=None, description="Method that finds the joints.")
    posture: Name | None = Field(
        default=None,
        description="Posture near which the path begins; default: the planner's choice.",
    )
    critical_points: CriticalPoints = Field(
        default=CriticalPoints(), description="Where virtual springs pull the elbows."
    )
    stiffness: Stiffness = Field(default=10.0, description="Of the virtual springs.")
    torque: Literal["limited", "ignored"] = Field(
        default="ignored", description="Whether torques are kept within the URDF's limits."
    )

    @property
    def both(self) -> bool:
        """Whether both tools follow."""
        return self.left is not None or self.right is not None

    @model_validator(mode="after")
    def _one_or_both(self) -> PathSection:
        own = self.through is not None or self.poses is not None
        if self.both:
            for key in ("left", "right"):
                curve = getattr(self, key)
                if curve is None:
                    raise refuse(
                        f"'{key}' is missing: where both follow, both need a path", code="E202"
                    )
                if curve.through is None and curve.poses is None:
                    raise refuse("no path; give 'through' or 'poses'", key)
            for key in ("through", "poses", "arm"):
                if getattr(self, key) is not None:
                    raise refuse(f"'{key}' does not go with 'left' and 'right'", key)
        elif not own:
            raise refuse("no path; give 'through' or 'poses', or 'left' and 'right' for both arms")
        return self
