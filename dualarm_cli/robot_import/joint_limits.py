"""Joint limits from MoveIt's `joint_limits.yaml`, and assumed speeds."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import field, replace
from pathlib import Path
from typing import Any

from dualarm_cli.errors import Diagnostic, InputError, did_you_mean
from dualarm_cli.files.robots.frozen_joints import position_range, stated_range
from dualarm_cli.files.robots.urdf import SOFT_LIMITS, Urdf, soft_range
from dualarm_cli.files.robots.urdf_tree import Element
from dualarm_cli.files.source.diagnostics import Findings
from dualarm_cli.files.source.text_source import quote, read_text, suggest
from dualarm_cli.files.source.yaml_source import Document, Loc, parse_yaml
from dualarm_cli.notes import Note, NoteTable
from dualarm_cli.records import dataclass

ASSUMED_SPEED, ASSUMED_SLIDING = math.radians(90.0), 0.1
"""Assumed top speed of joints without one [rad/s]; of slides [m/s]."""
ASSUMED = "90 deg/s (of joints that slide 100 mm/s)"
"""Assumed speeds as text."""


_KEYS = {
    "position": ("min_position", "max_position"),
    "velocity": ("max_velocity",),
    "acceleration": ("max_acceleration",),
    "deceleration": ("max_deceleration",),
    "jerk": ("max_jerk",),
    "soft": SOFT_LIMITS,
}
"""Kinds of limits with their keys; `has_…_limits` enables each kind."""
_NOT_USED = ("has_effort_limits", "max_effort", "k_position", "k_velocity", "angle_wraparound")
"""Keys of other tools that do not affect planning."""


_note = NoteTable(
    "joint_limits",
    ignored="{file}:{line}: {entry} is not taken",
    scale="{file}:{line}: {entry} is not taken: it scales MoveIt's motions; here `speed` of tasks does",
    wider="{file} allows larger {what} than the URDF, whose limits hold: {joints:*, }",
)


@dataclass(frozen=True)
class StatedLimits:
    """Limits of a joint; None for limits that the file does not set."""

    velocity: float | None = None
    """Maximum speed [rad/s or m/s]."""
    acceleration: float | None = None
    """Maximum acceleration and deceleration [rad/s² or m/s²]."""
    jerk: float | None = None
    """Maximum jerk [rad/s³ or m/s³]."""
    positions: tuple[float, float] | None = None
    """Minimum and maximum position [rad or m], overlapping the URDF's range."""
    soft: tuple[float, float] | None = None
    """Soft position limits [rad or m] that overlap those of the URDF."""


@dataclass(frozen=True)
class JointLimitsFile:
    """Content of a `joint_limits.yaml`."""

    joints: Mapping[str, StatedLimits] = field(default_factory=dict)
    """Limits by joint."""
    reasons: tuple[Note, ...] = ()
    """Messages on ignored entries."""


def read_joint_limits(path: Path, urdf: Urdf) -> JointLimitsFile:
    """Read the limits of `joint_limits.yaml` by joint.

    Args:
        path: the file.
        urdf: a checked URDF.

    Raises:
        InputError: it cannot be read, has another form, or names unknown joints; all errors at once.
    """
    source = read_text(path, str(path))
    if not source.text.strip():
        raise InputError(
            [Diagnostic(str(path), 0, 0, "E101", "is empty; `joint_limits:` is needed")]
        )
    document = parse_yaml(source)
    findings = Findings(document.diagnostics)
    findings.raise_if_any()
    joints = document.data.get("joint_limits") if isinstance(document.data, dict) else None
    if not isinstance(joints, dict):
        message = "has no mapping 'joint_limits'"
        raise InputError([Diagnostic(str(path), 0, 0, "E202", message)])
    limits_by_joint = {}
    for name, limits in joints.items():
        loc: Loc = ("joint_limits", name)
        if name not in urdf.joints:
            hint = did_you_mean(name, list(urdf.joints))
            message = f"the URDF has no joint {quote(name)}{hint}"
            findings.add(document, loc, message, key=True)
        elif not isinstance(limits, dict):
            findings.add(document, loc, f"must be a mapping, not {quote(limits)}", "E200")
        else:
            limits_by_joint[name] = _stated(document, loc, limits, urdf.joints[name], findings)
    findings.raise_if_any()
    reasons = _wider(path.name, urdf, limits_by_joint)
    for key in document.data:
        if key != "joint_limits":
            at = {"file": path.name, "line": document.place((key,))[0], "entry": key}
            reasons.append(_note("scale" if key.startswith("default_") else "ignored", **at))
    return JointLimitsFile(limits_by_joint, tuple(reasons))


def _wider(file: str, urdf: Urdf, limits_by_joint: Mapping[str, StatedLimits]) -> list[Note]:
    """List messages on joints with wider limits than the URDF's."""
    faster, farther = [], []
    for name, limits in limits_by_joint.items():
        speed = _speed(urdf.joints[name])
        if limits.velocity is not None and speed is not None and 0.0 < speed < limits.velocity:
            faster.append(name)
        if limits.positions is not None:
            lower, upper = position_range(urdf.joints[name])
            if limits.positions[0] < lower or upper < limits.positions[1]:
                farther.append(name)
    return [
        _note("wider", file=file, what=what, joints=names)
        for what, names in {"velocities": faster, "positions": farther}.items()
        if names
    ]


def _speed(joint: Element) -> float | None:
    """Read a joint's velocity limit [rad/s or m/s].

    0 without one, None for an invalid number.
    """
    limit = joint.find("limit")
    try:
        return float(limit.get("velocity", "0")) if limit is not None else 0.0
    except ValueError:
        return None


