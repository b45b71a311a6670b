"""One arm's stops as cells: where its transfers end and begin, and how long it works in between at least."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dualarm_cli.bound.cells import (
    ROUNDING,
    Cells,
    LineToTarget,
    free_cells,
    point_cells,
    pose_cells,
)
from dualarm_cli.bound.stretched_lines import line_bounds
from dualarm_cli.compiled.transfer_times import CellRuns, Laws, LineEnds, boxes, least_work
from dualarm_cli.effort import Resolution
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.geometry.elementary import TURN
from dualarm_cli.geometry.linear_systems import singular_values
from dualarm_cli.kinematics.closed_arm import ClosedArm
from dualarm_cli.kinematics.srs_arm import SrsArm
from dualarm_cli.postures.platform_reach import AngleCells, reachable_cells
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.problem import ArmWork, SequenceProblem, StopTarget
from dualarm_cli.stages.plans.stops import StopTable, flange_poses, platform_positions
from dualarm_cli.stages.search.transfer_table import Coordinates, TransferTable

Times = NDArray[np.float32]
Pose = tuple[FloatArray, FloatArray, FloatArray]
"""Of the flange at the target, and the tool's direction, as of `flange_poses`, shape (1, ...)."""
RUN = 32
"""Most cells of one run."""
SINGULAR = 1e-4
"""Least singular value of the Jacobian, lengths over the arm's, below which a pose's postures count as unknown."""
MOST_TURNS = 3
"""Number of turns within limits from which a joint may be anywhere."""
HERE = np.zeros(2)
"""Borders of the only cell of a platform that stands still."""


@dataclass(frozen=True)
class PostureBoxes:
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
    def of(cls, table: TransferTable, cells: Cells, columns: int) -> PostureBoxes:
        """Returns cells in steps."""
        low, high = table.box(cells.low[:, :columns], cells.high[:, :columns])
        return cls(cells.index, cells.kind, low, high, cells.line.astype(np.float32))

    def ends(self, groups: int) -> LineEnds:
        """Returns the cells as one end of lines, in so many platform cells."""
        first = np.searchsorted(self.index, np.arange(groups + 1)).astype(np.int64)
        return LineEnds.of(boxes(self.low, self.high), first, self.line)

    @cached_property
    def runs(self) -> CellRuns:
        """The cells in runs of those next to each other in platform cell, branch and arm angle."""
        n = len(self.index)
        change = (np.diff(self.index) != 0) | (np.diff(self.kind) != 0)
        begins = np.concatenate([[True], change])
        start = np.maximum.accumulate(np.where(begins, np.arange(n), 0))
        first = np.flatnonzero((np.arange(n) - start) % RUN == 0)
        low = np.minimum.reduceat(self.low, first, axis=1)
        high = np.maximum.reduceat(self.high, first, axis=1)
        index = np.ascontiguousarray(self.index, dtype=np.int64)
        cells = boxes(self.low, self.high)
        return CellRuns.of(cells, index, boxes(low, high), np.append(first, n))


@dataclass(frozen=True)
class StopBoxes:
    """One stop."""

    approach: PostureBoxes
    """Where its transfer ends."""
    retract: PostureBoxes
    """Where the next transfer begins."""
    same: bool
    """Whether both are one posture, there being no lines."""
    dwell: float
    """Time at the target [s]."""
    free: int | None
    """The last joint where it tells nothing, because turning the tool turns it alone; None where it does."""

    @property
    def untold(self) -> tuple[int, ...]:
        """The coordinates that do not count."""
        return () if self.free is None else (self.free,)

    @property
    def possible(self) -> bool:
        """Whether there are postures at all: at both ends, for one platform cell."""
        used = [np.bincount(end.index) > 0 for end in (self.approach, self.retract)]
        most = min(map(len, used))
        return bool((used[0][:most] & used[1][:most]).any())


@dataclass(frozen=True)
class StopReach:
    """Where one stop's lines begin and end, and from which parts of the platform's cells that is within reach."""

    poses: tuple[Pose, ...]
    """One for every yaw; none where joints are given or may be anything."""
    ends: tuple[tuple[AngleCells, AngleCells], ...]
    """Of each pose of an arm with an arm angle, the platform angles from which the outer end of its approach is within
    reach, and those from which that of its retract is."""
    parts: BoolArray
    """Whether both ends are within reach from somewhere in a part, with one yaw, shape (f,)."""
    free_last: bool
    """Whether the last joint tells nothing, because turning the tool turns it alone."""

    def within(self, parts: BoolArray) -> StopReach:
        """Returns the reach from some of the parts alone."""
        ends = tuple(
            (
                approach.take(np.flatnonzero(parts[approach.index])),
                retract.take(np.flatnonzero(parts[retract.index])),
            )
            for approach, retract in self.ends
        )
        return replace(self, ends=ends, parts=self.parts & parts)


