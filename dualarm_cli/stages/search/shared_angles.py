"""Platform angles from which all arms reach their stops of a stage."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray, distinct
from dualarm_cli.kinematics.srs.arm_angle_intervals import ArmAngleIntervals
from dualarm_cli.postures.platform_reach import reachable_cells, reachable_spans
from dualarm_cli.stages.plans.candidates import (
    Grid,
    flange_poses,
    line_ends,
    platform_positions,
)
from dualarm_cli.stages.plans.problem import SequenceProblem
from dualarm_cli.stages.plans.source import grid_nodes

Interval = tuple[float, float]


def shared_intervals(problem: SequenceProblem, stage: int, around: Interval) -> list[Interval]:
    """Find the platform angles from which all arms reach their stops of a stage.

    Exact over arm angle and reach. If limits decide, every interval wider than the scan step is found, with exact ends;
    so are the intervals that two arms share, however narrow.

    Args:
        problem: the sequence; its platform turns.
        stage: its number.
        around: lowest and highest platform angle [rad].

    Returns:
        Lowest and highest angles, ascending [rad].
    """
    shared = [around]
    for a, work in enumerate(problem.arms):
        if work.stops[stage] is None:
            continue
        arm_intervals = _intervals(problem, a, stage, around)
        both = [(max(p[0], q[0]), min(p[1], q[1])) for p in shared for q in arm_intervals]
        shared = sorted((low, high) for low, high in both if low <= high)
    return shared


def stages_apart(problem: SequenceProblem) -> list[int]:
    """List the stages whose arms share no platform angle, before any search.

    All stages try the angles of a coarse scan together; the few that fail get their `shared_intervals`.

    Args:
        problem: the sequence; its arms have an arm angle.
    """
    if not problem.turns:
        return []
    start = float(problem.platform_start[0])
    around = problem.platform.around(start, *problem.platform_range)
    left = np.arange(problem.stages)
    angles = np.arange(*around, problem.platform.spacing(problem.settings.first_scan_step, *around))
    for angle in angles[np.argsort(np.abs(angles - start), kind="stable")]:
        shared = np.ones(len(left), dtype=np.bool_)
        for a, work in enumerate(problem.arms):
            stops = [work.stops[k] for k in left.tolist()]
            posed = [stop is not None and stop.configurations is None for stop in stops]
            rows = np.flatnonzero(shared & np.array(posed, dtype=np.bool_))
            shared[rows] = _reaching(problem, a, left[rows], np.full(len(rows), angle))
        left = left[~shared]
    return [k for k in left.tolist() if not shared_intervals(problem, k, around)]


def spread(intervals: Sequence[Interval], count: int) -> FloatArray:
    """Spread a number of angles over intervals, ascending [rad], shape (c,)."""
    if not intervals:
        return np.zeros(0)
    widest = sorted(intervals, key=lambda interval: interval[0] - interval[1])[:count]
    width = np.array([high - low for low, high in widest])
    spare = count - len(widest)
    shares = width / max(float(width.sum()), 1e-12)
    numbers = 1 + np.floor(spare * shares).astype(np.int64)
    return np.sort(
        np.concatenate(
            [
                low + (high - low) * (np.arange(n) + 0.5) / n
                for (low, high), n in zip(widest, numbers.tolist(), strict=True)
            ]
        )
    )


def scanned_yaws(problem: SequenceProblem, a: int, stage: int) -> FloatArray:
    """Select the yaws of a stop that are scanned [rad]; all around where yaw is free."""
    stop = problem.arms[a].stops[stage]
    assert stop is not None
    if stop.free_yaw:
        return np.linspace(-np.pi, np.pi, problem.settings.scan_yaws, endpoint=False)
    return stop.yaw


def _poses(
    problem: SequenceProblem,
    a: int,
    stage: IntArray | int,
    angles: FloatArray,
    yaw: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Compute target, approach and retract poses, (m, 1, 3, 3), (m, 3, 3).

    They are poses of the flange.
    """
    table = problem.arms[a].stop_table
    work, stages = problem.arms[a], np.broadcast_to(stage, len(angles))
    row = table.first[stages]
    R, p, away = flange_poses(problem.platform, work, row, yaw, platform_positions(problem, angles))
    length = np.stack([table.approach[stages], table.retract[stages]], axis=1)
    return R[:, None], line_ends(p, away, length)


def arm_angle_intervals(
    problem: SequenceProblem,
    a: int,
    stage: IntArray | int,
    angles: FloatArray,
    yaw: FloatArray,
) -> ArmAngleIntervals:
    """Compute feasible arm angles at target, approach and retract, arrays (m, 3, 8, k)."""
    R, points = _poses(problem, a, stage, angles, yaw)
    return problem.arms[a].closed_form.feasible_arm_angles(R, points)


