"""Import of two single-arm URDFs as one cell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pinocchio as pin

from dualarm_cli.errors import UsageError
from dualarm_cli.files.robots.notes import robot_note
from dualarm_cli.files.robots.robot_pair import compose_pair, why_not_a_pair_member
from dualarm_cli.geometry.products import norm
from dualarm_cli.model.robot import Robot
from dualarm_cli.notes import Note, NoteTable
from dualarm_cli.records import dataclass
from dualarm_cli.robot_import.contacts import touches
from dualarm_cli.robot_import.importing import Imported, ImportRequest, import_robot
from dualarm_cli.robot_import.structure import NO_TIP

SHARE_OF_REACH = 0.6
"""Proposed distance of the bases, as a fraction of the shorter arm's reach.

Both arms then reach the space between them.
"""
STEP = 0.1
"""Increment of the distance [m]."""
TRIED = 20
"""Maximum number of tried distances."""


_note = NoteTable(
    "bases",
    assumed="bases: {distance:.1f} m apart, side by side, x to the front: assumed",
    colliding="bases: {distance:.1f} m apart, side by side, x to the front: assumed; the posture home collides there",
)


@dataclass(frozen=True)
class ImportedPair:
    """Files of two robots and their cell, and the decisions."""

    folder: str
    """Name of the folder."""
    files: Mapping[str, bytes]
    """Content of each file by its path in the folder."""
    reasons: tuple[Note, ...]
    """Decisions with their reasons, and assumptions."""


def import_pair(left: ImportRequest, right: ImportRequest) -> ImportedPair:
    """Import two robots side by side into one cell.

    Each has its own folder; equal robots share one.

    Args:
        left: robot of one arm.
        right: robot of one arm.

    Raises:
        InputError: a file cannot be used.
        UsageError: a robot has two arms, or a tree is ambiguous; the message names the option.
    """
    robots = {"left": _one_arm("left", left), "right": _one_arm("right", right)}
    if robots["left"].files == robots["right"].files:
        folders = dict.fromkeys(robots, robots["left"].folder)
    elif robots["left"].folder == robots["right"].folder:
        folders = {side: f"{side}_{imported.folder}" for side, imported in robots.items()}
    else:
        folders = {side: imported.folder for side, imported in robots.items()}
    distance, clear = _distance(*(imported.loaded.robot for imported in robots.values()))
    files: dict[str, bytes] = {}
    reasons: list[Note] = []
    for side, folder in folders.items():
        imported = robots[side]
        files |= {f"{folder}/{name}": content for name, content in imported.files.items()}
        prefixed = [
            robot_note("of_robot", robot=folder, note=reason) for reason in imported.reasons
        ]
        reasons += [reason for reason in prefixed if reason not in reasons]
    reasons.append(_note("assumed" if clear else "colliding", distance=distance))
    files["cell.yaml"] = _cell_text(folders, distance).encode()
    name = "_and_".join(dict.fromkeys(imported.folder for imported in robots.values()))
    return ImportedPair(f"{name}_cell", files, tuple(reasons))


def _one_arm(side: str, request: ImportRequest) -> Imported:
    """Import a robot, and refuse one that cannot be part of a pair."""
    other_side = "right" if side == "left" else "left"
    tips = {side: request.tips[side], other_side: NO_TIP} if side in request.tips else {}
    imported = import_robot(replace(request, tips=tips, platform=()))
    problem = why_not_a_pair_member(imported.loaded.robot)
    if problem is not None:
        raise UsageError(f"--{side} {request.urdf}: {problem}; import it by itself")
    return imported


def _distance(left: Robot, right: Robot) -> tuple[float, bool]:
    """Choose the distance of the bases [m], and test the posture home for collisions."""
    reach = min(_reach(left), _reach(right))
    first = max(1, round(SHARE_OF_REACH * reach / STEP))
    for k in range(first, first + TRIED):
        bases = (
            pin.SE3(np.eye(3), np.array([0.0, sign * 0.5 * k * STEP, 0.0])) for sign in (1, -1)
        )
        robot = compose_pair(left, next(bases), right, next(bases))
        if not touches(robot, robot.postures["home"][None], ["left", "right"]).any():
            return k * STEP, True
    return first * STEP, False


def _reach(robot: Robot) -> float:
    """Compute the maximum distance of the flange from the second joint [m]."""
    model = pin.buildModelFromXML(robot.urdf)
    joints = [model.getJointId(name) for name in robot.arms[0].joints]
    flange = model.frames[model.getFrameId(robot.arms[0].flange)].placement
    steps = [model.jointPlacements[joint].translation for joint in joints[2:]] + [
        flange.translation
    ]
    return float(sum(norm(step) for step in steps))


def _cell_text(folders: Mapping[str, str], distance: float) -> str:
    """Compose the text of a cell of two robots."""
    lines = [
        "# Written by `dualarm robot import`. The bases are assumed: write where yours are.",
        "dualarm: cell/1",
        "robot:",
    ]
    for (side, folder), y in zip(folders.items(), (0.5 * distance, -0.5 * distance), strict=True):
        base = f"base: {{xyz: [0, {y:.2f}, 0]}}"
        lines.append(f"  {side}: {{robot: {folder}/robot.yaml, {base}}}")
    return "\n".join(lines) + "\n"
