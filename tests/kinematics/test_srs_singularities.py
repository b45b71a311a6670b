"""Postures at and near the singularities of shoulder, elbow and wrist."""

from __future__ import annotations

import numpy as np
import pytest

from dualarm_cli.kinematics.srs.arm_angle_curves import ArmPlane
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


@pytest.mark.parametrize("size", [0.0, 1e-16, 1e-12, 1e-10, 1e-8, 1e-6, 1e-4])
@pytest.mark.parametrize("joints", [(1,), (3,), (5,), (1, 5), (1, 3), (3, 5), (1, 3, 5)])
def test_singular_and_nearly_singular_postures_are_reproduced(arm, joints, size):
    """Shoulder, elbow, wrist at or near their singular positions, alone and together."""
    q = random_postures(13, 40)
    for joint in joints:
        q[:, joint] = size - arm.canonical.offset[joint]
        if joint != 3:
            q[::2, joint] += np.pi
    R, p = arm.forward(q)
    for psi in (arm.arm_angle(q), np.linspace(-np.pi, np.pi, 40)):
        solutions = arm.solve(R, p, psi)
        assert solutions.reachable.all() and np.isfinite(solutions.q).all()
        assert_same_pose(arm, solutions.q, R[:, None], p[:, None])


def test_single_singular_poses_are_solved_without_any_batch(arm):
    """No leading axes at all, the zero of each triple in turn; one branch and all eight."""
    for joint in (1, 3, 5):
        q = random_postures(15, 1)[0]
        q[joint] = -arm.canonical.offset[joint]
        R, p = arm.forward(q)
        psi = arm.arm_angle(q)
        solutions = arm.solve(R, p, psi)
        assert solutions.q.shape == (8, 7) and solutions.reachable.shape == ()
        assert_same_pose(arm, solutions.q, R, p)
        one, reachable = arm.solve_branch(R, p, psi, arm.branch(q))
        assert one.shape == (7,) and reachable
        assert_same_pose(arm, one, R, p)


def test_a_folded_arm_and_a_wrist_behind_the_shoulder_are_reproduced(arm):
    """theta4 = pi (the wrist in the shoulder, where links are equal) and the wrist at -z."""
    q = random_postures(14, 40)
    q[:20, 3] = np.pi - arm.canonical.offset[3]
    q[20:, 3] = -arm.canonical.offset[3]
    q[20:, 1] = np.pi - arm.canonical.offset[1]
    R, p = arm.forward(q)
    solutions = arm.solve(R, p, np.linspace(-3.0, 3.0, 40))
    assert solutions.reachable.all()
    assert_same_pose(arm, solutions.q, R[:, None], p[:, None])


def test_singular_triples_leave_their_turn_to_the_outer_joint(chains):
    """The stretched SDA10F: joints 1 and 5 stay 0, its motion is steady in psi."""
    arm = chains["sda10f_left"].arm()
    R, p = arm.forward(np.zeros(7))
    q = arm.solve(R, p, np.linspace(-3.0, 3.0, 61)).q[:, 0]
    np.testing.assert_allclose(q[:, [0, 1, 3, 4, 5]], 0.0, atol=1e-12)
    assert circle_distance(q[1:], q[:-1]).max() < 0.1 + 1e-9


def test_a_stretched_arm_stays_stretched_under_rounding(chains):
    """4e-16 m short of the reach is the stretched arm, not 5e-8 rad of bend."""
    arm = chains["sda10f_left"].arm()
    R, p = arm.forward(np.zeros(7))
    towards = arm.geometry.shoulder - p
    nearer = p + 4e-16 * towards / np.linalg.norm(towards)
    q = arm.solve(R, nearer, np.linspace(-3.0, 3.0, 61)).q[:, 0]
    np.testing.assert_allclose(q[:, [0, 1, 3, 4, 5]], 0.0, atol=1e-12)


def test_a_wrist_exactly_in_the_shoulder_has_a_plane():
    """W = 0 with equal links: the first axis stands in for the undefined direction."""
    plane = ArmPlane.of(np.zeros((3, 1)), np.eye(3)[..., None], 0.3, 0.3)
    np.testing.assert_array_equal(plane.u[:, 0], [0.0, 0.0, 1.0])
    np.testing.assert_allclose(plane.bend, np.pi)
    # Upper arm and forearm cancel: their components along u and h are opposite.
    np.testing.assert_allclose(
        [plane.cos_a + plane.cos_f, plane.sin_a - plane.sin_f], 0, atol=1e-15
    )


def test_half_turns_are_positive(chains):
    """sin(-pi) is -1.2e-16, and atan2(-1.2e-16, -1) is -pi: joints of the stretched arm are pi."""
    for name in ("sda10f_left", "sda10f_right", "iiwa14"):
        arm = chains[name].arm()
        q = arm.solve(*arm.forward(np.zeros(7)), np.array([-np.pi, 0.0, np.pi])).q
        assert q.min() > -np.pi and (q == np.pi).sum() > 3
        # Bent in one plane: outer joints are 0 or half a turn, with rounding of either sign.
        grid = np.array([-1.2, -0.9, -0.4, 0.3, 0.8, 1.1])
        bent = np.zeros((216, 7))
        bent[:, [1, 3, 5]] = np.array(np.meshgrid(grid, grid, grid)).reshape(3, -1).T
        R, p = arm.forward(bent)
        assert arm.solve(R, p, arm.arm_angle(bent)).q.min() > -np.pi
