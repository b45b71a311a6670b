"""One arm's stops as cells: where its transfers end and begin, and how long it works in between at least."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dualarm_cli.bound.branches import branch_cells
from dualarm_cli.bound.cells import Cells, free_cells, point_cells, pose_cells
from dualarm_cli.effort import Resolution
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.kinematics.srs.srs_arm import SrsArm
from dualarm_cli.postures.platform_reach import AngleCells, ShapeRates, shape_rates, turned
from dualarm_cli.stages.search.problem import ArmWork, SequenceProblem, StopTarget
from dualarm_cli.stages.search.stops import StopTable, flange_poses, platform_positions
from dualarm_cli.stages.search.transfer_table import Coordinates, TransferTable

WIDEST = 0.004
"""Intervals of the platform angle are cut into parts of this width at most, looked at one by one [rad]."""


def line_bounds(
    work: ArmWork, R: FloatArray, wrist: FloatArray, end: FloatArray, cells: AngleCells
) -> FloatArray:
    """Returns the least time of a line of the wrist centre [s], shape (c,), over each interval of the platform angle.

    With the tool's orientation constant the wrist centre goes straight from one end to the other. In time T from rest
    to rest joint j turns D_j(T) at most, forth and back added up: a motion that turns back is nowhere faster than some
    motion that does not (between the greatest speeds v_i and v_k to either side of a turn, put v_k + (v + v_k)
    (v_i - v_k) / (v_i + v_k) for v, v_i >= v_k: never less than |v|, and its rates are scaled down).

    (a) The distance from the shoulder is joint 4's alone: D_4(T) is at least its difference between the ends. (b) The
    shoulder-wrist line turns by an angle beta about an axis m that stays, perpendicular to it. Joint 4 turns it
    against the upper arm by no more than alpha varies in all, and alpha follows from the distance. The rest is up to
    the joints before: axis 1 has a share |z1·m| of it, axis 2 (at right angles to it) at most the rest of a unit
    vector, axis 3 (the upper arm) at most sin alpha: beta - var(alpha) <= sum of the shares times D_j(T). Only the
    instants count at which the wrist is farther than ever before; so it may turn back on the line. (c) The same as the
    tool sees it, with the axes 7, 6, 5 and the forearm's angle gamma. Everything at its worst over the interval. Our
    own derivation.

    Args:
        work: the arm.
        R: flange rotation in the carried frame at platform angle zero, shape (3, 3).
        wrist: wrist centre at one end there [m], shape (3,).
        end: wrist centre at the other end [m], shape (3,).
        cells: intervals of the platform angle.
    """
    c = len(cells.index)
    if not c or np.linalg.norm(end - wrist) == 0.0:
        return np.zeros(c)
    count = max(1, int(np.ceil(2.0 * cells.half.max() / WIDEST)))
    share = np.arange(count) / count
    low = (cells.low[:, None] + (2.0 * cells.half)[:, None] * share).ravel()
    parts = AngleCells(
        np.repeat(cells.index, count), low, low + np.repeat(2.0 * cells.half / count, count)
    )
    return _line_bounds(work, R, wrist, end, parts).reshape(c, count).min(axis=1)


def _line_bounds(
    work: ArmWork, R: FloatArray, wrist: FloatArray, end: FloatArray, cells: AngleCells
) -> FloatArray:
    arm = work.closed_form
    geometry = arm.geometry
    one, other = (shape_rates(arm, x, cells) for x in (wrist, end))
    v, w = (turned(x, cells.middle) - geometry.shoulder for x in (wrist, end))
    length = float(np.linalg.norm(end - wrist))
    # The shoulder goes round under the line: how far it gets from the interval's middle.
    away = float(np.hypot(*geometry.shoulder[:2])) * cells.half
    cross = np.cross(v, w)
    size = np.maximum(np.linalg.norm(cross, axis=1), 1e-12)
    axis = cross / size[:, None]
    beta = np.arctan2(size, (v * w).sum(axis=1))
    for end_rates in (one, other):
        beta -= _turn(away / np.maximum(end_rates.distance_low, 1e-12))
    # m = v × w changes by no more than |v - w| times the shoulder's way.
    tilt = 2.0 * np.sin(0.5 * _turn(length * away / size))
    near, far, passes = _distances(v, w, length, size, away, one, other)
    near = np.maximum(near, arm.reach[0])
    upper, fore = geometry.upper, geometry.fore
    alpha, sin_alpha = _variation(upper, fore, near, far, passes)
    gamma, sin_gamma = _variation(fore, upper, near, far, passes)
    # Axis 1 turns with the platform, axis 7 stands in the world.
    first = np.abs(axis @ geometry.axes[0])
    seventh = turned(R @ (geometry.R_flange.T @ geometry.axes[6]), cells.middle)
    last = np.abs((axis * seventh).sum(axis=1))
    shoulder_way = np.stack([*_shares(first, tilt + cells.half), sin_alpha])
    wrist_way = np.stack([*_shares(last, tilt), sin_gamma])
    bend = _turns_of_joint_4(upper, fore, one, other)
    return _least_time(work, bend, (beta - alpha, shoulder_way), (beta - gamma, wrist_way))


def _turn(ratio: FloatArray) -> FloatArray:
    """Returns by what angle a vector turns at most when its end moves by a share of its length [rad]."""
    return np.where(ratio < 1.0, np.arcsin(np.minimum(ratio, 1.0)), np.pi)


def _distances(
    v: FloatArray,
    w: FloatArray,
    length: float,
    size: FloatArray,
    away: FloatArray,
    one: ShapeRates,
    other: ShapeRates,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns least and greatest distance of shoulder and wrist [m], and whether the least is between the ends."""
    far = np.maximum(one.distance_high, other.distance_high)
    ends = np.minimum(one.distance_low, other.distance_low)
    # Where the foot of the shoulder's height lies along the line.
    place = -(v * (w - v)).sum(axis=1) / length
    passes = (place > -away) & (place < length + away)
    near = np.where(passes, np.minimum(size / length - away, ends), ends)
    return np.maximum(near, 1e-6), far, passes


