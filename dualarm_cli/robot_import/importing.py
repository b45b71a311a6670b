"""Import of a URDF into a folder with a usable robot file.

`plan` can use it.

The written URDF has the robot's tree and hulls of its meshes, and nothing that only other tools read. The written robot
file has the results of the import, with their reasons in comments.
"""

from __future__ import annotations

import json
import math
import re
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from decimal import Decimal
from pathlib import Path

from dualarm_cli.errors import Diagnostic, InputError
from dualarm_cli.files.robots.frozen_joints import nearest_to_zero
from dualarm_cli.files.robots.mesh_formats import stl_bytes
from dualarm_cli.files.robots.meshes import link_meshes
from dualarm_cli.files.robots.packages import PackageFinder
from dualarm_cli.files.robots.robots import LoadedRobot, load_robot
from dualarm_cli.files.robots.schema_robot import JERK_RULE
from dualarm_cli.files.robots.urdf import Urdf, mesh_elements, moving_joints, read_urdf
from dualarm_cli.files.robots.urdf_tree import Element
from dualarm_cli.files.robots.urdf_writer import origin_words, urdf_text
from dualarm_cli.files.robots.visual_meshes import drawn_meshes, stl_copies, visual_meshes
from dualarm_cli.files.source.projects import Project
from dualarm_cli.files.source.text_source import quote
from dualarm_cli.model.shape import Hull, Shape, VisualMesh
from dualarm_cli.notes import Note, NoteTable
from dualarm_cli.records import dataclass
from dualarm_cli.robot_import.confined import XacroInput
from dualarm_cli.robot_import.contacts import (
    Contact,
    bare_cell,
    contact_reasons,
    find_contacts,
)
from dualarm_cli.robot_import.convex_parts import convex_parts
from dualarm_cli.robot_import.expanded_text import (
    check_arguments,
    program_notes,
    read_expanded,
    variant_notes,
)
from dualarm_cli.robot_import.group_states import find_postures
from dualarm_cli.robot_import.joint_limits import (
    ASSUMED,
    JointLimitsFile,
    StatedLimits,
    read_joint_limits,
    with_limits,
)
from dualarm_cli.robot_import.proposed_tool import proposed_tools
from dualarm_cli.robot_import.srdf import Srdf, named_tips, read_srdf, with_hands
from dualarm_cli.robot_import.structure import Structure, count_of, find_structure

_note = NoteTable(
    "import",
    velocity="velocity limits assumed, {assumed}, as the URDF has none: {joints:*, }",
    hulls="{meshes}: taken as convex hulls, in meshes/",
    parts="{name}: {parts}, in meshes/",
    drawn="{meshes}: simplified for the page, in meshes/",
    angles="{angles} of the URDF made exact multiples of a quarter turn: {values:listed}",
    shapeless="the URDF has no collision shapes: its links' collisions are not checked; add <collision> elements",
)


@dataclass(frozen=True)
class ImportRequest:
    """Request to import a robot, with the user's choices."""

    urdf: Path
    """Robot description (URDF or xacro)."""
    srdf: Path | None = None
    """MoveIt's description of groups, postures and contacts."""
    joint_limits: Path | None = None
    """MoveIt's joint limits."""
    tips: Mapping[str, str] = field(default_factory=dict)
    """Links to which tools are bolted, by side; `none` for a missing arm."""
    platform: tuple[str, ...] | None = None
    """Joints that carry both arms; None derives them from the tree."""
    packages: tuple[Path, ...] = ()
    """Folders of ROS packages."""
    seed: int = 0
    """Seed of the sampled postures."""
    divided: tuple[str, ...] = ()
    """Links whose meshes are divided into convex parts."""
    arguments: Mapping[str, str] = field(default_factory=dict)
    """Values of xacro arguments by name."""


