"""Candidates of arms without closed forms: numeric inverse kinematics and line continuation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.geometry.elementary import TURN
from dualarm_cli.geometry.products import product
from dualarm_cli.kinematics.continuation import CONTINUATION, FlangeLines, moved_along
from dualarm_cli.kinematics.general_arm import GeneralArm, numeric_form
from dualarm_cli.kinematics.self_motion import self_motions
from dualarm_cli.postures.problem import POSTURES
from dualarm_cli.stages.plans.candidates import (
    LINE_SAMPLES,
    CandidatePostures,
    Grid,
    Nodes,
    bulges,
    flange_poses,
    platform_positions,
    thinned,
    timed_postures,
)
from dualarm_cli.stages.plans.problem import ArmDecisions, ArmWork, SequenceProblem, StopTarget


def postures(
    problem: SequenceProblem,
    arm: int,
    stage: IntArray,
    angle: FloatArray,
    candidates: ArmDecisions,
) -> CandidatePostures:
    """Compute joints and line times of candidates, like `closed_form.postures`.

    Newton's method from each candidate's own posture, then continuation along its lines; given configurations are
    taken as they are. In stages in which the arm is idle nothing is looked for.
    """
    table = problem.arms[arm].stop_table
    work, idle = problem.arms[arm], ~table.active[stage]
    if not idle.any():
        return _postures(problem, work, stage, angle, candidates)
    q, k = candidates.near.astype(np.float64), np.flatnonzero(~idle)
    poses = timed_postures(work, q[:, None], idle, np.zeros(1), np.zeros(len(stage)))
    if not len(k):
        return poses
    active = _postures(problem, work, stage[k], angle[k], candidates.take(k))
    parts = {name: np.array(values) for name, values in vars(poses).items()}
    for name, values in parts.items():
        values[k] = getattr(active, name)
    return CandidatePostures(**parts)


def _postures(
    problem: SequenceProblem,
    work: ArmWork,
    stage: IntArray,
    angle: FloatArray,
    candidates: ArmDecisions,
) -> CandidatePostures:
    table = work.stop_table
    row = table.first[stage] + candidates.target
    poses = _poses(problem, work, stage, angle, candidates)
    carried = table.carried[row]
    # What is beyond a limit is followed as well, and judged with what may be between the samples.
    near = candidates.near.astype(np.float64)
    q, ok = moved_along(_loose(work), near, *poses[:2], candidates.psi_target)
    q = np.where(carried[:, None], table.configuration[row], q)
    ok |= carried
    length = np.stack([table.approach[stage], table.retract[stage]])
    path, followed = _followed(_loose(work), length, candidates, poses, q, LINE_SAMPLES)
    if path is None:
        return timed_postures(work, q[:, None], ok, np.zeros(1), table.dwell[stage])
    both = np.moveaxis(np.concatenate([path[:0:-1, 0], path[:, 1]]), 0, 1)
    bulge = bulges(np.diff(both, axis=1))
    return timed_postures(work, both, ok & followed, bulge, table.dwell[stage])


def anchored(candidates: ArmDecisions, joints: CandidatePostures) -> ArmDecisions:
    """Make feasible candidates their own reference postures."""
    ok = joints.possible
    swing = np.where(ok, candidates.psi_target, 0.0)
    return replace(
        candidates,
        psi_target=candidates.psi_target - swing,
        psi_approach=candidates.psi_approach - swing,
        psi_retract=candidates.psi_retract - swing,
        near=np.where(ok[:, None], joints.q_target, candidates.near),
    )


def lines_hold(
    problem: SequenceProblem, arm: int, angle: FloatArray, rows: ArmDecisions
) -> BoolArray:
    """Return in which stages lines can be traced at fine resolution, shape (n,).

    Args:
        problem: the sequence.
        arm: index of the arm.
        angle: platform angle of each stage [rad], shape (n,).
        rows: what the arm does in each stage, `anchored`.
    """
    table = problem.arms[arm].stop_table
    work, holds = problem.arms[arm], np.ones(problem.stages, dtype=np.bool_)
    k = np.flatnonzero(table.active)
    rows = rows.take(k)
    poses = _poses(problem, work, k, angle[k], rows)
    length = np.stack([table.approach[k], table.retract[k]])
    general = numeric_form(work.kinematics)
    _, holds[k] = _followed(general, length, rows, poses, rows.near, POSTURES.general_dense_samples)
    return holds


def given_postures(work: ArmWork, rows: ArmDecisions, q: FloatArray) -> ArmDecisions:
    """Return candidates at given configurations (n, joints) [rad]."""
    return rows.at(q)


def grid_nodes(
    problem: SequenceProblem,
    arm: int,
    stage: int,
    grid: Grid,
    near: ArmDecisions | None = None,
) -> Nodes:
    """Compute an arm's nodes at one stop, with those around a plan if given."""
    few, spare = len(grid.angles) <= problem.settings.thorough_angles, problem.arms[arm].spare > 0
    # A platform that does not turn leaves the poses as they are: around a plan they have been looked at before.
    thorough = few and spare if problem.turns else near is None
    if near is None:
        return _grid_nodes(problem, arm, stage, grid, thorough)
    around = _nodes_around(problem, arm, stage, grid.angles, near)
    if few and not spare:
        return around
    return _together(_grid_nodes(problem, arm, stage, grid, thorough), around)


