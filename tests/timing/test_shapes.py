"""Normalised double-S shapes."""

from __future__ import annotations

import numpy as np
import pytest

from dualarm_cli.timing.shapes import Shapes, symmetric_grid


def random_shapes(count=200):
    """Shapes of all kinds, some without a cruise or without constant acceleration."""
    rng = np.random.default_rng(5)
    start = rng.uniform(0.02, 0.9, count)
    end = rng.uniform(0.02, 1.0, count) * (1 - start)
    end[::5] = 1 - start[::5]
    jerks = rng.uniform(0.02, 0.5, (4, count))
    jerks[1::2, ::3] = 1.0 - jerks[::2, ::3]
    return Shapes(start, *jerks[:2], end, *jerks[2:])


def test_each_rate_is_the_integral_of_the_next():
    """Jerk is constant in a phase, so Taylor's series from each phase's start meets the next one's."""
    shapes = random_shapes()
    s, v, a, j = shapes.phases()
    dt = np.diff(shapes.breakpoints(), axis=1)
    after = (s + dt * (v + dt * (a / 2 + dt * j / 6)), v + dt * (a + dt * j / 2), a + dt * j)
    for rate, integral, end in zip((s, v, a), after, (1.0, 0.0, 0.0), strict=True):
        # Accelerations of short ramps are large: compare with the largest.
        scale = np.maximum(1.0, np.abs(rate).max(axis=1, keepdims=True))
        assert (np.abs(integral[:, :-1] - rate[:, 1:]) / scale).max() < 1e-12
        assert (np.abs(integral[:, -1:] - end) / scale).max() < 1e-12


def test_instants_within_phases_begin_and_end_with_them():
    """Three instants in each: at its start, in its middle by Taylor's series from there, at the start of the next."""
    shapes = random_shapes()
    half = np.diff(shapes.breakpoints(), axis=1) / 2.0
    s, v, a, j = shapes.phases()
    middle = (s + half * (v + half * (a / 2 + half * j / 6)), v + half * (a + half * j / 2))
    found = [rate.reshape(-1, 7, 3) for rate in shapes.within_phases(3)[:2]]
    for rate, expected, start in zip(found, middle, (s, v), strict=True):
        np.testing.assert_allclose(rate[:, :, 1], expected, atol=1e-12)
        np.testing.assert_array_equal(rate[:, :, 0], start)
        np.testing.assert_allclose(rate[:, :-1, 2], start[:, 1:], atol=1e-12)
    assert np.abs(found[0][:, -1, 2] - 1.0).max() < 1e-12
    assert np.abs(found[1][:, [0, -1], [0, 2]]).max() < 1e-12


def test_the_symmetric_shape_is_the_one_by_hand():
    """Ramp 1/3, jerk share 1/2: peak 1 / (1 - 1/3) = 1.5; acceleration 1.5 / (1/3 - 1/6) = 9."""
    shape = symmetric_grid(np.array([1 / 3]), np.array([0.5]))
    _, speed, acceleration, _ = shape.within_phases(2)
    # The first jerk phase ends after a sixth of the time; the fourth phase has the peak speed.
    assert acceleration[0, 1] == pytest.approx(9.0)
    assert [speed[0, 1], speed[0, 6]] == pytest.approx([0.75, 1.5])


def test_unequal_jerk_phases_are_those_by_hand():
    """Ramps of 1/2 with jerk phases of 1/8 and 3/8 reach the speed 1 with 1 / (1/2 - 1/4) = 4.

    They cover 4/8²/6 = 1/96 and 3/8 - 4 (3/8)²/6 = 27/96 each: 7/12 together, so all rates are 12/7 as high.
    """
    half, first, second = np.array([0.5]), np.array([0.25]), np.array([0.75])
    shape = Shapes(half, first, second, half, first, second)
    progress, speed, acceleration, jerk = shape.phases()[:, 0]
    assert progress[[1, 2, 3]] == pytest.approx([1 / 56, 1 / 56, 0.5])
    assert speed[[1, 3, 6]] == pytest.approx(np.array([0.25, 1.0, 0.25]) * 12 / 7)
    assert acceleration[[1, 6]] == pytest.approx([48 / 7, -48 / 7])
    assert jerk[[0, 2, 4, 6]] == pytest.approx(np.array([32, -32 / 3, -32 / 3, 32]) * 12 / 7)
