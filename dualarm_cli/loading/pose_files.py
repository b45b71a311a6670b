"""CSV files of poses."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from dualarm_cli.errors import Diagnostic, InputError
from dualarm_cli.loading.fields import QUATERNION_TOLERANCE
from dualarm_cli.loading.text_source import TextSource, quote
from dualarm_cli.model.tool_path import Line

SHORTEST = 1e-6
"""Pieces of paths shorter than this are none [m]."""
COLUMNS = ("x", "y", "z", "qx", "qy", "qz", "qw")
"""Columns of a CSV file of poses."""


def read_poses(source: TextSource) -> list[pin.SE3]:
    """Returns the poses of a CSV file: a header with x, y, z, qx, qy, qz, qw, then one pose a line [m].

    Args:
        source: the file.

    Raises:
        InputError: everything wrong with it.
    """
    lines = source.text.splitlines()
    names = [name.strip() for name in (lines[0] if lines else "").split(",")]
    missing = [name for name in COLUMNS if name not in names]
    if missing:
        message = (
            f"the first line must name the columns {', '.join(COLUMNS)}, with commas between them; missing: "
            f"{', '.join(missing)}"
        )
        raise InputError([Diagnostic(source.name, 1, 1, "E300", message)])
    findings: list[Diagnostic] = []
    poses: list[pin.SE3] = []
    for number, line in enumerate(lines[1:], 2):
        if not line.strip():
            continue
        pose, wrong = _row(line, names)
        if pose is not None and poses and Line(poses[-1], pose).length < SHORTEST:
            pose, wrong = None, "the same pose as the one before; remove it"
        if pose is None:
            findings.append(Diagnostic(source.name, number, 1, "E300", wrong))
        else:
            poses.append(pose)
    if not findings and len(poses) < 2:
        findings.append(Diagnostic(source.name, 0, 0, "E300", "a path needs two poses or more"))
    if findings:
        raise InputError(findings)
    return poses


def _row(line: str, names: list[str]) -> tuple[pin.SE3 | None, str]:
    """Returns the pose of one line, or what is wrong with it."""
    fields = line.split(",")
    if len(fields) != len(names):
        return None, f"{len(fields)} values; the first line names {len(names)} columns"
    values: dict[str, float] = {}
    for name, field in zip(names, fields, strict=True):
        if name not in COLUMNS:
            continue
        try:
            values[name] = float(field)
        except ValueError:
            return None, f"{name}: {quote(field.strip())} is not a number"
        if not math.isfinite(values[name]) or abs(values[name]) > 1e3:
            return None, f"{name}: {quote(field.strip())} is outside the range of -1000 to 1000"
    norm = math.sqrt(sum(values[name] ** 2 for name in COLUMNS[3:]))
    if abs(norm - 1.0) > QUATERNION_TOLERANCE:
        return None, f"a quaternion must have length 1, not {norm:.6g}; divide by its length"
    x, y, z, w = (values[name] / norm for name in COLUMNS[3:])
    rotation = pin.Quaternion(w, x, y, z).toRotationMatrix()
    return pin.SE3(rotation, np.array([values[name] for name in COLUMNS[:3]])), ""
