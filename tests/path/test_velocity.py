"""Least norm and virtual springs: exact tools, elbows at their critical points, limits kept."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dualarm_cli.geometry.rotations import log_rotation
from dualarm_cli.kinds.path.following import NoPath, PathMotion, PathProblem
from dualarm_cli.kinds.path.following.problem import Spring
from dualarm_cli.kinds.path.following.velocity import (
    Room,
    follow_min_norm,
    follow_spring,
    follow_spring_damped,
    make_step,
    spring_gradient,
)
from dualarm_cli.kinds.path.motion import with_smooth_self_motion


def tool_errors(problem: PathProblem, motion: PathMotion) -> float:
    """The largest error of both tools at all instants [m, rad]."""
    worst = 0.0
    for k, q in enumerate(motion.position):
        R, p = problem.body.tools(q)
        turn = log_rotation(problem.R[k] @ np.swapaxes(R, -1, -2))
        worst = max(worst, float(np.abs(p - problem.p[k]).max()), float(np.abs(turn).max()))
    return worst


def elbow_distances(problem: PathProblem, motion: PathMotion) -> np.ndarray:
    """Distances of the elbows from their critical points at all instants [m], (k, 2)."""
    body = problem.body
    return np.array(
        [spring_gradient(body, body.at(q), problem.spring)[1] for q in motion.position[::10]]
    )


@pytest.fixture(scope="module")
def followed(choi):
    """The circles without springs, with them, and as printed."""
    problem = choi[1]
    found = [follow(problem) for follow in (follow_min_norm, follow_spring, follow_spring_damped)]
    assert all(isinstance(motion, PathMotion) for motion in found)
    return problem, *found


def test_tools_with_and_without_springs_are_the_same(followed) -> None:
    """[Choi2020] Fig. 6 by the exact projector: within 1e-8 m and rad of the circles, and of each other."""
    problem, plain, pulled, _ = followed
    assert tool_errors(problem, plain) < 1e-9
    assert tool_errors(problem, pulled) < 1e-9


def test_tools_stay_exact_where_joint_limits_bind(choi) -> None:
    """Limits within the range that the springs use, at three times the speed, evened out as well: within 1e-9 m."""
    context, usual = choi
    work = context.job.tasks[0].path
    problem = context.problem(work, usual.start, context.clock(work, 3.0))
    free = follow_spring(problem).position
    low, high = problem.limits.lower.copy(), problem.limits.upper.copy()
    for name in ("left_r", "right_e"):
        j = problem.limits.joints.index(name)
        start, least, most = free[0, j], free[:, j].min(), free[:, j].max()
        if most - start > start - least:
            high[j] = start + 0.6 * (most - start)
        else:
            low[j] = start - 0.6 * (start - least)
    narrow = replace(problem, limits=replace(problem.limits, lower=low, upper=high))
    motion = follow_spring(narrow)
    assert isinstance(motion, PathMotion)
    assert min((motion.position - low).min(), (high - motion.position).min()) < 1e-2
    for window in (0.0, 0.32):
        assert tool_errors(narrow, with_smooth_self_motion(narrow, motion, window)) < 1e-9


def test_the_damped_projector_disturbs_the_tools(followed) -> None:
    """I - J+ J with a damped J+ is no projector: a thousand times the error, still below a millimetre."""
    problem, _, pulled, damped = followed
    error = tool_errors(problem, damped)
    assert 1e3 * tool_errors(problem, pulled) < error < 1e-3


def test_springs_bring_elbows_at_least_half_way_to_their_least_distance(followed) -> None:
    """[Choi2020] Figs. 7-11: above the least that the arm can reach 50 % less than without, and the waist moves."""
    problem, plain, pulled, _ = followed
    body = problem.body
    shoulders, upper = body.shoulders()
    # A sphere of the upper arm's length about the shoulder: no posture is nearer than this.
    least = np.abs(np.linalg.norm(shoulders - problem.spring.points, axis=1) - upper)
    without = elbow_distances(problem, plain).mean(axis=0) - least
    within = elbow_distances(problem, pulled).mean(axis=0) - least
    assert (within > 0.0).all()
    assert (within < 0.5 * without).all()
    waist = [problem.limits.joints.index(name) for name in ("waist_yaw", "waist_pitch")]
    assert np.ptp(pulled.position[:, waist], axis=0).max() > np.deg2rad(5.0)


def test_peak_speeds_stay_within_limits(followed) -> None:
    """At the shipped stiffness no joint exceeds its speed limit, and none half of it by the springs."""
    problem, _, pulled, _ = followed
    speed = np.abs(np.diff(pulled.position, axis=0)).max(axis=0) / problem.step
    assert (speed < problem.limits.velocity).all()


def test_the_gradient_is_that_of_half_the_squared_distances(choi) -> None:
    """V = -gain grad (D_L² + D_R²) / 2 by central differences, at random postures."""
    problem = choi[1]
    body, limits = problem.body, problem.limits
    spring = replace(problem.spring, gain=3.0)

    def potential(q: np.ndarray) -> float:
        return float((spring_gradient(body, body.at(q), spring)[1] ** 2).sum()) / 2.0

    random = np.random.default_rng(0)
    for _ in range(5):
        q = random.uniform(limits.lower, limits.upper)
        slope = [(potential(q + 1e-6 * e) - potential(q - 1e-6 * e)) / 2e-6 for e in np.eye(len(q))]
        found = spring_gradient(body, body.at(q), spring)[0]
        np.testing.assert_allclose(found, -3.0 * np.array(slope), atol=1e-8)


def test_a_step_of_least_norm_is_numpys_pseudo_inverse(choi) -> None:
    """Without damping the move is J+ times the tools' way, to second order in the step."""
    problem = replace(choi[1], damping=0.0)
    step = make_step(problem, Room(problem), exact=True, pulled=False)
    q, k = np.array(problem.start), problem.instants // 2
    # From a posture on the path, one instant on.
    found = follow_min_norm(problem)
    assert isinstance(found, PathMotion)
    q = found.position[k - 1]
    state = problem.body.at(q)
    way = np.concatenate(
        [
            np.concatenate([p1 - p0, log_rotation(R1 @ R0.T)])
            for R0, p0, R1, p1 in zip(state.R, state.p, problem.R[k], problem.p[k], strict=True)
        ]
    )
    expected = np.linalg.pinv(state.J) @ way
    moved = step(q, k) - q
    np.testing.assert_allclose(moved, expected, atol=10.0 * float(np.abs(way).max()) ** 2)


