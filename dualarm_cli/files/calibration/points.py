"""Schemas and readers of files of touched points and of calibrated base poses."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pinocchio as pin
from pydantic import Field, WithJsonSchema, model_validator

from dualarm_cli.files.robots.robot_joints import POSITION_SLACK
from dualarm_cli.files.robots.robot_pair import why_not_a_pair_member
from dualarm_cli.files.robots.robots import build_robot, find_robot
from dualarm_cli.files.source import quantities
from dualarm_cli.files.source.diagnostics import Findings
from dualarm_cli.files.source.documents import read_document, validate
from dualarm_cli.files.source.fields import (
    Name,
    Pose,
    Quantity,
    Section,
    ToolVector3,
    Vector3,
    quantity_schema,
    refuse,
    to_se3,
)
from dualarm_cli.files.source.projects import Project, noted
from dualarm_cli.files.source.quantities import LENGTH, QuantityError, parse_quantity
from dualarm_cli.files.source.text_source import quote, suggest
from dualarm_cli.files.source.yaml_source import Document, Loc
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.robot import Robot
from dualarm_cli.model.touches import Touches, TouchSide
from dualarm_cli.records import dataclass

JointReading = Annotated[Any, WithJsonSchema(quantity_schema([quantities.ANGLE], -6.29, 6.29))]
"""Read once the robot is known."""
Noise = Annotated[float, Quantity(LENGTH, 1e-9, 0.1)]


class TipSection(Section):
    """The touching tip of a tool."""

    xyz: ToolVector3 = Field(description="Tip in the flange frame [m].")


class ToucherSection(Section):
    """A robot that touches the points."""

    robot: Name = Field(description="Bundled robot's name, or path of a robot file; one arm.")
    tcp: TipSection = Field(
        default=TipSection.model_construct(xyz=[0.0, 0.0, 0.0]),
        description="Tip of its tool; default: the flange's origin.",
    )


class ReadingSection(Section):
    """Reading of one point by one robot: coordinates, joints, or both."""

    xyz: Vector3 | None = Field(
        default=None, description="Coordinates in the robot's base frame [m]."
    )
    joints: list[JointReading] | None = Field(
        default=None, description="Joint readings, base to flange [rad]; requires the robot."
    )

    @model_validator(mode="after")
    def _something(self) -> ReadingSection:
        if self.xyz is None and self.joints is None:
            raise refuse("no reading; give xyz, joints or both", code="E202")
        return self


class TouchedPointSection(Section):
    """A point that both robots have touched."""

    name: Name = Field(description="Its name.")
    left: ReadingSection = Field(description="The left robot's reading.")
    right: ReadingSection = Field(description="The right robot's reading.")


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
        description="Standard deviation of each coordinate of a touched point [m]; "
        "without it, it is estimated from the residuals.",
    )
    origin: Name | None = Field(
        default=None,
        description="Origin of the frame method, one of the first three points; default: the second.",
    )
    fit: list[Literal["tool", "base_height"]] = Field(
        default_factory=list,
        max_length=2,
        description="Robot parameters that are estimated together with the transform.",
    )
    points: list[TouchedPointSection] = Field(
        min_length=1, max_length=1000, description="The points."
    )


class BaseFile(Section):
    """Pose of a robot's base, as `dualarm calibrate --out` writes it."""

    dualarm: Literal["base/1"] = Field(description="Kind and version of the file.")
    relative_to: Literal["left", "right"] | None = Field(
        default=None,
        description="Robot of the pair whose base frame the pose refers to; default: the cell.",
    )
    base: Pose = Field(description="The root link's pose.")


@dataclass(frozen=True)
class LoadedTouches:
    """Touched points and their provenance."""

    touches: Touches
    """The points."""
    inputs: Mapping[str, str]
    """SHA-256 of every file that was read, by its name within the project."""


def load_points(path: str | Path) -> LoadedTouches:
    """Read the touched points of a file.

    Args:
        path: the file.

    Raises:
        InputError: everything wrong with it and the robot files that it names.
    """
    project = Project.of(Path(path))
    document = read_document(project, Path(path), str(path), "points/1")
    findings = Findings(document.diagnostics)
    model = validate(document, PointsFile, findings)
    if model is None:
        findings.fail()
    reader = _PointsReader(project, Path(path), document, findings)
    names = reader.names(model)
    origin = reader.origin(model, names)
    left, right = reader.side("left", model), reader.side("right", model)
    findings.raise_if_any()
    fit = tuple(dict.fromkeys(model.fit))
    return LoadedTouches(
        Touches(names, left, right, model.noise, origin, fit), dict(project.inputs)
    )


