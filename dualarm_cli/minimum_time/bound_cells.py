"""Cells of (platform angle, arm angle, branch) that together hold every posture of a stop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.kinematics.arm_angle_curves import flips
from dualarm_cli.kinematics.srs_arm import SrsArm
from dualarm_cli.minimum_time.bound_enclosures import TURN, Enclosures, enclosures
from dualarm_cli.minimum_time.bound_reach import (
    AngleCells,
    reachable_cells,
    shape_rates,
)

ROUNDING = 1e-6
"""What enclosures are widened by, since they are computed in floating point [rad]."""
APART = 2.0
"""Ranges of one joint whose middles are this far apart are not put into one cell [rad]."""


@dataclass(frozen=True)
class Resolution:
    """How finely postures are cut into cells."""

    step: float
    """Width of the platform's cells [rad]."""
    arm_angles: int
    """Parts of the circle of elbows."""
    finer: int
    """How many times finer, in both directions, the cells are on which joints are enclosed."""


@dataclass(frozen=True)
class Cells:
    """Joint enclosures; n of them, in order of their platform cell."""

    index: IntArray
    """Which cell of the platform's grid, shape (n,)."""
    kind: IntArray
    """Branch or the like, ascending within a platform cell: joints of neighbours of one kind are near, shape (n,)."""
    low: FloatArray
    """Lowest joints and, last, platform angle in the cell [rad], shape (n, 8)."""
    high: FloatArray
    """Highest ones [rad], shape (n, 8)."""
    line: FloatArray
    """Least time of the line that begins or ends there [s], shape (n,)."""

    def take(self, rows: IntArray) -> Cells:
        """Returns some of them."""
        return Cells(
            self.index[rows], self.kind[rows], self.low[rows], self.high[rows], self.line[rows]
        )

    @classmethod
    def joined(cls, parts: list[Cells]) -> Cells:
        """Returns several covers as one, in order of their platform cell."""
        every = cls(
            np.concatenate([part.index for part in parts]),
            np.concatenate([part.kind + 8 * k for k, part in enumerate(parts)]),
            *(
                np.concatenate([getattr(part, name) for part in parts])
                for name in ("low", "high", "line")
            ),
        )
        return every.take(np.lexsort((every.kind, every.index)))


