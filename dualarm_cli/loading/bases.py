"""Files with the pose of a robot's base, such as a calibration writes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pinocchio as pin

from dualarm_cli.errors import InputError
from dualarm_cli.loading.diagnostics import Findings
from dualarm_cli.loading.documents import read_document, validate
from dualarm_cli.loading.poses import to_se3
from dualarm_cli.loading.projects import Project
from dualarm_cli.loading.schema_points import BaseFile


@dataclass(frozen=True)
class Base:
    """Where a robot's root link stands."""

    pose: pin.SE3
    """Its pose."""
    relative_to: str | None
    """The robot of the pair in whose base frame that is; None for the cell."""


def read_base(project: Project, path: Path, name: str, role: str | None = None) -> Base:
    """Returns the pose that a file holds.

    Args:
        project: what the file must stay in.
        path: the file.
        name: what the user calls it.
        role: what the file is to the cell: base.left or base.right.

    Raises:
        InputError: everything wrong with the file.
    """
    document = read_document(project, path, name, "base/1", role)
    findings = Findings()
    findings.extend(document.diagnostics)
    model = validate(document, BaseFile, findings)
    findings.raise_if_any()
    if model is None:
        raise InputError(findings.diagnostics)
    return Base(to_se3(model.base), model.relative_to)
