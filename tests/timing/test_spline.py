"""Cubic splines from rest to rest."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from dualarm_cli.timing.spline import clamped_spline, largest_rates, rest_to_rest_spline


def test_speed_is_largest_where_acceleration_changes_its_sign():
    """From 1 rad/s with 1 rad/s² down to -1 rad/s² in 2 s: after 1 s the speed is 1 + 1/2."""
    time = np.array([0.0, 2.0])
    v, a, j = largest_rates(time, np.array([[1.0], [1.0]]), np.array([[1.0], [-1.0]]))
    assert [v[0], a[0], j[0]] == pytest.approx([1.5, 1.0, 1.0])


def test_a_jump_of_acceleration_is_no_jerk():
    """Two knots at one time: acceleration 1 before, -3 after, constant elsewhere."""
    time = np.array([0.0, 1.0, 1.0, 1.5])
    v = np.array([[0.0], [1.0], [1.0], [-0.5]])
    a = np.array([[1.0], [1.0], [-3.0], [-3.0]])
    assert [rate[0] for rate in largest_rates(time, v, a)] == [1.0, 3.0, 0.0]


def test_splines_rest_at_both_ends_and_pass_all_but_two_knots():
    """Uneven knots: position and velocity agree with piecewise linear acceleration."""
    rng = np.random.default_rng(31)
    time = np.concatenate([[0.0], np.cumsum(rng.uniform(0.02, 0.2, 20))])
    goal = np.sin(time[:, None] * np.array([1.0, 2.0, 3.0]))
    q, v, a = rest_to_rest_spline(time, goal)
    h = np.diff(time)[:, None]
    inner = [0, *range(2, 19), 20]
    assert np.array_equal(q[inner], goal[inner])
    assert np.abs(v[:-1] + h * (a[:-1] + a[1:]) / 2 - v[1:]).max() < 1e-12
    by_position = q[:-1] + h * (v[:-1] + h * (2 * a[:-1] + a[1:]) / 6)
    assert np.abs(by_position - q[1:]).max() < 1e-12
    for rate in (v, a):
        assert np.abs(rate[[0, -1]]).max() == 0.0


@pytest.mark.parametrize("count", [3, 4, 40])
def test_a_clamped_spline_is_scipy_s(count):
    """Uneven knots, three joints, any velocities at the ends; knots and the jerk between them."""
    rng = np.random.default_rng(count)
    time = np.concatenate([[0.0], np.cumsum(rng.uniform(0.01, 0.3, count - 1))])
    position = rng.normal(size=(count, 3))
    first, last = rng.normal(size=(2, 3))
    q, v, a = clamped_spline(time, position, first, last)
    expected = CubicSpline(time, position, bc_type=((1, first), (1, last)))
    np.testing.assert_array_equal(q, position)
    np.testing.assert_allclose(v, expected(time, 1), atol=1e-9 * np.abs(v).max())
    np.testing.assert_allclose(a, expected(time, 2), atol=1e-9 * np.abs(a).max())


def test_too_few_knots_are_refused():
    """A boundary condition each: the compiled function reads its neighbours' knots without asking."""
    rate = np.zeros(2)
    for count in range(5):
        with pytest.raises(ValueError, match="too few"):
            rest_to_rest_spline(np.arange(count) * 1.0, np.zeros((count, 2)))
    for count in range(3):
        with pytest.raises(ValueError, match="too few"):
            clamped_spline(np.arange(count) * 1.0, np.zeros((count, 2)), rate, rate)
