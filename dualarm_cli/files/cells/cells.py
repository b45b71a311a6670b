"""Reader of cell files."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from pydantic import create_model

from dualarm_cli.files.calibration.points import Base, read_base
from dualarm_cli.files.cells.cell_frames import frame_pose, world_frames
from dualarm_cli.files.cells.grasps import read_grasps
from dualarm_cli.files.cells.grids import patterns_of, pose_ranges
from dualarm_cli.files.cells.schema_cell import (
    CareSection,
    CellFile,
    PairMemberSection,
    PairSection,
    ShapeSection,
    ToolSection,
    WeighedSection,
)
from dualarm_cli.files.robots.meshes import read_hull
from dualarm_cli.files.robots.notes import robot_note
from dualarm_cli.files.robots.robot_pair import compose_pair, why_not_a_pair_member
from dualarm_cli.files.robots.robots import build_robot, find_robot
from dualarm_cli.files.source.bodies import checked_pairs, link_names
from dualarm_cli.files.source.diagnostics import Findings
from dualarm_cli.files.source.documents import read_document, validate
from dualarm_cli.files.source.fields import Pose, to_se3
from dualarm_cli.files.source.projects import Project, display_name, noted
from dualarm_cli.files.source.text_source import quote
from dualarm_cli.files.source.yaml_source import Document, Loc
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinds import of_kinds
from dualarm_cli.model.cell import Cell, Obstacle, Tool
from dualarm_cli.model.part_flow import Care, Grasp, part_as_held
from dualarm_cli.model.robot import Robot
from dualarm_cli.model.shape import Shape, uniform_inertia
from dualarm_cli.notes import Note
from dualarm_cli.records import dataclass


def pair_bases(
    project: Project, path: Path, document: Document, pair: PairSection, findings: Findings
) -> dict[str, pin.SE3] | None:
    """Read the base poses of a pair, or None after noting errors.

    Args:
        project: what files must stay in.
        path: the cell file.
        document: its content.
        pair: its two robots.
        findings: where errors are noted.
    """
    sections = {"left": pair.left.base, "right": pair.right.base}
    bases: dict[str, Base] = {}
    for side, value in sections.items():
        base = _base(project, path, document, value, ("robot", side, "base"), findings)
        if base is not None and base.relative_to == side:
            message = f"the file gives this robot's base relative to itself ({side}); use it for the other robot"
            findings.add(document, ("robot", side, "base"), message)
            base = None
        if base is not None:
            bases[side] = base
    if len(bases) < 2:
        return None
    if all(base.relative_to is not None for base in bases.values()):
        message = "the base of each robot is given relative to the other; give one of them a pose in the cell"
        findings.add(document, ("robot", "right", "base"), message)
        return None
    other_side = {"left": "right", "right": "left"}
    return {
        # T_cell_side = T_cell_other T_other_side
        side: base.pose if base.relative_to is None else bases[other_side[side]].pose * base.pose
        for side, base in bases.items()
    }


def _base(
    project: Project, path: Path, document: Document, value: object, loc: Loc, findings: Findings
) -> Base | None:
    """Read one robot's base, or None after noting errors."""
    if isinstance(value, dict):
        pose = validate(document, Pose, findings, value, loc)
        return None if pose is None else Base(to_se3(pose), None)
    if not isinstance(value, str):
        message = f"must be a pose, such as {{xyz: [0, 0, 0]}}, or the path of a base file, not {quote(value)}"
        findings.add(document, loc, message, "E200")
        return None
    with noted(findings, document, loc):
        file = project.follow(value, path)
        name = display_name(value, document.source.name)
        return read_base(project, file, name, f"base.{loc[1]}")
    return None


@dataclass(frozen=True)
class LoadedCell:
    """A cell and its provenance."""

    cell: Cell
    """The cell."""
    inputs: Mapping[str, str]
    """SHA-256 of every file that was read, by its name within the project."""
    notes: tuple[Note, ...]
    """Notes on how the files were interpreted."""


