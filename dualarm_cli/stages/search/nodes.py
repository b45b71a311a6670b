"""Node sets: every stop on a grid of platform angles, arm angles, branches and yaws."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.stages.search.postures import postures
from dualarm_cli.stages.search.problem import ArmDecisions, ArmWork, SequenceProblem, StopTarget
from dualarm_cli.stages.search.stops import StopTable, flange_poses, platform_positions

SWING_STEPS = 3
"""How many half steps of the arm angle a line may swing to either side."""
LINE_FACTOR = 1.08
"""Time of a line over the rest-to-rest time of its joints' displacements, roughly: joints on a line start and
stop together along a curve."""
LARGEST_TURN = 0.5 * np.pi
"""A joint that turns more than this along a line has no line that can be followed [rad]."""
FREE_YAWS = 6
"""Yaws of a node set where any will do and it changes more than the last joint."""


@dataclass(frozen=True)
class Grid:
    """How finely nodes are set."""

    angles: FloatArray
    """Platform angles [rad], shape (f,); one where it cannot be turned."""
    arm_angles: int
    """Number of arm angles around the circle."""
    most: int
    """Most nodes of one stop; more are thinned out."""


@dataclass(frozen=True)
class Nodes:
    """The nodes of one arm at one stop; n of them."""

    angle_index: IntArray
    """Index of the platform angle within the grid's, shape (n,)."""
    decisions: ArmDecisions
    """What each node means."""
    q_approach: FloatArray
    """Joints where the approach starts [rad], shape (n, 7)."""
    q_retract: FloatArray
    """Joints where the retract ends [rad], shape (n, 7)."""
    work: FloatArray
    """About how long approach, dwell and retract take [s], shape (n,)."""
    free_last: bool
    """Whether the last joint is free: any yaw will do, and it turns that joint alone."""

    def take(self, rows: IntArray) -> Nodes:
        """Returns some of the nodes."""
        return Nodes(
            self.angle_index[rows],
            self.decisions.take(rows),
            self.q_approach[rows],
            self.q_retract[rows],
            self.work[rows],
            self.free_last,
        )


def yaw_turns_last_joint(arm: ArmWork) -> bool:
    """Returns whether turning the tool about its z axis is turning the last joint: one axis, pointing alike or not."""
    geometry = arm.kinematics.geometry
    axis = geometry.R_flange.T @ geometry.axes[6]
    z_tool = arm.R_tool_flange.T[:, 2]
    if np.linalg.norm(np.cross(axis, z_tool)) > 1e-9:
        return False
    # The wrist centre and the tool centre point, seen from the flange, on one line along the axis.
    tcp = -arm.R_tool_flange.T @ arm.p_tool_flange
    between = tcp - geometry.p_flange_wrist
    return bool(np.linalg.norm(np.cross(between, axis)) < 1e-9)


def grid_nodes(
    problem: SequenceProblem, arm: int, table: StopTable, stage: int, grid: Grid
) -> Nodes:
    """Returns the nodes of one arm at one stop, none where it cannot be reached.

    At every platform angle, target arm angle, branch and yaw, the approach and the retract swing the arm angle so
    that the joints move least; lines count LINE_FACTOR times the rest-to-rest time of what their joints move.
    """
    work = problem.arms[arm]
    stop = work.stops[stage]
    assert stop is not None  # callers ask for active stages only
    if stop.configurations is not None:
        return _configuration_nodes(problem, arm, table, stage, stop, grid)
    free_last = stop.free_yaw and yaw_turns_last_joint(work)
    yaws = _yaws(stop, free_last)
    f = np.repeat(np.arange(len(grid.angles)), len(yaws))
    y = np.tile(yaws, len(grid.angles))
    row = np.full(len(f), table.first[stage])
    R, p, z = flange_poses(
        problem.platform, work, table, row, y, platform_positions(problem, grid.angles[f])
    )
    depths = np.array([0.0, stop.approach, stop.retract])
    points = p[:, None, :] - z[:, None, :] * depths[:, None]
    reachable = (work.kinematics.reach_miss(R[:, None], points) == 0.0).all(axis=1)
    f, y, R, points = f[reachable], y[reachable], R[reachable], points[reachable]
    same = stop.approach == stop.retract
    if same:
        points = points[:, :2]
    psi = np.linspace(-np.pi, np.pi, 2 * grid.arm_angles, endpoint=False)
    q = work.kinematics.solve(R[:, None, None], points[:, :, None], psi).q
    q_target = work.kinematics.nearest_turns(q[:, 0, ::2], middle_of_ranges(work))
    inside = work.kinematics.within_limits(q_target)
    if free_last:
        low, high = work.limits.lower.copy(), work.limits.upper.copy()
        low[6], high[6] = -np.inf, np.inf
        inside = np.asarray(((q_target >= low) & (q_target <= high)).all(axis=-1))
    else:
        low, high = work.limits.lower, work.limits.upper
    r, i, b = np.nonzero(inside)
    target = q_target[r, i, b]
    swing_a, q_a = _least_swing(q[:, 1], r, i, b, target, low, high, work)
    swing_r, q_r = (swing_a, q_a)
    if not same:
        swing_r, q_r = _least_swing(q[:, 2], r, i, b, target, low, high, work)
    ok = np.isfinite(q_a[:, 0]) & np.isfinite(q_r[:, 0])
    r, i, b, target = r[ok], i[ok], b[ok], target[ok]
    q_a, q_r, swing_a, swing_r = q_a[ok], q_r[ok], swing_a[ok], swing_r[ok]
    step = np.pi / grid.arm_angles
    psi_target = psi[2 * i]
    decisions = ArmDecisions(
        np.zeros(len(r), dtype=np.int64),
        y[r],
        b.astype(np.int64),
        psi_target,
        psi_target + swing_a * step,
        psi_target + swing_r * step,
        target,
    )
    lines = LINE_FACTOR * (work.law.duration(q_a - target) + work.law.duration(q_r - target))
    nodes = Nodes(f[r], decisions, q_a, q_r, lines + stop.dwell, free_last)
    return thinned(nodes, grid.most)