@dataclass(frozen=True)
class Imported:
    """Files of an imported robot, and the decisions."""

    folder: str
    """Name of the folder."""

    files: Mapping[str, bytes]
    """Content of each file by its path in the folder."""
    loaded: LoadedRobot
    """Robot as `plan` loads these files."""
    reasons: tuple[Note, ...]
    """Decisions with their reasons, and assumptions."""


def import_robot(request: ImportRequest) -> Imported:
    """Import a robot: description with hulls of its meshes, and commented robot file.

    Args:
        request: robot and choices.

    Raises:
        InputError: a file cannot be used.
        UsageError: the tree is ambiguous; the message names the option.
    """
    with tempfile.TemporaryDirectory() as folder:
        return _imported(request, Path(folder))


def _imported(request: ImportRequest, folder: Path) -> Imported:
    """Import a robot, with its files in a temporary folder while they are checked."""
    given = XacroInput(request.arguments, request.packages)
    sources = [read_expanded(path, given) for path in (request.urdf, request.srdf) if path]
    check_arguments(request.arguments, *sources)
    urdf = read_urdf(sources[0])
    srdf = read_srdf(sources[1], urdf) if request.srdf is not None else Srdf()
    limits = JointLimitsFile()
    if request.joint_limits is not None:
        limits = read_joint_limits(request.joint_limits, urdf)
    structure = find_structure(urdf, named_tips(srdf, request.tips), request.platform)
    structure = with_hands(structure, srdf, urdf)
    urdf, assumed = with_limits(urdf, structure.joints, limits.joints)
    moving_joints(urdf, structure.joints)  # reports errors at lines of the user's file
    file = request.urdf.absolute()
    finder = PackageFinder(Project.of(file), file, request.packages, beyond=True)
    meshes = link_meshes(urdf, finder)
    parts = convex_parts(urdf, finder, meshes.units, request.divided)
    description = described(urdf, meshes.shapes, parts, visual_meshes(urdf, finder))
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
    for path, content in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(content)
    first = _loaded(urdf, folder, text).robot
    contacts, often = find_contacts(first, srdf.contacts, request.seed)
    proposed = proposed_tools(bare_cell(first))
    tools = [tool.note for tool in proposed.values()]
    text = replace(text, contacts=contacts, suggested=often, tools=tools)
    tcps = {arm: tool.tcp for arm, tool in proposed.items()}
    postures = find_postures(_loaded(urdf, folder, text).robot, tcps, srdf, request.seed)
    text = replace(text, postures=postures.values, comments=postures.comments)
    loaded = _loaded(urdf, folder, text)
    reasons = [
        *program_notes(urdf.source),
        *(variant_notes(urdf.source) if len(structure.arms) == 1 and not request.tips else ()),
        *srdf.notes,
        *structure.reasons,
        *tools,
        *description.reasons,
        *meshes.notes,
        *limits.reasons,
    ]
    if assumed:
        reasons.append(_note("velocity", assumed=ASSUMED, joints=sorted(assumed)))
    reasons += [*contact_reasons(contacts, often), *postures.reasons]
    # The description's reasons already list the meshes taken as hulls or parts.
    reasons += [note for note in loaded.notes if note.key != "hulls"]
    files["robot.yaml"] = robot_text(text).encode()
    return Imported(_file_name(name), files, loaded, tuple(reasons))


def _near_zero(urdf: Urdf, structure: Structure) -> dict[str, float]:
    """Collect joints' nearest positions to an unreachable 0 [rad or m]."""
    positions = {joint: nearest_to_zero(urdf.joints[joint]) for joint in structure.joints}
    return {joint: position for joint, position in positions.items() if position != 0.0}


def _file_name(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9_-]+", "_", name).strip("_").lower() or "robot"


def _loaded(urdf: Urdf, folder: Path, text: RobotText) -> LoadedRobot:
    """Load the robot from its folder, as `plan` does.

    Raises:
        InputError: the files cannot be used; reported at the place in the URDF.
    """
    path = folder / "robot.yaml"
    path.write_text(robot_text(text), encoding="utf-8")
    try:
        return load_robot(path)
    except InputError as error:
        raise InputError([_in_urdf(urdf, entry) for entry in error.diagnostics]) from None


