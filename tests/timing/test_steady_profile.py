"""Steady speeds with ramps along joint paths: by finite differences, by hand, against ruckig and by invariants."""

from __future__ import annotations

import numpy as np
import pytest
import ruckig
from hypothesis import given, settings
from hypothesis import strategies as st

from dualarm_cli.model.robot import JointLimits
from dualarm_cli.timing.steady_search import (
    PathRates,
    Ramp,
    SteadyProfile,
    fastest_profile,
    profile_of_duration,
    steady_limit,
)

PLACES = 641


def limits_of(velocity, acceleration, jerk):
    """Limits of some joints, positions left open."""
    n = len(velocity)
    return JointLimits(
        tuple(f"j{k}" for k in range(n)),
        np.full(n, -np.inf),
        np.full(n, np.inf),
        np.array(velocity, dtype=float),
        np.array(acceleration, dtype=float),
        np.array(jerk, dtype=float),
        ("assumed",) * n,
    )


def waves(size, phase, straight):
    """Joints straight s + size sin(3 s + phase), as a function of the share and by their exact derivatives."""
    size, phase, straight = (np.array(part, dtype=float) for part in (size, phase, straight))

    def q(s):
        s = np.asarray(s)[:, None]
        return straight * s + size * np.sin(3.0 * s + phase)

    s = np.linspace(0.0, 1.0, PLACES)[:, None]
    rates = PathRates(
        straight + 3.0 * size * np.cos(3.0 * s + phase),
        -9.0 * size * np.sin(3.0 * s + phase),
        -27.0 * size * np.cos(3.0 * s + phase),
    )
    return q, rates


def one_joint(way):
    """A single joint that turns by a way [rad], linear in the share."""
    return PathRates(np.full((PLACES, 1), way), np.zeros((PLACES, 1)), np.zeros((PLACES, 1)))


def dense_rates(q, profile, count=20_001):
    """Largest velocities, accelerations and jerks by differences of positions, none across the edges of phases."""
    found = np.zeros((3, q(np.zeros(1)).shape[1]))
    for start, end in zip(profile.edges()[:-1], profile.edges()[1:], strict=True):
        if end - start < 1e-6:
            continue
        step = (end - start) / count
        position = q(profile.at(np.linspace(start, end, count))[0])
        # Third differences are taken over wide steps: q holds 16 digits.
        for order, stride in ((1, 10), (2, 100), (3, 1000)):
            rate = np.diff(position[::stride], order, axis=0) / (stride * step) ** order
            found[order - 1] = np.maximum(found[order - 1], np.abs(rate).max(axis=0))
    return found


PROFILES = [
    SteadyProfile(0.5, Ramp(0.8, 0.3), Ramp(0.4, 0.2)),
    SteadyProfile(2.0, Ramp(0.5, 0.25), Ramp(0.5, 0.0)),
    SteadyProfile(0.1, Ramp(0.3, 0.0), Ramp(0.2, 0.0)),
]


@pytest.mark.parametrize("profile", PROFILES)
def test_share_speed_and_acceleration_belong_together(profile):
    """Central differences of share and speed, away from where the acceleration jumps."""
    h = 1e-6
    time = np.linspace(2 * h, profile.duration - 2 * h, 4001)
    edges = profile.edges()
    time = time[np.abs(time[:, None] - edges).min(axis=1) > 2 * h]
    before, after = profile.at(time - h), profile.at(time + h)
    _, speed, acceleration = profile.at(time)
    np.testing.assert_allclose((after[0] - before[0]) / (2 * h), speed, atol=2e-9 / h * 1e-2)
    np.testing.assert_allclose((after[1] - before[1]) / (2 * h), acceleration, atol=2e-9)


@pytest.mark.parametrize("profile", PROFILES)
def test_it_goes_from_rest_to_rest_over_the_whole_path(profile):
    """Shares 0 and 1 at the ends, no speed there; the speed never above the steady one, the share never falling."""
    share, speed, _ = profile.at(np.array([0.0, profile.duration]))
    np.testing.assert_allclose(share, [0.0, 1.0], atol=1e-15)
    np.testing.assert_allclose(speed, 0.0, atol=1e-15)
    share, speed, _ = profile.at(np.linspace(0.0, profile.duration, 5001))
    assert (np.diff(share) >= -1e-15).all()
    assert speed.max() <= profile.speed * (1.0 + 1e-12)


def test_the_duration_is_the_steady_time_and_half_of_each_ramp():
    """1 / 0.5 + (0.8 + 0.4) / 2 = 2.6 s; and it is what an integral of the speed says."""
    profile = PROFILES[0]
    assert profile.duration == pytest.approx(2.6)
    time = np.linspace(0.0, 2.6, 200_001)
    assert np.trapezoid(profile.at(time)[1], time) == pytest.approx(1.0, abs=1e-9)
    np.testing.assert_allclose(profile.edges(), [0, 0.3, 0.5, 0.8, 2.2, 2.4, 2.4, 2.6])


