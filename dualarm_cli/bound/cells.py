"""Posture cells that cover a stop's postures, with lower bounds of line times."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field

import numpy as np

from dualarm_cli.compiled import posture_cells as compiled
from dualarm_cli.effort import Resolution
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.kinematics.posture_source import PostureSource
from dualarm_cli.kinematics.srs_arm import SrsArm
from dualarm_cli.model.motion.rest_to_rest import PassingLaw, RestToRest
from dualarm_cli.postures.platform_reach import AngleCells
from dualarm_cli.records import dataclass

ROUNDING = 1e-6
"""Margin of enclosures for rounding [rad], in compiled code as well."""


@dataclass(frozen=True)
class Cells:
    """Joint enclosures of n posture cells, in order of their platform cell."""

    index: IntArray
    """Numbers in the platform's grid, shape (n,)."""
    kind: IntArray
    """Branches or other classes, shape (n,), ascending within a platform cell.

    Neighbours of the same kind have similar joint values.
    """
    low: FloatArray
    """Lower ends of joints and, last, platform angle [rad], shape (n, joints + 1)."""
    high: FloatArray
    """Upper ends of joints and, last, platform angle [rad], shape (n, joints + 1)."""
    line: FloatArray
    """Least time of the line at each cell [s], shape (n,)."""
    displacement: FloatArray = field(default_factory=lambda: np.zeros((0, 2, 7)))
    """Least rises, then falls, of joints towards the target [rad], shape (n, 2, 7).

    -1 for joints that need not rise or fall. They hold for lines that take less than `Resolution.late` beyond the
    least. Empty for lines from rest, and if they are not computed.
    """

    def take(self, rows: IntArray) -> Cells:
        """Select cells by their rows."""
        displacement = self.displacement[rows] if len(self.displacement) else self.displacement
        low, high, line = self.low[rows], self.high[rows], self.line[rows]
        return Cells(self.index[rows], self.kind[rows], low, high, line, displacement)

    @classmethod
    def joined(cls, parts: list[Cells]) -> Cells:
        """Join covers, in order of their platform cell."""
        every = cls(
            np.concatenate([part.index for part in parts]),
            np.concatenate([part.kind + 8 * k for k, part in enumerate(parts)]),
            *(
                np.concatenate([getattr(part, name) for part in parts])
                for name in ("low", "high", "line", "displacement")
            ),
        )
        return every.take(np.lexsort((every.kind, every.index)))


@dataclass(frozen=True)
class LineToTarget:
    """Straight line of the tool from a pose to its target, or back."""

    target: FloatArray
    """Flange position at the target [m], shape (3,), in the carried frame at platform angle zero."""
    law: RestToRest
    """Rest-to-rest times of the joints."""
    floor: Callable[[AngleCells], FloatArray]
    """First bound on the line's time over platform intervals [s]."""


