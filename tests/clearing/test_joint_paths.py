"""Free paths: ends, freedom between their points, smoothness; and no path where there is none."""

from __future__ import annotations

import numpy as np
import pytest

from dualarm_cli.clearing.transfer_paths import GRIDPOINTS, free_points, rounded_path

LOWER, UPPER = np.full(2, -1.5), np.full(2, 1.5)
START, GOAL = np.array([-0.5, 0.0]), np.array([0.5, 0.0])


def wall(x, spare=0.0):
    """Free but for a wall of 0.1 s across the straight way, with the gaps beyond |y| = 0.4."""
    return ~((np.abs(x[:, 0]) < 0.05 + spare) & (np.abs(x[:, 1]) < 0.4 + spare))


@pytest.mark.parametrize("seed", range(8))
def test_a_path_leads_round_a_wall_by_nearly_the_shortest_way(seed):
    """Its ends are the given ones, it is free at a hundred times its points, and its way is up and down 0.4."""
    points = free_points(lambda x: wall(x, 0.02), START, GOAL, LOWER, UPPER, seed)
    path = rounded_path(wall, points)
    assert path.shape == (GRIDPOINTS, 2)
    np.testing.assert_allclose(path[[0, -1]], [START, GOAL], atol=1e-12)
    share = np.linspace(0.0, 1.0, 100)[:, None, None]
    between = path[:-1] + share * (path[1:] - path[:-1])
    assert wall(between.reshape(-1, 2)).all()
    assert 0.4 <= np.abs(path[:, 1]).max() < 0.6
    # As a spline it has no corner: neighbouring steps hardly differ.
    steps = np.diff(path, axis=0)
    assert np.abs(np.diff(steps, axis=0)).max() < np.abs(steps).max()


def test_the_same_seed_gives_the_same_path():
    """Bit by bit."""
    one, other = (free_points(wall, START, GOAL, LOWER, UPPER, 3) for _ in range(2))
    np.testing.assert_array_equal(one, other)


def test_there_is_no_path_through_a_closed_wall():
    """The trees end after so many edges."""

    def closed(x):
        return np.abs(x[:, 0]) >= 0.05

    assert free_points(closed, START, GOAL, LOWER, UPPER, 0) is None


def test_what_is_free_all_along_becomes_straight():
    """Short cuts leave nothing of the trees' detours."""
    points = free_points(lambda x: np.ones(len(x), bool), START, GOAL, LOWER, UPPER, 1)
    np.testing.assert_allclose(points[:, 1], 0.0, atol=0.02)