def _in_urdf(urdf: Urdf, diagnostic: Diagnostic) -> Diagnostic:
    """Move a written file's diagnostic to the joint or link in the URDF."""
    for elements in (urdf.joints, urdf.links):
        for name, element in elements.items():
            if quote(name) in diagnostic.message:
                place = element.line, element.column
                return urdf.source.diagnostic(*place, diagnostic.code, diagnostic.message)
    return Diagnostic(urdf.source.name, 0, 0, diagnostic.code, diagnostic.message)


NOISE, COARSE, UNITS = 1e-9, 1e-4, 5
"""Quarter-turn tolerances: exact and maximum rounded [rad], and in last decimals.

A written angle within NOISE of a multiple of a quarter turn is that multiple; so is one within UNITS of its last
decimal, at most COARSE: 1.5708, 3.14159, and 1.570795, which is half of 3.14159.
"""
ROUNDED = 1e-3
"""Coarsest last decimal of a rounded multiple of a quarter turn [rad].

An angle is taken as the multiple that rounds to it: 1.571, 3.142.
"""
_KEPT = ("origin", "parent", "child", "axis", "limit", "safety_controller", "mimic")


@dataclass(frozen=True)
class Described:
    """Robot description with its mesh files."""

    text: str
    """Text of the URDF."""
    meshes: Mapping[str, bytes]
    """STL files by path."""
    reasons: tuple[Note, ...]
    """Changes to the description, with their reasons."""


def described(
    urdf: Urdf,
    meshes: Mapping[str, Sequence[Shape]],
    parts: Mapping[str, Sequence[Sequence[Hull]]],
    visuals: Sequence[VisualMesh] = (),
) -> Described:
    """Build the description of an imported robot.

    Args:
        urdf: as it was read.
        meshes: its collision meshes by link.
        parts: convex parts of some links' meshes, by link and mesh; other meshes become their hulls.
        visuals: its visual meshes; they are simplified.
    """
    files: dict[str, bytes] = {}
    drawn, shown = _drawn(visuals)
    elements = []
    for name, link in urdf.links.items():
        clean = Element("link", {"name": name})
        clean.children = [c for c in link.children if c.tag == "inertial"]
        hulls = iter(parts.get(name) or [[s.hull] for s in meshes.get(name, ()) if s.hull])
        for solid in link.all("collision"):
            if next(mesh_elements(solid), None) is None:
                clean.children.append(
                    Element("collision", solid.attributes, children=solid.children)
                )
                continue
            origins = [c for c in solid.children if c.tag == "origin"]
            for hull in next(hulls):
                path = f"meshes/{_safe(name)}_{len(files)}.stl"
                files[path] = stl_bytes(hull)
                mesh = Element("mesh", {"filename": path})
                geometry = Element("geometry", {}, children=[mesh])
                clean.children.append(Element("collision", {}, children=[*origins, geometry]))
        clean.children += shown.get(name, [])
        elements.append(clean)
    rounded: list[str] = []
    for name, joint in urdf.joints.items():
        clean = Element("joint", {"name": name, "type": joint.get("type")})
        for child in joint.children:
            if child.tag not in _KEPT:
                continue
            attributes = dict(child.attributes)
            if child.tag == "origin" and "rpy" in attributes:
                attributes["rpy"], words = _exact(attributes["rpy"])
                rounded += words
            clean.children.append(Element(child.tag, attributes))
        elements.append(clean)
    reasons = []
    if files:
        count = sum(len(hulls) for name, hulls in meshes.items() if name not in parts)
        if count:
            whole = count_of(count, "collision mesh", "collision meshes")
            reasons.append(_note("hulls", meshes=whole))
    for name, divided in parts.items():
        convex = count_of(sum(map(len, divided)), "convex part")
        reasons.append(_note("parts", name=name, parts=convex))
    if drawn:
        whole = count_of(len(drawn), "visual mesh", "visual meshes")
        reasons.append(_note("drawn", meshes=whole))
    if rounded:
        angles = count_of(len(rounded), "rounded angle")
        reasons.append(_note("angles", angles=angles, values=list(dict.fromkeys(rounded))))
    if not any(link.find("collision") for link in urdf.links.values()):
        reasons.append(_note("shapeless"))
    return Described(urdf_text(urdf.root.name or "robot", elements), files | drawn, tuple(reasons))


