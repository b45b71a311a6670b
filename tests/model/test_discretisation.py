"""Points of curves for controllers: equal steps, the printed Euler step, and bounds that hold."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from dualarm_cli.model.curves import discretisation
from dualarm_cli.model.curves.contours import Ellipse, LineContour, Saddle, SphereArc
from dualarm_cli.model.curves.discretisation import Points, by_euler, by_length, judge, step_lengths
from dualarm_cli.model.curves.feature_curve import FeatureCurve, PoseCurve
from dualarm_cli.model.curves.point_spline import PointSpline

HERE = pin.SE3.Identity()
TURN = 2.0 * np.pi
SADDLE = FeatureCurve(Saddle(0.05, 0.045, np.pi / 2, 0.0, 0.0, TURN), HERE)
"""Table 2 of [Qin2024]."""
CIRCLE = FeatureCurve(Ellipse((0.02, 0.02), 0.0, TURN), HERE)


def saddle_speed(theta):
    """|P'| of Table 2's saddle by its angle, from Eq. 12 by hand: y' = r cos, z' = r sin, x' = -y y' / x."""
    R, r = 0.05, 0.045
    y = r * np.sin(theta)
    return np.hypot(r, y * r * np.cos(theta) / np.sqrt(R**2 - y**2))


def test_steps_are_whole_and_the_last_one_is_what_is_left():
    """1 mm by 0.3 mm: 0, 0.3, 0.6, 0.9, 1; by 0.25 mm no step of no length; by 2 mm only the ends."""
    assert step_lengths(1e-3, 3e-4) == pytest.approx([0.0, 3e-4, 6e-4, 9e-4, 1e-3])
    assert step_lengths(1e-3, 2.5e-4) == pytest.approx([0.0, 2.5e-4, 5e-4, 7.5e-4, 1e-3])
    assert step_lengths(1e-3, 2e-3).tolist() == [0.0, 1e-3]
    # Half a micrometre that would be left is joined to the step before it.
    assert step_lengths(1.0005e-3, 5e-4) == pytest.approx([0.0, 5e-4, 1.0005e-3])


def test_points_of_the_papers_saddle_are_equal_lengths_apart():
    """Every step integrated by scipy from Eq. 12: 0.8 mm; 308.74 mm are 385 of them and 0.745 mm."""
    points = by_length(SADDLE, 8e-4)
    theta = TURN * points.parameter
    steps = [quad(saddle_speed, a, b, epsabs=1e-15)[0] for a, b in pairwise(theta)]
    assert len(steps) == 386
    assert steps[:-1] == pytest.approx([8e-4] * 385, abs=1e-11)
    assert steps[-1] == pytest.approx(0.3087447 - 385 * 8e-4, abs=1e-7)
    assert points.p[0] == pytest.approx(points.p[-1], abs=1e-12)
    quality = judge(SADDLE, points)
    assert quality.spacing_error < 1e-11
    assert quality.drift < 1e-11
    assert quality.last_step == pytest.approx(steps[-1], abs=1e-11)


@pytest.mark.parametrize(("step", "expected"), [(8e-4, 3.3e-6), (1.7e-3, 15e-6), (2e-3, 20.6e-6)])
def test_the_printed_euler_step_is_off_by_micrometres(step, expected):
    """The step theta + V T / |P'|, again by a loop of floats and scipy: 4 to 10 ms at 200 mm/s."""
    theta = [0.0]
    while theta[-1] + step / saddle_speed(theta[-1]) < TURN:
        theta.append(theta[-1] + step / saddle_speed(theta[-1]))
    points = by_euler(SADDLE, step)
    assert TURN * points.parameter[:-1] == pytest.approx(theta, abs=1e-10)
    assert points.parameter[-1] == 1.0
    steps = [quad(saddle_speed, a, b, epsabs=1e-15)[0] for a, b in pairwise(theta)]
    quality = judge(SADDLE, points)
    assert quality.spacing_error == pytest.approx(np.abs(np.array(steps) - step).max(), abs=1e-10)
    assert quality.spacing_error == pytest.approx(expected, rel=0.05)
    assert quality.speed_error == pytest.approx(quality.spacing_error / step)
    assert quality.drift == pytest.approx(abs(sum(steps) - len(steps) * step), abs=1e-10)


