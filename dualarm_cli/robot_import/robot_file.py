"""The robot file that an import writes: what was found, and why, in comments."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import field

from dualarm_cli.files.robots.schema_robot import JERK_RULE
from dualarm_cli.records import dataclass
from dualarm_cli.robot_import.contacts import Contact
from dualarm_cli.robot_import.joint_limits import ASSUMED, StatedLimits
from dualarm_cli.robot_import.structure import Structure

ACCELERATION_RULE = "top speed in 0.3 s"
"""Acceleration limits of joints for which nobody states one."""


_WORDS = ("true", "false", "yes", "no", "on", "off", "null", "y", "n")
"""Words that YAML takes for something else than text."""


@dataclass(frozen=True)
class RobotText:
    """What a robot file says."""

    name: str
    """Of the robot."""
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
    """Links that touch in many postures, which people have to judge."""
    postures: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Named postures [rad or m]."""
    comments: Mapping[str, str] = field(default_factory=dict)
    """Comments on postures, by their names."""
    sliding: frozenset[str] = frozenset()
    """Joints that slide."""


def robot_text(robot: RobotText) -> str:
    """Returns the text of a robot file.

    Args:
        robot: what it says.
    """
    structure = robot.structure
    lines = [
        "# Written by `dualarm robot import`. Replace what is `assumed` where you know better.",
        *(f"# {_line(reason)}" for reason in structure.reasons),
        "dualarm: robot/1",
        f"name: {_text(robot.name)}",
        f"urdf: {_text(robot.urdf)}",
    ]
    if structure.platform:
        lines.append(f"platform: {_list(structure.platform)}  # carries both arms")
    lines.append("arms:")
    for side, arm in structure.arms.items():
        lines.append(f"  {side}: {{joints: {_list(arm.joints)}, flange: {_text(arm.tip)}}}")
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
            "assumed_contacts:  # judge them: each plan tells that their collisions are not checked"
        )
        lines += [f"  - {_list(pair.links)}  # {_line(pair.why)}" for pair in assumed]
    for pair in robot.suggested:
        if not pair.assumed:
            lines.append(f"# {_list(pair.links)} {_line(pair.why)} and are kept apart")
    return "\n".join(lines) + "\n"


def _limits(robot: RobotText) -> list[str]:
    """Returns the lines on limits."""
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
    """Returns the lines on lifts and rails that stand still, and how to let them move."""
    if not structure.frozen:
        return []
    lines = ["frozen:  # where other joints stand; 0 where it is not given"]
    for slide in structure.frozen:
        name = _text(slide.joint)
        if slide.arm:
            what = f"carries the {slide.arm} arm"
            change = f"name it first in the joints of the {slide.arm} arm"
        else:
            what = "carries both arms"
            change = f"write `platform: [{name}]`"
            if structure.platform:
                change += f" in place of {', '.join(structure.platform)}"
            change += f", or import again with --platform {name}"
        span = f"{1e3 * slide.lower:g} to {1e3 * slide.upper:g} mm"
        lines += [
            f"  # it {what}, {span}; to let it move between stages, delete its line and {change}",
            f"  {name}: {1e3 * slide.position:g} mm",
        ]
    return lines


def _text(text: str) -> str:
    """Returns text as YAML reads it: plain where it can be nothing else, else in quotes."""
    plain = re.fullmatch(r"[A-Za-z][A-Za-z0-9_.-]*", text) is not None
    return text if plain and text.lower() not in _WORDS else json.dumps(text)


def _line(text: str) -> str:
    """Returns text as one line of a comment."""
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())


def _list(names: Sequence[str]) -> str:
    return f"[{', '.join(map(_text, names))}]"