def _drawn(
    visuals: Sequence[VisualMesh],
) -> tuple[dict[str, bytes], dict[str, list[Element]]]:
    """Compose simplified visual mesh files, and their elements by link."""
    with tempfile.TemporaryDirectory() as folder:
        copies = stl_copies((mesh.file for mesh in visuals), Path(folder))
        visuals = [replace(mesh, file=copies.get(mesh.file, mesh.file)) for mesh in visuals]
        surfaces = drawn_meshes(visuals)
    paths = {key: f"meshes/visual_{k}.stl" for k, key in enumerate(surfaces)}
    shown: dict[str, list[Element]] = {}
    for mesh in visuals:
        path = paths.get((mesh.file, mesh.scale))
        if path is not None:
            geometry = Element("geometry", {}, children=[Element("mesh", {"filename": path})])
            origin = Element("origin", origin_words(mesh.pose))
            shown.setdefault(mesh.link, []).append(
                Element("visual", {}, children=[origin, geometry])
            )
    return {paths[key]: stl_bytes(surface) for key, surface in surfaces.items()}, shown


def _exact(rpy: str) -> tuple[str, list[str]]:
    """Make rounded multiples of a quarter turn exact, and list them as written.

    Small angles stay as they are, because a calibration may have measured them.
    """
    words, rounded = [], []
    for word in rpy.split():
        value = float(word)
        quarter = round(value / (0.5 * math.pi)) * 0.5 * math.pi
        exponent = Decimal(word).normalize().as_tuple().exponent
        last = 10.0**exponent if isinstance(exponent, int) and 10.0**exponent <= ROUNDED else 0.0
        slack = min(UNITS * last, COARSE) if last <= COARSE else 0.5 * last
        near = quarter != 0.0 and abs(value - quarter) < max(NOISE, slack)
        words.append(repr(quarter) if near else word)
        if near and abs(value - quarter) > 1e-12:
            rounded.append(word)
    return " ".join(words), rounded


def _safe(name: str) -> str:
    return "".join(c if c.isalnum() else "_" for c in name)


ACCELERATION_RULE = "top speed in 0.3 s"
"""Acceleration limits of joints without a stated limit."""
_WORDS = ("true", "false", "yes", "no", "on", "off", "null", "y", "n")
"""Words that YAML reads as something else than text."""


@dataclass(frozen=True)
class RobotText:
    """Contents of a robot file."""

    name: str
    """Name of the robot."""
    urdf: str
    """Name of its URDF file."""
    structure: Structure
    """Arms and platform."""
    assumed: frozenset[str]
    """Joints whose velocity limit is assumed."""
    limits: Mapping[str, StatedLimits]
    """Limits of other files."""
    contacts: Sequence[Contact] = ()
    """Links that may touch."""
    suggested: Sequence[Contact] = ()
    """Links that touch in many postures, to be judged by the user."""
    postures: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Named postures [rad or m]."""
    comments: Mapping[str, str] = field(default_factory=dict)
    """Comments on postures, by their names."""
    sliding: frozenset[str] = frozenset()
    """Joints that slide."""
    tools: Sequence[Note] = ()
    """Direction and length of each arm's tool, with the reason."""


