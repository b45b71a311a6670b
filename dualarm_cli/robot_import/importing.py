"""From a URDF to a folder with a robot file that `plan` can use."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from dualarm_cli.errors import Diagnostic, InputError, MissingDependencyError
from dualarm_cli.files.robots.frozen_joints import nearest_to_zero
from dualarm_cli.files.robots.meshes import link_meshes
from dualarm_cli.files.robots.packages import MeshFinder
from dualarm_cli.files.robots.robots import LoadedRobot, load_robot
from dualarm_cli.files.robots.urdf import Urdf, moving_joints, read_urdf
from dualarm_cli.files.robots.urdf_tree import parse_xml
from dualarm_cli.files.source.projects import Project
from dualarm_cli.files.source.text_source import TextSource, read_text
from dualarm_cli.robot_import.contacts import find_contacts
from dualarm_cli.robot_import.convex_parts import convex_parts
from dualarm_cli.robot_import.description import described
from dualarm_cli.robot_import.home import propose_home
from dualarm_cli.robot_import.joint_limits import ASSUMED, read_joint_limits, with_speeds
from dualarm_cli.robot_import.robot_file import RobotText, robot_text
from dualarm_cli.robot_import.srdf import Srdf, read_srdf
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
    """Links to which tools are bolted, by side."""
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
    urdf = read_urdf(_source(request.urdf))
    srdf = read_srdf(request.srdf, urdf) if request.srdf is not None else Srdf()
    limits = read_joint_limits(request.joint_limits) if request.joint_limits is not None else {}
    structure = find_structure(urdf, {**srdf.tips, **request.tips}, request.platform)
    if request.tips or srdf.tips:
        named = ", ".join(f"{side} {arm.tip}" for side, arm in structure.arms.items())
        structure = replace(structure, reasons=(f"flanges as named: {named}", *structure.reasons))
    urdf, assumed = with_speeds(urdf, structure.joints, limits)
    moving_joints(urdf, structure.joints)  # its errors are at lines of the user's file
    file = request.urdf.absolute()
    finder = MeshFinder(Project.of(file), file, request.packages, beyond=True)
    meshes = link_meshes(urdf, finder)
    parts = convex_parts(urdf, finder, request.divided)
    description = described(urdf, meshes, parts)
    name = urdf.root.name or request.urdf.stem
    zero = {"home": _near_zero(urdf, structure)}
    sliding = frozenset(n for n, j in urdf.joints.items() if j.get("type") == "prismatic")
    text = RobotText(name, f"{_file_name(name)}.urdf", structure, assumed, limits, postures=zero)
    text = replace(text, sliding=sliding)
    files = {text.urdf: description.text.encode(), **description.meshes}
    first = _loaded(files, robot_text(text))
    contacts, often = find_contacts(first.robot, srdf.contacts, request.seed)
    stated = _postures(srdf, first)
    text = replace(text, contacts=contacts, suggested=often, postures={**zero, **stated})
    if "home" not in stated:
        home = propose_home(_loaded(files, robot_text(text)).robot, request.seed)
        if home is not None:
            joint_limits = first.robot.limits
            rounded = np.clip(np.round(home, 4), joint_limits.lower, joint_limits.upper)
            values = dict(zip(first.robot.joints, rounded.tolist(), strict=True))
            text = replace(text, postures={"home": values, **stated}, proposed=True)
    content = robot_text(text)
    loaded = _loaded(files, content)
    reasons = [*structure.reasons, *description.reasons]
    if assumed:
        names = ", ".join(sorted(assumed))
        reasons.append(f"velocity limits assumed, {ASSUMED}, as the URDF has none: {names}")
    if contacts:
        reasons.append(f"links that may touch, see allowed_contacts: {len(contacts)} pairs")
    assumed_pairs = [pair for pair in often if pair.assumed]
    if assumed_pairs:
        reasons.append(
            f"links that touch in many postures, see assumed_contacts: {len(assumed_pairs)} pairs; their shapes are "
            "assumed to be wider than they. Judge them, or give them finer shapes (--convex-parts)"
        )
    for pair in often:
        if not pair.assumed:
            reasons.append(f"{' and '.join(pair.links)} {pair.why}, and are kept apart")
    if text.proposed:
        reasons.append(
            "posture home: proposed; collision-free, away from joint limits and singular postures"
        )
    elif "home" not in stated:
        reasons.append(
            "posture home: none of the postures tried is collision-free; all joints are at 0, write one"
        )
    return Imported(
        _file_name(name),
        {**files, "robot.yaml": content.encode()},
        loaded,
        tuple([*reasons, *loaded.notes]),
    )


def _source(path: Path) -> TextSource:
    """Returns the text of a URDF, expanded where it is a xacro file."""
    source = read_text(path, str(path))
    if not any(child.tag.startswith("xacro:") for child in parse_xml(source).children):
        return source
    try:
        import xacro
    except ImportError:
        raise MissingDependencyError("xacro", "xacro") from None
    try:
        text = xacro.process_file(str(path)).toxml()
    except Exception as error:  # whatever its macros raise
        message = f"xacro cannot expand it: {error}"
        raise InputError([Diagnostic(str(path), 0, 0, "E400", message)]) from None
    return TextSource(str(path), text, source.sha256)


def _near_zero(urdf: Urdf, structure: Structure) -> dict[str, float]:
    """Returns the joints that cannot be at 0, where they are nearest to it [rad or m]."""
    found = {joint: nearest_to_zero(urdf.joints[joint]) for joint in structure.joints}
    return {joint: position for joint, position in found.items() if position != 0.0}


def _file_name(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9_-]+", "_", name).strip("_").lower() or "robot"


def _loaded(files: Mapping[str, bytes], robot_file: str) -> LoadedRobot:
    """Returns the robot as `plan` reads its files."""
    with tempfile.TemporaryDirectory() as folder:
        for name, content in files.items():
            path = Path(folder) / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        path = Path(folder) / "robot.yaml"
        path.write_text(robot_file, encoding="utf-8")
        return load_robot(path)


def _postures(srdf: Srdf, loaded: LoadedRobot) -> dict[str, dict[str, float]]:
    """Returns the postures of an SRDF that have both arms' joints within their limits."""
    limits = loaded.robot.limits
    found = {}
    for name, state in srdf.states.items():
        own = {joint: state.get(joint, 0.0) for joint in limits.joints}
        values = np.array(list(own.values()))
        stated = sum(joint in state for joint in limits.joints)
        within = ((limits.lower <= values) & (values <= limits.upper)).all()
        if within and stated >= len(loaded.robot.arms[0].joints) and name != "free":
            found[name] = {joint: value for joint, value in own.items() if joint in state}
    return found
