"""Rotations as arrays against scipy's, from the smallest angles to half a turn."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dualarm_cli.geometry.rotations import exp_rotation, log_rotation, skew, to_quaternion

ANGLES = {
    "tiny": 10.0 ** np.linspace(-15.0, -7.0, 200),
    "where the series end": np.linspace(0.5e-6, 2e-6, 200),
    "small": 10.0 ** np.linspace(-5.0, -1.0, 200),
    "all": np.linspace(0.1, 3.0, 500),
    "near half a turn": np.pi - 10.0 ** np.linspace(-12.0, -1.0, 200),
}


def vectors(angles, seed=1):
    """Rotation vectors of these lengths in random directions."""
    axes = np.random.default_rng(seed).normal(size=(len(angles), 3))
    return angles[:, None] * axes / np.linalg.norm(axes, axis=1, keepdims=True)


@pytest.mark.parametrize("name", ANGLES)
def test_the_exponential_is_that_of_scipy(name):
    """Every entry to rounding; off the diagonal to a share of the angle, so that small turns are not lost."""
    v = vectors(ANGLES[name])
    found = exp_rotation(v)
    expected = Rotation.from_rotvec(v).as_matrix()
    assert np.abs(found - expected).max() < 1e-15
    antisymmetric = found - np.swapaxes(found, -1, -2)
    # R - R^T = 2 sin(angle) [axis]x.
    angle = ANGLES[name]
    exact = 2.0 * (np.sin(angle) / angle)[:, None, None] * skew(v)
    allowed = np.where(angle < 1.0, 1e-9 * angle, 2e-15)[:, None, None]
    assert (np.abs(antisymmetric - exact) <= allowed).all()


@pytest.mark.parametrize("name", ANGLES)
def test_exponentials_are_rotations(name):
    """R R^T = 1 and det R = 1."""
    R = exp_rotation(vectors(ANGLES[name], seed=2))
    assert np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max() < 2e-15
    assert np.linalg.det(R) == pytest.approx(1.0, abs=2e-15)


@pytest.mark.parametrize("name", ANGLES)
def test_the_logarithm_of_scipy_s_matrices_is_the_rotation_vector(name):
    """To a share of the angle; also where the trace says nothing (half a turn) or the sine does not (none)."""
    v = vectors(ANGLES[name], seed=3)
    R = Rotation.from_rotvec(v).as_matrix()
    error = np.linalg.norm(log_rotation(R) - v, axis=1)
    assert (error / np.maximum(ANGLES[name], 1e-6)).max() < 2e-9
    assert error.max() < 1e-14


def test_the_logarithm_of_half_turns_is_half_a_turn_about_the_axis():
    """About coordinate axes, diagonals and random axes; either sign of the axis is right."""
    axes = np.concatenate(
        [np.eye(3), -np.eye(3), vectors(np.ones(100), seed=4), [[1, 1, 0] / np.sqrt(2.0)]]
    )
    # R = 2 a a^T - 1.
    R = 2.0 * axes[:, :, None] * axes[:, None, :] - np.eye(3)
    found = log_rotation(R)
    assert np.linalg.norm(found, axis=1) == pytest.approx(np.pi, abs=1e-14)
    assert np.abs((found * axes).sum(axis=1)) == pytest.approx(np.pi, abs=1e-14)


def test_no_turn_has_no_logarithm_but_zero():
    """exp(0) = 1 and log(1) = 0, exactly."""
    assert exp_rotation(np.zeros((2, 3))).tolist() == [np.eye(3).tolist()] * 2
    assert log_rotation(np.eye(3)).tolist() == [0.0, 0.0, 0.0]


def test_turns_beyond_half_a_turn_are_the_shorter_ones():
    """200 degrees about an axis are -160 about it."""
    v = np.radians(200.0) * np.array([0.6, 0.0, 0.8])
    assert log_rotation(exp_rotation(v)) == pytest.approx(
        -np.radians(160.0) * np.array([0.6, 0, 0.8]), abs=1e-14
    )


@pytest.mark.parametrize("name", ANGLES)
def test_quaternions_are_those_of_scipy(name):
    """Up to the sign, in the order x, y, z, w."""
    R = Rotation.from_rotvec(vectors(ANGLES[name], seed=5))
    found, expected = to_quaternion(R.as_matrix()), R.as_quat()
    sign = np.sign((found * expected).sum(axis=1))[:, None]
    assert np.abs(sign * found - expected).max() < 1e-15


def test_each_component_may_be_the_largest():
    """Quaternions with one large component of either sign and small others, all four rows of the matrix."""
    rng = np.random.default_rng(6)
    for k in range(4):
        quaternion = rng.normal(scale=0.05, size=(50, 4))
        quaternion[:, k] = np.sign(quaternion[:, k])
        quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
        found = to_quaternion(Rotation.from_quat(quaternion).as_matrix())
        assert np.abs(np.abs((found * quaternion).sum(axis=1)) - 1.0).max() < 1e-15
        assert (np.sign(found[:, k]) == 1.0).all()


def test_leading_dimensions_are_kept():
    """Vectors (2, 5, 3) give matrices (2, 5, 3, 3), and the other way around, entry by entry."""
    v = vectors(np.linspace(0.1, 3.0, 10)).reshape(2, 5, 3)
    R = exp_rotation(v)
    assert R.shape == (2, 5, 3, 3)
    assert R[1, 3] == pytest.approx(Rotation.from_rotvec(v[1, 3]).as_matrix(), abs=1e-15)
    assert log_rotation(R) == pytest.approx(v, abs=1e-14)


def test_skew_is_the_cross_product():
    """K u = v x u for random vectors."""
    v, u = np.random.default_rng(7).normal(size=(2, 20, 3))
    assert np.einsum("kij,kj->ki", skew(v), u) == pytest.approx(np.cross(v, u), abs=1e-15)