def robot_text(robot: RobotText) -> str:
    """Compose the text of a robot file.

    Args:
        robot: its content.
    """
    structure = robot.structure
    lines = [
        "# Written by `dualarm robot import`. Replace what is `assumed` where you know better.",
        *(f"# {_line(reason)}" for reason in (*structure.reasons, *robot.tools)),
        "dualarm: robot/1",
        f"name: {_text(robot.name)}",
        f"urdf: {_text(robot.urdf)}",
    ]
    if structure.platform:
        lines.append(f"platform: {_list(structure.platform)}  # carries both arms")
    lines.append("arms:")
    for side, arm in structure.arms.items():
        hand = f", hand: {_text(arm.hand)}" if arm.hand else ""
        lines.append(f"  {side}: {{joints: {_list(arm.joints)}, flange: {_text(arm.tip)}{hand}}}")
    lines += [*_limits(robot), *_frozen(structure)]
    if robot.postures:
        lines.append("postures:  # joints that are not named are 0")
    for name, values in robot.postures.items():
        if name in robot.comments:
            lines.append(f"  # {_line(robot.comments[name])}")
        pairs = ", ".join(
            f"{_text(joint)}: {value!r} {'m' if joint in robot.sliding else 'rad'}"
            for joint, value in values.items()
            if value != 0.0
        )
        lines.append(f"  {_text(name)}: {{{pairs}}}")
    if robot.contacts:
        lines.append("allowed_contacts:  # links whose shapes overlap where the links do not")
        lines += [
            f"  - {_list(contact.links)}  # {_line(contact.why)}" for contact in robot.contacts
        ]
    assumed = [pair for pair in robot.suggested if pair.assumed]
    if assumed:
        lines.append(
            "assumed_contacts:  # judge them: each plan notes that their collisions are not checked"
        )
        lines += [f"  - {_list(pair.links)}  # {_line(pair.why)}" for pair in assumed]
    for pair in robot.suggested:
        if not pair.assumed:
            lines.append(f"# {_list(pair.links)} {_line(pair.why)} and are kept apart")
    return "\n".join(lines) + "\n"


def _limits(robot: RobotText) -> list[str]:
    """Compose the lines on limits."""
    rule = f"{{acceleration: {ACCELERATION_RULE}, jerk: {JERK_RULE}, source: assumed}}"
    lines = ["limits:  # positions and velocities are those of the URDF", f"  default: {rule}"]
    for joint in robot.structure.joints:
        stated = robot.limits.get(joint)
        if stated is None:
            continue
        rates = {"acceleration": stated.acceleration, "jerk": stated.jerk}
        given = ", ".join(
            f"{rate}: {value!r}" for rate, value in rates.items() if value is not None
        )
        if given:
            lines.append(f"  {_text(joint)}: {{{given}, source: joint_limits}}")
    if robot.assumed:
        names = ", ".join(sorted(robot.assumed))
        lines.append(
            f"  # the URDF has no velocity limits of these joints, {ASSUMED} is assumed: {names}"
        )
    return lines


def _frozen(structure: Structure) -> list[str]:
    """Compose the lines on held joints, and how to let them move."""
    if not structure.held:
        return []
    lines = ["frozen:  # where other joints stand; 0 where it is not given"]
    for held in structure.held:
        name = _text(held.joint)
        if held.arm:
            what = f"carries the {held.arm}"
            change = f"name it first in the joints of the {held.arm}"
        else:
            what = "carries both arms"
            change = f"write `platform: [{name}]`"
            if structure.platform:
                change += f" in place of {', '.join(structure.platform)}"
            change += f", or import again with --platform {name}"
        lines += [
            f"  # it {what}, {held.span}; to let it move between stages, delete its line and {change}",
            f"  {name}: {held.place}",
        ]
    return lines


def _text(text: str) -> str:
    """Quote text for YAML unless it can be read as nothing else."""
    plain = re.fullmatch(r"[A-Za-z][A-Za-z0-9_.-]*", text) is not None
    return text if plain and text.lower() not in _WORDS else json.dumps(text)


def _line(text: str) -> str:
    """Flatten text to one line of a comment."""
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())


def _list(names: Sequence[str]) -> str:
    return f"[{', '.join(map(_text, names))}]"
