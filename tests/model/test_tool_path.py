"""Tool paths: poses and lengths by hand, circles by their centres, splines by their derivatives, corners."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.model.curves.tool_path import (
    TURN_LENGTH,
    Line,
    RoundedCorner,
    Spline,
    ToolPath,
    Turn,
)

DOWN = pin.utils.rotate("x", np.pi)


def pose(*xyz, R=DOWN):
    """A pose."""
    return pin.SE3(np.array(R), np.array(xyz, dtype=float))


def turned(angle, *xyz):
    """A pose turned about z."""
    return pose(*xyz, R=pin.utils.rotate("z", angle))


def angle_between(R, S):
    """Angle of R^T S [rad], by pinocchio's logarithm."""
    return float(np.linalg.norm(pin.log3(R.T @ S)))


def test_a_line_is_as_long_as_its_way_and_evenly_divided():
    """3-4-5: from (1, 1, 1) by (0.3, 0, 0.4) it is 0.5 m; at 0.2 m two fifths of it, (1.12, 1, 1.16)."""
    line = Line(pose(1, 1, 1), pose(1.3, 1, 1.4))
    assert line.length == pytest.approx(0.5, abs=1e-15)
    R, p = line.at(np.array([0.0, 0.2, 0.5]))
    assert p == pytest.approx(np.array([[1, 1, 1], [1.12, 1, 1.16], [1.3, 1, 1.4]]), abs=1e-15)
    assert np.broadcast_to(DOWN, (3, 3, 3)) == pytest.approx(R, abs=1e-15)


def test_a_turn_on_the_spot_counts_0_1_m_per_radian():
    """90 degrees: pi/2 times 0.1 m; halfway 45 degrees, in place."""
    line = Line(turned(0.0, 1, 2, 3), turned(np.pi / 2, 1, 2, 3))
    assert TURN_LENGTH == 0.1
    assert line.length == pytest.approx(0.15707963267948966, abs=1e-15)
    R, p = line.at(np.array([line.length / 2]))
    assert p[0].tolist() == [1.0, 2.0, 3.0]
    assert R[0] == pytest.approx(pin.utils.rotate("z", np.pi / 4), abs=1e-15)


def test_the_longer_of_way_and_turning_counts():
    """2 rad are 0.2 m: more than a way of 0.15 m, less than one of 0.25 m."""
    start = turned(0.0, 0, 0, 0)
    assert Line(start, turned(2.0, 0.15, 0, 0)).length == pytest.approx(0.2, abs=1e-15)
    assert Line(start, turned(2.0, 0.25, 0, 0)).length == pytest.approx(0.25, abs=1e-15)


def test_a_tool_turns_in_proportion_to_the_way():
    """From 0.3 rad to 1.5 rad about z: after a quarter of the way 0.6 rad."""
    line = Line(turned(0.3, 0, 0, 0), turned(1.5, 0.4, 0, 0))
    R, p = line.at(np.array([0.1]))
    assert p[0] == pytest.approx([0.1, 0, 0], abs=1e-16)
    assert R[0] == pytest.approx(pin.utils.rotate("z", 0.6), abs=1e-15)


def test_a_line_to_where_the_tool_is_has_no_length_and_stays():
    """Nothing is divided by zero."""
    line = Line(pose(1, 2, 3), pose(1, 2, 3))
    assert line.length == 0.0
    assert line.at(np.zeros(2))[1].tolist() == [[1.0, 2.0, 3.0]] * 2


def test_a_turn_goes_on_a_circle_about_its_axis():
    """Quarter circle of radius 0.2 about the vertical through (1, 1): halfway at 45 degrees, its height kept."""
    turn = Turn(
        pose(1.2, 1, 0.5),
        np.array([1.0, 1.0, 0.0]),
        np.array([0.0, 0.0, 1.0]),
        np.pi / 2,
        np.array([0.0, 0.0, np.pi / 2]),
    )
    assert turn.length == pytest.approx(0.2 * np.pi / 2, abs=1e-15)
    R, p = turn.at(np.array([0.0, turn.length / 2, turn.length]))
    d = 0.2 * np.sqrt(0.5)
    assert p == pytest.approx(
        np.array([[1.2, 1, 0.5], [1 + d, 1 + d, 0.5], [1, 1.2, 0.5]]), abs=1e-15
    )
    assert R[1] == pytest.approx(pin.utils.rotate("z", np.pi / 4) @ DOWN, abs=1e-15)
    assert R[2] == pytest.approx(pin.utils.rotate("z", np.pi / 2) @ DOWN, abs=1e-15)


