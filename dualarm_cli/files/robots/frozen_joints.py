"""Positions of joints that belong neither to the platform nor to an arm."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from dualarm_cli.files.robots.notes import robot_note
from dualarm_cli.files.robots.urdf import MOVING_TYPES, UNLIMITED, Urdf, UrdfJoint, soft_range
from dualarm_cli.files.robots.urdf_tree import Element
from dualarm_cli.files.source.text_source import quote, suggest
from dualarm_cli.notes import Note, listed

if TYPE_CHECKING:
    from dualarm_cli.files.robots.schema_robot import RobotFile
    from dualarm_cli.files.source.diagnostics import Findings
    from dualarm_cli.files.source.yaml_source import Document, Loc


def frozen_positions(
    document: Document, model: RobotFile, urdf: Urdf, moving: Sequence[str], findings: Findings
) -> dict[str, float]:
    """Compute the fixed position [rad or m] of each joint outside platform and arms.

    The robot file decides; a joint that mimics another one follows it; every other joint is at 0, or at the
    nearest limit if 0 is outside.

    Args:
        document: the robot file.
        model: its content.
        urdf: its URDF.
        moving: joints of platform and arms.
        findings: where errors are noted.
    """
    joints = {
        name: joint
        for name, joint in urdf.joints.items()
        if joint.get("type") in MOVING_TYPES and name not in moving
    }
    positions = {name: nearest_to_zero(joint) for name, joint in joints.items()}
    for name, value in model.frozen.items():
        loc: Loc = ("frozen", name)
        if name in joints:
            position = _position(document, loc, value, joints[name], findings)
            positions[name] = positions[name] if position is None else position
        elif name in moving:
            message = f"{quote(name)} belongs to the platform or an arm; to freeze it, take its name out there"
            findings.add(document, loc, message, key=True)
        else:
            hint = suggest(name, list(joints), "others that move")
            findings.add(document, loc, f"the URDF moves no joint {quote(name)}{hint}", key=True)
    _check_chains(document, model, urdf, moving, findings)
    for name in joints:
        if name not in model.frozen:
            positions[name] = _followed(name, joints, positions, moving)
    return positions


def frozen_notes(urdf: Urdf, positions: Mapping[str, float]) -> list[Note]:
    """Compose notes on fixed joints: names, positions, and mimics of moving joints.

    Args:
        urdf: a checked URDF.
        positions: of its frozen joints [rad or m].
    """
    unsupported = [
        joint.name
        for joint in urdf.joints.values()
        if joint.get("type") not in ("fixed", *MOVING_TYPES)
    ]
    if not positions and not unsupported:
        return []
    zero = [*unsupported, *(name for name, position in positions.items() if position == 0.0)]
    elsewhere = [
        f"{name} at {_shown(urdf.joints[name], position)}"
        for name, position in positions.items()
        if position != 0.0
    ]
    places = [f"{listed(zero)} at 0"] if zero else []
    places += [listed(elsewhere)] if elsewhere else []
    notes = [robot_note("fixed", places=places)]
    leaders = {name: leader_of(urdf, name) for name in positions}
    followers = [
        f"{name} ({leader})"
        for name, leader in leaders.items()
        if leader and leader not in positions and urdf.joints[leader].get("type") in MOVING_TYPES
    ]
    if followers:
        notes.append(robot_note("followers", joints=followers))
    return notes


def _shown(joint: Element, position: float) -> str:
    if joint.get("type") == "prismatic":
        return f"{position * 1e3:.6g} mm"
    return f"{math.degrees(position):.6g} deg"


def nearest_to_zero(joint: Element) -> float:
    """Compute the position within a joint's limits nearest to 0 [rad or m].

    Args:
        joint: a moving joint; limits that are missing or no numbers exclude nothing.
    """
    lower, upper = position_range(joint)
    return min(max(0.0, lower), upper)


def position_range(joint: Element) -> tuple[float, float]:
    """Read a joint's limits [rad or m], narrowed by soft ones; else infinite."""
    whole, soft = stated_range(joint), soft_range(joint)
    lower, upper = max(whole[0], soft[0]), min(whole[1], soft[1])
    return (lower, upper) if lower <= upper else whole


def stated_range(joint: Element) -> tuple[float, float]:
    """Read the positions of a joint's `<limit>` [rad or m]; else infinite."""
    limit = joint.find("limit")
    if limit is None or joint.get("type") == "continuous":
        return UNLIMITED
    lower, upper = _number(limit, "lower", 0.0), _number(limit, "upper", 0.0)
    return (lower, upper) if lower <= upper else UNLIMITED


def _position(
    document: Document, loc: Loc, value: object, joint: Element, findings: Findings
) -> float | None:
    """Read a frozen position within the joint's limits, or None after noting errors."""
    if joint.find("mimic") is not None:
        leader = joint.child_name("mimic", "joint")
        message = f"{quote(joint.name)} mimics {quote(leader)}; give that joint's position"
        findings.add(document, loc, message, key=True)
        return None
    # The page of a plan uses this module without the readers of files.
    from dualarm_cli.files.robots.robot_joints import joint_position

    slides, limits = joint.get("type") == "prismatic", position_range(joint)
    frozen = UrdfJoint(joint.name, slides, *limits, velocity=0.0)
    return joint_position(document, loc, value, frozen, findings)


def _check_chains(
    document: Document, model: RobotFile, urdf: Urdf, moving: Sequence[str], findings: Findings
) -> None:
    """Note joints between root and flange that mimic a moving joint.

    The kinematics has no joints that follow others.
    """
    from dualarm_cli.files.robots.robot_joints import file_arms

    for side, arm in file_arms(model).items():
        for name in urdf.chain(arm.flange) if arm.flange in urdf.links else []:
            leader = leader_of(urdf, name)
            if name not in moving and leader in moving:
                message = (
                    f"joint {quote(name)}, which moves flange {quote(arm.flange)}, mimics {quote(leader)}; "
                    "arms with joints that follow others cannot be planned"
                )
                findings.add(document, ("arms", side, "joints"), message)


def leader_of(urdf: Urdf, name: str) -> str:
    """Find the joint at the end of a chain of mimics.

    Empty for a joint without mimic, and for a cycle of mimics.
    """
    seen = [name]
    while (leader := urdf.joints[seen[-1]].child_name("mimic", "joint")) in urdf.joints:
        if leader in seen:
            return ""
        seen.append(leader)
    return seen[-1] if len(seen) > 1 else ""


def _followed(
    name: str, joints: Mapping[str, Element], positions: Mapping[str, float], moving: Sequence[str]
) -> float:
    """Compute the position of a frozen joint, through its mimics.

    Its own in a cycle of mimics.
    """
    factor, offset, seen = 1.0, 0.0, [name]
    while True:
        mimic = joints[seen[-1]].find("mimic")
        leader = "" if mimic is None else mimic.get("joint")
        if mimic is None or leader in seen or (leader not in joints and leader not in moving):
            return factor * positions[seen[-1]] + offset if leader not in seen else positions[name]
        step, shift = (
            _number(mimic, key, default) for key, default in (("multiplier", 1.0), ("offset", 0.0))
        )
        factor, offset = factor * step, offset + factor * shift
        if leader in moving:  # the position that belongs to the leader at 0
            return offset
        seen.append(leader)


def _number(element: Element, attribute: str, default: float) -> float:
    """Read a number of a fixed joint; the default if it is missing or not finite."""
    try:
        value = float(element.get(attribute))
    except ValueError:
        return default
    return value if math.isfinite(value) else default
