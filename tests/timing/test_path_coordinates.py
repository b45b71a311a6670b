"""Lines and launches as compiled, against the method in numpy, whose coordinates have properties of their own."""

from __future__ import annotations

import numpy as np
import pytest

from dualarm_cli.model.motion.rest_to_rest import RestToRest
from dualarm_cli.timing.launch import launches, solve_launch
from dualarm_cli.timing.line_profile import solve_line
from dualarm_cli.timing.problem import LineProblem
from dualarm_cli.timing.shapes import Shapes, symmetric_grid


def law(limits):
    """The joints' limits as constants."""
    return RestToRest(limits.velocity, limits.acceleration, limits.jerk)


def test_coordinates_rise_from_end_to_end(line_reference, limits, lines):
    """The first one is the path length; all are monotone."""
    for path in lines[0]:
        share = line_reference.PathCoordinates.measure(path, law(limits)).share
        assert np.abs(share[0] - np.linspace(0, 1, len(path))).max() < 1e-15
        assert np.array_equal(share[:, [0, -1]], np.tile([0.0, 1.0], (len(share), 1)))
        assert (np.diff(share, axis=1) > 0).all()


def test_a_lone_joint_moves_evenly_with_its_coordinate(line_reference, limits):
    """Its angle x + x² is 2 at the end: at the share with x + x² = 1, x = (sqrt(5) - 1)/2, half way."""
    x = np.linspace(0, 1, 65)
    path = np.zeros((65, 7))
    path[:, 3] = 0.2 * (x + x**2)
    share = line_reference.PathCoordinates.measure(path, law(limits)).share[1]
    assert abs(share[32] - (np.sqrt(5) - 1) / 2) < 1e-6


def test_the_time_of_a_straight_path_is_that_of_its_slowest_joint(line_reference, limits):
    """A shape with v, a, j known at all instants: unit way, so only the joint's way counts."""
    path = np.linspace(0, 1, 65)[:, None] * np.array([0.3, 0, 0.1, 0, 0, 0.2, 0])
    shapes = symmetric_grid(np.array([0.5, 0.3]), np.array([0.5, 0.2]))
    found = line_reference.PathCoordinates.measure(path, law(limits)).scaled_time(
        shapes, np.zeros(4, int), 3
    )
    _, v, a, j = np.abs(shapes.phases()).max(axis=2)
    # Joint s has the longest way and the lowest limits of those that move.
    needs = [
        0.3 * v / limits.velocity[0],
        np.sqrt(0.3 * a / limits.acceleration[0]),
        np.cbrt(0.3 * j / limits.jerk[0]),
    ]
    assert np.abs(found / np.max(needs, axis=0) - 1).max() < 1e-9


def random_paths(count):
    """Joints along 80 mm: bent, and some with joints that stand."""
    rng = np.random.default_rng(5)
    share = np.linspace(0.0, 1.0, 65)[:, None]
    for k in range(count):
        a, b, c, d = rng.uniform(-1, 1, (4, 7))
        path = a + 0.4 * b * share + 0.1 * c * share**2 + 0.05 * d * np.sin(3 * share)
        if k % 4 == 0:
            path[:, 1 + np.flatnonzero(rng.random(6) < 0.5)] = 0.3
        yield path


def test_no_other_shape_is_much_faster(line_reference, limits, lines):
    """Of 4,000 random shapes along both smooth coordinates, none by more than 1 %."""
    rng = np.random.default_rng(3)
    ramps, jerks = rng.uniform(0.2, 0.8, (2, 4000)), rng.uniform(0.1, 0.6, (4, 4000))
    ramps[1] = 1.0 - ramps[0]
    for pair in (jerks[:2], jerks[2:]):
        pair /= np.maximum(pair.sum(axis=0), 1.0)
    shapes = Shapes(ramps[0], *jerks[:2], ramps[1], *jerks[2:])
    for path in lines[0]:
        paths = line_reference.PathCoordinates.measure(path, law(limits))
        least = min(paths.scaled_time(shapes, np.full(4000, c)).min() for c in (0, 1))
        found = solve_line(LineProblem(limits.joints, path, lines[1], limits)).duration
        assert found <= 1.01 * least


@pytest.mark.parametrize("jerk", ["limited", "unlimited"])
@pytest.mark.parametrize("knots", [12, 40])
def test_lines_are_those_of_the_method_in_numpy(line_reference, limits, without_jerk, knots, jerk):
    """Times and positions of all knots."""
    own = limits if jerk == "limited" else without_jerk
    length = np.linspace(0.0, 0.08, 65)
    for path in random_paths(8):
        found = solve_line(LineProblem(own.joints, path, length, own, knots=knots))
        time, q = line_reference.rest_line(path, law(own), knots)
        np.testing.assert_allclose(found.time, time, rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(found.position, q, atol=1e-8)


def test_a_cap_on_the_tool_is_a_limit_of_one_joint_more(line_reference, limits):
    """The path's length with the cap as its speed; 1e-4 of that is kept free."""
    length = np.linspace(0.0, 0.08, 65)
    for path in random_paths(4):
        problem = LineProblem(limits.joints, path, length, limits, tool_speed=0.25)
        cap = 0.25 * (1.0 - 1e-4)
        more = RestToRest(
            np.append(limits.velocity, cap),
            np.append(limits.acceleration, 1e9 * cap),
            np.append(limits.jerk, 1e18 * cap),
        )
        time, q = line_reference.rest_line(np.column_stack([path, length]), more, problem.knots)
        found = solve_line(problem)
        np.testing.assert_allclose(found.time, time, rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(found.position, q[:, :7], atol=1e-8)


@pytest.mark.parametrize("jerk", ["limited", "unlimited"])
def test_launches_are_those_of_the_method_in_numpy(line_reference, limits, without_jerk, jerk):
    """Estimates of all ways, and the knots of some."""
    own = limits if jerk == "limited" else without_jerk
    length = np.linspace(0.0, 0.08, 65)
    for path in random_paths(12):
        problem = LineProblem(own.joints, path, length, own)
        found = launches(problem)
        coordinate, time, velocity, acceleration = line_reference.launches(path, law(own))
        assert [way.coordinate for way in found.launches[:: time.shape[1]]] == coordinate.tolist()
        np.testing.assert_allclose(found.time, time.ravel(), rtol=1e-9)
        np.testing.assert_allclose(found.velocity, velocity.reshape(-1, 7), atol=1e-9)
        np.testing.assert_allclose(found.acceleration, acceleration.reshape(-1, 7), atol=1e-8)
        for way in found.launches[::23]:
            motion = solve_launch(problem, way)
            time, q = line_reference.launched_line(path, law(own), way, problem.knots)
            np.testing.assert_allclose(motion.time, time, rtol=1e-8, atol=1e-12)
            np.testing.assert_allclose(motion.position, q, atol=1e-8)
