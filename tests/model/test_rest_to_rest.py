"""Closed-form rest-to-rest times."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dualarm_cli.model.motion.rest_to_rest import RestToRest, rest_to_rest_duration

INF = np.inf


def time_of(distance, velocity, acceleration, jerk):
    """One joint."""
    one = [np.array([x]) for x in (distance, velocity, acceleration, jerk)]
    return float(rest_to_rest_duration(*one)[0])


@pytest.mark.parametrize(
    ("distance", "velocity", "acceleration", "jerk", "expected"),
    [
        # Four jerk phases: d = 2 j t³, t = (1/2)^(1/3), 4 t = 32^(1/3).
        (1.0, INF, INF, 1.0, 32 ** (1 / 3)),
        # Bang-bang: d = a t², 2 t.
        (1.0, INF, 4.0, INF, 1.0),
        # Trapezoid: d/v + v/a = 2/1 + 1/2.
        (2.0, 1.0, 2.0, INF, 2.5),
        # Full double S: d/v + v/a + a/j = 3/1 + 1/2 + 2/10.
        (3.0, 1.0, 2.0, 10.0, 3.7),
        # Acceleration reached, speed not: w²/a + w a/j = d with a = 2, j = 4: w²/2 + w/2 = 3, w = 2;
        # 2 (w/a + a/j) = 2 (1 + 0.5).
        (3.0, 10.0, 2.0, 4.0, 3.0),
        # Speed reached without the acceleration limit (v j < a²): d/v + 2 sqrt(v/j) = 5 + 2.
        (5.0, 1.0, 100.0, 1.0, 7.0),
        (0.0, 1.0, 1.0, 1.0, 0.0),
    ],
)
def test_times_by_hand(distance, velocity, acceleration, jerk, expected):
    """Every case of the double S once, with the arithmetic beside it."""
    velocity, acceleration = min(velocity, 1e9), min(acceleration, 1e9)
    assert time_of(distance, velocity, acceleration, jerk) == pytest.approx(expected, rel=1e-8)


def test_random_times_equal_ruckigs():
    """2,000 random distances and limits over six decades, to 1e-9 relative."""
    import ruckig

    rng = np.random.default_rng(3)
    otg, worst = ruckig.Ruckig(1), 0.0
    for _ in range(2_000):
        distance = 10 ** rng.uniform(-4, 1)
        velocity, acceleration, jerk = 10 ** rng.uniform([-1, -1, -1], [1, 2, 3])
        if rng.random() < 0.2:
            jerk = INF
        request = ruckig.InputParameter(1)
        request.current_position, request.target_position = [0.0], [distance]
        request.max_velocity, request.max_acceleration = [velocity], [acceleration]
        request.max_jerk = [jerk]
        trajectory = ruckig.Trajectory(1)
        otg.calculate(request, trajectory)
        ours = time_of(distance, velocity, acceleration, jerk)
        worst = max(worst, abs(ours / trajectory.duration - 1))
    assert worst < 1e-9


positive = st.floats(1e-3, 1e3)


@given(st.floats(1e-6, 1e3), positive, positive, positive, st.floats(0.1, 1.0))
@settings(max_examples=200, deadline=None)
def test_slower_limits_scale_time(distance, velocity, acceleration, jerk, speed):
    """Limits scaled by k, k², k³ are the same motion in 1/k of the speed."""
    full = time_of(distance, velocity, acceleration, jerk)
    slow = time_of(distance, velocity * speed, acceleration * speed**2, jerk * speed**3)
    assert slow == pytest.approx(full / speed, rel=1e-9)


@given(st.floats(0, 1e3), st.floats(0, 1e3), positive, positive, positive)
@settings(max_examples=200, deadline=None)
def test_a_longer_way_takes_longer(one, other, velocity, acceleration, jerk):
    """Time never falls with distance."""
    short, far = sorted((one, other))
    limits = (velocity, acceleration, jerk)
    assert time_of(short, *limits) <= time_of(far, *limits) * (1 + 1e-12)


def test_the_slowest_joint_decides_and_sides_are_equal():
    """`duration` is the largest of `per_joint`, for batches, whatever the sign."""
    law = RestToRest(np.array([1.0, 2.0]), np.array([3.0, 4.0]), np.array([INF, 50.0]))
    moves = np.random.default_rng(4).normal(size=(5, 6, 2))
    assert law.per_joint(moves).shape == (5, 6, 2)
    assert np.array_equal(law.duration(moves), law.per_joint(-moves).max(axis=-1))


@given(st.floats(1e-6, 1e3), positive, positive, positive, st.booleans())
@settings(max_examples=200, deadline=None)
def test_the_reachable_distance_inverts_the_time(distance, velocity, acceleration, jerk, limited):
    """How far one gets in the time of a way is that way."""
    law = RestToRest(*([x] for x in (velocity, acceleration, jerk if limited else INF)))
    reached = law.reachable_distance(law.per_joint(np.array([distance])))
    assert reached[0] == pytest.approx(distance, rel=1e-9)


def test_no_time_reaches_nothing():
    """Zero, with a jerk limit and without."""
    law = RestToRest([1.0, 1.0], [2.0, 2.0], [3.0, INF])
    assert np.array_equal(law.reachable_distance(np.zeros(2)), [0.0, 0.0])
    assert np.array_equal(law.per_joint(np.zeros(2)), [0.0, 0.0])


@pytest.mark.parametrize("jerk", [np.inf, 40.0, 5.0])
def test_the_table_of_times_is_the_closed_form_rounded_down(jerk):
    """At every step of the table: never above the time of the way, and below it by next to nothing."""
    law = RestToRest(np.array([1.0, 3.0]), np.array([4.0, 9.0]), np.array([jerk, 2.0 * jerk]))
    per_step, table = law.time_table
    way = np.arange(table.shape[1]) / per_step
    assert way[-1] == pytest.approx(np.pi, rel=1e-3)
    exact = np.stack([law.per_joint(np.stack([way, way], axis=1))[:, j] for j in range(2)])
    assert (table <= exact).all()
    longest = exact.max()
    assert (exact - table).max() < 2e-4 * longest
