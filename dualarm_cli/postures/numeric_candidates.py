"""Candidate postures of general arms: sampled at targets, followed along lines."""

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
class NumericCandidates:
    """Candidate postures of stops; every array has k rows."""

    row: IntArray
    """Numbers of the problems in the batch."""
    target: IntArray
    """Numbers of the nominal targets."""
    yaw: FloatArray
    """Turn about the tool's z axis [rad]."""
    branch: IntArray
    """Branch as numbered by `branches` for each pose, or number of a given configuration."""
    q: FloatArray
    """Joints at the target [rad], shape (k, n)."""
    drift: FloatArray
    """Self-motion along approach and retract, counted outward [rad], shape (k, 2)."""
    ends: FloatArray
    """Joints at the outer ends of approach and retract [rad], shape (k, 2, n)."""
    line: FloatArray
    """Estimated times of approach and retract [s], infinite if infeasible, shape (k, 2)."""

    @classmethod
    def at_targets(
        cls, row: IntArray, target: IntArray, yaw: FloatArray, branch: IntArray, q: FloatArray
    ) -> NumericCandidates:
        """Create candidates without drift whose lines are not follow_lines yet."""
        k = len(q)
        drift, line = np.zeros((k, 2)), np.full((k, 2), np.inf)
        return cls(row, target, yaw, branch, q, drift, np.repeat(q[:, None], 2, axis=1), line)

    @classmethod
    def concatenated(cls, parts: Sequence[NumericCandidates]) -> NumericCandidates:
        """Concatenate the rows of several sets of candidates."""
        return cls(*(np.concatenate([getattr(w, f.name) for w in parts]) for f in fields(cls)))

    def __len__(self) -> int:
        """Return the number of candidates."""
        return len(self.row)

    def take(self, index: IntArray | BoolArray) -> NumericCandidates:
        """Select candidates, in the order of the index."""
        return NumericCandidates(*(getattr(self, field.name)[index] for field in fields(self)))

    def poses(self, batch: StopBatch) -> ToolPoses:
        """Compute the flange poses at the targets."""
        return batch.poses(self.row, self.target, self.yaw)

    def cost(self, batch: StopBatch) -> tuple[FloatArray, FloatArray]:
        """Compute times of transfer and lines, and times plus travel cost [s], both (k,)."""
        moved = self.ends[:, 0] - batch.start[self.row]
        transfer = np.maximum(batch.problems[0].transfer_time(moved), batch.waiting[self.row])
        time = transfer + self.line.sum(axis=1)
        return time, time + POSTURES.travel_weight * np.abs(moved).sum(axis=1)

    def posture(self, k: int, time: float) -> StopPosture:
        """Convert one candidate to the solution."""
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


def target_candidates(batch: StopBatch) -> tuple[NumericCandidates, FloatArray]:
    """Sample postures at the targets of a batch, and measure its problems' misses.

    Arms of six joints have all branches; of seven, samples along the self-motion of all branches found (see
    `branches`); of more, one posture per start. Whole turns are nearest to the joints before the stop.

    Args:
        batch: the problems.

    Returns:
        The candidates, and the miss of each problem's nearest target: distance [m] and angle [rad], shape (b, 2).
    """
    if batch.given:
        return _given(batch), np.zeros((len(batch.problems), 2))
    row, target, yaw = batch.turned_targets()
    poses = batch.poses(row, target, yaw)
    solutions = batch.numeric_arm.postures(poses.R, poses.p, thorough=True)
    pose, q, branch = solutions.pose, solutions.q, solutions.branch
    if batch.numeric_arm.spare == 1:
        traced = self_motions(batch.numeric_arm, q, poses.R[pose], poses.p[pose])
        branch = branches(batch.numeric_arm, pose, q, traced)
        origin = np.broadcast_to(np.arange(len(pose)), traced.shape[:2])
        is_sample = ~np.isnan(traced[..., 0])
        q, origin = traced[is_sample], origin[is_sample]
        order = np.argsort(origin, kind="stable")
        q, origin = q[order], origin[order]
        pose, branch = pose[origin], branch[origin]
    candidates = NumericCandidates.at_targets(
        row[pose],
        target[pose],
        yaw[pose],
        branch,
        batch.numeric_arm.nearest_turns(q, batch.start[row[pose]]),
    )
    miss = np.full((len(batch.problems), 2), np.inf)
    for k in np.argsort(-solutions.miss.sum(axis=1), kind="stable").tolist():
        miss[row[k]] = solutions.miss[k]
    return candidates, miss


def _given(batch: StopBatch) -> NumericCandidates:
    counts = [len(problem.p_base_tool) for problem in batch.problems]
    row = np.repeat(np.arange(len(counts)), counts)
    target = np.concatenate([np.arange(count) for count in counts])
    q = batch.configurations(row, target)
    return NumericCandidates.at_targets(row, target, np.zeros(len(row)), target, q)


def select_clear(batch: StopBatch, candidates: NumericCandidates) -> NumericCandidates:
    """Select candidates without collision at targets and at follow_lines ends of lines."""
    is_clear = np.ones(len(candidates), dtype=np.bool_)
    for row in distinct(candidates.row).tolist():
        test = batch.problems[row].is_free
        if test is None:
            continue
        clear = np.flatnonzero(candidates.row == row)
        clear = clear[test(candidates.q[clear], "target")]
        if np.isfinite(candidates.line).all():
            clear = clear[test(candidates.ends[clear, 0], "approach")]
            clear = clear[test(candidates.ends[clear, 1], "retract")]
        is_clear[candidates.row == row] = False
        is_clear[clear] = True
    return candidates.take(is_clear)


def follow_lines(
    batch: StopBatch, candidates: NumericCandidates, samples: int
) -> NumericCandidates:
    """Follow the lines of candidates, and estimate their times.

    Args:
        batch: the problems.
        candidates: postures at targets with drifts.
        samples: of each line.
    """
    length = batch.length[candidates.row]
    if not length.any() or not len(candidates):
        # Without lines both ends are the target itself.
        ends = np.repeat(candidates.q[:, None], 2, axis=1)
        return replace(candidates, ends=ends, line=np.zeros((len(candidates), 2)))
    poses = candidates.poses(batch)
    shift = poses.outward * length[:, :, None]
    k, n = candidates.q.shape
    twice = np.repeat(np.arange(k), 2)
    path = batch.numeric_arm.follow_lines(
        candidates.q[twice],
        FlangeLines(poses.R[twice], poses.p[twice], shift.reshape(-1, 3)),
        candidates.drift.ravel(),
        samples,
    )
    still = (length == 0.0).ravel()
    time = np.where(still, 0.0, np.inf)
    timed = path.ok & ~still
    if timed.any():
        progress = np.linspace(0.0, 1.0, samples)
        time[timed] = batch.problems[0].line_time(path.q[:, timed].transpose(1, 0, 2), progress)
    # Without a line there is no drift.
    ends = np.where(still[:, None], candidates.q[twice], path.q[-1])
    return replace(candidates, ends=ends.reshape(k, 2, n), line=time.reshape(k, 2))