def test_a_turn_that_keeps_the_tool_moves_it_only():
    """No rotation of its own: the same rotation everywhere, on the same circle, the other way by a negative angle."""
    turn = Turn(
        pose(1, 0, 0), np.zeros(3), np.array([0.0, 0.0, 1.0]), -np.pi / 2, np.array([0.0, 0.0, 0.0])
    )
    R, p = turn.at(np.linspace(0.0, turn.length, 5))
    assert np.broadcast_to(DOWN, (5, 3, 3)) == pytest.approx(R, abs=1e-15)
    assert p[-1] == pytest.approx([0, -1, 0], abs=1e-15)
    assert turn.length == pytest.approx(np.pi / 2, abs=1e-15)


def test_a_small_circle_with_a_turning_tool_counts_by_the_turning():
    """Radius 30 mm, 2 rad: way 60 mm, turning 0.2 m."""
    axis = np.array([0.0, 0.0, 1.0])
    turn = Turn(pose(0.03, 0, 0), np.zeros(3), axis, 2.0, 2.0 * axis)
    assert turn.length == pytest.approx(0.2, abs=1e-15)
    assert turn.at(np.array([0.1]))[1][0] == pytest.approx(
        [0.03 * np.cos(1.0), 0.03 * np.sin(1.0), 0], abs=1e-16
    )


@pytest.mark.parametrize(
    ("via", "end", "angle"),
    [
        ((0, 1), (-1, 0), np.pi),  # the upper half
        ((0, -1), (-1, 0), np.pi),  # the lower half
        ((np.sqrt(0.5), np.sqrt(0.5)), (0, 1), np.pi / 2),  # the short way to (0, 1)
        ((-1, 0), (0, 1), 3 * np.pi / 2),  # the long way to it
        ((0, -1), (np.cos(0.1), np.sin(0.1)), 2 * np.pi - 0.1),  # nearly all around
    ],
)
def test_an_arc_takes_the_side_of_its_via_point(via, end, angle):
    """On the unit circle from (1, 0): the length is the angle."""
    arc = Turn.through(pose(1, 0, 2), np.array([*via, 2.0]), pose(*end, 2))
    assert arc is not None
    assert arc.length == pytest.approx(angle, abs=1e-14)
    assert arc.about == pytest.approx([0, 0, 2], abs=1e-14)
    p = arc.at(np.linspace(0.0, arc.length, 1001))[1]
    assert p[-1] == pytest.approx([*end, 2], abs=1e-14)
    assert np.linalg.norm(p - [*via, 2.0], axis=1).min() < arc.length / 2000 * 1.001


def test_random_arcs_keep_their_distance_from_the_centre_and_pass_their_point():
    """200 triples: centre equally far from all three (by linear equations), radius constant, via and end on the way."""
    rng = np.random.default_rng(1)
    for _ in range(200):
        a, via, b = rng.uniform(-0.5, 0.5, (3, 3))
        arc = Turn.through(pose(*a), via, pose(*b))
        assert arc is not None
        # |c - a|² = |c - via|² = |c - b|² and c in the plane of the three.
        normal = np.cross(via - a, b - a)
        left = np.array([2 * (via - a), 2 * (b - a), normal])
        right = [via @ via - a @ a, b @ b - a @ a, normal @ a]
        centre = np.linalg.solve(left, right)
        radius = np.linalg.norm(a - centre)
        p = arc.at(np.linspace(0.0, arc.length, 2001))[1]
        assert np.linalg.norm(p - centre, axis=1) == pytest.approx(radius, rel=1e-9)
        assert np.abs((p - a) @ normal).max() < 1e-9 * max(1.0, radius)
        assert np.linalg.norm(p - via, axis=1).min() <= arc.length / 4000 * 1.001
        assert np.linalg.norm(p[-1] - b) < 1e-9 * max(1.0, radius)
        assert arc.length == pytest.approx(radius * arc.angle, rel=1e-12)


