"""Transfers by ruckig and by trapezoids: exact knots, exact ends, least time."""

from __future__ import annotations

import numpy as np
import pytest
import ruckig

from dualarm_cli.model.motion.rest_to_rest import RestToRest
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.timing import TIMING_SOLVERS, ruckig_
from dualarm_cli.timing.problem import TransferProblem, why_jerk_limits_unsupported

JOINTS = ("s", "l", "e", "u", "r", "b", "t")


def random_transfers(count, seed):
    """Starts and goals: some joints do not move, some hardly do."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        start, goal = rng.uniform(-2, 2, (2, 7))
        still = rng.random(7) < 0.2
        goal[still] = start[still]
        goal = start + (goal - start) * rng.choice([1.0, 1e-2, 1e-6])
        yield start, goal


def least_time(limits, move):
    """Closed form of the slowest joint."""
    return float(RestToRest(limits.velocity, limits.acceleration, limits.jerk).duration(move))


@pytest.mark.parametrize("stretch", [0.0, 2.5])
def test_ruckig_transfers_take_the_closed_form_time_and_keep_every_limit(
    limits, stretch, assert_motion_is_consistent
):
    """300 random transfers, alone and stretched to a common duration."""
    for start, goal in random_transfers(150, 8):
        problem = TransferProblem(JOINTS, start, goal, limits, stretch)
        trajectory = TIMING_SOLVERS["ruckig"].transfer(problem)
        expected = max(stretch, least_time(limits, goal - start))
        assert trajectory.duration == pytest.approx(expected, rel=1e-9)
        assert_motion_is_consistent(trajectory, start, goal, limits)


@pytest.mark.parametrize("name", ["ruckig", "trapezoid", "toppra"])
@pytest.mark.parametrize("stretch", [0.0, 2.5])
def test_transfers_without_jerk_limits_jump_at_double_knots_only(
    without_jerk, name, stretch, assert_motion_is_consistent
):
    """Accelerations jump, also at both ends; position and velocity never do."""
    for start, goal in random_transfers(60, 9):
        problem = TransferProblem(JOINTS, start, goal, without_jerk, stretch)
        trajectory = TIMING_SOLVERS[name].transfer(problem)
        expected = max(stretch, least_time(without_jerk, goal - start))
        assert trajectory.duration == pytest.approx(expected, rel=1e-9)
        assert_motion_is_consistent(trajectory, start, goal, without_jerk)
        jump = np.abs(np.diff(trajectory.acceleration, axis=0)).max(axis=1) > 1e-3
        # With infinite jerk an acceleration is constant between knots, so every change is a jump.
        assert (np.diff(trajectory.time)[jump] == 0).all()


def test_nothing_to_do_takes_the_minimum_duration(limits):
    """Start equals goal."""
    q = np.linspace(-1, 1, 7)
    for name in ("ruckig", "trapezoid"):
        for duration in (0.0, 1.5):
            problem = TransferProblem(JOINTS, q, q, limits, duration)
            trajectory = TIMING_SOLVERS[name].transfer(problem)
            assert trajectory.duration == duration
            assert np.array_equal(trajectory.position[-1], q)


def test_solvers_without_jerk_say_whose_jerk_they_would_break(limits, without_jerk):
    """The reason names joints and what to do."""
    assert why_jerk_limits_unsupported(without_jerk) is None
    reason = why_jerk_limits_unsupported(limits)
    assert "7 joints have jerk limits (s, l, e...)" in reason
    assert "use timing ruckig" in reason


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"start": np.full(7, np.nan)}, "start must be 7 finite numbers"),
        ({"goal": np.zeros(6)}, "goal must be 7 finite numbers"),
        ({"joints": ()}, "at least one"),
        ({"minimum_duration": -1.0}, "minimum_duration must be 0 or more"),
        ({"minimum_duration": np.inf}, "minimum_duration must be 0 or more"),
    ],
)
def test_problems_that_would_crash_a_library_are_refused(limits, change, words):
    """Ruckig reads out of bounds for short lists and dies of zero joints."""
    fields = {"joints": JOINTS, "start": np.zeros(7), "goal": np.ones(7), "limits": limits}
    with pytest.raises(ValueError, match=words):
        TransferProblem(**(fields | change))


def test_limits_of_any_size_are_kept_over_any_duration(assert_motion_is_consistent):
    """500 problems over many decades: ways of 1e-12 rad beside radians, thousands of seconds."""
    rng = np.random.default_rng(14)
    for _ in range(500):
        n = int(rng.integers(1, 8))
        v, a, j = 10 ** rng.uniform([[-3], [-3], [-3]], [[2], [2], [4]], (3, n))
        j[rng.random(n) < rng.choice([0.0, 0.5, 1.0])] = np.inf
        start = rng.uniform(-3, 3, n)
        goal = start + rng.choice([-1, 1], n) * 10 ** rng.uniform(-12, 1, n)
        own = JointLimits(JOINTS[:n], start - 50, start + 50, v, a, j, ("assumed",) * n)
        least = least_time(own, goal - start)
        minimum = rng.choice([0.0, least, least * (1 + 1e-12), least + 10 ** rng.uniform(-9, 1)])
        problem = TransferProblem(own.joints, start, goal, own, minimum)
        trajectory = TIMING_SOLVERS["ruckig"].transfer(problem)
        assert trajectory.duration == pytest.approx(max(least, minimum), rel=1e-9)
        # A phase of a microsecond whose end moved by a nanosecond: a thousandth of its jerk.
        assert_motion_is_consistent(trajectory, start, goal, own, 1e-9)


def test_where_ruckig_fails_the_closed_form_answers(limits, monkeypatch):
    """A hair more than the least 3,204 s for 3.9 rad makes ruckig 0.19.4 raise; so does a broken one."""
    own = JointLimits(("s",), [-9], [9], [0.0012268853], [58.87], [np.inf], ("assumed",))
    start, goal = [-2.955543738673033], [0.9759941367808516]
    minimum = least_time(own, np.subtract(goal, start)) * (1 + 1e-10)
    trajectory = TIMING_SOLVERS["ruckig"].transfer(
        TransferProblem(own.joints, start, goal, own, minimum)
    )
    assert trajectory.duration == minimum
    assert trajectory.position[-1, 0] == goal[0]

    def broken(*_):
        raise ruckig.RuckigError("always")

    start, goal = next(random_transfers(1, 15))
    ordinary = TransferProblem(JOINTS, start, goal, limits)
    expected = ruckig_.solve_transfer(ordinary)
    monkeypatch.setattr(ruckig.Ruckig, "calculate", broken)
    found = ruckig_.solve_transfer(ordinary)
    assert found.duration == expected.duration
    assert np.array_equal(found.position[-1], goal)


def test_a_way_of_rounding_does_not_disturb_its_neighbours(limits):
    """One joint is 1e-12 rad from its goal, another moves for a second: both motions stay smooth.

    At full jerk the first would need phases of sqrt(1e-12 / 99 / 1) = 1e-7 s; it is slowed instead.
    """
    start, goal = np.zeros(7), np.zeros(7)
    goal[0], goal[1] = 1e-12, 2.0
    trajectory = TIMING_SOLVERS["ruckig"].transfer(TransferProblem(JOINTS, start, goal, limits))
    assert np.diff(trajectory.time).min() > 1e-3
    assert np.array_equal(trajectory.position[-1], goal)
    assert np.abs(trajectory.acceleration[:, 0]).max() < 1e-10
