"""Grasps of parts in cell files, with those that follow from symmetry and freedom.

A tool that may tilt, or grip within an area, has the stated grasp and one at each extreme. A grasp off the axis of a
symmetric part has one for each turn of the part. The planner chooses among all of them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pinocchio as pin

from dualarm_cli.files.cells.cell_frames import read_line
from dualarm_cli.files.cells.schema_cell import FreeSection, GraspSection, PartSection
from dualarm_cli.files.source.diagnostics import Findings
from dualarm_cli.files.source.fields import to_se3
from dualarm_cli.files.source.text_source import quote
from dualarm_cli.files.source.yaml_source import Document
from dualarm_cli.model.lines import Line
from dualarm_cli.model.part_flow import Grasp

MOST_GRASPS = 24
"""Maximum number of grasps of a part, with those for turns, tilts and areas."""


def read_grasps(
    document: Document,
    name: str,
    part: PartSection,
    frames: dict[str, pin.SE3],
    findings: Findings,
) -> dict[str, Grasp]:
    """Read the grasps of a part by name, after noting that there are too many.

    Args:
        document: the cell file.
        name: name of the part.
        part: the part as the file has it.
        frames: frames in the world.
        findings: where errors are noted.
    """
    grasps = {}
    for stated, section in part.grasps.items():
        lines: list[Line | None] = []
        for key, outward in (("approach", -1), ("retract", 1)):
            line, where = getattr(section, key), ("parts", name, "grasps", stated, key)
            lines.append(line and read_line(document, where, line, outward, frames, findings))
        for grasp in repeated(stated, section, part.symmetry or 1):
            if grasp.name in grasps:
                message = f"{quote(grasp.name)} is a turn, tilt or area of another grasp as well; rename one of them"
                findings.add(document, ("parts", name, "grasps", stated), message, key=True)
            grasps[grasp.name] = replace(
                grasp, approach=lines[0], retract=lines[1], width=section.width or 0.0
            )
    if len(grasps) > MOST_GRASPS:
        message = (
            f"part {quote(name)} has {len(grasps)} grasps with their turns, tilts and areas; at most {MOST_GRASPS}: "
            "lower 'symmetry', or remove grasps or their 'free'"
        )
        loc = ("parts", name, "symmetry" if part.symmetry else "grasps")
        findings.add(document, loc, message, key=True)
    return grasps


def repeated(stated: str, section: GraspSection, symmetry: int) -> Iterator[Grasp]:
    """Yield a grasp at each extreme of its freedom and each turn of the part.

    Args:
        stated: name of the grasp.
        section: the grasp as the file has it.
        symmetry: number of turns of the part.
    """
    free = section.free or FreeSection()
    for label, offset in _offsets(free):
        pose = to_se3(section) * offset
        grasp = Grasp(f"{stated}{label}", pose, of=stated)
        # A turn about the tool's own axis needs no grasp of its own.
        turns = 1 if grasp.is_on_axis else symmetry
        equal = math.lcm(section.symmetry or 1, symmetry // turns)
        for k in range(turns):
            turn = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, 2.0 * math.pi * k / turns), np.zeros(3))
            yield Grasp(
                grasp.name + (f"/{360 * k / turns:g} deg" if k else ""),
                turn * pose,
                free.turn is not None and not label,
                1 if label and not grasp.is_on_axis else equal,
                of=stated,
            )


def _offsets(free: FreeSection) -> Iterator[tuple[str, pin.SE3]]:
    """Yield extreme poses of the tool in its stated frame, with labels; the frame itself first."""
    yield "", pin.SE3.Identity()
    signs = (("+", 1.0), ("-", -1.0))
    for sign, factor in signs if free.tilt else ():
        for k, axis in enumerate("xy"):
            turn = pin.rpy.rpyToMatrix(*np.roll([factor * free.tilt, 0.0, 0.0], k))
            yield f"/tilt {sign}{axis}", pin.SE3(turn, np.zeros(3))
    width, depth = free.area or (0.0, 0.0)
    for sign_x, x in signs if free.area else ():
        for sign_y, y in signs:
            corner = np.array([x * width, y * depth, 0.0]) / 2.0
            yield f"/area {sign_x}x{sign_y}y", pin.SE3(np.eye(3), corner)
