"""Frames of all robot joints for many configurations at once, components first."""

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
    """Joint tree with constant transforms between joints; joint 0 is the root link.

    Every joint has its own frame here, whose z axis is the joint axis. Its motion is a rotation about z or a
    translation along z.
    """

    parents: tuple[int, ...]
    """Parent of each joint; 0 for joint 0."""
    columns: tuple[int, ...]
    """Column of each joint's position; -1 for joint 0."""
    R_joint_own: FloatArray
    """Rotation of the tree's frame in pinocchio's joint frame, shape (j, 3, 3)."""
    R_parent_own: FloatArray
    """Rotation between the tree's frames before the joint's motion, shape (j, 3, 3)."""
    p_parent_own: FloatArray
    """Translation before the joint's motion [m], shape (j, 3)."""
    slides: tuple[bool, ...]
    """Whether a joint is prismatic."""

    @classmethod
    def of(cls, model: pin.Model, joints: tuple[str, ...]) -> JointTree:
        """Build the tree of a model.

        Args:
            model: model of the URDF, one position per joint.
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
        """Convert the tree for the compiled functions."""
        return JointSteps.of(
            np.array(self.parents),
            np.array(self.columns),
            np.array(self.slides),
            self.R_parent_own,
            self.p_parent_own,
        )

    def above(self, joints: Iterable[int]) -> set[int]:
        """Return joints and all their ancestors, without the root link."""
        ancestors = set()
        for joint in joints:
            while joint:
                ancestors.add(joint)
                joint = self.parents[joint]
        return ancestors

    def frames(
        self, position: FloatArray, needed: Iterable[int]
    ) -> dict[int, tuple[FloatArray, FloatArray]]:
        """Compute frames of joints in the root link's: rotations (3, 3, n), translations (3, n).

        Args:
            position: all joints [rad, m], shape (n, columns); those without effect on the needed joints are ignored.
            needed: numbers of joints.
        """
        n = len(position)
        root: FloatArray = np.broadcast_to(np.eye(3)[:, :, None], (3, 3, n))
        frames = {0: (root, np.zeros((3, n)))}
        for joint in sorted(self.above(needed)):
            R, p = frames[self.parents[joint]]
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
            frames[joint] = R, p
        return frames
