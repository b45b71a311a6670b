"""Platform angles from which a pose can be reached, in intervals, and how far the wrist is from the shoulder there."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.geometry.elementary import TURN, arccos, arctan2, cos, sin
from dualarm_cli.geometry.products import norm
from dualarm_cli.kinematics.srs_arm import SrsArm
from dualarm_cli.records import dataclass

ROUNDING = 1e-9
"""What distances are widened by, since they are computed in floating point [m]."""
TINY = 1e-5
"""Nearer to the shoulder than this the wrist's distance may have a kink [m]."""
HAIR = 1e-7
"""What arcs are widened by for the same reason [rad]: a square root of what is lost at the end of the reach."""


@dataclass(frozen=True)
class AngleCells:
    """Intervals of the platform angle, each within one cell of the common grid; c of them."""

    index: IntArray
    """Which cell of the grid, shape (c,), ascending."""
    low: FloatArray
    """Where it begins [rad], shape (c,)."""
    high: FloatArray
    """Where it ends [rad], shape (c,)."""

    @property
    def middle(self) -> FloatArray:
        """Their middles [rad], shape (c,)."""
        return 0.5 * (self.low + self.high)

    @property
    def half(self) -> FloatArray:
        """Half their widths [rad], shape (c,)."""
        return 0.5 * (self.high - self.low)

    def take(self, rows: IntArray) -> AngleCells:
        """Returns some of them."""
        return AngleCells(self.index[rows], self.low[rows], self.high[rows])


def reachable_cells(arm: SrsArm, wrist: FloatArray, edges: FloatArray) -> AngleCells:
    """Returns the parts of a grid's cells from which a wrist centre is within reach.

    The squared distance from shoulder to wrist is A - B cos(phi - phi_B): the reachable angles are two arcs
    around phi_B, one to either side; a hair is added to their ends.

    Args:
        arm: kinematics in the carried frame, whose z axis is the platform's.
        wrist: wrist centre in the carried frame at platform angle zero [m], shape (3,).
        edges: borders of the grid's cells, ascending [rad], shape (g + 1,); one (twice) where nothing turns.
    """
    shoulder = arm.geometry.shoulder
    rho, radius = np.hypot(*wrist[:2]), np.hypot(*shoulder[:2])
    height = wrist[2] - shoulder[2]
    A, B = np.square(rho) + np.square(radius) + np.square(height), 2.0 * rho * radius
    least, most = arm.reach
    if edges[-1] == edges[0] or B < 1e-12:
        gap = norm(turned(wrist, edges[:1])[0] - shoulder)
        if not least - ROUNDING <= gap <= most + ROUNDING:
            return AngleCells(np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0))
        return AngleCells(np.arange(len(edges) - 1), edges[:-1], edges[1:])
    if np.sqrt(max(A - B, 0.0)) > most + ROUNDING or np.sqrt(A + B) < least - ROUNDING:
        return AngleCells(np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0))
    # In the carried frame the wrist turns backwards: its azimuth is theta - phi.
    nearest = arctan2(wrist[1], wrist[0]) - arctan2(shoulder[1], shoulder[0])
    nearest += TURN * np.round((0.5 * (edges[0] + edges[-1]) - nearest) / TURN)
    inner = arccos(np.clip((A - np.square(least)) / B, -1.0, 1.0))
    outer = arccos(np.clip((A - np.square(most)) / B, -1.0, 1.0))
    index, low, high = [], [], []
    for turn in range(-2, 3):
        for begin, end in ((inner, outer), (-outer, -inner)):
            first = np.maximum(edges[:-1], nearest + turn * TURN + begin - HAIR)
            last = np.minimum(edges[1:], nearest + turn * TURN + end + HAIR)
            some = np.flatnonzero(first < last)
            index.append(some)
            low.append(first[some])
            high.append(last[some])
    every = np.concatenate(index)
    order = np.lexsort((np.concatenate(low), every))
    return AngleCells(every[order], np.concatenate(low)[order], np.concatenate(high)[order])


def reachable_spans(arm: SrsArm, wrist: FloatArray) -> list[tuple[float, float]]:
    """Returns the positions of a rail from which a wrist centre is within reach, lowest and highest [m], ascending.

    The distance from shoulder to wrist is that of two points on parallel lines: within the farthest reach in one span,
    less the span within the nearest one.

    Args:
        arm: kinematics in the carried frame, which slides along its z axis.
        wrist: wrist centre in the carried frame with the rail at zero [m], shape (3,).
    """
    x, y, nearest = wrist - arm.geometry.shoulder
    away = float(np.hypot(x, y))
    least, most = arm.reach
    if away > most + ROUNDING:
        return []
    outer = float(np.sqrt(max(np.square(most) - np.square(away), 0.0))) + ROUNDING
    if away >= least - ROUNDING:
        return [(nearest - outer, nearest + outer)]
    inner = float(np.sqrt(np.square(least) - np.square(away))) - ROUNDING
    return [(nearest - outer, nearest - inner), (nearest + inner, nearest + outer)]


def turned(wrist: FloatArray, angle: FloatArray) -> FloatArray:
    """Returns a world point in the carried frame [m], shape (c, 3), for platform angles (c,) [rad].

    Args:
        wrist: the point in the carried frame at platform angle zero [m], shape (3,).
        angle: platform angles [rad], shape (c,).
    """
    c, s = cos(angle), sin(angle)
    x, y, z = wrist
    return np.stack([c * x + s * y, c * y - s * x, np.full(len(angle), z)], axis=1)


def wrist_distances(
    arm: SrsArm, wrist: FloatArray, cells: AngleCells
) -> tuple[FloatArray, FloatArray]:
    """Returns the least and the greatest distance from shoulder to wrist centre [m], shape (c,) each.

    In the world the shoulder goes round a circle of radius R and the wrist stands: with r its distance,
    |r'| <= R and |r''| <= R + R²/r. Our own derivation.

    Args:
        arm: kinematics in the carried frame.
        wrist: wrist centre in the carried frame at platform angle zero [m], shape (3,).
        cells: intervals of the platform angle; angles from which the wrist centre is out of reach do not count.
    """
    half = cells.half
    radius = float(np.hypot(*arm.geometry.shoulder[:2]))
    samples = [
        norm(turned(wrist, angle) - arm.geometry.shoulder, axis=1)
        for angle in (cells.low, cells.middle, cells.high)
    ]
    nearest, farthest = np.minimum.reduce(samples), np.maximum.reduce(samples)
    near = np.maximum(nearest - radius * half, TINY)
    # Between three samples half a width apart: the way to the nearest one, or the error of a parabola's chord.
    bulge = np.where(
        near > TINY, (radius + np.square(radius) / near) * np.square(half) / 8.0, np.inf
    )
    bulge = np.minimum(bulge, 0.5 * radius * half) + ROUNDING
    # The reach, but for the hair by which intervals of `reachable_cells` are longer.
    least, most = arm.reach[0] - radius * HAIR, arm.reach[1] + radius * HAIR
    low, high = np.clip(nearest - bulge, least, most), np.clip(farthest + bulge, least, most)
    return np.maximum(low, 0.0), high
