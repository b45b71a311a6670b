"""Scene of a cell: bodies that move with joints, and the solids on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field, replace
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from dualarm_cli.collision.solids import link_solids
from dualarm_cli.files.robots.visual_meshes import drawn_meshes
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.robot import Robot
from dualarm_cli.model.shape import Hull, Shape
from dualarm_cli.page.packed import packed
from dualarm_cli.records import dataclass

WORLD_BODY = -1
"""Body number of the world."""


@dataclass
class DrawnHulls:
    """Convex hulls of meshes, each written once."""

    rows: list[dict[str, str]] = field(default_factory=list)
    """Rows of the page's data."""
    _numbers: dict[int, int] = field(default_factory=dict)
    _kept: list[Hull] = field(default_factory=list)

    def number(self, hull: Hull) -> int:
        """Return the number of a hull; a new hull is added."""
        if id(hull) not in self._numbers:
            self._numbers[id(hull)] = len(self.rows)
            self._kept.append(hull)  # so that no other hull gets its id
            corners, triangles = packed(hull.corners, "f32"), packed(hull.triangles, "u32")
            self.rows.append({"corners": corners, "triangles": triangles})
        return self._numbers[id(hull)]


def placed(pose: pin.SE3) -> dict[str, list[float]]:
    """Encode a pose for the page: position [m] and quaternion x, y, z, w."""
    quaternion = pin.Quaternion(pose.rotation).coeffs()
    return {"xyz": pose.translation.tolist(), "quat": quaternion.tolist()}


def drawn(shape: Shape, holder: pin.SE3, hulls: DrawnHulls) -> dict[str, Any]:
    """Encode a solid for the page.

    Args:
        shape: of the data model.
        holder: the frame that it is posed in, in the body's frame.
        hulls: where its hull is put, if it has one.
    """
    number = None if shape.hull is None else hulls.number(shape.hull)
    row = {"kind": shape.kind, "size": list(shape.size), "hull": number}
    return row | placed(holder * shape.pose)


def bodies(model: pin.Model, robot: Robot, base: pin.SE3) -> list[dict[str, Any]]:
    """List the root link and a body per moving joint, in pinocchio's joint numbering.

    Args:
        model: of the robot's URDF.
        robot: whose joints move.
        base: pose of its root link in the world.
    """
    data = model.createData()
    pin.forwardKinematics(model, data, pin.neutral(model))
    root = {"name": "", "parent": WORLD_BODY, "joint": -1, "axis": [0.0, 0.0, 1.0], "slides": False}
    rows: list[dict[str, Any]] = [root | placed(base)]
    for number in range(1, model.njoints):
        motion = np.asarray(data.joints[number].S).ravel()
        slides = bool(np.any(motion[:3]))
        rows.append(
            {
                "name": model.names[number],
                "parent": int(model.parents[number]),
                "joint": robot.joints.index(model.names[number]),
                "axis": (motion[:3] if slides else motion[3:]).tolist(),
                "slides": slides,
            }
            | placed(model.jointPlacements[number])
        )
    return rows


def solids(model: pin.Model, cell: Cell, hulls: DrawnHulls) -> list[dict[str, Any]]:
    """List the solids of links, permanently mounted tools and obstacles.

    Args:
        model: of the robot's URDF.
        cell: of the data model.
        hulls: where hulls of meshes are put.
    """
    robot = cell.robot
    side = {joint: arm.name for arm in robot.arms for joint in arm.joints}
    rows = []
    for solid in link_solids(model, replace(robot, meshes={})):
        shape = Shape(*_form(solid.geometry), solid.pose)
        about = {"body": solid.joint, "name": solid.body, "role": "link"}
        about["arm"] = side.get(model.names[solid.joint], "")
        rows.append(about | drawn(shape, pin.SE3.Identity(), hulls))
    for name, shapes in robot.meshes.items():
        frame = model.frames[model.getFrameId(name, pin.FrameType.BODY)]
        about = {"body": frame.parentJoint, "name": name, "role": "link"}
        about["arm"] = side.get(model.names[frame.parentJoint], "")
        rows += [about | drawn(shape, frame.placement, hulls) for shape in shapes]
    for arm, tool in cell.tools.items():
        frame = flange(model, robot, arm)
        about = {"body": frame.parentJoint, "name": f"{arm}_tool", "role": "tool", "arm": arm}
        rows += [about | drawn(shape, frame.placement, hulls) for shape in tool.shapes]
    for obstacle in cell.obstacles:
        about = {"body": WORLD_BODY, "name": obstacle.name, "role": "obstacle", "arm": ""}
        rows.append(about | drawn(obstacle.shape, pin.SE3.Identity(), hulls))
    return rows


def visuals(model: pin.Model, robot: Robot, hulls: DrawnHulls) -> list[dict[str, Any]]:
    """List the visual meshes of the links, simplified; unreadable files are left out.

    Args:
        model: of the robot's URDF.
        robot: of the data model.
        hulls: where surfaces are put.
    """
    side = {joint: arm.name for arm in robot.arms for joint in arm.joints}
    surfaces = drawn_meshes(robot.visuals)
    rows = []
    for mesh in robot.visuals:
        surface = surfaces.get((mesh.file, mesh.scale))
        if surface is None:
            continue
        frame = model.frames[model.getFrameId(mesh.link, pin.FrameType.BODY)]
        about = {"body": frame.parentJoint, "name": mesh.link, "role": "link"}
        about["arm"] = side.get(model.names[frame.parentJoint], "")
        rows.append(about | drawn(Shape("mesh", (), mesh.pose, surface), frame.placement, hulls))
    return rows


def tcp(model: pin.Model, cell: Cell, arm: str) -> tuple[int, pin.SE3]:
    """Locate an arm's flange-mounted tool centre point: body number, pose in its frame."""
    frame = flange(model, cell.robot, arm)
    return frame.parentJoint, frame.placement * cell.tools[arm].tcp


def drawn_hands(model: pin.Model, cell: Cell) -> list[str]:
    """List the arms whose tool is the robot's own hand.

    Its links have shapes, and the tool has none.
    """
    drawn = {solid.body for solid in link_solids(model, replace(cell.robot, meshes={}))}
    drawn |= {*cell.robot.meshes, *(mesh.link for mesh in cell.robot.visuals)}
    hands = cell.robot.hands.items()
    return [arm for arm, links in hands if not cell.tools[arm].shapes and drawn & set(links)]


def flange(model: pin.Model, robot: Robot, arm: str) -> Any:
    """Look up the frame of an arm's flange in the robot's model."""
    return model.frames[model.getFrameId(robot.arm(arm).flange, pin.FrameType.BODY)]


def _form(geometry: coal.CollisionGeometry) -> tuple[Any, tuple[float, ...]]:
    """Return the kind and sizes of a primitive, as in `Shape`."""
    if isinstance(geometry, coal.Box):
        return "box", tuple((2.0 * np.asarray(geometry.halfSide).ravel()).tolist())
    if isinstance(geometry, coal.Sphere):
        return "sphere", (geometry.radius,)
    kind = "cylinder" if isinstance(geometry, coal.Cylinder) else "capsule"
    return kind, (geometry.radius, 2.0 * geometry.halfLength)


def poses_at(
    model: pin.Model, robot: Robot, base: pin.SE3, positions: FloatArray
) -> Sequence[pin.SE3]:
    """Compute the world poses of all bodies at joint positions (joints,).

    Bodies are in pinocchio's joint numbering.
    """
    q = np.empty(model.nq)
    q[[model.idx_qs[model.getJointId(name)] for name in robot.joints]] = positions
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    return [base * pose for pose in data.oMi]
