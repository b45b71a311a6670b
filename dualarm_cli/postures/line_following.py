"""Lines of many stops: joints along them, feasibility and times."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.geometry.elementary import TURN, cos, sin
from dualarm_cli.kinematics.srs.arm_angle_curves import ArmAngleCurves, flips
from dualarm_cli.postures.stop_batch import StopBatch, ToolPoses
from dualarm_cli.records import dataclass

LARGEST_STEP = np.pi / 2
"""Largest joint step between two samples of a line; a larger one is a jump [rad]."""
SAME_POSTURE = 1e-6
"""Tolerance of a given configuration against the solution for its pose [rad]."""
FLIPPED = np.column_stack([flips(joint, np.arange(8)) for joint in range(7)])
"""Flags of joints at the second of their two values, by branch, shape (8, 7)."""


@dataclass(frozen=True)
class Lines:
    """Lines from targets outward, sampled at equidistant fractions of their length."""

    batch: StopBatch
    """Problems of the lines."""
    row: IntArray
    """Numbers of the problems, shape (k,)."""
    length: FloatArray
    """Lengths of the lines [m], 0 for none, shape (k,)."""
    curves: ArmAngleCurves
    """Joints over the arm angle at every sample: targets of shape (s, k, 1)."""
    share: FloatArray
    """Fractions of the length at the samples, shape (s,); only 0 without any length."""

    @classmethod
    def of(
        cls, batch: StopBatch, poses: ToolPoses, line: tuple[FloatArray, FloatArray], samples: int
    ) -> Lines:
        """Sample the lines from k tool poses.

        Args:
            batch: the problems.
            poses: poses at the targets.
            line: directions outward (k, 3) and lengths (k,) [m] of the lines.
            samples: number of samples.
        """
        outward, length = line
        share = np.linspace(0.0, 1.0, samples) if length.any() else np.zeros(1)
        depth = share[:, None] * length
        points = poses.p + outward * depth[:, :, None]
        curves = batch.arm.curves(poses.R[None, :, None], points[:, :, None])
        return cls(batch, poses.row, length, curves, share)

    def follow(
        self, psi_target: FloatArray, psi_end: FloatArray, branch: IntArray, reference: FloatArray
    ) -> FollowedLines:
        """Compute the joints along the lines for c courses of the arm angle each.

        The branch is fixed and angles are unwrapped from the target, so that the joints are continuous.

        Args:
            psi_target: arm angles at the target [rad], shape (k, c).
            psi_end: arm angles at the outer end [rad], shape (k, c); ignored without a line.
            branch: of each line, shape (k,).
            reference: joints next to which whole turns are chosen at the target [rad], shape (k, 7); given
                configurations are not changed.
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
            ok = _insert_given(q, ok, reference.T[:, :, None], self.length == 0.0)
        highest, lowest = np.moveaxis(q.max(axis=0), 0, -1), np.moveaxis(q.min(axis=0), 0, -1)
        return FollowedLines(q, ok & arm.within_limits(highest) & arm.within_limits(lowest))

    def least_times(self, followed: FollowedLines) -> FloatArray:
        """Bound the times along the lines from below [s], shape (k, c), infinite if infeasible.

        The closed form of the slowest joint from one end to the other.
        """
        if len(self.share) == 1:
            return np.where(followed.ok, 0.0, np.inf)
        least = self.batch.problems[0].transfer_time(followed.at(-1) - followed.at(0))
        return np.where(followed.ok, least, np.inf)

    def times(self, followed: FollowedLines, selected: BoolArray | None = None) -> FloatArray:
        """Estimate the times along the lines [s], shape (k, c), infinite if infeasible.

        Lines without length take 0.

        Args:
            followed: the joints.
            selected: lines to time, shape (k, c); the others get infinity. None times all.
        """
        is_timed = followed.ok if selected is None else followed.ok & selected
        time = np.where(is_timed, 0.0, np.inf)
        has_length = is_timed & (self.length > 0.0)[:, None]
        if has_length.any():
            position = followed.q[:, :, has_length]
            time[has_length] = self.batch.problems[0].line_time(
                position.transpose(2, 0, 1), self.share
            )
        return time


@dataclass(frozen=True)
class FollowedLines:
    """Joints along lines, with feasibility."""

    q: FloatArray
    """Joints from the target outward [rad], shape (s, 7, k, c)."""
    ok: BoolArray
    """Flags of lines that are feasible at every sample, shape (k, c)."""

    def at(self, sample: int) -> FloatArray:
        """Return the joints at one sample [rad], shape (k, c, 7): 0 target, -1 outer end."""
        return np.moveaxis(self.q[sample], 0, -1)


def _unwrap(q: FloatArray) -> BoolArray:
    """Unwrap joints in place along the first axis, and flag lines without jumps, (k, c)."""
    if len(q) == 1:
        return np.ones(q.shape[2:], dtype=np.bool_)
    steps = q[1:] - q[:-1]
    turns = np.rint(steps / TURN)
    if turns.any():
        turns *= TURN
        steps -= turns
        q[1:] -= np.cumsum(turns, axis=0)
    return np.asarray(np.abs(steps).max(axis=(0, 1)) <= LARGEST_STEP)


def _insert_given(q: FloatArray, ok: BoolArray, given: FloatArray, still: BoolArray) -> BoolArray:
    """Insert given configurations (7, k, 1) at targets in place, and flag feasible lines.

    The configuration itself counts, even if a singular wrist has others for the same pose; a line must start in it.
    """
    same = np.abs(q[0] - given).max(axis=0) < SAME_POSTURE
    q[:, :, still] = given[:, still]
    q[0] = given
    return (ok & same) | still[:, None]