def _intervals(problem: SequenceProblem, a: int, stage: int, around: Interval) -> list[Interval]:
    """Find the platform angles from which one arm reaches its stop [rad]."""
    stop = problem.arms[a].stops[stage]
    if stop is None or stop.configurations is not None:
        # Given configurations turn with the platform: reach does not depend on its angle.
        return [around]

    settings = problem.settings

    def has_nodes(angles: FloatArray) -> BoolArray:
        grid = Grid(angles, settings.scan_arm_angles, settings.every_node)
        nodes = grid_nodes(problem, a, stage, grid)
        return np.bincount(nodes.angle_index, minlength=len(angles)) > 0

    if not problem.arms[a].kinematics.has_arm_angle:
        step = problem.platform.spacing(settings.coarse_scan_step, *around)
        angles = np.append(np.arange(*around, step), around[1])
        return _runs(angles, has_nodes, settings.coarse_scan_rounds)

    def feasible(angles: FloatArray) -> BoolArray:
        return _reaching(problem, a, np.full(len(angles), stage), angles)

    yaws = scanned_yaws(problem, a, stage)
    angles = np.arange(*around, problem.platform.spacing(settings.scan_step, *around))
    arcs = _arcs(problem, a, stage, yaws, around)
    angles = distinct(np.concatenate([angles, [around[1]], *arcs]))
    return _runs(angles, feasible, settings.scan_rounds)


def _reaching(problem: SequenceProblem, a: int, stages: IntArray, angles: FloatArray) -> BoolArray:
    """Flag the stages (m,) whose stop an arm reaches at platform angles (m,) [rad]."""
    yaws = {k: scanned_yaws(problem, a, k) for k in dict.fromkeys(stages.tolist())}
    every = [yaws[k] for k in stages.tolist()]
    row = np.repeat(np.arange(len(stages)), [len(yaw) for yaw in every])
    yaw = np.concatenate(every) if every else np.zeros(0)
    intervals = arm_angle_intervals(problem, a, stages[row], angles[row], yaw)
    # On one branch all along the lines, at any yaw.
    reached = np.all(intervals.count > 0, axis=1).any(axis=1)
    return np.bincount(row[reached], minlength=len(stages)) > 0


def _arcs(
    problem: SequenceProblem,
    a: int,
    stage: int,
    yaws: FloatArray,
    around: Interval,
) -> list[FloatArray]:
    """Sample platform angles at which a stop's points are within reach [rad]."""
    R, points = _poses(problem, a, stage, np.zeros(len(yaws)), yaws)
    arm = problem.arms[a].closed_form
    angles, count = [], problem.settings.angles_in_reach
    for wrists in arm.wrist_center(R, points):
        arcs = [around]
        for wrist in wrists:
            if problem.platform.is_rail:
                reachable = reachable_spans(arm, wrist)
            else:
                cells = reachable_cells(arm, wrist, np.array(around))
                reachable = list(zip(cells.low.tolist(), cells.high.tolist(), strict=True))
            arcs = [(max(p[0], q[0]), min(p[1], q[1])) for q in reachable for p in arcs]
        angles += [np.linspace(*arc, count) for arc in arcs if arc[0] <= arc[1]]
    return angles


def _runs(
    angles: FloatArray, feasible: Callable[[FloatArray], BoolArray], rounds: int
) -> list[Interval]:
    """Refine the intervals of feasibility among ascending angles (n,)."""
    ok = feasible(angles)
    if not ok.any():
        return []
    begins = np.flatnonzero(ok & ~np.append(False, ok[:-1]))
    ends = np.flatnonzero(ok & ~np.append(ok[1:], False))
    # Between an angle that is feasible and its neighbour that is not.
    inner = np.concatenate([angles[begins], angles[ends]])
    outer = np.concatenate(
        [angles[np.maximum(begins - 1, 0)], angles[np.minimum(ends + 1, len(angles) - 1)]]
    )
    parts, rows = 32, np.arange(len(inner))
    fraction = np.arange(parts + 1) / parts
    for _ in range(rounds):
        between = inner[:, None] + fraction * (outer - inner)[:, None]
        within = feasible(between[:, 1:].ravel()).reshape(len(inner), parts)
        # The last one before the first that is not; where all are, the outer end is no end.
        last = np.where(within.all(axis=1), parts, within.argmin(axis=1))
        inner, outer = between[rows, last], between[rows, np.minimum(last + 1, parts)]
    low, high = np.split(inner, 2)
    return list(zip(low.tolist(), high.tolist(), strict=True))
