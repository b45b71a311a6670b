"""The tool that is assumed where no cell file names one: which way a flange points, and what it carries already."""

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
    """Dimensions of a proposed tool, and numbers of its search."""

    length: float = 0.12
    """Maximum length of a gripper on a bare flange [m]."""
    length_share: float = 0.13
    """Maximum length of a gripper on a bare flange as share of the reach."""
    radius_share: float = 0.25
    """Radius of a gripper as a share of its length."""
    hand: float = 0.06
    """Shapes that stand out farther than this from the flange are a hand [m]."""
    beyond: float = 0.01
    """Distance of the tool centre point beyond the hand's shapes [m]."""
    finger: float = 0.04
    """Length of the capsule at the end of a hand [m]."""
    longer: tuple[float, ...] = (0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0)
    """Distances between flange and gripper that are tried, relative to the gripper's length.

    The arm's own shapes must leave it room.
    """
    postures: int = 200
    """Number of random postures in which a gripper is tested against its arm."""
    touched: float = 0.3
    """Largest share of tested postures in which gripper and arm may touch."""
    rounded: float = 0.005
    """Step to which dimensions of a gripper are rounded [m].

    It is a fifth of this for arms shorter than `short`.
    """
    short: float = 0.3
    """Reach up to which an arm is short [m]."""
    along: float = 0.6
    """Cosine from which on a flange is taken to point along the last joint's axis."""


TOOL = ToolSettings()

_DIRECTIONS = {
    "+x": ((1.0, 0.0, 0.0), (0.0, 90.0, 0.0)),
    "-x": ((-1.0, 0.0, 0.0), (0.0, -90.0, 0.0)),
    "+y": ((0.0, 1.0, 0.0), (-90.0, 0.0, 0.0)),
    "-y": ((0.0, -1.0, 0.0), (90.0, 0.0, 0.0)),
    "+z": ((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)),
    "-z": ((0.0, 0.0, -1.0), (180.0, 0.0, 0.0)),
}
"""Axes of a flange, and the turns (roll, pitch, yaw) [deg] that take z there."""


@dataclass(frozen=True)
class ProposedTool:
    """A gripper that points straight out of a flange."""

    axis: str
    """Which axis of the flange points out, such as +z."""
    start: float
    """Where the gripper begins along it [m]."""
    length: float
    """From there to the tool centre point [m]."""
    radius: float
    """Of the capsule between the two [m]."""
    hand: bool
    """Whether the robot's own shapes stand out from the flange: the capsule is at their end."""

    @property
    def rpy(self) -> tuple[float, float, float]:
        """Roll, pitch and yaw of the tool's frame in the flange's [deg]."""
        return _DIRECTIONS[self.axis][1]

    def along(self, distance: float) -> pin.SE3:
        """Returns the tool's frame moved to a distance from the flange [m], in the flange frame."""
        turn = pin.rpy.rpyToMatrix(*np.radians(self.rpy))
        return pin.SE3(turn, distance * np.array(_DIRECTIONS[self.axis][0]))

    @property
    def tool(self) -> Tool:
        """In the data model."""
        size = (self.radius, self.length - 2.0 * self.radius)
        shape = Shape("capsule", size, self.along(self.start + 0.5 * self.length))
        return Tool(self.along(self.start + self.length), 0.0, (shape,))


def with_tools(cell: Cell) -> tuple[Cell, dict[str, ProposedTool]]:
    """Returns a cell with a proposed tool on every arm, and these tools.

    Args:
        cell: its own tools are not looked at.
    """
    tools = proposed_tools(cell)
    return replace(cell, tools={name: one.tool for name, one in tools.items()}), tools


def proposed_tools(cell: Cell) -> dict[str, ProposedTool]:
    """Returns a tool for every arm of a cell.

    Args:
        cell: the robot and where it stands.
    """
    kinematics = general_arms(cell)
    return {
        arm.name: _tool(cell, arm, _outward(kinematics[arm.name]), kinematics[arm.name].length)
        for arm in cell.robot.arms
    }


def _outward(arm: GeneralArm) -> str:
    """Returns the axis of the flange that points away from the wrist.

    It is the last joint's axis, unless the flange is off to its side; of two ways that of the wrist's centre to the
    flange, or +.
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
    """Returns the tool of an arm whose flange points along one of its axes."""
    step = TOOL.rounded if reach > TOOL.short else 0.2 * TOOL.rounded
    out = _extent(cell, arm, ProposedTool(axis, 0.0, 0.0, 0.0, False).along(0.0))
    if out > TOOL.hand:
        end = step * float(np.ceil(round((out + TOOL.beyond) / step, 6)))
        return ProposedTool(axis, end - TOOL.finger, TOOL.finger, 0.01, True)
    length = step * float(np.ceil(round(min(TOOL.length, TOOL.length_share * reach) / step, 6)))
    radius = step * round(TOOL.radius_share * length / step)
    tries = [
        ProposedTool(axis, step * round(share * length / step), length, radius, False)
        for share in TOOL.longer
    ]
    return next((one for one in tries if _has_room(cell, arm, one)), tries[0])


def _has_room(cell: Cell, arm: Arm, tool: ProposedTool) -> bool:
    """Returns whether a tool touches the arm that carries it in few postures."""
    model = pin.buildModelFromXML(cell.robot.urdf)
    whole = replace(cell, tools={arm.name: tool.tool}, obstacles=())
    solids = cell_solids(whole, model, ())
    own = {model.getJointId(joint) for joint in arm.joints}
    pairs = [
        (pair.first, pair.second)
        for pair in pairs_that_must_keep_apart(model, solids, whole)
        if {solids[pair.first].joint, solids[pair.second].joint} <= own
        and f"{arm.name}_tool" in (solids[pair.first].body, solids[pair.second].body)
    ]
    if not pairs:
        return True
    geometry, data = geometry_model(solids, pairs), model.createData()
    results = pin.GeometryData(geometry)
    low = np.maximum(model.lowerPositionLimit, -np.pi)
    high = np.minimum(model.upperPositionLimit, np.pi)
    postures = np.random.default_rng(0).uniform(low, high, (TOOL.postures, model.nq))
    touched = sum(pin.computeCollisions(model, data, geometry, results, q, True) for q in postures)
    return touched <= TOOL.touched * TOOL.postures


def _extent(cell: Cell, arm: Arm, T_flange_turned: pin.SE3) -> float:
    """Returns how far the robot's shapes stand out from a flange along the z axis of a turned frame [m]."""
    model = pin.buildModelFromXML(cell.robot.urdf)
    flange = model.frames[model.getFrameId(arm.flange, pin.FrameType.BODY)]
    T = (flange.placement * T_flange_turned).inverse()
    out = 0.0
    for solid in link_solids(model, cell.robot):
        if solid.joint == flange.parentJoint:
            pose = T * solid.pose
            body = coal.CollisionObject(solid.geometry, pose.rotation, pose.translation)
            out = max(out, float(body.getAABB().max_[2]))
    return out
