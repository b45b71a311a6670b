"""Lines under other limits: exact where scaling laws give the answer, near a new timing elsewhere."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from dualarm_cli.model.robot import JointLimits
from dualarm_cli.report.sensitivity import line_factors
from dualarm_cli.timing.line_profile import solve_line
from dualarm_cli.timing.problem import LineProblem


def limits(velocity, acceleration, jerk):
    """Limits of as many joints as there are velocities."""
    n = len(velocity)
    return JointLimits(
        tuple(f"q{k}" for k in range(n)),
        np.full(n, -9.0),
        np.full(n, 9.0),
        *(np.array(values, dtype=float) for values in (velocity, acceleration, jerk)),
        ("assumed",) * n,
    )


def timed(path, law):
    """The line along a path under limits."""
    length = np.linspace(0.0, 0.08, len(path))
    return solve_line(LineProblem(law.joints, path, length, law))


def factors(trajectory, law, acceleration, jerk):
    """Factors of the one line that a trajectory is."""
    spans = np.array([[trajectory.time[0], trajectory.time[-1]]])
    return line_factors(trajectory, spans, law, np.array(acceleration), np.array(jerk))[:, 0]


def curved(seed):
    """A smooth path of three joints over 65 gridpoints."""
    rng = np.random.default_rng(seed)
    s = np.linspace(0.0, 1.0, 65)[:, None]
    one, two, phase = rng.uniform(-0.4, 0.4, (3, 3))
    return one * s + two * np.sin(1.5 * s + phase)


def test_one_joint_without_other_limits_follows_the_square_root():
    """Rest to rest under acceleration alone: T ~ a^-1/2, whatever the shape."""
    law = limits([100.0], [2.0], [np.inf])
    trajectory = timed(np.linspace(0.0, 0.3, 65)[:, None], law)
    found = factors(trajectory, law, [[1.0], [0.9], [1.1]], np.ones((3, 1)))
    assert found == pytest.approx([1.0, 0.9**-0.5, 1.1**-0.5], rel=1e-9)


def test_one_joint_under_jerk_alone_follows_the_cube_root():
    """T ~ j^-1/3."""
    law = limits([100.0], [1e4], [20.0])
    trajectory = timed(np.linspace(0.0, 0.3, 65)[:, None], law)
    found = factors(trajectory, law, np.ones((3, 1)), [[1.0], [0.9], [1.1]])
    assert found == pytest.approx([1.0, 0.9 ** (-1 / 3), 1.1 ** (-1 / 3)], rel=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_accelerations_and_jerks_by_square_and_cube_scale_time_exactly(seed):
    """Limits of a c² and j c³ play the same profile c times as fast while no speed limit is near."""
    law = limits([100.0] * 3, [5.0, 7.0, 9.0], [60.0, 70.0, 80.0])
    trajectory = timed(curved(seed), law)
    found = factors(trajectory, law, [[0.81] * 3, [1.21] * 3], [[0.729] * 3, [1.331] * 3])
    assert found == pytest.approx([1 / 0.9, 1 / 1.1], rel=1e-6)


def test_other_limits_of_single_joints_are_near_a_new_timing():
    """Each joint's acceleration and jerk, lower and higher: the median within 0.5 % of the line timed anew.

    Single lines timed anew may be 5 % slower than said, where the new search misses the profile that the old
    one had found; hardly one is faster.
    """
    law = limits([1.0, 1.2, 1.5], [5.0, 7.0, 9.0], [60.0, 70.0, 80.0])
    ones, off = np.ones(3), []
    for seed in range(6):
        path = curved(seed)
        trajectory = timed(path, law)
        for joint, factor, name in itertools.product(range(3), (0.9, 1.1), ("a", "j")):
            change = np.where(np.arange(3) == joint, factor, 1.0)
            a, j = (change, ones) if name == "a" else (ones, change)
            other = limits(law.velocity, law.acceleration * a, law.jerk * j)
            (found,) = factors(trajectory, law, [a], [j])
            off.append(found / (timed(path, other).duration / trajectory.duration) - 1.0)
            assert (found >= 1.0 - 1e-9) if factor < 1 else (found <= 1.0 + 1e-9)
    assert np.median(np.abs(off)) < 0.005
    assert max(off) < 0.03
    assert min(off) > -0.08
