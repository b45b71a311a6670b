"""Acceleration limits, jerk limits and position margins of a robot's joints."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import Literal

import numpy as np

from dualarm_cli.errors import did_you_mean
from dualarm_cli.files.robots.schema_robot import JERK_RULE, LimitSection, RobotFile
from dualarm_cli.files.robots.urdf import UrdfJoint
from dualarm_cli.files.source import quantities
from dualarm_cli.files.source.diagnostics import Findings
from dualarm_cli.files.source.quantities import Dimension, QuantityError, parse_quantity
from dualarm_cli.files.source.text_source import quote
from dualarm_cli.files.source.yaml_source import Document, Loc
from dualarm_cli.model.robot import JointLimits, rate_source

DEFAULT = "default"
"""Key of the limits of joints that have none of their own."""
NONE = "none"
"""What a file says of a jerk that is not limited."""
_SMALLEST_RATE = 1e-6
_RULE = re.compile(r"(top speed|acceleration) in (.+)", re.DOTALL)
_RULES = {"acceleration": "top speed", "jerk": "acceleration"}
"""What a rule for each rate begins with: the rate before it."""

Rate = Literal["acceleration", "jerk"]


def with_margins(
    document: Document, model: RobotFile, joints: list[UrdfJoint], findings: Findings
) -> list[UrdfJoint]:
    """Narrow the positions of joints by their own or default margins.

    Args:
        document: the robot file.
        model: its content.
        joints: the moving joints.
        findings: where errors are noted.
    """
    found = []
    for joint in joints:
        stated = {
            name: model.limits[name].position_margin
            for name in (joint.name, DEFAULT)
            if name in model.limits and model.limits[name].position_margin is not None
        }
        if not stated:
            found.append(joint)
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
        found.append(replace(joint, lower=lower, upper=max(lower, upper), narrowed=words))
    return found


def joint_limits(
    document: Document, model: RobotFile, joints: list[UrdfJoint], findings: Findings
) -> tuple[JointLimits, list[str]] | None:
    """Returns the limits of all moving joints and notes on assumed ones, or None after noting what is missing or wrong.

    A joint's own section comes first, then the URDF, then `default`; without any of them there is no acceleration
    limit, which is an error, and the jerk limit is that of JERK_RULE.

    Args:
        document: the robot file.
        model: its content.
        joints: the moving joints.
        findings: where errors are noted.
    """
    known = [joint.name for joint in joints]
    for name in model.limits:
        if name not in (*known, DEFAULT):
            message = f"{quote(name)} is no joint of platform or arms{did_you_mean(name, known)}"
            findings.add(document, ("limits", name), message, key=True)
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
        tuple(known),
        np.array([joint.lower for joint in joints]),
        np.array([joint.upper for joint in joints]),
        np.array([joint.velocity for joint in joints]),
        np.array([row[0] for row in rows]),
        np.array([row[1] for row in rows]),
        tuple(row[2] for row in rows),
    )
    return limits, _notes(ruled, len(joints))


def _notes(ruled: list[str], count: int) -> list[str]:
    """Returns a note on jerk limits that nobody gave."""
    if not ruled:
        return []
    of = "all joints" if len(ruled) == count else ", ".join(ruled)
    return [
        f"no jerk limit is given for {of}: `{JERK_RULE}` is assumed; give `jerk`, or `jerk: none` for no limit"
    ]


def _rate(
    which: Rate,
    document: Document,
    model: RobotFile,
    joint: UrdfJoint,
    before: float,
    findings: Findings,
) -> tuple[float, str] | None:
    """Returns a joint's limit and its source; NaN after noting what is wrong, None where nobody gives one.

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
            return _checked(value, which, document, loc, joint, before, findings), section.source
        if name == joint.name and stated is not None:
            return stated, "urdf"
    return None


def _checked(
    value: object,
    which: Rate,
    document: Document,
    loc: Loc,
    joint: UrdfJoint,
    before: float,
    findings: Findings,
) -> float:
    """Returns a limit [SI], infinite for no jerk limit, or NaN after noting what is wrong with it."""
    if which == "jerk" and value == NONE:
        return math.inf
    try:
        if isinstance(value, str) and " in " in value:
            return _ruled(value, which, before)
        rate = parse_quantity(value, _dimension(which, joint.slides))
    except QuantityError as error:
        findings.add(document, loc, str(error), "E200")
        return math.nan
    if rate < _SMALLEST_RATE:
        name = _dimension(which, joint.slides).name
        findings.add(document, loc, f"{quote(value)}: {name} must be positive", "E200")
        return math.nan
    return rate


def _dimension(which: Rate, slides: bool) -> Dimension:
    if which == "acceleration":
        return quantities.ACCELERATION if slides else quantities.ANGULAR_ACCELERATION
    return quantities.JERK if slides else quantities.ANGULAR_JERK


def _ruled(rule: str, which: Rate, before: float) -> float:
    """Returns the limit that a rule takes from the rate before it.

    Args:
        rule: `top speed in 0.3 s`, or `acceleration in 0.1 s` for a jerk.
        which: the rate.
        before: limit of the rate before it [SI].

    Raises:
        QuantityError: no such rule, or a time that is not above 0.
    """
    wanted = _RULES[which]
    found = _RULE.fullmatch(rule.strip())
    if found is None or found[1] != wanted:
        raise QuantityError(f"{quote(rule)} is no rule for {which}; write `{wanted} in 0.2 s`")
    seconds = parse_quantity(found[2], quantities.TIME)
    if seconds < 1e-3:
        raise QuantityError(f"{quote(rule)}: the time must be at least 1 ms")
    return before / seconds
