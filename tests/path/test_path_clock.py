"""The clock of a path: rest at ends and corners, forwards only, as fast as asked and no faster."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.kinds.path.context import PathClock
from dualarm_cli.model.curves.tool_path import Line, ToolPath
from dualarm_cli.model.process_work import PathWork


def polyline(*points):
    """A path through points in the plane."""
    poses = [pin.SE3(np.eye(3), np.array([*point, 0.0])) for point in points]
    return ToolPath(tuple(Line(a, b) for a, b in pairwise(poses)))


def work(*points, speed=0.1, **more):
    """A path of the left arm."""
    return PathWork({"left": polyline(*points)}, speed, **more)


LONG = work((0, 0), (0.5, 0))
CORNER = work((0, 0), (0.3, 0), (0.3, 0.2))
JOBS = {
    "long": LONG,
    "corner": CORNER,
    "short": work((0, 0), (0.005, 0)),
    "three corners": work((0, 0), (0.1, 0), (0.1, 0.05), (0, 0.05), (0, 0.051), speed=0.25),
    "given": work((0, 0), (0.3, 0.4), speed=0.2, acceleration=0.5, jerk=4.0),
}


def test_a_long_line_takes_its_length_over_its_speed_and_its_ramps():
    """0.5 m at 0.1 m/s is 5 s; a double S whose acceleration is reached adds v/a + a/j = 0.2 s + 0.1 s."""
    assert PathClock.of(LONG).duration == pytest.approx(5.3, abs=1e-12)


def test_acceleration_and_jerk_of_the_file_count():
    """0.5 m at 0.2 m/s, 0.5 m/s² and 4 m/s³: 2.5 + 0.4 + 0.125 s."""
    assert PathClock.of(JOBS["given"]).duration == pytest.approx(3.025, abs=1e-12)


def test_a_jerk_that_is_not_given_is_reached_in_a_tenth_of_a_second():
    """0.5 m at 0.1 m/s and 0.25 m/s²: 5 + 0.4 + 0.1 s."""
    found = PathClock.of(work((0, 0), (0.5, 0), acceleration=0.25))
    assert found.duration == pytest.approx(5.5, abs=1e-12)


def test_a_corner_costs_one_more_ramp():
    """0.3 m and 0.2 m, each from rest to rest: 3.3 + 2.3 s."""
    assert PathClock.of(CORNER).duration == pytest.approx(5.6, abs=1e-12)


def test_a_short_line_does_not_reach_its_speed():
    """5 mm with jerk 5 m/s³: without reaching acceleration or speed 4 (d / 2j)^(1/3) = 4 (5e-4)^(1/3) s."""
    found = PathClock.of(JOBS["short"])
    # The acceleration reached is j (d / 2j)^(1/3) = 0.397 m/s² if it may be; 0.5 m/s² are allowed.
    assert found.duration == pytest.approx(4.0 * 5e-4 ** (1.0 / 3.0), rel=1e-9)
    # Its fastest is in the middle: j t² of the first quarter, 5 (5e-4)^(2/3) m/s.
    _, speed = found.at(np.array([found.duration / 2]))
    assert speed[0] * 0.1 == pytest.approx(5.0 * 5e-4 ** (2.0 / 3.0), rel=1e-9)


@pytest.mark.parametrize("name", JOBS)
def test_half_the_pace_takes_twice_as_long_and_is_the_same_film(name):
    """Exactly, with given and with open ramps; at twice the time the same place, half the speed of the fast one."""
    full, half = PathClock.of(JOBS[name]), PathClock.of(JOBS[name], pace=0.5)
    assert half.duration == pytest.approx(2.0 * full.duration, rel=1e-12)
    time = np.linspace(0.0, full.duration, 301)
    place, speed = full.at(time)
    slow_place, slow_speed = half.at(2.0 * time)
    assert slow_place == pytest.approx(place, abs=1e-12)
    assert slow_speed == pytest.approx(speed, abs=1e-9)


def test_gentle_ramps_take_as_many_times_as_long():
    """Twice: 0.6 s instead of 0.3 s; what the file gives stays, so that its path is as before."""
    assert PathClock.of(LONG, ramp_stretch=2.0).duration == pytest.approx(5.6, abs=1e-12)
    given = JOBS["given"]
    assert PathClock.of(given, ramp_stretch=2.0).duration == PathClock.of(given).duration
    # 0.25 m/s² given, its jerk reached in 0.2 s: 5 + 0.4 + 0.2 s.
    half_given = work((0, 0), (0.5, 0), acceleration=0.25)
    assert PathClock.of(half_given, ramp_stretch=2.0).duration == pytest.approx(5.6, abs=1e-12)


@pytest.mark.parametrize("name", JOBS)
def test_it_goes_from_start_to_end_forwards_and_no_faster_than_asked(name):
    """Share from 0 to 1, never falling; speed between 0 and 1; before and behind nothing moves."""
    clock = PathClock.of(JOBS[name])
    share, speed = clock.at(np.linspace(-1.0, clock.duration + 1.0, 5001))
    assert (share[0], share[-1]) == pytest.approx((0.0, 1.0), abs=1e-12)
    assert (np.diff(share) >= -1e-15).all()
    assert speed.min() >= 0.0
    assert speed.max() <= 1.0
    assert speed[[0, -1]] == pytest.approx([0.0, 0.0], abs=1e-7)


@pytest.mark.parametrize("name", ["long", "corner", "three corners", "given"])
def test_the_speed_asked_for_is_reached(name):
    """On long pieces; by differences of the share, too, which the clipping of the speed does not touch."""
    asked = JOBS[name]
    clock = PathClock.of(asked)
    time, step = np.linspace(0.0, clock.duration, 5001, retstep=True)
    rate = np.diff(clock.at(time)[0]) * asked.length / step
    assert rate.max() <= asked.speed * (1.0 + 1e-9)
    assert rate.max() == pytest.approx(asked.speed, rel=1e-6)
    assert clock.at(time)[1].max() == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("name", JOBS)
def test_speed_is_the_rate_of_the_share(name):
    """Central differences of 0.1 ms; their error is jerk h² / 6."""
    asked = JOBS[name]
    clock = PathClock.of(asked)
    time, h = np.linspace(0.01, clock.duration - 0.01, 997), 1e-4
    rate = (clock.at(time + h)[0] - clock.at(time - h)[0]) * asked.length / (2 * h)
    assert clock.at(time)[1] * asked.speed == pytest.approx(rate, abs=1e-6)


def test_acceleration_and_jerk_stay_within_what_is_given():
    """Second and third differences of the length; both limits are reached."""
    clock = PathClock.of(JOBS["given"])
    time, h = np.linspace(0.0, clock.duration, 3026, retstep=True)
    length = clock.at(time)[0] * 0.5
    second, third = np.diff(length, 2) / h**2, np.diff(length, 3) / h**3
    assert np.abs(second).max() == pytest.approx(0.5, rel=1e-5)
    assert np.abs(third).max() == pytest.approx(4.0, rel=1e-3)


def test_the_tool_stands_still_at_every_corner():
    """At the shares 100/251, 150/251 and 250/251 of the way, and only there and at the ends."""
    clock = PathClock.of(JOBS["three corners"])
    time = np.linspace(0.0, clock.duration, 200001)
    share, speed = clock.at(time)
    for corner in (0.1 / 0.251, 0.15 / 0.251, 0.25 / 0.251):
        k = int(np.argmin(np.abs(share - corner)))
        assert speed[k - 2 : k + 3].min() < 1e-3
    moving = speed > 1e-3
    assert np.count_nonzero(np.diff(moving.astype(int)) == 1) == 4


def test_corners_of_both_tools_stop_both():
    """Left turns off after a quarter, right after half of its way: three pieces of 0.1, 0.1 and 0.2 m."""
    left = polyline((0, 0), (0.05, 0), (0.05, 0.15))
    right = polyline((0, 0), (0.2, 0), (0.2, 0.2))
    clock = PathClock.of(PathWork({"left": left, "right": right}, 0.1))
    assert clock.duration == pytest.approx(1.3 + 1.3 + 2.3, abs=1e-9)


def test_a_corner_that_both_tools_share_is_one():
    """Both turn back after a third of their way: two pieces, and none for rounding between them."""
    for scale in (0.1, 0.3, 0.07, 0.7, 1.0 / 3.0, 0.011):
        left = polyline((0, 0), (0.1, 0), (-0.1, 0))
        right = polyline((0, 0), (scale, 0), (-scale, 0))
        clock = PathClock.of(PathWork({"left": left, "right": right}, 0.1))
        longest = max(0.3, 3.0 * scale)
        corner = longest / 3.0
        pieces = corner / 0.1 + 0.3 + 2.0 * corner / 0.1 + 0.3
        assert clock.duration == pytest.approx(pieces, abs=1e-9), scale
        assert len(clock.starts) == 2 * len(PathClock.of(LONG).starts)
        assert (np.diff(clock.starts) >= 0.0).all()
