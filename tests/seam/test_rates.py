"""How fast a seam can be at a steady speed, against the derivatives of sines."""

from __future__ import annotations

import numpy as np
import pytest

from dualarm_cli.kinds.seam.closed_chain.posture_paths import steady_time, steady_times


def test_a_sine_s_rates_by_hand(cells):
    """For a sine of size A and w = 2 pi: A w / v, sqrt(A w² / a), (A w³ / j)^(1/3); differences are a little less."""
    limits = cells["sda10f"].robot.limits
    A, w, joint = 0.4, 2.0 * np.pi, 3
    q = np.zeros((401, len(limits.joints)))
    q[:, joint] = A * np.sin(w * np.linspace(0.0, 1.0, 401))
    v, a, j = (part[joint] for part in (limits.velocity, limits.acceleration, limits.jerk))
    expected = [A * w / v, np.sqrt(A * w**2 / a), np.cbrt(A * w**3 / j)]
    found = steady_times(q, limits)
    np.testing.assert_allclose(found, expected, rtol=1e-3)
    assert (found <= expected).all()
    assert steady_time(q, limits) == found.max()


def test_the_slowest_joint_decides_and_many_ways_are_judged_at_once(cells):
    """Two joints, linear in the share: the way over the speed limit; the other rates take no time."""
    limits = cells["sda10f"].robot.limits
    share = np.linspace(0.0, 1.0, 41)
    ways = np.zeros((2, 41, len(limits.joints)))
    ways[0, :, 1], ways[0, :, 7] = 0.5 * share, -0.7 * share
    ways[1] = 3.0 * ways[0]
    expected = max(0.5 / limits.velocity[1], 0.7 / limits.velocity[7])
    found = steady_times(ways, limits)
    np.testing.assert_allclose(found[:, 0], [expected, 3.0 * expected], rtol=1e-9)
    # What rounding leaves of the second and third differences.
    assert found[:, 1:].max() < 0.02 * expected


def test_slower_limits_take_longer_in_proportion(cells):
    """Limits scaled to half speed: exactly twice the time."""
    limits = cells["sda10f"].robot.limits
    q = np.cumsum(np.random.default_rng(0).normal(size=(41, 15)), axis=0)
    np.testing.assert_allclose(
        steady_times(q, limits.scaled(0.5)), 2.0 * steady_times(q, limits), rtol=1e-12
    )
    assert steady_time(q[::-1], limits) == pytest.approx(steady_time(q, limits), rel=1e-12)
