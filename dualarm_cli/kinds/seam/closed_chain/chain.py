"""Closed chain of part and tool in both arms, as equations in their joints."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np
import pinocchio as pin

from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.geometry.elementary import arccos, arctan2, cos, sin
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.geometry.rotations import log_rotation, skew
from dualarm_cli.kinematics.general_arm import GeneralArm
from dualarm_cli.kinematics.whole_body import cross
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.process_work import SeamWork
from dualarm_cli.records import dataclass

TURN = 0.1
"""Length equivalent of a radian in residuals [m]."""


@dataclass(frozen=True)
class Bodies:
    """Part and tool at k configurations of n joints, in the world."""

    R_part: FloatArray
    """Rotations of the part, shape (k, 3, 3)."""
    p_part: FloatArray
    """Positions of the part's frame [m], shape (k, 3)."""
    J_part: FloatArray
    """Its Jacobians, linear part first, shape (k, 6, n)."""
    R_tool: FloatArray
    """Rotations of the tool, shape (k, 3, 3)."""
    p_tool: FloatArray
    """Tool centre points [m], shape (k, 3)."""
    J_tool: FloatArray
    """Its Jacobians, shape (k, 6, n)."""


@dataclass(frozen=True)
class Equations:
    """System of m equations at each of k configurations of n joints."""

    residuals: FloatArray
    """Residuals [m or rad], shape (k, m)."""
    slope: FloatArray
    """Jacobians of the residuals, shape (k, m, n)."""
    scale: FloatArray
    """Length equivalent of a unit of each row [m], shape (m,)."""
    one_sided: int = 0
    """Number of last rows that are inequalities.

    Below 0 their residual and slope are 0.
    """

    @property
    def size(self) -> FloatArray:
        """Largest residual of each configuration [m, radians by TURN], shape (k,)."""
        largest: FloatArray = np.abs(self.residuals * self.scale).max(axis=1, initial=0.0)
        return largest

    @property
    def exact(self) -> Equations:
        """Equations without the one-sided rows."""
        rows = slice(0, self.residuals.shape[1] - self.one_sided)
        return Equations(self.residuals[:, rows], self.slope[:, rows], self.scale[rows])

    def after(self, first: Equations) -> Equations:
        """Append these equations to others without one-sided rows."""
        return Equations(
            np.concatenate([first.residuals, self.residuals], axis=1),
            np.concatenate([first.slope, self.slope], axis=1),
            np.concatenate([first.scale, self.scale]),
            self.one_sided,
        )

    def with_one_sided(self, excess: FloatArray, slope: FloatArray) -> Equations:
        """Add the inequality that an excess (k,) [rad], slope (k, n), is ≤ 0."""
        above = excess > 0.0
        return Equations(
            np.concatenate([self.residuals, np.where(above, excess, 0.0)[:, None]], axis=1),
            np.concatenate([self.slope, (slope * above[:, None])[:, None]], axis=1),
            np.append(self.scale, TURN),
            self.one_sided + 1,
        )


def lean_and_spin(E: FloatArray) -> FloatArray:
    """Compute the rotation errors of tools as tilt vector and spin, (k, 3) [rad].

    The first two are the tilt of the axis, a vector as long as its angle; the third is the turn about the axis.

    Args:
        E: rotations of the tools in their target frames, shape (k, 3, 3).
    """
    x, y, z = np.moveaxis(E[..., :, 2], -1, 0)
    sine = np.hypot(x, y)
    scale = np.where(sine > 1e-9, arctan2(sine, z) / np.where(sine > 1e-9, sine, 1.0), 1.0)
    # The tilt is along e_z x axis; undoing it leaves the spin.
    lean = np.stack([-y * scale, x * scale, np.zeros_like(x)], axis=-1)
    spin = arctan2(E[..., 1, 0] - E[..., 0, 1], E[..., 0, 0] + E[..., 1, 1])
    lean[..., 2] = spin
    return lean


def lean_slopes(E: FloatArray, w: FloatArray) -> FloatArray:
    """Compute derivatives of tilt and spin by the joints, (k, 3, n); see `lean_and_spin`.

    With the axis a = E e_z at the angle t from e_z, the tilt is (t / sin t) e_z x a, and the axis moves by w x a. The
    spin rate is the component of w along e_z + a, over 1 + a_z, because the tilt is the shortest turn.

    Args:
        E: rotations of the tools in their target frames, shape (k, 3, 3).
        w: turns in these frames by each of n joints [rad/rad], shape (k, 3, n).
    """
    axis = E[:, :, 2]
    moved = cross(np.swapaxes(w, 1, 2), axis[:, None]).swapaxes(1, 2)
    sine = np.hypot(axis[:, 0], axis[:, 1])
    angle = arctan2(sine, axis[:, 2])
    small = sine < 1e-6
    safe = np.where(small, 1.0, sine)
    ratio = np.where(small, 1.0, angle / safe)
    # d (t / sin t) / dt, and dt = -d a_z / sin t; near e_z both are small.
    bend = np.where(small, 0.0, (sine - angle * cos(angle)) / np.square(safe))
    turned = -moved[:, 2] / safe[:, None] * ~small[:, None]
    slopes = np.empty_like(w)
    slopes[:, 0] = -moved[:, 1] * ratio[:, None] - axis[:, 1:2] * bend[:, None] * turned
    slopes[:, 1] = moved[:, 0] * ratio[:, None] + axis[:, :1] * bend[:, None] * turned
    between = axis + np.array([0.0, 0.0, 1.0])
    denominator = np.maximum(1.0 + axis[:, 2], 1e-9)
    slopes[:, 2] = product(between[:, None], w)[:, 0] / denominator[:, None]
    return slopes


