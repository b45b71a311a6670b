"""One arm's stops as cells: where its transfers end and begin, and how long it works in between at least."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.minimum_time.bound_cells import (
    Cells,
    Resolution,
    free_cells,
    point_cells,
    pose_cells,
)
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
    def of(cls, table: TransferTable, cells: Cells, columns: int) -> Boxes:
        """Returns cells in steps."""
        low, high = table.box(cells.low[:, :columns], cells.high[:, :columns])
        return cls(cells.index, low, high, cells.line.astype(np.float32))


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

    @property
    def possible(self) -> bool:
        """Whether there are postures at all: at both ends, for one platform cell."""
        return bool(np.isin(self.approach.index, self.retract.index).any())


def stop_boxes(
    problem: SequenceProblem,
    arm: int,
    stops: StopTable,
    table: TransferTable,
    stage: int,
    edges: FloatArray,
    resolution: Resolution,
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
        resolution: how finely.
    """
    work = problem.arms[arm]
    stop = work.stops[stage]
    assert stop is not None  # callers ask for active stages only
    columns = 8 if problem.turns else 7
    still = stop.approach == 0.0 and stop.retract == 0.0
    straight = yaw_turns_last_joint(work)
    free_last = straight and (stop.free_yaw or len(stop.yaw) > 1) and stop.configurations is None
    if stop.configurations is not None and still:
        ends = [point_cells(stop.configurations, edges)] * 2
    elif stop.configurations is not None or (stop.free_yaw and not straight):
        ends = [free_cells(work.kinematics, edges)] * 2
    else:
        yaws = np.zeros(1) if free_last else stop.yaw
        parts = [
            _pose(problem, work, stops, stage, stop, yaw, edges, resolution, free_last)
            for yaw in yaws
        ]
        ends = [_joined([part[end] for part in parts]) for end in (0, 1)]
    approach, retract = (Boxes.of(table, cells, columns) for cells in ends)
    return StopBoxes(approach, retract, still, stop.dwell, free_last)


def _pose(
    problem: SequenceProblem,
    work: ArmWork,
    stops: StopTable,
    stage: int,
    stop: StopTarget,
    yaw: float,
    edges: FloatArray,
    resolution: Resolution,
    free_last: bool,
) -> list[Cells]:
    """Returns the cells at both outer ends of a pose's lines."""
    arm = work.kinematics
    row = stops.first[[stage]]
    zero = platform_positions(problem, np.zeros(1))
    R, p, z = (
        x[0] for x in flange_poses(problem.platform, work, stops, row, np.array([yaw]), zero)
    )
    target = arm.wrist_center(R, p)

    def cells(length: float) -> Cells:
        outer = p - length * z
        wrist = arm.wrist_center(R, outer)
        return pose_cells(
            arm,
            R,
            outer,
            edges,
            resolution,
            free_last,
            lambda intervals: line_bounds(work, R, wrist, target, intervals),
        )

    approach = cells(stop.approach)
    return [approach, approach if stop.approach == stop.retract else cells(stop.retract)]


def _joined(parts: list[Cells]) -> Cells:
    """Returns the cells of several yaws, in order of their platform cell."""
    index = np.concatenate([part.index for part in parts])
    order = np.argsort(index, kind="stable")
    low, high, line = (
        np.concatenate([getattr(part, name) for part in parts])[order]
        for name in ("low", "high", "line")
    )
    return Cells(index[order], low, high, line)
