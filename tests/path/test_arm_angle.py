"""The arm angle along a path: exact tools, no smooth change of it moves less."""

from __future__ import annotations

import numpy as np

from dualarm_cli.kinds.path.following import NoPath, PathMotion
from dualarm_cli.kinds.path.following.arm_angle import best_track, flange_poses, follow_arm_angle
from dualarm_cli.kinds.path.following.velocity import follow_min_norm

STATIONS = 61


def test_tools_are_exact_and_the_platform_stands(choi) -> None:
    """Closed forms at every instant: 1e-12; the waist does not move; joints stay within limits."""
    context, problem = choi
    found = follow_arm_angle(problem)
    assert isinstance(found, PathMotion)
    for k in range(0, problem.instants, 20):
        R, p = problem.body.tools(found.position[k])
        np.testing.assert_allclose(p, problem.p[k], atol=1e-11)
        np.testing.assert_allclose(R, problem.R[k], atol=1e-11)
    waist = context.model.platform_columns
    assert np.ptp(found.position[:, waist], axis=0).max() == 0.0
    assert (found.position >= problem.limits.lower).all()
    assert (found.position <= problem.limits.upper).all()
    np.testing.assert_allclose(found.position[0], problem.start, atol=1e-9)


def test_no_smooth_change_of_the_arm_angle_moves_less(choi) -> None:
    """The track's cost against 500 random perturbations that keep within limits, and against half the stations."""
    context, problem = choi
    at = np.round(
        np.interp(np.linspace(0, 1, STATIONS), problem.share, np.arange(problem.instants))
    ).astype(int)
    x = np.linspace(0.0, 1.0, STATIONS)
    random = np.random.default_rng(0)
    for b, arm in enumerate(context.model.arms.values()):
        R, p = flange_poses(context.model, arm, problem.start, problem.R[at, b], problem.p[at, b])
        velocity = context.limits.velocity[arm.columns]
        track = best_track(arm.kinematics, R, p, velocity)
        assert track is not None

        def cost(psi: np.ndarray, arm=arm, R=R, p=p, branch=track.branch, v=velocity) -> float:
            q = arm.kinematics.solve_branch(R, p, psi, np.array(branch))[0]
            inside = arm.kinematics.within_limits(q).all()
            moved = float((np.diff(q / v, axis=0) ** 2).sum()) * (STATIONS - 1)
            return moved if inside else np.inf

        np.testing.assert_allclose(cost(track.psi), track.cost, rtol=1e-9)
        for _ in range(500):
            waves = sum(random.normal() * np.cos(k * np.pi * x) / (1 + k) for k in range(5))
            tried = track.psi + 10.0 ** random.uniform(-3, 0) * waves
            # Where limits bind the last per mille may be left.
            assert cost(tried) > track.cost * (1.0 - 0.03)


def test_it_moves_less_than_least_norm_where_the_platform_has_to_stand(choi) -> None:
    """Over the whole path, with joints of the waist held, least norm at every instant is not least in all."""
    problem = choi[1]
    ours, local = follow_arm_angle(problem), follow_min_norm(problem)
    assert isinstance(ours, PathMotion) and isinstance(local, PathMotion)
    arms = ~problem.body.moves_carried

    def travel(motion: PathMotion) -> float:
        return float(((np.diff(motion.position[:, arms], axis=0)) ** 2).sum())

    assert travel(ours) < 1.3 * travel(local)


def test_a_path_out_of_reach_says_by_how_much(choi) -> None:
    """Tools 2 m farther ahead at the end: the wrist misses by about that less what the arm can do."""
    from dataclasses import replace

    problem = choi[1]
    away = problem.p + 2.0 * problem.share[:, None, None] * np.array([1.0, 0.0, 0.0])
    found = follow_arm_angle(replace(problem, p=away))
    assert isinstance(found, NoPath)
    assert found.reason.key == "wrist_misses"
    assert 0 < found.instant < problem.instants
