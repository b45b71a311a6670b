"""Lines of many stops at once: joints along them, whether they can be followed, how long they take."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.geometry.elementary import TURN, cos, sin
from dualarm_cli.kinematics.srs.arm_angle_curves import ArmAngleCurves, flips
from dualarm_cli.postures.stop_batch import StopBatch, ToolPoses
from dualarm_cli.records import dataclass

LARGEST_STEP = np.pi / 2
"""A joint that turns more than this between two samples of a line has jumped [rad]."""
SAME_POSTURE = 1e-6
"""Difference of a given configuration from the solution for its pose up to which they are one [rad]."""
FLIPPED = np.column_stack([flips(joint, np.arange(8)) for joint in range(7)])
"""Whether each joint takes the second of its two values in each branch, shape (8, 7)."""


@dataclass(frozen=True)
class Lines:
    """k lines from a target outward, sampled at equidistant shares of their length."""

    batch: StopBatch
    """The problems they belong to."""
    row: IntArray
    """Which problem each belongs to, shape (k,)."""
    length: FloatArray
    """Length of each [m], 0 for none, shape (k,)."""
    curves: ArmAngleCurves
    """Joints over the arm angle at every sample: targets of shape (s, k, 1)."""
    share: FloatArray
    """Shares of the length at the samples, from 0 to 1, shape (s,); only 0 where no line has a length."""

    @classmethod
    def of(cls, batch: StopBatch, poses: ToolPoses, length: FloatArray, samples: int) -> Lines:
        """Returns the lines from k tool poses.

        Args:
            batch: the problems.
            poses: where the lines begin.
            length: their lengths [m], shape (k,).
            samples: how many samples.
        """
        share = np.linspace(0.0, 1.0, samples) if length.any() else np.zeros(1)
        depth = share[:, None] * length
        points = poses.p - poses.z * depth[:, :, None]
        curves = batch.arm.curves(poses.R[None, :, None], points[:, :, None])
        return cls(batch, poses.row, length, curves, share)

    def follow(
        self, psi_target: FloatArray, psi_end: FloatArray, branch: IntArray, reference: FloatArray
    ) -> FollowedLines:
        """Returns joints along the lines for c courses of the arm angle each.

        The branch is fixed and angles are unwrapped from the target, so that the joints are continuous.

        Args:
            psi_target: arm angles at the target [rad], shape (k, c).
            psi_end: arm angles at the outer end [rad], shape (k, c); without a line there is nothing to vary along.
            branch: of each line, shape (k,).
            reference: joints to whose whole turns those at the target are nearest [rad], shape (k, 7); given
                configurations are taken as they are.
        """
        swing = np.where(self.length[:, None] > 0.0, psi_end - psi_target, 0.0)
        psi = psi_target + self.share[:, None, None] * swing
        q = np.empty((len(self.share), 7, *psi_target.shape))
        second = FLIPPED[branch][:, :, None]
        for joint, (plain, flipped) in enumerate(self.curves.pairs(sin(psi), cos(psi))):
            q[:, joint] = np.where(second[:, joint], flipped, plain)
        ok = self.curves.plane.reachable.all(axis=0) & _unwrap(q)
        arm = self.batch.arm
        at_target = np.moveaxis(q[0], 0, -1)
        turns = np.moveaxis(arm.nearest_turns(at_target, reference[:, None]), -1, 0) - q[0]
        if turns.any():
            q += turns
        if self.batch.given:
            ok = _as_given(q, ok, reference.T[:, :, None], self.length == 0.0)
        highest, lowest = np.moveaxis(q.max(axis=0), 0, -1), np.moveaxis(q.min(axis=0), 0, -1)
        return FollowedLines(q, ok & arm.within_limits(highest) & arm.within_limits(lowest))

    def least_times(self, followed: FollowedLines) -> FloatArray:
        """Returns what no motion along the lines can beat [s], shape (k, c): infinite where they cannot be followed.

        The closed form of the slowest joint from one end to the other.
        """
        if len(self.share) == 1:
            return np.where(followed.ok, 0.0, np.inf)
        least = self.batch.problems[0].transfer_time(followed.at(-1) - followed.at(0))
        return np.where(followed.ok, least, np.inf)

    def times(self, followed: FollowedLines, wanted: BoolArray | None = None) -> FloatArray:
        """Returns estimated times [s], shape (k, c): 0 without a line, infinite where it cannot be followed.

        Args:
            followed: the joints.
            wanted: which lines are worth the trouble, shape (k, c); the others get infinity; all of them by default.
        """
        asked = followed.ok if wanted is None else followed.ok & wanted
        time = np.where(asked, 0.0, np.inf)
        timed = asked & (self.length > 0.0)[:, None]
        if timed.any():
            position = followed.q[:, :, timed]
            time[timed] = self.batch.problems[0].line_time(position.transpose(2, 0, 1), self.share)
        return time


@dataclass(frozen=True)
class FollowedLines:
    """Joints along lines."""

    q: FloatArray
    """From the target outward [rad], shape (s, 7, k, c)."""
    ok: BoolArray
    """Whether a line can be followed at all samples, shape (k, c)."""

    def at(self, sample: int) -> FloatArray:
        """Returns the joints at one sample [rad], shape (k, c, 7): 0 is the target, -1 the outer end."""
        return np.moveaxis(self.q[sample], 0, -1)


def _unwrap(q: FloatArray) -> BoolArray:
    """Takes whole turns off in place along the first axis; returns where no joint jumps, (k, c)."""
    if len(q) == 1:
        return np.ones(q.shape[2:], dtype=np.bool_)
    steps = q[1:] - q[:-1]
    turns = np.rint(steps / TURN)
    if turns.any():
        turns *= TURN
        steps -= turns
        q[1:] -= np.cumsum(turns, axis=0)
    return np.asarray(np.abs(steps).max(axis=(0, 1)) <= LARGEST_STEP)


def _as_given(q: FloatArray, ok: BoolArray, given: FloatArray, still: BoolArray) -> BoolArray:
    """Puts given configurations (7, k, 1) where they belong, in place; returns what can be followed.

    The configuration itself counts, also where a singular wrist has others for the same pose; a line must start in it.
    """
    same = np.abs(q[0] - given).max(axis=0) < SAME_POSTURE
    q[:, :, still] = given[:, still]
    q[0] = given
    return (ok & same) | still[:, None]