def _stated(
    document: Document, loc: Loc, limits: Mapping[str, Any], joint: Element, findings: Findings
) -> StatedLimits:
    """Read the enabled limits of one joint, and report errors in them."""
    switches = [f"has_{kind}_limits" for kind in _KEYS]
    allowed = [*switches, *(key for keys in _KEYS.values() for key in keys), *_NOT_USED]
    for key in limits:
        if key not in allowed:
            message = f"unknown key {quote(key)}{suggest(key, allowed)}"
            findings.add(document, (*loc, key), message, "E201", key=True)
    values: dict[str, float] = {}
    for switch, keys in zip(switches, _KEYS.values(), strict=True):
        on = limits.get(switch, any(key in limits for key in keys))
        if not isinstance(on, bool):
            message = f"must be true or false, not {quote(on)}"
            findings.add(document, (*loc, switch), message, "E200")
        elif on:
            for key in keys:
                values |= _number(document, (*loc, key), limits, findings)
    rates = [v for key in ("max_acceleration", "max_deceleration") if (v := values.get(key))]
    positions, soft = (
        _positions(document, loc, values, _KEYS[kind], joint, findings)
        for kind in ("position", "soft")
    )
    acceleration = min(map(abs, rates), default=None)
    return StatedLimits(
        values.get("max_velocity"), acceleration, values.get("max_jerk"), positions, soft
    )


def _number(
    document: Document, loc: Loc, limits: Mapping[str, Any], findings: Findings
) -> dict[str, float]:
    """Read a limit by its key, or report the error and return nothing."""
    key = str(loc[-1])
    value = limits.get(key)
    free = key in (*_KEYS["position"], *_KEYS["soft"], "max_deceleration")
    expected = "a number" if free else "a number above 0"
    if key not in limits:
        findings.add(document, loc[:-1], f"{key} is missing; give {expected}", "E202", key=True)
    elif isinstance(value, bool) or not isinstance(value, int | float):
        more = "; take its quotes away" if isinstance(value, str) else ""
        findings.add(document, loc, f"{key} must be {expected}, not {quote(value)}{more}", "E200")
    elif value <= 0 and not free:
        findings.add(document, loc, f"{key} must be above 0, not {value:g}", "E200")
    else:
        return {key: float(value)}
    return {}


def _positions(
    document: Document,
    loc: Loc,
    values: Mapping[str, float],
    keys: Sequence[str],
    joint: Element,
    findings: Findings,
) -> tuple[float, float] | None:
    """Read stated positions, or None after reporting errors."""
    if not all(key in values for key in keys):
        return None
    stated = values[keys[0]], values[keys[1]]
    lower, upper = position_range(joint)
    first, last = _common(stated, (lower, upper))
    # Equal soft limits would count as none.
    if first < last or (first == last and keys != SOFT_LIMITS):
        return stated
    message = (
        f"no position of {quote(joint.name)} is within {stated[0]:g} to {stated[1]:g} and "
        f"within the URDF's {lower:g} to {upper:g}"
    )
    findings.add(document, (*loc, keys[0]), message)
    return None


def with_limits(
    urdf: Urdf, used: Collection[str], stated: Mapping[str, StatedLimits]
) -> tuple[Urdf, frozenset[str]]:
    """Merge the limits of another file into a URDF, and assume missing speeds.

    All used joints have a velocity limit afterwards. Returns the URDF and the joints with an assumed speed.

    Args:
        urdf: a checked URDF.
        used: its planned joints.
        stated: limits of another file by joint; they replace the URDF's if they are lower.
    """
    joints, assumed = dict(urdf.joints), set()
    for name in used:
        joint, given = joints[name], stated.get(name, StatedLimits())
        limit = joint.find("limit") or Element("limit", {}, joint.line, joint.column)
        attributes = dict(limit.attributes)
        kind = joint.get("type")
        if given.positions is not None:
            lower, upper = _common(given.positions, stated_range(joint))
            attributes |= {"lower": repr(lower), "upper": repr(upper)}
            kind = "revolute" if kind == "continuous" else kind
        speed = _speed(joint)
        if speed is None:
            continue  # the reader of limits reports it
        if given.velocity is not None and (speed == 0.0 or 0.0 < given.velocity < speed):
            attributes["velocity"] = repr(given.velocity)
        elif speed == 0.0:
            attributes["velocity"] = repr(ASSUMED_SLIDING if kind == "prismatic" else ASSUMED_SPEED)
            assumed.add(name)
        parts = {"limit": replace(limit, attributes=attributes)}
        if given.soft is not None:
            parts["safety_controller"] = _soft(joint, given.soft)
        others = [child for child in joint.children if child.tag not in parts]
        if attributes != limit.attributes or given.soft is not None:
            joints[name] = replace(
                joint,
                attributes={**joint.attributes, "type": kind},
                children=[*others, *parts.values()],
            )
    return replace(urdf, joints=joints), frozenset(assumed)


def _common(range_a: tuple[float, float], range_b: tuple[float, float]) -> tuple[float, float]:
    """Intersect two position ranges."""
    return max(range_a[0], range_b[0]), min(range_a[1], range_b[1])


def _soft(joint: Element, soft: tuple[float, float]) -> Element:
    """Narrow a joint's soft limits in `<safety_controller>` to those of another file."""
    safety = joint.find("safety_controller") or Element("safety_controller", {"k_velocity": "0"})
    common = zip(SOFT_LIMITS, map(repr, _common(soft, soft_range(joint))), strict=True)
    return replace(safety, attributes=safety.attributes | dict(common))
