"""Products, small systems and elementary functions of our own, against numpy's."""

from __future__ import annotations

import math
from itertools import accumulate

import numpy as np
import pytest
from scipy.interpolate import BSpline, CubicSpline, make_interp_spline
from scipy.spatial.transform import Rotation

from dualarm_cli.geometry import elementary
from dualarm_cli.geometry.linear_systems import (
    SingularMatrixError,
    determinant,
    inverse,
    least_squares,
    null_space,
    singular_values,
    solve,
    solve_banded,
    zeros_of,
)
from dualarm_cli.geometry.products import cross, norm, product
from dualarm_cli.geometry.splines import PoseSpline, closed_quintic_spline, quintic_spline
from dualarm_cli.native import LIBRARY

SHAPES = [
    ((3,), (3,)),
    ((3, 4), (4,)),
    ((3,), (3, 4)),
    ((3, 4), (4, 5)),
    ((9, 3, 3), (3,)),
    ((3,), (9, 3, 4)),
    ((5, 1, 3, 3), (7, 3, 3)),
    ((9, 4), (6, 4, 7)),
    ((0, 3, 3), (3, 3)),
    ((4, 0), (0, 5)),
]
MORE = [
    *SHAPES,
    ((70, 9), (9, 33)),
    ((400, 3, 3), (400, 3, 3)),
    ((40, 5), (30, 5, 7)),
    ((9000,), (9000,)),
]


@pytest.mark.parametrize("shapes", MORE)
def test_a_product_is_that_of_numpy(shapes):
    """Of vectors, matrices and stacks."""
    random = np.random.default_rng(1)
    a, b = (random.normal(size=shape) for shape in shapes)
    found = product(a, b)
    assert np.shape(found) == (a @ b).shape
    np.testing.assert_allclose(found, a @ b, atol=1e-12)


@pytest.mark.parametrize(
    "shapes", [((3,), (3,)), ((9, 3), (3,)), ((4, 1, 3), (5, 3)), ((0, 3), (3,))]
)
def test_a_vector_product_has_the_bits_of_numpys(shapes):
    """Of vectors and stacks."""
    random = np.random.default_rng(2)
    a, b = (random.normal(size=shape) for shape in shapes)
    np.testing.assert_array_equal(cross(a, b), np.cross(a, b))


def test_a_product_of_transposed_factors():
    """Factors that lie in memory column by column, and three of them."""
    a = np.arange(12.0).reshape(3, 4)
    np.testing.assert_array_equal(product(a.T, a), a.T @ a)
    np.testing.assert_array_equal(product(a, a.T, a), a @ a.T @ a)
    stack = np.arange(24.0).reshape(2, 3, 4)
    turned = np.swapaxes(stack, 1, 2)
    np.testing.assert_array_equal(product(stack, turned), stack @ turned)


def test_a_product_of_shapes_that_do_not_fit():
    """An error of numpy's kind, of sizes of 1 too: they are no scalars."""
    for one, other in (
        ((2, 3), (4, 2)),
        ((200, 3), (4, 200)),
        ((3, 1), (4, 2)),
        ((3,), (1, 4)),
        ((1,), (5,)),
    ):
        with pytest.raises(ValueError, match="mismatch"):
            product(np.ones(one), np.ones(other))


def test_functions_do_not_warn():
    """Of numbers outside their domain, or results beyond all floats, which are NaN and infinite."""
    with np.errstate(all="raise"):
        assert np.isnan(elementary.arccos(np.array([2.0, 0.5]))).tolist() == [True, False]
        assert elementary.exp(1000.0) == np.inf
        assert product([1e300], [1e300]) == np.inf


def test_a_norm_by_hand():
    """3, 4, 12: 5 and 13."""
    assert norm([3.0, 4.0]) == 5.0
    np.testing.assert_array_equal(norm([[3.0, 4.0], [5.0, 12.0]], axis=1), [5.0, 13.0])
    assert norm([[3.0, 4.0], [12.0, 0.0]]) == 13.0