def test_a_tool_turns_evenly_on_an_arc():
    """From no turn to 1 rad about x: after a third of the arc 1/3 rad."""
    arc = Turn.through(
        pose(1, 0, 0, R=np.eye(3)),
        np.array([0.0, 1.0, 0.0]),
        pose(-1, 0, 0, R=pin.utils.rotate("x", 1.0)),
    )
    assert arc is not None
    R = arc.at(np.array([arc.length / 3, arc.length]))[0]
    assert R[0] == pytest.approx(pin.utils.rotate("x", 1.0 / 3.0), abs=1e-15)
    assert R[1] == pytest.approx(pin.utils.rotate("x", 1.0), abs=1e-15)


def test_three_points_on_a_line_are_no_arc():
    """Between, beyond, at the start, at the end, start and end the same; in 50 random directions."""
    rng = np.random.default_rng(2)
    for way in rng.normal(size=(50, 3)):
        a = rng.uniform(-1, 1, 3)
        for share in (0.5, 2.0, -1.0, 0.0, 1.0):
            assert Turn.through(pose(*a), a + share * way, pose(*(a + way))) is None
        assert Turn.through(pose(*a), a + way, pose(*a)) is None


WAVE = tuple(
    turned(0.2 * k, 0.1 * k, 0.05 * np.sin(1.3 * k), 0.03 * np.cos(0.9 * k)) for k in range(7)
)


def test_a_spline_goes_through_its_poses_in_their_order():
    """Position and rotation together, each later than the one before; the ends exactly."""
    spline = Spline(WAVE)
    s = np.linspace(0.0, spline.length, 20001)
    R, p = spline.at(s)
    step, last = spline.length / 20000, -1
    for there in WAVE:
        k = int(np.argmin(np.linalg.norm(p - there.translation, axis=1)))
        assert np.linalg.norm(p[k] - there.translation) < step
        assert angle_between(R[k], there.rotation) < step / TURN_LENGTH
        assert k > last
        last = k
    assert p[[0, -1]] == pytest.approx(
        np.array([WAVE[0].translation, WAVE[-1].translation]), abs=1e-14
    )
    assert angle_between(R[-1], WAVE[-1].rotation) < 1e-12


def test_a_spline_is_travelled_at_unit_speed():
    """|dp/ds| = 1 by central differences where the way is longer than the turning, and the length is its way."""
    spline = Spline(WAVE)
    s = np.linspace(0.01, spline.length - 0.01, 4001)
    h = 1e-5
    speed = np.linalg.norm(spline.at(s + h)[1] - spline.at(s - h)[1], axis=1) / (2 * h)
    assert speed == pytest.approx(1.0, abs=1e-6)
    way = np.diff(spline.at(np.linspace(0.0, spline.length, 20001))[1], axis=0)
    assert np.linalg.norm(way, axis=1).sum() == pytest.approx(spline.length, rel=1e-6)


def test_where_a_spline_turns_more_than_it_goes_the_turning_is_even():
    """5 mm steps with 1 rad each: the angular speed is 10 rad per metre of length, everywhere."""
    spline = Spline(tuple(turned(1.0 * k, 0.005 * k, 0, 0) for k in range(5)))
    s = np.linspace(0.01, spline.length - 0.01, 201)
    h = 1e-5
    before, after = spline.at(s - h)[0], spline.at(s + h)[0]
    rate = [angle_between(a, b) / (2 * h) for a, b in zip(before, after, strict=True)]
    assert rate == pytest.approx([1.0 / TURN_LENGTH] * 201, rel=1e-6)
    assert spline.length == pytest.approx(0.4, rel=1e-9)


def second_differences(piece, count):
    """Second derivatives of the position over the length, at so many places."""
    s, h = np.linspace(0.0, piece.length, count, retstep=True)
    p = piece.at(s)[1]
    return (p[2:] - 2 * p[1:-1] + p[:-2]) / h**2


def largest_change(piece, count):
    """Largest change of the second derivative from one place to the next."""
    return np.linalg.norm(np.diff(second_differences(piece, count), axis=0), axis=1).max()


def test_the_second_derivative_of_a_spline_does_not_jump():
    """At half the spacing its changes are half as large; those of a polygon through the same points are not."""
    spline = Spline(WAVE)
    assert largest_change(spline, 4001) < 0.6 * largest_change(spline, 2001)
    polygon = ToolPath(tuple(Line(a, b) for a, b in pairwise(WAVE)))
    assert largest_change(polygon, 4001) > 1.0 * largest_change(polygon, 2001)


