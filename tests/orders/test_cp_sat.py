"""Bounds on all orders: never more than an order takes, and no less than they can be."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from dualarm_cli.orders.asynchronous.exact import exact_order
from dualarm_cli.orders.asynchronous.times import best_options, timed
from dualarm_cli.orders.paired.exact import best_of_all
from dualarm_cli.orders.paired.search import StageSearch
from dualarm_cli.orders.proof.cp_sat import prove
from dualarm_cli.orders.proof.relaxation import Relaxation, relax_options, relax_stages

KINDS = ("", "before", "sequences", "windows", "file", "before sequences windows")
EFFORT = 5.0


@pytest.mark.parametrize("one_stop", [True, False])
def test_least_times_of_stages_are_the_least_of_all_angles(in_stages, one_stop):
    """Word by word: from the last stop of a task to the last of the next, the way from the start and back."""
    for seed in range(6):
        problem = in_stages(seed, "", 4, one_stop=one_stop)
        found, s, f = relax_stages(problem), problem.stops, range(len(problem.turn))
        shortest = np.full(4, np.inf)
        for a, length in enumerate(problem.length):
            for t, own in enumerate(problem.tasks):
                inside = sum(
                    min(length[i, j, g, h] for g in f for h in f) for i, j in pairwise(own)
                )
                work = min(problem.work[a][own[0], g] for g in f)
                shortest[t] = min(shortest[t], work + inside)
                for c, before in enumerate([*problem.tasks, (s,)]):
                    begins = f if before != (s,) or problem.free_start else [0]
                    goes = min(length[before[-1], own[0], g, h] for g in begins for h in f)
                    assert found.cost[a][c, t] == pytest.approx(goes + inside)
                back = min(length[own[-1], s, g, h] for g in f for h in f)
                assert found.cost[a][t, 4] == pytest.approx(back)
        assert found.least == pytest.approx(shortest)


@pytest.mark.parametrize("kind", KINDS)
def test_no_order_by_clocks_is_faster_than_the_bound(by_clocks, every_row, kept, kind):
    """Every order of five tasks in several ways."""
    for seed in range(4):
        problem = by_clocks(seed, kind, 5, 1 + seed % 3, 1 if seed == 3 else 2)
        found = prove(relax_options(problem), None, EFFORT, 0)
        totals = [
            one.total
            for rows in every_row(problem.tasks, len(problem.arms))
            if kept(problem, rows)
            for one in [timed(problem, best_options(problem, rows))]
            if one.is_possible
        ]
        assert found.bound <= min(totals, default=np.inf) + 1e-9
        if found.impossible:
            assert not totals
        else:
            assert found.bound > 0.0
            assert kept(problem, found.tasks)
            assert sorted(t for row in found.tasks for t in row) == list(range(5))


@pytest.mark.parametrize("kind", ["", "sequences", "file", "before"])
def test_of_one_way_by_clocks_the_bound_is_the_best_order(by_clocks, kind):
    """But for rounding down: a millisecond for each way between two tasks.

    With precedence too where tasks take both arms equally long.
    """
    for seed in range(4):
        problem = by_clocks(30 + seed, kind, 6, 1, 1 + (seed > 0), restricted=kind != "before")
        if kind == "before":
            one = problem.arms[0]
            same = [replace(arm, first=one.first, second=one.second) for arm in problem.arms]
            problem = replace(problem, arms=tuple(same))
        best, found = exact_order(problem), prove(relax_options(problem), None, EFFORT, 0)
        if best is None:
            assert found.impossible
            continue
        assert best.total - 1e-3 * (problem.tasks + 1) <= found.bound <= best.total + 1e-9
        again = timed(problem, best_options(problem, found.tasks))
        assert again.total <= found.bound + 1e-3 * (problem.tasks + 1)


def test_an_order_of_less_than_a_second_is_bounded_by_what_it_takes(by_clocks):
    """The same work fifty times as quick: the bound follows."""
    problem = by_clocks(31, "", 4, 1, 2)
    slow, best = relax_options(problem), exact_order(problem)
    quick = replace(slow, cost=tuple(c / 50.0 for c in slow.cost), least=slow.least / 50.0)
    found = prove(quick, None, EFFORT, 0)
    assert best is not None
    assert best.total / 50.0 < 0.9
    assert best.total / 50.0 - 1e-3 * (problem.tasks + 1) <= found.bound <= best.total / 50.0 + 1e-9


@pytest.mark.parametrize("kind", [*KINDS, "apart"])
def test_no_order_of_stages_is_faster_than_the_bound(in_stages, kind):
    """The best of all orders of five tasks, and what a search finds with idle arms."""
    for seed in range(4):
        problem = in_stages(seed, kind, 5, 1 + (seed > 0))
        found = prove(relax_stages(problem), None, EFFORT, 0)
        best = best_of_all(problem)
        totals = [np.inf if best is None else best.total]
        search = StageSearch(problem, seed)
        totals += [one.total for one in [search.first() for _ in range(10)] if one is not None]
        if found.impossible:
            # What is late counts a thousandfold.
            assert min(totals) > 100.0 or "windows" in kind
        else:
            assert 0.0 < found.bound <= min(totals) + 1e-9


def test_one_arm_at_one_angle_has_the_best_order_as_its_bound(in_stages):
    """Nobody waits for anybody, the platform never turns: the relaxation leaves nothing out."""
    for seed in range(4):
        problem = replace(in_stages(seed, "", 5, 1, 1), returns=seed % 2 == 0)
        if not problem.returns:
            length = problem.length[0].copy()
            length[:, problem.stops] = 0.0
            problem = replace(problem, length=(length,))
        best = best_of_all(problem).total
        found = prove(relax_stages(problem), None, EFFORT, 0)
        assert best - 1e-3 * (problem.stops + 1) <= found.bound <= best + 1e-9


def test_a_hint_changes_nothing_that_is_proven(by_clocks):
    """Good or bad."""
    problem = by_clocks(2, "before", 6, 1, restricted=False)
    relaxed = relax_options(problem)
    plain = prove(relaxed, None, EFFORT, 0).bound
    for start in (exact_order(problem).order.tasks(1), ((0, 1, 2, 3, 4, 5), ())):
        assert prove(relaxed, start, EFFORT, 0).bound == plain


def test_bounds_that_are_told_grow_up_to_the_last_one(by_clocks):
    """And none is above it."""
    relaxed, told = relax_options(by_clocks(4, "before", 8, 1)), []
    found = prove(relaxed, None, EFFORT, 0, bounded=told.append)
    assert told == sorted(told)
    assert all(one <= found.bound + 1e-9 for one in told)


@pytest.fixture
def three():
    """Three tasks of one arm: a second each, a second to each and between any two, none back."""
    cost = np.full((4, 4), 2.0)
    cost[:, 3] = 0.0
    return Relaxation((cost,), np.ones(3))


def test_three_tasks_by_hand(three):
    """A way and a task, three times."""
    assert prove(three, None, EFFORT, 0).bound == pytest.approx(6.0)
    # Both arms do some: the slower one two of them.
    both = replace(three, cost=three.cost * 2)
    assert prove(both, None, EFFORT, 0).bound == pytest.approx(4.0)
    # One may begin at 7 at the earliest: it is over at 8, and last.
    late = replace(three, not_before=np.array([0.0, 7.0, 0.0]))
    found = prove(late, None, EFFORT, 0)
    assert found.bound == pytest.approx(8.0)
    assert found.tasks[0][-1] == 1


IMPOSSIBLE = {
    "two at once": {"not_after": np.array([2.5, 3.0, np.inf])},
    "too soon": {"not_after": np.array([1.9, np.inf, np.inf])},
    "all three in five": {"not_after": np.full(3, 5.5)},
    "in a ring": {"before": ((0, 1), (1, 2), (2, 0))},
    "between a row": {"before": ((0, 2), (2, 1)), "sequences": ((0, 1),)},
    "before what comes late": {
        "before": ((0, 1),),
        "not_before": np.array([5.0, 0, 0]),
        "not_after": np.array([np.inf, 7.9, np.inf]),
    },
    "file and row": {"in_file_order": True, "sequences": ((1, 0),)},
}


@pytest.mark.parametrize("name", IMPOSSIBLE)
def test_rules_that_none_can_keep_are_proven_impossible(three, name):
    """By hand: the k-th task is over after 2 k s at the earliest."""
    found = prove(replace(three, **IMPOSSIBLE[name]), None, EFFORT, 0)
    assert found.impossible
    assert np.isinf(found.bound)
    assert found.tasks is None


def test_a_little_more_time_makes_them_possible(three):
    """A millisecond more than it takes."""
    for rules in (
        {"not_after": np.array([2.001, 4.001, np.inf])},
        {"not_after": np.full(3, 6.001)},
        {
            "before": ((0, 1),),
            "not_before": np.array([5.0, 0, 0]),
            "not_after": np.array([np.inf, 8.001, np.inf]),
        },
        {"before": ((2, 0),), "sequences": ((0, 1),)},
    ):
        assert not prove(replace(three, **rules), None, EFFORT, 0).impossible


def test_a_task_that_no_arm_can_do_is_impossible(three):
    """Its row and column infinite."""
    cost = three.cost[0].copy()
    cost[1] = cost[:, 1] = np.inf
    alone = replace(three, cost=(cost,), least=np.array([1.0, np.inf, 1.0]))
    assert alone.allowed(0).tolist() == [True, False, True]
    assert prove(alone, None, EFFORT, 0).impossible


def test_a_sequence_is_of_one_arm(three):
    """Each arm can do one of the two."""
    one, other = three.cost[0].copy(), three.cost[0].copy()
    one[1] = one[:, 1] = other[0] = other[:, 0] = np.inf
    shared = replace(three, cost=(one, other))
    assert not prove(shared, None, EFFORT, 0).impossible
    assert prove(replace(shared, sequences=((0, 1),)), None, EFFORT, 0).impossible
