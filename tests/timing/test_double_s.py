"""Transfers in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from dualarm_cli.model.motion.rest_to_rest import RestToRest
from dualarm_cli.timing.double_s import fastest_phases, solve_transfer
from dualarm_cli.timing.problem import TransferProblem

INF = np.inf


@pytest.mark.parametrize(
    ("distance", "limits", "expected"),
    [
        # Trapezoid: ramps of v/a = 0.5 cover 0.25 each, the rest cruises (2 - 0.5)/1.
        (2.0, (1.0, 2.0, INF), [0.5, 1.5, 0.5]),
        # Triangle: two phases of sqrt(d/a).
        (-1.0, (9.0, 4.0, INF), [0.5, 0.0, 0.5]),
        # Jerk alone: four phases of (d/2j)^(1/3).
        (16.0, (99.0, 99.0, 1.0), [2.0, 0.0, 2.0, 0.0, 2.0, 0.0, 2.0]),
        # a/j = 0.2, v/a - a/j = 0.3, cruise d/v - v/a - a/j = 3 - 0.7.
        (3.0, (1.0, 2.0, 10.0), [0.2, 0.3, 0.2, 2.3, 0.2, 0.3, 0.2]),
        # Acceleration reached, speed not: w = 2 (see test_rest_to_rest), w/a - a/j = 1 - 0.5.
        (3.0, (10.0, 2.0, 4.0), [0.5, 0.5, 0.5, 0.0, 0.5, 0.5, 0.5]),
        # Speed reached, acceleration not: sqrt(v/j) = 1; 5/1 - 2.
        (5.0, (1.0, 100.0, 1.0), [1.0, 0.0, 1.0, 3.0, 1.0, 0.0, 1.0]),
    ],
)
def test_phases_by_hand(distance, limits, expected):
    """Every case once; the motion points the way of the displacement."""
    law = RestToRest(*([x] for x in limits))
    phases = fastest_phases(np.array([distance]), law)
    if len(expected) == 3:
        # A trapezoid is a double S whose jerk phases have no length.
        ramp, cruise, brake = expected
        expected = [0.0, ramp, 0.0, cruise, 0.0, brake, 0.0]
    assert phases.duration[0] == pytest.approx(expected, abs=1e-12)
    assert np.sign(phases.acceleration[0, 1]) == np.sign(distance)


def test_phases_take_the_closed_form_time():
    """2,000 random joints over many decades."""
    rng = np.random.default_rng(11)
    distance = 10 ** rng.uniform(-9, 2, 2_000)
    v, a, j = 10 ** rng.uniform([[-2], [-2], [-2]], [[2], [3], [5]], (3, 2_000))
    j[::5] = INF
    law = RestToRest(v, a, j)
    total = fastest_phases(distance, law).duration.sum(axis=1)
    assert np.abs(total / law.per_joint(distance) - 1).max() < 1e-12


@pytest.mark.parametrize("stretch", [0.0, 3.0])
def test_transfers_keep_limits_with_and_without_jerk(
    limits, without_jerk, stretch, assert_motion_is_consistent
):
    """Double S and trapezoid, alone and slowed."""
    rng = np.random.default_rng(12)
    for own in (limits, without_jerk):
        for _ in range(30):
            start, goal = rng.uniform(-2, 2, (2, 7))
            goal[0] = start[0]
            trajectory = solve_transfer(TransferProblem(own.joints, start, goal, own, stretch))
            assert_motion_is_consistent(trajectory, start, goal, own)
            law = RestToRest(own.velocity, own.acceleration, own.jerk)
            expected = max(stretch, float(law.duration(goal - start)))
            assert trajectory.duration == pytest.approx(expected, rel=1e-12)
