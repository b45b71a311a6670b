"""A tool's place for thousands of joint vectors at once; pinocchio gives the geometry, numpy the sums."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from dualarm_cli.errors import Diagnostic, InputError
from dualarm_cli.geometry.arrays import FloatArray

UNIT_AXIS = 1e-6
"""How far a joint's axis may be from unit length."""


@dataclass(frozen=True)
class ToolChain:
    """One arm's tool as constants C and joints about or along z: T = C0 Z(q0) C1 Z(q1) ... Cn."""

    constants: FloatArray
    """Homogeneous transforms between the joints, shape (n + 1, 4, 4)."""
    columns: tuple[int, ...]
    """Columns of the chain's joints within a joint vector, base first."""
    slides: tuple[bool, ...]
    """Whether a joint slides along its z axis instead of turning about it."""

    def poses(self, positions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Returns rotations (m, 3, 3) and positions (m, 3) [m] for joint vectors (m, n).

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
                c, s = np.cos(q), np.sin(q)
                frame[:, 0], frame[:, 1] = c * x + s * y, c * y - s * x
            frame = np.matmul(constant.T, frame)
        return np.ascontiguousarray(frame[:, :3].transpose(2, 0, 1)), frame[:, 3].T.copy()


def tool_chain(
    model: pin.Model, frame: int, base: pin.SE3, tcp: pin.SE3, joints: Sequence[str]
) -> ToolChain:
    """Returns the chain from the world to a tool.

    Args:
        model: the robot; every joint has one degree of freedom.
        frame: index of the flange's frame.
        base: pose of the robot's root in the world.
        tcp: tool centre point in the flange.
        joints: names of the joints, in the columns' order of the joint vectors to come.

    Raises:
        InputError: a joint has no axis, which pinocchio takes without a word.
    """
    flange = model.frames[frame]
    path = []
    joint = flange.parentJoint
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
    constants.append((before * flange.placement * tcp).homogeneous)
    return ToolChain(
        np.array(constants),
        tuple(joints.index(model.names[joint]) for joint in reversed(path)),
        tuple(slides),
    )


def _axis(model: pin.Model, joint: int) -> tuple[FloatArray, bool]:
    """Returns a joint's axis in its own frame and whether it slides along it."""
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    # pinocchio returns a matrix of one column as a vector.
    jacobian = pin.getJointJacobian(model, data, joint, pin.LOCAL).reshape(6, -1)
    subspace = jacobian[:, model.idx_vs[joint]]
    along, about = np.array(subspace[:3]), np.array(subspace[3:])
    slide = bool(np.linalg.norm(along) > np.linalg.norm(about))
    axis = along if slide else about
    length = float(np.linalg.norm(axis))
    if not abs(length - 1.0) <= UNIT_AXIS:
        name = model.names[joint]
        message = f"robot.urdf: joint '{name}' has an axis of length {length:g}; give it one"
        raise InputError([Diagnostic("schedule", 0, 0, "E300", message)])
    return axis / length, slide
