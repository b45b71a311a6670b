"""Forward and closed-form inverse kinematics of spherical-revolute-spherical arms."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.kinematics.srs.arm_angle_curves import flips, reference_directions
from dualarm_cli.kinematics.srs_arm import SrsArm

EXACT = 1e-9


def random_postures(seed: int, n: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-np.pi, np.pi, (n, 7))


def circle_distance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.abs(np.mod(a - b + np.pi, 2 * np.pi) - np.pi)


def assert_same_pose(arm: SrsArm, q: np.ndarray, R: np.ndarray, p: np.ndarray) -> None:
    R_found, p_found = arm.forward(q)
    assert np.abs(R_found - R).max() < EXACT
    assert np.abs(p_found - p).max() < EXACT


def check_all_branches(arm: SrsArm, q: np.ndarray) -> None:
    R, p = arm.forward(q)
    psi = arm.arm_angle(q)
    solutions = arm.solve(R, p, psi)
    assert solutions.reachable.all()
    assert solutions.q.min() > -np.pi and solutions.q.max() <= np.pi
    assert_same_pose(arm, solutions.q, R[:, None], p[:, None])
    for a in range(8):
        for b in range(a):
            gap = circle_distance(solutions.q[:, a], solutions.q[:, b]).max(axis=-1)
            assert gap.min() > 1e-6, (a, b)


def test_forward_agrees_with_pinocchio(chain, arm):
    """An independent library on the same joint frames, 500 postures."""
    model = chain.model()
    data = model.createData()
    q = random_postures(1, 500)
    R, p = arm.forward(q)
    for k in range(len(q)):
        pin.framesForwardKinematics(model, data, q[k])
        flange = data.oMf[model.getFrameId("flange")]
        np.testing.assert_allclose(R[k], flange.rotation, atol=1e-12)
        np.testing.assert_allclose(p[k], flange.translation, atol=1e-12)


def test_its_chain_of_joints_leads_to_the_flange(chain, arm):
    """Step by step about z axes, against pinocchio: for compiled functions that take any arm."""
    model, (steps, slides) = chain.model(), arm.chain
    data, frame = model.createData(), model.getFrameId("flange")
    assert not slides.any()
    for q in random_postures(2, 50):
        T = pin.SE3.Identity()
        for step, turn in zip(steps, (*q, 0.0), strict=True):
            T = (
                T
                * pin.SE3(step[:, :3], step[:, 3])
                * pin.SE3(pin.utils.rotate("z", turn), np.zeros(3))
            )
        pin.framesForwardKinematics(model, data, q)
        np.testing.assert_allclose(T.homogeneous, data.oMf[frame].homogeneous, atol=1e-12)


@pytest.mark.parametrize(
    ("q", "left", "right"),
    [
        ((0, 0, 0, 0, 0, 0, 0), (0.1, 1.14, 1.2), (0.1, -1.14, 1.2)),
        (
            (1.75, 0.8, 0, -0.66, 0, 0, 0),
            (-0.037266, 0.572758, 0.442242),
            (-0.037266, -0.572758, 0.442242),
        ),
    ],
)
def test_forward_gives_the_published_flange_of_the_sda10f(chains, q, left, right):
    """Rows 1 and 3 of the vendor model's table, waist at 0, six digits."""
    for name, expected in (("sda10f_left", left), ("sda10f_right", right)):
        _, p = chains[name].arm().forward(np.array(q, dtype=float))
        np.testing.assert_allclose(p, expected, atol=6e-7)


def test_every_branch_reproduces_the_pose_and_all_eight_differ(arm):
    """FK∘IK on 4,000 random postures of each arm, 20,000 in all."""
    check_all_branches(arm, random_postures(2, 4_000))


@pytest.mark.slow
def test_every_branch_reproduces_one_hundred_thousand_poses(arm):
    """The same on 100,000 random postures of each arm."""
    check_all_branches(arm, random_postures(3, 100_000))


def test_solving_with_its_own_arm_angle_and_branch_returns_the_posture(arm):
    """The inverse of the inverse, on random postures away from singularities."""
    q = random_postures(4, 4_000)
    sines = np.sin(q[:, [1, 3, 5]] + arm.canonical.offset[[1, 3, 5]])
    q = q[np.abs(sines).min(axis=1) > 1e-3]
    R, p = arm.forward(q)
    psi, branch = arm.arm_angle(q), arm.branch(q)
    found, reachable = arm.solve_branch(R, p, psi, branch)
    assert reachable.all() and set(np.unique(branch)) == set(range(8))
    assert circle_distance(found, q).max() < 1e-9


def test_each_branch_recognises_itself_and_its_arm_angle(arm):
    """Branch k of `solve` is branch k, and all eight have the arm angle asked for."""
    R, p = arm.forward(random_postures(5, 1_000))
    psi = np.random.default_rng(6).uniform(-np.pi, np.pi, 1_000)
    q = arm.solve(R, p, psi).q
    np.testing.assert_array_equal(arm.branch(q), np.tile(np.arange(8), (1_000, 1)))
    away = np.abs(np.sin(q[..., 3] + arm.canonical.offset[3])) > 1e-3
    assert circle_distance(arm.arm_angle(q), psi[:, None])[away].max() < 1e-9


