"""Removing and putting back, where arms go by their own clocks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dualarm_cli.orders.asynchronous.exact import exact_order
from dualarm_cli.orders.asynchronous.recreate import Recreator
from dualarm_cli.orders.asynchronous.times import timed

KINDS = (
    "",
    "before",
    "sequences",
    "windows",
    "file",
    "before sequences",
    "sequences windows",
    "file before",
)


@pytest.mark.parametrize("kind", KINDS)
def test_all_rules_are_kept_and_nothing_gets_worse(by_clocks, kept, kind):
    """Twelve tasks; every order that is told of, not the last one only."""
    for seed in range(2):
        problem = by_clocks(seed, kind, 12, 2, 1 + (seed > 0))
        search = Recreator(problem, seed)
        first = search.first()
        if first is None:
            # With the file's order on one arm and its reverse asked for there may be no place for a task.
            assert kind == "file before"
            continue
        told = []
        found = search.improve(first, 60, told.append)
        for one in (first, *told, found):
            rows = one.order.tasks(problem.options)
            assert kept(problem, rows)
            assert sorted(t for row in rows for t in row) == list(range(12))
            for a, nodes in enumerate(one.order.nodes):
                assert np.isfinite(problem.length[a][list(nodes)]).all()
            assert timed(problem, one.order) == one
        assert found.objective <= first.objective
        worths = [one.objective for one in told]
        assert worths == sorted(worths, reverse=True)
        # Without windows nothing can be late: what is found can be done.
        assert found.is_possible or "windows" in kind


def test_the_same_seed_gives_the_same_order(by_clocks):
    """To the last bit; another seed goes another way."""
    problem = by_clocks(3, "before", 14, 2)

    def way(seed):
        search = Recreator(problem, seed)
        told = []
        found = search.improve(search.first(), 120, told.append)
        return found, told

    assert way(5) == way(5)
    assert way(5)[1] != way(6)[1]


@pytest.mark.parametrize("kind", KINDS)
def test_few_tasks_are_done_as_soon_as_they_can_be(by_clocks, kind):
    """By the better of two searches as soon as in the best of all orders, but for what the arms' own times count."""
    for seed in range(2):
        problem = by_clocks(200 + seed, kind, 6, 1 if seed else 2)
        best = exact_order(problem)
        found = []
        for k in range(2):
            search = Recreator(problem, k)
            first = search.first()
            if first is not None:
                found.append(search.improve(first, 400))
        if best is None:
            assert not any(one.is_possible for one in found)
            continue
        possible = [one.total for one in found if one.is_possible]
        assert all(total >= best.total - 1e-9 for total in possible)
        # Where arms wait the search sees the waits of whole orders only, not of each place: nearly as soon.
        more = 0.06 * best.total if problem.coupled else 0.0
        assert min(possible) <= best.total + 1e-3 * sum(best.busy) + more + 1e-9, seed


def test_it_stops_when_told(by_clocks):
    """Before anything is tried: what it began with is what it returns."""
    problem = by_clocks(0, "", 12, 1)
    search = Recreator(problem, 0)
    first = search.first()
    assert search.improve(first, 10_000, stop=lambda: True) == first


def test_a_task_that_no_arm_can_do_has_no_order(by_clocks):
    """All ways of both arms infinite."""
    problem = by_clocks(1, "", 6, 2, restricted=False)
    arms = []
    for arm in problem.arms:
        first = arm.first.copy()
        first[2] = np.inf
        arms.append(replace(arm, first=first))
    nobody = replace(problem, arms=tuple(arms))
    assert Recreator(nobody, 0).first() is None
    assert exact_order(nobody) is None
