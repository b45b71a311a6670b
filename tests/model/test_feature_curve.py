"""Feature curves: on the surfaces that they are of, with frames that never flip, as long as other ways say."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp
from scipy.special import ellipe

from dualarm_cli.model.curves.contours import Ellipse, LineContour, Saddle, SphereArc
from dualarm_cli.model.curves.feature_curve import (
    FeatureCurve,
    PoseCurve,
    contour_frames,
    least_lean,
    sharpest_bend,
    sharpest_roll,
)
from dualarm_cli.model.curves.point_spline import PointSpline

HERE = pin.SE3.Identity()
TURN = 2.0 * np.pi
T = np.linspace(0.0, 1.0, 241)
RANDOM = settings(max_examples=40, deadline=None, derandomize=True)

radii = st.floats(0.01, 0.3)
shares = st.floats(0.05, 0.9)
slants = st.floats(0.2, np.pi - 0.2)
begins = st.floats(-7.0, 7.0)
spans = st.floats(0.3, TURN) | st.floats(-TURN, -0.3)


@st.composite
def saddles(draw):
    """Pipes that meet all round: r + e is at most 0.95 R."""
    R, r = draw(radii), draw(shares)
    e = draw(st.floats(-1.0, 1.0)) * (0.95 - r)
    start = draw(begins)
    return Saddle(R, r * R, draw(slants), e * R, start, start + draw(spans))


@st.composite
def arcs(draw):
    """Tubes that meet a ball all round."""
    R, r = draw(radii), draw(shares)
    e = draw(st.floats(-1.0, 1.0)) * (0.95 - r)
    start = draw(begins)
    return SphereArc(R, r * R, draw(st.floats(-3.0, 3.0)), e * R, start, start + draw(spans))


@st.composite
def ellipses(draw):
    """Seen from above or from outside."""
    start = draw(begins)
    axes = (draw(radii), draw(radii))
    return Ellipse(axes, start, start + draw(spans), draw(st.booleans()))


@st.composite
def splines(draw):
    """Eight points of a bent line in space that never turns back, with a normal carried along, or normals given."""
    seed = draw(st.integers(0, 10_000))
    rng = np.random.default_rng(seed)
    x = np.cumsum(rng.uniform(0.05, 0.1, 8))
    points = np.column_stack([x, rng.uniform(-0.03, 0.03, (8, 2))])
    up = np.array([0.1, 0.2, 1.0])
    return PointSpline(points, up if seed % 2 else up + rng.uniform(-0.2, 0.2, (8, 3)))


contours = saddles() | arcs() | ellipses() | splines()


@RANDOM
@given(saddles())
def test_a_saddle_lies_on_both_pipes(saddle):
    """Distance from the z axis is R; from the branch pipe's axis, by e along y and turned about y by the angle, r."""
    p = saddle.point(T)
    assert np.hypot(p[:, 0], p[:, 1]) == pytest.approx(saddle.main_radius, rel=1e-12)
    axis = np.array([np.sin(saddle.angle), 0.0, np.cos(saddle.angle)])
    off = np.cross(p - [0.0, saddle.eccentricity, 0.0], axis)
    assert np.linalg.norm(off, axis=1) == pytest.approx(saddle.branch_radius, rel=1e-9)
    # The branch comes out on the side of +x, and the normal is that of the main pipe.
    assert p[:, 0].min() > 0.0
    assert saddle.normal(T) == pytest.approx(p * [1.0, 1.0, 0.0])


@RANDOM
@given(arcs())
def test_an_arc_lies_on_ball_and_tube(arc):
    """Distance from the origin is R; from the tube's axis, by e along x and turned about x by the angle, r."""
    p = arc.point(T)
    assert np.linalg.norm(p, axis=1) == pytest.approx(arc.main_radius, rel=1e-12)
    axis = np.array([0.0, -np.sin(arc.angle), np.cos(arc.angle)])
    off = np.cross(p - [arc.eccentricity, 0.0, 0.0], axis)
    assert np.linalg.norm(off, axis=1) == pytest.approx(arc.branch_radius, rel=1e-9)
    assert (p @ axis).min() > 0.0
    assert arc.normal(T) == pytest.approx(p)