@dataclass(frozen=True)
class AddedToCell:
    """Content of a cell file for one kind of work."""

    fields: Mapping[str, Any]
    """Its fields of a `Cell`, by name."""
    bodies: Sequence[tuple[Loc, str]] = ()
    """Places and names of further bodies that may collide."""


@dataclass(frozen=True)
class KindCell:
    """Extension of cell files for one kind of work."""

    keys: type[CellFile]
    """Section with the additional keys."""
    read: Callable[[CellReader, CellFile, dict[str, Tool], dict[str, pin.SE3]], AddedToCell]
    """Reader of the additional keys, which notes errors.

    It receives the tool of each arm and the frames in the world.
    """


@cache
def cell_schema(kinds: tuple[KindCell, ...]) -> type[CellFile]:
    """Build the schema of cell files with the given kinds of work."""
    bases = tuple(reversed([kind.keys for kind in kinds])) or (CellFile,)
    return create_model(CellFile.__name__, __base__=bases, __doc__=CellFile.__doc__)


def load_cell(path: str | Path) -> LoadedCell:
    """Read the cell in a cell file.

    Args:
        path: the cell file.

    Raises:
        InputError: everything wrong with it and the files that it names.
    """
    project = Project.of(Path(path))
    cell, notes = build_cell(project, Path(path), str(path))
    return LoadedCell(cell, dict(project.inputs), notes)


def build_cell(project: Project, path: Path, name: str) -> tuple[Cell, tuple[Note, ...]]:
    """Build the cell of a cell file, with notes on its interpretation.

    Args:
        project: what the file must stay in.
        path: the file.
        name: what the user calls it.

    Raises:
        InputError: everything wrong with the file and those that it names.
    """
    document = read_document(project, path, name, "cell/1")
    findings = Findings(document.diagnostics)
    kinds = tuple(of_kinds("cell_reading"))
    model = validate(document, cell_schema(kinds), findings)
    reader = CellReader(project, path, name, document, findings)
    robot = reader.robot(document.data.get("robot"))
    if model is None:
        findings.fail()
    frames = world_frames(document, dict(model.frames), findings)
    obstacles = reader.obstacles(model, frames)
    tools = reader.tools(model, robot)
    parts, part_inertias = reader.parts(model)
    grasps = {
        name: read_grasps(document, name, part, frames, findings)
        for name, part in model.parts.items()
        if part.grasps
    }
    added = [kind.read(reader, model, tools, frames) for kind in kinds]
    if robot is None:
        findings.fail()
    bodies = reader.bodies(robot, model, [body for addition in added for body in addition.bodies])
    allowed: dict[Loc, Sequence[str]] = {
        ("allowed_contacts", k): pair for k, pair in enumerate(model.allowed_contacts)
    }
    contacts = checked_pairs(document, allowed, bodies, findings, parts)
    between: dict[Loc, Sequence[str]] = {
        ("clearances", k, "between"): section.between for k, section in enumerate(model.clearances)
    }
    special = checked_pairs(document, between, bodies, findings, parts)
    findings.raise_if_any()
    cell = Cell(
        robot,
        to_se3(model.base),
        tools,
        frames,
        obstacles,
        model.clearance,
        model.limits.tool_speed,
        tuple((*pair, s.clearance) for pair, s in zip(special, model.clearances, strict=True)),
        contacts,
        parts,
        part_inertias=part_inertias,
        torque=model.torque,
        patterns=patterns_of(model.frames),
        grasps=grasps,
        widths=_widths(model, grasps),
        varying=pose_ranges(model.frames, frames),
        care={name: read_care(part.while_holding) for name, part in model.parts.items()},
        **{name: value for addition in added for name, value in addition.fields.items()},
    )
    for part, by_name in grasps.items():
        for grasp in by_name.values():
            cell = cell.with_held_part(part, grasp.name, grasp.pose)
    return cell, tuple(reader.notes)


def _widths(model: CellFile, grasps: Mapping[str, Mapping[str, Grasp]]) -> dict[str, float]:
    """List the widths of parts [m], and of parts as held by a grasp."""
    widths = {name: part.width for name, part in model.parts.items() if part.width is not None}
    for part, by_name in grasps.items():
        held = {part_as_held(part, grasp.name): grasp.width for grasp in by_name.values()}
        widths |= {name: width for name, width in held.items() if width}
    return widths