def pose_cells(
    arm: SrsArm,
    flange: tuple[FloatArray, FloatArray],
    intervals: AngleCells,
    resolution: Resolution,
    free_last: bool,
    line: LineToTarget | None,
) -> Cells:
    """Compute cells that cover every posture at a fixed flange pose, over platform angles.

    Joints are enclosed on fine cells and clipped to their limits; cells with a joint outside its limits are dropped. A
    joint that meets its limits in two turns gives a cell for each. Where at most one in eight fine cells of an interval
    of the platform angle remains, the interval and the circle are cut once more, and a branch needs a fine cell there
    as well: every posture lies in one. Fine cells of the same branch and turn are then enclosed together: any grouping
    of a cover is a cover, and the excess of the enclosures shrinks with the square of the fine cells' size.

    Over each interval of the platform angle the arm plane is carried along from the middle by the smallest rotation of
    the shoulder-wrist line, and the circle of elbows is cut into equal parts: a box in (phi, psi). Joints 1 and 2 are
    azimuth and polar angle of the upper arm seen from the carried frame, joint 3 is the azimuth of axis 1 seen from the
    upper arm, at the same polar angle; joints 7, 6, 5 likewise with the forearm, seen from the tool. Their sines and
    cosines are A sin psi + B cos psi + C, where A, B and C follow from phi by sums, products, reciprocals and roots.
    Interval arithmetic on these and on their first and second derivatives gives ranges of the joints' second
    derivatives over a box. A function on a box is below the bilinear interpolation of its corners by at most
    (M_phi h_phi² + M_psi h_psi²) / 2, with half-widths h and the greatest second derivatives M (0 if they are
    negative), and above it likewise. Where this bound is loose, as near a pole, the range of the values is used. Both
    are widened by 1e-6 rad, because they are computed in floating point.

    A line takes at least the rest-to-rest time of the slowest joint between both its ends, at the best arm angle of the
    target. With the same phi at both ends, psi at the outer end and psi + delta at the target, the displacement of a
    joint is a function of (phi, psi, delta). It is bounded between its eight corners in the same manner: its second
    derivatives are differences of those at both ends. Displacements are taken modulo whole turns, so that the joints'
    turns may be unknown, and for each triple the other branch at the target counts as well. In time T from rest to rest
    a joint travels D(T) or less, back and forth added up: a motion with reversals is nowhere faster than some motion
    without (between the greatest speeds v_i and v_k to either side of a reversal, put v_k + (v + v_k) (v_i - v_k) /
    (v_i + v_k) for v, v_i >= v_k: never less than |v|, and its rates are scaled down). So the tool's timing along the
    line does not matter. Our own derivation.

    Where tools pass the outer end in motion, the displacements of all triples that take less than `late` beyond the
    least are enclosed as well, with their signs: they tell which joints turn back
    (`PassingLaw`).

    Args:
        arm: kinematics in the carried frame.
        flange: its rotation, shape (3, 3), and position [m], shape (3,), in the carried frame at platform angle zero.
        intervals: the platform angles, within the parts of its cells (`finer_edges`).
        resolution: fineness of the cells.
        free_last: whether joint 7 is free, because yaw is.
        line: the line that begins or ends at the pose, or None.
    """
    if not len(intervals.index):
        return free_cells(arm, np.zeros(1))  # an empty cover
    finer = resolution.finer
    floor = np.zeros(len(intervals.index)) if line is None else line.floor(intervals)
    passing = line.law if line is not None and isinstance(line.law, PassingLaw) else None
    late = 0.0 if passing is None else resolution.late
    index, branch, low, high, times, least, most = compiled.posture_cells(
        arm.numbers,
        flange,
        None if line is None else (line.target, *line.law.time_table, late),
        (intervals.index // finer, intervals.low, intervals.high, floor),
        (resolution.arm_angles, resolution.finer_circle or finer),
        free_last,
    )
    if passing is None:
        return Cells(index, branch, low, high, times)
    least_each_side = np.stack([least, -most], axis=1)
    return Cells(
        index, branch, low, high, times, np.where(least_each_side > 0.0, least_each_side, -1.0)
    )


def finer_edges(edges: FloatArray, finer: int) -> FloatArray:
    """Divide cells into `finer` equal parts each: borders [rad], shape (finer g + 1,)."""
    count = len(edges) - 1
    return np.interp(np.arange(finer * count + 1) / finer, np.arange(count + 1), edges)


def free_cells(arm: PostureSource, edges: FloatArray) -> Cells:
    """Make a cell per platform cell in which every joint is free."""
    n = len(edges) - 1
    return Cells(
        np.arange(n),
        np.zeros(n, dtype=np.int64),
        np.column_stack([np.tile(arm.lower, (n, 1)), edges[:-1]]),
        np.column_stack([np.tile(arm.upper, (n, 1)), edges[1:]]),
        np.zeros(n),
    )


def point_cells(configurations: FloatArray, edges: FloatArray) -> Cells:
    """Make cells of configurations (m, joints) that turn with the platform."""
    n, m = len(edges) - 1, len(configurations)
    q = np.tile(configurations, (n, 1))
    return Cells(
        np.repeat(np.arange(n), m),
        np.tile(np.arange(m), n),
        np.column_stack([q, np.repeat(edges[:-1], m)]),
        np.column_stack([q, np.repeat(edges[1:], m)]),
        np.zeros(n * m),
    )
