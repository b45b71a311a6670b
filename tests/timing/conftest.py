"""Limits and lines that the timing tests share."""

from __future__ import annotations

import numpy as np
import pytest

from dualarm_cli.model.robot import JointLimits

JOINTS = ("s", "l", "e", "u", "r", "b", "t")


@pytest.fixture
def limits() -> JointLimits:
    """An SDA10F arm: speeds of the maker, time to top speed 0.3 s, jerk ten times that a second."""
    velocity = np.radians([170.0, 170, 170, 170, 200, 200, 400])
    return JointLimits(
        JOINTS,
        np.full(7, -3.2),
        np.full(7, 3.2),
        velocity,
        velocity / 0.3,
        velocity / 0.03,
        ("assumed",) * 7,
    )


@pytest.fixture
def without_jerk(limits) -> JointLimits:
    """The same without jerk limits."""
    return JointLimits(
        JOINTS,
        limits.lower,
        limits.upper,
        limits.velocity,
        limits.acceleration,
        np.full(7, np.inf),
        limits.source,
    )


@pytest.fixture
def lines():
    """Smooth joint paths over 80 mm such as an arm has on a straight approach, and their length."""
    rng = np.random.default_rng(21)
    length = np.linspace(0.0, 0.08, 65)
    share = length[:, None] / 0.08
    paths = []
    for _ in range(6):
        a, b, c, d = rng.uniform(-1, 1, (4, 7))
        paths.append(a + 0.4 * b * share + 0.1 * c * share**2 + 0.05 * d * np.sin(3 * share))
    return paths, length


@pytest.fixture(scope="session")
def assert_motion_is_consistent():
    """The check below, as a fixture."""
    return check_motion


def check_motion(trajectory, start, goal, limits, tolerance=1e-9):
    """Integrates jerk over every interval and checks agreement, ends and limits."""
    dt = np.diff(trajectory.time)[:, None]
    q, v, a = trajectory.position, trajectory.velocity, trajectory.acceleration
    assert (dt >= 0).all()
    # Knots a nanosecond apart have become one: at 24 rad/s² that is 2.4e-8 rad/s.
    assert np.abs(v[:-1] + dt * (a[:-1] + a[1:]) / 2 - v[1:]).max() < 2.5e-8
    by_position = q[:-1] + dt * (v[:-1] + dt * (2 * a[:-1] + a[1:]) / 6)
    assert np.abs(by_position - q[1:]).max() < 1e-9
    assert np.abs(q[0] - start).max() == 0.0
    assert np.abs(q[-1] - goal).max() < 1e-12
    for rate in (v, a):
        assert np.abs(rate[[0, -1]]).max() < 1e-9
    # Between knots: 20 instants per interval.
    share = np.linspace(0, 1, 20)
    times = (trajectory.time[:-1, None] + dt * share).ravel()
    speed, strength = (np.abs(rate).max(axis=0) for rate in trajectory.at(times)[1:])
    assert (speed <= limits.velocity * (1 + tolerance)).all()
    assert (strength <= limits.acceleration * (1 + tolerance)).all()
    if np.isfinite(limits.jerk).all():
        change = np.abs(np.diff(a, axis=0))
        assert (change <= limits.jerk * dt * (1 + 1e-6) + 1e-6).all()
