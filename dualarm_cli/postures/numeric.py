"""Posture of least time of arms without closed forms: sampled inverse kinematics, lines followed, then refined."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import power
from dualarm_cli.kinematics.continuation import moved_along
from dualarm_cli.postures.numeric_ways import (
    NumericWays,
    clear_ones,
    followed,
    target_ways,
)
from dualarm_cli.postures.problem import POSTURES, NoPosture, StopPosture, StopProblem
from dualarm_cli.postures.stop_batch import StopBatch
from dualarm_cli.refusals import Refusal


def choose_numeric(problem: StopProblem) -> StopPosture | NoPosture:
    """Returns the posture of least time for transfer, approach and retract, or why there is none.

    Postures at the target are solved for from many starts and, where a joint is spare, sampled along their self-motion
    (`target_ways`); the quickest are followed along their lines by continuation (`LineFollowing`); the best are refined
    along self-motion, free yaw and drift by rounds of ever narrower variation. No optimality is claimed.

    Raises:
        UnsupportedError: the arm was measured in closed form.
    """
    batch = StopBatch((problem,))
    ways, miss = target_ways(batch)
    if not len(ways):
        return NoPosture(_nowhere(miss[0]))
    moved = ways.q - problem.start
    ways = ways.take(np.argsort(problem.transfer_time(moved), kind="stable"))
    clear = False
    size = POSTURES.general_batch
    for first in range(0, len(ways), size):
        some = clear_ones(batch, ways.take(np.arange(first, min(first + size, len(ways)))))
        clear |= len(some) > 0
        some = _sorted(batch, clear_ones(batch, _drifted(batch, some)))
        for k in _leading(some):
            found = _settled(batch, some.take(np.array([k])))
            if found is not None:
                return _best_of(batch, some, k, found)
    if not clear:
        return NoPosture(Refusal("target_touches"))
    return NoPosture(Refusal("lines_not_followed" if problem.clear is None else "lines_not_clear"))


def _nowhere(miss: FloatArray) -> Refusal:
    distance, angle = miss
    if not np.isfinite(distance):
        return Refusal("target_out_of_reach")
    return Refusal("target_missed", more={"mm": distance * 1e3, "degrees": np.degrees(angle)})


def _drifted(batch: StopBatch, ways: NumericWays) -> NumericWays:
    """Returns ways that can be gone, each with the drift of either line that makes it quickest."""
    varies = batch.numeric_arm.spare and batch.length.any()
    drifts = POSTURES.general_drifts if varies else (0.0,)
    return _best_drifts(batch, ways, np.broadcast_to(drifts, (len(ways), 2, len(drifts))))


def _best_drifts(batch: StopBatch, ways: NumericWays, drifts: FloatArray) -> NumericWays:
    """Returns ways that can be gone with the best of d drifts of either line; lines do not depend on each other.

    Args:
        batch: the problems.
        ways: k postures at targets.
        drifts: to be tried [rad], shape (k, 2, d).
    """
    k, d = len(ways), drifts.shape[2]
    each = ways.take(np.repeat(np.arange(k), d))
    each = replace(each, drift=np.swapaxes(drifts, 1, 2).reshape(-1, 2))
    each = followed(batch, each, POSTURES.line_samples)
    transfer = replace(each, line=np.zeros_like(each.line)).cost(batch)[1]
    line = each.line.reshape(k, d, 2)
    best_in = (transfer.reshape(k, d) + line[:, :, 0]).argmin(axis=1)
    best_out = line[:, :, 1].argmin(axis=1)
    own = np.arange(k)
    pick_in, pick_out = each.take(own * d + best_in), each.take(own * d + best_out)
    found = replace(
        pick_in,
        drift=np.stack([pick_in.drift[:, 0], pick_out.drift[:, 1]], axis=1),
        ends=np.stack([pick_in.ends[:, 0], pick_out.ends[:, 1]], axis=1),
        line=np.stack([pick_in.line[:, 0], pick_out.line[:, 1]], axis=1),
    )
    return found.take(np.flatnonzero(np.isfinite(found.line).all(axis=1)))


def _sorted(batch: StopBatch, ways: NumericWays) -> NumericWays:
    return ways.take(np.argsort(ways.cost(batch)[1], kind="stable"))


def _leading(ways: NumericWays) -> list[int]:
    """Returns the order in which sorted ways are settled: the best of each yaw and branch first."""
    key = np.stack([ways.target, ways.branch]).T
    _, first = np.unique(key, axis=0, return_index=True)
    ahead = np.sort(first)
    rest = np.setdiff1d(np.arange(len(ways)), ahead)
    return [*ahead.tolist(), *rest.tolist()]


def _best_of(batch: StopBatch, ways: NumericWays, first: int, found: StopPosture) -> StopPosture:
    """Returns the quickest that the leading ways come to, one of which is known already."""
    if not batch.refine:
        return found
    best = found
    order = _leading(ways)
    place = order.index(first)
    for k in order[place + 1 : place + POSTURES.general_starts]:
        other = _settled(batch, ways.take(np.array([k])))
        if other is not None and other.cost < best.cost:
            best = other
    return best


def _settled(batch: StopBatch, way: NumericWays) -> StopPosture | None:
    """Returns the posture that one way leads to when it is refined and that holds at many more samples, or None."""
    tries = [way]
    if batch.refine and (batch.numeric_arm.spare or batch.free_yaw):
        tries += refined(batch, way)
    for one in reversed(tries):
        if holds(batch, one):
            time, _ = one.cost(batch)
            return one.posture(0, float(time[0]))
    return None


def holds(batch: StopBatch, way: NumericWays) -> bool:
    """Returns whether one way's lines can be followed at many samples and its postures are collision-free."""
    dense = followed(batch, way, POSTURES.general_dense_samples)
    return bool(np.isfinite(dense.line).all()) and len(clear_ones(batch, dense)) == 1