@RANDOM
@given(contours)
def test_derivatives_are_those_of_differences(contour):
    """First and second, by central differences of the points and of the first ones; bounds hold for the third."""
    t, h = np.linspace(0.01, 0.99, 57), 1e-5
    scale = np.abs(contour.rate(t)).max()
    first = (contour.point(t + h) - contour.point(t - h)) / (2.0 * h)
    assert contour.rate(t) == pytest.approx(first, abs=1e-5 * scale)
    second = (contour.rate(t + h) - contour.rate(t - h)) / (2.0 * h)
    size = np.abs(contour.second(t)).max() + scale
    # A spline's second derivative has kinks at its points.
    assert contour.second(t) == pytest.approx(second, abs=1e-3 * size)
    half = np.full(len(t), 0.008)
    bound = contour.third_bound(t, half)
    for share in np.linspace(-1.0, 1.0, 21):
        change = np.linalg.norm(contour.second(t + share * half) - contour.second(t), axis=1)
        assert (change <= bound * abs(share) * half * (1.0 + 1e-9) + 1e-9 * size).all()


@pytest.mark.parametrize("share", [0.5, 0.9, 0.999])
def test_the_third_derivative_s_bound_is_not_idle(share):
    """On narrow cells it is near what differences of the second derivative give, also where pipes only just meet."""
    for contour in (
        Saddle(0.05, 0.05 * share, 1.2, 0.0, 0.0, TURN),
        SphereArc(0.05, 0.025, 0.4, 0.05 * share - 0.025, 0.0, TURN),
    ):
        t, h = np.linspace(0.001, 0.999, 4001), 1e-6
        third = np.linalg.norm(contour.second(t + h) - contour.second(t - h), axis=1) / (2.0 * h)
        bound = contour.third_bound(t, np.full(len(t), 1e-7))
        assert (bound >= third * (1.0 - 1e-3)).all()
        # Absolute values of terms that partly cancel, but never much more than the largest.
        assert bound.max() <= 4.0 * third.max()


@RANDOM
@given(contours)
def test_frames_are_rotations_with_x_along_and_z_out_and_never_flip(contour):
    """The z axis is the normal without its part along the curve; neighbours turn by little."""
    assume(least_lean(contour) > 0.02)
    t = np.linspace(0.0, 1.0, 2001)
    R = contour_frames(contour, t)
    assert R.swapaxes(1, 2) @ R == pytest.approx(np.broadcast_to(np.eye(3), R.shape), abs=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)
    x, y, z = np.moveaxis(R, 2, 0)
    rate, normal = contour.rate(t), contour.normal(t)
    assert (x * rate).sum(axis=1) == pytest.approx(np.linalg.norm(rate, axis=1))
    assert np.cross(z, x) == pytest.approx(y, abs=1e-12)
    # In the plane of curve and normal, on the normal's side.
    assert (y * normal).sum(axis=1) == pytest.approx(0.0, abs=1e-12 * np.abs(normal).max())
    assert (z * normal).sum(axis=1).min() > 0.0
    assert (R[1:] * R[:-1]).sum(axis=1).min() > 0.5


@RANDOM
@given(saddles() | arcs() | ellipses())
def test_lengths_are_scipy_s_integrals_and_steps_equal(contour):
    """The whole, and ten equal parts of it, each integrated anew."""
    curve = FeatureCurve(contour, HERE)

    def speed(t):
        return float(np.linalg.norm(contour.rate(np.array([t]))))

    edges = curve.arc.at(np.linspace(0.0, curve.length, 11))
    parts = [quad(speed, a, b, epsabs=1e-13, epsrel=1e-11)[0] for a, b in pairwise(edges)]
    assert sum(parts) == pytest.approx(curve.length, rel=1e-9)
    assert parts == pytest.approx([curve.length / 10] * 10, rel=1e-8)


def test_pipes_that_only_just_meet_are_as_exact():
    """10 um from the main pipe's side the saddle nearly has a corner: equal parts around it by scipy, to 1e-11 m."""
    contour = Saddle(0.05, 0.04999, np.pi / 2, 0.0, 0.0, TURN)
    curve = FeatureCurve(contour, HERE)

    def speed(t):
        return float(np.linalg.norm(contour.rate(np.array([t]))))

    s = curve.length / 4 + np.linspace(-0.003, 0.003, 41)
    edges = curve.arc.at(s)
    parts = [quad(speed, a, b, epsabs=1e-14, epsrel=1e-12)[0] for a, b in pairwise(edges)]
    assert parts == pytest.approx([0.006 / 40] * 40, abs=1e-11)


