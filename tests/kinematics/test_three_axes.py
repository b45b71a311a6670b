"""Three axes that carry a point: families, places, and how far what is out of reach is missed."""

from __future__ import annotations

import numpy as np
import pytest

from dualarm_cli.kinematics.three_axes import ThreeAxes, point_miss, point_postures
from dualarm_cli.kinematics.wrist_arm import WristArm

KINDS = ("elbow", "elbow_meeting", "meeting", "parallel", "any")


@pytest.mark.parametrize("kind", KINDS)
def test_the_point_is_where_the_arm_has_it(wrist_arms, kind):
    """Against the wrist centre of the whole arm, joint 1 at zero, in the frame that carries the arm."""
    rng = np.random.default_rng(2)
    arm = WristArm.of(wrist_arms.random_arm(kind, rng).arm)
    q = rng.uniform(-3.0, 3.0, (40, 6))
    q[:, 0] = 0.0
    axes = arm.shoulder
    place = axes.place(q[:, 1:3]) @ axes.R1.T + axes.p1
    assert np.abs(place - arm.wrist_center(*arm.forward(q))).max() < 1e-12
    # Across both axes: the common normal.
    assert abs(axes.p12[2]) == 0.0
    assert abs((axes.normal * np.conj(axes.axis1)).real) < 1e-12
    assert (axes.R12.T @ axes.p12)[2] == pytest.approx(0.0, abs=1e-12)


def test_derivatives_of_the_section_are_those_of_finite_differences(wrist_arms):
    """Central differences of 1e-5 rad."""
    rng = np.random.default_rng(5)
    axes = WristArm.of(wrist_arms.random_arm("any", rng).arm).shoulder
    q = rng.uniform(-3.0, 3.0, (50, 2))
    at, slope, bend = axes.section(q)
    place = axes.place(q)
    assert np.abs(at[:, 0] - np.hypot(place[:, 0], place[:, 1])).max() < 1e-12
    assert np.abs(at[:, 1] - place[:, 2]).max() < 1e-12
    for k in range(2):
        step = 1e-5 * np.eye(2)[k]
        above, below = axes.section(q + step), axes.section(q - step)
        assert np.abs((above[0] - below[0]) / 2e-5 - slope[:, :, k]).max() < 1e-7
        assert np.abs((above[1] - below[1]) / 2e-5 - bend[:, :, :, k]).max() < 1e-6


def three(R12: np.ndarray, p12, R23: np.ndarray, p23, point) -> ThreeAxes:
    """Axes with frame 1 at the origin."""
    return ThreeAxes.of(
        np.array([np.eye(3), R12, R23]),
        np.array([np.zeros(3), p12, p23], dtype=np.float64),
        np.asarray(point, dtype=np.float64),
    )


def about_x(angle: float) -> np.ndarray:
    """A rotation about x."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def test_families_follow_from_the_axes():
    """Right angles, parallels, and what none of them has."""
    side, same, point = about_x(-np.pi / 2), np.eye(3), [0.5, 0, 0]
    assert three(side, [0.2, 0, 0], same, [0.4, 0, 0], point).family == "elbow"
    assert three(side, [0, 0, 0.3], same, [0.4, 0, 0], point).family == "elbow"
    assert three(side, [0, 0, 0.3], side, [0.4, 0, 0], point).family == "two_steps"
    assert three(same, [0.2, 0, 0], side, [0.4, 0, 0], point).family == "two_steps"
    assert three(side, [0.2, 0, 0], side, [0.4, 0.1, 0.1], point).family == "quartic"
    # Three parallel axes; a point on axis 3; axes 1 and 2 the same one; a distance of 0.1 mm that drowns in rounding.
    assert three(same, [0.2, 0, 0], same, [0.4, 0, 0], point).family is None
    assert three(side, [0.2, 0, 0], same, [0.4, 0, 0], [0, 0, 0.3]).family is None
    assert three(same, [0, 0, 0.2], side, [0.4, 0, 0], point).family is None
    assert three(side, [1e-4, 0, 0], side, [0.4, 0.1, 0.1], point).family is None


@pytest.mark.parametrize("kind", KINDS)
def test_places_out_of_reach_are_missed_by_what_dense_sampling_finds(wrist_arms, kind):
    """30 places far and near: never more than 700 x 700 postures come near, and hardly less."""
    rng = np.random.default_rng(4)
    axes = WristArm.of(wrist_arms.random_arm(kind, rng).arm).shoulder
    p = rng.uniform(-3.0, 3.0, (30, 3))
    free = np.full(2, np.inf)
    miss = point_miss(axes, p, -free, free)
    angle = np.linspace(-np.pi, np.pi, 700)
    place = axes.place(np.stack(np.meshgrid(angle, angle), axis=-1).reshape(-1, 2))
    reached = np.stack([np.hypot(place[:, 0], place[:, 1]), place[:, 2]], axis=1)
    local = (p - axes.p1) @ axes.R1
    wanted = np.stack([np.hypot(local[:, 0], local[:, 1]), local[:, 2]], axis=1)
    dense = np.array([np.hypot(*(reached - w).T).min() for w in wanted])
    assert (miss <= dense + 1e-9).all()
    assert (dense - miss).max() < 0.02
    out = ~point_postures(axes, p, np.zeros((30, 3))).reachable.any(axis=1)
    assert out.sum() >= 10
    assert (miss[out] > 1e-6).all()
    assert (miss[~out] < 1e-8).all()


def test_limits_of_both_joints_count():
    """Links of 0.4 and 0.5 m, joint 2 from 0 (ahead) to 90 deg (down), joint 3 at 0: what is up, ahead, behind.

    0.9 m above the shoulder is missed by 0.9 sqrt(2) m, from straight ahead; ahead and, joint 1 turned, behind by 0.
    """
    axes = three(about_x(-np.pi / 2), [0.0, 0, 0], np.eye(3), [0.4, 0, 0], [0.5, 0, 0])
    lower, upper = np.array([0.0, 0.0]), np.array([np.pi / 2, 1e-12])
    found = point_miss(
        axes, np.array([[0.0, 0.0, 0.9], [0.9, 0.0, 0.0], [-0.9, 0.0, 0.0]]), lower, upper
    )
    assert found == pytest.approx([0.9 * np.sqrt(2.0), 0.0, 0.0], abs=1e-9)
