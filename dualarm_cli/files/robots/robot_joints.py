"""Joints of a robot file, checked against its URDF: names, chains, postures and limits.

Limits are acceleration limits, jerk limits and position margins.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
import pinocchio as pin

from dualarm_cli.errors import did_you_mean
from dualarm_cli.files.robots.notes import robot_note
from dualarm_cli.files.robots.schema_robot import (
    JERK_RULE,
    ArmSection,
    LimitSection,
    RobotFile,
    TorqueSection,
)
from dualarm_cli.files.robots.urdf import Urdf, UrdfJoint
from dualarm_cli.files.source import quantities
from dualarm_cli.files.source.diagnostics import Findings
from dualarm_cli.files.source.quantities import Dimension, QuantityError, parse_quantity
from dualarm_cli.files.source.text_source import quote
from dualarm_cli.files.source.yaml_source import Document, Loc
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.joint_axes import joint_axes, measured_kind
from dualarm_cli.model.place import Place
from dualarm_cli.model.robot import Arm, JointLimits, JointTorques, Robot, rate_source
from dualarm_cli.notes import Note

POSITION_SLACK = 1e-9
"""Tolerance of position limits, for rounding [rad or m]."""


def file_arms(model: RobotFile) -> dict[str, ArmSection]:
    """Return the arms of a robot file, left before right."""
    pairs = (("left", model.arms.left), ("right", model.arms.right))
    return {name: arm for name, arm in pairs if arm is not None}


def _source(model: RobotFile) -> str:
    return "the URDF has" if model.dh is None else "the robot of the DH parameters has"


def check_names(document: Document, model: RobotFile, urdf: Urdf, findings: Findings) -> bool:
    """Check that the URDF has every named joint and flange, each joint once.

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
        ends = {"flange": arm.flange, **({"hand": arm.hand} if arm.hand else {})}
        for key, link in ends.items():
            loc = ("arms", side, key)
            if link not in urdf.links:
                hint = did_you_mean(link, list(urdf.links))
                findings.add(document, loc, f"{source} no link {quote(link)}{hint}")
            elif link in urdf.joints:
                message = f"{source} a link and a joint named {quote(link)}; rename one"
                findings.add(document, loc, message)
    return len(findings.diagnostics) == before


def check_chains(
    document: Document, model: RobotFile, urdf: Urdf, joints: list[UrdfJoint], findings: Findings
) -> None:
    """Note arms whose joints do not form their chain, and unsuitable kinds."""
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
        if arm.hand and urdf.chain(arm.hand)[-1:] != urdf.chain(arm.flange)[-1:]:
            ends = f"{quote(arm.hand)} does not move with flange {quote(arm.flange)}"
            message = f"link {ends}; name a link fixed to it"
            findings.add(document, ("arms", side, "hand"), message)
        count = {"srs": 7, "spherical_wrist": 6, "parallel_axes": 6}.get(arm.kind or "")
        if count is not None and len(arm.joints) != count:
            message = f"kind {arm.kind} needs {count} joints, found {len(arm.joints)}"
            findings.add(document, loc, message)
        elif count is not None and slides & set(arm.joints):
            names = ", ".join(name for name in arm.joints if name in slides)
            findings.add(document, loc, f"kind {arm.kind} needs joints that turn; {names} slides")


def posture_positions(
    document: Document, model: RobotFile, joints: list[UrdfJoint], findings: Findings
) -> dict[str, FloatArray]:
    """Read the named postures with home, each (n,) over the moving joints."""
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
    """Note joints that a posture omits although 0 is outside their limits."""
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
    """Read a joint position within its limits [rad or m]; None after an error."""
    dimension = quantities.LENGTH if joint.slides else quantities.ANGLE
    try:
        position = parse_quantity(value, dimension)
    except QuantityError as error:
        findings.add(document, loc, str(error), "E200")
        return None
    beyond = max(joint.lower - position, position - joint.upper)
    if beyond > POSITION_SLACK:
        factor, unit = (1e3, "mm") if joint.slides else (math.degrees(1.0), "deg")
        # A position that lies beyond a limit by rounding differs from it in late digits only.
        digits = ".6g" if beyond > 1e-3 else ".12g"
        spans = (
            f"{scale * joint.lower:{digits}} to {scale * joint.upper:{digits}} {name}"
            for scale, name in ((1.0, dimension.unit), (factor, unit))
        )
        span = "{} ({})".format(*spans)
        span += "".join(f", narrowed by {cause}" for cause in joint.narrowed)
        message = f"{quote(value)} is outside the limits of {quote(joint.name)}: {span}"
        about = {"joint": joint.name, "value": position, "allowed": [joint.lower, joint.upper]}
        findings.add(document, loc, message, about=about)
        return None
    # A position outside by rounding only is moved onto the limit.
    return min(max(position, joint.lower), joint.upper)