def test_a_spline_is_straight_at_its_ends():
    """Natural: no curvature at either end, against the largest in between."""
    bend = np.linalg.norm(second_differences(Spline(WAVE), 4001), axis=1)
    assert max(bend[0], bend[-1]) < 0.01 * bend.max()


def test_a_spline_through_two_poses_is_the_line():
    """Nothing bends it."""
    a, b = turned(0.0, 0, 0, 0), turned(0.5, 0.3, 0.4, 0)
    spline, line = Spline((a, b)), Line(a, b)
    assert spline.length == pytest.approx(line.length, abs=1e-12)
    s = np.linspace(0.0, 0.5, 11)
    assert spline.at(s)[1] == pytest.approx(line.at(s)[1], abs=1e-12)
    assert spline.at(s)[0] == pytest.approx(line.at(s)[0], abs=1e-12)


@pytest.mark.parametrize(
    ("x", "pose_number"),
    [((0, 0.1, 0), 1), ((0, 0.1, 0.2, 0.1, 0), 2), ((0, 0.1, 0.05, 0.2), 1), ((0, 0.3, 0.29), 1)],
)
def test_a_spline_that_reverses_on_a_line_turns_back_there(x, pose_number):
    """On a line there is no way around: its direction flips, exactly at a pose or near one."""
    assert Spline(tuple(pose(value, 0, 0) for value in x)).turns_back == pose_number


@pytest.mark.parametrize("width", [0.1, 0.01, 0.001, 0.0001])
def test_a_spline_with_room_to_turn_does_not_turn_back(width):
    """A hairpin, however narrow, has poses on both sides; a tool may also turn on the spot between two ways."""
    points = ((0, 0), (0.1, 0), (0.1, width), (0, width))
    assert Spline(tuple(pose(*point, 0) for point in points)).turns_back is None
    assert Spline(WAVE).turns_back is None
    angles, x = (0.0, 1.0, 2.0, 3.0), (0.0, 0.02, 0.03, 0.01)
    turning = tuple(turned(a, value, 0, 0) for a, value in zip(angles, x, strict=True))
    assert Spline(turning).turns_back is None


def test_a_turn_back_and_forth_on_the_spot_turns_back():
    """Rotations reverse like positions."""
    assert Spline(tuple(turned(a, 0, 0, 0) for a in (0.0, 1.0, 0.0))).turns_back == 1


def tangent_arc(R_end=DOWN):
    """A line of 0.3 m along x, then a quarter circle of radius 0.1 that goes on in its direction."""
    line = Line(pose(0, 0, 0), pose(0.3, 0, 0))
    d = 0.1 * np.sqrt(0.5)
    arc = Turn.through(
        pose(0.3, 0, 0), np.array([0.3 + d, 0.1 - d, 0.0]), pose(0.4, 0.1, 0, R=R_end)
    )
    assert arc is not None
    return ToolPath((line, arc))


def test_lengths_add_up_and_poses_meet():
    """0.3 + 0.1 pi/2; the same pose from both sides of the junction."""
    path = tangent_arc()
    assert path.length == pytest.approx(0.3 + 0.05 * np.pi, abs=1e-15)
    assert path.junctions == pytest.approx((0.3,), abs=1e-15)
    p = path.at(np.array([0.3 - 1e-9, 0.3 + 1e-9, path.length]))[1]
    assert p == pytest.approx(np.array([[0.3, 0, 0], [0.3, 0, 0], [0.4, 0.1, 0]]), abs=1.1e-9)
    # 0.1 m times 45 degrees behind the junction.
    d = 0.1 * np.sqrt(0.5)
    assert path.pose(0.3 + 0.025 * np.pi).translation == pytest.approx(
        [0.3 + d, 0.1 - d, 0], abs=1e-14
    )


def test_beyond_its_ends_a_path_stands_still():
    """The poses of start and end."""
    path = tangent_arc()
    R, p = path.at(np.array([-5.0, 0.0, path.length, 1e9]))
    assert p[0].tolist() == p[1].tolist() == [0.0, 0.0, 0.0]
    assert p[2].tolist() == p[3].tolist()
    assert R[2].tolist() == R[3].tolist()
    assert p[3] == pytest.approx([0.4, 0.1, 0], abs=1e-14)


def test_an_arc_that_continues_a_line_is_no_corner():
    """Nor is a line that continues a line; both are junctions."""
    assert tangent_arc().corners == ()
    straight = ToolPath(
        (Line(pose(0, 0, 0), pose(0.1, 0, 0)), Line(pose(0.1, 0, 0), pose(0.4, 0, 0)))
    )
    assert straight.corners == ()
    assert len(straight.junctions) == 1