def test_table_2_s_curves():
    """[Qin2024] Table 2: the saddle of 50 and 45 mm; the arc of 20 mm on the ball of 50 mm is a circle at 45.8 mm."""
    saddle = FeatureCurve(Saddle(0.05, 0.045, np.pi / 2, 0.0, 0.0, TURN), HERE)
    # Eq. 12 with alpha = 90 deg and e = 0: (sqrt(R² - r² sin²), r sin, -r cos).
    speed = quad(
        lambda b: np.hypot(
            0.045, 0.045**2 * np.sin(b) * np.cos(b) / np.sqrt(0.05**2 - (0.045 * np.sin(b)) ** 2)
        ),
        0.0,
        np.pi / 2,
        epsabs=1e-14,
    )[0]
    assert saddle.length == pytest.approx(4.0 * speed, rel=1e-10)
    assert round(saddle.length, 5) == 0.30874
    arc = FeatureCurve(SphereArc(0.05, 0.02, 0.0, 0.0, 0.0, TURN), HERE)
    assert arc.length == pytest.approx(0.04 * np.pi, rel=1e-12)
    R, p = arc.at(np.linspace(0.0, arc.length, 9))
    assert p[:, 2] == pytest.approx(np.sqrt(0.05**2 - 0.02**2))
    # z is the ball's normal: it leans outwards by arcsin(20 / 50).
    assert R[:, 2, 2] == pytest.approx(np.sqrt(1.0 - 0.4**2))


def test_saddle_at_beta_0_by_hand():
    """R = 50, r = 30 mm, e = 0, perpendicular: (50, 0, -30) mm, then along +y; z is +x, so y = z cross x = +z."""
    R, p = FeatureCurve(Saddle(0.05, 0.03, np.pi / 2, 0.0, 0.0, TURN), HERE).at(np.array([0.0]))
    assert p[0] == pytest.approx([0.05, 0.0, -0.03], abs=1e-15)
    assert R[0] == pytest.approx(
        np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), abs=1e-15
    )


def test_an_ellipse_from_above_and_from_outside():
    """4 a E; a quarter of the way is a quarter around; z is up or outward; half of it is half as long."""
    above = FeatureCurve(Ellipse((0.1, 0.06), 0.0, TURN), HERE)
    whole = 0.4 * ellipe(1.0 - 0.36)
    assert above.length == pytest.approx(whole, rel=1e-12)
    R, p = above.at(np.array([0.25, 0.5]) * whole)
    assert p == pytest.approx(np.array([[0.0, 0.06, 0.0], [-0.1, 0.0, 0.0]]), abs=1e-11)
    assert R[:, :, 2] == pytest.approx(np.array([[0.0, 0.0, 1.0]] * 2))
    outside = FeatureCurve(Ellipse((0.1, 0.06), 0.0, np.pi, outward=True), HERE)
    assert outside.length == pytest.approx(0.5 * whole, rel=1e-12)
    R, _ = outside.at(np.array([0.5 * outside.length]))
    # At the top: along -x, out +y, so that y = z x x = +y cross -x = +z.
    assert R[0] == pytest.approx(
        np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]), abs=1e-11
    )


@RANDOM
@given(saddles() | arcs() | ellipses(), st.floats(0.0, 1.0))
def test_a_reversed_curve_is_the_same_curve_from_its_end(contour, share):
    """Same points and normals, x and y the other way."""
    kind, values = type(contour), dict(vars(contour))
    values |= {"start": contour.end, "end": contour.start}
    one, other = FeatureCurve(contour, HERE), FeatureCurve(kind(**values), HERE)
    assert other.length == pytest.approx(one.length, rel=1e-12)
    R, p = one.at(np.array([share * one.length]))
    S, q = other.at(np.array([(1.0 - share) * other.length]))
    assert q == pytest.approx(p, abs=1e-9)
    assert pytest.approx(R @ np.diag([-1.0, -1.0, 1.0]), abs=1e-6) == S


def test_the_curve_s_own_pose_places_points_and_frames():
    """A line of 0.2 m along x, turned by 90 degrees about z and moved."""
    place = pin.SE3(pin.utils.rotate("z", np.pi / 2), np.array([1.0, 2.0, 3.0]))
    line = LineContour(np.zeros(3), np.array([0.2, 0.0, 0.0]), np.array([0.3, 0.0, 5.0]))
    curve = FeatureCurve(line, place)
    R, p = curve.at(np.array([0.05]))
    assert curve.length == pytest.approx(0.2, rel=1e-13)
    assert p[0] == pytest.approx([1.0, 2.05, 3.0])
    assert R[0] == pytest.approx(
        np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), abs=1e-12
    )