def _variation(
    own: float, other: float, near: FloatArray, far: FloatArray, passes: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Returns how much a link's angle to the shoulder-wrist line varies at most in all [rad], and its greatest sine."""
    difference = own**2 - other**2
    stationary = np.sqrt(max(difference, 0.0))
    turns = (stationary > near) & (stationary < far)
    cosines = np.stack(
        [
            np.clip((r * r + difference) / (2.0 * own * r), -1.0, 1.0)
            for r in (near, far, np.clip(stationary, near, far))
        ]
    )
    least, most = cosines.min(axis=0), cosines.max(axis=0)
    swept = np.arccos(least) - np.arccos(most)
    straddles = (least <= 0.0) & (most >= 0.0)
    sine = np.where(straddles, 1.0, np.sqrt(1.0 - np.minimum(np.abs(least), np.abs(most)) ** 2))
    return swept * np.where(passes, 2.0, 1.0) * np.where(turns, 2.0, 1.0), sine


def _shares(along: FloatArray, tilt: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Returns how much of a unit turn about m two axes at right angles can give, the first of them known."""
    least = np.clip(along - tilt, 0.0, 1.0)
    return np.minimum(along + tilt, 1.0), np.sqrt(1.0 - least**2)


def _turns_of_joint_4(upper: float, fore: float, one: ShapeRates, other: ShapeRates) -> FloatArray:
    """Returns by how much joint 4 turns at least between the ends of the line [rad], (c,)."""

    def bend(r: FloatArray) -> FloatArray:
        return np.arccos(np.clip((r * r - upper**2 - fore**2) / (2.0 * upper * fore), -1.0, 1.0))

    low_1, high_1 = bend(one.distance_high), bend(one.distance_low)
    low_2, high_2 = bend(other.distance_high), bend(other.distance_low)
    return np.maximum(np.maximum(low_1 - high_2, low_2 - high_1), 0.0)


def _least_time(
    work: ArmWork,
    bend: FloatArray,
    shoulder: tuple[FloatArray, FloatArray],
    wrist: tuple[FloatArray, FloatArray],
) -> FloatArray:
    """Returns the least T at which joints 1 to 4, and 7 to 5, can turn far enough; less than a step of a table less."""
    step, way = work.law.reach_table
    low, high = np.zeros((2, len(bend)), dtype=np.int64)
    high += way.shape[1] - 1
    while (high - low > 1).any():
        middle = (low + high) // 2
        own = way[:, middle]
        fits = (
            (own[3] >= bend)
            & ((shoulder[1] * own[:3]).sum(axis=0) >= shoulder[0])
            & ((wrist[1] * own[:3:-1]).sum(axis=0) >= wrist[0])
        )
        high = np.where(fits, middle, high)
        low = np.where(fits, low, middle)
    return step * low.astype(np.float64)


Times = NDArray[np.float32]


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
    where yaw moves more than the last joint. An arm without an arm angle has other closed
    forms, and its platform stands still.

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
    columns = work.joints + (1 if problem.turns else 0)
    still = stop.approach == 0.0 and stop.retract == 0.0
    straight = work.last_axis_is_tools
    free_last = straight and (stop.free_yaw or len(stop.yaw) > 1) and stop.configurations is None
    if stop.configurations is not None and still:
        ends = [point_cells(stop.configurations, edges)] * 2
    elif stop.configurations is not None or (stop.free_yaw and not straight):
        ends = [free_cells(work.kinematics, edges)] * 2
    else:
        yaws = np.zeros(1) if free_last else stop.yaw
        row, zero = stops.first[[stage]], platform_positions(problem, np.zeros(1))
        poses = [
            flange_poses(problem.platform, work, stops, row, np.array([yaw]), zero) for yaw in yaws
        ]
        if isinstance(work.kinematics, SrsArm):
            parts = [_pose_cells(work, stop, pose, edges, resolution, free_last) for pose in poses]
        else:
            parts = [branch_cells(work, table, stop, pose, free_last) for pose in poses]
        ends = [Cells.joined([part[end] for part in parts]) for end in (0, 1)]
    approach, retract = (PostureBoxes.of(table, cells, columns) for cells in ends)
    return StopBoxes(approach, retract, still, stop.dwell, work.joints - 1 if free_last else None)


def _pose_cells(
    work: ArmWork,
    stop: StopTarget,
    pose: tuple[FloatArray, FloatArray, FloatArray],
    edges: FloatArray,
    resolution: Resolution,
    free_last: bool,
) -> list[Cells]:
    """Returns the cells at both outer ends of a pose's lines; its pose as of `flange_poses`, shape (1, ...)."""
    arm = work.closed_form
    R, p, z = (x[0] for x in pose)
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
                stop.untold,
            )
            lines = approach.line[a][:, None] + retract.line[r][None, :]
            least = np.maximum(moved, lines) + dwell
        parts.append((a, r, least))
        work[a] = least.min(axis=1)
    return StopWork(approach.index, len(work), parts, work)
