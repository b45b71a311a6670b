"""Posture cells at stop ends, and lower bounds of approach, dwell and retract."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from dualarm_cli.bound.cells import (
    ROUNDING,
    Cells,
    LineToTarget,
    finer_edges,
    free_cells,
    point_cells,
    pose_cells,
)
from dualarm_cli.bound.stretched_lines import line_bounds
from dualarm_cli.effort import Resolution
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.srs_arm import SrsArm
from dualarm_cli.postures.platform_reach import AngleCells, reachable_cells
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.candidates import flange_poses, platform_positions
from dualarm_cli.stages.plans.problem import ArmWork, SequenceProblem, StopTarget
from dualarm_cli.stages.search.potentials import transfer_table
from dualarm_cli.timing.transfer_table import Pairs, PostureBoxes, Times, TransferTable

Pose = tuple[FloatArray, FloatArray, FloatArray]
"""Flange pose at the target and directions of lines, as of `flange_poses`, shape (1, ...)."""
HERE = np.zeros(2)
"""Borders of the single cell of a fixed platform."""


@dataclass(frozen=True)
class StopReach:
    """Platform angles from which a stop's lines are within reach."""

    poses: tuple[Pose, ...]
    """Poses, one for every yaw; empty for given or free joints."""
    ends: tuple[tuple[AngleCells, AngleCells], ...]
    """Platform angles of each pose: with the approach's outer end in reach, and the retract's.

    For arms with an arm angle only.
    """
    span: FloatArray
    """Range of each platform part with both ends in reach [rad], shape (2, f).

    With the same yaw at both ends. The low end is infinite, and above the high one, if there is none.
    """
    free_last: bool
    """Flag of a free last joint: yaw turns it alone."""

    def within(self, low: FloatArray, high: FloatArray) -> StopReach:
        """Restrict the reach to a range of each platform part [rad], shape (f,) each."""

        def restricted(cells: AngleCells) -> AngleCells:
            begin = np.maximum(cells.low, low[cells.index])
            end = np.minimum(cells.high, high[cells.index])
            return AngleCells(cells.index, begin, end).take(np.flatnonzero(begin <= end))

        ends = tuple((restricted(approach), restricted(retract)) for approach, retract in self.ends)
        return replace(self, ends=ends)


@dataclass(frozen=True)
class StopWork:
    """Approach, dwell and retract of one stop, between cells of postures."""

    lines: Pairs
    """Pairs of cells where the approach begins and where the retract ends."""
    same: bool
    """Flag of a stop without lines, whose ends are one posture."""
    dwell: float
    """Time at the target [s]."""

    @property
    def approach(self) -> PostureBoxes:
        """Cells where the transfer to the stop ends."""
        return self.lines.before

    @property
    def retract(self) -> PostureBoxes:
        """Cells where the next transfer begins."""
        return self.lines.after

    @property
    def ignored(self) -> tuple[int, ...]:
        """Coordinates without influence: the last joint, if yaw turns it alone."""
        return self.lines.without

    @property
    def possible(self) -> bool:
        """Flag of stops with postures at both ends for one platform cell."""
        used = [np.bincount(end.index) > 0 for end in (self.approach, self.retract)]
        shared = min(map(len, used))
        return bool((used[0][:shared] & used[1][:shared]).any())

    @cached_property
    def least(self) -> Times:
        """Least work from each approach cell over all retract cells [s], shape (n,)."""
        zero = np.zeros(len(self.retract.index), dtype=np.float32)
        return self.with_rest(zero, zero)[0]

    def onward(self, turned: Times) -> Times:
        """Compute the least dwell, retract and rest after approaches that are not late [s], shape (n,).

        Args:
            turned: time that follows from each retract cell after a retract from the target [s].
        """
        if self.same or self.approach.at_target:
            return self.with_rest(turned, turned)[0]
        return self.lines.least_in_cell(self.retract.line + turned) + np.float32(self.dwell)

    def with_rest(self, rest: Times, turned: Times) -> tuple[Times, Times]:
        """Compute the least work plus rest, and the least rest, per approach cell.

        Args:
            rest: time that follows from each retract cell [s].
            turned: the same, after a retract from the target.

        Returns:
            Both in s, shape (n,) each.
        """
        if self.same:
            return turned + np.float32(self.dwell), turned
        sums = self.lines.least_within(rest, turned)
        return sums + np.float32(self.dwell), self.lines.least_in_cell(rest)


