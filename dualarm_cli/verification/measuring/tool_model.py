"""Tool poses over time, by pinocchio on the schedule's own URDF."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from dualarm_cli.errors import Diagnostic, InputError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import arctan2, cos, sin
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.records import dataclass

UNIT_AXIS = 1e-6
"""Tolerance of the length of a joint's axis."""


@dataclass(frozen=True)
class ToolChain:
    """Kinematic chain of one tool: T = C0 Z(q0) C1 Z(q1) ... Cn.

    C are constants, Z are joints about or along z.
    """

    constants: FloatArray
    """Homogeneous transforms between the joints, shape (n + 1, 4, 4)."""
    columns: tuple[int, ...]
    """Columns of the chain's joints within a joint vector, base first."""
    slides: tuple[bool, ...]
    """Flags of joints that slide along their z axis instead of turning about it."""

    def poses(self, positions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute rotations (m, 3, 3) and positions (m, 3) [m] for joint vectors (m, n).

        Agrees with pinocchio's forward kinematics to rounding (tested on random trees of joints).
        """
        count = len(positions)
        # Axes x, y, z and the origin are frame[:, 0..3], each (3, m): long rows keep numpy fast.
        frame = np.repeat(self.constants[0, :3, :, None], count, axis=2)
        steps = zip(self.columns, self.slides, self.constants[1:], strict=True)
        for column, slide, constant in steps:
            q = positions[:, column]
            x, y, z, origin = (frame[:, k] for k in range(4))
            if slide:
                origin += q * z
            else:
                c, s = cos(q), sin(q)
                frame[:, 0], frame[:, 1] = c * x + s * y, c * y - s * x
            frame = product(constant.T, frame)
        return np.ascontiguousarray(frame[:, :3].transpose(2, 0, 1)), frame[:, 3].T.copy()


def tool_chain(
    model: pin.Model,
    joint: int,
    base: pin.SE3,
    after: Sequence[pin.SE3],
    joints: Sequence[str],
) -> ToolChain:
    """Build the chain from the world to a tool or another body.

    Args:
        model: the robot; every joint has one degree of freedom.
        joint: the joint that carries the body.
        base: pose of the robot's root in the world.
        after: poses from the joint to the tool, each in the frame of the previous one.
        joints: names of the joints, in the order of columns of joint vectors.

    Raises:
        InputError: a joint has no axis, which pinocchio accepts.
    """
    path = []
    while joint > 0:
        path.append(joint)
        joint = model.parents[joint]
    before, constants, slides = base, [], []
    for joint in reversed(path):
        axis, slide = _axis(model, joint)
        # Turned so that the joint's own axis is z.
        turn = pin.SE3(
            pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), axis).toRotationMatrix(),
            np.zeros(3),
        )
        constants.append((before * model.jointPlacements[joint] * turn).homogeneous)
        slides.append(slide)
        before = turn.inverse()
    for pose in after:
        before = before * pose
    constants.append(before.homogeneous)
    return ToolChain(
        np.array(constants),
        tuple(joints.index(model.names[joint]) for joint in reversed(path)),
        tuple(slides),
    )


def _axis(model: pin.Model, joint: int) -> tuple[FloatArray, bool]:
    """Return a joint's axis in its own frame and whether it slides along it."""
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    # pinocchio returns a matrix of one column as a vector.
    jacobian = pin.getJointJacobian(model, data, joint, pin.LOCAL).reshape(6, -1)
    subspace = jacobian[:, model.idx_vs[joint]]
    along, about = np.array(subspace[:3]), np.array(subspace[3:])
    slide = bool(norm(along) > norm(about))
    axis = along if slide else about
    length = float(norm(axis))
    if not abs(length - 1.0) <= UNIT_AXIS:
        name = model.names[joint]
        message = f"robot.urdf: joint '{name}' has an axis of length {length:g}; give a unit vector"
        raise InputError([Diagnostic("schedule", 0, 0, "E300", message)])
    return axis / length, slide


class ToolModel:
    """Forward kinematics of a schedule's robot."""

    def __init__(self, schedule: Schedule) -> None:
        """Build the model and look up all names.

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
        self._base, self._joints = robot.base, joints
        self._chains = {}
        for arm, part in robot.arms.items():
            flange = model.frames[self._frames[arm]]
            after = [flange.placement, part.tcp]
            self._chains[arm] = tool_chain(model, flange.parentJoint, robot.base, after, joints)

    def pose(self, arm: str, position: FloatArray) -> pin.SE3:
        """Compute the tool centre point in the world by pinocchio, for joints (n,)."""
        q = np.ascontiguousarray(position[self._order])
        pin.forwardKinematics(self._model, self._data, q)
        flange = pin.updateFramePlacement(self._model, self._data, self._frames[arm])
        return self._base * flange * self._tcp[arm]

    def joints(self, arm: str) -> tuple[str, ...]:
        """Return the joints that move an arm's flange, base first."""
        return tuple(self._joints[column] for column in self._chains[arm].columns)

    def poses(self, arm: str, positions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute rotations (m, 3, 3) and positions (m, 3) [m] for joint vectors (m, n)."""
        return self._chains[arm].poses(positions)


def rotation_angle(R: FloatArray) -> FloatArray:
    """Compute the angles of rotations (..., 3, 3) [rad], exact for small ones."""
    skew = np.stack(
        [
            R[..., 2, 1] - R[..., 1, 2],
            R[..., 0, 2] - R[..., 2, 0],
            R[..., 1, 0] - R[..., 0, 1],
        ],
        axis=-1,
    )
    trace = R[..., 0, 0] + R[..., 1, 1] + R[..., 2, 2]
    return arctan2(norm(skew, axis=-1), trace - 1.0)


def _input_error(message: str) -> InputError:
    return InputError([Diagnostic("schedule", 0, 0, "E300", message)])
