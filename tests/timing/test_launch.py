"""Lines whose far end is passed in motion: limits, ends, the path, and hand arithmetic."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from dualarm_cli.compiled.trajectories import cubic_spline
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.timing.launch import (
    CUTS,
    PROFILES,
    Launch,
    launches,
    reversed_in_time,
    solve_launch,
)
from dualarm_cli.timing.problem import LineProblem

JOINTS = ("s", "l", "e", "u", "r", "b", "t")


def straight(way, velocity, acceleration, jerk):
    """One joint on a straight path."""
    limits = JointLimits(("s",), [-9.0], [9.0], [velocity], [acceleration], [jerk], ("assumed",))
    length = np.linspace(0.0, 0.08, 65)
    return LineProblem(("s",), way * length[:, None] / 0.08, length, limits)


def state_at_end(trajectory, step=1e-4):
    """Velocity and acceleration at the last instant, from positions alone: a cubic through the last four."""
    t = trajectory.duration - step * np.arange(4)[::-1]
    q = trajectory.at(t)[0]
    fitted = np.polynomial.polynomial.polyfit((t - t[-1]) / step, q, 3)
    return fitted[1] / step, 2.0 * fitted[2] / step**2


def test_a_joint_under_its_jerk_limit_alone_takes_the_time_of_hand_arithmetic():
    """Rising all the way d = j t³/6; falling to none again in the second half d = j t³/8."""
    d, jerk = 0.3, 90.0
    problem = straight(d, 1e3, 1e4, jerk)
    found = launches(problem)
    assert found.time.min() == pytest.approx(np.cbrt(6.0 * d / jerk), rel=1e-9)
    # Without phases of constant acceleration four equal phases make the whole: half of it is up and down again.
    way = dataclasses.replace(
        found.launches[0], constant=0.0, cruise=0.0, inner=1.0, cut=0.5, coordinate=0
    )
    motion = solve_launch(problem, way)
    assert motion.duration == pytest.approx(np.cbrt(8.0 * d / jerk), rel=1e-2)
    velocity, acceleration = state_at_end(motion)
    # j (t/2)² at the end; nothing is left of j t/2.
    assert velocity[0] == pytest.approx(jerk * (motion.duration / 2.0) ** 2, rel=2e-2)
    assert abs(acceleration[0]) < 0.03 * jerk * motion.duration / 2.0


def test_a_joint_without_a_jerk_limit_accelerates_almost_all_the_way():
    """The least time is sqrt(2 d / a)."""
    found = launches(straight(0.2, 1e3, 10.0, np.inf))
    least = np.sqrt(2.0 * 0.2 / 10.0)
    assert least <= found.time.min() <= 1.1 * least


@pytest.mark.parametrize("knots", [12, 24])
@pytest.mark.parametrize(("constant", "inner"), [(20.0, 1.0), (40.0, 0.4), (40.0, 1.5)])
def test_few_knots_cost_no_time_without_a_jerk_limit(constant, inner, knots):
    """Ramps of acceleration between two knots made it overshoot: 30 % longer than all at full acceleration."""
    d, acceleration = 0.2, 10.0
    problem = dataclasses.replace(straight(d, 1e3, acceleration, np.inf), knots=knots)
    # The whole rise and no more: from rest over one ramp, then at full acceleration.
    share = (1.0 + constant) / (2.0 * (1.0 + constant + 1.0 / inner))
    way = Launch(constant, 0.0, inner, share, 0)
    ramp = 1.0 / (1.0 + constant)
    # Way of the ramp, then at the speed that it ends with, then what full acceleration adds; a = t = 1.
    way_in_unit_time = ramp**2 / 6.0 + ramp / 2.0 * (1.0 - ramp) + (1.0 - ramp) ** 2 / 2.0
    expected = np.sqrt(d / acceleration / way_in_unit_time)
    assert solve_launch(problem, way).duration == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("jerk", ["limited", "unlimited"])
def test_launches_keep_every_limit_and_pass_the_end_as_estimated(limits, without_jerk, lines, jerk):
    """Random lines, every fifth way: extrema between knots, states at the end by differences of positions."""
    off = []
    own = limits if jerk == "limited" else without_jerk
    paths, length = lines
    for path in paths:
        problem = LineProblem(JOINTS, path, length, own, knots=48)
        found = launches(problem)
        assert len(found.launches) == len(PROFILES) * len(CUTS)
        for k in range(0, len(found.launches), 5):
            motion = solve_launch(problem, found.launches[k])
            assert np.abs(motion.position[0] - path[0]).max() == 0.0
            assert np.abs(motion.position[-1] - path[-1]).max() < 1e-12
            assert np.abs([motion.velocity[0], motion.acceleration[0]]).max() == 0.0
            times = np.linspace(0.0, motion.duration, 2001)
            q, v, a = motion.at(times)
            assert (np.abs(v).max(axis=0) <= own.velocity * (1 + 1e-9)).all()
            assert (np.abs(a).max(axis=0) <= own.acceleration * (1 + 1e-9)).all()
            between = np.abs(np.diff(motion.acceleration, axis=0))
            allowed = own.jerk * np.diff(motion.time)[:, None]
            if jerk == "limited":
                assert (between <= allowed * (1 + 1e-9) + 1e-9).all()
            assert np.abs(np.gradient(q, times, axis=0)[1:-1] - v[1:-1]).max() < 1e-4
            # The end: what the motion says, what its positions say, what was estimated.
            velocity, acceleration = state_at_end(motion)
            np.testing.assert_allclose(motion.velocity[-1], velocity, atol=1e-5)
            np.testing.assert_allclose(motion.acceleration[-1], acceleration, atol=2e-2)
            speed = np.abs((found.velocity[k] - velocity) / own.velocity).max()
            off.append((abs(motion.duration / found.time[k] - 1.0), speed))
    assert (np.median(off, axis=0) < 0.01).all()
    assert (np.percentile(off, 90, axis=0) < 0.05).all()


def test_launches_stay_on_their_lines(limits, lines):
    """Between knots too: the nearest point of the exact path, finely sampled, is 2e-4 rad away at most."""
    paths, length = lines
    for path in paths:
        problem = LineProblem(JOINTS, path, length, limits, knots=96)
        spline = CubicSpline(length, path)
        fine = spline(np.linspace(0.0, length[-1], 4001))
        for k in range(2, len(launches(problem).launches), 17):
            motion = solve_launch(problem, launches(problem).launches[k])
            q = motion.at(np.linspace(0.0, motion.duration, 60))[0]
            gap = np.linalg.norm(q[:, None] - fine, axis=2).min(axis=1)
            assert gap.max() < 2e-4


def test_a_cap_on_the_tool_holds_at_the_far_end(limits, lines):
    """0.25 m/s on 80 mm: the speed along the line, from the positions of a joint that moves evenly."""
    _, length = lines
    path = np.zeros((65, 7))
    path[:, 0] = length
    problem = LineProblem(JOINTS, path, length, limits, tool_speed=0.25, knots=48)
    found = launches(problem)
    assert found.velocity[:, 0].max() <= 0.25
    for way in found.launches[::20]:
        motion = solve_launch(problem, way)
        assert np.abs(motion.at(np.linspace(0, motion.duration, 999))[1][:, 0]).max() <= 0.25


def test_backwards_in_time_it_is_the_same_way(limits, lines):
    """Positions at mirrored instants; velocities turn their signs, accelerations do not."""
    paths, length = lines
    problem = LineProblem(JOINTS, paths[0], length, limits)
    motion = solve_launch(problem, launches(problem).launches[7])
    back = reversed_in_time(motion)
    times = np.linspace(0.0, motion.duration, 50)
    for mine, theirs, sign in zip(
        motion.at(times), back.at(motion.duration - times), (1, -1, 1), strict=True
    ):
        np.testing.assert_allclose(mine, sign * theirs, atol=1e-9)


@pytest.mark.parametrize("count", [4, 5, 40])
def test_a_launch_spline_is_scipy_s_through_its_own_second_knot(count):
    """Uneven knots: scipy's clamped spline from speed 0 through the same knots is at rest at the start as well."""
    rng = np.random.default_rng(count)
    time = np.concatenate([[0.0], np.cumsum(rng.uniform(0.01, 0.3, count - 1))])
    goal, last = rng.normal(size=(count, 3)), rng.normal(size=3)
    q, v, a = cubic_spline(time, goal, None, last)
    kept = [0, *range(2, count)]
    np.testing.assert_array_equal(q[kept], goal[kept])
    expected = CubicSpline(time, q, bc_type=((1, np.zeros(3)), (1, last)))
    np.testing.assert_allclose(v, expected(time, 1), atol=1e-9 * np.abs(v).max())
    np.testing.assert_allclose(a, expected(time, 2), atol=1e-9 * np.abs(a).max())
    assert np.abs(expected(0.0, 2)).max() < 1e-9 * np.abs(a).max()
