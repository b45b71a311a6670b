"""Coordinates along a path."""

from __future__ import annotations

import numpy as np

from dualarm_cli.timing.line_profile import PathCoordinates
from dualarm_cli.timing.rest_to_rest import RestToRest
from dualarm_cli.timing.shapes import symmetric_grid


def law(limits):
    """The joints' limits as constants."""
    return RestToRest(limits.velocity, limits.acceleration, limits.jerk)


def test_coordinates_rise_from_end_to_end(limits, lines):
    """The first one is the path length; all are monotone."""
    for path in lines[0]:
        share = PathCoordinates.measure(path, law(limits)).share
        assert np.abs(share[0] - np.linspace(0, 1, len(path))).max() < 1e-15
        assert np.array_equal(share[:, [0, -1]], np.tile([0.0, 1.0], (len(share), 1)))
        assert (np.diff(share, axis=1) > 0).all()


def test_a_lone_joint_moves_evenly_with_its_coordinate(limits):
    """Its angle x + x² is 2 at the end: at the share with x + x² = 1, x = (sqrt(5) - 1)/2, half way."""
    x = np.linspace(0, 1, 65)
    path = np.zeros((65, 7))
    path[:, 3] = 0.2 * (x + x**2)
    share = PathCoordinates.measure(path, law(limits)).share[1]
    assert abs(share[32] - (np.sqrt(5) - 1) / 2) < 1e-6


def test_the_time_of_a_straight_path_is_that_of_its_slowest_joint(limits):
    """A shape with v, a, j known at all instants: unit way, so only the joint's way counts."""
    path = np.linspace(0, 1, 65)[:, None] * np.array([0.3, 0, 0.1, 0, 0, 0.2, 0])
    shapes = symmetric_grid(np.array([0.5, 0.3]), np.array([0.5, 0.2]))
    found = PathCoordinates.measure(path, law(limits)).scaled_time(shapes, np.zeros(4, int), 3)
    _, _, a, j = np.abs(shapes.phases()).max(axis=2)
    # Joint s has the longest way and the lowest limits of those that move.
    needs = [
        0.3 * shapes.peak / limits.velocity[0],
        np.sqrt(0.3 * a / limits.acceleration[0]),
        np.cbrt(0.3 * j / limits.jerk[0]),
    ]
    assert np.abs(found / np.max(needs, axis=0) - 1).max() < 1e-9
