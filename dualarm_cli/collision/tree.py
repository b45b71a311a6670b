"""Frames of all joints of a robot for many configurations at once, components first."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pinocchio as pin

from dualarm_cli.compiled.pair_margins import JointSteps
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import cos, sin
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class JointTree:
    """A robot's joints as constant steps; joint 0 is the root link.

    Every joint has a frame of its own here whose z axis is the joint's axis, so that its motion is a turn about z or a
    shift along it.
    """

    parents: tuple[int, ...]
    """Joint before each joint; 0 of joint 0."""
    columns: tuple[int, ...]
    """Column of each joint's position; -1 of joint 0."""
    R_joint_own: FloatArray
    """Rotation of the frame that is used here in pinocchio's of the same joint, shape (j, 3, 3)."""
    R_parent_own: FloatArray
    """Rotation before each joint's motion, between frames that are used here, shape (j, 3, 3)."""
    p_parent_own: FloatArray
    """Translation before each joint's motion [m], shape (j, 3)."""
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
        turned, slides, columns = [np.eye(3)], [False], [-1]
        R, p = [np.eye(3)], [np.zeros(3)]
        for joint in range(1, model.njoints):
            twist = pin.getJointJacobian(model, data, joint, pin.LOCAL)[:, model.idx_vs[joint]]
            slides.append(bool(norm(twist[3:]) < 0.5))
            axis = twist[:3] if slides[-1] else twist[3:]
            turned.append(pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), axis).matrix())
            columns.append(joints.index(model.names[joint]))
            before, step = turned[model.parents[joint]], model.jointPlacements[joint]
            R.append(product(before.T, step.rotation, turned[-1]))
            p.append(product(before.T, step.translation))
        return cls(
            tuple(int(parent) for parent in model.parents),
            tuple(columns),
            np.array(turned),
            np.array(R),
            np.array(p),
            tuple(slides),
        )

    def steps(self) -> JointSteps:
        """Returns the joints as compiled functions take them."""
        return JointSteps.of(
            np.array(self.parents),
            np.array(self.columns),
            np.array(self.slides),
            self.R_parent_own,
            self.p_parent_own,
        )

    def above(self, joints: Iterable[int]) -> set[int]:
        """Returns some joints and all before them, without the root link."""
        found = set()
        for joint in joints:
            while joint:
                found.add(joint)
                joint = self.parents[joint]
        return found

    def frames(
        self, position: FloatArray, needed: Iterable[int]
    ) -> dict[int, tuple[FloatArray, FloatArray]]:
        """Returns frames of some joints in the root link's: rotations (3, 3, n) and translations (3, n).

        Args:
            position: all joints [rad, m], shape (n, columns); those not above a needed joint do not count.
            needed: numbers of joints.
        """
        n = len(position)
        root: FloatArray = np.broadcast_to(np.eye(3)[:, :, None], (3, 3, n))
        found = {0: (root, np.zeros((3, n)))}
        for joint in sorted(self.above(needed)):
            R, p = found[self.parents[joint]]
            p = p + product(self.p_parent_own[joint], R)
            R = product(self.R_parent_own[joint].T, R)
            q = position[:, self.columns[joint]]
            if self.slides[joint]:
                p = p + R[:, 2] * q
            else:
                s, c = sin(q), cos(q)
                turned = np.empty_like(R)
                turned[:, 0] = c * R[:, 0] + s * R[:, 1]
                turned[:, 1] = c * R[:, 1] - s * R[:, 0]
                turned[:, 2] = R[:, 2]
                R = turned
            found[joint] = R, p
        return found