@pytest.mark.parametrize("degrees", [0.5, 5.0, 90.0, 180.0])
def test_lines_at_an_angle_meet_in_a_corner(degrees):
    """Wherever the direction changes, also straight back."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    path = ToolPath(
        (
            Line(pose(0, 0, 0), pose(0.2, 0, 0)),
            Line(pose(0.2, 0, 0), pose(0.2 + 0.1 * c, 0.1 * s, 0)),
        )
    )
    assert path.corners == pytest.approx((0.2,), abs=1e-15)


@pytest.mark.parametrize(("share", "corners"), [(0.9, 0), (1.1, 1)])
def test_a_direction_that_changes_by_less_than_a_thousandth_is_none(share, corners):
    """Two lines at an angle whose sine is that, and a tool that turns by as much per its length of 0.1 m."""
    away = share * 1e-3
    along = 0.1 * np.sqrt(1.0 - away**2)
    first = Line(pose(0, 0, 0), pose(0.2, 0, 0))
    bent = Line(pose(0.2, 0, 0), pose(0.2 + along, 0.1 * away, 0))
    assert len(ToolPath((first, bent)).corners) == corners
    # On 0.1 m it turns by as many radians as makes 0.1 m of it per metre.
    turning = Line(turned(0, 0.2, 0, 0), turned(away, 0.3, 0, 0))
    straight = Line(turned(0, 0, 0, 0), turned(0, 0.2, 0, 0))
    assert len(ToolPath((straight, turning)).corners) == corners


def test_an_arc_across_a_line_is_a_corner():
    """The line comes along x, the circle starts along y."""
    arc = Turn.through(pose(0.3, 0, 0), np.array([0.2, 0.1, 0.0]), pose(0.1, 0, 0))
    assert arc is not None
    path = ToolPath((Line(pose(0, 0, 0), pose(0.3, 0, 0)), arc))
    assert path.corners == pytest.approx((0.3,), abs=1e-15)


def test_a_tool_that_suddenly_turns_has_a_corner():
    """The way goes straight on, but from the junction on the tool turns; and a tangent arc with a turning tool."""
    path = ToolPath(
        (
            Line(turned(0, 0, 0, 0), turned(0, 0.2, 0, 0)),
            Line(turned(0, 0.2, 0, 0), turned(0.5, 0.4, 0, 0)),
        )
    )
    assert path.corners == pytest.approx((0.2,), abs=1e-15)
    assert len(tangent_arc(pin.utils.rotate("x", 2.0)).corners) == 1


def test_a_steadily_turning_tool_has_none():
    """0.4 rad on 0.2 m, then 0.2 rad on 0.1 m about the same axis."""
    path = ToolPath(
        (
            Line(turned(0, 0, 0, 0), turned(0.4, 0.2, 0, 0)),
            Line(turned(0.4, 0.2, 0, 0), turned(0.6, 0.3, 0, 0)),
        )
    )
    assert path.corners == ()


def test_circles_that_touch_are_no_corner_and_are_in_all_directions():
    """An S of two half circles, in 20 random placements."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        T = pin.SE3(pin.exp3(rng.uniform(-2, 2, 3)), rng.normal(size=3))
        first = Turn.through(T * pose(0, 0, 0), T.act(np.array([0.1, 0.1, 0])), T * pose(0.2, 0, 0))
        other = Turn.through(
            T * pose(0.2, 0, 0), T.act(np.array([0.3, -0.1, 0])), T * pose(0.4, 0, 0)
        )
        assert first is not None
        assert other is not None
        assert ToolPath((first, other)).corners == ()
        back = Turn.through(
            T * pose(0.2, 0, 0), T.act(np.array([0.3, 0.1, 0])), T * pose(0.4, 0, 0)
        )
        assert back is not None
        assert len(ToolPath((first, back)).corners) == 1


def polyline(seed: int) -> ToolPath:
    """Five poses at random, of which every third path keeps its rotation."""
    random = np.random.default_rng(seed)
    size = [0.0, 0.3, 1.0][seed % 3]
    poses = [
        pin.SE3(pin.exp3(size * random.normal(size=3)), 0.2 * random.normal(size=3))
        for _ in range(5)
    ]
    return ToolPath(tuple(Line(a, b) for a, b in pairwise(poses)))