KEPT = 0.97
"""Fraction of the allowed tilts that is used.

Between checked places they are a little larger.
"""


@dataclass(frozen=True)
class _Limb:
    """Kinematics of what one arm holds."""

    arm: GeneralArm
    """Platform and arm as one chain, with the held frame instead of the flange."""
    columns: list[int]
    """Columns of its joints among the robot's."""

    def at(self, position: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Compute rotations (k, 3, 3), positions (k, 3) [m] and Jacobians (k, 6, n)."""
        R, p, J_own = self.arm.linearised(np.ascontiguousarray(position[:, self.columns]))
        J = np.zeros((len(position), 6, position.shape[1]))
        J[:, :, self.columns] = J_own
        return R, p, J


def _limb(model: pin.Model, cell: Cell, name: str, T_flange_held: pin.SE3) -> _Limb:
    """Build the kinematics of an arm and its held frame."""
    robot, arm = cell.robot, cell.robot.arm(name)
    joints = [*robot.platform, *arm.joints]
    columns = robot.columns(joints)
    bounds = robot.limits.lower[columns], robot.limits.upper[columns]
    bare = GeneralArm.from_model(model, joints, arm.flange, cell.base, bounds)
    R = product(bare.R_last_flange, T_flange_held.rotation)
    p = bare.p_last_flange + product(bare.R_last_flange, T_flange_held.translation)
    return _Limb(replace(bare, R_last_flange=R, p_last_flange=p), columns)


class Chain:
    """Closed chain of a seam as residuals with Jacobians ([Qin2024] Eq. 2-6, 18, 19).

    The tool's pose in the part is compared with the seam's, independent of their place in the world: joints that carry
    both arms have no influence. A part without a master stands in the world.
    """

    def __init__(self, cell: Cell, work: SeamWork) -> None:
        """Build the kinematics, with the part's frame in place of the master's tool.

        Args:
            cell: robot, base and tools.
            work: the seam.
        """
        robot, n = cell.robot, len(cell.robot.joints)
        self.work = work
        self.joints = robot.joints
        """Names of the n joints."""
        model = pin.buildModelFromXML(robot.urdf)
        arm_joints = {arm.name: np.isin(robot.joints, arm.joints) for arm in robot.arms}
        none = np.zeros(n, dtype=np.bool_)
        self.slave_joints: BoolArray = arm_joints[work.slave]
        """The slave's own joints, shape (n,)."""
        self.master_joints: BoolArray = none if work.master is None else arm_joints[work.master]
        """The master's own joints, shape (n,); none without a master."""
        carries = np.isin(robot.joints, robot.platform)
        self.moves_tool: BoolArray = self.slave_joints | carries
        """Flags of joints that move the tool, shape (n,)."""
        self.moves_part: BoolArray = none if work.master is None else self.master_joints | carries
        """Flags of joints that move the part, shape (n,)."""
        self._tool = _limb(model, cell, work.slave, cell.tools[work.slave].tcp)
        self._part = None if work.master is None else _limb(model, cell, work.master, work.part)

    @cached_property
    def closes(self) -> BoolArray:
        """Flags of joints that change the tool's pose in the part, shape (n,).

        Joints that carry both arms do not.
        """
        return self.moves_tool ^ self.moves_part

    def bodies(self, position: FloatArray) -> Bodies:
        """Compute part and tool at configurations (k, n) [rad]."""
        tool = self._tool.at(position)
        if self._part is not None:
            return Bodies(*self._part.at(position), *tool)
        k, n = position.shape
        T = self.work.part
        stands = np.tile(T.rotation, (k, 1, 1)), np.tile(T.translation, (k, 1))
        return Bodies(*stands, np.zeros((k, 6, n)), *tool)

    def equations(self, bodies: Bodies, share: FloatArray) -> Equations:
        """Assemble the equations of a tool on the seam within its freedoms.

        Distance of the tool's working point from the seam (3 rows, along the target axes), tilt of its axis (2 rows, if
        none is allowed), and its spin (1 row, if not free). One-sided rows follow: tilt of the axis beyond the allowed
        one, and of the surface beyond `downhand`.

        Args:
            bodies: at k configurations.
            share: fractions of the seam, shape (k,).
        """
        work = self.work
        r, J = self.offsets(bodies, share)
        rows = [0, 1, 2] if work.tool.tilt > 0.0 else [0, 1, 2, 3, 4]
        rows += [] if work.tool.free_spin else [5]
        equations = Equations(
            r[:, rows], J[:, rows], np.array([1.0 if i < 3 else TURN for i in rows])
        )
        if work.tool.tilt > 0.0:
            lean = norm(r[:, 3:5], axis=1)
            along = r[:, 3:5] / np.maximum(lean, 1e-12)[:, None]
            slope = (along[:, :, None] * J[:, 3:5]).sum(axis=1)
            equations = equations.with_one_sided(lean - KEPT * work.tool.tilt, slope)
        if work.downhand is not None:
            upward, J_upward = self.upward(bodies, share)
            angle = arccos(np.clip(upward, -1.0, 1.0))
            slope = -J_upward / np.maximum(sin(angle), 1e-6)[:, None]
            equations = equations.with_one_sided(angle - KEPT * work.downhand, slope)
        return equations

    def leans_too_far(self, bodies: Bodies, share: FloatArray, kept: float = 1.0) -> bool:
        """Test whether tool or surface tilts more than allowed at any of k configurations.

        Args:
            bodies: at k configurations.
            share: fractions of the seam, shape (k,).
            kept: fraction of the allowed tilts.
        """
        work, farthest = self.work, -np.inf
        if work.tool.tilt > 0.0:
            lean = norm(self.offsets(bodies, share)[0][:, 3:5], axis=1)
            farthest = float((lean - kept * work.tool.tilt).max())
        if work.downhand is not None:
            upward, _ = self.upward(bodies, share)
            angle = arccos(np.clip(upward, -1.0, 1.0))
            farthest = max(farthest, float((angle - kept * work.downhand).max()))
        return farthest > 0.0

    def offsets(self, bodies: Bodies, share: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute tool errors on the seam (k, 6) and their Jacobians (k, 6, n).

        Entries 0 to 2: distance of the working point from the seam [m]; 3 and 4: tilt of its axis; 5: spin [rad].
        """
        work = self.work
        R_seam, p_seam = work.tool_frames(share)
        R_should = product(bodies.R_part, R_seam)
        tip = bodies.p_tool + work.tool.standoff * bodies.R_tool[:, :, 2]
        target = bodies.p_part + product(bodies.R_part, p_seam[..., None])[..., 0]
        to_should = np.swapaxes(R_should, -1, -2)
        r = np.empty((len(share), 6))
        r[:, :3] = product(to_should, (tip - target)[..., None])[..., 0]
        E = product(to_should, bodies.R_tool)
        r[:, 3:] = lean_and_spin(E)
        Jt, Jp = bodies.J_tool, bodies.J_part
        v = Jt[:, :3] - product(skew(tip - bodies.p_tool), Jt[:, 3:])
        # The part carries the seam's point, and the axes along which the difference is taken.
        v = v - Jp[:, :3] + product(skew(tip - bodies.p_part), Jp[:, 3:])
        turning = lean_slopes(E, product(to_should, Jt[:, 3:] - Jp[:, 3:]))
        J = np.concatenate([product(to_should, v), turning], axis=1)
        return r, J

    def nearest_share(self, bodies: Bodies, share: FloatArray, steps: int = 3) -> FloatArray:
        """Find the fractions (k,) of the seam nearest to the tool's working point.

        Args:
            bodies: at k configurations.
            share: initial fractions, shape (k,).
            steps: Newton steps along the seam.
        """
        work = self.work
        tip = bodies.p_tool + work.tool.standoff * bodies.R_tool[:, :, 2]
        inside = product((tip - bodies.p_part)[:, None], bodies.R_part)[:, 0]
        for _ in range(steps):
            s = share * work.length
            along = ((inside - work.curve.at(s)[1]) * work.curve.directions(s)).sum(axis=1)
            share = np.clip(share + along / work.length, 0.0, 1.0)
        return share

    def part_equations(self, bodies: Bodies, R: FloatArray, p: FloatArray) -> Equations:
        """Assemble the equations of the part at given poses: 6 rows.

        Args:
            bodies: at k configurations.
            R: rotations, shape (k, 3, 3).
            p: positions [m], shape (k, 3).
        """
        turn = log_rotation(product(bodies.R_part, np.swapaxes(R, -1, -2)))
        scale = np.array([1.0, 1.0, 1.0, TURN, TURN, TURN])
        return Equations(np.concatenate([bodies.p_part - p, turn], axis=1), bodies.J_part, scale)

    def upward(self, bodies: Bodies, share: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute the vertical component of the surface normal, (k,), and its Jacobian, (k, n).

        Args:
            bodies: at k configurations.
            share: fractions of the seam, shape (k,).
        """
        R, _ = self.work.curve.at(share * self.work.length)
        normal = product(bodies.R_part, R[:, :, 2:])[..., 0]
        # d normal = w x normal; its z is (w_x n_y - w_y n_x).
        w = bodies.J_part[:, 3:]
        return normal[:, 2], w[:, 0] * normal[:, 1:2] - w[:, 1] * normal[:, :1]
