"""Where a robot's tool tip is, from joint readings: tip = p(q) + R(q) tool + height z."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from dualarm_cli.errors import UsageError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.robot import Robot
from dualarm_cli.model.touches import TouchSide


@dataclass(frozen=True)
class Flanges:
    """Flange poses of one robot in its base frame."""

    rotation: FloatArray
    """R_base_flange, shape (n, 3, 3)."""
    position: FloatArray
    """p_base_flange [m], shape (n, 3)."""

    def tips(self, tool: FloatArray, height: float = 0.0) -> FloatArray:
        """Returns the tips [m] (n, 3) of a tool (3,) [m], all raised by a height [m]."""
        found: FloatArray = self.position + self.rotation @ tool + np.array([0.0, 0.0, height])
        return found


def flange_poses(robot: Robot, joints: FloatArray) -> Flanges:
    """Returns where the flange of a robot of one arm is.

    Args:
        robot: a robot of one arm.
        joints: positions in the arm's order [rad], shape (n, k).
    """
    model = pin.buildModelFromXML(robot.urdf)
    data = model.createData()
    frame = model.getFrameId(robot.arms[0].flange)
    columns = robot.columns(robot.arms[0].joints)
    rotations, positions = np.empty((len(joints), 3, 3)), np.empty((len(joints), 3))
    for k, values in enumerate(joints):
        q = np.zeros(model.nq)
        q[columns] = values
        pin.framesForwardKinematics(model, data, q)
        rotations[k], positions[k] = data.oMf[frame].rotation, data.oMf[frame].translation
    return Flanges(rotations, positions)


def second_joint_height(robot: Robot) -> float | None:
    """Returns how high the second joint's origin is above the base [m], where the first turns about the vertical."""
    model = pin.buildModelFromXML(robot.urdf)
    data = model.createData()
    joints = [model.getJointId(name) for name in robot.arms[0].joints]
    pin.forwardKinematics(model, data, pin.neutral(model))
    if len(joints) < 2:
        return None
    q = pin.neutral(model)
    height = float(data.oMi[joints[1]].translation[2])
    q[model.idx_qs[joints[0]]] = 1.0
    pin.forwardKinematics(model, data, q)
    upright = abs(float(data.oMi[joints[1]].translation[2]) - height) < 1e-9
    return height if upright else None


def touched_points(
    side: str, touch: TouchSide, use: str, tool: FloatArray, height: float = 0.0
) -> FloatArray:
    """Returns a robot's points in its base frame [m], shape (n, 3).

    Args:
        side: `left` or `right`, for messages.
        touch: what it has touched.
        use: `joints` or `xyz`: which of the two is taken where a point has both.
        tool: tip of the tool in the flange frame [m], shape (3,).
        height: added along the base frame's z [m].

    Raises:
        UsageError: a named kind of reading is asked for that no point has.
    """
    has = {"joints": touch.read, "xyz": touch.measured}
    if not has[use].any() and not has["xyz" if use == "joints" else "joints"].all():
        raise UsageError(f"the {side} robot has no {use} for any point")
    found = touch.xyz.copy()
    by_joints = touch.read & ((use == "joints") | ~touch.measured)
    if by_joints.any() and touch.robot is not None:
        found[by_joints] = flange_poses(touch.robot, touch.joints[by_joints]).tips(tool, height)
    return found
