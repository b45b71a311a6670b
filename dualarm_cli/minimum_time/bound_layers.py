"""One arm's stops as cells: where its transfers end and begin, and how long it works in between at least."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.minimum_time.bound_cells import Cells, free_cells, point_cells, pose_cells
from dualarm_cli.minimum_time.bound_lines import line_bounds
from dualarm_cli.minimum_time.nodes import yaw_turns_last_joint
from dualarm_cli.minimum_time.problem import ArmWork, SequenceProblem, StopTarget
from dualarm_cli.minimum_time.stops import StopTable, flange_poses, platform_positions
from dualarm_cli.minimum_time.transfer_table import Coordinates, TransferTable

Times = NDArray[np.float32]


@dataclass(frozen=True)
class Boxes:
    """Cells in steps of a table, rounded outward; n of them."""

    index: IntArray
    """Platform cell of each, ascending, shape (n,)."""
    low: Coordinates
    """Lowest joints and platform, shape (c, n)."""
    high: Coordinates
    """Highest ones, shape (c, n)."""
    line: Times
    """Least time of the line at this end [s], shape (n,)."""

    @classmethod
    def of(cls, table: TransferTable, cells: Cells, line: FloatArray, columns: int) -> Boxes:
        """Returns cells in steps."""
        low, high = table.box(cells.low[:, :columns], cells.high[:, :columns])
        return cls(cells.index, low, high, line.astype(np.float32))


@dataclass(frozen=True)
class StopBoxes:
    """One stop."""

    approach: Boxes
    """Where its transfer ends."""
    retract: Boxes
    """Where the next transfer begins."""
    same: bool
    """Whether both are one posture, there being no lines."""
    dwell: float
    """Time at the target [s]."""
    free_last: bool
    """Whether joint 7 tells nothing, because turning the tool turns it alone."""


def stop_boxes(
    problem: SequenceProblem,
    arm: int,
    stops: StopTable,
    table: TransferTable,
    stage: int,
    edges: FloatArray,
    arm_angles: int,
) -> StopBoxes:
    """Returns the cells of one arm's stop.

    Given configurations are points where there is no line, and free otherwise; a pose whose yaw is free is free too
    where yaw moves more than joint 7.

    Args:
        problem: the sequence.
        arm: index of the arm.
        stops: its stops.
        table: its transfer times.
        stage: which stage; the arm works in it.
        edges: borders of the platform's cells [rad], shape (g + 1,).
        arm_angles: parts of the circle of elbows.
    """
    work = problem.arms[arm]
    stop = work.stops[stage]
    assert stop is not None  # callers ask for active stages only
    columns = 8 if problem.turns else 7
    still = stop.approach == 0.0 and stop.retract == 0.0
    straight = yaw_turns_last_joint(work)
    free_last = straight and (stop.free_yaw or len(stop.yaw) > 1) and stop.configurations is None
    cells: tuple[Cells, Cells]
    lines = np.zeros(0), np.zeros(0)
    if stop.configurations is not None and still:
        cells = (point_cells(stop.configurations, edges),) * 2
    elif stop.configurations is not None or (stop.free_yaw and not straight):
        cells = (free_cells(work.kinematics, edges),) * 2
    else:
        yaws = np.zeros(1) if free_last else stop.yaw
        parts = [
            _pose(problem, work, stops, stage, stop, yaw, edges, arm_angles, free_last)
            for yaw in yaws
        ]
        cells = _joined([part[0][0] for part in parts]), _joined([part[0][1] for part in parts])
        lines = _in_order(parts, 0), _in_order(parts, 1)
    boxes = [
        Boxes.of(table, c, line if len(line) else np.zeros(len(c.index)), columns)
        for c, line in zip(cells, lines, strict=True)
    ]
    return StopBoxes(boxes[0], boxes[1], still, stop.dwell, free_last)


def _pose(
    problem: SequenceProblem,
    work: ArmWork,
    stops: StopTable,
    stage: int,
    stop: StopTarget,
    yaw: float,
    edges: FloatArray,
    arm_angles: int,
    free_last: bool,
) -> tuple[tuple[Cells, Cells], tuple[FloatArray, FloatArray]]:
    """Returns the cells at both outer ends of a pose's lines, and the lines' least times by cell."""
    arm = work.kinematics
    row = stops.first[[stage]]
    zero = platform_positions(problem, np.zeros(1))
    R, p, z = (
        x[0] for x in flange_poses(problem.platform, work, stops, row, np.array([yaw]), zero)
    )
    target = arm.wrist_center(R, p)
    cells, lines = [], []
    for length in (stop.approach, stop.retract):
        if cells and stop.approach == stop.retract:
            cells.append(cells[0])
            lines.append(lines[0])
            continue
        outer = p - length * z
        found, intervals, _ = pose_cells(arm, R, outer, edges, arm_angles, free_last)
        least = line_bounds(work, arm.wrist_center(R, outer), target, intervals)
        cells.append(found)
        lines.append(least[found.part])
    return (cells[0], cells[1]), (lines[0], lines[1])


def _joined(parts: list[Cells]) -> Cells:
    """Returns the cells of several yaws, in order of their platform cell."""
    index = np.concatenate([part.index for part in parts])
    order = np.argsort(index, kind="stable")
    low, high, part = (
        np.concatenate([getattr(part, name) for part in parts])[order]
        for name in ("low", "high", "part")
    )
    return Cells(index[order], low, high, part)


def _in_order(
    parts: list[tuple[tuple[Cells, Cells], tuple[FloatArray, FloatArray]]], end: int
) -> FloatArray:
    """Returns the line times of several yaws in the order of their joined cells."""
    index = np.concatenate([cells[end].index for cells, _ in parts])
    times = np.concatenate([lines[end] for _, lines in parts])
    return times[np.argsort(index, kind="stable")]
