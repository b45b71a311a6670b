"""Two URDFs of one arm each, as one cell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pinocchio as pin

from dualarm_cli.errors import UsageError
from dualarm_cli.files.robots.robot_pair import compose_pair, why_not_a_pair_member
from dualarm_cli.geometry.products import norm
from dualarm_cli.model.robot import Robot
from dualarm_cli.records import dataclass
from dualarm_cli.robot_import.contacts import touches
from dualarm_cli.robot_import.importing import Imported, ImportRequest, import_robot
from dualarm_cli.robot_import.structure import NO_TIP

SHARE_OF_REACH = 0.6
"""Distance of the bases that is proposed, as a share of the shorter arm's reach: both reach what is between them."""
STEP = 0.1
"""The distance is a multiple of this [m]."""
TRIED = 20
"""Distances that are tried at most."""


@dataclass(frozen=True)
class ImportedPair:
    """The files of two robots and of their cell, and what was decided."""

    folder: str
    """Name for their folder."""
    files: Mapping[str, bytes]
    """Content of each file by its path in the folder."""
    reasons: tuple[str, ...]
    """What was decided, and why; what is assumed."""


def import_pair(left: ImportRequest, right: ImportRequest) -> ImportedPair:
    """Returns two robots side by side in one cell, each in a folder of its own; one folder if they are the same.

    Args:
        left: robot of one arm.
        right: robot of one arm.

    Raises:
        InputError: a file that cannot be used.
        UsageError: a robot of two arms, or a tree that leaves a choice that an option settles.
    """
    robots = {"left": _one_arm("left", left), "right": _one_arm("right", right)}
    if robots["left"].files == robots["right"].files:
        folders = dict.fromkeys(robots, robots["left"].folder)
    elif robots["left"].folder == robots["right"].folder:
        folders = {side: f"{side}_{one.folder}" for side, one in robots.items()}
    else:
        folders = {side: one.folder for side, one in robots.items()}
    distance, clear = _distance(*(one.loaded.robot for one in robots.values()))
    files: dict[str, bytes] = {}
    reasons: list[str] = []
    for side, folder in folders.items():
        one = robots[side]
        files |= {f"{folder}/{name}": content for name, content in one.files.items()}
        told = [f"{folder}: {reason}" for reason in one.reasons]
        reasons += [reason for reason in told if reason not in reasons]
    assumed = f"bases: {distance:.1f} m apart, side by side, x to the front: assumed"
    if not clear:
        assumed += "; the posture home collides there"
    reasons.append(assumed)
    files["cell.yaml"] = _cell_text(folders, distance).encode()
    name = "_and_".join(dict.fromkeys(one.folder for one in robots.values()))
    return ImportedPair(f"{name}_cell", files, tuple(reasons))


def _one_arm(side: str, request: ImportRequest) -> Imported:
    """Returns a robot, and refuses one that cannot be one of two."""
    other = "right" if side == "left" else "left"
    tips = {side: request.tips[side], other: NO_TIP} if side in request.tips else {}
    imported = import_robot(replace(request, tips=tips, platform=()))
    problem = why_not_a_pair_member(imported.loaded.robot)
    if problem is not None:
        raise UsageError(f"--{side} {request.urdf}: {problem}; import it by itself")
    return imported


def _distance(left: Robot, right: Robot) -> tuple[float, bool]:
    """Returns the distance of the bases [m], and whether the posture home is collision-free there."""
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
    """Returns how far the flange is from the arm's second joint at most: all links in a row [m]."""
    model = pin.buildModelFromXML(robot.urdf)
    joints = [model.getJointId(name) for name in robot.arms[0].joints]
    flange = model.frames[model.getFrameId(robot.arms[0].flange)].placement
    steps = [model.jointPlacements[joint].translation for joint in joints[2:]] + [
        flange.translation
    ]
    return float(sum(norm(step) for step in steps))


def _cell_text(folders: Mapping[str, str], distance: float) -> str:
    """Returns the text of a cell of two robots."""
    lines = [
        "# Written by `dualarm robot import`. The bases are assumed: write where yours are.",
        "dualarm: cell/1",
        "robot:",
    ]
    for (side, folder), y in zip(folders.items(), (0.5 * distance, -0.5 * distance), strict=True):
        base = f"base: {{xyz: [0, {y:.2f}, 0]}}"
        lines.append(f"  {side}: {{robot: {folder}/robot.yaml, {base}}}")
    return "\n".join(lines) + "\n"