def stop_reach(
    problem: SequenceProblem, arm: int, stops: StopTable, stage: int, edges: FloatArray
) -> StopReach:
    """Returns the reach of one arm's stop.

    Args:
        problem: the sequence.
        arm: index of the arm.
        stops: its stops.
        stage: which stage; the arm works in it.
        edges: borders of the parts of the platform's cells [rad], shape (f + 1,).
    """
    work = problem.arms[arm]
    stop = work.stops[stage]
    assert stop is not None  # callers ask for active stages only
    every = np.ones(len(edges) - 1, dtype=np.bool_)
    yaw_is_free = stop.configurations is None and (stop.free_yaw or len(stop.yaw) > 1)
    free_last = yaw_is_free and work.last_axis_is_tools
    if stop.configurations is not None or (stop.free_yaw and not free_last):
        return StopReach((), (), every, free_last)
    yaws = np.zeros(1) if free_last else stop.yaw
    row, zero = stops.first[[stage]], platform_positions(problem, np.zeros(1))
    poses = tuple(
        flange_poses(problem.platform, work, stops, row, np.array([yaw]), zero) for yaw in yaws
    )
    if not isinstance(work.kinematics, SrsArm):
        return StopReach(poses, (), every, free_last)
    ends = tuple(_ends_within_reach(work.kinematics, stop, pose, edges) for pose in poses)
    parts = np.zeros_like(every)
    for approach, retract in ends:
        parts[np.intersect1d(approach.index, retract.index)] = True
    return StopReach(poses, ends, parts, free_last)


def _ends_within_reach(
    arm: SrsArm, stop: StopTarget, pose: Pose, edges: FloatArray
) -> tuple[AngleCells, AngleCells]:
    """Returns from where the outer ends of a pose's lines are within reach: of the approach and of the retract."""
    R, p, z = (x[0] for x in pose)
    lengths = dict.fromkeys((stop.approach, stop.retract))
    ends = [reachable_cells(arm, arm.wrist_center(R, p - x * z), edges) for x in lengths]
    return ends[0], ends[-1]


def stop_boxes(
    problem: SequenceProblem,
    arm: int,
    table: TransferTable,
    stage: int,
    reach: StopReach,
    edges: FloatArray,
    resolution: Resolution,
) -> StopBoxes:
    """Returns the cells of one arm's stop, which hold all of its postures at the platform angles of its reach.

    Given configurations are points where there is no line, and free otherwise; a pose whose yaw is free is free too
    where yaw moves more than the last joint. An arm without an arm angle has other closed
    forms, and its platform stands still.

    Args:
        problem: the sequence.
        arm: index of the arm.
        table: its transfer times.
        stage: which stage; the arm works in it.
        reach: of the stop.
        edges: borders of the platform's cells [rad], shape (g + 1,).
        resolution: how finely.
    """
    work = problem.arms[arm]
    stop = work.stops[stage]
    assert stop is not None  # callers ask for active stages only
    columns = work.joints + (1 if problem.turns else 0)
    still = stop.approach == 0.0 and stop.retract == 0.0
    if stop.configurations is not None and still:
        ends = [point_cells(stop.configurations, edges)] * 2
    elif not reach.poses:
        ends = [free_cells(work.kinematics, edges)] * 2
    else:
        if reach.ends:
            found = [
                _pose_cells(work, stop, pose, within, resolution, reach.free_last)
                for pose, within in zip(reach.poses, reach.ends, strict=True)
            ]
        else:
            found = [branch_cells(work, table, stop, pose, reach.free_last) for pose in reach.poses]
        ends = (
            found[0]
            if len(found) == 1
            else [Cells.joined([one[end] for one in found]) for end in (0, 1)]
        )
    approach = retract = PostureBoxes.of(table, ends[0], columns)
    if ends[1] is not ends[0]:
        retract = PostureBoxes.of(table, ends[1], columns)
    free = work.joints - 1 if reach.free_last else None
    return StopBoxes(approach, retract, still, stop.dwell, free)


def _pose_cells(
    work: ArmWork,
    stop: StopTarget,
    pose: Pose,
    within: tuple[AngleCells, AngleCells],
    resolution: Resolution,
    free_last: bool,
) -> list[Cells]:
    """Returns the cells at both outer ends of a pose's lines, from the platform angles within reach."""
    arm = work.closed_form
    R, p, z = (x[0] for x in pose)

    def cells(length: float, intervals: AngleCells) -> Cells:
        outer = p - length * z
        ends = arm.wrist_center(R, outer), arm.wrist_center(R, p)
        line = LineToTarget(p, work.law, lambda some: line_bounds(work, R, *ends, some))
        return pose_cells(arm, R, outer, intervals, resolution, free_last, line if length else None)

    approach = cells(stop.approach, within[0])
    return [approach, approach if stop.approach == stop.retract else cells(stop.retract, within[1])]