def test_euler_s_error_grows_with_the_square_of_the_step_and_is_none_on_a_circle():
    """Half the step, a quarter of the error; a parameter proportional to the length leaves rounding."""
    one, half = (judge(SADDLE, by_euler(SADDLE, h)).spacing_error for h in (4e-4, 2e-4))
    assert one / half == pytest.approx(4.0, rel=0.01)
    points = by_euler(CIRCLE, 1e-3)
    assert judge(CIRCLE, points).spacing_error < 1e-15
    assert points.parameter == pytest.approx(by_length(CIRCLE, 1e-3).parameter, abs=1e-12)


def test_a_circle_s_chords_and_turns_by_hand():
    """Radius r, step h: r (1 - cos(h / 2r)) from the chord, frames turn by h / r, axes' cosine cos(h / r)."""
    r, h = 0.02, 2e-3
    quality = judge(CIRCLE, by_length(CIRCLE, h))
    assert quality.chord_error == pytest.approx(r * (1.0 - np.cos(h / (2.0 * r))), rel=1e-9)
    assert quality.turn == pytest.approx(h / r, rel=1e-9)
    assert quality.least_dot == pytest.approx(np.cos(h / r), rel=1e-9)
    # kappa h² / 8 is 25 um, and the curvature 50 per metre, each bounded to a thousandth.
    assert h**2 / (8.0 * r) <= quality.chord_bound <= h**2 / (8.0 * r) * 1.002
    assert 1.0 / r <= quality.curvature_bound <= 1.001 / r
    assert quality.lean < 1e-12


def test_a_line_has_no_error_at_all():
    """No curvature, no turn, axes the same."""
    line = FeatureCurve(
        LineContour(np.zeros(3), np.array([0.1, 0.2, 0.0]), np.array([0.0, 0.0, 1.0])), HERE
    )
    for points in (by_length(line, 1e-3), by_euler(line, 1e-3)):
        quality = judge(line, points)
        assert (quality.chord_bound, quality.curvature_bound) == (0.0, 0.0)
        assert max(quality.chord_error, quality.spacing_error, quality.turn) < 1e-12
        assert quality.least_dot == pytest.approx(1.0)


@st.composite
def curves(draw):
    """Saddles, arcs, ellipses and splines, gentle and nearly as sharp as they may be."""
    kind, reach = draw(st.sampled_from("saelp")), draw(st.floats(0.1, 0.998))
    share = draw(st.floats(0.1, 0.9))
    end = draw(st.floats(1.0, TURN))
    r, e = 0.05 * reach * share, 0.05 * reach * (1.0 - share)
    if kind == "s":
        return FeatureCurve(Saddle(0.05, r, draw(st.floats(0.3, 2.8)), e, 0.3, 0.3 + end), HERE)
    if kind == "a":
        return FeatureCurve(SphereArc(0.05, r, 0.4, -e, 0.3, 0.3 + end), HERE)
    if kind == "e":
        return FeatureCurve(Ellipse((0.05, 0.05 * (1.02 - reach)), 0.0, end), HERE)
    rng = np.random.default_rng(draw(st.integers(0, 1000)))
    points = np.column_stack([0.05 * np.arange(9.0), rng.uniform(-0.04, 0.04, (9, 2))])
    if kind == "l":
        return FeatureCurve(PointSpline(points, np.array([0.0, 0.0, 1.0])), HERE)
    return PoseCurve.through([pin.SE3(np.eye(3), p) for p in points], HERE)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(curves(), st.floats(2e-4, 3e-2))
def test_no_point_of_a_curve_is_farther_from_its_chord_than_proven(curve, step):
    """Dense points against their chords, and curvatures by differences against the bound, which is not idle."""
    points = by_length(curve, step)
    quality = judge(curve, points)
    worst = 0.0
    for a, b in pairwise(points.parameter):
        p = curve.contour.point(np.linspace(a, b, 60))
        chord = (p[-1] - p[0]) / np.linalg.norm(p[-1] - p[0])
        off = p - p[0]
        worst = max(worst, np.linalg.norm(np.cross(off, chord), axis=1).max())
    assert quality.chord_error <= worst * (1.0 + 1e-2) + 1e-14
    assert worst <= quality.chord_bound
    s = np.linspace(0.0, curve.length, 20_001)
    p = curve.at(s)[1]
    h = s[1]
    kappa = np.linalg.norm(p[2:] - 2.0 * p[1:-1] + p[:-2], axis=1) / h**2
    assert kappa.max() <= quality.curvature_bound * (1.0 + 1e-3)
    assert quality.curvature_bound <= 1.3 * kappa.max() + 1e-3