def _yaws(stop: StopTarget, free_last: bool) -> FloatArray:
    if free_last:
        return np.zeros(1)
    if stop.free_yaw:
        return np.linspace(-np.pi, np.pi, FREE_YAWS, endpoint=False)
    return stop.yaw


def middle_of_ranges(work: ArmWork) -> FloatArray:
    """Returns the middle of every joint's range [rad], 0 where it has none."""
    low, high = work.limits.lower, work.limits.upper
    bounded = np.isfinite(low) & np.isfinite(high)
    return np.where(
        bounded, 0.5 * (np.where(bounded, low, 0.0) + np.where(bounded, high, 0.0)), 0.0
    )


def _least_swing(
    q_end: FloatArray,
    r: IntArray,
    i: IntArray,
    b: IntArray,
    target: FloatArray,
    low: FloatArray,
    high: FloatArray,
    work: ArmWork,
) -> tuple[IntArray, FloatArray]:
    """Returns the swing (in half steps) whose joints move least, and the joints there; NaN for none."""
    count = q_end.shape[1]
    best = np.full(len(r), np.inf)
    swing = np.zeros(len(r), dtype=np.int64)
    q = np.full((len(r), 7), np.nan)
    inverse = 1.0 / work.limits.velocity
    for k in sorted(range(-SWING_STEPS, SWING_STEPS + 1), key=abs):
        end = q_end[r, (2 * i + k) % count, b]
        moved = end - target
        moved -= 2.0 * np.pi * np.round(moved / (2.0 * np.pi))
        size = np.abs(moved * inverse).max(axis=1)
        reached = target + moved
        inside = ((reached >= low) & (reached <= high)).all(axis=1)
        inside &= np.abs(moved).max(axis=1) <= LARGEST_TURN
        size = np.where(inside, size, np.inf)
        better = size < best
        best[better], swing[better], q[better] = size[better], k, reached[better]
    return swing, q


def _configuration_nodes(
    problem: SequenceProblem, arm: int, table: StopTable, stage: int, stop: StopTarget, grid: Grid
) -> Nodes:
    """Returns given configurations at every platform angle, with the best of several swings."""
    work = problem.arms[arm]
    assert stop.configurations is not None
    m = len(stop.configurations)
    step = np.pi / grid.arm_angles
    swings = step * np.arange(-SWING_STEPS, SWING_STEPS + 1)
    alternative, k_a, k_r = (
        x.ravel() for x in np.meshgrid(np.arange(m), *(np.arange(len(swings)),) * 2, indexing="ij")
    )
    q = stop.configurations[alternative]
    psi = work.kinematics.arm_angle(q)
    every = ArmDecisions(
        alternative,
        np.zeros(len(q)),
        work.kinematics.branch(q),
        psi,
        psi + swings[k_a],
        psi + swings[k_r],
        q,
    )
    stages = np.full(len(q), stage)
    angle = np.zeros(len(q))
    found = postures(problem, arm, table, stages, angle, every)
    best = []
    for k in range(m):
        rows = np.nonzero(alternative == k)[0]
        best.append(rows[int(np.argmin(found.work[rows]))])
    rows = np.array([k for k in best if found.possible[k]], dtype=np.int64)
    f = np.repeat(np.arange(len(grid.angles)), len(rows))
    rows = np.tile(rows, len(grid.angles))
    nodes = Nodes(
        f, every.take(rows), found.q_approach[rows], found.q_retract[rows], found.work[rows], False
    )
    return thinned(nodes, grid.most)


def thinned(nodes: Nodes, most: int) -> Nodes:
    """Returns at most so many nodes, spread evenly over platform angles and line times."""
    n = len(nodes.work)
    if n <= most:
        return nodes
    order = np.lexsort((nodes.work, nodes.angle_index))
    return nodes.take(np.sort(order[np.linspace(0, n - 1, most).astype(np.int64)]))
