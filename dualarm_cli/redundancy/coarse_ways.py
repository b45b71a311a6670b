"""First ways to make stops: the quickest postures at targets with several courses of the arm angle along the lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.kinematics.srs_limits import wrap
from dualarm_cli.redundancy.line_following import Followed, Lines
from dualarm_cli.redundancy.problem import NoPosture
from dualarm_cli.redundancy.stop_batch import StopBatch
from dualarm_cli.redundancy.target_grid import TargetPostures
from dualarm_cli.redundancy.ways import LINE_SAMPLES, SURE, Ways, transfer_cost

SWINGS = np.array([0.0, -0.2, 0.2, -0.5, 0.5])
"""Changes of the arm angle along a line that are tried [rad]."""
FAR = 0.4
"""Difference of arm angle or yaw from which on another way may lead elsewhere when it is refined [rad]."""
LOOKED_AT_FIRST = 4
"""Postures of each problem, by what no motion can beat, whose lines are timed first."""
NEAR = 1.02
"""Other lines are timed if they may come to within this multiple of the best of those."""


def coarse_ways(
    batch: StopBatch,
    grid: Sequence[TargetPostures | NoPosture],
    rows: Sequence[int],
    complete: bool,
) -> Ways:
    """Returns postures at targets with their best swings, problem by problem and best first.

    Timing lines costs most: those that cannot come near the best are left out, unless all ways are asked for.

    Args:
        batch: the problems.
        grid: the postures at their targets.
        rows: the problems whose ways are asked for.
        complete: whether all ways are timed.
    """
    ways = _unswung(grid, rows)
    swings = SWINGS if batch.length.any() else SWINGS[:1]
    sides = _sides(batch, ways, swings)
    transfer, travel = transfer_cost(batch, ways.row, sides[0][1].at(-1))
    least = np.empty((2, *transfer.shape))
    for side in (0, 1):
        lines, followed = sides[side % len(sides)]
        least[side] = SURE * lines.least_times(followed)
    least[0] += transfer + travel
    wanted = np.isfinite(least)
    if complete:
        line = _line_times(sides, wanted)
    else:
        first = _first(ways.row, least.min(axis=2).sum(axis=0))[:, None]
        line = _line_times(sides, wanted & first)
        best = _best_of_row(
            ways.row, (transfer + travel + line[0]).min(axis=1) + line[1].min(axis=1)
        )
        # The two lines share what the best takes: one has what the other, at its least, leaves.
        other = least.min(axis=2)[::-1, :, None]
        worth = wanted & np.isfinite(other)
        worth[worth] = (least + np.where(worth, other, 0.0) <= NEAR * best[:, None])[worth]
        line = np.minimum(line, _line_times(sides, worth & ~first))
    cost_in, own = transfer + travel + line[0], np.arange(len(ways.row))
    k_in, k_out = cost_in.argmin(axis=1), line[1].argmin(axis=1)
    cost = cost_in[own, k_in] + line[1, own, k_out]
    ways = replace(
        ways,
        swing_in=swings[k_in],
        swing_out=swings[k_out],
        time=transfer[own, k_in] + line[0, own, k_in] + line[1, own, k_out],
        cost=cost,
    )
    order = np.lexsort((cost, ways.row))
    return _spread(ways.take(order[np.isfinite(cost[order])]))


def _spread(ways: Ways) -> Ways:
    """Returns sorted ways with the best one of each problem that is FAR from its very best in second place."""
    first = np.flatnonzero(np.diff(ways.row, prepend=-1))
    best = np.repeat(first, np.diff(np.append(first, len(ways.row))))
    turned = np.stack([ways.psi - ways.psi[best], ways.yaw - ways.yaw[best]])
    far = (np.abs(wrap(turned)) > FAR).any(axis=0) | (ways.branch != ways.branch[best])
    place = np.arange(len(ways.row), dtype=np.float64)
    far_ones = np.flatnonzero(far)
    second = far_ones[np.diff(ways.row[far_ones], prepend=-1) > 0]
    place[second] = best[second] + 0.5
    return ways.take(np.argsort(place))


def _unswung(grid: Sequence[TargetPostures | NoPosture], rows: Sequence[int]) -> Ways:
    """Returns all postures at the targets of some problems as ways that are still to be timed."""
    found = [(row, one) for row in rows if isinstance(one := grid[row], TargetPostures)]
    row = np.repeat([row for row, _ in found], [len(one.psi) for _, one in found])
    target, yaw, branch, psi = (
        np.concatenate([getattr(one, name) for _, one in found])
        for name in ("target", "yaw", "branch", "psi")
    )
    open_ = np.zeros(len(row))
    return Ways(row, target, yaw, branch, psi, open_, open_, open_, open_)


def _sides(batch: StopBatch, ways: Ways, swings: FloatArray) -> list[tuple[Lines, Followed]]:
    """Returns approach and retract of every way with every swing; one for both where they are equal."""
    alike = np.array_equal(batch.length[:, 0], batch.length[:, 1])
    psi = np.broadcast_to(ways.psi[:, None], (len(ways.row), len(swings)))
    poses, reference = ways.poses(batch), ways.reference(batch)
    sides = []
    for side in (0,) if alike else (0, 1):
        lines = Lines.of(batch, poses, batch.length[ways.row, side], LINE_SAMPLES)
        sides.append((lines, lines.follow(psi, psi + swings, ways.branch, reference)))
    return sides


def _line_times(sides: Sequence[tuple[Lines, Followed]], wanted: BoolArray) -> FloatArray:
    """Returns times of wanted lines [s], infinite for others, shape (2, n, s)."""
    if len(sides) == 1:
        ((lines, followed),) = sides
        both = lines.times(followed, wanted[0] | wanted[1])
        return np.stack([both, both])
    return np.stack(
        [lines.times(followed, one) for (lines, followed), one in zip(sides, wanted, strict=True)]
    )


def _first(row: IntArray, least: FloatArray) -> BoolArray:
    """Returns the LOOKED_AT_FIRST least entries of each problem, shape (n,)."""
    order = np.lexsort((least, row))
    place = np.arange(len(row)) - np.searchsorted(row[order], row[order], side="left")
    first = np.zeros(len(row), dtype=np.bool_)
    first[order[place < LOOKED_AT_FIRST]] = True
    return first


def _best_of_row(row: IntArray, total: FloatArray) -> FloatArray:
    """Returns the least total of each entry's problem, shape (n,); row ascends."""
    first = np.flatnonzero(np.diff(row, prepend=-1))
    counts = np.diff(np.append(first, len(row)))
    return np.repeat(np.minimum.reduceat(total, first), counts)
