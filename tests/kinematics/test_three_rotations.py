"""Rotations as turns about three axes at any angles: products, Euler angles, what cannot be made."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.kinematics.platform_chain import rotation_z
from dualarm_cli.kinematics.wrist_arm import three_turns


def turned(R12, R23, q):
    """The product of the turns (..., 3)."""
    return rotation_z(q[..., 0]) @ R12 @ rotation_z(q[..., 1]) @ R23 @ rotation_z(q[..., 2])


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    """Any rotation."""
    v = rng.normal(size=3)
    return pin.exp3(rng.uniform(0.3, 2.8) * v / np.linalg.norm(v))


def test_both_ways_make_the_rotation_and_one_is_the_one_it_was_made_with():
    """20 pairs of random frames, 200 random turns each."""
    rng = np.random.default_rng(1)
    for _ in range(20):
        R12, R23 = random_rotation(rng), random_rotation(rng)
        q = rng.uniform(-np.pi, np.pi, (200, 3))
        M = turned(R12, R23, q)
        found = three_turns(R12, R23, M, np.zeros(200))
        assert found.possible.all()
        assert np.abs(turned(R12, R23, found.q) - M[:, None]).max() < 1e-12
        away = np.abs(np.angle(np.exp(1j * (found.q - q[:, None])))).max(axis=2).min(axis=1)
        assert away.max() < 1e-6


def test_right_angles_give_the_angles_of_euler():
    """Axes z, y, z: R = Rz(a) Ry(b) Rz(c) with b >= 0 is way 0, and (a + pi, -b, c + pi) way 1."""
    to_y = pin.exp3(np.array([-np.pi / 2, 0.0, 0.0]))
    M = pin.exp3(np.array([0, 0, 0.4])) @ pin.exp3(np.array([0, 1.1, 0]))
    M = M @ pin.exp3(np.array([0, 0, -0.7]))
    found = three_turns(to_y, to_y.T, M, np.array(0.0))
    assert found.q[0] == pytest.approx([0.4, 1.1, -0.7])
    assert found.q[1] == pytest.approx([0.4 - np.pi, -1.1, np.pi - 0.7])


def test_axes_at_60_and_30_deg_reach_angles_from_30_to_90_deg():
    """The outer axes of a chain at 60 and 30 deg are 30 to 90 deg apart; a rotation by more or less is impossible."""
    R12 = pin.exp3(np.array([np.radians(60.0), 0, 0]))
    R23 = pin.exp3(np.array([np.radians(30.0), 0, 0]))
    angles = np.radians([0.0, 29.0, 31.0, 89.0, 91.0, 180.0])
    M = np.array([pin.exp3(np.array([a, 0.0, 0.0])) for a in angles])
    found = three_turns(R12, R23, M, np.zeros(6))
    assert found.possible.tolist() == [False, False, True, True, False, False]
    assert np.isfinite(found.q).all()


def test_aligned_outer_axes_keep_the_first_angle_at_its_reference():
    """The identity, and half a turn about x, by axes at right angles."""
    to_y = pin.exp3(np.array([-np.pi / 2, 0.0, 0.0]))
    for M in (np.eye(3), np.diag([1.0, -1.0, -1.0])):
        found = three_turns(to_y, to_y.T, M, np.array(0.3))
        assert found.aligned
        assert found.q[:, 0] == pytest.approx([0.3, 0.3])
        assert np.abs(turned(to_y, to_y.T, found.q) - M).max() < 1e-12