def test_a_carried_normal_turns_no_more_than_the_curve_bends():
    """Against the equation of rotation-minimising frames, u' = -(u . x') x, integrated by scipy."""
    angle = np.linspace(0.0, 4.0, 25)
    helix = np.column_stack([0.1 * np.cos(angle), 0.1 * np.sin(angle), 0.05 * angle])
    contour = PointSpline(helix, np.array([1.0, 0.2, 0.1]))

    def tangent(t):
        rate = contour.rate(np.array([t]))[0]
        return rate / np.linalg.norm(rate)

    def change(t, u):
        rate, bend = contour.rate(np.array([t]))[0], contour.second(np.array([t]))[0]
        size = np.linalg.norm(rate)
        turning = (bend - (bend @ rate) / size**2 * rate) / size
        return -(u @ turning) * rate / size

    x = tangent(0.0)
    up = contour.up - (contour.up @ x) * x
    found = solve_ivp(change, (0.0, 1.0), up / np.linalg.norm(up), rtol=1e-10, atol=1e-12)
    z = contour_frames(contour, np.array([1.0]))[0, :, 2]
    assert z == pytest.approx(found.y[:, -1], abs=1e-5)


def test_normals_of_a_spline_count_by_their_direction_alone():
    """A normal that is a thousand times longer changes nothing."""
    points = np.array([[0.0, 0, 0], [0.1, 0.01, 0], [0.2, 0, 0.01], [0.3, 0, 0]])
    up = np.array([[0.0, 0.1, 1], [0, 0, 1], [0, -0.2, 1], [0, 0, 1]])
    longer = up * np.array([[1.0], [1000.0], [1e-3], [5.0]])
    one, other = (contour_frames(PointSpline(points, normals), T) for normals in (up, longer))
    assert one == pytest.approx(other, abs=1e-12)
    # At the points themselves z is the normal that is given, without its part along the curve.
    contour = PointSpline(points, up)
    assert np.cross(contour.normal(contour.knots), up) == pytest.approx(0.0, abs=1e-12)


def test_a_closed_spline_is_smooth_where_it_closes():
    """Direction and curvature at both ends agree, also where the last point is 4 um off the first."""
    angle = np.linspace(0.0, TURN, 9)
    points = np.column_stack([0.1 * np.cos(angle), 0.06 * np.sin(angle), 0.01 * np.cos(2 * angle)])
    points[-1] += 4e-6
    up = np.array([0.0, 0.0, 1.0])
    ends = np.array([0.0, 1.0])
    for derivative in ("point", "rate", "second"):
        first, last = getattr(PointSpline(points, up, closed=True), derivative)(ends)
        assert first == pytest.approx(last, abs=1e-12), derivative
    first, last = PointSpline(points, up).rate(ends)
    assert np.abs(first - last).max() > 1e-3
    # The points are on it.
    closed = PointSpline(points, up, closed=True)
    assert closed.point(closed.knots[:-1]) == pytest.approx(points[:-1], abs=1e-12)
    assert closed.point(ends[1:])[0] == pytest.approx(points[0], abs=1e-12)


def test_normals_that_close_but_for_rounding_are_smooth_where_they_close():
    """Nine normals round a ring that lean outward; the last differs from the first by 1e-9."""
    turn = np.linspace(0.0, TURN, 9)
    points = 0.1 * np.column_stack([np.cos(turn), np.sin(turn), np.zeros(9)])
    points[-1] = points[0]
    up = np.column_stack([np.cos(turn), np.sin(turn), np.ones(9)])
    up[-1] = up[0] + 1e-9
    spline = PointSpline(points, up, closed=True)
    given = up / np.linalg.norm(up, axis=1)[:, None]
    assert spline.normal(spline.knots[:-1]) == pytest.approx(given[:-1], abs=1e-8)
    h = 1e-4
    around = spline.normal(np.array([1.0 - h, 1.0, 0.0, h]))
    assert around[1] == pytest.approx(around[2], abs=1e-12)
    assert (around[1] - around[0]) / h == pytest.approx((around[3] - around[2]) / h, abs=0.01)


def test_normals_of_a_closed_spline_that_do_not_close_stay_as_given():
    """The last of nine normals leans less than the first one, at the same point: both are kept."""
    turn = np.linspace(0.0, TURN, 9)
    points = 0.1 * np.column_stack([np.cos(turn), np.sin(turn), np.zeros(9)])
    points[-1] = points[0]
    up = np.column_stack([np.linspace(0.3, 0.2, 9), np.zeros(9), np.ones(9)])
    up /= np.linalg.norm(up, axis=1)[:, None]
    spline = PointSpline(points, up, closed=True)
    assert spline.normal(np.array([0.0, 1.0])) == pytest.approx(up[[0, -1]], abs=1e-9)


