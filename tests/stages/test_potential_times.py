"""Compiled times of transfers with their work and minima over them, against numpy on random numbers."""

from __future__ import annotations

import numpy as np
import pytest

from dualarm_cli.compiled.transfer_times import boxes, gap_times, least_through, work_times
from dualarm_cli.model.motion.rest_to_rest import RestToRest
from dualarm_cli.timing.transfer_table import TransferTable

SIZES = [(1, 1, 1), (3, 7, 2), (48, 8, 4), (5, 9, 29), (20, 513, 6), (2, 1030, 29)]
"""Rows, columns and groups: whole lanes and tiles, and some more."""


@pytest.fixture
def table():
    """The times of four joints of two laws."""
    laws = [
        RestToRest(np.array([2.0, 3.0]), np.array([9.0, 13.5]), np.array([80.0, 120.0])),
        RestToRest(np.array([1.0, 1.5]), np.array([2.0, 9.0]), np.array([40.0, np.inf])),
    ]
    return TransferTable.of(laws, np.full(4, -3.0), np.full(4, 3.0))


def some(random, size, groups):
    """Ascending groups, of which some may be empty."""
    return np.sort(random.integers(0, groups, size))


@pytest.mark.parametrize(("rows", "columns", "groups"), SIZES)
def test_times_with_work_and_their_least_by_groups(table, rows, columns, groups):
    """Pair by pair; infinite where a group is empty or work is impossible."""
    random = np.random.default_rng(rows + columns)
    start, goal = (table.coordinates(random.uniform(-3, 3, (n, 4))) for n in (rows, columns))
    come, gone = some(random, rows, groups), some(random, columns, groups)
    work = random.uniform(0, 2, columns).astype(np.float32)
    work[random.random(columns) < 0.2] = np.inf
    for without in ((), (1,), (0, 1, 2, 3)):
        times, least = work_times(table.laws(without), start, goal, work, (come, gone, groups))
        expected = table.times(start, goal, without) + work
        np.testing.assert_array_equal(times, expected)
        for g in range(groups):
            for h in range(groups):
                pairs = expected[come == g][:, gone == h]
                assert least[g, h] == pairs.min(initial=np.inf)


@pytest.mark.parametrize(("rows", "columns", "groups"), SIZES)
def test_least_through_every_row(rows, columns, groups):
    """The larger of time and floor, and what is left: infinite where nothing is possible."""
    random = np.random.default_rng(rows + columns)
    times = random.uniform(0, 2, (rows, columns)).astype(np.float32)
    come, gone = some(random, rows, groups), some(random, columns, groups)
    floor = random.uniform(0, 2, (groups, groups)).astype(np.float32)
    left = random.uniform(0, 2, columns).astype(np.float32)
    for impossible in (times, floor, left):
        impossible[random.random(impossible.shape) < 0.2] = np.inf
    found = least_through(times, (come, gone), floor, left)
    expected = (np.maximum(times, floor[come][:, gone]) + left).min(axis=1)
    np.testing.assert_array_equal(found, expected)


def test_points_are_as_far_apart_as_boxes_without_size(table):
    """The compiled function takes a shorter way between points."""
    random = np.random.default_rng(0)
    start, goal = (table.coordinates(random.uniform(-3, 3, (n, 4))) for n in (20, 600))
    given = boxes(start, start.copy()), boxes(goal, goal.copy())
    as_boxes = gap_times(table.laws(), *given)
    np.testing.assert_array_equal(table.times(start, goal), as_boxes)
