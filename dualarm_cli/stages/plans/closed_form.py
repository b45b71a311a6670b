"""Candidates of arms with closed forms: grid nodes over arm angles and branches."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from dualarm_cli.compiled import srs as compiled
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.geometry.elementary import TURN
from dualarm_cli.postures.line_following import LARGEST_STEP, SAME_POSTURE
from dualarm_cli.stages.plans.candidates import (
    LINE_SAMPLES,
    MIDDLE,
    CandidatePostures,
    Grid,
    Nodes,
    bulges,
    flange_poses,
    line_ends,
    platform_positions,
    thinned,
    timed_postures,
)
from dualarm_cli.stages.plans.problem import (
    ArmDecisions,
    ArmWork,
    SequenceProblem,
    StopTable,
    StopTarget,
)


def postures(
    problem: SequenceProblem,
    arm: int,
    stage: IntArray,
    angle: FloatArray,
    candidates: ArmDecisions,
) -> CandidatePostures:
    """Compute joints and line times of candidates.

    Exact inverse kinematics at LINE_SAMPLES samples of each line, the branch fixed and the angles unwrapped from the
    target outward; lines timed by the closed-form estimate.

    Args:
        problem: the sequence.
        arm: index of the arm.
        stage: stage of each candidate, shape (n,).
        angle: platform angle of each candidate [rad], shape (n,).
        candidates: n of them.
    """
    n, size = len(stage), 4096  # Joints of a block fit the processor's cache.
    if n <= size:
        return _postures(problem, arm, stage, angle, candidates)
    blocks = [slice(k, k + size) for k in range(0, n, size)]
    parts = [_postures(problem, arm, stage[b], angle[b], candidates.take(b)) for b in blocks]
    return CandidatePostures(
        *(
            np.concatenate([getattr(part, field.name) for part in parts])
            for field in fields(CandidatePostures)
        )
    )


def _postures(
    problem: SequenceProblem,
    arm: int,
    stage: IntArray,
    angle: FloatArray,
    candidates: ArmDecisions,
) -> CandidatePostures:
    table = problem.arms[arm].stop_table
    work, n = problem.arms[arm], len(stage)
    row = table.first[stage] + candidates.target
    position = platform_positions(problem, angle)
    R, p, away = flange_poses(problem.platform, work, row, candidates.yaw, position)
    length = np.stack([table.approach[stage], table.retract[stage]], axis=1)
    psi = np.stack([candidates.psi_target, candidates.psi_approach, candidates.psi_retract], axis=1)
    q, ok = compiled.joints_along_lines(
        work.closed_form.numbers,
        compiled.LinePair(
            (R, p, away), candidates.branch, psi, length, np.broadcast_to(candidates.near, (n, 7))
        ),
        LARGEST_STEP,
        LINE_SAMPLES,
    )
    lines = q.shape[1] > 1
    middle = MIDDLE if lines else 0
    bulge = bulges(np.diff(q, axis=1)) if lines else np.zeros((n, 1, 7))
    q, ok = _at_configurations(table, row, length, q, ok, middle)
    return timed_postures(work, q, ok, bulge, table.dwell[stage])


def _at_configurations(
    table: StopTable,
    row: IntArray,
    length: FloatArray,
    q: FloatArray,
    ok: BoolArray,
    middle: int,
) -> tuple[FloatArray, BoolArray]:
    """Replace paths and feasibility of candidates at given configurations.

    The configuration itself counts, also where a singular wrist has others for the same pose; a line must start in it.
    """
    carried = table.carried[row]
    if not carried.any():
        return q, ok
    given = np.where(carried[:, None], table.configuration[row], q[:, middle])
    turn = TURN * np.round((given - q[:, middle]) / TURN)
    q = q + turn[:, None]
    still = length.max(axis=1) == 0.0
    same = np.abs(q[:, middle] - given).max(axis=1) < SAME_POSTURE
    ok = np.where(carried, (ok & same) | still, ok)
    q[still] = given[still, None]
    q[:, middle] = given
    return q, ok


def anchored(candidates: ArmDecisions, joints: CandidatePostures) -> ArmDecisions:
    """Return candidates unchanged: closed forms need no reference posture."""
    return candidates


def lines_hold(
    problem: SequenceProblem, arm: int, angle: FloatArray, rows: ArmDecisions
) -> BoolArray:
    """Return True for all stages: closed forms follow lines exactly, shape (n,)."""
    return np.ones(problem.stages, dtype=np.bool_)


def given_postures(work: ArmWork, rows: ArmDecisions, q: FloatArray) -> ArmDecisions:
    """Return candidates with the arm angles of given configurations (n, joints) [rad]."""
    return replace(rows, psi_target=work.closed_form.arm_angle(q), near=q)


def grid_nodes(
    problem: SequenceProblem,
    arm: int,
    stage: int,
    grid: Grid,
    near: ArmDecisions | None = None,
) -> Nodes:
    """Compute the nodes of one arm at one stop; empty if out of reach.

    At every platform angle, target arm angle, branch and yaw, the approach and the retract swing the arm angle so
    that the joints move least; lines count a little more than the rest-to-rest time of what their joints move.
    """
    table = problem.arms[arm].stop_table
    work = problem.arms[arm]
    stop = work.stops[stage]
    assert stop is not None  # callers ask for active stages only
    if stop.configurations is not None:
        return _configuration_nodes(problem, arm, stage, stop, grid)
    free_last = work.frees_last_joint(stop)
    yaws = _yaws(stop, free_last, problem.settings.node_yaws)
    f = np.repeat(np.arange(len(grid.angles)), len(yaws))
    y = np.tile(yaws, len(grid.angles))
    row = np.full(len(f), table.first[stage])
    R, p, away = flange_poses(
        problem.platform, work, row, y, platform_positions(problem, grid.angles[f])
    )
    points = line_ends(p, away, np.array([stop.approach, stop.retract]))
    reachable = (work.closed_form.reach_miss(R[:, None], points) == 0.0).all(axis=1)
    f, y, R, points = f[reachable], y[reachable], R[reachable], points[reachable]
    r, i, b, swing, q = compiled.nodes(
        work.closed_form.numbers,
        R,
        points,
        compiled.ArmAngleGrid(
            grid.arm_angles,
            work.kinematics.middle,
            work.limits.velocity,
            6 if free_last else 7,
            problem.settings.swing_steps,
            0.5 * np.pi,  # A joint that turns more has no line that can be followed.
        ),
    )
    target, q_a, q_r = q[:, 0], q[:, 1], q[:, 2]
    step = np.pi / grid.arm_angles
    psi_target: FloatArray = 2.0 * step * i.astype(np.float64) - np.pi
    decisions = ArmDecisions(
        np.zeros(len(r), dtype=np.int64),
        y[r],
        b,
        psi_target,
        psi_target + swing[:, 0] * step,
        psi_target + swing[:, 1] * step,
        target,
    )
    lines = work.law.duration(q_a - target) + work.law.duration(q_r - target)
    nodes = Nodes(
        f[r], decisions, q_a, q_r, problem.settings.line_factor * lines + stop.dwell, free_last
    )
    return thinned(nodes, grid.most)


def _yaws(stop: StopTarget, free_last: bool, count: int) -> FloatArray:
    if free_last:
        return np.zeros(1)
    if stop.free_yaw:
        return np.linspace(-np.pi, np.pi, count, endpoint=False)
    return stop.yaw


def _configuration_nodes(
    problem: SequenceProblem, arm: int, stage: int, stop: StopTarget, grid: Grid
) -> Nodes:
    """Compute nodes of given configurations at every platform angle, with the best swings."""
    work = problem.arms[arm]
    assert stop.configurations is not None
    m = len(stop.configurations)
    step, max_steps = np.pi / grid.arm_angles, problem.settings.swing_steps
    swings = step * np.arange(-max_steps, max_steps + 1)
    alternative, k_a, k_r = (
        x.ravel() for x in np.meshgrid(np.arange(m), *(np.arange(len(swings)),) * 2, indexing="ij")
    )
    q = stop.configurations[alternative]
    psi = work.closed_form.arm_angle(q)
    every = ArmDecisions(
        alternative,
        np.zeros(len(q)),
        work.closed_form.branch(q),
        psi,
        psi + swings[k_a],
        psi + swings[k_r],
        q,
    )
    stages = np.full(len(q), stage)
    angle = np.zeros(len(q))
    lines = postures(problem, arm, stages, angle, every)
    best = []
    for k in range(m):
        rows = np.nonzero(alternative == k)[0]
        best.append(rows[int(np.argmin(lines.work[rows]))])
    rows = np.array([k for k in best if lines.possible[k]], dtype=np.int64)
    f = np.repeat(np.arange(len(grid.angles)), len(rows))
    rows = np.tile(rows, len(grid.angles))
    nodes = Nodes(
        f, every.take(rows), lines.q_approach[rows], lines.q_retract[rows], lines.work[rows], False
    )
    return thinned(nodes, grid.most)
