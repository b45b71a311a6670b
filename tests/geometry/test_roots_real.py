"""All real zeros of trigonometric polynomials, enclosed."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dualarm_cli.geometry.roots import derivative, polynomial_value, real_zeros


def with_zeros(zeros):
    """Coefficients of the product of sin((phi - z) / 2) over 2k zeros (n, 2k), by interpolation."""
    count = zeros.shape[1]
    samples = np.arange(count + 1) * (2 * np.pi / (count + 1))
    f = np.prod(np.sin((samples[None, :, None] - zeros[:, None, :]) / 2), axis=2)
    # 2k + 1 equidistant samples determine order k: the discrete Fourier sums.
    columns = [f.mean(axis=1)]
    for m in range(1, count // 2 + 1):
        columns += [2 * (f * np.cos(m * samples)).mean(axis=1)]
        columns += [2 * (f * np.sin(m * samples)).mean(axis=1)]
    return np.column_stack(columns)


def distance(a, b):
    """Distance on the circle."""
    return np.abs(np.mod(a - b + np.pi, 2 * np.pi) - np.pi)


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("scale", [1.0, 1e-200, 1e200])
def test_the_zeros_a_polynomial_is_made_of_come_back_in_order(order, scale):
    """Random zeros at least 0.05 apart, whatever the scale of the coefficients."""
    rng = np.random.default_rng(order)
    zeros = np.sort(rng.uniform(-np.pi, np.pi, (5_000, 2 * order)), axis=1)
    gap = np.diff(np.column_stack([zeros, zeros[:, 0] + 2 * np.pi]), axis=1).min(axis=1)
    zeros = zeros[gap > 0.05]
    found = real_zeros(scale * with_zeros(zeros))
    assert found.exists.all()
    assert (np.diff(found.angle, axis=1) > 0).all()
    # Six zeros 0.05 apart have a slope of 0.025⁵ = 1e-8 at least, so 1e-16 of rounding moves one by 1e-8.
    nearest = distance(found.angle[:, :, None], zeros[:, None, :]).min(axis=2)
    assert nearest.max() < 1e-7
    assert np.median(nearest) < 1e-14


@pytest.mark.parametrize("order", [2, 3])
def test_a_double_zero_is_one_or_two_or_none_as_its_height_says(order):
    """Touching the axis: once. Pushed through it by 1e-9: a close pair. Lifted off it: nothing."""
    rng = np.random.default_rng(9)
    double = rng.uniform(-3.0, 3.0, 500)
    others = double[:, None] + np.linspace(1.5, 4.5, 2 * order - 2)
    exact = with_zeros(np.column_stack([double, double, others]))
    bend = polynomial_value(derivative(derivative(exact)), double[:, None])[:, 0]
    for lift, count in ((-1e-9, 2), (0.0, None), (1e-9, 0)):
        moved = exact.copy()
        moved[:, 0] += lift * np.sign(bend)
        found = real_zeros(moved)
        near = found.exists & (distance(found.angle, double[:, None]) < 1e-2)
        if count is None:
            assert ((near.sum(axis=1) == 1) | (near.sum(axis=1) == 2)).mean() > 0.5
            assert (near.sum(axis=1) <= 2).all()
        else:
            assert (near.sum(axis=1) == count).all()
        if count == 2:
            # f = lift + bend/2 d²: the pair is sqrt(2 lift / bend) to either side.
            offset = distance(found.angle, double[:, None])[near].reshape(-1, 2)
            expected = np.sqrt(2e-9 / np.abs(bend))
            assert np.allclose(offset, expected[:, None], rtol=1e-2)


def test_rows_that_vanish_and_constants_list_no_zeros():
    """0 is zero everywhere and lists none; 3 is zero nowhere; cos is zero twice."""
    rows = np.zeros((4, 7))
    rows[1, 0] = 3.0
    rows[2, 1] = 1.0
    rows[3] = 5e-324
    with np.errstate(divide="raise", invalid="raise", over="raise"):
        found = real_zeros(rows)
    assert found.exists.sum(axis=1).tolist() == [0, 0, 2, 0]
    assert np.allclose(found.angle[2, :2], [-np.pi / 2, np.pi / 2], atol=1e-15)
    assert (found.angle[~found.exists] == 0.0).all()


def test_a_zero_at_half_a_turn_is_plus_pi_and_listed_once():
    """sin(phi) vanishes at 0 and pi; -pi is outside of (-pi, pi]."""
    found = real_zeros(np.array([[0.0, 0.0, 1.0]]))
    assert np.allclose(found.angle, [[0.0, np.pi]], atol=1e-15)
    # (1 + cos)(2 - cos) and its like touch zero at pi from either side.
    for row in ([1.5, 1.0, 0.0, -0.5, 0.0], [-1.5, -1.0, 0.0, 0.5, 0.0], [1.0, 1.0, 0.0]):
        touch = real_zeros(np.array([row]))
        zeros = touch.angle[touch.exists]
        assert np.allclose(np.abs(zeros), np.pi, atol=1e-6)
        assert (zeros > -np.pi).all()
        assert (zeros <= np.pi).all()


def test_no_rows_give_no_zeros():
    """Shapes stay."""
    assert real_zeros(np.zeros((0, 5))).angle.shape == (0, 4)


numbers = st.one_of(st.floats(-10, 10), st.sampled_from([0.0, 1.0, -1.0]), st.floats(-1e-12, 1e-12))


@given(st.sampled_from([3, 5, 7]).flatmap(lambda w: st.lists(numbers, min_size=w, max_size=w)))
@settings(max_examples=500, deadline=None)
def test_every_sign_change_is_listed_and_everything_listed_is_a_zero(row):
    """Against 2,001 samples; coefficients of very different sizes, zeros and ones among them."""
    coefficients = np.array([row])
    scale = np.abs(coefficients).max()
    with np.errstate(divide="raise", invalid="raise", over="raise"):
        found = real_zeros(coefficients)
    assert np.isfinite(found.angle).all()
    zeros = found.angle[found.exists]
    samples = np.linspace(-np.pi, np.pi, 2002) + 0.000123
    f = polynomial_value(coefficients, samples[None])[0]
    # Where the samples themselves are rounding noise a change of sign means nothing.
    sure = np.abs(f) > 1e-13 * scale
    change = np.flatnonzero((f[:-1] * f[1:] < 0) & sure[:-1] & sure[1:])
    for k in change:
        ahead = np.mod(zeros - samples[k], 2 * np.pi)
        assert (ahead <= samples[1] - samples[0] + 1e-12).any()
    if zeros.size:
        assert np.abs(polynomial_value(coefficients, zeros[None])).max() <= 1e-13 * scale


def test_value_and_derivative_agree_with_the_definition_and_finite_differences():
    """Order three at random angles."""
    rng = np.random.default_rng(4)
    f, phi = rng.normal(size=(50, 7)), rng.uniform(-4, 4, (50, 3))
    expected = f[:, :1] + sum(
        f[:, [2 * m - 1]] * np.cos(m * phi) + f[:, [2 * m]] * np.sin(m * phi) for m in (1, 2, 3)
    )
    assert np.allclose(polynomial_value(f, phi), expected, atol=1e-13)
    h = 1e-6
    slope = (polynomial_value(f, phi + h) - polynomial_value(f, phi - h)) / (2 * h)
    assert np.allclose(polynomial_value(derivative(f), phi), slope, atol=1e-7)