def _grid_nodes(
    problem: SequenceProblem,
    arm: int,
    stage: int,
    grid: Grid,
    thorough: bool,
) -> Nodes:
    """Compute the nodes of one arm at one stop; empty if out of reach.

    At every platform angle and yaw the postures that inverse kinematics finds, with a spare joint others along their
    self-motion, all with the whole turns that limits allow; lines count a little more than the rest-to-rest time
    of what their joints move.

    Args:
        problem: the sequence.
        arm: index of the arm.
        stage: number of the stage, in which the arm works.
        grid: how finely they are set.
        thorough: whether all branches are looked for, and sampled along all of their self-motion.
    """
    table = problem.arms[arm].stop_table
    work = problem.arms[arm]
    stop = work.stops[stage]
    assert stop is not None  # callers ask for active stages only
    general = numeric_form(work.kinematics)
    index, rows = _targets(problem, work, stage, grid, thorough)
    count = len(index)
    stages, angle = np.full(count, stage), grid.angles[index]
    poses = _poses(problem, work, stages, angle, rows)
    length = np.stack([table.approach[stages], table.retract[stages]])
    path, ok = _followed(general, length, rows, poses, rows.near, POSTURES.end_samples)
    ends = np.stack([rows.near, rows.near]) if path is None else path[-1]
    out, back = (work.law.duration(end - rows.near) for end in ends)
    time = problem.settings.line_factor * (out + back) + stop.dwell
    nodes = Nodes(index, rows, ends[0], ends[1], time, False)
    nodes = nodes.take(np.flatnonzero(ok))
    if stop.configurations is None:
        nodes = _with_turns(work, nodes, grid.most)
    return thinned(_by_angle(nodes), grid.most)


def _nodes_around(
    problem: SequenceProblem,
    arm: int,
    stage: int,
    angles: FloatArray,
    plan: ArmDecisions,
) -> Nodes:
    """Vary self-motion and drifts of a plan's stop at platform angles (f,) [rad]."""
    work = problem.arms[arm]
    stop = work.stops[stage]
    assert stop is not None  # callers ask for active stages only
    varied = work.spare > 0 and stop.configurations is None
    along, drifts = np.zeros(1), np.zeros((1, 2))
    if varied:
        along = np.array(problem.settings.general_around)
        moved = problem.settings.general_drift
        drifts = np.array([[0.0, 0.0], [-moved, 0.0], [moved, 0.0], [0.0, -moved], [0.0, moved]])
    f, s, d = (
        x.ravel()
        for x in np.meshgrid(*(np.arange(len(x)) for x in (angles, along, drifts)), indexing="ij")
    )
    rows = plan.take(np.full(len(f), stage))
    rows = replace(
        rows,
        psi_target=rows.psi_target + along[s],
        psi_approach=rows.psi_approach + along[s] + drifts[d, 0],
        psi_retract=rows.psi_retract + along[s] + drifts[d, 1],
    )
    joints = postures(problem, arm, np.full(len(f), stage), angles[f], rows)
    nodes = Nodes(
        f,
        anchored(rows, joints),
        joints.q_approach,
        joints.q_retract,
        joints.work,
        False,
    )
    return nodes.take(np.flatnonzero(joints.possible))


