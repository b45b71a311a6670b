"""Where the two robots of a cell stand: poses in the cell file, or in files of their own."""

from __future__ import annotations

from pathlib import Path

import pinocchio as pin

from dualarm_cli.errors import InputError
from dualarm_cli.loading.bases import Base, read_base
from dualarm_cli.loading.diagnostics import Findings
from dualarm_cli.loading.documents import validate
from dualarm_cli.loading.fields import Pose
from dualarm_cli.loading.poses import to_se3
from dualarm_cli.loading.projects import BadReferenceError, Project, display_name
from dualarm_cli.loading.schema_cell import PairSection
from dualarm_cli.loading.text_source import quote
from dualarm_cli.loading.yaml_source import Document, Loc


def pair_bases(
    project: Project, path: Path, document: Document, pair: PairSection, findings: Findings
) -> dict[str, pin.SE3] | None:
    """Returns the poses of both robots' root links in the cell, or None after noting what is wrong.

    Args:
        project: what files must stay in.
        path: the cell file.
        document: its content.
        pair: its two robots.
        findings: where errors are noted.
    """
    sections = {"left": pair.left.base, "right": pair.right.base}
    found: dict[str, Base] = {}
    for side, value in sections.items():
        base = _base(project, path, document, value, ("robot", side, "base"), findings)
        if base is not None and base.relative_to == side:
            message = f"the file says where the robot stands from the {side} one, which is this one"
            findings.add(document, ("robot", side, "base"), message)
            base = None
        if base is not None:
            found[side] = base
    if len(found) < 2:
        return None
    if all(base.relative_to is not None for base in found.values()):
        message = "each robot stands relative to the other; give one of them a pose in the cell"
        findings.add(document, ("robot", "right", "base"), message)
        return None
    other = {"left": "right", "right": "left"}
    return {
        # T_cell_side = T_cell_other T_other_side
        side: base.pose if base.relative_to is None else found[other[side]].pose * base.pose
        for side, base in found.items()
    }


def _base(
    project: Project, path: Path, document: Document, value: object, loc: Loc, findings: Findings
) -> Base | None:
    """Returns one robot's base, or None after noting what is wrong."""
    if isinstance(value, dict):
        pose = validate(document, Pose, findings, value, loc)
        return None if pose is None else Base(to_se3(pose), None)
    if not isinstance(value, str):
        message = f"must be a pose, such as {{xyz: [0, 0, 0]}}, or the path of a base file, not {quote(value)}"
        findings.add(document, loc, message, "E200")
        return None
    try:
        file = project.follow(value, path)
        name = display_name(value, document.source.name)
        return read_base(project, file, name, f"base.{loc[1]}")
    except BadReferenceError as error:
        findings.add(document, loc, str(error), "E500")
    except InputError as error:
        findings.extend(error.diagnostics)
    return None