X = np.linspace(-0.999, 0.999, 4001)
FUNCTIONS = {
    "sin": (math.sin, 40.0 * X),
    "cos": (math.cos, 40.0 * X),
    "arcsin": (math.asin, X),
    "arccos": (math.acos, X),
    "arctan": (math.atan, 9.0 * X),
    "exp": (math.exp, 9.0 * X),
    "log": (math.log, 1.0 + X),
    "tanh": (math.tanh, 3.0 * X),
    "cbrt": (np.cbrt, 9.0 * X),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_an_elementary_function_is_that_of_the_c_library(name):
    """Within two units of the last digit, for arrays of any shape and for numbers."""
    reference, x = FUNCTIONS[name]
    function = getattr(elementary, name)
    expected = np.array([reference(value) for value in x.tolist()])
    assert (np.abs(function(x) - expected) <= 2.0 * np.spacing(np.abs(expected))).all()
    np.testing.assert_array_equal(
        function(x[:-1].reshape(40, 100).T), function(x[:-1]).reshape(40, 100).T
    )
    assert isinstance(function(0.5), float)


def test_functions_of_two_numbers():
    """All quadrants; whole, broken and negative powers."""
    y, x = np.meshgrid(np.linspace(-2.0, 2.0, 41), np.linspace(-3.0, 3.0, 31))
    np.testing.assert_allclose(elementary.arctan2(y, x), np.arctan2(y, x), rtol=4e-16)
    powers = np.array([[-2.5], [-1.0], [0.0], [0.5], [3.0], [8.0]])
    base = np.linspace(0.1, 9.0, 50)
    np.testing.assert_allclose(elementary.power(base, powers), base**powers, rtol=1e-14)
    np.testing.assert_allclose(elementary.geometric(0.01, 100.0, 5), [0.01, 0.1, 1.0, 10.0, 100.0])


def test_complex_numbers():
    """(1 + 2i)(3 - i) = 5 + 5i, of angle 45 degrees and modulus sqrt 50."""
    z = elementary.complex_product(np.array([1.0 + 2.0j]), 3.0 - 1.0j)
    assert z == 5.0 + 5.0j
    assert elementary.angle_of(z) == math.pi / 4.0
    assert elementary.modulus(z) == math.sqrt(50.0)
    assert elementary.angle_between(2.0j, 3.0 + 0.0j) == math.pi / 2.0
    assert abs(elementary.unit_complex(0.3) - np.exp(0.3j)) < 1e-15


def test_the_library_calls_no_function_of_the_machines_math_library():
    """It would name it: its digits depend on the processor."""
    assert b"libm.so" not in LIBRARY.read_bytes()


@pytest.mark.parametrize("n", [1, 2, 3, 6, 9])
def test_square_systems(n):
    """Solutions, inverses and determinants as LAPACK has them."""
    random = np.random.default_rng(n)
    A, B = random.normal(size=(30, n, n)), random.normal(size=(30, n, 2))
    np.testing.assert_allclose(A @ solve(A, B), B, atol=1e-9)
    np.testing.assert_allclose(A[0] @ solve(A[0], B[0, :, 0]), B[0, :, 0], atol=1e-10)
    np.testing.assert_allclose(inverse(A) @ A, np.broadcast_to(np.eye(n), A.shape), atol=1e-9)
    np.testing.assert_allclose(determinant(A), np.linalg.det(A), rtol=1e-10)


def test_singular_systems():
    """The determinant is 0; there is no solution, but a shortest one in the sense of least squares."""
    A = np.array([[1.0, 1.0], [1.0, 1.0]])
    assert determinant(A) == 0.0
    with pytest.raises(SingularMatrixError):
        solve(A, np.ones(2))
    np.testing.assert_allclose(least_squares(A, np.array([1.0, 3.0])), [1.0, 1.0], atol=1e-15)
    # A zero pivot is no reason to give up.
    np.testing.assert_allclose(
        solve(np.array([[0.0, 1.0], [2.0, 0.0]]), np.array([3.0, 8.0])), [4.0, 3.0]
    )


@pytest.mark.parametrize("shape", [(20, 6, 7), (20, 6, 6), (20, 7, 3), (2, 3, 4, 5)])
def test_singular_values(shape):
    """As LAPACK has them."""
    A = np.random.default_rng(2).normal(size=shape)
    np.testing.assert_allclose(singular_values(A), np.linalg.svd(A, compute_uv=False), rtol=1e-10)


def test_a_null_space():
    """Orthonormal, and mapped to zero, of matrices of less than full rank too."""
    A = np.random.default_rng(3).normal(size=(20, 6, 8))
    A[:10, 5] = A[:10, 4]
    rows = null_space(A)
    assert rows.shape == (20, 2, 8)
    np.testing.assert_allclose(A @ np.swapaxes(rows, 1, 2), 0.0, atol=1e-13)
    np.testing.assert_allclose(
        rows @ np.swapaxes(rows, 1, 2), np.broadcast_to(np.eye(2), (20, 2, 2)), atol=1e-14
    )


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_zeros_of_polynomials(scale):
    """t² = s² has the zeros ± s, t² + s² none that is real; (t - 1)(t - 2)(t - 3), and pairs of complex ones."""
    real, imaginary = zeros_of(np.array([[-scale * scale, 0.0], [scale * scale, 0.0]]))
    np.testing.assert_allclose(
        np.sort(real, axis=1), [[-scale, scale], [0.0, 0.0]], atol=1e-14 * scale
    )
    np.testing.assert_allclose(
        np.sort(imaginary, axis=1), [[0.0, 0.0], [-scale, scale]], atol=1e-14 * scale
    )
    real, imaginary = zeros_of(np.array([[-6.0, 11.0, -6.0]]))
    np.testing.assert_allclose(np.sort(real[0]), [1.0, 2.0, 3.0], rtol=1e-13)
    pairs = np.array([0.5 + 1.0j, 0.5 - 1.0j, -2.0 + 0.1j, -2.0 - 0.1j])
    real, imaginary = zeros_of(np.poly(pairs).real[:0:-1][None])
    found = (real + 1j * imaginary)[0]
    assert np.abs(found[:, None] - pairs).min(axis=0).max() < 1e-12


@pytest.mark.parametrize("n", [6, 7, 30])
def test_a_quintic_spline_is_that_of_scipy(n):
    """Whose polynomials beside the ends are one, with rates at the ends, and with free ends."""
    random = np.random.default_rng(n)
    x, y = np.cumsum(random.uniform(0.5, 1.5, n)), random.normal(size=(n, 3))
    rates = [[(order, random.normal(size=3)) for order in (1, 2)] for _ in range(2)]
    free = [(2, np.zeros(3)), (4, np.zeros(3))]
    at = np.linspace(x[0], x[-1], 200)
    for ends in ((), rates, (free, free)):
        expected = make_interp_spline(x, y, k=5, bc_type=tuple(ends) or None)
        np.testing.assert_allclose(quintic_spline(x, y, *ends)(at), expected(at), atol=1e-12)


@pytest.mark.parametrize("n", [3, 4, 7, 60])
def test_a_closed_quintic_spline_passes_its_values_and_closes(n):
    """With its first four derivatives; as scipy's where that one is not for few values."""
    random = np.random.default_rng(n)
    x, y = np.cumsum(random.uniform(0.2, 2.0, n + 1)), random.normal(size=(n + 1, 3))
    y[-1] = y[0]
    found = closed_quintic_spline(x, y)
    np.testing.assert_allclose(found(x), y, atol=1e-12)
    near = BSpline(found.t, found.c, 5)
    for order in range(5):
        ends = near(x[0], order), near(x[-1], order)
        np.testing.assert_allclose(*ends, rtol=1e-9, atol=1e-9)
    if n > 5:
        at = np.linspace(x[0], x[-1], 300)
        expected = make_interp_spline(x, y, k=5, bc_type="periodic")
        np.testing.assert_allclose(found(at), expected(at), atol=1e-11)


def test_a_banded_system():
    """As the same system in full."""
    random = np.random.default_rng(4)
    full = 8.0 * np.eye(9) + np.tril(np.triu(random.normal(size=(9, 9)), -2), 2)
    rows = np.array([np.pad(full, ((0, 0), (2, 2)))[i, i : i + 5] for i in range(9)])
    right = random.normal(size=(9, 2))
    np.testing.assert_allclose(full @ solve_banded(rows, right), right, atol=1e-13)


@pytest.mark.parametrize(("count", "turn"), [(2, 1.0), (3, 3.0), (8, 2.5), (8, 1e-3), (200, 0.05)])
def test_a_spline_of_poses_is_smooth_and_natural(count, turn):
    """Positions as scipy's natural spline; turning by differences: its rate, C2 at every pose, at rest at the ends.

    Rotations are compared with Rodrigues' formula in scipy; a change of the acceleration within 1e-4 is no jump.
    """
    random = np.random.default_rng(count)
    x = np.cumsum(random.uniform(0.2, 1.0, count))
    axes = random.normal(size=(count, 3))
    axes *= (
        turn * random.uniform(0.3, 1.0, (count, 1)) / np.linalg.norm(axes, axis=1, keepdims=True)
    )
    turns = Rotation.from_rotvec(axes)
    R = np.stack([one.as_matrix() for one in accumulate(turns, lambda a, b: a * b)])
    p = random.normal(size=(count, 3))
    found, at = PoseSpline.through(x, R, p), np.linspace(x[0] + 1e-5, x[-1] - 1e-5, 501)
    np.testing.assert_allclose(found.at(x)[0], R, atol=1e-14)
    if count > 2:
        expected = CubicSpline(x, p, bc_type="natural")
        np.testing.assert_allclose(found.at(at)[1], expected(at), atol=1e-12)
        np.testing.assert_allclose(found.rates(at)[1], expected(at, 1), atol=1e-11)
    before, after = found.at(at - 1e-6)[0], found.at(at + 1e-6)[0]
    rate = Rotation.from_matrix(np.swapaxes(before, 1, 2) @ after).as_rotvec() / 2e-6
    largest = np.abs(rate).max()
    np.testing.assert_allclose(found.rates(at)[0], rate, atol=1e-7 * largest + 1e-9)
    step = 1e-4
    rates = found.rates(np.add.outer([-step, 0.0, step], x[1:-1]).ravel())[0].reshape(3, -1, 3)
    assert np.abs(rates[2] - 2.0 * rates[1] + rates[0]).max(initial=0.0) < 100.0 * step**2 * largest
    for end, inside in ((x[0], x[0] + step), (x[-1], x[-1] - step)):
        change = found.rates(np.array([end]))[0] - found.rates(np.array([inside]))[0]
        assert np.abs(change).max() < 100.0 * step**2 * largest