def test_a_pull_into_a_limit_stops_before_it_and_moves_smoothly(choi) -> None:
    """Critical points behind the back would take an elbow past its limit: it is stopped, the tools stay exact."""
    context, problem = choi
    far = np.array([[-0.4, 0.3, 0.3], [-0.4, -0.3, 0.3]])
    pulled = replace(problem, spring=Spring(far, 200.0))
    found = follow_spring(pulled)
    assert isinstance(found, PathMotion)
    limits = context.limits
    room = np.minimum(found.position - limits.lower, limits.upper - found.position)
    assert room.min() >= 0.0
    assert room.min() < np.deg2rad(2.0), "no limit was reached: the test shows nothing"
    assert tool_errors(pulled, found) < 1e-7
    speed = np.diff(found.position, axis=0) / problem.step
    # Speeds change by a joint's braking at most, never jump: 4 per second times its speed, and a few instants' worth.
    assert np.abs(np.diff(speed, axis=0)).max() < 0.1


def test_out_of_reach_is_told_with_the_instant(choi) -> None:
    """Both tools go straight ahead by up to 2 m: beyond any arm."""
    problem = choi[1]
    away = problem.p + 2.0 * problem.share[:, None, None] * np.array([1.0, 0.0, 0.0])
    found = follow_min_norm(replace(problem, p=away))
    assert isinstance(found, NoPath)
    # The arm is 0.7 m long and the waist bends: somewhere after the first decimetre, before the last metre.
    assert 0.05 < problem.share[found.instant] < 0.6
