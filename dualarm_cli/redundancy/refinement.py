"""Ways to make stops made better between the grid's arm angles: rounds of ever narrower variation."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.redundancy.line_following import Lines
from dualarm_cli.redundancy.stop_batch import StopBatch
from dualarm_cli.redundancy.ways import LINE_SAMPLES, SURE, Ways, transfer_cost

ALL_WAYS = 2
"""Rounds in which all ways of a problem are refined."""
FIRST_WIDTH = 0.25
"""Half-width of the first round of refinement [rad]."""


def _steps(count: int) -> FloatArray:
    """Returns an odd number of equal steps from -1 to 1, no step being the first of them and the only one of one."""
    half = count // 2
    return np.roll(np.arange(-half, half + 1) / max(half, 1), -half)


@dataclass(frozen=True)
class _Pattern:
    """How rounds of refinement vary a way: every combination of yaws, arm angles and swings is looked at."""

    yaw: FloatArray
    """Variations of the yaw, as shares of the half-width; none is the first."""
    psi: FloatArray
    """Of the arm angle at the target."""
    swing: FloatArray
    """Of each line's swing."""
    shrink: float
    """Half-width of a round as a share of that of the one before."""
    rounds: int
    """How many rounds there are."""

    @classmethod
    def of(cls, batch: StopBatch) -> _Pattern:
        """Returns what is free to vary in the problems of a batch, as finely as it is cheap."""
        if batch.length.any():
            yaw, psi = 3 if batch.free_yaw else 1, 1 if batch.given else 5
            return cls(_steps(yaw), _steps(psi), _steps(5), 0.6, 6)
        yaw, psi, shrink = (9, 9, 0.25) if batch.free_yaw else (1, 17, 0.125)
        return cls(_steps(yaw), _steps(1 if batch.given else psi), _steps(1), shrink, 3)

    def thinned(self) -> _Pattern:
        """Returns the same with three variations at most of each."""
        yaw, psi, swing = (_steps(min(3, len(v))) for v in (self.yaw, self.psi, self.swing))
        return replace(self, yaw=yaw, psi=psi, swing=swing)


def refinements(batch: StopBatch, ways: Ways) -> list[Ways]:
    """Returns one ever better way of each problem, the first one given; all in lockstep.

    Of several ways of one problem the best after ALL_WAYS rounds goes on alone.

    In a round every combination of a few yaws, arm angles at the target and swings of approach and retract is looked
    at; given the target the two lines do not depend on each other, so that each is followed for its own swings only
    and the best of both belong together.

    Args:
        batch: the problems.
        ways: ways that can be gone, problem by problem.
    """
    pattern = _Pattern.of(batch)
    found = [ways]
    lines: Lines | None = None
    for k in range(pattern.rounds):
        width = FIRST_WIDTH * pattern.shrink**k
        if k == ALL_WAYS:
            best = leading(found[-1])
            if len(best) < len(ways.row):
                found, lines = [stage.take(best) for stage in found], None
        last = found[-1]
        yaw = last.yaw[:, None] + width * pattern.yaw
        if lines is None or batch.free_yaw:
            lines = _lines(batch, last, yaw)
        found.append(_better(batch, last, lines, pattern, width))
    return found


def variation(batch: StopBatch, ways: Ways, width: float) -> Ways:
    """Returns the best of one round of variation of each way, by up to a half-width [rad]; or the way itself."""
    pattern = _Pattern.of(batch).thinned()
    lines = _lines(batch, ways, ways.yaw[:, None] + width * pattern.yaw)
    return _better(batch, ways, lines, pattern, width)


def leading(ways: Ways) -> IntArray:
    """Returns the index of the best way of each problem."""
    order = np.lexsort((ways.cost, ways.row))
    best: IntArray = order[np.diff(ways.row[order], prepend=-1) > 0]
    return best


def _lines(batch: StopBatch, ways: Ways, yaw: FloatArray) -> Lines:
    """Returns both lines of n ways from y yaws (n, y) each, in the order (n, y, approach and retract)."""
    y = yaw.shape[1]
    row, target = np.repeat(ways.row, y), np.repeat(ways.target, y)
    poses = batch.poses(row, target, yaw.ravel())
    twice = np.repeat(np.arange(len(row)), 2)
    return Lines.of(batch, poses.take(twice), batch.length[row].ravel(), LINE_SAMPLES)


def _better(batch: StopBatch, ways: Ways, lines: Lines, pattern: _Pattern, width: float) -> Ways:
    """Returns the best variation of each way, or the way itself where none is better."""
    n, y, t, s = len(ways.row), len(pattern.yaw), len(pattern.psi), len(pattern.swing)
    psi = ways.psi[:, None] + width * pattern.psi
    swings = np.stack([ways.swing_in, ways.swing_out], axis=1)[:, :, None] + width * pattern.swing
    shape = (n, y, 2, t, s)
    psi_target = np.broadcast_to(psi[:, None, None, :, None], shape)
    psi_end = psi_target + swings[:, None, :, None, :]
    each = np.repeat(np.arange(n), 2 * y)
    followed = lines.follow(
        psi_target.reshape(-1, t * s),
        psi_end.reshape(-1, t * s),
        ways.branch[each],
        ways.reference(batch)[each],
    )
    end = followed.at(-1).reshape(*shape, 7)[:, :, 0]
    transfer, travel = transfer_cost(batch, ways.row, end)
    least = lines.least_times(followed).reshape(shape) * SURE
    least[:, :, 0] += transfer + travel
    # Of the two lines one cannot be worth more than what the other leaves.
    room = (ways.cost[:, None, None, None] - least.min(axis=4))[:, :, ::-1]
    wanted = least < room[..., None]
    line = lines.times(followed, wanted.reshape(len(each), -1)).reshape(shape)
    time_in = transfer + line[:, :, 0]
    cost_in = time_in + travel
    best_in, best_out = cost_in.argmin(axis=3), line[:, :, 1].argmin(axis=3)
    total = (cost_in.min(axis=3) + line[:, :, 1].min(axis=3)).reshape(n, -1)
    index, own = total.argmin(axis=1), np.arange(n)
    at_yaw, at_psi = np.divmod(index, t)
    k_in, k_out = best_in[own, at_yaw, at_psi], best_out[own, at_yaw, at_psi]
    better = total[own, index] < ways.cost
    time = time_in[own, at_yaw, at_psi, k_in] + line[own, at_yaw, 1, at_psi, k_out]
    return replace(
        ways,
        yaw=np.where(better, ways.yaw + width * pattern.yaw[at_yaw], ways.yaw),
        psi=np.where(better, psi[own, at_psi], ways.psi),
        swing_in=np.where(better, swings[own, 0, k_in], ways.swing_in),
        swing_out=np.where(better, swings[own, 1, k_out], ways.swing_out),
        time=np.where(better, time, ways.time),
        cost=np.where(better, total[own, index], ways.cost),
    )
