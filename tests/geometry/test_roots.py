"""Zeros of trigonometric polynomials."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dualarm_cli.geometry.roots import first_order_zeros, second_order_zeros, zeros_of_any_order


def value(coefficients, angle):
    """The polynomial itself, for coefficients 1, cos 1, sin 1, cos 2, ... and angles (n, k)."""
    total = np.repeat(coefficients[:, :1], angle.shape[1], axis=1)
    for m in range(1, coefficients.shape[1] // 2 + 1):
        total += coefficients[:, [2 * m - 1]] * np.cos(m * angle)
        total += coefficients[:, [2 * m]] * np.sin(m * angle)
    return total


def with_zeros(zeros, scale=1.0):
    """Second-order coefficients of the product of sin((phi - z) / 2) over four zeros (n, 4)."""
    # sin((p-a)/2) sin((p-b)/2) = (cos((a-b)/2) - cos(p - (a+b)/2)) / 2: the product of two such.
    a, b, c, d = zeros.T
    u1, u2, m1, m2 = np.cos((a - b) / 2), np.cos((c - d) / 2), (a + b) / 2, (c + d) / 2
    # (u1 - cos(p-m1)) (u2 - cos(p-m2)), expanded with cos x cos y = (cos(x-y) + cos(x+y)) / 2.
    f0 = u1 * u2 + np.cos(m1 - m2) / 2
    f1 = -u1 * np.cos(m2) - u2 * np.cos(m1)
    f2 = -u1 * np.sin(m2) - u2 * np.sin(m1)
    return scale * np.column_stack([f0, f1, f2, np.cos(m1 + m2) / 2, np.sin(m1 + m2) / 2])


def distance(a, b):
    """Distance on the circle."""
    return np.abs(np.mod(a - b + np.pi, 2 * np.pi) - np.pi)


def test_the_first_order_finds_known_zeros():
    """1 - 2 cos(phi) vanishes at ±60 degrees; 3 + cos has no zero; 0 + 0 cos has none to name."""
    angle, exists = first_order_zeros(
        np.array([1.0, 3.0, 0.0]), np.array([-2.0, 1.0, 0.0]), np.array([0.0, 0.0, 0.0])
    )
    wrapped = np.sort(np.mod(angle[0] + np.pi, 2 * np.pi) - np.pi)
    assert np.allclose(wrapped, [-np.pi / 3, np.pi / 3], atol=1e-12)
    assert exists.tolist() == [[True, True], [False, False], [False, False]]
    assert np.isfinite(angle).all()


@pytest.mark.parametrize("scale", [1.0, 1e-9, 1e9])
def test_the_second_order_finds_the_zeros_it_was_made_of(scale):
    """Polynomials are multiplied out from random zeros; the zeros come back, whatever the scale."""
    rng = np.random.default_rng(5)
    zeros = rng.uniform(-np.pi, np.pi, (20_000, 4))
    gap = np.min([distance(zeros[:, i], zeros[:, j]) for i in range(4) for j in range(i)], axis=0)
    zeros = zeros[gap > 0.02]
    angle, imaginary = second_order_zeros(with_zeros(zeros, scale))
    nearest = distance(angle[:, :, None], zeros[:, None, :]).min(axis=1)
    assert (imaginary == 0).all()
    # Zeros 0.02 apart: the condition number is about 1/0.02³, 1e5 times the rounding of 1e-16.
    assert nearest.max() < 1e-8


def test_a_double_zero_is_found_on_either_side_of_real():
    """Two equal zeros may come out as a nearly real pair; the pair is where the zero is."""
    rng = np.random.default_rng(6)
    zeros = np.array([-2.0, 0.5, 0.5, 2.0]) + rng.uniform(-0.3, 0.3, (5_000, 1))
    angle, imaginary = second_order_zeros(with_zeros(zeros))
    # Rounding of 1e-16 moves a double zero by its square root, times the polynomial's curvature.
    near = distance(angle, zeros[:, [1]]) < 1e-5
    assert (near.sum(axis=1) == 2).all()
    assert imaginary[near].max() < 1e-5


def test_degenerate_rows_give_numbers():
    """Vanishing rows, single harmonics and a vanishing chart value give no NaN and no warning."""
    rows = np.array(
        [
            [0.0, 0.0, 0.0, 0.0, 0.0],
            [1.0, 0.0, 0.0, 0.0, 0.0],
            [0.0, 1.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, 1.0, 0.0],
            [0.0, 0.0, 0.0, 0.0, 1.0],
            [1.0, 1.0, 0.0, 0.0, 0.0],
        ]
    )
    with np.errstate(all="raise"):
        angle, imaginary = second_order_zeros(rows)
    assert np.isfinite(angle).all()
    assert np.isfinite(imaginary).all()
    # cos 2 phi vanishes at ±45 and ±135 degrees, sin 2 phi at 0, ±90 and 180.
    assert np.allclose(np.cos(2 * angle[3]), 0.0, atol=1e-12)
    assert np.allclose(np.sin(2 * angle[4]), 0.0, atol=1e-12)


@given(
    st.lists(st.floats(-10, 10).map(lambda x: round(x, 6)), min_size=5, max_size=5).filter(
        lambda row: max(map(abs, row)) > 1e-3
    )
)
@settings(max_examples=300, deadline=None)
def test_closed_form_and_companion_matrix_agree_on_real_zeros(row):
    """Every real zero of either method makes the polynomial vanish, and they find as many."""
    coefficients = np.array([row])
    scale = np.abs(coefficients).max()
    angle, imaginary = second_order_zeros(coefficients)
    other, other_imaginary = zeros_of_any_order(coefficients)
    # The grid is crooked, so that no sample falls on a zero of a polynomial with simple coefficients.
    samples = np.linspace(-3.14, 3.14, 719)[None] + 0.00123
    f = value(coefficients, samples)[0]
    changes = int((f[:-1] * f[1:] < 0).sum())
    for zeros, imag in ((angle, imaginary), (other, other_imaginary)):
        real = zeros[imag < 1e-9]
        if real.size:
            assert np.abs(value(coefficients, real[None])).max() < 1e-6 * scale
        assert (imag < 1e-3).sum() >= min(changes, 4)


def test_the_third_order_finds_every_sign_change():
    """Eigenvalues find what a dense scan of 5,000 random third-order polynomials sees."""
    rng = np.random.default_rng(7)
    coefficients = rng.normal(size=(2_000, 7))
    angle, imaginary = zeros_of_any_order(coefficients)
    grid = np.linspace(-np.pi, np.pi, 1440, endpoint=False)
    f = value(coefficients, np.broadcast_to(grid, (len(coefficients), len(grid))))
    row, column = np.nonzero(f * np.roll(f, -1, axis=1) < 0)
    step = grid[1] - grid[0]
    ahead = np.mod(angle[row] - grid[column, None] + 1e-9, 2 * np.pi)
    assert ((ahead <= step + 2e-9) & (imaginary[row] < 1e-6)).any(axis=1).all()


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_zeros_in_every_direction_that_may_be_put_at_infinity_are_found(order):
    """sin(m phi) (2 + cos phi)^(order - m) has 2 m zeros, half a turn over m apart: also of a chart's spacing."""
    samples = np.arange(2 * order + 1) * (2 * np.pi / (2 * order + 1))
    basis = np.column_stack(
        [np.ones_like(samples)]
        + [wave(m * samples) for m in range(1, order + 1) for wave in (np.cos, np.sin)]
    )
    for m in range(1, order + 1):
        f = np.sin(m * samples) * (2.0 + np.cos(samples)) ** (order - m)
        angle, imaginary = zeros_of_any_order(np.linalg.solve(basis, f)[None])
        real = angle[0][imaginary[0] < 1e-9]
        expected = np.arange(2 * m) * (np.pi / m)
        assert len(real) == 2 * m
        assert distance(real[:, None], expected).min(axis=0).max() < 1e-9
