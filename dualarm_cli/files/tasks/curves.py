"""Reader of curves in task files: from pieces, or through the poses of a CSV file."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pinocchio as pin

from dualarm_cli.errors import Diagnostic, InputError
from dualarm_cli.files.cells.cell_frames import frame_pose
from dualarm_cli.files.source.diagnostics import Findings
from dualarm_cli.files.source.fields import QUATERNION_TOLERANCE, FramedPose, to_se3
from dualarm_cli.files.source.projects import Project, display_name, noted
from dualarm_cli.files.source.text_source import TextSource, quote
from dualarm_cli.files.source.yaml_source import Document, Loc
from dualarm_cli.files.tasks.schema_curves import (
    CurveSection,
    PieceSection,
    PointSection,
    TurnSection,
)
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.curves.tool_path import Line, Piece, Spline, ToolPath, Turn

SHORTEST = 1e-6
"""Minimum length of a piece of a path [m]."""
COLUMNS = ("x", "y", "z", "qx", "qy", "qz", "qw")
"""Columns of a CSV file of poses."""


def read_poses(source: TextSource) -> list[pin.SE3]:
    """Read poses from CSV columns x, y, z [m], qx, qy, qz, qw.

    Each line is a pose.

    Args:
        source: the file.

    Raises:
        InputError: everything wrong with it.
    """
    lines = source.text.splitlines()
    names = [name.strip() for name in (lines[0] if lines else "").split(",")]
    missing = [name for name in COLUMNS if name not in names]
    if missing:
        message = (
            f"the first line must name the columns {', '.join(COLUMNS)}, with commas between them; missing: "
            f"{', '.join(missing)}"
        )
        raise InputError([Diagnostic(source.name, 1, 1, "E300", message)])
    findings: list[Diagnostic] = []
    poses: list[pin.SE3] = []
    for number, line in enumerate(lines[1:], 2):
        if not line.strip():
            continue
        pose, wrong = _row(line, names)
        if pose is not None and poses and Line(poses[-1], pose).length < SHORTEST:
            pose, wrong = None, "the same pose as the one before; remove it"
        if pose is None:
            findings.append(Diagnostic(source.name, number, 1, "E300", wrong))
        else:
            poses.append(pose)
    if not findings and len(poses) < 2:
        findings.append(Diagnostic(source.name, 0, 0, "E300", "a path needs two poses or more"))
    if findings:
        raise InputError(findings)
    return poses


def _row(line: str, names: list[str]) -> tuple[pin.SE3 | None, str]:
    """Read the pose of one line, or an error message."""
    fields = line.split(",")
    if len(fields) != len(names):
        return None, f"{len(fields)} values; the first line names {len(names)} columns"
    values: dict[str, float] = {}
    for name, field in zip(names, fields, strict=True):
        if name not in COLUMNS:
            continue
        try:
            values[name] = float(field)
        except ValueError:
            return None, f"{name}: {quote(field.strip())} is not a number"
        if not math.isfinite(values[name]) or abs(values[name]) > 1e3:
            return None, f"{name}: {quote(field.strip())} is outside the range of -1000 to 1000"
    length = math.sqrt(sum(values[name] * values[name] for name in COLUMNS[3:]))
    if abs(length - 1.0) > QUATERNION_TOLERANCE:
        return None, f"a quaternion must have length 1, not {length:.6g}; divide by its length"
    x, y, z, w = (values[name] / length for name in COLUMNS[3:])
    rotation = pin.Quaternion(w, x, y, z).toRotationMatrix()
    return pin.SE3(rotation, np.array([values[name] for name in COLUMNS[:3]])), ""


class CurveReader:
    """Converter of the curves of one task file to data."""

    def __init__(
        self, project: Project, path: Path, document: Document, cell: Cell, findings: Findings
    ) -> None:
        """Store a file, its cell and the list of errors.

        Args:
            project: folder that files must not leave.
            path: the task file.
            document: its content.
            cell: provides the frames.
            findings: where errors are noted.
        """
        self._project, self._path = project, path
        self._document, self._findings = document, findings
        self._frames = dict(cell.frames)
        self._default: str | None = None

    def note(self, loc: Loc, message: str, code: str = "E300") -> None:
        """Note an error at a place of the file."""
        self._findings.add(self._document, loc, message, code)

    def frame(self, name: str | None, loc: Loc) -> pin.SE3 | None:
        """Look up a frame's pose in the world.

        No name means the world. None after noting an error.
        """
        self._default = None
        return self._frame(name, loc)

    def read(self, section: CurveSection, loc: Loc, frame: str | None = None) -> ToolPath | None:
        """Read a curve, or return None after noting errors.

        Args:
            section: the curve as the file has it.
            loc: where it stands.
            frame: the named frame of poses that name none; None for the world.
        """
        self._default = frame
        return self._curve(section, loc)

    def world_pose(self, section: FramedPose, loc: Loc) -> pin.SE3 | None:
        """Convert a pose to the world; None after noting an unknown frame."""
        frame = self.frame(section.in_, (*loc, "in"))
        return None if frame is None else frame * to_se3(section)

    def poses(self, reference: str, loc: Loc) -> list[pin.SE3] | None:
        """Read the poses of a CSV file unchanged, or None after noting an error."""
        self._default = None
        return self._file(reference, loc)

    def _curve(self, curve: CurveSection, loc: Loc) -> ToolPath | None:
        if curve.poses is not None:
            poses = self._file(curve.poses, (*loc, "poses"))
            spline = None if poses is None else self._smooth(poses, (*loc, "poses"), listed=False)
            return None if spline is None else ToolPath((spline,))
        return self._pieces(curve.through or [], (*loc, "through"))

    def _pieces(self, sections: list[PieceSection], loc: Loc) -> ToolPath | None:
        if not sections or sections[0].xyz is None:
            self.note((*loc, 0), "the first entry of a path is the pose where it starts: give xyz")
            return None
        if sections[0].rpy is None and sections[0].quat is None:
            self.note((*loc, 0), "the start of a path needs the tool's rotation; give rpy or quat")
            return None
        here = self._pose(sections[0], (*loc, 0), None)
        pieces: list[Piece] = []
        for k, section in enumerate(sections[1:], 1):
            if here is None:
                return None
            piece = self._piece(section, (*loc, k), here)
            if piece is None:
                return None
            if piece.length < SHORTEST:
                self.note((*loc, k), "the tool is already there; remove this piece")
                return None
            pieces.append(piece)
            R, p = piece.at(np.array([piece.length]))
            here = pin.SE3(R[0], p[0])
        if not pieces:
            self.note(loc, "a path needs a start and at least one more entry")
            return None
        return ToolPath(tuple(pieces))

    def _piece(self, section: PieceSection, loc: Loc, here: pin.SE3) -> Piece | None:
        if section.arc is not None:
            via = self._point(section.arc.via, (*loc, "arc", "via"))
            to = self._pose(section.arc.to, (*loc, "arc", "to"), here)
            if via is None or to is None:
                return None
            arc = Turn.through(here, via, to)
            if arc is None:
                closed = float(norm(to.translation - here.translation)) < SHORTEST
                message = (
                    "an arc cannot end where it starts; write a full circle as a turn"
                    if closed
                    else "start, via and end lie on a line; write it as a line"
                )
                self.note((*loc, "arc"), message)
            return arc
        if section.turn is not None:
            return self._turn(section.turn, (*loc, "turn"), here)
        if section.spline is not None:
            return self._spline(section.spline, (*loc, "spline"), here)
        to = self._pose(section, loc, here)
        return None if to is None else Line(here, to)

    def _turn(self, section: TurnSection, loc: Loc, here: pin.SE3) -> Piece | None:
        frame = self._frame(section.in_, (*loc, "in"))
        if frame is None:
            return None
        axis = product(frame.rotation, section.axis)
        axis /= norm(axis)
        about = frame.act(np.array(section.about))
        turned = section.angle * axis if section.tool == "turns" else np.zeros(3)
        return Turn(here, about, axis, section.angle, turned)

    def _spline(self, sections: list[FramedPose], loc: Loc, here: pin.SE3) -> Piece | None:
        poses = [here]
        for k, section in enumerate(sections):
            pose = self._pose(section, (*loc, k), poses[-1])
            if pose is None:
                return None
            if Line(poses[-1], pose).length < SHORTEST:
                self.note((*loc, k), "the same pose as the one before; remove it")
                return None
            poses.append(pose)
        return self._smooth(poses, loc, listed=True)

    def _smooth(self, poses: list[pin.SE3], loc: Loc, listed: bool) -> Spline | None:
        """Interpolate poses by a spline, or return None after noting a cusp.

        Args:
            poses: start pose and the poses after it.
            loc: where they stand.
            listed: whether all but the first are listed there, each with its own place.
        """
        spline = Spline(tuple(poses))
        back = spline.turns_back
        if back is None:
            return spline
        where = "this pose" if listed else f"its pose number {back + 1}"
        message = (
            f"the curve turns back at once near {where}, where the tool would have to stop; "
            "end the curve there and begin another piece"
        )
        self.note((*loc, max(back - 1, 0)) if listed else loc, message)
        return None

    def _pose(self, section: FramedPose, loc: Loc, before: pin.SE3 | None) -> pin.SE3 | None:
        """Read a pose in the world; without a rotation it keeps the previous one."""
        if section.xyz is None:
            self.note(loc, "no position; give xyz")
            return None
        frame = self._frame(section.in_, (*loc, "in"))
        if frame is None:
            return None
        pose = frame * to_se3(section)
        if section.rpy is None and section.quat is None and before is not None:
            pose = pin.SE3(before.rotation, pose.translation)
        return pose

    def _point(self, section: PointSection, loc: Loc) -> FloatArray | None:
        frame = self._frame(section.in_, (*loc, "in"))
        return None if frame is None else np.array(frame.act(np.array(section.xyz)))

    def _frame(self, name: str | None, loc: Loc) -> pin.SE3 | None:
        return frame_pose(self._document, loc, name or self._default, self._frames, self._findings)

    def _file(self, reference: str, loc: Loc) -> list[pin.SE3] | None:
        frame = self._frame(None, loc)
        with noted(self._findings, self._document, loc):
            path = self._project.follow(reference, self._path)
            name = display_name(reference, self._document.source.name)
            rows = read_poses(self._project.read(path, name))
            return None if frame is None else [frame * pose for pose in rows]
        return None
