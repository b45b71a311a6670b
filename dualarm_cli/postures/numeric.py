"""Numeric redundancy solver for arms without closed forms.

Postures are sampled by inverse kinematics, follow_lines along their lines, then refine.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import power
from dualarm_cli.kinematics.continuation import moved_along
from dualarm_cli.postures.numeric_candidates import (
    NumericCandidates,
    follow_lines,
    select_clear,
    target_candidates,
)
from dualarm_cli.postures.problem import POSTURES, NoPosture, StopPosture, StopProblem
from dualarm_cli.postures.stop_batch import StopBatch
from dualarm_cli.refusals import Refusal


def choose_numeric(problem: StopProblem) -> StopPosture | NoPosture:
    """Choose the posture of least time for transfer, approach and retract.

    Postures at the target are solved from many starts and, if a joint is redundant, sampled along their self-motion
    (`target_candidates`); the quickest are follow_lines along their lines by continuation (`FlangeLines`); the best are
    refine along self-motion, free yaw and drift in rounds of decreasing width. No optimality is claimed.

    Raises:
        UnsupportedError: the arm was measured in closed form.
    """
    batch = StopBatch((problem,))
    candidates, miss = target_candidates(batch)
    if not len(candidates):
        return NoPosture(_miss_refusal(miss[0]))
    travel = candidates.q - problem.start
    candidates = candidates.take(np.argsort(problem.transfer_time(travel), kind="stable"))
    clear = False
    size = POSTURES.general_batch
    for first in range(0, len(candidates), size):
        block = select_clear(
            batch, candidates.take(np.arange(first, min(first + size, len(candidates))))
        )
        clear |= len(block) > 0
        block = _sort_by_cost(batch, select_clear(batch, _with_initial_drifts(batch, block)))
        for k in _refinement_order(block):
            posture = _refine_to_posture(batch, block.take(np.array([k])))
            if posture is not None:
                return _quickest_refined(batch, block, k, posture)
    if not clear:
        return NoPosture(Refusal("target_touches"))
    reason = "lines_not_followed" if problem.is_free is None else "lines_not_clear"
    return NoPosture(Refusal(reason))


def _miss_refusal(miss: FloatArray) -> Refusal:
    distance, angle = miss
    if not np.isfinite(distance):
        return Refusal("target_out_of_reach")
    return Refusal("target_missed", data={"mm": distance * 1e3, "degrees": np.degrees(angle)})


def _with_initial_drifts(batch: StopBatch, candidates: NumericCandidates) -> NumericCandidates:
    """Select feasible candidates with the quickest drift of each line."""
    varies = batch.numeric_arm.spare and batch.length.any()
    drifts = POSTURES.general_drifts if varies else (0.0,)
    return _best_drifts(
        batch, candidates, np.broadcast_to(drifts, (len(candidates), 2, len(drifts)))
    )


def _best_drifts(
    batch: StopBatch, candidates: NumericCandidates, drifts: FloatArray
) -> NumericCandidates:
    """Select feasible candidates with the best of d drifts of each line.

    The two lines are independent of each other.

    Args:
        batch: the problems.
        candidates: k postures at targets.
        drifts: drifts to compare [rad], shape (k, 2, d).
    """
    k, d = len(candidates), drifts.shape[2]
    repeated = candidates.take(np.repeat(np.arange(k), d))
    repeated = replace(repeated, drift=np.swapaxes(drifts, 1, 2).reshape(-1, 2))
    repeated = follow_lines(batch, repeated, POSTURES.line_samples)
    transfer = replace(repeated, line=np.zeros_like(repeated.line)).cost(batch)[1]
    line = repeated.line.reshape(k, d, 2)
    best_in = (transfer.reshape(k, d) + line[:, :, 0]).argmin(axis=1)
    best_out = line[:, :, 1].argmin(axis=1)
    rows = np.arange(k)
    pick_in, pick_out = repeated.take(rows * d + best_in), repeated.take(rows * d + best_out)
    best = replace(
        pick_in,
        drift=np.stack([pick_in.drift[:, 0], pick_out.drift[:, 1]], axis=1),
        ends=np.stack([pick_in.ends[:, 0], pick_out.ends[:, 1]], axis=1),
        line=np.stack([pick_in.line[:, 0], pick_out.line[:, 1]], axis=1),
    )
    return best.take(np.flatnonzero(np.isfinite(best.line).all(axis=1)))


def _sort_by_cost(batch: StopBatch, candidates: NumericCandidates) -> NumericCandidates:
    return candidates.take(np.argsort(candidates.cost(batch)[1], kind="stable"))


def _refinement_order(candidates: NumericCandidates) -> list[int]:
    """Order sorted candidates: the best of each yaw and branch first."""
    key = np.stack([candidates.target, candidates.branch]).T
    _, first = np.unique(key, axis=0, return_index=True)
    ahead = np.sort(first)
    others = np.setdiff1d(np.arange(len(candidates)), ahead)
    return [*ahead.tolist(), *others.tolist()]


def _quickest_refined(
    batch: StopBatch, candidates: NumericCandidates, first: int, first_posture: StopPosture
) -> StopPosture:
    """Return the quickest refine posture of the leading candidates."""
    if not batch.refine:
        return first_posture
    best = first_posture
    order = _refinement_order(candidates)
    place = order.index(first)
    for k in order[place + 1 : place + POSTURES.general_starts]:
        posture = _refine_to_posture(batch, candidates.take(np.array([k])))
        if posture is not None and posture.cost < best.cost:
            best = posture
    return best


def _refine_to_posture(batch: StopBatch, candidate: NumericCandidates) -> StopPosture | None:
    """Refine one candidate to a posture that is feasible at dense samples, or None."""
    variations = [candidate]
    if batch.refine and (batch.numeric_arm.spare or batch.free_yaw):
        variations += refine(batch, candidate)
    for variation in reversed(variations):
        if holds(batch, variation):
            time, _ = variation.cost(batch)
            return variation.posture(0, float(time[0]))
    return None


def holds(batch: StopBatch, candidate: NumericCandidates) -> bool:
    """Return whether a candidate is feasible at dense samples and collision-free."""
    dense = follow_lines(batch, candidate, POSTURES.general_dense_samples)
    return bool(np.isfinite(dense.line).all()) and len(select_clear(batch, dense)) == 1


def refine(batch: StopBatch, candidate: NumericCandidates) -> list[NumericCandidates]:
    """Refine one candidate, and list its improvements in order."""
    improvements: list[NumericCandidates] = []
    best = candidate
    for k in range(POSTURES.general_rounds):
        width = POSTURES.general_width * power(POSTURES.general_shrink, k)
        variations = _vary_drifts(batch, vary(batch, best, width), width)
        if not len(variations):
            continue
        cost = variations.cost(batch)[1]
        least = int(cost.argmin())
        if cost[least] < best.cost(batch)[1][0]:
            best = variations.take(np.array([least]))
            improvements.append(best)
    return improvements


def vary(batch: StopBatch, candidate: NumericCandidates, width: float) -> NumericCandidates:
    """Vary one candidate along self-motion and free yaw, by up to a half-width [rad]."""
    spare = batch.numeric_arm.spare and not batch.given
    along = width * np.array(POSTURES.along_self_motion if spare else (0.0,))
    turn = width * np.array(POSTURES.to_sides if batch.free_yaw else (0.0,))
    count = len(along) * len(turn)
    neighbours = candidate.take(np.zeros(count, dtype=np.int64))
    neighbours = replace(neighbours, yaw=neighbours.yaw + np.repeat(turn, len(along)))
    if count == 1:
        return neighbours
    poses = neighbours.poses(batch)
    q, reached = moved_along(
        batch.numeric_arm, neighbours.q, poses.R, poses.p, np.tile(along, len(turn))
    )
    return replace(neighbours, q=q).take(reached)


def _vary_drifts(
    batch: StopBatch, candidates: NumericCandidates, width: float
) -> NumericCandidates:
    """Vary the drifts of candidates by up to a half-width [rad], and select the best."""
    varies = batch.numeric_arm.spare and batch.length.any()
    steps = np.array(POSTURES.to_sides if varies else (0.0,))
    return _best_drifts(batch, candidates, candidates.drift[:, :, None] + width * steps)
