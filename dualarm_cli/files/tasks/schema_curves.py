"""Schema of curves in task files: lines, arcs, turns and splines."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from dualarm_cli.files.source import quantities
from dualarm_cli.files.source.fields import (
    Angle,
    FramedPose,
    Name,
    Quantity,
    Section,
    Vector3,
    refuse,
)
from dualarm_cli.files.source.quantities import Dimension

PathAcceleration = Annotated[float, Quantity(quantities.ACCELERATION, 1e-6)]
Component = Annotated[float, Quantity(Dimension("component", {"": 1.0}, 1e6))]
PATH_PIECES = ("arc", "turn", "spline")
"""Pieces of a path other than straight lines."""


class PointSection(Section):
    """A point in the world or in a named frame."""

    xyz: Vector3 = Field(description="Position [m].")
    in_: Name | None = Field(
        default=None, alias="in", description="Named reference frame; default: world."
    )


class ArcSection(Section):
    """Circular arc from the path's current end through a point."""

    via: PointSection = Field(description="A point on the arc.")
    to: FramedPose = Field(description="End pose; without rpy or quat the tool keeps its rotation.")


class TurnSection(Section):
    """Turn about a fixed axis: the tool moves on a circle about it."""

    about: Vector3 = Field(description="A point of the axis [m].")
    axis: Annotated[list[Component], Field(min_length=3, max_length=3)] = Field(
        description="Direction of the axis."
    )
    angle: Angle = Field(description="Angle of the turn, positive by the right-hand rule [rad].")
    tool: Literal["turns", "keeps"] = Field(
        default="turns",
        description="Rotation of the tool. turns: with the axis, as on a rigid part; keeps: unchanged.",
    )
    in_: Name | None = Field(
        default=None, alias="in", description="Named frame of point and axis; default: world."
    )

    @model_validator(mode="after")
    def _axis_has_length(self) -> TurnSection:
        if sum(value * value for value in self.axis) < 1e-12:
            raise refuse("an axis needs a direction; allowed: for example [0, 0, 1]", "axis")
        return self


class PieceSection(FramedPose):
    """Next piece of a path: straight line to a pose, arc, turn or spline."""

    arc: ArcSection | None = Field(default=None, description="A circular arc.")
    turn: TurnSection | None = Field(default=None, description="A turn about an axis.")
    spline: Annotated[list[FramedPose], Field(min_length=1, max_length=10_000)] | None = Field(
        default=None, description="Poses of a smooth curve from the current end of the path."
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
    """Path of one tool: pieces, or poses from a file."""

    through: Annotated[list[PieceSection], Field(min_length=1, max_length=10_000)] | None = Field(
        default=None, description="The start pose, then the pieces of the curve."
    )
    poses: Name | None = Field(
        default=None,
        description="CSV file of poses of a smooth curve: columns x, y, z [m], qx, qy, qz, qw.",
    )

    @model_validator(mode="after")
    def _check_at_most_one(self) -> CurveSection:
        if self.through is not None and self.poses is not None:
            raise refuse("'poses' does not go with 'through'; keep one", "poses")
        return self