@pytest.mark.parametrize("seed", range(12))
def test_rounded_corners_are_smooth_and_left_by_no_more_than_allowed(seed):
    """Unit speed and continuous curvature by finite differences; the corner's distance by dense samples."""
    path = polyline(seed)
    rounded = path.rounded(0.02)
    assert rounded.length <= path.length
    curves = [piece for piece in rounded.pieces if isinstance(piece, RoundedCorner)]
    assert len(rounded.corners) == len(path.corners) - len(curves)
    s = np.linspace(0.0, rounded.length, 40001)
    R, p = rounded.at(s)
    turned_by = np.array([pin.log3(a.T @ b) for a, b in pairwise(R)])
    steps = np.maximum(
        np.linalg.norm(np.diff(p, axis=0), axis=1), TURN_LENGTH * np.linalg.norm(turned_by, axis=1)
    )
    beside_corners = np.ones(len(steps), dtype=bool)
    for corner in rounded.corners:
        beside_corners &= np.abs(s[:-1] - corner) > 2.0 * s[1]
    assert steps[beside_corners] == pytest.approx(s[1], rel=1e-3)
    for curve in curves:
        assert np.linalg.norm(p - curve.corner.translation, axis=1).min() <= 0.02 + s[1]
        turn = min(np.linalg.norm(pin.log3(R_here.T @ curve.corner.rotation)) for R_here in R[::20])
        assert TURN_LENGTH * turn <= 0.02 + 30 * s[1]
        # Third derivatives exist, so that the curvature beside its ends is small and zero at them.
        step = 1e-3 * curve.length
        near = curve.at(np.array([0.0, step, 2.0 * step]))[1]
        bend = np.linalg.norm(near[0] - 2.0 * near[1] + near[2]) / step**2
        assert bend < 0.1 / curve.length


def test_a_right_angle_is_cut_where_hand_arithmetic_says():
    """Points d, 0.7 d, 0.4 d beside it, weighed 1, 5, 10 of 32: its middle is 8.5 / 32 d off both ways."""
    path = ToolPath(
        (Line(pose(0, 0, 0), pose(0.5, 0, 0)), Line(pose(0.5, 0, 0), pose(0.5, 0.5, 0)))
    )
    [_, curve, _] = path.rounded(0.02).pieces
    d = 0.02 / (np.sqrt(2.0) * 8.5 / 32.0)
    ends = curve.at(np.array([0.0, curve.length]))[1]
    assert ends == pytest.approx(np.array([[0.5 - d, 0, 0], [0.5, d, 0]]), abs=1e-12)
    middle = curve.at(np.array([0.5 * curve.length]))[1][0]
    assert middle == pytest.approx([0.5 - d * 8.5 / 32, d * 8.5 / 32, 0], abs=1e-9)
    assert curve.left_by == pytest.approx(0.02, abs=1e-12)


def test_short_pieces_share_and_sharp_corners_and_arcs_keep_their_stops():
    """Half of a piece each; a corner of 150 degrees stays."""
    short = ToolPath(
        (
            Line(pose(0, 0, 0), pose(0.5, 0, 0)),
            Line(pose(0.5, 0, 0), pose(0.5, 0.01, 0)),
            Line(pose(0.5, 0.01, 0), pose(0, 0.01, 0)),
        )
    )
    rounded = short.rounded(0.02)
    curves = [piece for piece in rounded.pieces if isinstance(piece, RoundedCorner)]
    assert [curve.reach for curve in curves] == pytest.approx([0.005, 0.005])
    assert len(rounded.pieces) == 4 and rounded.corners == ()
    back = pose(0.5 - 0.4 * np.cos(np.pi / 6), 0.2, 0)
    hairpin = ToolPath((Line(pose(0, 0, 0), pose(0.5, 0, 0)), Line(pose(0.5, 0, 0), back)))
    assert hairpin.rounded(0.02).pieces == hairpin.pieces
    arc = Turn(pose(0.5, 0, 0), np.array([0.5, -0.2, 0.0]), np.array([0, 0, 1.0]), 1.0, np.zeros(3))
    into_an_arc = ToolPath((Line(pose(0.5, -0.5, 0), pose(0.5, 0, 0)), arc))
    assert into_an_arc.rounded(0.02).pieces == into_an_arc.pieces
