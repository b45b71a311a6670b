"""Frames of all joints of a robot for many configurations at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from dualarm_cli.geometry.arrays import FloatArray


@dataclass(frozen=True)
class JointTree:
    """A robot's joints as constant steps and axes; joint 0 is the root link."""

    parents: tuple[int, ...]
    """Joint before each joint; 0 of joint 0."""
    columns: tuple[int, ...]
    """Column of each joint's position; -1 of joint 0."""
    R_parent_joint: FloatArray
    """Rotation before each joint's motion, shape (j, 3, 3)."""
    p_parent_joint: FloatArray
    """Translation before each joint's motion [m], shape (j, 3)."""
    axes: FloatArray
    """Unit axis of each joint in its own frame, shape (j, 3)."""
    slides: tuple[bool, ...]
    """Whether a joint slides along its axis."""

    @classmethod
    def of(cls, model: pin.Model, joints: tuple[str, ...]) -> JointTree:
        """Measures a model.

        Args:
            model: of the URDF, one position per joint.
            joints: names of the joints in the order of their columns.
        """
        data = model.createData()
        pin.computeJointJacobians(model, data, pin.neutral(model))
        axes, slides, columns = [np.zeros(3)], [False], [-1]
        for joint in range(1, model.njoints):
            twist = pin.getJointJacobian(model, data, joint, pin.LOCAL)[:, model.idx_vs[joint]]
            slides.append(bool(np.linalg.norm(twist[3:]) < 0.5))
            axes.append(twist[:3] if slides[-1] else twist[3:])
            columns.append(joints.index(model.names[joint]))
        steps = model.jointPlacements
        return cls(
            tuple(int(parent) for parent in model.parents),
            tuple(columns),
            np.array([step.rotation for step in steps]),
            np.array([step.translation for step in steps]),
            np.array(axes),
            tuple(slides),
        )

    def frames(
        self, position: FloatArray, needed: frozenset[int]
    ) -> dict[int, tuple[FloatArray, FloatArray]]:
        """Returns frames of some joints in the root link's: rotations (n, 3, 3) and translations (n, 3).

        Args:
            position: all joints [rad, m], shape (n, columns); those not above a needed joint do not count.
            needed: numbers of joints.
        """
        wanted = set(needed)
        for joint in sorted(needed, reverse=True):
            while joint:
                wanted.add(joint)
                joint = self.parents[joint]
        n = len(position)
        found = {0: (np.broadcast_to(np.eye(3), (n, 3, 3)), np.zeros((n, 3)))}
        for joint in sorted(wanted - {0}):
            R, p = found[self.parents[joint]]
            p = p + R @ self.p_parent_joint[joint]
            R = R @ self.R_parent_joint[joint]
            q = position[:, self.columns[joint]]
            if self.slides[joint]:
                p = p + (R @ self.axes[joint]) * q[:, None]
            else:
                R = R @ _turns(self.axes[joint], q)
            found[joint] = R, p
        return found


def _turns(axis: FloatArray, angle: FloatArray) -> FloatArray:
    """Returns rotations about a unit axis, shape (n, 3, 3) ([Rodrigues1840])."""
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    s, c = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    turned: FloatArray = np.eye(3) + s * K + (1.0 - c) * (K @ K)
    return turned
