"""What a receiver makes of samples: brute force, and motions whose deviations are known by hand."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from scipy.interpolate import BPoly, CubicHermiteSpline

from dualarm_cli.formats.sampling import losses, sampled
from dualarm_cli.geometry.interpolation import INTERPOLATIONS, extrema, interpolated
from dualarm_cli.verification.measuring.tolerances import TOL


@pytest.mark.parametrize("degree", [0, 1, 2, 3, 4, 5])
def test_extrema_are_those_of_the_zeros_of_the_derivative(degree):
    """NumPy's polynomials on 200 random ones, each over an interval of its own."""
    rng = np.random.default_rng(degree)
    rows = rng.normal(size=(200, degree + 1, 1)) * 10.0 ** rng.integers(-3, 3, (200, degree + 1, 1))
    length = rng.uniform(0.1, 3.0, 200)
    low, high = extrema(rows, length)
    for row, end, least, most in zip(rows[:, :, 0], length, low[:, 0], high[:, 0], strict=True):
        curve = Polynomial(row)
        turns = curve.deriv().roots() if degree > 1 else np.array([])
        inside = [z.real for z in turns if abs(z.imag) < 1e-9 and 0 < z.real < end]
        values = curve(np.array([0.0, end, *inside]))
        scale = 1e-9 * np.abs(values).max()
        assert least == pytest.approx(values.min(), abs=scale)
        assert most == pytest.approx(values.max(), abs=scale)


def test_interpolation_is_scipys():
    """Hermite's cubic and quintic of random samples, between them."""
    rng = np.random.default_rng(3)
    time = np.cumsum(rng.uniform(0.01, 0.1, 20))
    rates = rng.normal(size=(3, 20, 2))
    at = np.linspace(time[0], time[-1], 500)
    cubic = interpolated("cubic", time, *rates).derivatives(at)
    expected = CubicHermiteSpline(time, rates[0], rates[1])
    for order in range(3):
        np.testing.assert_allclose(cubic[:, order], expected(at, order), atol=1e-7)
    quintic = interpolated("quintic", time, *rates).derivatives(at)
    expected = BPoly.from_derivatives(time, rates.transpose(1, 0, 2))
    for order in range(3):
        np.testing.assert_allclose(quintic[:, order], expected(at, order), rtol=1e-6, atol=1e-6)


def test_a_linear_receiver_cuts_a_parabola_by_an_eighth_of_a_h_squared(exported):
    """With constant acceleration a the chord of a step h is a h²/8 away from the motion, and nowhere more."""
    schedule = exported.schedule
    most = np.abs(schedule.trajectory.at(np.linspace(0, schedule.duration, 100_000))[2]).max()
    for rate in (50.0, 200.0):
        samples = sampled(schedule, rate)
        # The last step may be half as long again.
        step = np.diff(samples.time)
        worst = max(row.deviation for row in losses(schedule, samples, "linear"))
        assert worst > 0.5 * most * np.median(step) ** 2 / 8
        assert worst <= most * step.max() ** 2 / 8 * (1.0 + 1e-6)


@pytest.mark.parametrize(
    ("kind", "rate"), [*((kind, 100.0) for kind in INTERPOLATIONS), ("cubic", 250.0)]
)
def test_no_instant_deviates_more_than_is_said(exported, kind, rate):
    """By 100,000 instants: what is said is never less, and at most a hundredth more."""
    schedule = exported.schedule
    samples = sampled(schedule, rate)
    rows = losses(schedule, samples, kind)
    motion = interpolated(
        kind, samples.time, samples.position, samples.velocity, samples.acceleration
    )
    at = np.linspace(0.0, schedule.duration, 100_001)
    found = motion.derivatives(at)
    exact = schedule.trajectory.select(samples.joints).at(at)[0]
    limits = schedule.robot.limits.select(samples.joints)
    for k, row in enumerate(rows):
        seen = np.abs(found[:, 0, k] - exact[:, k]).max()
        assert seen <= row.deviation + 1e-14
        assert row.deviation <= 1.01 * seen + 1e-12
        speed = np.abs(found[:, 1, k]).max() / limits.velocity[k]
        assert speed <= row.velocity + 1e-9
        assert row.velocity <= 1.01 * speed + 1e-9


@pytest.mark.parametrize("rate", [100.0, 250.0])
def test_with_knots_cubic_interpolation_is_exact_and_keeps_limits(exported, rate):
    """Between knots the jerk is constant, so that Hermite's cubic is the motion itself, as exactly as that agrees."""
    schedule = exported.schedule
    for row in losses(schedule, sampled(schedule, rate, knots=True), "cubic"):
        assert row.deviation < TOL.position_agreement
        assert row.within_limits


def test_without_knots_a_hundred_hertz_exceed_limits_and_are_told(exported):
    """The acceleration of a cubic overshoots where the jerk changes within a step; on a coarse grid much more."""
    schedule = exported.schedule
    rows = losses(schedule, sampled(schedule, 20.0), "cubic")
    assert any(row.acceleration is not None and row.acceleration > 1.001 for row in rows)
    assert not all(row.within_limits for row in rows)


@pytest.mark.parametrize("rate", [0.01, 1.0, 333.0, 1000.0])
def test_samples_rise_from_the_start_to_the_end(exported, rate):
    """Whole nanoseconds, no step shorter than half of the grid's, the last one at the end."""
    samples = sampled(exported.schedule, rate)
    steps = np.diff(samples.nanoseconds)
    assert samples.nanoseconds[0] == 0
    assert samples.time[-1] == pytest.approx(exported.schedule.duration, abs=1.1e-9)
    assert (steps > 0).all()
    if len(steps) > 1:
        assert steps.min() >= 0.499 * 1e9 / rate
