"""Intervals of the platform angle from which a pose is in reach, with wrist distances."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.geometry.elementary import TURN, arccos, arctan2, cos, sin
from dualarm_cli.geometry.products import norm
from dualarm_cli.kinematics.srs_arm import SrsArm
from dualarm_cli.records import dataclass

ROUNDING = 1e-9
"""Rounding error bound of distances [m]."""
TINY = 1e-5
"""Distance from the shoulder below which the wrist's distance may have a kink [m]."""
HAIR = 1e-7
"""Rounding error bound of arcs [rad], a square root at the end of the reach."""


@dataclass(frozen=True)
class AngleCells:
    """Intervals of the platform angle (c), each within one cell of the common grid."""

    index: IntArray
    """Numbers of the grid's cells, shape (c,), ascending."""
    low: FloatArray
    """Lower ends [rad], shape (c,)."""
    high: FloatArray
    """Upper ends [rad], shape (c,)."""

    @property
    def middle(self) -> FloatArray:
        """Middles of the intervals [rad], shape (c,)."""
        return 0.5 * (self.low + self.high)

    @property
    def half(self) -> FloatArray:
        """Half-widths of the intervals [rad], shape (c,)."""
        return 0.5 * (self.high - self.low)

    def take(self, rows: IntArray) -> AngleCells:
        """Select intervals by row."""
        return AngleCells(self.index[rows], self.low[rows], self.high[rows])


def reachable_cells(arm: SrsArm, wrist: FloatArray, edges: FloatArray) -> AngleCells:
    """Compute the parts of a grid's cells from which a wrist centre is within reach.

    The squared distance from shoulder to wrist is A - B cos(phi - phi_B): the reachable angles are two arcs
    around phi_B, one to either side; `HAIR` is added to their ends.

    Args:
        arm: kinematics in the carried frame, whose z axis is the platform's.
        wrist: wrist centre in the carried frame at platform angle zero [m], shape (3,).
        edges: borders of the grid's cells, ascending [rad], shape (g + 1,); one (twice) if nothing turns.
    """
    shoulder = arm.geometry.shoulder
    rho, radius = np.hypot(*wrist[:2]), np.hypot(*shoulder[:2])
    height = wrist[2] - shoulder[2]
    A, B = np.square(rho) + np.square(radius) + np.square(height), 2.0 * rho * radius
    min_reach, max_reach = arm.reach
    if edges[-1] == edges[0] or B < 1e-12:
        gap = norm(turned(wrist, edges[:1])[0] - shoulder)
        if not min_reach - ROUNDING <= gap <= max_reach + ROUNDING:
            return AngleCells(np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0))
        return AngleCells(np.arange(len(edges) - 1), edges[:-1], edges[1:])
    if np.sqrt(max(A - B, 0.0)) > max_reach + ROUNDING or np.sqrt(A + B) < min_reach - ROUNDING:
        return AngleCells(np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0))
    # In the carried frame the wrist turns backwards: its azimuth is theta - phi.
    nearest = arctan2(wrist[1], wrist[0]) - arctan2(shoulder[1], shoulder[0])
    nearest += TURN * np.round((0.5 * (edges[0] + edges[-1]) - nearest) / TURN)
    inner = arccos(np.clip((A - np.square(min_reach)) / B, -1.0, 1.0))
    outer = arccos(np.clip((A - np.square(max_reach)) / B, -1.0, 1.0))
    index, low, high = [], [], []
    for turn in range(-2, 3):
        for begin, end in ((inner, outer), (-outer, -inner)):
            first = np.maximum(edges[:-1], nearest + turn * TURN + begin - HAIR)
            last = np.minimum(edges[1:], nearest + turn * TURN + end + HAIR)
            rows = np.flatnonzero(first < last)
            index.append(rows)
            low.append(first[rows])
            high.append(last[rows])
    cells = np.concatenate(index)
    order = np.lexsort((np.concatenate(low), cells))
    return AngleCells(cells[order], np.concatenate(low)[order], np.concatenate(high)[order])


def reachable_spans(arm: SrsArm, wrist: FloatArray) -> list[tuple[float, float]]:
    """Compute the spans of a rail from which a wrist centre is within reach [m], ascending.

    The distance from shoulder to wrist is that of two points on parallel lines: within the farthest reach in one span,
    less the span within the nearest one.

    Args:
        arm: kinematics in the carried frame, which slides along its z axis.
        wrist: wrist centre in the carried frame with the rail at zero [m], shape (3,).
    """
    x, y, nearest = wrist - arm.geometry.shoulder
    radial = float(np.hypot(x, y))
    min_reach, max_reach = arm.reach
    if radial > max_reach + ROUNDING:
        return []
    outer = float(np.sqrt(max(np.square(max_reach) - np.square(radial), 0.0))) + ROUNDING
    if radial >= min_reach - ROUNDING:
        return [(nearest - outer, nearest + outer)]
    inner = float(np.sqrt(np.square(min_reach) - np.square(radial))) - ROUNDING
    return [(nearest - outer, nearest - inner), (nearest + inner, nearest + outer)]


def turned(wrist: FloatArray, angle: FloatArray) -> FloatArray:
    """Transform a world point to the carried frame at platform angles [m], shape (c, 3).

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
    """Bound the distances from shoulder to wrist centre in intervals [m], shape (c,) each.

    In the world the shoulder moves on a circle of radius R and the wrist stands: with r its distance,
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
    distance_bound = np.maximum(nearest - radius * half, TINY)
    # Between three samples half a width apart: the distance to the nearest one, or the error of a parabola's chord.
    bulge = np.where(
        distance_bound > TINY,
        (radius + np.square(radius) / distance_bound) * np.square(half) / 8.0,
        np.inf,
    )
    bulge = np.minimum(bulge, 0.5 * radius * half) + ROUNDING
    # The reach, extended by the `HAIR` of the intervals of `reachable_cells`.
    min_reach, max_reach = arm.reach[0] - radius * HAIR, arm.reach[1] + radius * HAIR
    low, high = (
        np.clip(nearest - bulge, min_reach, max_reach),
        np.clip(farthest + bulge, min_reach, max_reach),
    )
    return np.maximum(low, 0.0), high
