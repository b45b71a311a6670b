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
from dualarm_cli.minimum_time.potentials import LAST_JOINT
from dualarm_cli.minimum_time.problem import ArmWork, SequenceProblem, StopTarget
from dualarm_cli.minimum_time.stops import StopTable, flange_poses, platform_positions
from dualarm_cli.minimum_time.transfer_table import Coordinates, TransferTable

Times = NDArray[np.float32]


@dataclass(frozen=True)
class Boxes:
    """Cells in steps of a table, rounded outward; n of them."""

    index: IntArray
    """Platform cell of each, ascending, shape (n,)."""
    kind: IntArray
    """See `Cells`, shape (n,)."""
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
        return cls(cells.index, cells.kind, low, high, cells.line.astype(np.float32))


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
        ends = [Cells.joined([part[end] for part in parts]) for end in (0, 1)]
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


@dataclass(frozen=True)
class StopWork:
    """Approach, dwell and retract of one stop."""

    index: IntArray
    """Platform cell of each approach cell, shape (n,)."""
    count: int
    """Number n of approach cells."""
    parts: list[tuple[slice, slice, Times]]
    """By platform cell: approach cells, retract cells and the least work between them [s]."""
    least: Times
    """From each approach cell, whatever follows [s], shape (n,)."""

    def with_rest(self, rest: Times) -> tuple[Times, Times]:
        """Returns the least of work and rest, and of the rest alone, from each approach cell [s], shape (n,) each.

        Args:
            rest: from each retract cell [s].
        """
        own, beyond = (np.full(self.count, np.inf, dtype=np.float32) for _ in range(2))
        for approach, retract, least in self.parts:
            own[approach] = (least + rest[retract]).min(axis=1)
            beyond[approach] = np.where(np.isfinite(least), rest[retract], np.inf).min(axis=1)
        return own, beyond


def stop_work(table: TransferTable, stop: StopBoxes) -> StopWork:
    """Returns the least times of approach, dwell and retract between the cells of one stop.

    Args:
        table: the arm's transfer times.
        stop: the cells.
    """
    approach, retract = stop.approach, stop.retract
    parts = []
    work = np.full(len(approach.index), np.inf, dtype=np.float32)
    dwell = np.float32(stop.dwell)
    for cell in np.intersect1d(approach.index, retract.index):
        a, r = (slice(*np.searchsorted(x.index, [cell, cell + 1])) for x in (approach, retract))
        if stop.same:
            least = np.full((a.stop - a.start,) * 2, np.inf, dtype=np.float32)
            np.fill_diagonal(least, dwell)
        else:
            moved = table.gap_times(
                approach.low[:, a],
                approach.high[:, a],
                retract.low[:, r],
                retract.high[:, r],
                (LAST_JOINT,) if stop.free_last else (),
            )
            lines = approach.line[a][:, None] + retract.line[r][None, :]
            least = np.maximum(moved, lines) + dwell
        parts.append((a, r, least))
        work[a] = least.min(axis=1)
    return StopWork(approach.index, len(work), parts, work)
