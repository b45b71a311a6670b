"""Reach over a table and postures that reach a pose, as functions of Python."""

from __future__ import annotations

import math
from pathlib import Path
from typing import SupportsFloat

import numpy as np
import pinocchio as pin

from dualarm_cli.errors import UsageError, check_type
from dualarm_cli.files.cells.cells import load_cell
from dualarm_cli.files.robots.robots import load_robot
from dualarm_cli.files.source.bundled import CELL_FILE, ROBOT_FILE, bundled_robots
from dualarm_cli.files.source.documents import read_document
from dualarm_cli.files.source.projects import Project
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.products import product
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.job import Job
from dualarm_cli.notes import Note, NoteTable
from dualarm_cli.reachability.facing_tools import handover_poses
from dualarm_cli.reachability.reach_map import reach_map
from dualarm_cli.reachability.region import best_height, platform_positions, region
from dualarm_cli.report.comparisons import ReachReport
from dualarm_cli.report.reach import handover_rows, reach_document
from dualarm_cli.robot_import.contacts import bare_cell
from dualarm_cli.robot_import.proposed_tool import with_tools

_note = NoteTable("tools", assumed="no cell file names the tools")
MOST_NODES = 400_000
"""Maximum number of points over all platform angles."""
MAX_TILT = 90.0
"""Largest tilt [deg]."""
ROUNDING = 1e-6
"""Rounding tolerance of given rotations, and of platform positions [rad or m]."""


def reach(
    robot: str | Path | Job | Cell,
    *,
    height: float | None = None,
    tilt: float = 0.0,
    step: float | None = None,
    handover: float | None = None,
) -> ReachReport:
    """Compute the reachable part of a table, as `dualarm robot reach --json`.

    The document has the areas that each arm and both arms reach, by platform position.

    Args:
        robot: a job, a bundled robot's name, a robot's folder, a robot file or a cell file.
        height: height of the tool centre point [m]; None for that of the cell's frames, else where most is reached.
        tilt: tilt of the tool from straight down, its tip outwards [rad].
        step: spacing of the points [m]; None for one by the robot's size.
        handover: distance of the tool centre points of hand-overs [m]; None for no search of their poses.

    Raises:
        InputError: the file cannot be read.
        UsageError: a height, tilt, spacing or distance that is not allowed.
    """
    cell = robot.cell if isinstance(robot, Job) else robot
    cell = cell if isinstance(cell, Cell) else reach_cell(str(cell))[0]
    given = {"tilt": tilt, "height": height, "step": step, "handover": handover}
    for key, value in given.items():
        if value is not None:
            check_type(key, value, SupportsFloat)
    if not abs(tilt) <= math.radians(MAX_TILT):
        raise UsageError(
            f"tilt {math.degrees(tilt):g} deg: must be between -{MAX_TILT:g} and {MAX_TILT:g} deg"
        )
    if height is not None and not math.isfinite(height):
        raise UsageError(f"height {height:g} m: must be finite")
    here = region(cell)
    if handover is not None and len(cell.robot.arms) < 2:
        raise UsageError(f"handover: {cell.robot.name} has one arm only; a hand-over needs two")
    if handover is not None and not 0.0 <= handover <= here.radius:
        raise UsageError(f"handover {handover:g} m: must be from 0 to {here.radius:.3g} m")
    platform = platform_positions(cell)
    spacing = here.step if step is None else step
    width = 2.0 * (here.radius + here.travel)
    points = len(platform) * float(np.square(width / spacing)) if spacing > 0.0 else math.inf
    if not points <= MOST_NODES:
        least = math.ceil(width * math.sqrt(len(platform) / MOST_NODES) * 1000.0)
        raise UsageError(f"step {spacing:g} m: must be {least} mm or more for this robot")
    if height is None and cell.frames:
        height = float(np.median([pose.translation[2] for pose in cell.frames.values()]))
    if height is None:
        height = best_height(cell, here)
    if height is None:
        height = here.easy[1]
    grid = here.grid(platform, np.array([height]), spacing, tilt, whole=True)
    name = robot if isinstance(robot, str | Path) else cell.robot.name
    document = reach_document(str(name), cell, reach_map(cell, grid))
    if handover is not None:
        document["handover_distance"] = handover
        document["handovers"] = handover_rows(cell, handover_poses(cell, handover), handover)
    return document


