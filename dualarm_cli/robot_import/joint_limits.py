"""MoveIt's `joint_limits.yaml`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dualarm_cli.errors import Diagnostic, InputError
from dualarm_cli.files.source.text_source import read_text
from dualarm_cli.files.source.yaml_source import parse_yaml


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
    joints = document.data.get("joint_limits")
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