def test_one_branch_equals_that_branch_of_all(arm):
    """`solve_branch` with a branch per element against `solve`."""
    rng = np.random.default_rng(7)
    R, p = arm.forward(random_postures(8, 300))
    psi, branch = rng.uniform(-np.pi, np.pi, 300), rng.integers(0, 8, 300)
    one, _ = arm.solve_branch(R, p, psi, branch)
    np.testing.assert_array_equal(one, arm.solve(R, p, psi).q[np.arange(300), branch])


def test_targets_and_arm_angles_broadcast(arm):
    """Rows of targets against columns of arm angles equal one call at a time."""
    R, p = arm.forward(random_postures(9, 6))
    psi = np.linspace(-3.0, 3.0, 5)
    q = arm.solve(R[:, None], p[:, None], psi).q
    assert q.shape == (6, 5, 8, 7)
    for i in range(6):
        for j in range(5):
            np.testing.assert_allclose(arm.solve(R[i], p[i], psi[j]).q, q[i, j], atol=1e-9)
    # One rotation with many positions, as along a line.
    line = p[0] + np.linspace(0.0, 1e-3, 4)[:, None] * np.array([1.0, 0.0, 0.0])
    q_line, _ = arm.solve_branch(R[:1], line, 0.2, np.int64(3))
    assert q_line.shape == (4, 7)


def test_self_motion_keeps_the_flange_and_moves_the_elbow_on_its_circle(arm):
    """One target, 721 arm angles: same pose, elbow on its circle at the angle asked for."""
    R, p = arm.forward(np.array([0.4, 0.7, -0.3, 1.1, 0.5, 0.8, -0.2]))
    psi = np.linspace(-np.pi, np.pi, 721)
    q = arm.solve(R, p, psi).q
    assert_same_pose(arm, q, R, p)
    _, upper, _, _ = arm.canonical.chain(np.ascontiguousarray(q[:, 0]))
    w = arm.canonical.B.T @ (arm.wrist_center(R, p) - arm.geometry.shoulder)
    u = w / np.linalg.norm(w)
    r, t = reference_directions(u)
    np.testing.assert_allclose(u @ upper, u @ upper[:, 0], atol=1e-12)
    assert circle_distance(np.arctan2(t @ upper, r @ upper), psi).max() < 1e-9


def test_all_branches_hold_the_elbow_at_the_same_place(arm):
    """Elbow position from the upper arm's direction, equal over the eight branches."""
    R, p = arm.forward(random_postures(10, 50))
    q = np.ascontiguousarray(arm.solve(R, p, 0.7 * np.ones(50)).q)
    _, upper, _, _ = arm.canonical.chain(q)
    upper = upper.reshape(3, 50, 8)
    np.testing.assert_allclose(upper, np.broadcast_to(upper[:, :, :1], upper.shape), atol=1e-9)


def test_a_branch_is_continuous_along_the_arm_angle(arm):
    """Where no triple comes near its singularity, joints move by little for little."""
    R, p = arm.forward(random_postures(11, 40))
    psi = np.linspace(-np.pi, np.pi, 4_001)
    q = arm.solve(R[:, None], p[:, None], psi).q
    sines = np.abs(np.sin(q[..., [1, 5]] + arm.canonical.offset[[1, 5]])).min(axis=(1, 3))
    steps = circle_distance(q[:, 1:], q[:, :-1]).max(axis=(1, 3))
    regular = sines > 0.1
    assert regular.sum() > 20
    # |dq/dpsi| <= 1/sin of the middle joint plus 1; the step is pi / 2000.
    assert steps[regular].max() < 11.0 * np.pi / 2_000


def test_a_branch_is_continuous_along_a_line(arm):
    """A 0.1 m line in 1,000 steps on every branch at a fixed arm angle."""
    R, p = arm.forward(np.array([0.4, 0.7, -0.3, 1.1, 0.5, 0.8, -0.2]))
    towards = arm.geometry.shoulder - arm.wrist_center(R, p)
    towards /= np.linalg.norm(towards)
    line = p + np.linspace(0.0, 0.1, 1_001)[:, None] * towards
    for branch in range(8):
        q, reachable = arm.solve_branch(R, line, 0.4, np.int64(branch))
        assert reachable.all() and (arm.branch(q) == branch).all()
        assert_same_pose(arm, q, R, line)
        assert circle_distance(q[1:], q[:-1]).max() < 0.02


def test_the_reference_is_continuous_across_the_first_axis():
    """Directions within 1e-6 of +z have references within 2e-6 of x and y; all are right-handed."""
    angle = np.linspace(0.0, 2 * np.pi, 50)
    u = np.stack([1e-6 * np.cos(angle), 1e-6 * np.sin(angle), np.ones(50)])
    r, t = reference_directions(u / np.linalg.norm(u, axis=0))
    assert np.abs(r - np.array([[1.0], [0.0], [0.0]])).max() < 2e-6
    assert np.abs(t - np.array([[0.0], [1.0], [0.0]])).max() < 2e-6
    u = np.random.default_rng(12).normal(size=(3, 2_000))
    u[:, 0], u[:, 1] = (0.0, 0.0, -1.0), (1e-9, -1e-9, -1.0)
    u /= np.linalg.norm(u, axis=0)
    r, t = reference_directions(u)
    for a, b, value in ((r, r, 1.0), (r, u, 0.0), (t, u, 0.0)):
        np.testing.assert_allclose((a * b).sum(axis=0), value, atol=1e-14)
    np.testing.assert_allclose(np.cross(u, r, axis=0), t, atol=1e-14)


