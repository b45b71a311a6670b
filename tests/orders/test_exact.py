"""The best order of few tasks against all of them, one after the other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dualarm_cli.orders.asynchronous.exact import exact_order, is_small
from dualarm_cli.orders.asynchronous.times import best_options, keeps_rules, timed

KINDS = (
    "",
    "before",
    "sequences",
    "windows",
    "file",
    "before sequences",
    "before windows",
    "sequences windows",
    "file before",
    "file sequences windows",
)


def naive(problem, every_row, kept):
    """Returns the least total of all orders that keep the rules, None where there is none."""
    totals = []
    for rows in every_row(problem.tasks, len(problem.arms)):
        if kept(problem, rows):
            found = timed(problem, best_options(problem, rows))
            if np.isfinite(found.total) and found.late <= 1e-9:
                totals.append(found.total)
    return min(totals, default=None)


@pytest.mark.parametrize("kind", KINDS)
def test_it_is_the_best_of_all_orders(by_clocks, every_row, kept, kind):
    """Five instances a kind, of four or five tasks, two of them with one way a task and one with one arm."""
    for k in range(5):
        problem = by_clocks(100 + k, kind, 4 + k % 2, 1 + k // 2, 1 if k == 4 else 2)
        assert is_small(problem)
        least, found = naive(problem, every_row, kept), exact_order(problem)
        assert (found is None) == (least is None), k
        if found is not None:
            assert found.total == pytest.approx(least, abs=1e-9), k
            assert kept(problem, found.order.tasks(problem.options))
            assert timed(problem, found.order).total == found.total
            done = sorted(t for row in found.order.tasks(problem.options) for t in row)
            assert done == list(range(problem.tasks))


def test_seven_tasks_that_depend_on_one_another(by_clocks, every_row, kept):
    """The most that are enumerated."""
    problem = by_clocks(5, "before", 7, 1)
    assert exact_order(problem).total == pytest.approx(naive(problem, every_row, kept), abs=1e-9)


def test_the_slower_arms_time_is_what_counts(by_clocks, every_row, kept):
    """Here another order is 0.3 ms slower, and easier for both arms together by more than 0.3 s."""
    problem = by_clocks(1047, "before windows", 4, 1)
    assert exact_order(problem).total == pytest.approx(naive(problem, every_row, kept), abs=1e-9)


def test_rules_are_kept_as_the_words_say(by_clocks, every_row, kept):
    """`keeps_rules` for all orders of four tasks, each with all rules."""
    for seed in range(4):
        problem = by_clocks(seed, "before sequences file" if seed % 2 else "before sequences", 4, 1)
        for rows in every_row(4, 2):
            assert keeps_rules(problem, rows) == kept(problem, rows), rows


def test_best_ways_make_an_arms_own_time_least(by_clocks):
    """All ways of three tasks in one order, 27 of them."""
    for seed in range(20):
        problem = by_clocks(seed, "", 3, 3, 1, restricted=False)
        tasks = np.random.default_rng(seed).permutation(3).tolist()
        times = []
        for ways in np.ndindex(3, 3, 3):
            clock, last = 0.0, problem.start_node
            for task, way in zip(tasks, ways, strict=True):
                node = 3 * task + way
                clock += problem.between[0][last, node] + problem.length[0][node]
                last = node
            times.append(clock + problem.between[0][last, problem.start_node])
        found = timed(problem, best_options(problem, [tasks]))
        assert found.busy[0] == pytest.approx(min(times), abs=1e-12)
        assert found.total == found.busy[0]


def test_an_order_is_timed_as_by_hand(by_clocks):
    """Two arms, a task each, one after the other's and in its window; then a window that is missed."""
    made = by_clocks(0, "", 2, 1, restricted=False)
    problem = replace(
        made,
        returns=True,
        turn=(0.0, 0.0),
        before=((0, 1),),
        not_before=np.array([9.0, 0.0]),
        not_after=np.array([np.inf, 11.0]),
    )
    found = timed(problem, best_options(problem, ((0,), (1,))))
    # The first begins when its window opens, the second when the first is over: both have long been there.
    over = 9.0 + problem.length[0][0]
    done = over + problem.length[1][1]
    home = [problem.between[0][0, 2], problem.between[1][1, 2]]
    assert found.begins == ((9.0,), (pytest.approx(over),))
    assert found.ends == ((pytest.approx(over),), (pytest.approx(done),))
    assert found.total == pytest.approx(max(over + home[0], done + home[1]))
    assert found.late == pytest.approx(max(0.0, done - 11.0))
    missed = timed(replace(problem, not_after=np.array([9.0, 9.5])), found.order)
    assert missed.late == pytest.approx(over - 9.0 + done - 9.5)
    assert not missed.is_possible
    # Each waits for the other forever.
    crossed = replace(by_clocks(0, "", 4, 1, restricted=False), before=((0, 3), (2, 1)))
    assert np.isinf(timed(crossed, best_options(crossed, ((1, 0), (3, 2)))).total)
