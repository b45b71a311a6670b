"""Where the tools are, by pinocchio on the schedule's own URDF."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from dualarm_cli.errors import Diagnostic, InputError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.verification.tool_chain import tool_chain


class ToolModel:
    """Forward kinematics of a schedule's robot."""

    def __init__(self, schedule: Schedule) -> None:
        """Builds the model and looks every name up.

        Raises:
            InputError: the URDF cannot be read, or a joint or flange is not in it.
        """
        robot = schedule.robot
        try:
            model = pin.buildModelFromXML(robot.urdf)
        except ValueError as error:
            raise _input_error(f"robot.urdf cannot be read: {str(error).splitlines()[0]}") from None
        joints = schedule.trajectory.joints
        for name in joints:
            # The first of pinocchio's joints is the universe, which no file may name.
            if name not in model.names[1:]:
                raise _input_error(f"robot.joints: '{name}' is not a joint of the URDF")
        for name in model.names[1:]:
            if name not in joints:
                raise _input_error(f"robot.joints: the URDF's moving joint '{name}' is missing")
        if model.nq != model.nv:
            raise _input_error("robot.urdf: continuous joints are not supported; give them limits")
        for arm, part in robot.arms.items():
            # A joint may have the same name: only the link is meant. Not every text is a name to pinocchio.
            links = [frame.name for frame in model.frames if frame.type == pin.FrameType.BODY]
            if part.flange not in links:
                raise _input_error(f"robot.arms.{arm}.flange: {part.flange!r} is not in the URDF")
        self._model, self._data = model, model.createData()
        self._order = [joints.index(name) for name in model.names[1:]]
        self._frames = {
            arm: model.getFrameId(part.flange, pin.FrameType.BODY)
            for arm, part in robot.arms.items()
        }
        self._tcp = {arm: part.tcp for arm, part in robot.arms.items()}
        self._base = robot.base
        self._chains = {
            arm: tool_chain(model, self._frames[arm], robot.base, part.tcp, joints)
            for arm, part in robot.arms.items()
        }

    def pose(self, arm: str, position: FloatArray) -> pin.SE3:
        """Returns the tool centre point in the world by pinocchio, for joints (n,) as in the trajectory."""
        q = np.ascontiguousarray(position[self._order])
        pin.forwardKinematics(self._model, self._data, q)
        flange = pin.updateFramePlacement(self._model, self._data, self._frames[arm])
        return self._base * flange * self._tcp[arm]

    def poses(self, arm: str, positions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Returns rotations (m, 3, 3) and positions (m, 3) [m] for many joint vectors (m, n)."""
        return self._chains[arm].poses(positions)


def rotation_angle(R: FloatArray) -> FloatArray:
    """Returns the angles [rad] of rotations (..., 3, 3), exact for small ones."""
    skew = np.stack(
        [
            R[..., 2, 1] - R[..., 1, 2],
            R[..., 0, 2] - R[..., 2, 0],
            R[..., 1, 0] - R[..., 0, 1],
        ],
        axis=-1,
    )
    trace = R[..., 0, 0] + R[..., 1, 1] + R[..., 2, 2]
    return np.arctan2(np.linalg.norm(skew, axis=-1), trace - 1.0)


def _input_error(message: str) -> InputError:
    return InputError([Diagnostic("schedule", 0, 0, "E300", message)])
