"""Ways of general arms to make stops: sampled postures at targets, followed along their lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray, distinct
from dualarm_cli.kinematics.continuation import FlangeLines
from dualarm_cli.kinematics.self_motion import branches, self_motions
from dualarm_cli.postures.problem import POSTURES, StopPosture
from dualarm_cli.postures.stop_batch import StopBatch, ToolPoses
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class NumericWays:
    """k ways to make stops; every array has k rows."""

    row: IntArray
    """Which problem of the batch."""
    target: IntArray
    """Which nominal target."""
    yaw: FloatArray
    """Turn about the tool's z axis [rad]."""
    branch: IntArray
    """Branch, as `branches` numbers them pose by pose (given configurations: which one)."""
    q: FloatArray
    """Joints at the target [rad], shape (k, n)."""
    drift: FloatArray
    """Way along the self-motion that comes with approach and retract, counted outward [rad], shape (k, 2)."""
    ends: FloatArray
    """Joints where approach begins and retract ends [rad], shape (k, 2, n)."""
    line: FloatArray
    """Estimated times of approach and retract [s], infinite where they cannot be followed, shape (k, 2)."""

    @classmethod
    def at_targets(
        cls, row: IntArray, target: IntArray, yaw: FloatArray, branch: IntArray, q: FloatArray
    ) -> NumericWays:
        """Returns ways whose lines are still to be followed, without drift."""
        k = len(q)
        drift, line = np.zeros((k, 2)), np.full((k, 2), np.inf)
        return cls(row, target, yaw, branch, q, drift, np.repeat(q[:, None], 2, axis=1), line)

    @classmethod
    def together(cls, some: Sequence[NumericWays]) -> NumericWays:
        """Returns all rows of several, one after the other."""
        return cls(*(np.concatenate([getattr(w, f.name) for w in some]) for f in fields(cls)))

    def __len__(self) -> int:
        """Returns the number of ways."""
        return len(self.row)

    def take(self, index: IntArray | BoolArray) -> NumericWays:
        """Returns some of the ways, in the order of the index."""
        return NumericWays(*(getattr(self, field.name)[index] for field in fields(self)))

    def poses(self, batch: StopBatch) -> ToolPoses:
        """Returns the flange poses at the targets."""
        return batch.poses(self.row, self.target, self.yaw)

    def cost(self, batch: StopBatch) -> tuple[FloatArray, FloatArray]:
        """Returns the times of transfer and lines [s], and the same with what travel costs, both (k,)."""
        moved = self.ends[:, 0] - batch.start[self.row]
        transfer = np.maximum(batch.problems[0].transfer_time(moved), batch.waiting[self.row])
        time = transfer + self.line.sum(axis=1)
        return time, time + POSTURES.travel_weight * np.abs(moved).sum(axis=1)

    def posture(self, k: int, time: float) -> StopPosture:
        """Returns one way as the solution."""
        return StopPosture(
            target=int(self.target[k]),
            yaw=float(self.yaw[k]),
            branch=int(self.branch[k]),
            psi_target=0.0,
            psi_approach=float(self.drift[k, 0]),
            psi_retract=float(self.drift[k, 1]),
            q_approach=self.ends[k, 0],
            q_target=self.q[k],
            q_retract=self.ends[k, 1],
            cost=time,
        )


def target_ways(batch: StopBatch) -> tuple[NumericWays, FloatArray]:
    """Returns postures at the targets of all problems of a batch, and by how much each problem misses.

    With six joints all branches; with seven samples along all branches that are met (see `branches`); with more, one
    posture per start. Turns are those nearest to where the arm is before.

    Args:
        batch: the problems.

    Returns:
        The ways, and the miss of each problem's nearest target: distance [m] and angle [rad], shape (b, 2).
    """
    if batch.given:
        return _given(batch), np.zeros((len(batch.problems), 2))
    row, target, yaw = batch.turned_targets()
    poses = batch.poses(row, target, yaw)
    found = batch.numeric_arm.postures(poses.R, poses.p, thorough=True)
    pose, q, branch = found.pose, found.q, found.branch
    if batch.numeric_arm.spare == 1:
        traced = self_motions(batch.numeric_arm, q, poses.R[pose], poses.p[pose])
        branch = branches(batch.numeric_arm, pose, q, traced)
        of = np.broadcast_to(np.arange(len(pose)), traced.shape[:2])
        good = ~np.isnan(traced[..., 0])
        q, of = traced[good], of[good]
        order = np.argsort(of, kind="stable")
        q, of = q[order], of[order]
        pose, branch = pose[of], branch[of]
    ways = NumericWays.at_targets(
        row[pose],
        target[pose],
        yaw[pose],
        branch,
        batch.numeric_arm.nearest_turns(q, batch.start[row[pose]]),
    )
    miss = np.full((len(batch.problems), 2), np.inf)
    for k in np.argsort(-found.miss.sum(axis=1), kind="stable").tolist():
        miss[row[k]] = found.miss[k]
    return ways, miss


def _given(batch: StopBatch) -> NumericWays:
    counts = [len(problem.p_base_tool) for problem in batch.problems]
    row = np.repeat(np.arange(len(counts)), counts)
    target = np.concatenate([np.arange(count) for count in counts])
    q = batch.configurations(row, target)
    return NumericWays.at_targets(row, target, np.zeros(len(row)), target, q)


def clear_ones(batch: StopBatch, ways: NumericWays) -> NumericWays:
    """Returns the ways that are collision-free at their targets and, where known, at the ends of their lines."""
    kept = np.ones(len(ways), dtype=np.bool_)
    for row in distinct(ways.row).tolist():
        test = batch.problems[row].clear
        if test is None:
            continue
        left = np.flatnonzero(ways.row == row)
        left = left[test(ways.q[left], "target")]
        if np.isfinite(ways.line).all():
            left = left[test(ways.ends[left, 0], "approach")]
            left = left[test(ways.ends[left, 1], "retract")]
        kept[ways.row == row] = False
        kept[left] = True
    return ways.take(kept)


def followed(batch: StopBatch, ways: NumericWays, samples: int) -> NumericWays:
    """Returns ways with the ends and times of their lines.

    Args:
        batch: the problems.
        ways: postures at targets with drifts.
        samples: of each line.
    """
    length = batch.length[ways.row]
    if not length.any() or not len(ways):
        # Without lines both ends are the target itself, whatever the ways were made from.
        ends = np.repeat(ways.q[:, None], 2, axis=1)
        return replace(ways, ends=ends, line=np.zeros((len(ways), 2)))
    poses = ways.poses(batch)
    shift = -poses.z[:, None] * length[:, :, None]
    k, n = ways.q.shape
    twice = np.repeat(np.arange(k), 2)
    course = batch.numeric_arm.follow_lines(
        ways.q[twice],
        FlangeLines(poses.R[twice], poses.p[twice], shift.reshape(-1, 3)),
        ways.drift.ravel(),
        samples,
    )
    still = (length == 0.0).ravel()
    time = np.where(still, 0.0, np.inf)
    timed = course.ok & ~still
    if timed.any():
        share = np.linspace(0.0, 1.0, samples)
        time[timed] = batch.problems[0].line_time(course.q[:, timed].transpose(1, 0, 2), share)
    # Where there is no line there is nothing to drift along.
    ends = np.where(still[:, None], ways.q[twice], course.q[-1])
    return replace(ways, ends=ends.reshape(k, 2, n), line=time.reshape(k, 2))