@dataclass(frozen=True)
class StopCells:
    """Cells of all stops of a sequence, over a grid of platform angles."""

    problem: SequenceProblem
    """The sequence."""
    edges: FloatArray
    """Borders of the platform's cells [rad], shape (g + 1,)."""
    resolution: Resolution
    """Fineness of the cells."""

    @cached_property
    def tables(self) -> tuple[TransferTable, ...]:
        """Transfer times of each arm."""
        return tuple(transfer_table(self.problem, work) for work in self.problem.arms)

    @cached_property
    def parts(self) -> FloatArray:
        """Borders of the parts of the platform's cells [rad], shape (f + 1,)."""
        return finer_edges(self.edges, self.resolution.finer)

    def works(self, stage: int) -> dict[int, StopWork]:
        """Compute the work of each active arm in a stage.

        Only platform angles from which all active arms reach their stops count.
        """
        arms = [a for a, arm in enumerate(self.problem.arms) if arm.stops[stage] is not None]
        reach = {a: self.reach(a, stage) for a in arms}
        low, high = np.stack([each.span for each in reach.values()], axis=1)
        shared = low.max(axis=0), high.min(axis=0)
        return {a: self.work(a, stage, reach[a].within(*shared)) for a in arms}

    def reach(self, a: int, stage: int) -> StopReach:
        """Compute the platform angles from which an arm reaches its stop."""
        problem = self.problem
        work = problem.arms[a]
        stop = work.stops[stage]
        assert stop is not None  # callers pass active stages only
        every = np.stack([self.parts[:-1], self.parts[1:]])
        yaw_is_free = stop.configurations is None and (stop.free_yaw or len(stop.yaw) > 1)
        free_last = yaw_is_free and work.last_axis_is_tools and not stop.lines_turn
        if stop.configurations is not None or (stop.free_yaw and not free_last):
            return StopReach((), (), every, free_last)
        yaws = np.zeros(1) if free_last else stop.yaw
        row, zero = work.stop_table.first[[stage]], platform_positions(problem, np.zeros(1))
        poses = tuple(
            flange_poses(problem.platform, work, row, np.array([yaw]), zero) for yaw in yaws
        )
        if not work.kinematics.has_arm_angle:
            return StopReach(poses, (), every, free_last)
        ends = tuple(_ends_within_reach(work.closed_form, stop, pose, self.parts) for pose in poses)
        low, high = np.stack([_ranges(*pair, every.shape[1]) for pair in ends], axis=1)
        return StopReach(poses, ends, np.stack([low.min(axis=0), high.max(axis=0)]), free_last)

    def work(self, a: int, stage: int, reach: StopReach) -> StopWork:
        """Compute the posture cells at both ends of one arm's stop.

        They cover all of its postures at the platform angles of its reach. Given configurations are points without
        lines, and free joints with lines. A pose with free yaw gives free joints, too, if yaw moves more than the last
        joint. An arm without an arm angle has other closed forms, and a fixed platform.
        """
        problem = self.problem
        work = problem.arms[a]
        stop = work.stops[stage]
        assert stop is not None  # callers pass active stages only
        columns = work.joints + (1 if problem.turns else 0)
        still = stop.approach == 0.0 and stop.retract == 0.0
        if stop.configurations is not None and still:
            ends = [point_cells(stop.configurations, self.edges)] * 2
        elif not reach.poses:
            ends = [free_cells(work.kinematics, self.edges)] * 2
        else:
            if reach.ends:
                covers = [
                    _pose_cells(work, stop, pose, within, self.resolution, reach.free_last)
                    for pose, within in zip(reach.poses, reach.ends, strict=True)
                ]
            else:
                covers = [
                    branch_cells(work, self.tables[a], stop, pose, reach.free_last)
                    for pose in reach.poses
                ]
            ends = (
                covers[0]
                if len(covers) == 1
                else [Cells.joined([cover[end] for cover in covers]) for end in (0, 1)]
            )
        late = self.resolution.late
        # Without a line the joints are at rest at the target.
        approach, retract = (
            _boxes(self.tables[a], cells, columns, late if length else np.inf)
            for cells, length in zip(ends, (stop.approach, stop.retract), strict=True)
        )
        free = (work.joints - 1,) if reach.free_last else ()
        return StopWork(Pairs(self.tables[a], approach, retract, free), still, stop.dwell)