@pytest.mark.parametrize("parts", [12, 40, 200, 1000])
def test_curvature_is_enclosed_on_wide_cells_too(parts, monkeypatch):
    """One cell a step: the ellipse's a / b² at its tips, wherever these lie in their cells; a saddle by many points."""
    monkeypatch.setattr(discretisation, "CURVE_STEPS", replace(discretisation.CURVE_STEPS, cells=1))
    for start in np.linspace(0.0, 0.5, 11):
        curve = FeatureCurve(Ellipse((0.05, 0.02), start, start + TURN), HERE)
        quality = judge(curve, by_length(curve, curve.length / parts))
        assert quality.curvature_bound >= 0.05 / 0.02**2
        assert quality.chord_bound >= quality.chord_error
        # The saddle's product of derivatives changes along it as well, unlike the ellipse's.
        curve = FeatureCurve(Saddle(0.05, 0.048, 1.2, 0.0, start, start + TURN), HERE)
        t = np.linspace(0.0, 1.0, 20_001)
        rate, second = curve.contour.rate(t), curve.contour.second(t)
        kappa = np.linalg.norm(np.cross(rate, second), axis=1) / np.linalg.norm(rate, axis=1) ** 3
        quality = judge(curve, by_length(curve, curve.length / parts))
        assert quality.curvature_bound >= kappa.max()
        assert quality.chord_bound >= quality.chord_error


def test_bounds_of_two_steps_of_an_arc_by_hand(monkeypatch):
    """An arc of radius r over 2 rad in two steps: derivatives of 2r, 4r and 8r; half a step is d = 1/4.

    With P and Q for the first two: |Q| <= 4r + 8r/4 = 6r, r/2 <= |P| <= 7r/2, |P x Q| <= 8r² + 8r/4 · 7r/2 = 15r²:
    the curvature is at most 120/r. The chord is nearer by the second derivative: 6r (1/2)²/8.
    """
    monkeypatch.setattr(discretisation, "CURVE_STEPS", replace(discretisation.CURVE_STEPS, cells=1))
    for r in (0.03, 2.0):
        arc = FeatureCurve(Ellipse((r, r), 0.3, 2.3), HERE)
        quality = judge(arc, by_length(arc, r))
        # A billionth more, for rounding.
        assert quality.curvature_bound / (1.0 + 1e-9) == pytest.approx(120.0 / r, rel=1e-11)
        assert quality.chord_bound / (1.0 + 1e-9) == pytest.approx(6.0 * r / 32.0, rel=1e-11)
    # In 40 steps d is 1/80, and the curvature's bound is the better one.
    arc = FeatureCurve(Ellipse((2.0, 2.0), 0.3, 2.3), HERE)
    quality = judge(arc, by_length(arc, 0.1))
    second = 8.0 + 16.0 / 80.0
    least, most = 4.0 - second / 80.0, 4.0 + second / 80.0
    kappa = (32.0 + 16.0 / 80.0 * most) / least**3
    assert quality.curvature_bound == pytest.approx(kappa)
    assert quality.chord_bound == pytest.approx(min(kappa * 0.1**2, second / 40.0**2) / 8.0)


def test_frames_that_are_given_off_the_curve_are_told():
    """Frames turned by 10 degrees about z against a straight way."""
    poses = [
        pin.SE3(pin.utils.rotate("z", np.radians(10.0)), np.array([x, 0, 0]))
        for x in (0.0, 0.1, 0.2)
    ]
    curve = PoseCurve.through(poses, pin.SE3(pin.utils.rotate("x", 1.0), np.ones(3)))
    assert judge(curve, by_length(curve, 0.01)).lean == pytest.approx(np.radians(10.0))


def test_the_largest_lean_is_told():
    """Frames that turn from 0 to 20 degrees about z along a straight way: the last one is off most."""
    poses = [
        pin.SE3(pin.utils.rotate("z", np.radians(100.0 * x)), np.array([x, 0, 0]))
        for x in (0.0, 0.1, 0.2)
    ]
    curve = PoseCurve.through(poses, HERE)
    assert judge(curve, by_length(curve, 0.01)).lean == pytest.approx(np.radians(20.0))


def test_a_flip_of_a_frame_shows_as_a_cosine_below_0():
    """One frame turned over about x."""
    points = by_length(CIRCLE, 1e-3)
    R = points.R.copy()
    R[5] = R[5] @ np.diag([1.0, -1.0, -1.0])
    quality = judge(CIRCLE, Points(points.step, points.parameter, R, points.p))
    assert quality.least_dot == pytest.approx(-1.0, abs=2e-3)
    assert quality.turn == pytest.approx(np.pi, abs=0.1)