def test_a_fold_beyond_the_limit_of_joint_four_misses_by_its_distance(chains):
    """SDA10F at q4 = 150°, limit 135°: distances 0.72 cos(q4 / 2), by the isosceles triangle."""
    arm = chains["sda10f_left"].arm()
    q = np.zeros((2, 7))
    q[:, 3] = np.deg2rad([150.0, 134.0])
    expected = 0.72 * (np.cos(np.deg2rad(67.5)) - np.cos(np.deg2rad(75.0)))
    np.testing.assert_allclose(arm.reach_miss(*arm.forward(q)), [expected, 0.0], atol=1e-12)


def test_targets_out_of_reach_are_masked_and_zero(arm):
    """Beyond the stretched arm and inside its core, next to a target within reach."""
    q = np.zeros((1, 7))
    q[0, 3] = 1.0
    R, p = arm.forward(q)
    far = p + np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0]])
    R = np.broadcast_to(R, (2, 3, 3))
    solutions = arm.solve(R[:, None], far[:, None], np.zeros(3))
    assert solutions.reachable[0].all() and not solutions.reachable[1].any()
    assert np.abs(solutions.q[0]).max() > 0.1 and not solutions.q[1].any()
    joints, reachable = arm.solve_branch(R, far, 0.0, np.array([1, 6]))
    assert list(reachable) == [True, False] and not joints[1].any()
    d = np.linalg.norm(arm.wrist_center(R, far) - arm.geometry.shoulder, axis=-1)
    np.testing.assert_allclose(arm.reach_miss(R, far)[1], d[1] - arm.reach[1], atol=1e-12)


def test_reach_holds_over_a_dense_scan_of_joint_four(arm):
    """Least and greatest shoulder-wrist distance against 100,001 values of joint 4."""
    q4 = np.linspace(max(arm.lower[3], -np.pi), min(arm.upper[3], np.pi), 100_001)
    q = np.zeros((len(q4), 7))
    q[:, 3] = q4
    wrist = arm.wrist_center(*arm.forward(q))
    d = np.linalg.norm(wrist - arm.geometry.shoulder, axis=-1)
    np.testing.assert_allclose(arm.reach, (d.min(), d.max()), atol=1e-8)
    interior = arm.elbow_interior_angle(q4)
    a1, a2 = arm.geometry.upper, arm.geometry.fore
    # Law of cosines, with the interior angle.
    np.testing.assert_allclose(d**2, a1**2 + a2**2 - 2 * a1 * a2 * np.cos(interior), atol=1e-12)


def test_compiled_postures_are_those_of_the_curves(arm):
    """Two implementations, random targets and targets with round angles: the same joints of all branches."""
    random, grid = np.random.default_rng(31), np.deg2rad([-90.0, 0.0, 45.0])
    round_angles = np.array(np.meshgrid(*[grid] * 7)).reshape(7, -1).T
    q = np.concatenate([random.uniform(-np.pi, np.pi, (2000, 7)), round_angles])
    R, p = arm.forward(q)
    psi = random.uniform(-np.pi, np.pi, len(q))
    curves = arm.curves(R, p)
    pairs = np.array(curves.pairs(np.sin(psi), np.cos(psi)))
    found = arm.solve(R, p, psi)
    assert found.reachable.all()
    for branch in range(8):
        flip = [int(flips(joint, np.array(branch))) for joint in range(7)]
        expected = pairs[np.arange(7), flip].T
        difference = found.q[:, branch] - expected
        difference -= 2.0 * np.pi * np.round(difference / (2.0 * np.pi))
        well = np.abs(np.sin(expected[:, [1, 5]] + arm.canonical.offset[[1, 5]])).min(axis=1) > 1e-6
        assert np.abs(difference[well]).max() < 1e-9


def test_targets_of_other_types_are_the_same_targets(arm):
    """Whole numbers and single precision, as Python code may give them, against double precision."""
    q = np.array([0.1, 0.4, 0.2, 0.9, 0.3, 0.5, 0.6])
    p = arm.forward(q)[1].astype(np.float32)
    found = arm.solve(np.eye(3, dtype=np.int64), p, 0.0)
    expected = arm.solve(np.eye(3), p.astype(np.float64), 0.0)
    assert np.array_equal(found.reachable, expected.reachable)
    np.testing.assert_array_equal(found.q, expected.q)
    one = arm.feasible_arm_angles(np.eye(3, dtype=np.int64), p)
    np.testing.assert_array_equal(
        one.start, arm.feasible_arm_angles(np.eye(3), p.astype(np.float64)).start
    )