def pose_cells(
    arm: SrsArm,
    R: FloatArray,
    p: FloatArray,
    edges: FloatArray,
    resolution: Resolution,
    free_last: bool,
    lines: Callable[[AngleCells], FloatArray],
) -> Cells:
    """Returns cells that cover every posture of one flange pose that stands in the world.

    `enclosures` on fine cells, cut at the joint limits; cells in which a joint cannot be within its limits are left
    out. Where two turns of a joint meet its limits there is a cell for either. Fine cells of one branch and turn are
    then enclosed together: any grouping of a cover is a cover, and the give and take of the enclosures shrinks with
    the square of the fine cells.

    Args:
        arm: kinematics in the carried frame.
        R: flange rotation in the carried frame at platform angle zero, shape (3, 3).
        p: flange position there [m], shape (3,).
        edges: borders of the platform's cells [rad], shape (g + 1,).
        resolution: how finely.
        free_last: whether joint 7 is free.
        lines: returns the least time of the line at this pose for intervals of the platform angle [s].
    """
    finer = resolution.finer
    wrist = arm.wrist_center(R, p)
    intervals = reachable_cells(arm, wrist, finer_edges(edges, finer))
    if not len(intervals.index):
        return free_cells(arm, edges[:1])
    rates = shape_rates(arm, wrist, intervals)
    found = enclosures(arm, R, p, intervals, rates, resolution.arm_angles * finer)
    if free_last:
        found.low[6], found.high[6] = -np.inf, np.inf
    first, second = _within_limits(found, arm.lower, arm.upper)
    cells, part, psi = _every_branch(first, second, intervals, finer)
    return _merged(replace(cells, line=lines(intervals)[part]), psi // finer)


def finer_edges(edges: FloatArray, finer: int) -> FloatArray:
    """Returns the borders of the cells' equal parts [rad], shape (finer g + 1,)."""
    count = len(edges) - 1
    return np.interp(np.arange(finer * count + 1) / finer, np.arange(count + 1), edges)


@dataclass(frozen=True)
class _Ranges:
    """Enclosures on one turn, cut at the joint limits; shapes (7, 2, c, k)."""

    low: FloatArray
    """Lowest position [rad]."""
    high: FloatArray
    """Highest position [rad]."""
    meets: BoolArray
    """Whether there is any."""


def _within_limits(
    found: Enclosures, lower: FloatArray, upper: FloatArray
) -> tuple[_Ranges, _Ranges]:
    """Returns enclosures on the turn that meets the limits, and on a second one where two turns do.

    A joint is free within its limits where nothing is known of it, and where several turns meet limits that are more
    than a turn apart.
    """
    shape = (7, 1, 1, 1)
    bottom, top = lower.reshape(shape), upper.reshape(shape)
    bounded = np.isfinite(bottom) & np.isfinite(top)
    middle = 0.5 * (np.where(bounded, bottom, 0.0) + np.where(bounded, top, 0.0))
    low, high = found.low - ROUNDING, found.high + ROUNDING
    known = (high - low < TURN) & bounded
    low, high = np.where(known, low, bottom), np.where(known, high, top)
    # The nearest turn to the limits' middle: if any turn meets them, it does, or one next to it.
    shift = TURN * np.round((middle - np.where(known, 0.5 * (low + high), middle)) / TURN)
    low, high = low + shift, high + shift
    turns = np.stack([(low + k * TURN <= top) & (high + k * TURN >= bottom) for k in (-1, 0, 1)])
    most = np.where(top - bottom <= TURN + ROUNDING, 2, 1)
    known &= turns.sum(axis=0) <= most
    one = np.where(turns[1], 0.0, np.where(turns[0], -TURN, TURN))
    other = np.where(turns[0] & turns[1], -TURN, TURN)

    def on(turn: FloatArray, meets: BoolArray) -> _Ranges:
        return _Ranges(
            np.where(known, np.maximum(low + turn, bottom), bottom),
            np.where(known, np.minimum(high + turn, top), top),
            meets,
        )

    return on(one, turns.any(axis=0) | ~known), on(other, (turns.sum(axis=0) == 2) & known)


def _every_branch(
    first: _Ranges, second: _Ranges, intervals: AngleCells, finer: int
) -> tuple[Cells, IntArray, IntArray]:
    """Returns the fine cells of all branches and turns, their intervals and their parts of the circle."""
    branches = np.arange(8)
    possible = np.ones((*first.low.shape[2:], 8), dtype=np.bool_)
    flip = np.stack([flips(joint, branches).astype(np.int64) for joint in range(7)])
    for joint in range(7):
        possible &= np.moveaxis(first.meets[joint][flip[joint]], 0, -1)
    part, psi, branch = np.nonzero(possible)
    joints = np.arange(7)[:, None]
    places = (joints, flip[:, branch], part, psi)
    low, high, rows = first.low[places], first.high[places], np.arange(len(part))
    twice = second.meets[places]
    for joint in map(int, np.flatnonzero(twice.any(axis=1))):
        again = np.flatnonzero(twice[joint][rows])
        other = rows[again]
        place = joint, flip[joint, branch[other]], part[other], psi[other]
        low, high = np.hstack([low, low[:, again]]), np.hstack([high, high[:, again]])
        low[joint, len(rows) :], high[joint, len(rows) :] = second.low[place], second.high[place]
        rows = np.concatenate([rows, other])
    part, psi = part[rows], psi[rows]
    cells = Cells(
        intervals.index[part] // finer,
        branch[rows],
        np.vstack([low, intervals.low[part]]).T,
        np.vstack([high, intervals.high[part]]).T,
        np.zeros(len(rows)),
    )
    return cells, part, psi


def _merged(cells: Cells, psi: IntArray) -> Cells:
    """Returns one cell around all of a platform cell that have branch, turns and part of the circle in common."""
    if not len(psi):
        return cells
    parts = int(psi.max()) + 1
    key = (cells.index * 8 + cells.kind) * parts + psi
    order = np.argsort(key, kind="stable")
    _, first, group = np.unique(key[order], return_index=True, return_inverse=True)
    middle = (0.5 * (cells.low + cells.high)[order, :7]).copy()
    # Turns are told by where a joint is next to the first cell of the same part of the circle.
    apart = np.abs(middle - middle[first][group]) > APART
    turn = apart @ (1 << np.arange(7))
    key = key[order] * (1 << 7) + turn
    again = np.argsort(key, kind="stable")
    order, key = order[again], key[again]
    first = np.flatnonzero(np.concatenate([[True], np.diff(key) > 0]))
    return Cells(
        cells.index[order][first],
        cells.kind[order][first],
        np.minimum.reduceat(cells.low[order], first),
        np.maximum.reduceat(cells.high[order], first),
        np.minimum.reduceat(cells.line[order], first),
    )


def free_cells(arm: SrsArm, edges: FloatArray) -> Cells:
    """Returns one cell per platform cell in which every joint is free."""
    n = len(edges) - 1
    return Cells(
        np.arange(n),
        np.zeros(n, dtype=np.int64),
        np.column_stack([np.tile(arm.lower, (n, 1)), edges[:-1]]),
        np.column_stack([np.tile(arm.upper, (n, 1)), edges[1:]]),
        np.zeros(n),
    )


def point_cells(configurations: FloatArray, edges: FloatArray) -> Cells:
    """Returns given configurations (m, 7) in every platform cell: they turn with the platform."""
    n, m = len(edges) - 1, len(configurations)
    q = np.tile(configurations, (n, 1))
    return Cells(
        np.repeat(np.arange(n), m),
        np.tile(np.arange(m), n),
        np.column_stack([q, np.repeat(edges[:-1], m)]),
        np.column_stack([q, np.repeat(edges[1:], m)]),
        np.zeros(n * m),
    )