def model_arms(document: Document, model: RobotFile, measured: pin.Model) -> tuple[Arm, ...]:
    """Build the arms, left before right; missing kinds are measured.

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
        arms.append(Arm(name, tuple(arm.joints), arm.flange, kind, place, arm.hand or ""))
    return tuple(arms)


DEFAULT = "default"
"""Key of the default limits."""
_SMALLEST_RATE = 1e-6
_RULE = re.compile(r"(top speed|acceleration) in (.+)", re.DOTALL)

Rate = Literal["acceleration", "jerk"]


def with_margins(
    document: Document, model: RobotFile, joints: list[UrdfJoint], findings: Findings
) -> list[UrdfJoint]:
    """Narrow the positions of joints by their position margins or the default margin.

    Args:
        document: the robot file.
        model: its content.
        joints: the moving joints.
        findings: where errors are noted.
    """
    narrowed = []
    for joint in joints:
        stated = {
            name: model.limits[name].position_margin
            for name in (joint.name, DEFAULT)
            if name in model.limits and model.limits[name].position_margin is not None
        }
        if not stated:
            narrowed.append(joint)
            continue
        name, value = next(iter(stated.items()))
        try:
            margin = parse_quantity(value, quantities.LENGTH if joint.slides else quantities.ANGLE)
            if not 0.0 <= 2.0 * margin <= joint.upper - joint.lower:
                span = f"{joint.lower:.6g} to {joint.upper:.6g}"
                raise QuantityError(
                    f"{quote(value)} must not be negative, nor more than half of {span}"
                )
        except QuantityError as error:
            message = f"margin of {quote(joint.name)}: {error}"
            findings.add(document, ("limits", name, "position_margin"), message, "E200")
            margin = 0.0
        words = (*joint.narrowed, "position_margin") if margin else joint.narrowed
        lower, upper = joint.lower + margin, joint.upper - margin
        narrowed.append(replace(joint, lower=lower, upper=max(lower, upper), narrowed=words))
    return narrowed


def joint_limits(
    document: Document, model: RobotFile, joints: list[UrdfJoint], findings: Findings
) -> tuple[JointLimits, list[Note]] | None:
    """Read the limits of all moving joints, with notes on assumed ones.

    None after noting errors.

    The section of a joint has priority over the URDF, and the URDF over `default`. Without any of them a missing
    acceleration limit is an error, and the jerk limit follows JERK_RULE.

    Args:
        document: the robot file.
        model: its content.
        joints: the moving joints.
        findings: where errors are noted.
    """
    names = [joint.name for joint in joints]
    _check_joint_names(document, "limits", list(model.limits), names, findings)
    rows = []
    lacking: list[str] = []
    ruled: list[str] = []
    for joint in joints:
        acceleration = _rate("acceleration", document, model, joint, joint.velocity, findings)
        if acceleration is None:
            lacking.append(joint.name)
            continue
        if math.isnan(acceleration[0]):
            continue
        jerk = _rate("jerk", document, model, joint, acceleration[0], findings)
        if jerk is None:
            ruled.append(joint.name)
            jerk = _ruled(JERK_RULE, "jerk", acceleration[0]), "assumed"
        if not math.isnan(jerk[0]):
            rows.append((acceleration[0], jerk[0], rate_source(acceleration[1], jerk[1])))
    if lacking:
        message = (
            f"no acceleration limit for {', '.join(lacking)}; give one with its source, or one rule for all: "
            "`default: {acceleration: top speed in 0.3 s}`"
        )
        findings.add(document, ("limits",), message, "E202", key=True)
    if len(rows) != len(joints):
        return None
    limits = JointLimits(
        tuple(names),
        np.array([joint.lower for joint in joints]),
        np.array([joint.upper for joint in joints]),
        np.array([joint.velocity for joint in joints]),
        np.array([row[0] for row in rows]),
        np.array([row[1] for row in rows]),
        tuple(row[2] for row in rows),
    )
    whose = ["all joints"] if len(ruled) == len(joints) else ruled
    return limits, [robot_note("jerk_rule", joints=whose, rule=JERK_RULE)] if ruled else []


def _check_joint_names(
    document: Document, key: str, given: Sequence[str], names: Sequence[str], findings: Findings
) -> None:
    """Note names in a section that are no moving joints, nor `default`."""
    for name in given:
        if name not in (*names, DEFAULT):
            hint = did_you_mean(name, list(names))
            message = f"{quote(name)} is no joint of platform or arms{hint}"
            findings.add(document, (key, name), message, key=True)


def joint_torques(
    document: Document,
    model: RobotFile,
    robot: Robot,
    findings: Findings,
) -> JointTorques | None:
    """Read the torques of all moving joints; None where the robot file states none.

    Args:
        document: the robot file.
        model: its content.
        robot: with the efforts of its URDF.
        findings: where errors are noted.
    """
    names = robot.joints
    _check_joint_names(document, "torques", list(model.torques), names, findings)
    if not model.torques:
        return None
    stated = {key: value.model_dump(exclude_unset=True) for key, value in model.torques.items()}
    usual = stated.get(DEFAULT, {})
    sections = [TorqueSection(**usual | stated.get(name, {})) for name in names]
    efforts = [
        effort if section.effort is None else section.effort
        for effort, section in zip(robot.torques.effort.tolist(), sections, strict=True)
    ]
    for name, section, effort in zip(names, sections, efforts, strict=True):
        if 0.0 < section.derating * effort <= section.coulomb_friction:
            key = name if "coulomb_friction" in stated.get(name, {}) else DEFAULT
            message = (
                f"friction of {section.coulomb_friction:g} leaves {quote(name)} nothing of its effort of "
                f"{section.derating * effort:g}; give less friction or more effort"
            )
            findings.add(document, ("torques", key, "coulomb_friction"), message)
    return JointTorques(
        np.array([s.derating for s in sections]) * efforts,
        np.array([math.inf if s.rated_effort is None else s.rated_effort for s in sections]),
        np.array([s.coulomb_friction for s in sections]),
        np.array([s.viscous_friction for s in sections]),
        np.array([s.rotor_inertia for s in sections]),
        np.array([s.spring for s in sections]),
        np.array([s.spring_stiffness for s in sections]),
    )


def _rate(
    which: Rate,
    document: Document,
    model: RobotFile,
    joint: UrdfJoint,
    before: float,
    findings: Findings,
) -> tuple[float, str] | None:
    """Read a joint's acceleration or jerk limit [SI] and its source.

    The limit is NaN after noting a wrong value. None where neither the robot file nor the URDF gives one.

    Args:
        which: of the two.
        document: the robot file.
        model: its content.
        joint: the joint.
        before: its velocity limit, or the acceleration limit for its jerk.
        findings: where errors are noted.
    """
    stated = joint.acceleration if which == "acceleration" else joint.jerk
    for name in (joint.name, DEFAULT):
        section: LimitSection | None = model.limits.get(name)
        value = None if section is None else getattr(section, which)
        if section is not None and value is not None:
            loc: Loc = ("limits", name, which)
            try:
                return _limit(value, which, joint, before), section.source
            except QuantityError as error:
                findings.add(document, loc, str(error), "E200")
                return math.nan, section.source
        if name == joint.name and stated is not None:
            return stated, "urdf"
    return None


def _limit(value: object, which: Rate, joint: UrdfJoint, before: float) -> float:
    """Read a limit [SI], infinite for no jerk limit; raises QuantityError."""
    if which == "jerk" and value == "none":
        return math.inf
    if isinstance(value, str) and " in " in value:
        return _ruled(value, which, before)
    dimension = _dimension(which, joint.slides)
    rate = parse_quantity(value, dimension)
    if rate < _SMALLEST_RATE:
        raise QuantityError(f"{quote(value)}: {dimension.name} must be positive")
    return rate


def _dimension(which: Rate, slides: bool) -> Dimension:
    if which == "acceleration":
        return quantities.ACCELERATION if slides else quantities.ANGULAR_ACCELERATION
    return quantities.JERK if slides else quantities.ANGULAR_JERK


def _ruled(rule: str, which: Rate, before: float) -> float:
    """Compute the limit that a rule derives from the rate before it [SI].

    Args:
        rule: `top speed in 0.3 s`, or `acceleration in 0.1 s` for a jerk.
        which: the rate.
        before: limit of the rate before it [SI].

    Raises:
        QuantityError: no such rule, or a time that is not above 0.
    """
    wanted = {"acceleration": "top speed", "jerk": "acceleration"}[which]
    match = _RULE.fullmatch(rule.strip())
    if match is None or match[1] != wanted:
        raise QuantityError(f"{quote(rule)} is no rule for {which}; write `{wanted} in 0.2 s`")
    seconds = parse_quantity(match[2], quantities.TIME)
    if seconds < 1e-3:
        raise QuantityError(f"{quote(rule)}: the time must be at least 1 ms")
    return before / seconds
