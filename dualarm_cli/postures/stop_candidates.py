"""Candidate postures of stops with their times, many in one array."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.postures.line_following import FollowedLines, Lines
from dualarm_cli.postures.problem import POSTURES
from dualarm_cli.postures.stop_batch import StopBatch, ToolPoses
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class StopCandidates:
    """Candidate postures of stops; every array has shape (n,)."""

    row: IntArray
    """Numbers of the problems in the batch."""
    target: IntArray
    """Numbers of the nominal targets."""
    yaw: FloatArray
    """Turn about the tool's z axis [rad]."""
    branch: IntArray
    """Branch of the inverse kinematics."""
    psi: FloatArray
    """Arm angle at the target [rad]."""
    swing_in: FloatArray
    """Change of the arm angle from the target to where the approach starts [rad]."""
    swing_out: FloatArray
    """Change of the arm angle from the target to where the retract ends [rad]."""
    time: FloatArray
    """Time of transfer, approach and retract [s], infinite if infeasible."""
    cost: FloatArray
    """Time plus a small cost of the joints' travel [s]."""

    @classmethod
    def at_targets(
        cls, row: IntArray, target: IntArray, yaw: FloatArray, branch: IntArray, psi: FloatArray
    ) -> StopCandidates:
        """Create candidates without swings, with times of 0 until they are computed."""
        zero = np.zeros(len(row))
        return cls(row, target, yaw, branch, psi, zero, zero, zero, zero)

    @classmethod
    def concatenated(cls, parts: Sequence[StopCandidates]) -> StopCandidates:
        """Concatenate the rows of several sets of candidates."""
        return cls(*(np.concatenate([getattr(w, f.name) for w in parts]) for f in fields(cls)))

    def take(self, index: IntArray) -> StopCandidates:
        """Select candidates, in the order of the index."""
        return StopCandidates(*(getattr(self, field.name)[index] for field in fields(self)))

    def poses(self, batch: StopBatch) -> ToolPoses:
        """Compute the tool poses at the targets."""
        return batch.poses(self.row, self.target, self.yaw)

    def reference(self, batch: StopBatch) -> FloatArray:
        """Return the reference joints of whole turns at the targets [rad], shape (n, 7)."""
        if batch.given:
            return batch.configurations(self.row, self.target)
        return batch.start[self.row]

    def follow(self, batch: StopBatch, samples: int) -> FollowedLines:
        """Compute the joints along 2 n lines, all approaches before all retracts."""
        poses, twice = self.poses(batch), np.tile(np.arange(len(self.row)), 2)
        both_lines = self.take(twice)
        line = np.concatenate([*np.moveaxis(poses.outward, 1, 0)]), batch.length[self.row].T.ravel()
        lines = Lines.of(batch, poses.take(twice), line, samples)
        end = both_lines.psi + np.concatenate([self.swing_in, self.swing_out])
        return lines.follow(
            both_lines.psi[:, None], end[:, None], both_lines.branch, both_lines.reference(batch)
        )


def transfer_cost(batch: StopBatch, row: IntArray, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compute transfer times with the platform's, and travel costs [s], both (k, ...).

    Args:
        batch: the problems.
        row: numbers of the problems, shape (k,).
        q: joints at the end of the transfers [rad], shape (k, ..., 7).
    """
    between = (slice(None), *[None] * (q.ndim - 2))
    moved = q - batch.start[row][between]
    time = np.maximum(batch.problems[0].transfer_time(moved), batch.waiting[row][between])
    return time, POSTURES.travel_weight * np.abs(moved).sum(axis=-1)
