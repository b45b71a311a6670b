"""Bounds on the third derivatives of contours, by finite differences of the second ones."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from dualarm_cli.model.curves.contours import Contour, Ellipse, Saddle, SphereArc
from dualarm_cli.model.curves.point_spline import PointSpline

STEP = 1e-6


def contour(kind: str, random: np.random.Generator) -> Contour:
    """A random contour of one kind, forwards or backwards, r + e up to 0.998 R."""
    start, span = random.uniform(-7.0, 7.0), random.choice([-1.0, 1.0]) * random.uniform(0.5, 6.28)
    R, reach, share = 0.05, random.uniform(0.1, 0.97), random.uniform(0.1, 0.9)
    r, e = R * reach * share, random.choice([-1.0, 1.0]) * R * reach * (1.0 - share)
    if kind == "saddle":
        return Saddle(R, r, random.uniform(0.3, 2.8), e, start, start + span)
    if kind == "arc":
        return SphereArc(R, r, random.uniform(-3.0, 3.0), e, start, start + span)
    return Ellipse((r, R - r), start, start + span)


def third(curve: Contour, t: np.ndarray) -> np.ndarray:
    """Length of the third derivative (k,) at parameters (k,)."""
    return np.linalg.norm(curve.second(t + STEP) - curve.second(t - STEP), axis=1) / (2.0 * STEP)


@pytest.mark.parametrize("kind", ["saddle", "arc", "ellipse"])
@pytest.mark.parametrize("half", [1e-4, 0.003, 0.03, 0.2])
def test_no_third_derivative_in_an_interval_is_above_its_bound(kind, half):
    """Sixty intervals of forty random contours each, looked at in 41 places."""
    random = np.random.default_rng(17)
    for _ in range(40):
        curve = contour(kind, random)
        t = random.uniform(half, 1.0 - half, 60)
        places = (t[:, None] + half * np.linspace(-1.0, 1.0, 41)).ravel()
        largest = third(curve, places).reshape(60, 41).max(axis=1)
        bound = curve.third_bound(t, np.full(60, half))
        assert (largest <= bound * (1.0 + 1e-6)).all()


@pytest.mark.parametrize("kind", ["saddle", "arc"])
def test_the_greatest_bound_of_a_whole_turn_is_less_than_twice_the_greatest_derivative(kind):
    """Without width all that is lost is that terms are added by size; r + e is half of R."""
    random = np.random.default_rng(18)
    t = np.linspace(0.0, 1.0, 721)
    for _ in range(20):
        angle, e = random.uniform(0.4, 2.7), random.choice([-1.0, 1.0]) * 0.005
        curve = (Saddle if kind == "saddle" else SphereArc)(0.05, 0.02, angle, e, 0.0, 2.0 * np.pi)
        assert curve.third_bound(t, np.zeros(721)).max() <= 2.0 * third(curve, t).max()


@pytest.mark.parametrize("pitch", [0.0, 0.02, -0.06])
@pytest.mark.parametrize("along", [0.0, 0.7, -3.0])
def test_a_normal_that_is_carried_along_a_helix_turns_against_its_torsion(pitch, along):
    """Of radius 50 mm and `pitch` per rad: in Frenet's frame it turns by -pitch / hypot(radius, pitch) per rad.

    Rotation-minimising vectors by hand; whatever of the first one is along the curve does not count.
    """
    radius, u = 0.05, np.linspace(0.0, 4.0, 60)
    size = np.hypot(radius, pitch)
    c, s, zero = np.cos(u), np.sin(u), np.zeros_like(u)
    points = np.stack([radius * c, radius * s, pitch * u], axis=1)
    tangent = np.stack([-radius * s, radius * c, zero + pitch], axis=1) / size
    inwards = np.stack([-c, -s, zero], axis=1)
    binormal = np.cross(tangent, inwards)
    angle = (0.4 - pitch / size * u)[:, None]
    expected = np.cos(angle) * inwards + np.sin(angle) * binormal
    spline = PointSpline(points, expected[0] + along * tangent[0])
    found = spline.normal(spline.knots)
    found = found / np.linalg.norm(found, axis=1)[:, None]
    np.testing.assert_allclose(found, expected, atol=2e-4)
    rate = spline.rate(spline.knots)
    assert np.abs((found * rate).sum(axis=1) / np.linalg.norm(rate, axis=1)).max() < 1e-6


@pytest.mark.parametrize("kind", ["saddle", "arc", "ellipse"])
def test_a_contour_ten_times_as_large_has_ten_times_the_lengths(kind):
    """Points, all derivatives and the bound of the third are lengths: any wrong power of a length shows."""
    random = np.random.default_rng(19)
    t, half = np.linspace(0.05, 0.95, 7), np.full(7, 0.02)
    for _ in range(10):
        curve = contour(kind, random)
        sizes = {
            name: tuple(10.0 * x for x in value) if isinstance(value, tuple) else 10.0 * value
            for name, value in vars(curve).items()
            if name.endswith("radius") or name in ("eccentricity", "semi_axes")
        }
        large = dataclasses.replace(curve, **sizes)
        for name in ("point", "rate", "second"):
            expected = 10.0 * getattr(curve, name)(t)
            np.testing.assert_allclose(getattr(large, name)(t), expected, rtol=1e-9, atol=1e-12)
        expected = 10.0 * curve.third_bound(t, half)
        np.testing.assert_allclose(large.third_bound(t, half), expected, rtol=1e-9)


@pytest.mark.parametrize("half", [0.0, 0.003, 0.1])
def test_bounds_of_third_derivatives_are_sums_of_sizes(half):
    """Of an arc z = sqrt(q(beta)), of a saddle x = f(y(beta)), term by term, each at its largest in the interval.

    q = R² - r² - e² - 2 r e cos beta has derivatives of up to 2 r e sin, 2 r e and 2 r e sin. f(y)² = R² - y² gives
    -y / x, -R² / x³ and -3 R² y / x⁵; y = r sin beta + e gives r cos, r and r cos.
    """
    random, t = np.random.default_rng(20), np.linspace(0.0, 1.0, 41)
    for _ in range(20):
        arc = contour("arc", random)
        turn, beta = abs(arc.end - arc.start), arc.start + t * (arc.end - arc.start)
        R, r, e = arc.main_radius, arc.branch_radius, arc.eccentricity
        q = R**2 - r**2 - e**2 - 2.0 * r * e * np.cos(beta)
        one = 2.0 * r * abs(e) * np.minimum(np.abs(np.sin(beta)) + half * turn, 1.0)
        two = 2.0 * r * abs(e)
        z = np.sqrt(np.maximum(q - one * half * turn, R**2 - (r + abs(e)) ** 2))
        size = one / (2.0 * z) + 3.0 * one * two / (4.0 * z**3) + 3.0 * one**3 / (8.0 * z**5)
        expected = np.hypot(r, size) * turn**3
        np.testing.assert_allclose(arc.third_bound(t, np.full(41, half)), expected, rtol=1e-9)
        saddle = contour("saddle", random)
        turn, beta = abs(saddle.end - saddle.start), saddle.start + t * (saddle.end - saddle.start)
        R, r, e = saddle.main_radius, saddle.branch_radius, saddle.eccentricity
        one = r * np.minimum(np.abs(np.cos(beta)) + half * turn, 1.0)
        y = np.minimum(np.abs(r * np.sin(beta) + e) + one * half * turn, r + abs(e))
        x = np.sqrt(R**2 - y**2)
        f = (y / x, R**2 / x**3, 3.0 * R**2 * y / x**5)
        along = f[2] * one**3 + 3.0 * f[1] * one * r + f[0] * one
        up = (along * abs(np.cos(saddle.angle)) + r) / abs(np.sin(saddle.angle))
        expected = np.sqrt(along**2 + r**2 + up**2) * turn**3
        np.testing.assert_allclose(saddle.third_bound(t, np.full(41, half)), expected, rtol=1e-9)


@pytest.mark.parametrize("half", [1e-4, 0.02, 0.2])
@pytest.mark.parametrize("closed", [False, True])
def test_no_third_derivative_of_a_spline_is_above_its_bound(half, closed):
    """Intervals up to both ends, over one knot and many, looked at in 201 places; at most ten times as large."""
    random, told = np.random.default_rng(21), 0.0
    for _ in range(20):
        points = np.cumsum(random.uniform(-0.02, 0.05, (random.integers(9, 14), 3)), axis=0)
        if closed:
            points[-1] = points[0]
        curve = PointSpline(points, np.array([0.0, 0.0, 1.0]), closed)
        t = np.concatenate([[0.0, half, 1.0 - half, 1.0], random.uniform(0.0, 1.0, 20)])
        places = np.clip(t[:, None] + half * np.linspace(-1.0, 1.0, 201), 2 * STEP, 1.0 - 2 * STEP)
        largest = third(curve, places.ravel()).reshape(len(t), -1).max(axis=1)
        bound = curve.third_bound(t, np.full(len(t), half))
        assert (largest <= bound * (1.0 + 1e-6) + 1e-4).all()
        told = max(told, float((largest / bound).max()))
    assert told > 0.9


@pytest.mark.parametrize("seed", range(30))
def test_ends_of_open_splines_do_not_hook(seed):
    """Curvature in the end spans is of the size of that inside, however uneven the points are."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(9, 30))
    angle = np.arange(count) * 2.0 * np.pi / count
    radius = rng.uniform(0.9, 1.1, count)
    ring = [0.06 * radius * np.cos(angle), 0.045 * radius * np.sin(angle), 0.0 * angle]
    ridge = [0.02 * np.arange(count), *rng.uniform(-0.005, 0.005, (2, count))]
    for points in (np.stack(ring, axis=1), np.stack(ridge, axis=1)):
        spline = PointSpline(points, np.array([0.0, 0.0, 1.0]))
        t = spline.knots

        def sharpest(low, high, spline=spline):
            at = np.linspace(low, high, 2000)
            rate = spline.rate(at)
            bend = np.linalg.norm(np.cross(rate, spline.second(at)), axis=1)
            return (bend / np.linalg.norm(rate, axis=1) ** 3).max()

        ends = max(sharpest(t[0], t[2]), sharpest(t[-3], t[-1]))
        assert ends < 4.0 * sharpest(t[2], t[-3])


@pytest.mark.parametrize("each", [False, True])
def test_a_spline_of_dense_points_takes_some_with_their_own_normals(each):
    """Of 961 points of a wave as few as tell the others, equally many apart; normals, one for all or one for each."""
    x = np.linspace(0.0, 1.0, 961)
    points = np.column_stack([x, 0.05 * np.sin(6.0 * x), np.zeros(961)])
    normals = np.column_stack([0.2 * x, np.zeros(961), np.ones(961)])
    spline = PointSpline.through(points, normals if each else normals[0], closed=False)
    k = np.rint(spline.points[:, 0] * 960).astype(int)
    assert len(k) <= 481
    np.testing.assert_array_equal(spline.points, points[k])
    np.testing.assert_array_equal(spline.up, normals[k] if each else normals[0])
    assert np.ptp(np.diff(k)) <= 1
