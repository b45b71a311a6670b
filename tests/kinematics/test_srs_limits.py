"""Whole turns of joints within their limits."""

from __future__ import annotations

import numpy as np

from dualarm_cli.kinematics.srs.srs_limits import (
    nearest_turns,
    some_turn_within,
    within_limits,
    wrap,
)

PI = np.pi


def test_angles_are_wrapped_into_the_half_open_turn():
    """-pi becomes pi; whole turns and rounding at the seam stay inside."""
    given = np.array([0.0, PI, -PI, 3 * PI, 7.0, -7.0, np.nextafter(-PI, 0), np.nextafter(PI, 4)])
    wrapped = wrap(given)
    assert (wrapped > -PI).all() and (wrapped <= PI).all()
    np.testing.assert_allclose(np.cos(wrapped), np.cos(given), atol=1e-14)
    np.testing.assert_allclose(wrapped[:6], [0, PI, PI, PI, 7 - 2 * PI, 2 * PI - 7], atol=1e-14)


def test_the_nearest_turn_within_limits_is_the_best_of_all_turns():
    """Brute force over turns -3 to 3 on random angles, references and limits of many widths."""
    rng = np.random.default_rng(1)
    lower = np.array([-4.0, -PI, -1.396, -9.0, -np.inf, -2.0, -0.5])
    upper = np.array([4.0, PI, 3.491, 5.0, np.inf, 2.0, 8.0])
    q, reference = rng.uniform(-PI, PI, (500, 7)), rng.uniform(-8, 8, (500, 7))
    found = nearest_turns(q, reference, lower, upper)
    turned = q[..., None] + 2 * PI * np.arange(-3, 4)
    allowed = (turned >= lower[:, None]) & (turned <= upper[:, None])
    cost = np.where(allowed, np.abs(turned - reference[..., None]), np.inf)
    best = np.take_along_axis(turned, cost.argmin(axis=-1)[..., None], axis=-1)[..., 0]
    np.testing.assert_allclose(found, np.where(allowed.any(axis=-1), best, q), atol=1e-12)


def test_half_a_turn_is_taken_on_the_side_of_the_reference():
    """With limits of exactly ±180° the angle pi is also -pi."""
    limit = np.array([PI])
    found = nearest_turns(np.array([PI]), np.array([[-3.0], [3.0]]), -limit, limit)
    np.testing.assert_allclose(found[:, 0], [-PI, PI], atol=1e-15)


def test_limits_hold_for_the_angle_as_it_stands():
    """A joint one turn beyond its limit is beyond it; infinite limits never are."""
    lower, upper = np.array([-1.0, -np.inf]), np.array([1.0, np.inf])
    q = np.array([[1.0, 99.0], [1.0 + 1e-6, 0.0], [2 * PI, 0.0], [-1.0, -99.0]])
    assert within_limits(q, lower, upper).tolist() == [True, False, False, True]


def test_some_turn_of_an_angle_is_within_limits_where_brute_force_finds_one():
    """Ranges inside, across and beyond half a turn, and more than a turn."""
    angle = np.linspace(-PI, PI, 2_001)
    turned = angle[:, None] + 2 * PI * np.arange(-3, 4)
    for low, high in ((-1.0, 0.5), (-1.396, 3.491), (4.0, 7.0), (-4.0, 4.0), (-np.inf, np.inf)):
        expected = ((turned >= low) & (turned <= high)).any(axis=1)
        np.testing.assert_array_equal(some_turn_within(angle, low, high), expected)
