"""Visualisation markers of the cell and its events, and the tree of link frames.

Markers are rows of visualization_msgs/Marker. The links of a schedule's URDF form a tree of frames, as in tf.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from dualarm_cli.exporting.cell_urdf import GROUND
from dualarm_cli.formats.request import ExportRequest, stamp
from dualarm_cli.formats.sampling import NANO
from dualarm_cli.formats.solid_meshes import hull_mesh
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.schedule import Event, ScheduleRobot
from dualarm_cli.page.carried_objects import carried_objects
from dualarm_cli.page.scene import WORLD_BODY, DrawnHulls, solids
from dualarm_cli.records import dataclass
from dualarm_cli.verification.as_done import job_as_done

CUBE, SPHERE, CYLINDER, TEXT, TRIANGLES = 1, 2, 3, 9, 11
"""Marker types."""
COLOURS = {
    "obstacle": (0.55, 0.55, 0.6, 0.8),
    "link": (0.8, 0.8, 0.8, 1.0),
    "part": (0.9, 0.55, 0.2, 1.0),
    "tool": (0.3, 0.5, 0.8, 1.0),
    "event": (0.1, 0.1, 0.1, 1.0),
}
"""Red, green, blue and opacity by namespace."""
TEXT_HEIGHT = 0.05
"""Height of an event's text [m]."""
TEXT_TIME = 1
"""Display time of an event's text [s]."""

Rows = list[dict[str, Any]]


def marker_rows(
    request: ExportRequest, world: str, frames: Sequence[LinkFrame]
) -> Iterator[tuple[int, Rows]]:
    """Yield times [ns] and the markers set then.

    Markers show obstacles, hulls of links, parts, changed tools and events. A part is fixed to the frame of the link
    that carries it, or to the world; on a conveyor it is set anew at the sampling rate.

    Args:
        request: with a job.
        world: name of the fixed frame.
        frames: of the links.
    """
    schedule, job = request.schedule, request.job
    assert job is not None
    done, hulls = job_as_done(schedule, job), DrawnHulls()
    model = pin.buildModelFromXML(job.cell.robot.urdf)
    names = _body_names(model, frames, world)
    standing = [
        _marker(solid, (solid["role"], k), names[solid["body"]], 0, hulls)
        for k, solid in enumerate(solids(model, job.cell, hulls))
        if solid["role"] == "obstacle" or (solid["role"] == "link" and solid["hull"] is not None)
    ]
    if standing:
        yield 0, standing
    for number, carried in enumerate(carried_objects(schedule, done, hulls)):
        yield from _carried(carried, number, names, request, hulls)
    for number, event in enumerate(schedule.events):
        time = round(event.time * NANO)
        yield time, [_words(event, number, time, world)]


def _body_names(
    model: pin.Model, frames: Sequence[LinkFrame], world: str
) -> dict[int, tuple[str, pin.SE3]]:
    """Map each body number to its link frame and its pose in that frame."""
    root = next(frame for frame in frames if frame.parent == world)
    links = {frame.joint: frame.name for frame in frames if frame.joint}
    frames_by_body = {WORLD_BODY: (world, pin.SE3.Identity()), 0: (root.name, pin.SE3.Identity())}
    for number in range(1, model.njoints):
        link = links[model.names[number]]
        placement = model.frames[model.getFrameId(link, pin.FrameType.BODY)].placement
        frames_by_body[number] = (link, placement.inverse())
    return frames_by_body


def _carried(
    carried: Mapping[str, Any],
    number: int,
    names: Mapping[int, tuple[str, pin.SE3]],
    request: ExportRequest,
    hulls: DrawnHulls,
) -> Iterator[tuple[int, Rows]]:
    """Yield the markers of a part or changed tool at each new carrier."""
    steps = carried["keyframes"]
    ends = [*(step["time"] for step in steps[1:]), request.schedule.duration]
    for step, end in zip(steps, ends, strict=True):
        times = [step["time"]]
        if any(step["velocity"]):
            count = max(1, round((end - step["time"]) * request.rate))
            times = np.linspace(step["time"], end, count, endpoint=False).tolist()
        for time in times:
            offset = (time - step["time"]) * np.array(step["velocity"])
            pose = pin.SE3(np.eye(3), offset) * _pose(step)
            frame, body = names[step["body"]]
            holder = (frame, body * pose)
            instant = round(time * NANO)
            rows = [
                _marker(solid, (carried["role"], number * 1000 + k), holder, instant, hulls)
                for k, solid in enumerate(carried["solids"])
            ]
            if rows:
                yield instant, rows


def _marker(
    solid: Mapping[str, Any],
    identity: tuple[str, int],
    holder: tuple[str, pin.SE3],
    time: int,
    hulls: DrawnHulls,
) -> dict[str, Any]:
    """Build the marker of a solid.

    A capsule becomes a cylinder of the same total length.
    """
    frame, pose = holder
    pose = pose * _pose(solid)
    size, kind = solid["size"], solid["kind"]
    about: dict[str, Any] = {"type": TRIANGLES, "scale": [1.0, 1.0, 1.0]}
    if solid["hull"] is not None:
        about["points"] = triangle_corners(hulls, solid["hull"])
    elif kind == "box":
        about = {"type": CUBE, "scale": size}
    elif kind == "sphere":
        about = {"type": SPHERE, "scale": [2.0 * size[0]] * 3}
    elif kind == "half_space":
        side, thickness = GROUND
        about = {"type": CUBE, "scale": [side, side, thickness]}
        pose = pose * pin.SE3(np.eye(3), np.array([0.0, 0.0, -thickness / 2.0]))
    else:
        length = size[1] + (2.0 * size[0] if kind == "capsule" else 0.0)
        about = {"type": CYLINDER, "scale": [2.0 * size[0], 2.0 * size[0], length]}
    return _row(identity, frame, time, pose, about)


