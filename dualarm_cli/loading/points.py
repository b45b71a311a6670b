"""Files of touched points to nouns."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dualarm_cli.errors import InputError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.loading import quantities
from dualarm_cli.loading.diagnostics import Findings
from dualarm_cli.loading.documents import read_document, validate
from dualarm_cli.loading.projects import BadReferenceError, Project
from dualarm_cli.loading.quantities import QuantityError, parse_quantity
from dualarm_cli.loading.robot_joints import POSITION_SLACK
from dualarm_cli.loading.robot_pair import why_not_a_pair_member
from dualarm_cli.loading.robots import build_robot, find_robot
from dualarm_cli.loading.schema_points import PointsFile, ReadingSection, ToucherSection
from dualarm_cli.loading.text_source import quote, suggest
from dualarm_cli.loading.yaml_source import Document, Loc
from dualarm_cli.model.robot import Robot
from dualarm_cli.model.touches import Touches, TouchSide


@dataclass(frozen=True)
class LoadedTouches:
    """Touched points, and what is known of their loading."""

    touches: Touches
    """The points."""
    inputs: Mapping[str, str]
    """SHA-256 of every file that was read, by its name within the project."""


def load_points(path: str | Path) -> LoadedTouches:
    """Returns the touched points of a file.

    Args:
        path: the file.

    Raises:
        InputError: everything wrong with it and the robot files that it names.
    """
    project = Project.of(Path(path))
    document = read_document(project, Path(path), str(path), "points/1")
    findings = Findings()
    findings.extend(document.diagnostics)
    model = validate(document, PointsFile, findings)
    if model is None:
        findings.raise_if_any()
        raise InputError(findings.diagnostics)
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
    """Turns one file into nouns, noting every error."""

    def __init__(
        self, project: Project, path: Path, document: Document, findings: Findings
    ) -> None:
        self._project, self._path = project, path
        self._document, self._findings = document, findings

    def names(self, model: PointsFile) -> tuple[str, ...]:
        """Returns the points' names, which must differ."""
        first: dict[str, int] = {}
        for k, point in enumerate(model.points):
            loc = ("points", k, "name")
            if point.name in first:
                message = f"duplicate point {quote(point.name)}, first at line {first[point.name]}"
                self._findings.add(self._document, loc, message, "E102")
            first.setdefault(point.name, self._document.place(loc)[0])
        return tuple(point.name for point in model.points)

    def origin(self, model: PointsFile, names: tuple[str, ...]) -> int:
        """Returns which of the first three points is the origin of the frame method."""
        if model.origin is None:
            return 1
        if model.origin not in names[:3]:
            known = suggest(model.origin, list(names[:3]), "the first three points are")
            message = f"{quote(model.origin)} cannot be the origin{known}"
            self._findings.add(self._document, ("origin",), message)
            return 1
        return names.index(model.origin)

    def side(self, side: str, model: PointsFile) -> TouchSide:
        """Returns what one robot says of all points."""
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
        try:
            place = find_robot(self._project, section.robot, self._path, self._document.source.name)
            robot, _ = build_robot(place)
        except BadReferenceError as error:
            self._findings.add(self._document, loc, str(error), "E500")
            return None
        except InputError as error:
            self._findings.extend(error.diagnostics)
            return None
        problem = why_not_a_pair_member(robot)
        if problem is not None:
            self._findings.add(self._document, loc, problem)
            return None
        return robot

    def _joints(self, loc: Loc, values: list[object], robot: Robot) -> FloatArray | None:
        """Returns joint readings within the limits [rad], or None after noting what is wrong."""
        names = robot.arms[0].joints
        if len(values) != len(names):
            message = f"{robot.name} has {len(names)} joints ({', '.join(names)}); found {len(values)} readings"
            self._findings.add(self._document, loc, message)
            return None
        limits = robot.limits.select(names)
        found = []
        for k, (name, value) in enumerate(zip(names, values, strict=True)):
            try:
                position = parse_quantity(value, quantities.ANGLE)
            except QuantityError as error:
                self._findings.add(self._document, (*loc, k), str(error), "E200")
                continue
            low, high = float(limits.lower[k]), float(limits.upper[k])
            if not low - POSITION_SLACK <= position <= high + POSITION_SLACK:
                span = f"{low:.6g} to {high:.6g} rad ({math.degrees(low):.6g} to {math.degrees(high):.6g} deg)"
                message = (
                    f"{quote(value)} is outside the limits of {quote(name)}: {span}; a plain number is rad, "
                    "degrees are written `30 deg`"
                )
                self._findings.add(self._document, (*loc, k), message)
            found.append(position)
        return np.array(found) if len(found) == len(names) else None