@dataclass(frozen=True)
class StopWork:
    """Approach, dwell and retract of one stop."""

    laws: Laws
    """The arm's transfer times."""
    stop: StopBoxes
    """The cells."""

    @cached_property
    def least(self) -> Times:
        """From each approach cell, whatever follows [s], shape (n,)."""
        return self._with(np.zeros(len(self.stop.retract.index), dtype=np.float32))

    @cached_property
    def _ends(self) -> tuple[int, LineEnds, LineEnds]:
        """Number of platform cells, and both ends for the compiled function."""
        approach, retract = self.stop.approach, self.stop.retract
        groups = 1 + int(max(approach.index[-1], retract.index[-1]))
        return groups, approach.ends(groups), retract.ends(groups)

    def _with(self, rest: Times) -> Times:
        dwell = np.float32(self.stop.dwell)
        if self.stop.same:
            return rest + dwell
        groups, approach, retract = self._ends
        return least_work(self.laws, approach, retract, groups, rest) + dwell

    def with_rest(self, rest: Times) -> tuple[Times, Times]:
        """Returns the least of work and rest, and of the rest alone, from each approach cell [s], shape (n,) each.

        Args:
            rest: from each retract cell [s].
        """
        if self.stop.same:
            return self._with(rest), rest
        index = self.stop.retract.index
        cells, first = np.unique(index, return_index=True)
        beyond = np.full(self._ends[0], np.inf, dtype=np.float32)
        beyond[cells] = np.minimum.reduceat(rest, first)
        return self._with(rest), beyond[self.stop.approach.index]


def stop_work(table: TransferTable, stop: StopBoxes) -> StopWork:
    """Returns the least times of approach, dwell and retract between the cells of one stop.

    Args:
        table: the arm's transfer times.
        stop: the cells, some of either end in one platform cell.
    """
    return StopWork(table.laws(stop.untold), stop)


def branch_cells(
    work: ArmWork,
    table: TransferTable,
    stop: StopTarget,
    pose: tuple[FloatArray, FloatArray, FloatArray],
    free_last: bool,
) -> list[Cells]:
    """Returns the cells at both outer ends of a pose's lines: points, one for each posture and whole turn.

    A line takes at least the rest-to-rest time from its outer posture to the nearest one at the target. Where a pose is
    singular, or nearly, its postures are a continuum, or not known to ROUNDING: its cell is everything within limits.

    Args:
        work: an arm with closed forms.
        table: its transfer times.
        stop: what it does.
        pose: of the flange at the target, and the tool's direction, as of `flange_poses`, shape (1, ...).
        free_last: whether the last joint is free.
    """
    arm = work.kinematics
    assert isinstance(arm, ClosedArm)  # callers have looked
    R, p, z = (x[0] for x in pose)
    target = _postures(arm, R, p, free_last)
    ends = []
    for length in dict.fromkeys((stop.approach, stop.retract)):
        found = target if length == 0.0 else _postures(arm, R, p - length * z, free_last)
        if found is None:
            ends.append(free_cells(arm, HERE))
            continue
        branch, low, high = found
        line = np.zeros(len(low))
        if length and target is not None:
            # What is free may be anywhere in either cell.
            line = table.gap_times(*table.box(low, high), *table.box(*target[1:])).min(axis=1)
        here = np.zeros((len(low), 1))
        number = np.zeros(len(low), dtype=np.int64)
        ends.append(Cells(number, branch, np.hstack([low, here]), np.hstack([high, here]), line))
    return [ends[0], ends[-1]]


def _postures(
    arm: ClosedArm, R: FloatArray, p: FloatArray, free_last: bool
) -> tuple[IntArray, FloatArray, FloatArray] | None:
    """Returns branches (n,), lowest and highest joints (n, 6) [rad] of all that may reach a pose; None for unknown."""
    found = arm.solve(R, p)
    branch = np.flatnonzero(found.reachable)
    q = found.q[branch]
    if not len(q) or found.singular.any():
        return None
    J = arm.jacobian(q)
    J[:, :3] /= arm.length
    if singular_values(J)[:, -1].min() < SINGULAR:
        return None
    low, high = q - ROUNDING, q + ROUNDING
    for joint in range(arm.axes):
        bottom, top = arm.lower[joint], arm.upper[joint]
        if (free_last and joint == arm.axes - 1) or not top - bottom < MOST_TURNS * TURN:
            low[:, joint], high[:, joint] = bottom, top
            continue
        first = np.ceil((bottom - high[:, joint]) / TURN)
        count = (np.floor((top - low[:, joint]) / TURN) - first + 1).astype(np.int64)
        rows = np.repeat(np.arange(len(low)), np.maximum(count, 0))
        place = np.arange(len(rows)) - np.searchsorted(rows, rows)
        branch, low, high = branch[rows], low[rows], high[rows]
        shift = TURN * (first[rows] + place)
        low[:, joint] += shift
        high[:, joint] += shift
    return (branch, low, high) if len(low) else None
