"""Equations of a closed chain: what is left of them, how they change with the joints, how tools lean and spin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.whole_body import cross

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


def lean_and_spin(E: FloatArray) -> FloatArray:
    """Returns how tools are turned away from how they should be, (k, 3) [rad].

    The first two are the lean of the axis, a vector as long as its angle; the third is the turn about the axis.

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


def lean_slopes(E: FloatArray, w: FloatArray) -> FloatArray:
    """Returns how lean and spin change, (k, 3, n), where tools turn by w (k, 3, n) per joint; see `lean_and_spin`.

    With the axis a = E e_z at the angle t from e_z the lean is (t / sin t) e_z x a, and the axis moves by w x a. What
    turns about the axis alone is the part of w along e_z + a, over 1 + a_z (the lean's own turn is the shortest one).

    Args:
        E: rotations of the tools in the frames as they should be, shape (k, 3, 3).
        w: turns in these frames by each of n joints [rad/rad], shape (k, 3, n).
    """
    axis = E[:, :, 2]
    moved = cross(np.swapaxes(w, 1, 2), axis[:, None]).swapaxes(1, 2)
    sine = np.hypot(axis[:, 0], axis[:, 1])
    angle = np.arctan2(sine, axis[:, 2])
    small = sine < 1e-6
    safe = np.where(small, 1.0, sine)
    ratio = np.where(small, 1.0, angle / safe)
    # d (t / sin t) / dt, and dt = -d a_z / sin t; near e_z both are small.
    bend = np.where(small, 0.0, (sine - angle * np.cos(angle)) / safe**2)
    turned = -moved[:, 2] / safe[:, None] * ~small[:, None]
    found = np.empty_like(w)
    found[:, 0] = -moved[:, 1] * ratio[:, None] - axis[:, 1:2] * bend[:, None] * turned
    found[:, 1] = moved[:, 0] * ratio[:, None] + axis[:, :1] * bend[:, None] * turned
    between = axis + np.array([0.0, 0.0, 1.0])
    over = np.maximum(1.0 + axis[:, 2], 1e-9)
    found[:, 2] = (between[:, None] @ w)[:, 0] / over[:, None]
    return found
