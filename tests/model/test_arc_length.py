"""Length along curves: closed forms, scipy's integrals, and the way back from a length to the parameter."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.special import ellipe

from dualarm_cli.model.curves.arc_length import ArcLength

EVEN = np.linspace(0.0, 1.0, 257)


def ellipse_speed(a, b):
    """Length per turn of (a cos, b sin) at shares of a turn."""
    return lambda t: (
        2.0 * np.pi * np.hypot(a * np.sin(2.0 * np.pi * t), b * np.cos(2.0 * np.pi * t))
    )


def test_polynomials_up_to_degree_five_are_exact():
    """Three Gauss points: the integral of 6 u^5 + 2 u + 1 from 0 to 2 is 64 + 4 + 2 = 70, with one stretch."""
    arc = ArcLength.measure(lambda u: 6.0 * u**5 + 2.0 * u + 1.0, np.array([0.0, 2.0]))
    assert arc.whole == pytest.approx(70.0, rel=1e-14)
    assert arc.speed.tolist() == [1.0, 6.0 * 32.0 + 4.0 + 1.0]


def test_a_circle_is_2_pi_r_and_its_parameter_proportional_to_its_length():
    """Radius 0.3 m."""
    arc = ArcLength.measure(ellipse_speed(0.3, 0.3), EVEN)
    assert arc.whole == pytest.approx(0.6 * np.pi, rel=1e-14)
    s = np.linspace(0.0, arc.whole, 1001)
    assert arc.at(s) == pytest.approx(s / arc.whole, abs=1e-14)


@pytest.mark.parametrize(("a", "b"), [(0.1, 0.09), (0.1, 0.03), (0.02, 1.0)])
def test_an_ellipse_is_as_long_as_the_elliptic_integral_says(a, b):
    """4 a E(1 - b²/a²), by scipy."""
    arc = ArcLength.refine(ellipse_speed(a, b), EVEN)
    assert arc.whole == pytest.approx(4.0 * a * ellipe(1.0 - (b / a) ** 2), rel=1e-11)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.floats(0.005, 0.2), st.floats(0.0, 1.0))
def test_refining_finds_sharp_places(width, at):
    """A speed of 1 + 1 / (1 + ((u - at) / width)²): its integral is u + width arctan((u - at) / width)."""

    def speed(u):
        return 1.0 + 1.0 / (1.0 + ((u - at) / width) ** 2)

    def whole(u):
        return u + width * np.arctan((u - at) / width)

    arc = ArcLength.refine(speed, np.linspace(0.0, 1.0, 9))
    assert arc.whole == pytest.approx(whole(1.0) - whole(0.0), rel=1e-10)
    s = np.linspace(0.0, arc.whole, 301)
    assert whole(arc.at(s)) - whole(0.0) == pytest.approx(s, abs=1e-10)


def test_refining_leaves_nodes_alone_where_they_are_enough():
    """A constant speed needs no more of them."""
    arc = ArcLength.refine(lambda u: np.full_like(u, 0.7), np.linspace(0.0, 1.0, 5))
    assert arc.parameter.tolist() == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert arc.whole == pytest.approx(0.7, rel=1e-15)


def test_the_length_up_to_a_found_parameter_is_the_one_asked_for():
    """Equal steps of the length of an ellipse, each integrated anew by scipy: no error adds up."""
    speed = ellipse_speed(0.1, 0.04)
    arc = ArcLength.refine(speed, EVEN)
    t = arc.at(np.linspace(0.0, arc.whole, 41))
    steps = [
        quad(lambda u: float(speed(np.array([u]))[0]), *pair, epsabs=1e-15)[0]
        for pair in pairwise(t)
    ]
    assert steps == pytest.approx([arc.whole / 40] * 40, abs=1e-12)


def test_lengths_beyond_the_ends_stay_at_the_ends_and_arrays_are_frozen():
    """So that rounding does not leave the curve."""
    arc = ArcLength.measure(ellipse_speed(1.0, 2.0), EVEN)
    assert arc.at(np.array([-1.0, arc.whole + 1.0])).tolist() == [0.0, 1.0]
    with pytest.raises(ValueError, match="read-only"):
        arc.length[0] = 1.0
