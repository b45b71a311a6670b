"""Ways to make stops: many at once, each with its time; some of them, or one of each problem's."""

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
class StopWays:
    """n ways to make stops; every array has shape (n,)."""

    row: IntArray
    """Which problem of the batch."""
    target: IntArray
    """Which nominal target."""
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
    """Time of transfer, approach and retract [s], infinite where a way cannot be gone."""
    cost: FloatArray
    """The same and a little for the joints' travel [s]."""

    @classmethod
    def at_targets(
        cls, row: IntArray, target: IntArray, yaw: FloatArray, branch: IntArray, psi: FloatArray
    ) -> StopWays:
        """Returns ways without swings whose times are still open, written as 0."""
        open_ = np.zeros(len(row))
        return cls(row, target, yaw, branch, psi, open_, open_, open_, open_)

    @classmethod
    def together(cls, some: Sequence[StopWays]) -> StopWays:
        """Returns all rows of several, one after the other."""
        return cls(*(np.concatenate([getattr(w, f.name) for w in some]) for f in fields(cls)))

    def take(self, index: IntArray) -> StopWays:
        """Returns some of the ways, in the order of the index."""
        return StopWays(*(getattr(self, field.name)[index] for field in fields(self)))

    def poses(self, batch: StopBatch) -> ToolPoses:
        """Returns the tool poses at the targets."""
        return batch.poses(self.row, self.target, self.yaw)

    def reference(self, batch: StopBatch) -> FloatArray:
        """Returns the joints whose whole turns those at the targets are nearest to [rad], shape (n, 7)."""
        if batch.given:
            return batch.configurations(self.row, self.target)
        return batch.start[self.row]

    def follow(self, batch: StopBatch, samples: int) -> FollowedLines:
        """Returns the joints along both lines of every way: 2 n lines, all approaches before all retracts."""
        twice = np.tile(np.arange(len(self.row)), 2)
        both = self.take(twice)
        lines = Lines.of(batch, both.poses(batch), batch.length[self.row].T.ravel(), samples)
        end = both.psi + np.concatenate([self.swing_in, self.swing_out])
        return lines.follow(both.psi[:, None], end[:, None], both.branch, both.reference(batch))


def transfer_cost(batch: StopBatch, row: IntArray, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Returns the times of transfers [s], the platform's included, and what their travel costs, both (k, ...).

    Args:
        batch: the problems.
        row: which problem each belongs to, shape (k,).
        q: where the transfers end [rad], shape (k, ..., 7).
    """
    between = (slice(None), *[None] * (q.ndim - 2))
    moved = q - batch.start[row][between]
    time = np.maximum(batch.problems[0].transfer_time(moved), batch.waiting[row][between])
    return time, POSTURES.travel_weight * np.abs(moved).sum(axis=-1)
