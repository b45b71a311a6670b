"""Default gripper of a cell without tools: flange direction, and an existing hand."""

from __future__ import annotations

from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin

from dualarm_cli.collision.solids import (
    cell_solids,
    geometry_model,
    link_solids,
    pairs_that_must_keep_apart,
)
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.kinematics.cell_model import general_arms
from dualarm_cli.kinematics.general_arm import GeneralArm
from dualarm_cli.model.cell import Cell, Tool
from dualarm_cli.model.robot import Arm
from dualarm_cli.model.shape import Shape
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class ToolSettings:
    """Dimensions of a proposed tool, and settings of its search."""

    length: float = 0.12
    """Maximum length of a gripper on a bare flange [m]."""
    length_share: float = 0.13
    """Maximum length of a gripper as a fraction of the reach."""
    radius_share: float = 0.25
    """Radius of a gripper as a fraction of its length."""
    hand: float = 0.06
    """Extent of shapes beyond the flange from which they count as a hand [m]."""
    beyond: float = 0.01
    """Distance of the tool centre point beyond the hand's shapes [m]."""
    finger: float = 0.04
    """Length of the capsule at the end of a hand [m]."""
    longer: tuple[float, ...] = (0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0)
    """Candidate distances between flange and gripper, relative to the gripper's length.

    The gripper must not touch the arm's own shapes.
    """
    postures: int = 200
    """Number of random postures in which a gripper is tested against its arm."""
    touched: float = 0.3
    """Maximum fraction of tested postures in which gripper and arm touch."""
    rounded: float = 0.005
    """Step to which dimensions of a gripper are rounded [m].

    A fifth of it for arms shorter than `short`.
    """
    short: float = 0.3
    """Maximum reach of a short arm [m]."""
    along: float = 0.6
    """Minimum cosine at which a flange points along the last joint's axis."""


TOOL = ToolSettings()

_DIRECTIONS = {
    "+x": ((1.0, 0.0, 0.0), (0.0, 90.0, 0.0)),
    "-x": ((-1.0, 0.0, 0.0), (0.0, -90.0, 0.0)),
    "+y": ((0.0, 1.0, 0.0), (-90.0, 0.0, 0.0)),
    "-y": ((0.0, -1.0, 0.0), (90.0, 0.0, 0.0)),
    "+z": ((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)),
    "-z": ((0.0, 0.0, -1.0), (180.0, 0.0, 0.0)),
}
"""Axes of a flange, and roll, pitch, yaw from z to them [deg]."""


@dataclass(frozen=True)
class ProposedTool:
    """Gripper that points straight out of a flange."""

    axis: str
    """Axis of the flange that points out, such as +z."""
    start: float
    """Distance from the flange to the gripper's begin [m]."""
    length: float
    """Length from the gripper's begin to the tool centre point [m]."""
    radius: float
    """Radius of the gripper's capsule [m]."""
    hand: bool
    """Flag of a robot with its own hand: the capsule is at its end."""

    @property
    def rpy(self) -> tuple[float, float, float]:
        """Roll, pitch and yaw of the tool's frame in the flange's [deg]."""
        return _DIRECTIONS[self.axis][1]

    def along(self, distance: float) -> pin.SE3:
        """Compute the tool frame at a distance from the flange [m]."""
        turn = pin.rpy.rpyToMatrix(*np.radians(self.rpy))
        return pin.SE3(turn, distance * np.array(_DIRECTIONS[self.axis][0]))

    @property
    def tool(self) -> Tool:
        """Proposed tool in the data model."""
        size = (self.radius, self.length - 2.0 * self.radius)
        shape = Shape("capsule", size, self.along(self.start + 0.5 * self.length))
        return Tool(self.along(self.start + self.length), 0.0, (shape,))


def with_tools(cell: Cell) -> tuple[Cell, dict[str, ProposedTool]]:
    """Mount a proposed tool on every arm of a cell; returns the cell and the tools.

    Args:
        cell: the cell, whose own tools are ignored.
    """
    tools = proposed_tools(cell)
    return replace(cell, tools={name: proposed.tool for name, proposed in tools.items()}), tools


