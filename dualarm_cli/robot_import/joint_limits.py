"""Joint limits from elsewhere: MoveIt's `joint_limits.yaml`, and speeds where nobody states one."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from dualarm_cli.errors import Diagnostic, InputError
from dualarm_cli.files.robots.urdf import Urdf
from dualarm_cli.files.robots.urdf_tree import Element
from dualarm_cli.files.source.text_source import read_text
from dualarm_cli.files.source.yaml_source import parse_yaml

ASSUMED_SPEED, ASSUMED_SLIDING = math.radians(90.0), 0.1
"""Top speed of a joint for which nobody states one [rad/s]; of one that slides [m/s]."""
ASSUMED = "90 deg/s (of joints that slide 100 mm/s)"
"""The same in words."""


@dataclass(frozen=True)
class StatedLimits:
    """Limits of a joint; None where the file sets none."""

    velocity: float | None
    """Largest speed [rad/s or m/s]."""
    acceleration: float | None
    """Largest acceleration [rad/s² or m/s²]."""
    jerk: float | None
    """Largest jerk [rad/s³ or m/s³]."""


def read_joint_limits(path: Path) -> dict[str, StatedLimits]:
    """Returns the limits of `joint_limits.yaml` by joint.

    Args:
        path: the file.

    Raises:
        InputError: it cannot be read, or its form is another one.
    """
    document = parse_yaml(read_text(path, str(path)))
    if document.diagnostics:
        raise InputError(document.diagnostics)
    joints = document.data.get("joint_limits") if isinstance(document.data, dict) else None
    if not isinstance(joints, dict):
        message = "has no mapping 'joint_limits'"
        raise InputError([Diagnostic(str(path), 0, 0, "E202", message)])
    found = {}
    for name, limits in joints.items():
        if not isinstance(limits, dict):
            where = document.diagnostic(("joint_limits", name), "E200", "must be a mapping")
            raise InputError([where])
        found[str(name)] = StatedLimits(
            *(_limit(limits, rate) for rate in ("velocity", "acceleration", "jerk"))
        )
    return found


def _limit(limits: Mapping[str, Any], rate: str) -> float | None:
    """Returns a limit that is switched on and positive."""
    value = limits.get(f"max_{rate}")
    stated = limits.get(f"has_{rate}_limits", value is not None)
    usable = isinstance(value, int | float) and not isinstance(value, bool) and value > 0
    return float(value) if stated is True and usable else None  # type: ignore[arg-type]


def with_speeds(
    urdf: Urdf, used: Collection[str], stated: Mapping[str, StatedLimits]
) -> tuple[Urdf, frozenset[str]]:
    """Returns a URDF in which all joints that are used have a velocity limit, and those whose limit is assumed.

    Args:
        urdf: a checked URDF.
        used: its joints that are planned.
        stated: limits of another file, by joint; they take the place of the URDF's where they are lower.
    """
    joints, assumed = dict(urdf.joints), set()
    for name in used:
        joint = joints[name]
        own = joint.find("limit") or Element("limit", {}, joint.line, joint.column)
        try:
            speed = float(own.get("velocity", "0"))
        except ValueError:
            continue  # the reader of limits reports it
        other = stated[name].velocity if name in stated else None
        if other is not None and (speed == 0.0 or 0.0 < other < speed):
            speed = other
        elif speed == 0.0:
            slides = joint.get("type") == "prismatic"
            speed = ASSUMED_SLIDING if slides else ASSUMED_SPEED
            assumed.add(name)
        else:
            continue
        limit = replace(own, attributes={**own.attributes, "velocity": repr(speed)})
        others = [child for child in joint.children if child.tag != "limit"]
        joints[name] = replace(joint, children=[*others, limit])
    return replace(urdf, joints=joints), frozenset(assumed)
