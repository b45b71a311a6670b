"""Cells of (platform angle, arm angle, branch) that together hold every posture of a stop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np

from dualarm_cli.compiled import posture_cells as compiled
from dualarm_cli.effort import Resolution
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.kinematics.general_arm import GeneralArm
from dualarm_cli.kinematics.srs.srs_arm import SrsArm
from dualarm_cli.postures.platform_reach import (
    AngleCells,
    ShapeRates,
    reachable_cells,
    shape_rates,
)

ROUNDING = 1e-6
"""What enclosures are widened by, since they are computed in floating point [rad]; the compiled ones as well."""


@dataclass(frozen=True)
class Cells:
    """Joint enclosures; n of them, in order of their platform cell."""

    index: IntArray
    """Which cell of the platform's grid, shape (n,)."""
    kind: IntArray
    """Branch or the like, ascending within a platform cell: joints of neighbours of one kind are near, shape (n,)."""
    low: FloatArray
    """Lowest joints and, last, platform angle in the cell [rad], shape (n, joints + 1)."""
    high: FloatArray
    """Highest ones [rad], shape (n, joints + 1)."""
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

    Enclosures on fine cells, cut at the joint limits; cells in which a joint cannot be within its limits are left
    out. Where two turns of a joint meet its limits there is a cell for either. Fine cells of one branch and turn are
    then enclosed together: any grouping of a cover is a cover, and the give and take of the enclosures shrinks with
    the square of the fine cells.

    Over each interval of the platform angle the arm plane is carried along from the middle by the smallest rotation of
    the shoulder-wrist line, and the circle of elbows is cut into equal parts: a box in (phi, psi). Joints 1 and 2 are
    azimuth and polar angle of the upper arm seen from the carried frame, joint 3 is the azimuth of axis 1 seen from the
    upper arm, at the same polar angle; joints 7, 6, 5 likewise with the forearm, seen from the tool. Each is the
    direction of a unit vector that moves at bounded rates (`ShapeRates`), so with s the least sine of the polar angle
    and d the farthest that the vector is from where it is at the nearest corner:

    - the polar angle is within d of a corner's;
    - the azimuth is within d / s, and within asin(sin d / sin theta) with a corner's theta, of a corner's;
    - a smooth function on a box lies between its corners, give or take (M_phi h_phi² + M_psi h_psi²) / 2, with
      half-widths h and bounds M of its second derivatives (bilinear interpolation): for an azimuth
      |q''| <= a2/s + 2 a1²/s², for a polar angle |q''| <= (a2 + a1²)/s.

    The least of these counts, widened by 1e-6 rad, since it is computed in floating point. Joint 4 depends on the
    distance alone. Our own derivation.

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
    found = compiled.posture_cells(
        arm.numbers,
        R,
        p,
        intervals.index // finer,
        (intervals.low, intervals.high),
        [getattr(rates, field.name) for field in fields(ShapeRates)],
        lines(intervals),
        resolution.arm_angles,
        finer,
        free_last,
    )
    return Cells(*found)


def finer_edges(edges: FloatArray, finer: int) -> FloatArray:
    """Returns the borders of the cells' equal parts [rad], shape (finer g + 1,)."""
    count = len(edges) - 1
    return np.interp(np.arange(finer * count + 1) / finer, np.arange(count + 1), edges)


def free_cells(arm: SrsArm | GeneralArm, edges: FloatArray) -> Cells:
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
    """Returns given configurations (m, joints) in every platform cell: they turn with the platform."""
    n, m = len(edges) - 1, len(configurations)
    q = np.tile(configurations, (n, 1))
    return Cells(
        np.repeat(np.arange(n), m),
        np.tile(np.arange(m), n),
        np.column_stack([q, np.repeat(edges[:-1], m)]),
        np.column_stack([q, np.repeat(edges[1:], m)]),
        np.zeros(n * m),
    )