def refined(batch: StopBatch, way: NumericWays) -> list[NumericWays]:
    """Returns ever better variations of one way, in their order."""
    found: list[NumericWays] = []
    best = way
    for k in range(POSTURES.general_rounds):
        width = POSTURES.general_width * power(POSTURES.general_shrink, k)
        tried = _drifts_around(batch, varied(batch, best, width), width)
        if not len(tried):
            continue
        cost = tried.cost(batch)[1]
        least = int(cost.argmin())
        if cost[least] < best.cost(batch)[1][0]:
            best = tried.take(np.array([least]))
            found.append(best)
    return found


def varied(batch: StopBatch, way: NumericWays, width: float) -> NumericWays:
    """Returns one way and its neighbours along self-motion and free yaw, up to a half-width [rad]."""
    spare = batch.numeric_arm.spare and not batch.given
    along = width * np.array(POSTURES.along_self_motion if spare else (0.0,))
    turn = width * np.array(POSTURES.to_sides if batch.free_yaw else (0.0,))
    count = len(along) * len(turn)
    near = way.take(np.zeros(count, dtype=np.int64))
    near = replace(near, yaw=near.yaw + np.repeat(turn, len(along)))
    if count == 1:
        return near
    poses = near.poses(batch)
    q, met = moved_along(batch.numeric_arm, near.q, poses.R, poses.p, np.tile(along, len(turn)))
    return replace(near, q=q).take(met)


def _drifts_around(batch: StopBatch, ways: NumericWays, width: float) -> NumericWays:
    """Returns ways with the best of a few drifts about their own, up to a half-width [rad]."""
    varies = batch.numeric_arm.spare and batch.length.any()
    steps = np.array(POSTURES.to_sides if varies else (0.0,))
    return _best_drifts(batch, ways, ways.drift[:, :, None] + width * steps)
