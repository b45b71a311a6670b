"""Feasible arm angles in closed form against dense scans and their own definition."""

from __future__ import annotations

import numpy as np

from dualarm_cli.kinematics.srs.arm_angle_intervals import ArmAngleIntervals
from dualarm_cli.kinematics.srs_arm import SrsArm

TURN = 2 * np.pi


def targets(arm: SrsArm, seed: int, n: int) -> tuple[np.ndarray, np.ndarray]:
    low, high = np.maximum(arm.lower, -np.pi), np.minimum(arm.upper, np.pi)
    return arm.forward(np.random.default_rng(seed).uniform(low, high, (n, 7)))


def feasible_by_scan(arm: SrsArm, R, p, psi: np.ndarray) -> np.ndarray:
    """Whether each branch (n, m, 8) has some turns of its joints within limits, by brute force."""
    q = arm.solve(R[:, None], p[:, None], psi).q
    turned = q[..., None] + TURN * np.arange(-2, 3)
    inside = (turned >= arm.lower[:, None] - 1e-9) & (turned <= arm.upper[:, None] + 1e-9)
    return inside.any(axis=-1).all(axis=-1)


def to_limits(arm: SrsArm, q: np.ndarray) -> np.ndarray:
    """Distance (...) of the joint nearest to one of its limits, whole turns apart."""
    gaps = []
    for limit in (arm.lower, arm.upper):
        finite = np.where(np.isfinite(limit), limit, 0.0)
        gap = np.abs(np.mod(q - finite + np.pi, TURN) - np.pi)
        gaps.append(np.where(np.isfinite(limit), gap, np.inf).min(axis=-1))
    return np.minimum(*gaps)


def contained(intervals: ArmAngleIntervals, psi: np.ndarray) -> np.ndarray:
    """Whether arm angles, broadcast against (...), are in an interval of each branch, shape (..., 8)."""
    turned = np.mod(np.asarray(psi)[..., None, None] - intervals.start, TURN)
    return (turned <= intervals.end - intervals.start).any(axis=-1)


def at_ends(arm: SrsArm, R, p, ends: np.ndarray) -> np.ndarray:
    """Joints (n, 8, k, 7) at interval ends (n, 8, k), NaN where there are none."""
    branch = np.arange(8)[None, :, None]
    q, _ = arm.solve_branch(
        R[:, None, None], p[:, None, None], np.where(np.isnan(ends), 0.0, ends), branch
    )
    return np.where(np.isnan(ends)[..., None], np.nan, q)


def sda10f_with(chains, **changes) -> SrsArm:
    arm = chains["sda10f_left"].arm()
    lower, upper = arm.lower.copy(), arm.upper.copy()
    for joint, (low, high) in changes.items():
        lower[int(joint[1]) - 1], upper[int(joint[1]) - 1] = low, high
    return SrsArm(arm.geometry, lower, upper)


def test_intervals_hold_exactly_the_feasible_arm_angles_of_a_scan(arm):
    """Both directions: 1,001 arm angles × 60 targets × 8 branches of each arm."""
    R, p = targets(arm, 1, 60)
    psi = np.random.default_rng(2).uniform(-np.pi, np.pi, 1_001)
    found = arm.feasible_arm_angles(R, p)
    per_target = ArmAngleIntervals(found.start[:, None], found.end[:, None], found.count[:, None])
    expected = feasible_by_scan(arm, R, p, psi)
    assert 0.005 < expected.mean() < 0.995
    np.testing.assert_array_equal(contained(per_target, psi), expected)


def test_every_interval_end_touches_a_limit(arm):
    """Random targets pass no singularity exactly, so only limits can end an interval."""
    R, p = targets(arm, 3, 400)
    found = arm.feasible_arm_angles(R, p)
    whole = np.isclose(found.end - found.start, TURN, atol=1e-12)
    for ends in (found.start, found.end):
        gap = to_limits(arm, at_ends(arm, R, p, np.where(whole, np.nan, ends)))
        assert np.isfinite(gap).sum() > 100
        assert np.nanmax(gap) < 1e-8


def test_intervals_are_ascending_apart_and_counted(arm):
    """Starts in the circle, no overlap even around it, NaN beyond the count."""
    found = arm.feasible_arm_angles(*targets(arm, 4, 300))
    used = np.arange(found.start.shape[-1]) < found.count[..., None]
    np.testing.assert_array_equal(np.isnan(found.start), ~used)
    np.testing.assert_array_equal(np.isnan(found.end), ~used)
    assert (found.end[used] > found.start[used]).all()
    assert (np.abs(found.start[used]) <= np.pi).all()
    assert not (found.start[..., 1:] < found.end[..., :-1]).any()
    length = np.where(used, found.end - found.start, 0.0).sum(axis=-1)
    assert length.max() <= TURN + 1e-12
    first, last = found.start[..., 0], np.nanmax(np.where(used, found.end, -9.0), axis=-1)
    assert not (last - TURN > first + 1e-12).any()