def proposed_tools(cell: Cell) -> dict[str, ProposedTool]:
    """Propose a tool for every arm of a cell.

    Args:
        cell: robot and base.
    """
    kinematics = general_arms(cell)
    return {
        arm.name: _tool(cell, arm, _outward(kinematics[arm.name]), kinematics[arm.name].length)
        for arm in cell.robot.arms
    }


def _outward(arm: GeneralArm) -> str:
    """Select the axis of the flange that points away from the wrist.

    It is the last joint's axis, unless the flange is off to its side. Of its two directions the one from the wrist
    centre to the flange is taken, or +.
    """
    R, p = arm.forward(np.zeros((1, arm.axes)))
    away = product(R[0].T, p[0] - arm.meeting_point)
    _, _, jacobian = arm.linearised(np.zeros((1, arm.axes)))
    last = product(R[0].T, jacobian[0, 3:, -1])
    length = float(norm(away))
    direction = last * np.sign(last[np.argmax(np.abs(last))])
    if length > 1e-3:
        cosine = float(product(away, last)) / length
        direction = last * np.sign(cosine) if abs(cosine) >= TOOL.along else away
    return max(
        _DIRECTIONS, key=lambda axis: round(float(product(direction, _DIRECTIONS[axis][0])), 6)
    )


def _tool(cell: Cell, arm: Arm, axis: str, reach: float) -> ProposedTool:
    """Propose the tool of an arm from its flange's outward axis."""
    step = TOOL.rounded if reach > TOOL.short else 0.2 * TOOL.rounded
    extent = _extent(cell, arm, ProposedTool(axis, 0.0, 0.0, 0.0, False).along(0.0))
    if extent > TOOL.hand:
        end = step * float(np.ceil(round((extent + TOOL.beyond) / step, 6)))
        return ProposedTool(axis, end - TOOL.finger, TOOL.finger, 0.01, True)
    length = step * float(np.ceil(round(min(TOOL.length, TOOL.length_share * reach) / step, 6)))
    radius = step * round(TOOL.radius_share * length / step)
    candidates = [
        ProposedTool(axis, step * round(share * length / step), length, radius, False)
        for share in TOOL.longer
    ]
    return next((tool for tool in candidates if _has_room(cell, arm, tool)), candidates[0])


def _has_room(cell: Cell, arm: Arm, tool: ProposedTool) -> bool:
    """Check that a tool touches its arm in few postures."""
    model = pin.buildModelFromXML(cell.robot.urdf)
    whole = replace(cell, tools={arm.name: tool.tool}, obstacles=())
    solids = cell_solids(whole, model, ())
    arm_joints = {model.getJointId(joint) for joint in arm.joints}
    pairs = [
        (pair.first, pair.second)
        for pair in pairs_that_must_keep_apart(model, solids, whole)
        if {solids[pair.first].joint, solids[pair.second].joint} <= arm_joints
        and f"{arm.name}_tool" in (solids[pair.first].body, solids[pair.second].body)
    ]
    if not pairs:
        return True
    geometry, data = geometry_model(solids, pairs), model.createData()
    results = pin.GeometryData(geometry)
    low = np.maximum(model.lowerPositionLimit, -np.pi)
    high = np.minimum(model.upperPositionLimit, np.pi)
    postures = np.random.default_rng(0).uniform(low, high, (TOOL.postures, model.nq))
    collisions = sum(
        pin.computeCollisions(model, data, geometry, results, q, True) for q in postures
    )
    return collisions <= TOOL.touched * TOOL.postures


def _extent(cell: Cell, arm: Arm, T_flange_turned: pin.SE3) -> float:
    """Compute the extent of shapes beyond a flange, along z [m]."""
    model = pin.buildModelFromXML(cell.robot.urdf)
    flange = model.frames[model.getFrameId(arm.flange, pin.FrameType.BODY)]
    T = (flange.placement * T_flange_turned).inverse()
    extent = 0.0
    for solid in link_solids(model, cell.robot):
        if solid.joint == flange.parentJoint:
            pose = T * solid.pose
            body = coal.CollisionObject(solid.geometry, pose.rotation, pose.translation)
            extent = max(extent, float(body.getAABB().max_[2]))
    return extent
