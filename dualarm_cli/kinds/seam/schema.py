"""Schema of coordinate tasks: one arm's tool along a curve on the other's part."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field, model_validator

from dualarm_cli.files.source import quantities
from dualarm_cli.files.source.fields import (
    Angle,
    Clearance,
    Duration,
    FramedPose,
    Length,
    Name,
    Pose,
    Quantity,
    Section,
    StraightLine,
    ToolSpeed,
    Vector3,
    WithinReach,
    refuse,
)
from dualarm_cli.files.source.short_forms import ShortForm
from dualarm_cli.files.tasks.schema_curves import Component, CurveSection, PathAcceleration
from dualarm_cli.files.tasks.schema_tasks import TaskHead

Tilt = Annotated[float, Quantity(quantities.ANGLE, 0.0, 1.0)]
Downhand = Annotated[float, Quantity(quantities.ANGLE, 0.01, 3.1)]
WorkDuration = Annotated[float, Quantity(quantities.TIME, 1e-3)]
Direction = Annotated[list[Component], Field(min_length=3, max_length=3)]

CurveKind = Literal["saddle", "arc", "ellipse", "line", "spline", "poses"]
NEEDS: Mapping[str, tuple[str, ...]] = {
    "saddle": ("main_radius", "branch_radius"),
    "arc": ("radius",),
    "ellipse": ("semi_axes",),
    "line": ("start", "end"),
    "spline": ("points",),
    "poses": ("file",),
}
"""Required keys of each kind of curve."""
TAKES: Mapping[str, tuple[str, ...]] = {
    "saddle": ("angle", "eccentricity", "begin", "finish"),
    "arc": ("main_radius", "angle", "eccentricity", "begin", "finish", "side"),
    "ellipse": ("begin", "finish", "side"),
    "line": ("normal",),
    "spline": ("normal", "normals", "closed"),
    "poses": (),
}
"""Optional keys of each kind of curve."""


class FeatureSection(Pose):
    """Curve on the part.

    Its own pose places it in the part's frame.
    """

    kind: CurveKind = Field(description="What it is.")
    main_radius: WithinReach | None = Field(
        default=None,
        description="Radius of the main pipe (saddle), or of the sphere that the arc lies on [m].",
    )
    branch_radius: WithinReach | None = Field(
        default=None, description="Radius of the branch pipe of a saddle [m]."
    )
    radius: WithinReach | None = Field(default=None, description="Radius of an arc [m].")
    angle: Angle | None = Field(
        default=None, description="Between the pipes' axes; default 90 deg (saddle), 0 (arc) [rad]."
    )
    eccentricity: Length | None = Field(
        default=None, description="Distance between the pipes' axes [m]; default 0."
    )
    semi_axes: Annotated[list[WithinReach], Field(min_length=2, max_length=2)] | None = Field(
        default=None, description="Semi-axes of an ellipse in the plane z = 0, along x and y [m]."
    )
    begin: Angle | None = Field(
        default=None, description="Angle where a saddle, arc or ellipse begins [rad]; default 0."
    )
    finish: Angle | None = Field(
        default=None,
        description="Angle where it ends; default a full turn; below 'begin' the curve runs backwards [rad].",
    )
    side: Literal["above", "outside"] | None = Field(
        default=None,
        description="Side of a flat arc or ellipse from which the tool comes: along z, or from outside in its plane.",
    )
    start: Vector3 | None = Field(default=None, description="Where a line begins [m].")
    end: Vector3 | None = Field(default=None, description="Where a line ends [m].")
    points: Annotated[list[Vector3], Field(min_length=2, max_length=10_000)] | None = Field(
        default=None, description="Points that a spline goes through [m]."
    )
    normal: Direction | None = Field(
        default=None,
        description="Surface normal, outwards: of a line (default z), or at the "
        "start of a spline, carried along without twist.",
    )
    normals: Annotated[list[Direction], Field(min_length=2, max_length=10_000)] | None = Field(
        default=None, description="Surface normal, outwards, at every point of a spline."
    )
    closed: bool | None = Field(
        default=None, description="Whether a spline ends where it begins, smoothly."
    )
    file: Name | None = Field(
        default=None,
        description="CSV of poses of the curve's frame (x along it, z out of the surface): x, y, z, qx, qy, qz, qw.",
    )

    @model_validator(mode="after")
    def _keys_of_its_kind(self) -> FeatureSection:
        for key in NEEDS[self.kind]:
            if getattr(self, key) is None:
                raise refuse(f"kind: {self.kind} needs '{key}'", code="E202")
        allowed = {*NEEDS[self.kind], *TAKES[self.kind]}
        for key in {key for keys in (*NEEDS.values(), *TAKES.values()) for key in keys} - allowed:
            if getattr(self, key) is not None:
                keys_of_kind = ", ".join(sorted(allowed))
                raise refuse(
                    f"'{key}' does not go with kind: {self.kind}; it has {keys_of_kind}", key
                )
        if self.normals is not None and self.normal is not None:
            raise refuse("'normal' does not go with 'normals'; keep one", "normal")
        if self.normals is not None and len(self.normals) != len(self.points or []):
            raise refuse("'normals' needs one entry for each of 'points'", "normals")
        return self


class SeamToolSection(Section):
    """Pose and freedoms of the tool on the curve."""

    standoff: Clearance = Field(
        default=0.0, description="Distance of the tool centre point from the curve [m]."
    )
    work_angle: Angle = Field(
        default=0.0, description="Work angle: turn of the tool about the curve's tangent [rad]."
    )
    travel_angle: Angle = Field(
        default=0.0,
        description="Travel angle: then turn about the curve frame's y axis, forwards or back [rad].",
    )
    spin: Angle | None = Field(
        default=None,
        description="Turn about the tool's own axis [rad]; default 0: its x axis is along the curve.",
    )
    free: Literal["spin", "none"] = Field(
        default="none",
        description="spin: the tool may turn about its own axis; none: its x axis is along the curve.",
    )
    tilt: Tilt = Field(
        default=0.0, description="Largest tilt of the tool axis from its nominal direction [rad]."
    )

    @model_validator(mode="after")
    def _one_spin(self) -> SeamToolSection:
        if self.spin is not None and self.free == "spin":
            raise refuse("'spin' does not go with free: spin; keep one", "spin")
        return self


class HoldSection(FramedPose):
    """Pose or motion of the part during the work."""

    mode: Literal["free", "still"] | None = Field(
        default=None,
        description="free: the planner moves the part as well; still: the planner finds one fixed pose.",
    )
    way: CurveSection | None = Field(
        default=None,
        description="Curve of the part's frame, followed in proportion to the tool's progress.",
    )

    @model_validator(mode="after")
    def _check_exactly_one(self) -> HoldSection:
        given = [key for key in ("mode", "xyz", "way") if getattr(self, key) is not None]
        if not given:
            raise refuse("give free, still, a pose (xyz, rpy) or a curve (way)")
        if len(given) > 1:
            raise refuse(f"'{given[1]}' does not go with '{given[0]}'; keep one", given[1])
        if self.way is not None and self.way.through is None and self.way.poses is None:
            raise refuse("no curve; give through or poses", "way")
        if self.xyz is None and self.in_ is not None:
            raise refuse("'in' goes with a pose; the poses of a curve have their own", "in")
        if self.xyz is None and (self.rpy is not None or self.quat is not None):
            raise refuse("a pose needs xyz", "rpy" if self.rpy is not None else "quat")
        return self


Hold = Annotated[HoldSection, ShortForm("mode")]


class EntrySection(Section):
    """Motion of the tool to the curve."""

    approach: StraightLine = Field(
        default=0.0, description="Straight line along the tool's axis [m]."
    )
    dwell: Duration = Field(default=0.0, description="Dwell at the start of the curve [s].")
    duration: WorkDuration | None = Field(
        default=None,
        description="Time from the previous motion to the start of the curve, "
        "approach and dwell included; default: the "
        "shortest [s].",
    )


class ExitSection(Section):
    """Motion of the tool from the curve."""

    dwell: Duration = Field(default=0.0, description="Dwell at the end of the curve [s].")
    retract: StraightLine = Field(
        default=0.0, description="Straight line along the tool's axis [m]."
    )


class CoordinateSection(Section):
    """Work along a curve on a part that the other arm holds."""

    master: Literal["left", "right"] | None = Field(
        default=None,
        description="The arm that holds the part; without one the part stands in the cell.",
    )
    slave: Literal["left", "right"] = Field(description="The arm whose tool works.")
    curve: FeatureSection = Field(description="The curve, in the part's frame.")
    part: FramedPose = Field(
        description="The part's frame in the master's flange; without a master in the world or a named frame."
    )
    tool: SeamToolSection = Field(
        default=SeamToolSection.model_construct(),
        description="Stand-off, angles and freedoms of the tool.",
    )
    hold: Hold = Field(
        default=HoldSection.model_construct(mode="free"),
        description="Where the part is: free (default), still, a pose in the world, or a curve that its frame follows.",
    )
    speed: ToolSpeed | None = Field(
        default=None, description="Speed of the tool along the curve, relative to the part [m/s]."
    )
    duration: WorkDuration | None = Field(
        default=None, description="Time for the curve, ramps included, instead of a speed [s]."
    )
    acceleration: PathAcceleration | None = Field(
        default=None,
        description="Largest acceleration along the curve [m/s²]; default: as the joints allow.",
    )
    slower: Literal["allowed", "forbidden"] = Field(
        default="forbidden",
        description="Whether the speed may be reduced where the joints' limits need it.",
    )
    downhand: Downhand | None = Field(
        default=None,
        description="Largest angle between the surface normal under the tool and the upward vertical [rad].",
    )
    entry: EntrySection = Field(
        default=EntrySection.model_construct(), description="Approach of the tool."
    )
    exit: ExitSection = Field(
        default=ExitSection.model_construct(), description="Retract of the tool."
    )
    not_before: Duration = Field(
        default=0.0, description="When the curve begins at the earliest, from the plan's start [s]."
    )
    touches: list[Name] | None = Field(
        default=None,
        description="Bodies (tools or obstacles) that the tool may touch, but "
        "not penetrate, while it works; default the "
        "master's tool.",
    )
    posture: Name | None = Field(
        default=None, description="Posture near which it begins; default: the planner's choice."
    )
    method: Name | None = Field(
        default=None, description="Seam solver; `dualarm solvers` lists them."
    )

    @model_validator(mode="after")
    def _consistent(self) -> CoordinateSection:
        if self.master == self.slave:
            raise refuse(
                "master and slave are the same arm; without a master leave the key out", "slave"
            )
        if (self.speed is None) == (self.duration is None):
            raise refuse(
                "give 'speed' or 'duration', one of them", "duration" if self.speed else ""
            )
        if self.master is not None and self.part.in_ is not None:
            raise refuse("'in' does not go with a master: the part is in its flange", "part")
        if self.master is None and (self.hold.mode != "free"):
            raise refuse("'hold' needs a master; without one 'part' says where the part is", "hold")
        if self.master is None and self.downhand is not None:
            raise refuse("'downhand' needs a master that can turn the part", "downhand")
        return self


class SeamTask(TaskHead):
    """Task that both arms may work on one part."""

    coordinate: CoordinateSection | None = Field(
        default=None,
        description="Both arms on one part: one holds it, the other works along a curve.",
    )
