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
from dualarm_cli.postures.problem import NoPosture, StopPosture, StopProblem
from dualarm_cli.postures.stop_batch import StopBatch
from dualarm_cli.refusals import Refusal

LINE_SAMPLES = 7
"""Samples of a line while postures are compared."""
DENSE_SAMPLES = 65
"""Samples of a line at which the posture that is taken must keep its limits."""
LOOKED_AT = 32
"""Postures at the target, quickest to get to first, whose lines are followed together."""
STARTS = 3
"""Ways that are refined, best first, of as many branches as there are."""
DRIFTS = np.array([0.0, -0.3, 0.3])
"""Drifts along lines that are tried first [rad]."""
FIRST_WIDTH, SHRINK, ROUNDS = 0.3, 0.55, 6
"""Half-width of the first round of refinement [rad], that of each other one as a share, and how many there are."""
AROUND = np.array([0.0, -1.0, -0.4, 0.4, 1.0])
"""Variations along the self-motion in a round, as shares of the half-width."""
SIDES = np.array([0.0, -1.0, 1.0])
"""Variations of yaw and drifts in a round."""


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
    for first in range(0, len(ways), LOOKED_AT):
        some = clear_ones(batch, ways.take(np.arange(first, min(first + LOOKED_AT, len(ways)))))
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
    drifts = DRIFTS if batch.numeric_arm.spare and batch.length.any() else DRIFTS[:1]
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
    each = followed(batch, each, LINE_SAMPLES)
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
    """Returns the quickest that the STARTS leading ways come to, one of which is known already."""
    if not batch.refine:
        return found
    best = found
    order = _leading(ways)
    place = order.index(first)
    for k in order[place + 1 : place + STARTS]:
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
    """Returns whether one way's lines can be followed at DENSE_SAMPLES samples and its postures are collision-free."""
    dense = followed(batch, way, DENSE_SAMPLES)
    return bool(np.isfinite(dense.line).all()) and len(clear_ones(batch, dense)) == 1


def refined(batch: StopBatch, way: NumericWays) -> list[NumericWays]:
    """Returns ever better variations of one way, in their order."""
    found: list[NumericWays] = []
    best = way
    for k in range(ROUNDS):
        tried = _drifts_around(batch, varied(batch, best, FIRST_WIDTH * power(SHRINK, k)), k)
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
    along = width * (AROUND if batch.numeric_arm.spare and not batch.given else AROUND[:1])
    turn = width * (SIDES if batch.free_yaw else SIDES[:1])
    count = len(along) * len(turn)
    near = way.take(np.zeros(count, dtype=np.int64))
    near = replace(near, yaw=near.yaw + np.repeat(turn, len(along)))
    if count == 1:
        return near
    poses = near.poses(batch)
    q, met = moved_along(batch.numeric_arm, near.q, poses.R, poses.p, np.tile(along, len(turn)))
    return replace(near, q=q).take(met)


def _drifts_around(batch: StopBatch, ways: NumericWays, round_: int) -> NumericWays:
    """Returns ways with the best of a few drifts about their own."""
    steps = SIDES if batch.numeric_arm.spare and batch.length.any() else SIDES[:1]
    width = FIRST_WIDTH * power(SHRINK, round_)
    return _best_drifts(batch, ways, ways.drift[:, :, None] + width * steps)