def test_a_trapezoid_by_hand():
    """1 rad at 1 rad/s with 4 rad/s²: ramps of 0.25 s, 1.25 s; the margins on both are 0.995 and 0.985."""
    limits = limits_of([1.0], [4.0], [np.inf])
    found = fastest_profile(one_joint(1.0), limits, np.inf, trapezoid=True)
    assert found.start.jerk_time == found.end.jerk_time == 0.0
    by_hand = 1.0 / 0.995 + 0.995 / (4.0 * 0.985)
    assert by_hand <= found.duration * (1.0 + 1e-12)
    assert found.duration <= 1.01 * by_hand
    # 0.04 rad never get to 1 rad/s: 2 sqrt(0.04 / 4) = 0.2 s.
    short = fastest_profile(one_joint(0.04), limits, np.inf, trapezoid=True)
    by_hand = 2.0 * np.sqrt(0.04 / (4.0 * 0.985))
    assert by_hand <= short.duration * (1.0 + 1e-12)
    assert short.duration <= 1.02 * by_hand


@pytest.mark.parametrize("way", [1e-3, 0.03, 0.3, 2.0])
def test_one_joint_is_never_faster_than_ruckig_and_hardly_slower(way):
    """Three limits of an SDA10F joint; the margins on them and the grids cost a few percent."""
    limits = limits_of([2.97], [9.9], [99.0])
    problem = ruckig.InputParameter(1)
    problem.current_position, problem.target_position = [0.0], [way]
    problem.max_velocity, problem.max_acceleration, problem.max_jerk = [2.97], [9.9], [99.0]
    best = ruckig.Trajectory(1)
    ruckig.Ruckig(1).calculate(problem, best)
    found = fastest_profile(one_joint(way), limits, np.inf)
    assert best.duration <= found.duration <= 1.05 * best.duration


rates = st.floats(0.1, 10.0)


@settings(max_examples=25, deadline=None)
@given(
    size=st.lists(st.floats(-0.5, 0.5), min_size=3, max_size=3),
    phase=st.lists(st.floats(0.0, 6.0), min_size=3, max_size=3),
    straight=st.lists(st.floats(-2.0, 2.0), min_size=3, max_size=3),
    limit=st.lists(rates, min_size=3, max_size=3),
    jerk=st.booleans(),
    share=st.floats(0.05, 3.0),
)
def test_every_limit_is_kept_on_any_path(size, phase, straight, limit, jerk, share):
    """Sines with a slope under random limits, half of them without jerk limits, looked at densely."""
    q, path = waves(size, phase, straight)
    velocity = np.array(limit)
    limits = limits_of(velocity, 5.0 * velocity, 50.0 * velocity if jerk else np.full(3, np.inf))
    asked = share * steady_limit(path, limits).speed
    found = fastest_profile(path, limits, asked, trapezoid=not jerk)
    assert found is not None
    assert found.speed <= asked
    measured = dense_rates(q, found)
    assert (measured[0] <= limits.velocity * (1.0 + 1e-9)).all()
    assert (measured[1] <= limits.acceleration * (1.0 + 1e-6)).all()
    assert (measured[2] <= limits.jerk * (1.0 + 1e-3)).all()


def test_limits_are_kept_on_short_waves_in_ramps_too():
    """Forty waves, of which each phase of a ramp covers several: limits by differences of positions."""
    phase = np.array([0.3, 1.1])
    k, size = 2.0 * np.pi * 40.0, np.array([2e-4, 1e-4])

    def q(s):
        s = np.asarray(s)[:, None]
        return s * [1.0, -0.5] + size * np.sin(k * s + phase)

    s = np.linspace(0.0, 1.0, 16 * 40 + 1)[:, None]
    rates = PathRates(
        [1.0, -0.5] + k * size * np.cos(k * s + phase),
        -(k**2) * size * np.sin(k * s + phase),
        -(k**3) * size * np.cos(k * s + phase),
    )
    limits = limits_of([2.0, 2.0], [6.0, 6.0], [120.0, 120.0])
    found = fastest_profile(rates, limits, np.inf)
    velocity, acceleration, jerk = dense_rates(q, found)
    assert (velocity <= limits.velocity).all()
    assert (acceleration <= limits.acceleration).all()
    assert (jerk <= limits.jerk).all()


@pytest.mark.parametrize("share", [0.01, 0.3, 0.7])
def test_a_speed_that_can_be_kept_is_kept_exactly(share):
    """Not by a rounding less, however slow."""
    _, path = waves([0.2, -0.3], [0.0, 1.0], [1.0, 0.5])
    limits = limits_of([2.0, 2.0], [10.0, 10.0], [100.0, 100.0])
    asked = share * steady_limit(path, limits).speed
    assert fastest_profile(path, limits, asked).speed == asked