def read_care(section: CareSection | None) -> Care:
    """Read the limits of a task or of a held part."""
    given = {key: getattr(section, key, None) for key in CareSection.model_fields}
    return Care(**{key: value for key, value in given.items() if value is not None})


class CellReader:
    """Converter of one cell file to the data model; collects every error."""

    def __init__(
        self, project: Project, path: Path, name: str, document: Document, findings: Findings
    ) -> None:
        """Store the file and where its errors are noted.

        Args:
            project: what it must stay in.
            path: the file.
            name: what the user calls it.
            document: its content.
            findings: where errors are noted.
        """
        self.project, self.path, self.name = project, path, name
        self.document, self.findings = document, findings
        self.notes: list[Note] = []

    def robot(self, value: object) -> Robot | None:
        """Read the robot, or a pair as one robot; None after noting errors."""
        if isinstance(value, str):
            return self._one_robot(value, ("robot",))
        if isinstance(value, dict):
            pair = validate(self.document, PairSection, self.findings, value, ("robot",))
            return self._pair(pair) if pair is not None else None
        if value is not None:
            message = (
                f"must be a robot's name, a path, or {{left: …, right: …}}, not {quote(value)}"
            )
            self.findings.add(self.document, ("robot",), message, "E200")
        elif "robot" in self.document.data:
            self.findings.add(self.document, ("robot",), "must not be empty", "E200")
        return None

    def _one_robot(self, reference: str, loc: Loc) -> Robot | None:
        with noted(self.findings, self.document, loc):
            place = find_robot(self.project, reference, self.path, self.name)
            side = ".".join(str(step) for step in loc[:2]) if len(loc) > 1 else "robot"
            robot, notes = build_robot(replace(place, role=side))
            robot_notes = [robot_note("of_robot", robot=robot.name, note=note) for note in notes]
            self.notes += [note for note in robot_notes if note not in self.notes]
            return robot
        return None

    def _pair(self, pair: PairSection) -> Robot | None:
        left, right = self._member("left", pair.left), self._member("right", pair.right)
        bases = pair_bases(self.project, self.path, self.document, pair, self.findings)
        if left is None or right is None or bases is None:
            return None
        return compose_pair(left, bases["left"], right, bases["right"])

    def _member(self, side: str, member: PairMemberSection) -> Robot | None:
        loc: Loc = ("robot", side, "robot")
        robot = self._one_robot(member.robot, loc)
        problem = why_not_a_pair_member(robot) if robot is not None else None
        if problem is not None:
            self.findings.add(self.document, loc, problem)
            return None
        return robot

    def tools(self, model: CellFile, robot: Robot | None) -> dict[str, Tool]:
        """Read the tool of every arm.

        An arm without one has its flange as tool centre point.
        """
        sections = {"left": model.tools.left, "right": model.tools.right}
        arms = [arm.name for arm in robot.arms] if robot is not None else list(sections)
        tools = {}
        for side, section in sections.items():
            if section is None:
                continue
            if robot is not None and side not in arms:
                message = f"{robot.name} has no {side} arm; it has {', '.join(arms)}"
                self.findings.add(self.document, ("tools", side), message, key=True)
            tools[side] = self.tool(section, ("tools", side))
        return {arm: tools.get(arm, Tool(pin.SE3.Identity())) for arm in arms}

    def tool(self, section: ToolSection, loc: Loc) -> Tool:
        """Read a tool: its centre point, weight and solids."""
        tcp, shapes = to_se3(section.tcp), self._shapes(section.shapes, loc)
        tool = Tool(tcp, self._inertia(section, shapes, tcp.translation, loc), shapes)
        if section.opening is None:
            return tool
        least, most = section.opening
        return replace(tool, opening=(least, most))

    def parts(self, model: CellFile) -> tuple[dict[str, tuple[Shape, ...]], dict[str, pin.Inertia]]:
        """Read the solids and the inertia of each kind of part."""
        shapes = {
            name: self._shapes(part.shapes, ("parts", name)) for name, part in model.parts.items()
        }
        inertias = {
            name: self._inertia(part, shapes[name], np.zeros(3), ("parts", name))
            for name, part in model.parts.items()
        }
        return shapes, inertias

    def _shapes(self, sections: Sequence[ShapeSection], loc: Loc) -> tuple[Shape, ...]:
        shapes = [self.shape(s, (*loc, "shapes", k), {}) for k, s in enumerate(sections)]
        return tuple(shape for shape in shapes if shape is not None)

    def _inertia(
        self, section: WeighedSection, shapes: Sequence[Shape], point: FloatArray, loc: Loc
    ) -> pin.Inertia:
        """Read an inertia; without solids the mass is at a point (3,) [m]."""
        solid = uniform_inertia(shapes)
        if section.density is not None and solid.mass <= 0.0:
            message = "a density needs shapes that have a volume; give a mass, or shapes"
            self.findings.add(self.document, (*loc, "density"), message)
        mass = section.mass or (section.density or 0.0) * solid.mass
        if mass <= 0.0:
            return pin.Inertia.Zero()
        center, moments = point, np.zeros((3, 3))
        if solid.mass > 0.0:
            center, moments = solid.lever, solid.inertia * (mass / solid.mass)
        if section.center_of_mass is not None:
            center = np.array(section.center_of_mass)
        if section.inertia is not None:
            xx, yy, zz, xy, xz, yz = [*section.inertia, 0.0, 0.0, 0.0][:6]
            moments = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        return pin.Inertia(mass, center, moments)

    def bodies(self, robot: Robot, model: CellFile, added: Sequence[tuple[Loc, str]]) -> list[str]:
        """List the names of all bodies, with `added` ones; note duplicates."""
        fixed = [*link_names(robot), *(f"{arm.name}_tool" for arm in robot.arms)]
        named: list[tuple[Loc, str]] = [(("parts", name), name) for name in model.parts]
        named += [(("obstacles", name), name) for name in model.obstacles]
        names = {name for _, name in added}
        for loc, name in (*added, *named):
            taken = loc[0] in ("parts", "obstacles") and name in names
            if name in fixed or taken or (loc[0] == "obstacles" and name in model.parts):
                message = f"{quote(name)} is already the name of a link, tool or part"
                self.findings.add(self.document, loc, message, key=True)
        return list(dict.fromkeys([*fixed, *(name for _, name in (*added, *named))]))

    def obstacles(self, model: CellFile, frames: dict[str, pin.SE3]) -> tuple[Obstacle, ...]:
        """Read the obstacles, posed in the world."""
        shapes = {
            name: self.shape(section, ("obstacles", name), frames)
            for name, section in model.obstacles.items()
        }
        return tuple(Obstacle(name, shape) for name, shape in shapes.items() if shape is not None)

    def shape(self, section: ShapeSection, loc: Loc, frames: dict[str, pin.SE3]) -> Shape | None:
        """Read a solid in its reference frame, or None after noting errors.

        Args:
            section: the solid as the file has it.
            loc: where it stands.
            frames: those that it may name, in the world.
        """
        T_world_frame = frame_pose(self.document, (*loc, "in"), section.in_, frames, self.findings)
        if T_world_frame is None:
            return None
        pose = T_world_frame * to_se3(section)
        if section.box is not None:
            return Shape("box", tuple(section.box), pose)
        if section.sphere is not None:
            return Shape("sphere", (section.sphere.radius,), pose)
        if section.cylinder is not None:
            return Shape("cylinder", (section.cylinder.radius, section.cylinder.length), pose)
        if section.capsule is not None:
            return Shape("capsule", (section.capsule.radius, section.capsule.length), pose)
        if section.mesh is None:
            return Shape("half_space", (), pose)
        with noted(self.findings, self.document, (*loc, "mesh")):
            path = self.project.follow(section.mesh.file, self.path)
            hull = read_hull(path, section.mesh.file, np.full(3, section.mesh.scale))
            return Shape("mesh", (), pose, hull)
        return None