def reach_cell(robot: str) -> tuple[Cell, list[Note]]:
    """Load the cell of a robot or cell file, with notes on assumed tools.

    Raises:
        InputError: the file cannot be read.
    """
    path = Path(robot)
    if path.is_dir() and robot not in bundled_robots():
        path = path / (CELL_FILE if (path / CELL_FILE).is_file() else ROBOT_FILE)
    if robot in bundled_robots() or not path.is_file():
        cell = bare_cell(load_robot(robot).robot)
    else:
        data = read_document(Project.of(path), path, str(path)).data
        if data["dualarm"] == "cell/1":
            cell = load_cell(path).cell
            if "tools" in data:
                return cell, []
        else:
            cell = bare_cell(load_robot(path).robot)
    cell, tools = with_tools(cell)
    return cell, [_note("assumed"), *(tool.note for tool in tools.values())]


def inverse_kinematics(
    job: Job | Cell,
    arm: str,
    pose: pin.SE3 | FloatArray,
    platform: FloatArray | float | None = None,
) -> FloatArray:
    """Solve for postures of an arm whose tool centre point is at a pose.

    Postures are within joint limits; collisions are not checked. An arm of seven joints has postures at many arm
    angles, an arm without closed forms those that a search from fixed starts finds.

    Args:
        job: a job or cell.
        arm: name of the arm.
        pose: pose of the tool centre point in the world, also as a matrix of shape (4, 4).
        platform: positions of the platform's joints [rad or m]; None for those of the start posture, or home.

    Returns:
        Positions of the arm's joints, base to flange [rad], shape (k, n); k is 0 if none was found.

    Raises:
        UsageError: unknown arm, no pose, another number of platform joints, or positions beyond their limits.
    """
    check_type("job", job, Job, Cell)
    cell = job.cell if isinstance(job, Job) else job
    model = CellModel.from_cell(cell)
    if arm not in model.arms:
        raise UsageError(f"arm {arm!r}: {cell.robot.name} has {', '.join(model.arms)}")
    if platform is None:
        start = job.start_joints if isinstance(job, Job) else cell.robot.postures["home"]
        platform = start[model.platform_columns]
    position = np.atleast_1d(np.asarray(platform, dtype=np.float64))
    if position.shape != (len(model.platform_columns),):
        count = len(model.platform_columns)
        raise UsageError(f"platform of shape {position.shape}: must have {count} positions")
    limits = cell.robot.limits.select(cell.robot.platform)
    for joint, value, least, most in zip(
        limits.joints, position, limits.lower, limits.upper, strict=True
    ):
        if not (math.isfinite(value) and least - ROUNDING <= value <= most + ROUNDING):
            raise UsageError(f"platform: {joint} {value:g}: must be from {least:g} to {most:g}")
    parts = model.arms[arm]
    R, p = model.platform.pose(position)
    flange = pin.SE3(R, p).inverse() * _pose(pose) * parts.T_flange_tcp.inverse()
    reached = parts.kinematics.postures(flange.rotation[None], flange.translation[None])
    return reached.q


def _pose(given: pin.SE3 | FloatArray) -> pin.SE3:
    """Convert a pose, or its matrix (4, 4), to a pose.

    Raises:
        UsageError: no pose.
    """
    try:
        matrix = np.asarray(getattr(given, "homogeneous", given), dtype=np.float64)
    except (TypeError, ValueError):
        matrix = np.empty(0)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise UsageError("pose: must be a pin.SE3 or a 4 x 4 matrix of finite numbers")
    R = matrix[:3, :3]
    rotated = np.allclose(product(R, R.T), np.eye(3), rtol=0.0, atol=ROUNDING)
    # The third row of a rotation is the cross product of the others; that of a reflection is its opposite.
    if not rotated or product(np.cross(R[0], R[1]), R[2]) < 0.0:
        raise UsageError(f"pose: {R.tolist()} is no rotation matrix to {ROUNDING:g}")
    if not np.allclose(matrix[3], (0.0, 0.0, 0.0, 1.0), rtol=0.0, atol=ROUNDING):
        raise UsageError(f"pose: last row {matrix[3].tolist()}: must be [0, 0, 0, 1]")
    return pin.SE3(R, matrix[:3, 3])
