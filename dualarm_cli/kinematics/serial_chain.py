"""Forward kinematics and Jacobians of serial arms, for many postures at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from itertools import pairwise
from typing import Self

import numpy as np
import pinocchio as pin

from dualarm_cli.errors import UnsupportedError
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, readonly
from dualarm_cli.geometry.elementary import arctan2, cos, sin
from dualarm_cli.geometry.joint_axes import parallel_deviation
from dualarm_cli.geometry.linear_systems import least_squares
from dualarm_cli.geometry.products import cross, norm, product
from dualarm_cli.kinematics.platform_chain import align_z
from dualarm_cli.kinematics.posture_source import LimitedJoints
from dualarm_cli.records import dataclass

LEAST_JOINTS = 6
"""Minimum number of joints to hold a tool in any pose."""
FEW = 64
"""Number of postures up to which products of matrices are faster (measured)."""


@dataclass(frozen=True)
class SerialChain(LimitedJoints):
    """Forward kinematics, Jacobians and limits of n >= 6 joints, in the frame that carries them.

    Every joint frame is turned so that its axis is z: frame k is R_parent_joint[k], p_parent_joint[k] in frame k - 1,
    then turned about z by joint k, or shifted along it where the joint slides. Positions of joints that slide are in m,
    even if only rad is stated; a metre counts like a radian.
    """

    R_parent_joint: FloatArray
    """Constant rotation before each joint's motion, shape (n, 3, 3)."""
    p_parent_joint: FloatArray
    """Constant translation before each joint's motion [m], shape (n, 3)."""
    R_last_flange: FloatArray
    """Rotation of the flange in the last joint's frame, shape (3, 3)."""
    p_last_flange: FloatArray
    """Position of the flange in the last joint's frame [m], shape (3,)."""
    lower: FloatArray
    """Lowest joint positions [rad], shape (n,), -inf allowed."""
    upper: FloatArray
    """Highest joint positions [rad], shape (n,), inf allowed."""
    slides: tuple[int, ...] = ()
    """Numbers of the joints that slide, from 0."""

    def __post_init__(self) -> None:
        """Freeze the arrays.

        Raises:
            UnsupportedError: fewer than six joints.
        """
        for name in self.__dataclass_fields__.keys() - {"slides"}:
            object.__setattr__(self, name, readonly(getattr(self, name)))
        if self.axes < LEAST_JOINTS:
            raise UnsupportedError(
                f"the arm has {self.axes} joints; {LEAST_JOINTS} are needed to hold a tool in any pose"
            )

    @classmethod
    def from_model(
        cls,
        model: pin.Model,
        joints: Sequence[str],
        flange: str,
        T_carried_root: pin.SE3,
        limits: tuple[FloatArray, FloatArray],
    ) -> Self:
        """Measure an arm on a pinocchio model.

        Args:
            model: the whole robot, one position per joint.
            joints: the arm's joints from base to flange, each moved by the one before.
            flange: link to which the tool is bolted.
            T_carried_root: the model's root in the frame that carries the arm, all platform joints at zero.
            limits: lowest and highest joint positions [rad], each of shape (n,).

        Raises:
            UnsupportedError: fewer than six joints.
        """
        data = model.createData()
        pin.computeJointJacobians(model, data, pin.neutral(model))
        pin.updateFramePlacements(model, data)
        frames, slides = [pin.SE3.Identity()], []
        for k, name in enumerate(joints):
            index = model.getJointId(name)
            twist = pin.getJointJacobian(model, data, index, pin.LOCAL)
            # Of a robot with one joint the Jacobian comes without its second axis.
            twist = twist.reshape(6, model.nv)[:, model.idx_vs[index]]
            if norm(twist[3:]) < 0.5:
                slides.append(k)
            axis = twist[:3] if k in slides else twist[3:]
            turned = pin.SE3(align_z(axis), np.zeros(3))
            frames.append(T_carried_root * data.oMi[index] * turned)
        steps = [parent.inverse() * frame for parent, frame in pairwise(frames)]
        last = frames[-1].inverse() * T_carried_root * data.oMf[model.getFrameId(flange)]
        return cls(
            np.array([step.rotation for step in steps]),
            np.array([step.translation for step in steps]),
            last.rotation,
            last.translation,
            *limits,
            tuple(slides),
        )

    @property
    def last_axis(self) -> tuple[FloatArray, FloatArray]:
        """Last joint's axis in the flange frame: direction and point [m], (3,) each."""
        back = self.R_last_flange.T
        return back[:, 2], product(-back, self.p_last_flange)

    @property
    def axes(self) -> int:
        """Number of joints."""
        return len(self.p_parent_joint)

    @property
    def spare(self) -> int:
        """Number of redundant joints: the dimension of the self-motion."""
        return self.axes - LEAST_JOINTS

    @cached_property
    def without_limits(self) -> Self:
        """Copy of the arm without position limits."""
        free = np.full(self.axes, np.inf)
        return replace(self, lower=-free, upper=free)

    @cached_property
    def length(self) -> float:
        """Sum of the distances from joint to joint, up to the flange [m]."""
        links = norm([*self.p_parent_joint[1:], self.p_last_flange], axis=1)
        return float(links.sum())

    @cached_property
    def reach(self) -> float:
        """Upper bound on the flange's distance from the first axis' origin [m].

        Joints that slide are at 0. The bound is the length of links between points of the axes, and these are moved
        until it is least: where a URDF has the origins of its joints along their axes makes no difference.
        """
        p, up = [*self.p_parent_joint, self.p_last_flange], np.array([0.0, 0.0, 1.0])
        axes, moved = [*self.R_parent_joint[:, :, 2], np.zeros(3)], np.zeros(self.axes + 1)

        def link(k: int) -> FloatArray:
            """Compute the vector to point k in frame k - 1 [m]."""
            return np.asarray(p[k] + moved[k] * axes[k] - moved[k - 1] * up)

        for _ in range(10):  # further passes shorten industrial arms by less than 0.1 mm
            for k in range(1, self.axes):
                moved[k] = 0.0
                # The straight line from neighbour to neighbour, with the two links in one plane through the axis.
                before, after = link(k), link(k + 1)
                feet = -float(product(before, axes[k])), float(after[2])
                away = float(norm(cross(before, axes[k]))), float(norm(after[:2]))
                share = away[0] / sum(away) if sum(away) else 0.0
                moved[k] = feet[0] + share * (feet[1] - feet[0])
        return float(sum(norm(link(k)) for k in range(1, self.axes + 1)))

    @cached_property
    def farthest(self) -> float:
        """Upper bound on the flange's distance with sliding joints anywhere within limits [m].

        It is measured from the first axis' origin.
        """
        slides = list(self.slides)
        travel = np.maximum(np.abs(self.lower[slides]), np.abs(self.upper[slides]))
        return self.reach + float(travel.sum())

    def forward(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute flange poses.

        Args:
            q: joints [rad], of those that slide [m], shape (..., n).

        Returns:
            Rotations (..., 3, 3) and positions (..., 3) [m].
        """
        q = np.asarray(q, dtype=np.float64)
        shape = q.shape[:-1]
        R, p, _, _ = self._chain(q.reshape(-1, self.axes))
        return R.reshape(*shape, 3, 3), p.reshape(*shape, 3)

    def jacobian(self, q: FloatArray) -> FloatArray:
        """Compute Jacobians of the flange in the carried frame, shape (..., 6, n).

        Linear velocity is above angular velocity.
        """
        q = np.asarray(q, dtype=np.float64)
        return self.linearised(q.reshape(-1, self.axes))[2].reshape(*q.shape[:-1], 6, self.axes)

    def linearised(self, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Compute flange poses and Jacobians.

        Args:
            q: joints [rad], of those that slide [m], shape (b, n).

        Returns:
            Rotations (b, 3, 3), positions (b, 3) [m] and Jacobians (b, 6, n).
        """
        R, p, z, origin = self._chain(q)
        arm = p.T[:, None] - origin
        J = np.empty((len(q), 6, self.axes))
        J[:, 0] = (z[1] * arm[2] - z[2] * arm[1]).T
        J[:, 1] = (z[2] * arm[0] - z[0] * arm[2]).T
        J[:, 2] = (z[0] * arm[1] - z[1] * arm[0]).T
        J[:, 3:] = z.transpose(2, 0, 1)
        for k in self.slides:
            J[:, :3, k], J[:, 3:, k] = z[:, k].T, 0.0
        return R, p, J

    def origins(self, q: FloatArray) -> FloatArray:
        """Compute the origins of all joints [m], shape (b, n, 3)."""
        return self._chain(q)[3].transpose(2, 1, 0)

    def _chain(self, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Compute flange poses, and axes and origins of all joints, both (3, n, b).

        Few postures are quickest as products of 4 x 4 matrices, many with the postures last in memory.
        """
        return self._chain_of_few(q) if len(q) <= FEW else self._chain_of_many(q)

    @cached_property
    def _steps(self) -> FloatArray:
        """Every constant step and the flange's as a homogeneous matrix, shape (n + 1, 4, 4)."""
        steps = np.zeros((self.axes + 1, 4, 4))
        steps[:-1, :3, :3], steps[:-1, :3, 3] = self.R_parent_joint, self.p_parent_joint
        steps[-1, :3, :3], steps[-1, :3, 3] = self.R_last_flange, self.p_last_flange
        steps[:, 3, 3] = 1.0
        return readonly(steps)

    @cached_property
    def chain(self) -> tuple[FloatArray, BoolArray]:
        """Constant transforms between successive joints, and a mask of the joints that slide.

        Rotation and position [m] of each joint at zero in the one before, and of the flange in the last one,
        shape (n + 1, 3, 4); mask of shape (n,). Joints slide along their z axes or turn about them.
        """
        slides = np.zeros(self.axes, dtype=np.bool_)
        slides[list(self.slides)] = True
        return readonly(self._steps[:, :3]), slides

    def _chain_of_few(self, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        n, steps = self.axes, self._steps
        c, s = self._turned(q)
        c, s = c[..., None], s[..., None]
        turned = np.empty((len(q), n, 4, 4))
        turned[..., 0] = c * steps[:n, :, 0] + s * steps[:n, :, 1]
        turned[..., 1] = c * steps[:n, :, 1] - s * steps[:n, :, 0]
        turned[..., 2:] = steps[:n, :, 2:]
        for k in self.slides:
            turned[:, k, :, 3] += q[:, k, None] * steps[k, :, 2]
        T = np.empty((n + 1, len(q), 4, 4))
        T[0] = turned[:, 0]
        for k in range(1, n):
            T[k] = product(T[k - 1], turned[:, k])
        T[n] = product(T[n - 1], steps[n])
        z, origin = (T[:n, :, :3, i].transpose(2, 0, 1) for i in (2, 3))
        return T[n, :, :3, :3], T[n, :, :3, 3], z, origin

    def _turned(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute cosines and sines of joints (b, n); sliding joints count as angle 0."""
        c, s = cos(q), sin(q)
        c[:, list(self.slides)], s[:, list(self.slides)] = 1.0, 0.0
        return c, s

    def _chain_of_many(
        self, q: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        n, b = q.shape[1], len(q)
        c, s = (x.T for x in self._turned(q))
        # Columns of the present frame, each (3, b), and its origin.
        frame = np.repeat(np.eye(3)[:, :, None], b, axis=2)
        p = np.zeros((3, b))
        z, origin = np.empty((3, n, b)), np.empty((3, n, b))
        for k, step in enumerate(self._steps):
            # Columns of the next frame and the step to it are combinations of the present columns.
            x, y, z_next, step_to_next = product(step[:3].T, frame.reshape(3, -1)).reshape(4, 3, b)
            p = p + step_to_next
            if k == n:
                break
            if k in self.slides:
                p = p + q[:, k] * z_next
            frame = np.empty((3, 3, b))
            frame[0], frame[1], frame[2] = c[k] * x + s[k] * y, c[k] * y - s[k] * x, z_next
            z[:, k], origin[:, k] = z_next, p
        return np.stack([x, y, z_next]).transpose(2, 1, 0), p.T, z, origin

    @cached_property
    def meeting_point(self) -> FloatArray:
        """Point nearest to the last three axes, all joints at zero [m], shape (3,)."""
        _, points, across = self._last_axes
        # Three parallel axes leave the place along them open.
        center: FloatArray = least_squares(
            across.sum(axis=0), product(across, points[:, :, None])[..., 0].sum(axis=0)
        )
        return center

    @cached_property
    def wrist_gap(self) -> float:
        """Largest distance of the last three axes from their common point [m]; 0: spherical wrist."""
        _, points, across = self._last_axes
        away = product(across, (points - self.meeting_point)[:, :, None])[..., 0]
        return float(norm(away, axis=1).max())

    @cached_property
    def parallel_deviation(self) -> float:
        """Largest sine of the angles of axes 2, 3 and 4, 0 if parallel."""
        return parallel_deviation(self._chain(np.zeros((1, self.axes)))[2][:, :, 0].T)

    @cached_property
    def _last_axes(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Last three axes, points on them [m] and projections across them, joints at zero."""
        _, _, z, origin = self._chain(np.zeros((1, self.axes)))
        axes, points = z[:, -3:, 0].T, origin[:, -3:, 0].T
        return axes, points, np.eye(3) - axes[:, :, None] * axes[:, None, :]


def pose_error(
    R: FloatArray, p: FloatArray, R_wanted: FloatArray, p_wanted: FloatArray
) -> FloatArray:
    """Compute the displacements from poses to wanted poses, shape (b, 6).

    Translations [m] are above rotation vectors [rad].

    Args:
        R: rotations, shape (b, 3, 3).
        p: positions [m], shape (b, 3).
        R_wanted: wanted rotations, broadcast against R.
        p_wanted: wanted positions [m], broadcast against p.
    """
    E = product(R_wanted, np.swapaxes(R, -1, -2))
    axis = 0.5 * np.stack(
        [E[..., 2, 1] - E[..., 1, 2], E[..., 0, 2] - E[..., 2, 0], E[..., 1, 0] - E[..., 0, 1]],
        axis=-1,
    )
    sine = norm(axis, axis=-1)
    angle = arctan2(sine, 0.5 * (np.trace(E, axis1=-2, axis2=-1) - 1.0))
    # At half a turn the axis is lost to rounding: any direction makes progress there.
    scale = np.where(sine > 1e-9, angle / np.maximum(sine, 1e-9), 1.0)
    return np.concatenate([p_wanted - p, axis * scale[..., None]], axis=-1)
