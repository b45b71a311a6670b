"""From a URDF to a folder with a robot file that `plan` can use."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Mapping
from dataclasses import field, replace
from pathlib import Path

from dualarm_cli.errors import Diagnostic, InputError
from dualarm_cli.files.robots.frozen_joints import nearest_to_zero
from dualarm_cli.files.robots.meshes import link_meshes
from dualarm_cli.files.robots.packages import MeshFinder
from dualarm_cli.files.robots.robots import HULL_NOTE, LoadedRobot, load_robot
from dualarm_cli.files.robots.urdf import Urdf, moving_joints, read_urdf
from dualarm_cli.files.source.projects import Project
from dualarm_cli.files.source.text_source import quote
from dualarm_cli.records import dataclass
from dualarm_cli.robot_import.contacts import contact_reasons, find_contacts
from dualarm_cli.robot_import.convex_parts import convex_parts
from dualarm_cli.robot_import.description import described
from dualarm_cli.robot_import.expanded_text import program_notes, read_expanded
from dualarm_cli.robot_import.group_states import find_postures
from dualarm_cli.robot_import.joint_limits import (
    ASSUMED,
    JointLimitsFile,
    read_joint_limits,
    with_limits,
)
from dualarm_cli.robot_import.robot_file import RobotText, robot_text
from dualarm_cli.robot_import.srdf import Srdf, named_tips, read_srdf
from dualarm_cli.robot_import.structure import Structure, find_structure


@dataclass(frozen=True)
class ImportRequest:
    """What is imported, and what the user settles."""

    urdf: Path
    """The robot description."""
    srdf: Path | None = None
    """MoveIt's description of groups, postures and contacts."""
    joint_limits: Path | None = None
    """MoveIt's joint limits."""
    tips: Mapping[str, str] = field(default_factory=dict)
    """Links to which tools are bolted, by side; `none` where there is no arm."""
    platform: tuple[str, ...] | None = None
    """Joints that carry both arms; None where the tree decides."""
    packages: tuple[Path, ...] = ()
    """Folders of ROS packages."""
    seed: int = 0
    """Of the postures that are sampled."""
    divided: tuple[str, ...] = ()
    """Links whose meshes become several convex parts."""


@dataclass(frozen=True)
class Imported:
    """A robot's files, and what was decided."""

    folder: str
    """Name for their folder."""

    files: Mapping[str, bytes]
    """Content of each file by its path in the folder."""
    loaded: LoadedRobot
    """The robot as `plan` reads those files."""
    reasons: tuple[str, ...]
    """What was decided, and why; what is assumed."""


def import_robot(request: ImportRequest) -> Imported:
    """Returns a robot's files: description with hulls of its meshes, and a robot file that says why it is as it is.

    Args:
        request: what is imported.

    Raises:
        InputError: a file that cannot be used.
        UsageError: the tree leaves a choice that an option settles.
    """
    urdf = read_urdf(read_expanded(request.urdf))
    srdf = read_srdf(request.srdf, urdf) if request.srdf is not None else Srdf()
    limits = JointLimitsFile()
    if request.joint_limits is not None:
        limits = read_joint_limits(request.joint_limits, urdf)
    structure = find_structure(urdf, named_tips(srdf, request.tips), request.platform)
    urdf, assumed = with_limits(urdf, structure.joints, limits.joints)
    moving_joints(urdf, structure.joints)  # its errors are at lines of the user's file
    file = request.urdf.absolute()
    finder = MeshFinder(Project.of(file), file, request.packages, beyond=True)
    meshes = link_meshes(urdf, finder)
    description = described(
        urdf, meshes.shapes, convex_parts(urdf, finder, meshes.units, request.divided)
    )
    name = urdf.root.name or request.urdf.stem
    sliding = frozenset(n for n, j in urdf.joints.items() if j.get("type") == "prismatic")
    text = RobotText(
        name,
        f"{_file_name(name)}.urdf",
        structure,
        assumed,
        limits.joints,
        postures={"home": _near_zero(urdf, structure)},
        sliding=sliding,
    )
    files = {text.urdf: description.text.encode(), **description.meshes}
    first = _loaded(urdf, files, robot_text(text))
    contacts, often = find_contacts(first.robot, srdf.contacts, request.seed)
    text = replace(text, contacts=contacts, suggested=often)
    postures = find_postures(_loaded(urdf, files, robot_text(text)).robot, srdf, request.seed)
    text = replace(text, postures=postures.values, comments=postures.comments)
    content = robot_text(text)
    loaded = _loaded(urdf, files, content)
    reasons = [
        *program_notes(urdf.source),
        *srdf.notes,
        *structure.reasons,
        *description.reasons,
        *meshes.notes,
        *limits.reasons,
    ]
    if assumed:
        names = ", ".join(sorted(assumed))
        reasons.append(f"velocity limits assumed, {ASSUMED}, as the URDF has none: {names}")
    reasons += [*contact_reasons(contacts, often), *postures.reasons]
    # The description tells which meshes are taken as hulls, and which as parts.
    reasons += [note for note in loaded.notes if not note.startswith(HULL_NOTE)]
    return Imported(
        _file_name(name), {**files, "robot.yaml": content.encode()}, loaded, tuple(reasons)
    )


def _near_zero(urdf: Urdf, structure: Structure) -> dict[str, float]:
    """Returns the joints that cannot be at 0, where they are nearest to it [rad or m]."""
    found = {joint: nearest_to_zero(urdf.joints[joint]) for joint in structure.joints}
    return {joint: position for joint, position in found.items() if position != 0.0}


def _file_name(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9_-]+", "_", name).strip("_").lower() or "robot"


def _loaded(urdf: Urdf, files: Mapping[str, bytes], robot_file: str) -> LoadedRobot:
    """Returns the robot as `plan` reads its files.

    Raises:
        InputError: they cannot be used; told at the place of the URDF that it comes from.
    """
    with tempfile.TemporaryDirectory() as folder:
        for name, content in files.items():
            path = Path(folder) / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        path = Path(folder) / "robot.yaml"
        path.write_text(robot_file, encoding="utf-8")
        try:
            return load_robot(path)
        except InputError as error:
            raise InputError([_in_urdf(urdf, found) for found in error.diagnostics]) from None


def _in_urdf(urdf: Urdf, found: Diagnostic) -> Diagnostic:
    """Returns what is wrong with a file that is being written at the joint or link of the URDF that it is about."""
    for elements in (urdf.joints, urdf.links):
        for name, element in elements.items():
            if quote(name) in found.message:
                place = element.line, element.column
                return urdf.source.diagnostic(*place, found.code, found.message)
    return Diagnostic(urdf.source.name, 0, 0, found.code, found.message)
