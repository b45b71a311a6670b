"""Figure of a job: its cell, robot and targets from above and from behind."""

from __future__ import annotations

from collections.abc import Iterator

import coal
import numpy as np
import pinocchio as pin

from dualarm_cli.collision.solids import cell_solids
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinds.drawing import new_figure, rendered
from dualarm_cli.model.job import Job, JointTarget, PoseTarget
from dualarm_cli.model.robot import Robot
from dualarm_cli.report.figures.motion_figure import COLOURS

VIEWS = (("from above", (1, 0)), ("from behind", (1, 2)))
"""Title, and horizontal and vertical world axis of each view."""
MARKERS = {"pick": "o", "place": "s", "take": "o", "give": "s", "path": "."}
"""Markers by action; other actions have a diamond."""


def draw_cell(job: Job, kind: str) -> bytes:
    """Draw a job's cell with the robot at its start, and its targets, in two views.

    Seams are not drawn.

    Args:
        job: job.
        kind: one of FIGURE_KINDS.

    Raises:
        MissingDependencyError: matplotlib is not installed.
    """
    bodies, targets = list(_bodies(job)), _targets(job)
    figure = new_figure(9.0, 4.5)
    shown = np.vstack([*(points for colour, points in bodies if colour), *targets.values()])
    low, high = shown.min(axis=0) - 0.2, shown.max(axis=0) + 0.2  # margin [m]
    for axes, (title, (u, v)) in zip(figure.subplots(1, 2), VIEWS, strict=True):
        depth = 3 - u - v  # seen from above: highest last; from behind: nearest to the viewer last
        sign = 1.0 if depth == 2 else -1.0
        for colour, points in sorted(bodies, key=lambda body: sign * body[1][:, depth].max()):
            outline = _outline(points[:, [u, v]])
            axes.fill(*outline.T, facecolor=colour or "0.85", edgecolor="0.4", lw=0.5, alpha=0.6)
        for (arm, action), points in targets.items():
            style = {"color": COLOURS.get(arm, "0.2"), "marker": MARKERS.get(action, "D")}
            label = f"{arm} {action}"
            axes.plot(points[:, u], points[:, v], linestyle="", markersize=5, label=label, **style)
        names = "xyz"
        axes.set(title=title, xlabel=f"{names[u]} [m]", ylabel=f"{names[v]} [m]", aspect="equal")
        axes.set(xlim=(high[u], low[u]), ylim=(low[v], high[v]))
    if targets:
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=6)
    return rendered(figure, kind)


def _bodies(job: Job) -> Iterator[tuple[str, FloatArray]]:
    """Yield colour and points [m], shape (n, 3), of each solid at the start.

    Obstacles have no colour.
    """
    cell = job.cell
    model, data = _placed(cell.robot, job.start_joints)
    side = {joint: arm.name for arm in cell.robot.arms for joint in arm.joints}
    fixed = {obstacle.name for obstacle in cell.obstacles}
    for solid in cell_solids(cell, model, ()):
        pose = cell.base * data.oMi[solid.joint] * solid.pose
        points = _corners(solid.geometry) @ pose.rotation.T + pose.translation
        colour = COLOURS.get(side.get(model.names[solid.joint], ""), "0.55")
        if len(points):
            yield "" if solid.body in fixed else colour, points


def _targets(job: Job) -> dict[tuple[str, str], FloatArray]:
    """Collect positions of targets and points of paths [m], shape (n, 3), by arm and action."""
    rows: dict[tuple[str, str], list[FloatArray]] = {}
    for task in job.tasks:
        for stop in task.stops:
            row = rows.setdefault((task.arm, stop.action), [])
            if isinstance(stop.target, PoseTarget):
                row.append(stop.target.pose.translation)
            elif isinstance(stop.target, JointTarget):
                row.append(_tool(job, task.arm, stop.target.configurations[0]))
        for arm, path in ({} if task.path is None else task.path.paths).items():
            _, points = path.at(np.linspace(0.0, path.length, 60))
            rows.setdefault((arm, "path"), []).extend(points)
    return {key: np.array(row) for key, row in rows.items() if row}


def _tool(job: Job, arm: str, configuration: FloatArray) -> FloatArray:
    """Compute the tool's position [m] at a configuration of its arm."""
    robot, position = job.cell.robot, job.start_joints.copy()
    position[[robot.joints.index(joint) for joint in robot.arm(arm).joints]] = configuration
    model, data = _placed(robot, position)
    frame = model.getFrameId(robot.arm(arm).flange, pin.FrameType.BODY)
    pose = job.cell.base * pin.updateFramePlacement(model, data, frame) * job.cell.tools[arm].tcp
    return np.asarray(pose.translation)


def _placed(robot: Robot, position: FloatArray) -> tuple[pin.Model, pin.Data]:
    """Build the robot's model with its joints at a position [rad or m], shape (n,)."""
    model = pin.buildModelFromXML(robot.urdf)
    data = model.createData()
    order = [robot.joints.index(name) for name in model.names[1:]]
    pin.forwardKinematics(model, data, position[order])
    return model, data


def _corners(geometry: coal.CollisionGeometry) -> FloatArray:
    """Return points whose hull is a solid [m], shape (n, 3); none for a half-space."""
    if isinstance(geometry, coal.Box):
        signs = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(-1, 3)
        return signs * np.asarray(geometry.halfSide).ravel()
    if isinstance(geometry, coal.Convex):
        return np.array(geometry.points())
    if isinstance(geometry, coal.Halfspace):
        return np.empty((0, 3))
    half = np.array([0.0, 0.0, getattr(geometry, "halfLength", 0.0)])
    turn, rise = np.meshgrid(np.arange(24) * (np.pi / 12), np.arange(-6, 7) * (np.pi / 12))
    ball = np.stack([np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise)], -1)
    ends = (1.0, 1.0, 0.0) if isinstance(geometry, coal.Cylinder) else np.ones(3)
    points = geometry.radius * (ball.reshape(-1, 3) * ends)
    return np.vstack([points - half, points + half])


def _outline(points: FloatArray) -> FloatArray:
    """Order the corners of the convex hull of points, shape (n, 2)."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return points[ConvexHull(points).vertices]
    except QhullError:  # a plate seen from its edge
        return points[[points[:, 0].argmin(), points[:, 0].argmax()]]
