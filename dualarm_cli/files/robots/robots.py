"""Reader of robot files, with a URDF or with Denavit-Hartenberg tables.

Tables are converted to the text of a URDF.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from dualarm_cli.errors import Diagnostic, InputError
from dualarm_cli.files.robots.frozen_joints import frozen_notes, frozen_positions
from dualarm_cli.files.robots.meshes import LinkMeshes, link_meshes
from dualarm_cli.files.robots.notes import robot_note
from dualarm_cli.files.robots.packages import PackageFinder
from dualarm_cli.files.robots.robot_joints import (
    check_chains,
    check_names,
    file_arms,
    joint_limits,
    joint_torques,
    model_arms,
    posture_positions,
    with_margins,
)
from dualarm_cli.files.robots.schema_robot import RobotFile, RowSection
from dualarm_cli.files.robots.urdf import Urdf, UrdfJoint, moving_joints, read_urdf
from dualarm_cli.files.robots.urdf_tree import Element
from dualarm_cli.files.robots.urdf_writer import urdf_text, write_urdf
from dualarm_cli.files.robots.visual_meshes import visual_meshes
from dualarm_cli.files.source.bodies import checked_pairs
from dualarm_cli.files.source.bundled import ROBOT_FILE, bundled_robots, robots_folder
from dualarm_cli.files.source.diagnostics import Findings
from dualarm_cli.files.source.documents import read_document, validate
from dualarm_cli.files.source.fields import to_se3
from dualarm_cli.files.source.projects import (
    BadReferenceError,
    Project,
    display_name,
    noted,
)
from dualarm_cli.files.source.text_source import TextSource, quote, suggest
from dualarm_cli.files.source.yaml_source import Document
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import arctan2, cos, sin
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.geometry.rotations import rpy_angles
from dualarm_cli.model.robot import Robot
from dualarm_cli.notes import Note
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class LoadedRobot:
    """A robot and its provenance."""

    robot: Robot
    """The robot."""
    inputs: Mapping[str, str]
    """SHA-256 of every file that was read, by its name within the project."""
    notes: tuple[Note, ...]
    """Notes on how the files were interpreted."""


@dataclass(frozen=True)
class RobotFilePlace:
    """Location of a robot file."""

    project: Project
    """Project that its references must not leave."""
    path: Path
    """The file."""
    name: str
    """Name in messages."""
    role: str = "robot"
    """Role in the cell: robot, robot.left or robot.right."""


def load_robot(name_or_path: str | Path) -> LoadedRobot:
    """Read a bundled robot, or the robot in a robot file.

    Args:
        name_or_path: a bundled robot's name, the path of a robot file, or a folder with a robot.yaml.

    Raises:
        InputError: there is no such robot, or its files are wrong; every error at once.
    """
    reference = str(name_or_path)
    path = Path(reference)
    if path.is_dir() and reference not in bundled_robots():
        path = path / ROBOT_FILE
        reference = str(path)
    try:
        if isinstance(name_or_path, Path) or _is_path(reference):
            place = RobotFilePlace(Project.of(path), path, reference)
        else:
            place = _find_bundled(Project(Path.cwd()), reference)
    except BadReferenceError as error:
        raise InputError([Diagnostic(reference, 0, 0, "E500", str(error))]) from None
    robot, notes = build_robot(place)
    return LoadedRobot(robot, dict(place.project.inputs), notes)


def find_robot(project: Project, reference: str, holder: Path, holder_name: str) -> RobotFilePlace:
    """Find the robot file that another file refers to.

    Args:
        project: the other file's project.
        reference: a bundled name, or a relative path.
        holder: the other file.
        holder_name: what the user calls it.

    Raises:
        BadReferenceError: no such robot, or a path that may not be followed.
    """
    if not _is_path(reference):
        return _find_bundled(project, reference)
    path = project.follow(reference, holder)
    return RobotFilePlace(project, path, display_name(reference, holder_name))


def _is_path(reference: str) -> bool:
    return "/" in reference or reference.endswith((".yaml", ".yml"))


def _find_bundled(project: Project, name: str) -> RobotFilePlace:
    names = bundled_robots()
    if name not in names:
        raise BadReferenceError(
            f"no bundled robot {quote(name)}{suggest(name, names, 'bundled')}; "
            "the path of a robot file ends with .yaml"
        )
    path = robots_folder() / name / ROBOT_FILE
    return RobotFilePlace(project.bundled(), path, f"robots/{name}/{ROBOT_FILE}")


def build_robot(place: RobotFilePlace) -> tuple[Robot, tuple[Note, ...]]:
    """Build the robot of a robot file, with notes on its interpretation.

    Args:
        place: the robot file.

    Raises:
        InputError: everything wrong with the file and its URDF.
    """
    document = read_document(place.project, place.path, place.name, "robot/1", place.role)
    findings = Findings(document.diagnostics)
    described = _check_description(document, findings)
    model = validate(document, RobotFile, findings)
    if model is None or not described:
        findings.fail()
    urdf, read = _load_urdf(place, document, model, findings)
    meshes = read.shapes
    if urdf is None or not check_names(document, model, urdf, findings):
        findings.fail()
    names = [*model.platform, *(joint for arm in file_arms(model).values() for joint in arm.joints)]
    joints, notes = _moving_joints(urdf, names, findings)
    check_chains(document, model, urdf, joints, findings)
    joints = with_margins(document, model, joints, findings)
    found_limits = joint_limits(document, model, joints, findings)
    frozen = frozen_positions(document, model, urdf, names, findings)
    postures = posture_positions(document, model, joints, findings)
    contacts, doubtful = (
        checked_pairs(
            document,
            {(key, k): pair for k, pair in enumerate(pairs)},
            list(urdf.links),
            findings,
        )
        for key, pairs in (
            ("allowed_contacts", model.allowed_contacts),
            ("assumed_contacts", model.assumed_contacts),
        )
    )
    findings.raise_if_any()
    if found_limits is None:
        findings.fail()
    limits, assumed = found_limits
    text = write_urdf(urdf, joints, frozen)
    robot = Robot(
        model.name,
        text,
        tuple(model.platform),
        model_arms(document, model, _checked_model(urdf, text, len(joints))),
        limits,
        postures,
        (*contacts, *doubtful),
        meshes,
        read.visuals,
    )
    stated = joint_torques(document, model, robot, findings)
    findings.raise_if_any()
    robot = replace(robot, stated_torques=stated)
    notes += [
        *_narrowed_notes(joints),
        *assumed,
        *frozen_notes(urdf, frozen),
    ]
    if doubtful:
        pairs = [f"{link_a} and {link_b}" for link_a, link_b in doubtful]
        notes.append(robot_note("assumed_contacts", pairs=pairs))
    if meshes:
        notes.append(robot_note("hulls", links=[*meshes]))
    return robot, (*notes, *read.notes)


def _moving_joints(
    urdf: Urdf, names: Sequence[str], findings: Findings
) -> tuple[list[UrdfJoint], list[Note]]:
    """Select the named joints, with notes.

    Everything wrong with the file and the joints is raised.
    """
    try:
        return moving_joints(urdf, names)
    except InputError as error:
        findings.extend(error.diagnostics)
        findings.fail()


def _slowed_notes(joints: Sequence[UrdfJoint]) -> list[Note]:
    """Compose notes on joints that controllers slow down at positions which plans use."""
    notes = []
    for slides in (False, True):
        slowed = [joint for joint in joints if joint.slowed and joint.slides == slides]
        slowed = [joint for joint in slowed if "position_margin" not in joint.narrowed]
        if slowed:
            far = max(joint.slowed for joint in slowed)
            distance = f"{1e3 * far:.3g} mm" if slides else f"{math.degrees(far):.3g} deg"
            names = [joint.name for joint in slowed]
            notes.append(robot_note("slowed", distance=distance, joints=names))
    return notes


def _narrowed_notes(joints: Sequence[UrdfJoint]) -> list[Note]:
    """Compose notes on narrowed joint positions, and on joints slowed down at their ends."""
    causes = dict.fromkeys(cause for joint in joints for cause in joint.narrowed)
    return [
        robot_note(
            "narrowed",
            cause=cause,
            joints=[joint.name for joint in joints if cause in joint.narrowed],
        )
        for cause in causes
    ] + _slowed_notes(joints)


def _check_description(document: Document, findings: Findings) -> bool:
    """Check that a robot file has either a URDF or tables; note errors."""
    given = [key for key in ("urdf", "dh") if document.data.get(key) is not None]
    if len(given) == 2:
        findings.add(
            document, ("dh",), "urdf and dh both describe the robot; keep one", "E200", key=True
        )
    if not given:
        message = "'urdf' is missing; give the path of a URDF, or DH parameters: `dh: …`"
        findings.add(document, (), message, "E202")
    return len(given) == 1


def _load_urdf(
    place: RobotFilePlace, document: Document, model: RobotFile, findings: Findings
) -> tuple[Urdf | None, LinkMeshes]:
    """Read the checked URDF and its meshes by link, or None after noting errors."""
    if model.urdf is None:
        return read_tables(document, model, findings), LinkMeshes({}, {})
    with noted(findings, document, ("urdf",)):
        path = place.project.follow(model.urdf, place.path)
        source = place.project.read(path, display_name(model.urdf, place.name))
        urdf = read_urdf(source)
        folder = Project(Path(os.path.realpath(place.path.parent)))
        finder = PackageFinder(folder, path)
        meshes = link_meshes(urdf, finder)
        return urdf, replace(meshes, visuals=visual_meshes(urdf, finder))
    return None, LinkMeshes({}, {})


def _checked_model(urdf: Urdf, text: str, count: int) -> pin.Model:
    """Build pinocchio's model of the written URDF, with one coordinate per joint.

    Raises:
        InputError: pinocchio cannot read it so.
    """
    try:
        model = pin.buildModelFromXML(text)
    except (ValueError, RuntimeError) as error:
        reason = str(error).strip().splitlines()[0]
        message = f"cannot be used: {reason}"
        raise InputError([Diagnostic(urdf.source.name, 0, 0, "E400", message)]) from None
    if (model.nq, model.nv) != (count, count):
        message = f"has {model.nq} positions and {model.nv} velocities for {count} joints"
        raise InputError([Diagnostic(urdf.source.name, 0, 0, "E400", message)])
    return model


ROOT_LINK = "base_link"
"""Name of the root link."""
Placement = tuple[FloatArray, FloatArray]
"""Translation (3,) [m] and rotation (3, 3) of a frame in the previous one."""


def read_tables(document: Document, model: RobotFile, findings: Findings) -> Urdf | None:
    """Build the URDF that a robot file's tables describe.

    Args:
        document: the robot file.
        model: its content, with tables.
        findings: where errors are noted.

    Returns:
        The URDF, or None after an error has been noted.
    """
    if model.dh is None or not _check_links(document, model, findings):
        return None
    parts = [Element("link", {"name": ROOT_LINK})]
    for side, rows in model.dh.tables().items():
        arm = getattr(model.arms, side)
        base = to_se3(getattr(model.dh.bases, side))
        frames = placements(rows, model.dh.convention)
        R, p = np.array(base.rotation), np.array(base.translation)
        frames[0] = (p + product(R, frames[0][0]), product(R, frames[0][1]))
        parts += _arm(rows, frames, arm.flange)
    try:
        return read_urdf(TextSource(document.source.name, urdf_text("robot", parts), ""))
    except (
        InputError
    ) as error:  # the generated text has no places in a file: report the table instead
        for diagnostic in error.diagnostics:
            findings.add(document, ("dh",), diagnostic.message)
        return None


def placements(rows: Sequence[RowSection], convention: str) -> list[Placement]:
    """Compute the frame of each joint in the previous one, then the flange's.

    A joint's frame turns with it, about its z axis; at position 0 it stands as the table's theta says. So a
    standard row's Tz(d) Tx(a) Rx(alpha) comes after its joint and belongs to the next frame, a modified row's
    Rx(alpha) Tx(a) before it.

    Args:
        rows: the table.
        convention: `standard` ([Denavit1955]; [Qin2024] Eq. 1) or `modified` ([Craig1989]).
    """
    zero, turns = np.zeros(3), [_turn_z(row.theta) for row in rows]
    if convention == "modified":
        frames = [
            (
                np.array([row.a, -sin(row.alpha) * row.d, cos(row.alpha) * row.d]),
                product(_turn_x(row.alpha), turn),
            )
            for row, turn in zip(rows, turns, strict=True)
        ]
        return [*frames, (zero, np.eye(3))]
    turns.append(np.eye(3))
    after = [(np.array([row.a, 0.0, row.d]), _turn_x(row.alpha)) for row in rows]
    return [
        (p, product(R, turn))
        for (p, R), turn in zip([(zero, np.eye(3)), *after], turns, strict=True)
    ]


def _check_links(document: Document, model: RobotFile, findings: Findings) -> bool:
    """Check that link names are unique, and that arms and tables match."""
    before, tables = len(findings.diagnostics), model.dh.tables() if model.dh is not None else {}
    for name in model.platform:
        message = (
            f"{quote(name)}: DH parameters describe arms only; a robot with a platform needs a URDF"
        )
        findings.add(document, ("platform", model.platform.index(name)), message)
    seen = {ROOT_LINK: "the root link"}
    for side, rows in tables.items():
        if getattr(model.arms, side) is None:
            findings.add(document, ("dh", side), f"arms has no {side} arm for it", key=True)
            continue
        for k, row in enumerate(rows):
            if row.joint in seen:
                message = f"joint {quote(row.joint)} is also {seen[row.joint]}; rename it"
                findings.add(document, ("dh", side, k, "joint"), message, "E102")
            seen[row.joint] = seen[f"{row.joint}_link"] = f"at {side} row {k + 1}"
    for side in ("left", "right"):
        arm = getattr(model.arms, side)
        if arm is not None and side not in tables:
            findings.add(document, ("arms", side), f"dh has no {side} table for it", key=True)
        elif arm is not None and arm.flange in seen:
            message = f"flange {quote(arm.flange)} is also {seen[arm.flange]}; rename it"
            findings.add(document, ("arms", side, "flange"), message)
        if arm is not None:
            seen[arm.flange] = f"the {side} flange"
    return len(findings.diagnostics) == before


def _arm(rows: Sequence[RowSection], frames: list[Placement], flange: str) -> list[Element]:
    """Build the links and joints of one arm."""
    parts, parent = [], ROOT_LINK
    for row, frame, following in zip(rows, frames, frames[1:], strict=False):
        name = f"{row.joint}_link"
        joint = _joint(row.joint, "revolute", parent, name, frame)
        limits = {"lower": row.lower, "upper": row.upper, "velocity": row.velocity}
        words = {key: repr(value) for key, value in (limits | {"effort": row.effort}).items()}
        joint.children += [Element("axis", {"xyz": "0 0 1"}), Element("limit", words)]
        link = Element("link", {"name": name})
        if row.radius is not None:
            for tag in ("visual", "collision"):
                link.children += _capsule(tag, name, row.radius, following[0])
        parts += [link, joint]
        parent = name
    last = _joint(f"{parent}_to_{flange}", "fixed", parent, flange, frames[-1])
    return [*parts, Element("link", {"name": flange}), last]


def _joint(name: str, kind: str, parent: str, child: str, frame: Placement) -> Element:
    joint = Element("joint", {"name": name, "type": kind})
    joint.children = [
        _origin(*frame),
        Element("parent", {"link": parent}),
        Element("child", {"link": child}),
    ]
    return joint


def _capsule(tag: str, link: str, radius: float, end: FloatArray) -> list[Element]:
    """Build a capsule from a link's origin to a point.

    It consists of a cylinder and two balls.
    """
    length = float(norm(end))
    ball = Element("sphere", {"radius": repr(radius)})
    if length < 1e-9:
        return [_solid(tag, f"{link}_capsule", np.zeros(3), np.eye(3), ball)]
    x, y, z = end / length
    tilt = arctan2(math.hypot(x, y), z)
    R = product(_turn_z(arctan2(y, x)), _turn_y(tilt))
    middle = Element("cylinder", {"radius": repr(radius), "length": repr(length)})
    return [
        _solid(tag, f"{link}_capsule", end / 2.0, R, middle),
        _solid(tag, f"{link}_capsule_a", np.zeros(3), np.eye(3), ball),
        _solid(tag, f"{link}_capsule_b", end, np.eye(3), ball),
    ]


def _solid(tag: str, name: str, p: FloatArray, R: FloatArray, shape: Element) -> Element:
    geometry = Element("geometry", {}, children=[shape])
    return Element(tag, {"name": name}, children=[_origin(p, R), geometry])


def _origin(p: FloatArray, R: FloatArray) -> Element:
    words = [" ".join(repr(float(v) + 0.0) for v in values) for values in (p, rpy_angles(R))]
    return Element("origin", {"xyz": words[0], "rpy": words[1]})


def _turn_x(angle: float) -> FloatArray:
    c, s = cos(angle), sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _turn_y(angle: float) -> FloatArray:
    c, s = cos(angle), sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def _turn_z(angle: float) -> FloatArray:
    c, s = cos(angle), sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