def _together(nodes: Nodes, others: Nodes) -> Nodes:
    """Merge two sets of nodes in order of their platform angles."""
    decisions = ArmDecisions(
        *(
            np.concatenate([x, y])
            for x, y in zip(
                vars(nodes.decisions).values(), vars(others.decisions).values(), strict=True
            )
        )
    )
    return _by_angle(
        Nodes(
            np.concatenate([nodes.angle_index, others.angle_index]),
            decisions,
            np.concatenate([nodes.q_approach, others.q_approach]),
            np.concatenate([nodes.q_retract, others.q_retract]),
            np.concatenate([nodes.work, others.work]),
            nodes.free_last,
        )
    )


def _by_angle(nodes: Nodes) -> Nodes:
    return nodes.take(np.argsort(nodes.angle_index, kind="stable"))


def _loose(work: ArmWork) -> GeneralArm:
    return numeric_form(work.kinematics).without_limits


def _poses(
    problem: SequenceProblem,
    work: ArmWork,
    stage: IntArray,
    angle: FloatArray,
    rows: ArmDecisions,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute flange rotations, positions and directions of lines of candidates at their targets."""
    table = work.stop_table
    row = table.first[stage] + rows.target
    position = platform_positions(problem, angle)
    return flange_poses(problem.platform, work, row, rows.yaw, position)


def _followed(
    general: GeneralArm,
    length: FloatArray,
    rows: ArmDecisions,
    poses: tuple[FloatArray, FloatArray, FloatArray],
    q: FloatArray,
    samples: int,
) -> tuple[FloatArray | None, BoolArray]:
    """Trace both lines outward from the targets; also flag feasible candidates.

    Args:
        general: the arm, with the limits that count.
        length: of approach and retract [m], shape (2, n).
        rows: the candidates.
        poses: theirs.
        q: joints at the targets [rad], shape (n, joints).
        samples: of each line.

    Returns:
        Joints (samples, 2, n, joints), None where no candidate has a line, and which are followed, shape (n,).
    """
    R, p, away = poses
    ok = np.asarray(general.within_limits(q))
    if not length.any():
        return None, ok
    drift = np.stack([rows.psi_approach, rows.psi_retract]) - rows.psi_target
    path = np.broadcast_to(q, (samples, 2, *q.shape)).copy()
    which, k = np.nonzero(length > 0.0)
    lines = FlangeLines(R[k], p[k], away[k, which] * length[which, k, None])
    skeleton = POSTURES.end_samples if samples == LINE_SAMPLES else CONTINUATION.skeleton
    course = general.follow_lines(q[k], lines, drift[which, k], samples, skeleton)
    path[:, which, k] = course.q
    followed = np.ones(length.shape, dtype=np.bool_)
    followed[which, k] = course.ok
    return path, ok & followed.all(axis=0)


def _targets(
    problem: SequenceProblem,
    work: ArmWork,
    stage: int,
    grid: Grid,
    thorough: bool,
) -> tuple[IntArray, ArmDecisions]:
    """Solve postures at the targets, with platform-angle indices (n,)."""
    f, stop = len(grid.angles), work.stops[stage]
    assert stop is not None  # callers ask for active stages only
    if stop.configurations is not None:
        m = len(stop.configurations)
        target = np.tile(np.arange(m), f)
        rows = _rows(work, target, np.zeros(m * f), stop.configurations[target])
        return np.repeat(np.arange(f), m), rows
    yaws, general = _yaws(stop, problem.settings.node_yaws), numeric_form(work.kinematics)
    index, yaw = np.repeat(np.arange(f), len(yaws)), np.tile(yaws, f)
    start = np.tile(work.kinematics.middle, (len(yaw), 1))
    targets = _rows(work, np.zeros(len(yaw), dtype=np.int64), yaw, start)
    R, p, _ = _poses(problem, work, np.full(len(yaw), stage), grid.angles[index], targets)
    solutions = general.postures(R, p, thorough=thorough)
    pose, q = solutions.pose, solutions.q
    most = round(problem.settings.general_node_share * grid.most)
    if work.spare == 1 and thorough:
        traced = self_motions(general, q, R[pose], p[pose])
        good = ~np.isnan(traced[..., 0])
        pose, q = np.broadcast_to(pose, good.shape)[good], traced[good]
    elif work.spare:
        wanted = most // max(1, len(pose)) - 1
        sideways = np.array(problem.settings.general_sideways[: max(0, wanted)])
        pose, q = _along_self_motion(general, R, p, pose, q, sideways)
    q = general.nearest_turns(q, work.kinematics.middle)
    order = np.argsort(pose, kind="stable")
    if len(order) > most:
        order = order[np.linspace(0, len(order) - 1, most).astype(np.int64)]
    pose, q = pose[order], q[order]
    return index[pose], _rows(work, np.zeros(len(pose), dtype=np.int64), yaw[pose], q)


def _along_self_motion(
    general: GeneralArm,
    R: FloatArray,
    p: FloatArray,
    pose: IntArray,
    q: FloatArray,
    along: FloatArray,
) -> tuple[IntArray, FloatArray]:
    """Extend postures (k, joints) by offsets (s,) along their self-motion [rad]."""
    each = np.repeat(np.arange(len(pose)), len(along))
    of = pose[each]
    moved, met = moved_along(general, q[each], R[of], p[of], np.tile(along, len(pose)))
    return np.concatenate([pose, of[met]]), np.concatenate([q, moved[met]])


def _yaws(stop: StopTarget, count: int) -> FloatArray:
    if stop.free_yaw:
        return np.linspace(-np.pi, np.pi, count, endpoint=False)
    return stop.yaw


def _rows(work: ArmWork, target: IntArray, yaw: FloatArray, q: FloatArray) -> ArmDecisions:
    """Return candidates at target joints (n, joints) [rad], without drift along lines."""
    zero = np.zeros(len(q))
    return ArmDecisions(target, yaw, _branch(work, q), zero, zero, zero, q)


def _branch(work: ArmWork, q: FloatArray) -> IntArray:
    """Encode in which half of its range every joint is, shape (n,)."""
    upper = q[:, :12] > work.kinematics.middle[:12]
    return np.asarray(product(upper, 1 << np.arange(upper.shape[1])), dtype=np.int64)


def _with_turns(work: ArmWork, nodes: Nodes, most: int) -> Nodes:
    """Add copies of nodes whole turns away, within limits.

    If there are more than `most`, every node keeps an equal number of copies, nearest to the start first.
    """
    n = len(nodes.work)
    row, shift = np.arange(n), np.zeros((n, work.joints))
    places = np.stack([nodes.q_target, nodes.q_approach, nodes.q_retract])
    for joint in sorted(set(range(work.joints)) - set(numeric_form(work.kinematics).slides)):
        # One turn in each direction is enough for joints without limits.
        low = max(work.limits.lower[joint], -1.5 * TURN)
        high = min(work.limits.upper[joint], 1.5 * TURN)
        if high - low < TURN:
            continue
        least, largest = places[:, :, joint].min(axis=0), places[:, :, joint].max(axis=0)
        rows, shifts = [row], [shift]
        for turn in (-2.0 * TURN, -TURN, TURN, 2.0 * TURN):
            inside = (least[row] + turn >= low) & (largest[row] + turn <= high)
            moved = shift[inside]
            moved[:, joint] = turn
            rows.append(row[inside])
            shifts.append(moved)
        row, shift = np.concatenate(rows), np.concatenate(shifts)
    if len(row) > most:
        away = np.abs(nodes.q_target[row] + shift - work.start).sum(axis=1)
        order = np.lexsort((away, row))
        rank = np.arange(len(row)) - np.searchsorted(row[order], row[order])
        kept = np.sort(order[rank < max(1, most // n)])
        row, shift = row[kept], shift[kept]
    copies = nodes.take(row)
    return replace(
        copies,
        decisions=copies.decisions.at(copies.q_target + shift),
        q_approach=copies.q_approach + shift,
        q_retract=copies.q_retract + shift,
    )
