"""Kinematics of the platform: the frame that carries both arms, at many positions."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from dualarm_cli.geometry.arrays import FloatArray, readonly
from dualarm_cli.geometry.elementary import TURN, cos, sin
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.records import dataclass

LEVER = 0.5
"""Travel of a sliding platform equivalent to a turn, as shoulders move [m/rad]."""
LEAST_PLACES = 4
"""Minimum number of spacings over the range of a sliding platform."""


@dataclass(frozen=True)
class PlatformChain:
    """Joints between the world and the arms' carried frame: none, one or two.

    Every joint frame is turned so that its axis is z. With one joint the carried frame is the axis frame
    turned by the platform angle, so that an arm's shoulder has a fixed radius, azimuth and height in it; or, where the
    joint slides, shifted along its z axis.
    """

    joints: tuple[str, ...]
    """Names of the k joints, world side first."""
    R_parent_joint: FloatArray
    """Constant rotation before each joint's motion, shape (k, 3, 3)."""
    p_parent_joint: FloatArray
    """Constant translation before each joint's motion [m], shape (k, 3)."""
    revolute: tuple[bool, ...]
    """Flags of joints that turn; others slide along z."""
    T_world_carried: pin.SE3
    """Carried frame with all joints at zero, or the root link's pose without joints."""
    fixed: bool = False
    """Flag of a platform that stays at its start position."""

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        object.__setattr__(self, "R_parent_joint", readonly(self.R_parent_joint))
        object.__setattr__(self, "p_parent_joint", readonly(self.p_parent_joint))

    @classmethod
    def from_model(cls, model: pin.Model, joints: tuple[str, ...], base: pin.SE3) -> PlatformChain:
        """Measure the chain on a pinocchio model.

        Args:
            model: the whole robot, one position per joint.
            joints: platform joints, each moved by the one before.
            base: pose of the model's root in the world.
        """
        data = model.createData()
        pin.computeJointJacobians(model, data, pin.neutral(model))
        frames = [base]
        revolute = []
        for name in joints:
            index = model.getJointId(name)
            # Local unit twist of the joint: (linear, angular).
            twist = pin.getJointJacobian(model, data, index, pin.LOCAL)[:, model.idx_vs[index]]
            revolute.append(bool(norm(twist[3:]) > 0.5))
            axis = twist[3:] if revolute[-1] else twist[:3]
            frames.append(base * data.oMi[index] * pin.SE3(align_z(axis), np.zeros(3)))
        world = pin.SE3.Identity()
        parents = [world, *frames[1:-1]] if joints else []
        steps = [
            parent.inverse() * frame for parent, frame in zip(parents, frames[1:], strict=True)
        ]
        return cls(
            joints,
            np.array([step.rotation for step in steps]).reshape(-1, 3, 3),
            np.array([step.translation for step in steps]).reshape(-1, 3),
            tuple(revolute),
            frames[-1],
        )

    @property
    def is_chosen(self) -> bool:
        """Flag of a platform of one joint, whose position is chosen stage by stage."""
        return len(self.joints) == 1 and not self.fixed

    @property
    def is_turntable(self) -> bool:
        """Flag of a chosen platform that turns."""
        return self.is_chosen and self.revolute[0]

    @property
    def is_rail(self) -> bool:
        """Flag of a chosen platform that slides."""
        return self.is_chosen and not self.revolute[0]

    def around(self, here: float, lower: float, upper: float) -> tuple[float, float]:
        """Return the scanned range [rad or m].

        It is half a turn to either side, or a whole rail.

        Args:
            here: position of its one joint [rad or m].
            lower: its lower limit [rad or m].
            upper: its upper limit [rad or m].
        """
        if self.is_rail:
            return lower, upper
        return max(lower, here - np.pi), min(upper, here + np.pi)

    def spacing(self, step: float, lower: float, upper: float) -> float:
        """Convert a spacing of platform angles to positions [rad or m].

        A rail's spacing is LEVER times the step. It is finer on a short rail; a long one has no more positions than a
        circle has angles.

        Args:
            step: spacing of the angles [rad].
            lower: lower limit of its one joint [rad or m].
            upper: its upper limit [rad or m].
        """
        if not self.is_rail or upper <= lower:
            return step
        finest = min(LEVER * step, (upper - lower) / LEAST_PLACES)
        return max(finest, (upper - lower) * step / TURN)

    def shifted(self, moved: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute the transform of carried points by a further move of its one joint.

        Args:
            moved: displacements [rad or m], shape (...).

        Returns:
            Rotations (..., 3, 3) and translations (..., 3) [m] that take points of the carried frame before the move
            into that after it.
        """
        if not self.is_rail:
            return rotation_z(-moved), np.zeros((*np.shape(moved), 3))
        back = np.zeros((*np.shape(moved), 3))
        back[..., 2] = -moved
        return np.broadcast_to(np.eye(3), (*np.shape(moved), 3, 3)), back

    def pose(self, position: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute the carried frame's world rotations (..., 3, 3), positions (..., 3) [m].

        Args:
            position: joint positions [rad or m], shape (..., k).
        """
        batch = position.shape[:-1]
        if not self.joints:
            rotation = np.broadcast_to(self.T_world_carried.rotation, (*batch, 3, 3))
            return rotation, np.broadcast_to(self.T_world_carried.translation, (*batch, 3))
        R = np.broadcast_to(np.eye(3), (*batch, 3, 3))
        p = np.zeros((*batch, 3))
        for k, turns in enumerate(self.revolute):
            p = p + product(R, self.p_parent_joint[k])
            R = product(R, self.R_parent_joint[k])
            if turns:
                R = product(R, rotation_z(position[..., k]))
            else:
                p = p + R[..., :, 2] * position[..., k, None]
        return R, p


def rotation_z(angle: FloatArray) -> FloatArray:
    """Compute rotations about z, shape (..., 3, 3), by angles (...) [rad]."""
    c, s = cos(angle), sin(angle)
    R = np.zeros((*np.shape(angle), 3, 3))
    R[..., 0, 0] = R[..., 1, 1] = c
    R[..., 0, 1], R[..., 1, 0], R[..., 2, 2] = -s, s, 1.0
    return R


def align_z(axis: FloatArray) -> FloatArray:
    """Compute a rotation from z to the unit vector `axis`.

    It is the identity for z.
    """
    if np.array_equal(axis, [0.0, 0.0, 1.0]):
        return np.eye(3)
    # Any frame with that z axis is valid; the coordinate axis farthest from it spans x.
    x = np.cross(np.eye(3)[np.argmin(np.abs(axis))], axis)
    x /= norm(x)
    return np.column_stack([x, np.cross(axis, x), axis])