class _PointsReader:
    """Converter of one file to the data model; collects every error."""

    def __init__(
        self, project: Project, path: Path, document: Document, findings: Findings
    ) -> None:
        self._project, self._path = project, path
        self._document, self._findings = document, findings

    def names(self, model: PointsFile) -> tuple[str, ...]:
        """Read the names of the points, which must differ."""
        first: dict[str, int] = {}
        for k, point in enumerate(model.points):
            loc = ("points", k, "name")
            if point.name in first:
                message = f"duplicate point {quote(point.name)}, first at line {first[point.name]}"
                self._findings.add(self._document, loc, message, "E102")
            first.setdefault(point.name, self._document.place(loc)[0])
        return tuple(point.name for point in model.points)

    def origin(self, model: PointsFile, names: tuple[str, ...]) -> int:
        """Find the index of the frame method's origin among the first three points."""
        if model.origin is None:
            return 1
        if model.origin not in names[:3]:
            hint = suggest(model.origin, list(names[:3]), "the first three points are")
            message = f"{quote(model.origin)} cannot be the origin{hint}"
            self._findings.add(self._document, ("origin",), message)
            return 1
        return names.index(model.origin)

    def side(self, side: str, model: PointsFile) -> TouchSide:
        """Read one robot's readings of the points."""
        section: ToucherSection | None = getattr(model, side)
        robot = self._robot(side, section) if section is not None else None
        readings: list[ReadingSection] = [getattr(point, side) for point in model.points]
        xyz = np.full((len(readings), 3), math.nan)
        joints = np.full((len(readings), len(robot.joints) if robot is not None else 0), math.nan)
        for k, reading in enumerate(readings):
            if reading.xyz is not None:
                xyz[k] = reading.xyz
            loc: Loc = ("points", k, side, "joints")
            if reading.joints is not None and section is None:
                message = f"joint readings need the robot; give `{side}: {{robot: …}}` at the top"
                self._findings.add(self._document, loc, message, key=True)
            elif reading.joints is not None and robot is not None:
                values = self._joints(loc, reading.joints, robot)
                joints[k] = values if values is not None else math.nan
        tcp = np.zeros(3) if section is None else np.array(section.tcp.xyz)
        return TouchSide(robot, tcp, joints, xyz)

    def _robot(self, side: str, section: ToucherSection) -> Robot | None:
        loc: Loc = (side, "robot")
        with noted(self._findings, self._document, loc):
            place = find_robot(self._project, section.robot, self._path, self._document.source.name)
            robot, _ = build_robot(place)
            problem = why_not_a_pair_member(robot)
            if problem is None:
                return robot
            self._findings.add(self._document, loc, problem)
        return None

    def _joints(self, loc: Loc, values: list[object], robot: Robot) -> FloatArray | None:
        """Read joint readings within the limits [rad], or None after noting errors."""
        names = robot.arms[0].joints
        if len(values) != len(names):
            message = f"{robot.name} has {len(names)} joints ({', '.join(names)}); found {len(values)} readings"
            self._findings.add(self._document, loc, message)
            return None
        limits = robot.limits.select(names)
        positions = []
        for k, (name, value) in enumerate(zip(names, values, strict=True)):
            try:
                position = parse_quantity(
                    value, quantities.LENGTH if name in robot.sliding else quantities.ANGLE
                )
            except QuantityError as error:
                self._findings.add(self._document, (*loc, k), str(error), "E200")
                continue
            low, high = float(limits.lower[k]), float(limits.upper[k])
            if not low - POSITION_SLACK <= position <= high + POSITION_SLACK:
                span = _span(low, high, name in robot.sliding)
                message = f"{quote(value)} is outside the limits of {quote(name)}: {span}"
                self._findings.add(self._document, (*loc, k), message)
            positions.append(position)
        return np.array(positions) if len(positions) == len(names) else None


def _span(low: float, high: float, slides: bool) -> str:
    """Format a joint's limits [rad or m] and the units of its readings."""
    if slides:
        return (
            f"{low:.6g} to {high:.6g} m ({1e3 * low:.6g} to {1e3 * high:.6g} mm); a plain number is m, "
            "millimetres are written `30 mm`"
        )
    return (
        f"{low:.6g} to {high:.6g} rad ({math.degrees(low):.6g} to {math.degrees(high):.6g} deg); "
        "a plain number is rad, degrees are written `30 deg`"
    )


@dataclass(frozen=True)
class Base:
    """Pose of a robot's root link."""

    pose: pin.SE3
    """Pose of the root link."""
    relative_to: str | None
    """Robot of the pair whose base frame the pose refers to; None for the cell."""


def read_base(project: Project, path: Path, name: str, role: str | None = None) -> Base:
    """Read the base pose in a file.

    Args:
        project: what the file must stay in.
        path: the file.
        name: what the user calls it.
        role: what the file is to the cell: base.left or base.right.

    Raises:
        InputError: everything wrong with the file.
    """
    document = read_document(project, path, name, "base/1", role)
    findings = Findings(document.diagnostics)
    model = validate(document, BaseFile, findings)
    if model is None or findings.diagnostics:
        findings.fail()
    return Base(to_se3(model.base), model.relative_to)
