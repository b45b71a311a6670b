"""The closed chain: part in one arm, tool in the other, as equations in the joints of both."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.geometry.rotations import log_rotation, skew
from dualarm_cli.kinematics.whole_body import WholeBody
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.seam import SeamWork

TURN = 0.1
"""Length that a radian counts as where residuals are compared [m]."""


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
    """m equations at each of k configurations of n joints."""

    left: FloatArray
    """What is left of them [m or rad], shape (k, m)."""
    slope: FloatArray
    """How they change with the joints, shape (k, m, n)."""
    scale: FloatArray
    """Length that a unit counts as where they are compared [m], shape (m,)."""
    one_sided: int = 0
    """So many of the last rows may be anything below 0: they are 0 there, and change with nothing."""

    @property
    def size(self) -> FloatArray:
        """The largest of each configuration [m, radians by TURN], shape (k,)."""
        found: FloatArray = np.abs(self.left * self.scale).max(axis=1, initial=0.0)
        return found

    @property
    def exact(self) -> Equations:
        """Those that are not one-sided."""
        rows = slice(0, self.left.shape[1] - self.one_sided)
        return Equations(self.left[:, rows], self.slope[:, rows], self.scale[rows])

    def after(self, other: Equations) -> Equations:
        """Returns these after others that have no one-sided rows."""
        return Equations(
            np.concatenate([other.left, self.left], axis=1),
            np.concatenate([other.slope, self.slope], axis=1),
            np.concatenate([other.scale, self.scale]),
            self.one_sided,
        )

    def with_one_sided(self, excess: FloatArray, slope: FloatArray) -> Equations:
        """Returns them with one row more: an excess (k,) [rad] that may not be above 0, and its slope (k, n)."""
        above = excess > 0.0
        return Equations(
            np.concatenate([self.left, np.where(above, excess, 0.0)[:, None]], axis=1),
            np.concatenate([self.slope, (slope * above[:, None])[:, None]], axis=1),
            np.append(self.scale, TURN),
            self.one_sided + 1,
        )


class Chain:
    """A seam's closed chain on one cell's robot: [Qin2024] Eq. 2-6, 18 and 19, as residuals with Jacobians.

    The tool's pose in the part is compared with the seam's; where both are in the world plays no part, so that
    joints that carry both arms have no influence. A part without a master stands in the world.
    """

    def __init__(self, cell: Cell, work: SeamWork) -> None:
        """Builds the kinematics, the part's frame in place of the master's tool.

        Args:
            cell: robot, base and tools.
            work: the seam.
        """
        self.work = work
        if work.master is not None:
            holder = replace(cell.tools[work.master], tcp=work.part)
            cell = replace(cell, tools={**cell.tools, work.master: holder})
        self._body = WholeBody(cell)
        robot = cell.robot
        self._own = {arm.name: np.isin(robot.joints, arm.joints) for arm in robot.arms}
        self._slave = self._body.arms.index(work.slave)
        self._master = None if work.master is None else self._body.arms.index(work.master)
        self.joints = self._body.joints
        """Names of the n joints."""

    @cached_property
    def slave_joints(self) -> BoolArray:
        """The slave's own joints, shape (n,)."""
        return self._own[self.work.slave]

    @cached_property
    def master_joints(self) -> BoolArray:
        """The master's own joints, shape (n,); none without a master."""
        none = np.zeros(len(self.joints), dtype=np.bool_)
        return none if self.work.master is None else self._own[self.work.master]

    @cached_property
    def moves_tool(self) -> BoolArray:
        """Which joints move the tool, shape (n,)."""
        return self._body.moves[self._slave]

    @cached_property
    def moves_part(self) -> BoolArray:
        """Which joints move the part, shape (n,)."""
        if self._master is None:
            return np.zeros(len(self.joints), dtype=np.bool_)
        return self._body.moves[self._master]

    @cached_property
    def closes(self) -> BoolArray:
        """Which joints change the tool's pose in the part, shape (n,): those that carry both do not."""
        return self.moves_tool ^ self.moves_part

    def bodies(self, position: FloatArray) -> Bodies:
        """Returns part and tool at configurations (k, n) [rad]."""
        k, n = position.shape
        found = Bodies(
            np.empty((k, 3, 3)),
            np.empty((k, 3)),
            np.zeros((k, 6, n)),
            np.empty((k, 3, 3)),
            np.empty((k, 3)),
            np.empty((k, 6, n)),
        )
        tool, part = self._slave, self._master
        for i, q in enumerate(position):
            state = self._body.at(q)
            found.R_tool[i], found.p_tool[i] = state.R[tool], state.p[tool]
            found.J_tool[i] = state.J[6 * tool : 6 * tool + 6]
            if part is not None:
                found.R_part[i], found.p_part[i] = state.R[part], state.p[part]
                found.J_part[i] = state.J[6 * part : 6 * part + 6]
        if part is None:
            found.R_part[:], found.p_part[:] = self.work.part.rotation, self.work.part.translation
        return found

    def equations(
        self, bodies: Bodies, share: FloatArray, back: float | FloatArray = 0.0
    ) -> Equations:
        """Returns what has to vanish for the tool to be on the seam within its freedoms.

        The tool's working point against the seam's point (3 rows, along the tool's axes as they should be); the lean of
        its axis (2 rows, where the work leaves none); its spin (1 row, if not free). Then one-sided rows: what the axis
        leans beyond the tilt that the work leaves, what the surface leans beyond `downhand`.

        Args:
            bodies: at k configurations.
            share: of the seam, shape (k,).
            back: how far the tool is drawn back along its axis [m], a number or one for each, shape (k,).
        """
        work = self.work
        r, J = self.offsets(bodies, share, back)
        rows = [0, 1, 2] if work.tool.tilt > 0.0 else [0, 1, 2, 3, 4]
        rows += [] if work.tool.free_spin else [5]
        found = Equations(r[:, rows], J[:, rows], np.array([1.0 if i < 3 else TURN for i in rows]))
        if work.tool.tilt > 0.0:
            lean = np.linalg.norm(r[:, 3:5], axis=1)
            along = r[:, 3:5] / np.maximum(lean, 1e-12)[:, None]
            slope = (along[:, :, None] * J[:, 3:5]).sum(axis=1)
            found = found.with_one_sided(lean - work.tool.tilt, slope)
        if work.downhand is not None:
            upward, J_upward = self.upward(bodies, share)
            angle = np.arccos(np.clip(upward, -1.0, 1.0))
            slope = -J_upward / np.maximum(np.sin(angle), 1e-6)[:, None]
            found = found.with_one_sided(angle - work.downhand, slope)
        return found

    def offsets(
        self, bodies: Bodies, share: FloatArray, back: float | FloatArray = 0.0
    ) -> tuple[FloatArray, FloatArray]:
        """Returns how the tool is off the seam, (k, 6), and how that changes with the joints, (k, 6, n).

        Entries 0 to 2: the working point from the seam's point [m]; 3 and 4: lean of the tool's axis; 5: spin [rad].
        """
        work = self.work
        R_seam, p_seam = work.tool_frames(share)
        R_should = bodies.R_part @ R_seam
        reach = np.broadcast_to(work.tool.standoff + np.asarray(back), share.shape)
        tip = bodies.p_tool + reach[:, None] * bodies.R_tool[:, :, 2]
        there = bodies.p_part + (bodies.R_part @ p_seam[..., None])[..., 0]
        to_should = np.swapaxes(R_should, -1, -2)
        r = np.empty((len(share), 6))
        r[:, :3] = (to_should @ (tip - there)[..., None])[..., 0]
        r[:, 3:] = lean_and_spin(to_should @ bodies.R_tool)
        Jt, Jp = bodies.J_tool, bodies.J_part
        v = Jt[:, :3] - skew(tip - bodies.p_tool) @ Jt[:, 3:]
        # The part carries the seam's point, and the axes along which the difference is taken.
        v = v - Jp[:, :3] + skew(tip - bodies.p_part) @ Jp[:, 3:]
        J = np.concatenate([to_should @ v, to_should @ (Jt[:, 3:] - Jp[:, 3:])], axis=1)
        return r, J

    def nearest_share(self, bodies: Bodies, share: FloatArray, steps: int = 3) -> FloatArray:
        """Returns the shares (k,) of the seam whose points are nearest to the tool's working point.

        Args:
            bodies: at k configurations.
            share: where to begin, shape (k,).
            steps: Newton steps along the seam.
        """
        work = self.work
        tip = bodies.p_tool + work.tool.standoff * bodies.R_tool[:, :, 2]
        inside = ((tip - bodies.p_part)[:, None] @ bodies.R_part)[:, 0]
        for _ in range(steps):
            R, p = work.curve.at(share * work.length)
            along = ((inside - p) * R[:, :, 0]).sum(axis=1)
            share = np.clip(share + along / work.length, 0.0, 1.0)
        return share

    def part_equations(self, bodies: Bodies, R: FloatArray, p: FloatArray) -> Equations:
        """Returns what has to vanish for the part to be at poses in the world: 6 rows.

        Args:
            bodies: at k configurations.
            R: rotations, shape (k, 3, 3).
            p: positions [m], shape (k, 3).
        """
        turn = log_rotation(bodies.R_part @ np.swapaxes(R, -1, -2))
        scale = np.array([1.0, 1.0, 1.0, TURN, TURN, TURN])
        return Equations(np.concatenate([bodies.p_part - p, turn], axis=1), bodies.J_part, scale)

    def upward(self, bodies: Bodies, share: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Returns the vertical part of the surface's outward normal, (k,), and its change with the joints, (k, n).

        Args:
            bodies: at k configurations.
            share: of the seam, shape (k,).
        """
        R, _ = self.work.curve.at(share * self.work.length)
        normal = (bodies.R_part @ R[:, :, 2:])[..., 0]
        # d normal = w x normal; its z is (w_x n_y - w_y n_x).
        w = bodies.J_part[:, 3:]
        return normal[:, 2], w[:, 0] * normal[:, 1:2] - w[:, 1] * normal[:, :1]


def lean_and_spin(E: FloatArray) -> FloatArray:
    """Returns how tools are turned away from how they should be, (k, 3) [rad].

    The first two are the lean of the axis, a vector as long as its angle; the third the turn about it that is left.

    Args:
        E: rotations of the tools in the frames as they should be, shape (k, 3, 3).
    """
    x, y, z = np.moveaxis(E[..., :, 2], -1, 0)
    sine = np.hypot(x, y)
    scale = np.where(sine > 1e-9, np.arctan2(sine, z) / np.where(sine > 1e-9, sine, 1.0), 1.0)
    # e_z x axis is the lean; taking it back leaves the spin.
    lean = np.stack([-y * scale, x * scale, np.zeros_like(x)], axis=-1)
    spin = np.arctan2(E[..., 1, 0] - E[..., 0, 1], E[..., 0, 0] + E[..., 1, 1])
    lean[..., 2] = spin
    return lean
