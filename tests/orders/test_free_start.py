"""A start that is free: the way to the first stop takes nothing, and all goes back there in the end."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise, permutations

import numpy as np
import pytest

from dualarm_cli.model.motion.rest_to_rest import RestToRest
from dualarm_cli.orders.asynchronous.problem import ArmTasks, SequencingProblem
from dualarm_cli.orders.paired.changes import closed
from dualarm_cli.orders.paired.problem import IDLE, StageOrder
from dualarm_cli.orders.paired.times import with_angles

LAW = RestToRest(np.array([1.0]), np.array([1e6]), np.array([np.inf]))
"""A joint that goes 1 rad/s at once."""


def line_of(places):
    """Returns tasks of one arm at places of one joint [rad], each 0.5 s long."""
    at = np.array(places)[:, None, None]
    work = np.full((len(places), 1), 0.5)
    return ArmTasks(at, at, work, np.zeros_like(work), np.array([10.0]), LAW, free=True)


def test_an_arm_that_begins_anywhere_is_counted_the_least_way_back():
    """At 0, 1 and 4 on a line; home is at 10: nothing to any place, and from each back to the nearest, itself."""
    problem = SequencingProblem((line_of([0.0, 1.0, 4.0]),), (1, 1, 1), returns=True)
    between = problem.between[0]
    np.testing.assert_allclose(between[3], 0.0)
    np.testing.assert_allclose(between[:3, 3], 0.0, atol=1e-5)
    np.testing.assert_allclose(between[0, :3], [0.0, 1.0, 4.0], atol=1e-5)
    bound_start = replace(problem, arms=(replace(problem.arms[0], free=False),)).between[0]
    np.testing.assert_allclose(bound_start[3, :3], [10.0, 9.0, 6.0], atol=1e-5)


def test_no_round_is_shorter_than_what_its_order_is_counted():
    """All orders of five places: what is counted is never more than the whole round there and back."""
    places = [0.3, -1.0, 2.0, 0.9, 5.0]
    problem = SequencingProblem((line_of(places),), (1,) * 5, returns=True)
    between = problem.between[0]
    for order in permutations(range(5)):
        way = [5, *order, 5]
        counted = sum(between[i, j] for i, j in pairwise(way))
        gone = [places[k] for k in (*order, order[0])]
        assert counted <= sum(abs(b - a) for a, b in pairwise(gone)) + 1e-5


@pytest.mark.parametrize("seed", range(6))
def test_a_closed_order_goes_back_to_its_first_stops(in_stages, seed):
    """The total without a way back, and the longest way of arms and platform from the last stage to the first."""
    problem = replace(in_stages(seed, "", 6, one_stop=True), free_start=True, returns=True)
    length = [np.array(one) for one in problem.length]
    for one in length:
        one[: problem.stops, problem.stops] = 0.0
    problem = replace(problem, length=tuple(length))
    can = [np.isfinite(work).all(axis=1) for work in problem.work]
    stops = [np.flatnonzero(own) for own in can]
    assert not set(stops[0][:2]) & set(stops[1][-2:])
    order = with_angles(problem, np.stack([stops[0][:2], stops[1][-2:]], axis=1))
    assert np.isfinite(order.total)
    begin, end = order.angles[0], order.angles[-1]
    back = [problem.turn[end, begin]]
    for a in range(2):
        first, last = order.slots[0, a], order.slots[-1, a]
        back.append(problem.length[a][last, first, end, begin] - problem.work[a][first, begin])
    assert closed(problem, order).total == pytest.approx(order.total + max(back), rel=1e-6)


def test_an_arm_that_does_nothing_has_no_way_back(in_stages):
    """And an order that cannot be stays one."""
    problem = replace(in_stages(1, "", 3, one_stop=True), free_start=True, returns=True)
    never = StageOrder(np.array([[0, IDLE]]), np.zeros(1, dtype=np.int64), np.inf)
    assert closed(problem, never) is never