def test_a_spline_of_many_points_is_measured_at_its_points():
    """10 000 points of a circle of 0.1 m: 0.2 pi, though the nodes of other contours are 2049."""
    angle = np.linspace(0.0, TURN, 10_000)
    points = np.column_stack([0.1 * np.cos(angle), 0.1 * np.sin(angle), 0.0 * angle])
    curve = FeatureCurve(PointSpline(points, np.tile([0.0, 0.0, 1.0], (10_000, 1)), True), HERE)
    assert set(curve.contour.knots) <= set(curve.contour.nodes)
    assert curve.length == pytest.approx(0.2 * np.pi, rel=1e-9)


def test_poses_are_on_their_curve_and_only_the_way_is_its_length():
    """A circle of 20 mm whose frames turn with it: 2 pi 20 mm, though turning by a radian counts as 100 mm in paths."""
    angle = np.linspace(0.0, TURN, 73)
    poses = [
        pin.SE3(pin.utils.rotate("z", a + np.pi / 2), 0.02 * np.array([np.cos(a), np.sin(a), 0.0]))
        for a in angle
    ]
    curve = PoseCurve.through(poses, HERE)
    assert curve.length == pytest.approx(0.04 * np.pi, rel=1e-6)
    # Equal chords: the poses are at equal steps of the parameter.
    R, p = curve.at_parameter(np.linspace(0.0, 1.0, 73))
    assert p == pytest.approx(np.array([pose.translation for pose in poses]), abs=1e-9)
    assert pytest.approx(np.array([pose.rotation for pose in poses]), abs=1e-8) == R
    # It closes smoothly, and a curve that is placed elsewhere is moved with all its frames.
    first, last = curve.contour.second(np.array([0.0, 1.0]))
    assert first == pytest.approx(last, abs=1e-9)
    place = pin.SE3(pin.utils.rotate("x", 0.7), np.array([1.0, 2.0, 3.0]))
    S, q = PoseCurve.through(poses, place).at(np.array([0.03]))
    R, p = curve.at(np.array([0.03]))
    assert q[0] == pytest.approx(place.act(p[0]))
    assert S[0] == pytest.approx(place.rotation @ R[0])


def _wave(count, digits):
    """Poses of a wave of 10 mm on 0.3 m, three to its length, x along it, as a file of so many digits has them."""
    t = np.linspace(0.0, 1.0, count)
    k = 2.0 * np.pi * 3.0
    p = np.column_stack([0.3 * t, 0.01 * np.cos(k * t), 0.0 * t]).round(digits)
    heading = np.arctan2(-0.01 * k * np.sin(k * t), 0.3)
    poses = []
    for place, angle in zip(p, heading, strict=True):
        z, w = np.round([np.sin(angle / 2.0), np.cos(angle / 2.0)], digits)
        poses.append(pin.SE3(pin.Quaternion(w, 0.0, 0.0, z).normalized().toRotationMatrix(), place))
    return poses


@pytest.mark.parametrize(
    ("count", "digits"), [(101, 16), (301, 16), (2001, 16), (8001, 16), (2001, 9), (8001, 6)]
)
def test_a_wave_s_derivatives_do_not_hang_on_how_densely_it_is_described(count, digits):
    """Against the wave's own: curvature to a fiftieth of its largest, third no larger by half, also at the ends.

    8001 poses are 45 um apart: differences of what six digits round away would be some 1000 times the third derivative.
    """
    curve = PoseCurve.through(_wave(count, digits), HERE)
    t, k, step = np.linspace(0.0, 1.0, 901), 2.0 * np.pi * 3.0, 1e-3
    whole = quad(lambda u: np.hypot(0.3, 0.01 * k * np.sin(k * u)), 0.0, 1.0, limit=200)[0]
    assert curve.length == pytest.approx(whole, rel=5e-6)

    def along(s):
        R, p = curve.at(s)
        return np.column_stack([p, R[:, :, 0]])

    # The same points by the exact wave, at the same x.
    s = np.clip(t * whole, 2.0 * step, whole - 2.0 * step)
    points, heading = along(s)[:, :3], along(s)[:, 3:]
    assert points[:, 1] == pytest.approx(0.01 * np.cos(k * points[:, 0] / 0.3), abs=3e-6)
    slope = -0.01 * k / 0.3 * np.sin(k * points[:, 0] / 0.3)
    bend = -0.01 * (k / 0.3) ** 2 * np.cos(k * points[:, 0] / 0.3)
    assert heading[:, 1] == pytest.approx(slope / np.hypot(1.0, slope), abs=1e-4)
    curvature = bend / (1.0 + slope**2) ** 1.5
    found = (along(s + step)[:, 3:] - along(s - step)[:, 3:]) / (2.0 * step)
    sign = found[:, 1] * heading[:, 0] - found[:, 0] * heading[:, 1]
    assert sign == pytest.approx(curvature, abs=0.02 * np.abs(curvature).max())
    u = np.linspace(0.0, 1.0, 901)
    third = (curve.contour.second(u[2:]) - curve.contour.second(u[:-2])) / (u[2] - u[0])
    assert np.abs(third).max() < 1.5 * 0.01 * k**3


