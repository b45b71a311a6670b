"""What is in the cell besides the robot, and what happens there, as visualization_msgs/Marker."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from dualarm_cli.formats.frames import LinkFrame
from dualarm_cli.formats.request import ExportRequest, stamp
from dualarm_cli.formats.sampling import NANO
from dualarm_cli.formats.solid_meshes import GROUND, hull_mesh
from dualarm_cli.model.schedule import Event
from dualarm_cli.page.scene import WORLD_BODY, DrawnHulls, solids
from dualarm_cli.page.things import things
from dualarm_cli.verification.as_done import job_as_done

CUBE, SPHERE, CYLINDER, TEXT, TRIANGLES = 1, 2, 3, 9, 11
"""Types of markers."""
COLOURS = {
    "obstacle": (0.55, 0.55, 0.6, 0.8),
    "link": (0.8, 0.8, 0.8, 1.0),
    "part": (0.9, 0.55, 0.2, 1.0),
    "tool": (0.3, 0.5, 0.8, 1.0),
    "event": (0.1, 0.1, 0.1, 1.0),
}
"""Red, green, blue and opacity by namespace."""
TEXT_HEIGHT = 0.05
"""Of the words at an event [m]."""
TEXT_TIME = 1
"""How long they stay [s]."""

Rows = list[dict[str, Any]]


def marker_rows(
    request: ExportRequest, world: str, frames: Sequence[LinkFrame]
) -> Iterator[tuple[int, Rows]]:
    """Yields times [ns] and the markers that are set then: obstacles, hulls of links, parts, changed tools, events.

    A part is fixed to the frame of the link that carries it, or to the world; on a conveyor it is set anew at the rate.

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
    for number, thing in enumerate(things(schedule, done, hulls)):
        yield from _thing(thing, number, names, request, hulls)
    for number, event in enumerate(schedule.events):
        time = round(event.time * NANO)
        yield time, [_words(event, number, time, world)]


def _body_names(
    model: pin.Model, frames: Sequence[LinkFrame], world: str
) -> dict[int, tuple[str, pin.SE3]]:
    """Returns, by a body's number, the frame that it is and where the body is in that frame."""
    root = next(frame for frame in frames if frame.parent == world)
    own = {frame.joint: frame.name for frame in frames if frame.joint}
    found = {WORLD_BODY: (world, pin.SE3.Identity()), 0: (root.name, pin.SE3.Identity())}
    for number in range(1, model.njoints):
        link = own[model.names[number]]
        placement = model.frames[model.getFrameId(link, pin.FrameType.BODY)].placement
        found[number] = (link, placement.inverse())
    return found


def _thing(
    thing: Mapping[str, Any],
    number: int,
    names: Mapping[int, tuple[str, pin.SE3]],
    request: ExportRequest,
    hulls: DrawnHulls,
) -> Iterator[tuple[int, Rows]]:
    """Yields the markers of a part or a changed tool, each time that somebody else holds it."""
    steps = thing["keyframes"]
    ends = [*(step["time"] for step in steps[1:]), request.schedule.duration]
    for step, end in zip(steps, ends, strict=True):
        times = [step["time"]]
        if any(step["velocity"]):
            count = max(1, round((end - step["time"]) * request.rate))
            times = np.linspace(step["time"], end, count, endpoint=False).tolist()
        for time in times:
            gone = (time - step["time"]) * np.array(step["velocity"])
            here = pin.SE3(np.eye(3), gone) * _pose(step)
            frame, body = names[step["body"]]
            holder = (frame, body * here)
            instant = round(time * NANO)
            rows = [
                _marker(solid, (thing["role"], number * 1000 + k), holder, instant, hulls)
                for k, solid in enumerate(thing["solids"])
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
    """Returns the marker of a solid; a capsule is the cylinder of its whole length."""
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
    """Returns the words that stand at the tool while an event happens."""
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
    """Returns the pose of a row of the page's data."""
    return pin.SE3(pin.Quaternion(np.array(row["quat"])).matrix(), np.array(row["xyz"]))


def triangle_corners(hulls: DrawnHulls, number: int) -> list[dict[str, float]]:
    """Returns the corners of a hull's triangles, one after another."""
    corners, triangles = hull_mesh(hulls, number)
    return [dict(zip("xyz", row, strict=True)) for row in corners[triangles.ravel()].tolist()]