def test_the_steady_limit_names_the_joint_the_rate_and_the_place():
    """For 0.1 sin(8 s) it is 6.4 rad where 8 s = pi/2; 1 rad/s² allow 1/sqrt(6.4) of speed."""
    s = np.linspace(0.0, 1.0, PLACES)[:, None]
    zero = np.zeros_like(s)
    path = PathRates(
        np.hstack([zero, 0.8 * np.cos(8 * s)]),
        np.hstack([zero, -6.4 * np.sin(8 * s)]),
        np.hstack([zero, -51.2 * np.cos(8 * s)]),
    )
    limits = limits_of([9.0, 9.0], [1.0, 1.0], [np.inf, np.inf])
    found = steady_limit(path, limits)
    assert (found.joint, found.kind) == ("j1", "acceleration")
    # |sin| is 1 at pi/16 and at 3 pi/16.
    assert min(abs(found.share - np.pi / 16), abs(found.share - 3 * np.pi / 16)) < 1e-3
    assert found.speed == pytest.approx(np.sqrt(0.985 / 6.4), rel=1e-5)


def test_the_file_s_acceleration_is_kept_and_used():
    """0.5 1/s² to 0.25 1/s: no ramp below 0.5 s, of a trapezoid hardly more."""
    limits = limits_of([10.0], [100.0], [np.inf])
    found = fastest_profile(one_joint(1.0), limits, 0.25, 0.5, trapezoid=True)
    assert found.speed == 0.25
    for ramp in (found.start, found.end):
        assert 0.5 * (1.0 - 1e-9) <= ramp.time <= 0.5 * 1.02
    smooth = fastest_profile(one_joint(1.0), limits, 0.25, 0.5)
    assert np.abs(smooth.at(np.linspace(0, smooth.duration, 9001))[2]).max() <= 0.5 * (1 + 1e-9)


@pytest.mark.parametrize("pace", [0.01, 0.2])
def test_slow_jobs_find_their_ramps(pace):
    """Limits scaled by pace, pace², pace³: everything takes 1/pace times as long, to within the grid of ramps."""
    _, path = waves([0.2, -0.3], [0.0, 1.0], [1.0, 0.5])
    full = limits_of([2.0, 2.0], [10.0, 10.0], [100.0, 100.0])
    asked = 0.5 * steady_limit(path, full).speed
    quick = fastest_profile(path, full, asked)
    slow = fastest_profile(path, full.scaled(pace), pace * asked)
    assert slow.speed == pace * asked
    assert slow.duration * pace == pytest.approx(quick.duration, rel=0.02)


def test_joints_that_do_not_move_allow_any_speed_the_ramps_can_come_to():
    """A path along which nothing moves; as fast as asked, or in a hundredth of a second or two if nothing is asked."""
    path = PathRates(*(np.zeros((PLACES, 2)) for _ in range(3)))
    limits = limits_of([1.0, 1.0], [1.0, 1.0], [1.0, 1.0])
    assert fastest_profile(path, limits, 3.0).speed == 3.0
    assert fastest_profile(path, limits, np.inf).duration < 0.03
    assert profile_of_duration(path, limits, 0.7).duration == pytest.approx(0.7, rel=1e-12)


@pytest.mark.parametrize("trapezoid", [False, True])
def test_a_given_duration_is_met_exactly_and_keeps_the_limits(trapezoid):
    """From roomy to hardly possible; below the shortest time there is none."""
    q, path = waves([0.2, -0.3], [0.0, 1.0], [1.0, 0.5])
    jerk = np.inf if trapezoid else 100.0
    limits = limits_of([2.0, 2.0], [10.0, 10.0], [jerk, jerk])
    shortest = fastest_profile(path, limits, np.inf, trapezoid=trapezoid).duration
    for factor in (1.1, 1.5, 4.0, 30.0):
        found = profile_of_duration(path, limits, factor * shortest, trapezoid=trapezoid)
        assert found.duration == pytest.approx(factor * shortest, rel=1e-12)
        measured = dense_rates(q, found)
        assert (measured[0] <= limits.velocity).all()
        assert (measured[1] <= limits.acceleration * (1.0 + 1e-6)).all()
        assert (measured[2] <= limits.jerk * (1.0 + 1e-3)).all()
    assert profile_of_duration(path, limits, 0.9 * shortest, trapezoid=trapezoid) is None


def test_ramps_of_both_ends_follow_what_the_joints_do_there():
    """One joint that moves ever faster along the path: the ramp at its end is the longer one; mirrored if turned."""
    s = np.linspace(0.0, 1.0, PLACES)[:, None]
    path = PathRates(0.2 + 2.0 * s, np.full_like(s, 2.0), np.zeros_like(s))
    limits = limits_of([5.0], [5.0], [50.0])
    asked = 0.8
    forth, back = (fastest_profile(one, limits, asked) for one in (path, path.backwards()))
    assert forth.end.time > 1.5 * forth.start.time
    assert (forth.start, forth.end) == (back.end, back.start)