def test_joints_are_continuous_within_limits_along_an_interval(chains):
    """With ±180° at joints 1, 5, 7 an interval stops where a joint would have to turn back."""
    arm = chains["sda10f_left"].arm()
    R, p = targets(arm, 5, 40)
    found = arm.feasible_arm_angles(R, p)
    n, branch, k = np.nonzero(~np.isnan(found.start))
    share = np.linspace(1e-9, 1 - 1e-9, 2_001)
    psi = found.start[n, branch, k, None] * (1 - share) + found.end[n, branch, k, None] * share
    q, _ = arm.solve_branch(R[n, None], p[n, None], psi, branch[:, None])
    sines = np.abs(np.sin(q[..., [1, 5]])).min(axis=(1, 2))
    assert arm.within_limits(q).all()
    assert (sines > 0.05).sum() > 50
    # |dq/dpsi| <= 1 + 1 / 0.05, the step at most 2 pi / 2000.
    assert np.abs(np.diff(q, axis=1)).max(axis=(1, 2))[sines > 0.05].max() < 21 * TURN / 2_000


def test_without_limits_the_whole_circle_is_feasible(chains):
    """Infinite limits on every joint leave one interval from -pi to pi."""
    arm = chains["iiwa14"].arm()
    free = SrsArm(arm.geometry, np.full(7, -np.inf), np.full(7, np.inf))
    found = free.feasible_arm_angles(*targets(arm, 6, 20))
    np.testing.assert_array_equal(found.count, 1)
    np.testing.assert_array_equal(found.start[..., 0], -np.pi)
    np.testing.assert_array_equal(found.end[..., 0], np.pi)


def test_the_elbow_branch_and_reach_decide_for_all_arm_angles(chains):
    """Joint 4 limited to positive angles empties branches 4 to 7; out of reach empties all."""
    arm = sda10f_with(chains, j4=(0.1, 2.3))
    R, p = arm.forward(np.array([[0.3, 0.6, -0.2, 1.0, 0.1, 0.5, 0.2]]))
    found = arm.feasible_arm_angles(R, p)
    assert (found.count[0, 4:] == 0).all() and found.count[0, :4].any()
    assert not arm.feasible_arm_angles(R, p + 5.0).count.any()


def test_a_branch_that_passes_its_singularity_exactly_is_cut_there(chains):
    """Wrist direction at the elbow's own angle from axis 1: at one psi the upper arm is on axis 1.

    A posture with q2 = 0 and a bent elbow; joints 1 and 3 jump by half a turn where psi passes it.
    """
    arm = sda10f_with(chains, j1=(-9.0, 9.0), j3=(-9.0, 9.0), j5=(-9.0, 9.0), j7=(-9.0, 9.0))
    q = np.array([0.0, 0.0, 0.7, 1.2, 0.4, 0.9, 0.3])
    R, p = arm.forward(q)
    cut = float(arm.arm_angle(q))
    found = arm.feasible_arm_angles(R, p)
    k = int(arm.branch(q))
    ends = np.concatenate([found.start[k], found.end[k]])
    assert np.nanmin(np.abs(np.mod(ends - cut + np.pi, TURN) - np.pi)) < 1e-7
    before, after = (arm.solve_branch(R, p, cut + step, np.int64(k))[0] for step in (-1e-5, 1e-5))
    assert abs(np.mod(after[0] - before[0], TURN) - np.pi) < 1e-3
    psi = np.random.default_rng(8).uniform(-np.pi, np.pi, 2_001)
    np.testing.assert_array_equal(
        contained(found, psi), feasible_by_scan(arm, R[None], p[None], psi)[0]
    )


def test_the_stretched_arm_is_limited_by_the_joint_that_turns(chains):
    """SDA10F stretched: q1 = q5 = 0, and psi turns joint 3 one to one, within ±170° of 360°."""
    arm = chains["sda10f_left"].arm()
    found = arm.feasible_arm_angles(*arm.forward(np.zeros(7)))
    # q3 and q7 turn against each other, both one to one; ±170° of joint 3 leaves 340°.
    total = np.nansum(found.end[0] - found.start[0])
    np.testing.assert_allclose(total, np.deg2rad(340.0), atol=1e-9)
    # One piece: at psi = 0 nothing has to be passed, though shoulder and wrist are singular.
    assert found.count[0] == 1
    # Branch 1 has q5 = 180° throughout, at its limits but not passing them, and q7 half a turn on:
    # it passes ±180° once within joint 3's range and cuts that in two.
    assert found.count[1] == 2


def test_planar_targets_with_exact_coincidences_agree_with_a_scan(chains):
    """Arms in one plane with round angles: limits, singularities and seams fall together."""
    arm = chains["sda10f_left"].arm()
    grid = np.deg2rad([-90.0, 0.0, 45.0])
    q = np.array(np.meshgrid([0.0], grid, [0.0], grid, [0.0], grid, [0.0])).reshape(7, -1).T
    R, p = arm.forward(q)
    psi = np.random.default_rng(9).uniform(-np.pi, np.pi, 301)
    found = arm.feasible_arm_angles(R, p)
    per_target = ArmAngleIntervals(found.start[:, None], found.end[:, None], found.count[:, None])
    np.testing.assert_array_equal(contained(per_target, psi), feasible_by_scan(arm, R, p, psi))
