"""Cells of (platform angle, arm angle, branch) that together hold every posture of a stop."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dualarm_cli.compiled import posture_cells as compiled
from dualarm_cli.effort import Resolution
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.kinematics.posture_source import PostureSource
from dualarm_cli.kinematics.srs_arm import SrsArm
from dualarm_cli.model.rest_to_rest import RestToRest
from dualarm_cli.postures.platform_reach import AngleCells
from dualarm_cli.records import dataclass

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


@dataclass(frozen=True)
class LineToTarget:
    """A straight line of the tool from a pose to its target, or back."""

    target: FloatArray
    """Flange position at the target in the carried frame at platform angle zero [m], shape (3,)."""
    law: RestToRest
    """Rest-to-rest times of the joints on it."""
    floor: Callable[[AngleCells], FloatArray]
    """Returns what it takes at least over intervals of the platform angle [s]; better is found where it can be."""


def pose_cells(
    arm: SrsArm,
    flange: tuple[FloatArray, FloatArray],
    intervals: AngleCells,
    resolution: Resolution,
    free_last: bool,
    line: LineToTarget | None,
) -> Cells:
    """Returns cells that cover every posture of one flange pose that stands in the world, over some platform angles.

    Enclosures on fine cells, cut at the joint limits; cells in which a joint cannot be within its limits are left
    out. Where two turns of a joint meet its limits there is a cell for either. Fine cells of one branch and turn are
    then enclosed together: any grouping of a cover is a cover, and the give and take of the enclosures shrinks with
    the square of the fine cells.

    Over each interval of the platform angle the arm plane is carried along from the middle by the smallest rotation of
    the shoulder-wrist line, and the circle of elbows is cut into equal parts: a box in (phi, psi). Joints 1 and 2 are
    azimuth and polar angle of the upper arm seen from the carried frame, joint 3 is the azimuth of axis 1 seen from the
    upper arm, at the same polar angle; joints 7, 6, 5 likewise with the forearm, seen from the tool. Their sines and
    cosines are A sin psi + B cos psi + C, where A, B and C follow from phi by sums, products, reciprocals and roots.
    Interval arithmetic on these and on their first and second derivatives gives ranges of the joints' second
    derivatives over a box. A function on a box is below the bilinear interpolation of its corners by at most
    (M_phi h_phi² + M_psi h_psi²) / 2, with half-widths h and the greatest second derivatives M (0 if they are
    negative), and above it likewise. Where that tells little, as near a pole, the range of the values counts. Both are
    widened by 1e-6 rad, since they are computed in floating point.

    A line takes at least the rest-to-rest time of the slowest joint between both its ends, at the arm angle of the
    target that suits it best. With the same phi at both ends, psi at the outer end and psi + delta at the target, what
    a joint turns is a function of (phi, psi, delta), and between its eight corners in the same way: its second
    derivatives are differences of those at both ends. Whole turns count nothing, so that the joints' turns need not be
    known, and of each triple the other branch at the target counts as well. In time T from rest to rest a joint turns
    D(T) at most, forth and back added up: a motion that turns back is nowhere faster than some motion that does not
    (between the greatest speeds v_i and v_k to either side of a turn, put v_k + (v + v_k) (v_i - v_k) / (v_i + v_k) for
    v, v_i >= v_k: never less than |v|, and its rates are scaled down). So it does not matter how the tool gets along
    the line. Our own derivation.

    Args:
        arm: kinematics in the carried frame.
        flange: its rotation, shape (3, 3), and position [m], shape (3,), in the carried frame at platform angle zero.
        intervals: the platform angles, within the parts of its cells (`finer_edges`).
        resolution: how finely.
        free_last: whether joint 7 is free.
        line: the line that begins or ends there; None without one.
    """
    if not len(intervals.index):
        return free_cells(arm, np.zeros(1))  # no cell at all
    finer = resolution.finer
    known = np.zeros(len(intervals.index)) if line is None else line.floor(intervals)
    found = compiled.posture_cells(
        arm.numbers,
        flange,
        None if line is None else (line.target, *line.law.time_table),
        (intervals.index // finer, intervals.low, intervals.high, known),
        (resolution.arm_angles, finer),
        free_last,
    )
    return Cells(*found)


def finer_edges(edges: FloatArray, finer: int) -> FloatArray:
    """Returns the borders of the cells' equal parts [rad], shape (finer g + 1,)."""
    count = len(edges) - 1
    return np.interp(np.arange(finer * count + 1) / finer, np.arange(count + 1), edges)


def free_cells(arm: PostureSource, edges: FloatArray) -> Cells:
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