def _words(event: Event, number: int, time: int, world: str) -> dict[str, Any]:
    """Build the text marker at the tool during an event."""
    about = {
        "type": TEXT,
        "scale": [0.0, 0.0, TEXT_HEIGHT],
        "text": f"{event.arm}: {event.action} {event.task}{f', {event.signal}' * bool(event.signal)}",
        "lifetime": {"sec": TEXT_TIME, "nanosec": 0},
    }
    return _row(("event", number), world, time, event.pose, about)


def _row(
    identity: tuple[str, int], frame: str, time: int, pose: pin.SE3, about: dict[str, Any]
) -> dict[str, Any]:
    quaternion = pin.Quaternion(pose.rotation).coeffs().tolist()
    return about | {
        "header": {"stamp": stamp(time), "frame_id": frame},
        "ns": identity[0],
        "id": identity[1],
        "frame_locked": True,
        "pose": {
            "position": dict(zip("xyz", pose.translation.tolist(), strict=True)),
            "orientation": dict(zip("xyzw", quaternion, strict=True)),
        },
        "scale": dict(zip("xyz", about["scale"], strict=True)),
        "color": dict(zip("rgba", COLOURS[identity[0]], strict=True)),
    }


def _pose(row: Mapping[str, Any]) -> pin.SE3:
    """Return the pose of a row of the page's data."""
    return pin.SE3(pin.Quaternion(np.array(row["quat"])).matrix(), np.array(row["xyz"]))


def triangle_corners(hulls: DrawnHulls, number: int) -> list[dict[str, float]]:
    """List the corners of a hull's triangles, one after another."""
    corners, triangles = hull_mesh(hulls, number)
    return [dict(zip("xyz", row, strict=True)) for row in corners[triangles.ravel()].tolist()]


@dataclass(frozen=True)
class LinkFrame:
    """Link and its pose in its parent link."""

    name: str
    """Name of the link."""
    parent: str
    """Name of the parent link; of the root link, the world frame."""
    pose: pin.SE3
    """Pose of the link's frame in the parent's, at position 0 of its joint."""
    joint: str = ""
    """Name of the moving joint between link and parent; empty for a fixed link."""
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Axis of the joint in the link's frame."""
    slides: bool = False
    """Flag of a joint that slides along its axis instead of turning about it."""

    def poses(self, positions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute the link's poses in its parent.

        Args:
            positions: of its joint [rad or m], shape (m,).

        Returns:
            Translations (m, 3) [m] and quaternions x, y, z, w (m, 4).
        """
        count, axis = len(positions), np.array(self.axis)
        translation = np.tile(self.pose.translation, (count, 1))
        rotation = pin.Quaternion(self.pose.rotation)
        if self.slides or not self.joint:
            if self.joint:
                translation = translation + positions[:, None] * (self.pose.rotation @ axis)
            return translation, np.tile(rotation.coeffs(), (count, 1))
        s, c = np.sin(positions / 2.0), np.cos(positions / 2.0)
        vector, scalar = rotation.coeffs()[:3], rotation.coeffs()[3]
        turned = scalar * s[:, None] * axis + c[:, None] * vector
        turned = turned + s[:, None] * np.cross(vector, axis)
        return translation, np.column_stack([turned, scalar * c - s * (vector @ axis)])


def link_frames(robot: ScheduleRobot) -> tuple[str, list[LinkFrame]]:
    """Build the tree of a robot's link frames.

    Args:
        robot: of a schedule.

    Returns:
        Name of the fixed frame, and the frames of all links, parents first.
    """
    model = pin.buildModelFromXML(robot.urdf)
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    links = [k for k, frame in enumerate(model.frames) if frame.type == pin.FrameType.BODY]
    names = {model.frames[k].name for k in links}
    world = next(name for name in ("world", "cell", "cell_world") if name not in names)
    link_tree = []
    for k in links:
        frame = model.frames[k]
        above = frame.parentFrame
        while above > 0 and model.frames[above].type != pin.FrameType.BODY:
            above = model.frames[above].parentFrame
        if above == 0:
            link_tree.append(LinkFrame(frame.name, world, robot.base * data.oMf[k]))
            continue
        parent = model.frames[above]
        pose = data.oMf[above].actInv(data.oMf[k])
        if frame.parentJoint == parent.parentJoint:
            link_tree.append(LinkFrame(frame.name, parent.name, pose))
            continue
        motion = np.asarray(data.joints[frame.parentJoint].S).ravel()
        slides = bool(np.any(motion[:3]))
        about = frame.placement.rotation.T @ (motion[:3] if slides else motion[3:])
        axis = (float(about[0]), float(about[1]), float(about[2]))
        joint = model.names[frame.parentJoint]
        link_tree.append(LinkFrame(frame.name, parent.name, pose, joint, axis, slides))
    return world, link_tree