@pytest.mark.parametrize("turns", [0.0, 1.0, 2.0])
def test_closed_poses_turn_as_fast_where_they_end_as_where_they_begin(turns):
    """Twelve places round a ring, frames that wobble and go round none, once and twice: after one turn q is -q."""
    poses = []
    for share in np.linspace(0.0, 1.0, 13):
        angle = TURN * (share % 1.0)
        wobble = pin.utils.rotate("x", 0.3 * np.sin(angle + 0.7))
        place = 0.1 * np.array([np.cos(angle), np.sin(angle), 0.0])
        poses.append(pin.SE3(pin.utils.rotate("z", turns * TURN * share) @ wobble, place))
    curve = PoseCurve.through(poses, HERE)
    h = 1e-5
    before, end, begin, after = curve.frames(np.array([1.0 - h, 1.0, 0.0, h]))
    np.testing.assert_allclose(end, begin, atol=1e-9)
    np.testing.assert_allclose(
        pin.log3(before.T @ end) / h, pin.log3(begin.T @ after) / h, atol=5e-3
    )


@pytest.mark.parametrize("turns", [1.0, 2.0])
def test_closed_poses_that_are_described_densely_are_told_by_few(turns):
    """Once round a ring in 960 steps, frames that go round once, so that q ends as -q, or twice: 256 tell or fewer."""
    poses = []
    for share in np.linspace(0.0, 1.0, 961):
        angle = TURN * (share % 1.0)
        place = 0.1 * np.array([np.cos(angle), np.sin(angle), 0.0])
        poses.append(pin.SE3(pin.utils.rotate("z", turns * TURN * share), place))
    assert len(PoseCurve.through(poses, HERE).rotations) <= 257


def test_what_cannot_have_a_frame_is_found():
    """A normal along a line; a spline that turns back; a thin ellipse; normals that change sides. Others are smooth."""
    line = LineContour(np.zeros(3), np.array([0.0, 0.0, 0.2]), np.array([0.1, 0.0, 1.0]))
    assert least_lean(line) == pytest.approx(np.arctan(0.1))
    x = np.array([1.0, 0.0, 0.0])
    along = PointSpline(np.array([[0.0, 0, 0], [0.1, 0, 0], [0.2, 0.1, 0]]), np.zeros(3) + x)
    straight = PointSpline(np.outer([0.0, 0.1, 0.2], x), x)
    assert least_lean(straight) == 0.0
    assert sharpest_bend(straight)[0] == 0.0
    assert sharpest_bend(along)[0] < 0.1
    back = PointSpline(np.outer([0.0, 0.1, 0.0], x), np.array([0.0, 0.0, 1.0]))
    bend, at = sharpest_bend(back)
    assert bend == pytest.approx(np.pi)
    assert at == pytest.approx([0.1, 0.0, 0.0], abs=1e-3)
    assert sharpest_bend(Ellipse((0.1, 1e-9), 0.0, TURN))[0] > 1.0
    assert sharpest_bend(Ellipse((0.1, 0.05), 0.0, TURN))[0] < 0.01
    up = np.array([[0.0, 0, 1], [0, 0, -1], [0, 0, 1]])
    over = PointSpline(np.outer([0.0, 0.1, 0.3], x), up)
    assert sharpest_roll(over)[0] == pytest.approx(np.pi)
    assert sharpest_roll(Saddle(0.05, 0.045, 1.0, 0.0, 0.0, TURN))[0] < 0.02