def _boxes(table: TransferTable, cells: Cells, columns: int, late: float) -> PostureBoxes:
    """Round cells to steps of a table; `late` is infinite without a line."""
    low, high = table.box(cells.low[:, :columns], cells.high[:, :columns])
    line = cells.line.astype(np.float32)
    if table.chains is None:
        return PostureBoxes(cells.index, cells.kind, low, high, line)
    displacement = np.full((2, *low.shape), 0 if np.isinf(late) else -1, dtype=np.int16)
    if len(cells.displacement):
        steps = np.floor(cells.displacement * table.scale[:7]).transpose(1, 2, 0)
        displacement[:, :7] = np.where(steps < 0.0, -1, steps)
    return PostureBoxes(cells.index, cells.kind, low, high, line, displacement, late)


def _ends_within_reach(
    arm: SrsArm, stop: StopTarget, pose: Pose, edges: FloatArray
) -> tuple[AngleCells, AngleCells]:
    """Compute the platform angles that reach the approach's outer end, and the retract's."""
    ends = [
        reachable_cells(arm, arm.wrist_center(pose[0][0], outer), edges)
        for _, outer in _lines(stop, pose)
    ]
    return ends[0], ends[-1]


def _ranges(approach: AngleCells, retract: AngleCells, count: int) -> FloatArray:
    """Compute the range of each platform part that reaches both ends [rad], shape (2, count).

    Its low end is infinite, and above the high one, if there is none.
    """
    low, high = np.full((2, count), np.inf), np.full((2, count), -np.inf)
    for end, cells in enumerate((approach, retract)):
        np.minimum.at(low[end], cells.index, cells.low)
        np.maximum.at(high[end], cells.index, cells.high)
    both = np.stack([low.max(axis=0), high.min(axis=0)])
    both[:, both[0] > both[1]] = [[np.inf], [-np.inf]]
    return both


def _lines(stop: StopTarget, pose: Pose) -> list[tuple[float, FloatArray]]:
    """List length and outer flange position of approach and retract [m]; equal lines once."""
    p, away = pose[1][0], pose[2][0]
    lines = [(x, p + x * away[k]) for k, x in enumerate((stop.approach, stop.retract))]
    alike = lines[0][0] == lines[1][0] and np.array_equal(lines[0][1], lines[1][1])
    return lines[:1] if alike else lines


def _pose_cells(
    work: ArmWork,
    stop: StopTarget,
    pose: Pose,
    within: tuple[AngleCells, AngleCells],
    resolution: Resolution,
    free_last: bool,
) -> list[Cells]:
    """Compute the cells at both outer ends of a pose's lines."""
    arm = work.closed_form
    R, p = pose[0][0], pose[1][0]
    target = arm.wrist_center(R, p)

    def cells(length: float, outer: FloatArray, intervals: AngleCells) -> Cells:
        ends = arm.wrist_center(R, outer), target
        line = LineToTarget(p, work.law, lambda block: line_bounds(work, R, *ends, block))
        return pose_cells(
            arm, (R, outer), intervals, resolution, free_last, line if length else None
        )

    ends = [
        cells(*line, intervals) for line, intervals in zip(_lines(stop, pose), within, strict=False)
    ]
    return [ends[0], ends[-1]]


def branch_cells(
    work: ArmWork,
    table: TransferTable,
    stop: StopTarget,
    pose: tuple[FloatArray, FloatArray, FloatArray],
    free_last: bool,
) -> list[Cells]:
    """Compute point cells at both outer ends of lines, one per posture and turn.

    A line takes at least the rest-to-rest time from its outer posture to the nearest posture at the target. At or near
    a singularity the postures are a continuum or uncertain beyond ROUNDING: then the cell is the whole joint range.

    Args:
        work: an arm with closed forms.
        table: its transfer times.
        stop: its stop.
        pose: flange pose at the target and directions of lines, as of `flange_poses`, shape (1, ...).
        free_last: whether the last joint is free, because yaw is.
    """
    arm = work.kinematics
    R = pose[0][0]
    target = arm.enclosure(R, pose[1][0], ROUNDING, free_last)
    ends = []
    for length, outer in _lines(stop, pose):
        enclosure = target if length == 0.0 else arm.enclosure(R, outer, ROUNDING, free_last)
        if enclosure is None:
            ends.append(free_cells(arm, HERE))
            continue
        branch, low, high = enclosure
        line = np.zeros(len(low))
        if length and target is not None:
            # Free joints may have any value in both cells.
            line = table.gap_times(*table.box(low, high), *table.box(*target[1:])).min(axis=1)
        platform = np.zeros((len(low), 1))
        number = np.zeros(len(low), dtype=np.int64)
        ends.append(
            Cells(number, branch, np.hstack([low, platform]), np.hstack([high, platform]), line)
        )
    return [ends[0], ends[-1]]
