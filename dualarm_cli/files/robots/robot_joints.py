"""What a robot file says of joints, checked against its URDF: names, chains, postures."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from dualarm_cli.errors import did_you_mean
from dualarm_cli.files.robots.schema_robot import ArmSection, RobotFile
from dualarm_cli.files.robots.urdf import Urdf, UrdfJoint
from dualarm_cli.files.source import quantities
from dualarm_cli.files.source.diagnostics import Findings
from dualarm_cli.files.source.quantities import QuantityError, parse_quantity
from dualarm_cli.files.source.text_source import quote
from dualarm_cli.files.source.yaml_source import Document, Loc
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.joint_axes import joint_axes, measured_kind
from dualarm_cli.model.place import Place
from dualarm_cli.model.robot import Arm

AXES_OF_KIND = {"srs": 7, "spherical_wrist": 6, "parallel_axes": 6}
"""How many joints an arm of a kind has."""
POSITION_SLACK = 1e-9
"""How far a posture may lie outside its limits, for rounding [rad or m]."""


def file_arms(model: RobotFile) -> dict[str, ArmSection]:
    """Returns the arms that a robot file has, left before right."""
    pairs = (("left", model.arms.left), ("right", model.arms.right))
    return {name: arm for name, arm in pairs if arm is not None}


def _source(model: RobotFile) -> str:
    return "the URDF has" if model.dh is None else "the robot of the DH parameters has"


def check_names(document: Document, model: RobotFile, urdf: Urdf, findings: Findings) -> bool:
    """Returns whether every joint and flange that the file names is in the URDF, each joint once.

    Args:
        document: the robot file.
        model: its content.
        urdf: its URDF.
        findings: where errors are noted.
    """
    before = len(findings.diagnostics)
    arms, source = file_arms(model), _source(model)
    if not arms:
        findings.add(document, ("arms",), "has no arm; give left, right or both", "E202")
    places: list[tuple[Loc, str]] = [
        (("platform", k), name) for k, name in enumerate(model.platform)
    ]
    for side, arm in arms.items():
        places += [(("arms", side, "joints", k), name) for k, name in enumerate(arm.joints)]
    first: dict[str, int] = {}
    for loc, name in places:
        if name not in urdf.joints:
            hint = did_you_mean(name, list(urdf.joints))
            findings.add(document, loc, f"{source} no joint {quote(name)}{hint}")
        elif name in first:
            message = f"joint {quote(name)} is named twice, first at line {first[name]}"
            findings.add(document, loc, message)
        first.setdefault(name, document.place(loc)[0])
    for side, arm in arms.items():
        loc = ("arms", side, "flange")
        if arm.flange not in urdf.links:
            hint = did_you_mean(arm.flange, list(urdf.links))
            findings.add(document, loc, f"{source} no link {quote(arm.flange)}{hint}")
        elif arm.flange in urdf.joints:
            message = f"{source} a link and a joint named {quote(arm.flange)}; rename one"
            findings.add(document, loc, message)
    return len(findings.diagnostics) == before


def check_chains(
    document: Document, model: RobotFile, urdf: Urdf, joints: list[UrdfJoint], findings: Findings
) -> None:
    """Notes arms whose joints are not what moves their flange, and kinds that do not fit."""
    used = {joint.name for joint in joints}
    slides = {joint.name for joint in joints if joint.slides}
    for side, arm in file_arms(model).items():
        loc: Loc = ("arms", side, "joints")
        chain = [name for name in urdf.chain(arm.flange) if name in used]
        wanted = [*model.platform, *arm.joints]
        if chain != wanted:
            message = (
                f"{_source(model).removesuffix(' has')} moves flange {quote(arm.flange)} by [{', '.join(chain)}], "
                f"platform and arm name [{', '.join(wanted)}]"
            )
            findings.add(document, loc, message)
        for k, name in enumerate(arm.joints[1:], start=1):
            if name in slides:
                message = f"{quote(name)} slides; of an arm's joints only the first one may"
                findings.add(document, (*loc, k), message)
        count = AXES_OF_KIND.get(arm.kind or "")
        if count is not None and len(arm.joints) != count:
            message = f"kind {arm.kind} needs {count} joints, found {len(arm.joints)}"
            findings.add(document, loc, message)
        elif count is not None and slides & set(arm.joints):
            names = ", ".join(name for name in arm.joints if name in slides)
            findings.add(document, loc, f"kind {arm.kind} needs joints that turn; {names} slides")


def posture_positions(
    document: Document, model: RobotFile, joints: list[UrdfJoint], findings: Findings
) -> dict[str, FloatArray]:
    """Returns the named postures, home among them, each of shape (n,) over the moving joints."""
    columns = {joint.name: k for k, joint in enumerate(joints)}
    postures = {}
    sections: dict[str, dict[str, object]] = {"home": {}, **model.postures}
    for posture, positions in sections.items():
        if posture == "free":
            message = "'free' cannot name a posture; it lets the planner choose the start"
            findings.add(document, ("postures", posture), message, key=True)
        q = np.zeros(len(joints))
        for name, value in positions.items():
            loc: Loc = ("postures", posture, name)
            if name not in columns:
                hint = did_you_mean(name, list(columns))
                message = f"{quote(name)} is no joint of platform or arms{hint}"
                findings.add(document, loc, message, key=True)
                continue
            position = joint_position(document, loc, value, joints[columns[name]], findings)
            q[columns[name]] = position if position is not None else math.nan
        postures[posture] = q
        _check_zeros(document, posture, positions, joints, model, findings)
    return postures


def _check_zeros(
    document: Document,
    posture: str,
    positions: dict[str, object],
    joints: list[UrdfJoint],
    model: RobotFile,
    findings: Findings,
) -> None:
    """Notes joints that a posture does not name although they cannot be at 0."""
    outside = [
        joint.name
        for joint in joints
        if joint.name not in positions and not joint.lower <= 0.0 <= joint.upper
    ]
    if outside:
        loc = ("postures", posture) if posture in model.postures else ("postures",)
        message = (
            f"posture {quote(posture)} does not name {', '.join(outside)}, "
            "and 0 is outside their limits; give their positions"
        )
        findings.add(document, loc, message, key=True)


def joint_position(
    document: Document, loc: Loc, value: object, joint: UrdfJoint, findings: Findings
) -> float | None:
    """Returns a joint position within its limits [rad or m], or None after noting what is wrong."""
    dimension = quantities.LENGTH if joint.slides else quantities.ANGLE
    try:
        position = parse_quantity(value, dimension)
    except QuantityError as error:
        findings.add(document, loc, str(error), "E200")
        return None
    if not joint.lower - POSITION_SLACK <= position <= joint.upper + POSITION_SLACK:
        span = f"{joint.lower:.6g} to {joint.upper:.6g} {dimension.unit}"
        if joint.slides:
            span += f" ({1e3 * joint.lower:.6g} to {1e3 * joint.upper:.6g} mm)"
        else:
            span += f" ({math.degrees(joint.lower):.6g} to {math.degrees(joint.upper):.6g} deg)"
        span += "".join(f", narrowed by {cause}" for cause in joint.narrowed)
        message = f"{quote(value)} is outside the limits of {quote(joint.name)}: {span}"
        about = {"joint": joint.name, "value": position, "allowed": [joint.lower, joint.upper]}
        findings.add(document, loc, message, about=about)
        return None
    # What lies outside by rounding only is put onto the limit.
    return min(max(position, joint.lower), joint.upper)


def model_arms(document: Document, model: RobotFile, measured: pin.Model) -> tuple[Arm, ...]:
    """Returns the arms as values, left before right; kinds that the file does not give are measured.

    Args:
        document: the robot file.
        model: its content.
        measured: the robot as pinocchio reads it.
    """
    arms = []
    for name, arm in file_arms(model).items():
        kind = arm.kind or measured_kind(*joint_axes(measured, arm.joints))
        key = "joints" if arm.kind is None else "kind"
        place = Place(document.source.name, *document.place(("arms", name, key)))
        arms.append(Arm(name, tuple(arm.joints), arm.flange, kind, place))
    return tuple(arms)
