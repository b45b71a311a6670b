"""Orders of arms that change tools, by their own clocks: against every order, change by change, word by word."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise, permutations, product

import numpy as np
import pytest

from dualarm_cli.orders.asynchronous.epochs import Epoch, EpochProblem
from dualarm_cli.orders.asynchronous.exact import exact_order
from dualarm_cli.orders.asynchronous.recreate import Recreator
from dualarm_cli.orders.asynchronous.times import timed
from dualarm_cli.orders.proof.relaxation import relax_options
from dualarm_cli.orders.rules.tool_stands import NO_TOOL, ToolStands, minimum_sums


def with_tools(problem, seed, *, start=0, home=None, tools=2, costly=1.0):
    """Returns a problem whose first arm has tools, its tasks with one or the other or none, and two ways at stands."""
    rng = np.random.default_rng(seed)
    entry, leaving = rng.uniform(-2, 2, (2, 2, tools, 2, 2))
    work = costly * rng.uniform(0.3, 1.0, (2, tools, 2))
    work[0, 0, 1] = np.inf
    entry[0, 0, 1] = leaving[0, 0, 1] = np.nan
    tool = rng.integers(NO_TOOL, tools, problem.tasks)
    stands = ToolStands(tool, start, start if home is None else home, entry, leaving, work)
    return replace(problem, stands=(stands, *[None] * (len(problem.arms) - 1)))


def least_time(problem, a, tasks):
    """Returns the least time of one arm's tasks in an order, over all ways of tasks and stands, stop after stop [s]."""
    arm, stands = problem.arms[a], problem.stands[a]
    stations, on = [], NO_TOOL if stands is None else stands.start
    for t in (*tasks, None):
        new = on if stands is None else stands.home if t is None else int(stands.tool[t])
        if t is None and not problem.returns:
            break
        if new != on:
            if on != NO_TOOL:
                stations.append((stands.entry[0, on], stands.leaving[0, on], stands.work[0, on]))
            if new != NO_TOOL:
                stations.append((stands.entry[1, new], stands.leaving[1, new], stands.work[1, new]))
            on = new
        if t is not None:
            stations.append((arm.entry[t], arm.leaving[t], arm.first[t] + arm.second[t]))
    known = {}

    def time(here, there):
        key = here.tobytes(), there.tobytes()
        if key not in known:
            known[key] = float(arm.law.duration(there - here))
        return known[key]

    best = np.inf
    for ways in product(*(range(len(work)) for _, _, work in stations)):
        here, total = arm.start, 0.0
        for k, (way, (entry, leaving, work)) in enumerate(zip(ways, stations, strict=True)):
            if not np.isfinite(work[way]):
                total = np.inf
                break
            move = time(here, entry[way])
            total += max(move, problem.turn[0] if k == 0 else 0.0) + work[way]
            here = leaving[way]
        if problem.returns and stations and np.isfinite(total):
            back = time(here, arm.start)
            total += max(back, problem.turn[1])
        best = min(best, total)
    return best


@pytest.mark.parametrize("start", [0, NO_TOOL])
def test_one_arms_best_order_is_the_best_of_all(by_clocks, start):
    """Four tasks of three kinds of tools in every order, with every way of tasks and stands."""
    for seed in range(2):
        problem = with_tools(by_clocks(seed, "", 4, 2, 1), seed, start=start)
        least = min(least_time(problem, 0, row) for row in permutations(range(4)))
        found = exact_order(problem)
        assert found.total == pytest.approx(least, abs=1e-9)
        [row] = found.order.tasks(problem.options)
        assert least_time(problem, 0, row) == pytest.approx(least, abs=1e-9)
        assert min(relax_options(problem).cost[0][4, :4]) <= least


def test_two_arms_share_what_only_one_has_to_change_for(by_clocks):
    """Every assignment and order: the slower arm's time."""
    for seed in range(4):
        problem = with_tools(by_clocks(seed, "", 4, 1, 2, restricted=False), seed)
        totals = []
        for who in product((0, 1), repeat=4):
            rows = [[t for t in range(4) if who[t] == a] for a in (0, 1)]
            least = [
                min((least_time(problem, a, p) for p in permutations(row)), default=0.0)
                if row
                else 0.0
                for a, row in enumerate(rows)
            ]
            totals.append(max(least))
        assert exact_order(problem).total == pytest.approx(min(totals), abs=1e-9)
        search = Recreator(problem, seed)
        assert search.improve(search.first(), 400).total == pytest.approx(min(totals), abs=1e-9)


def changes(tools, start, home):
    """Returns how often tools change along a row of them."""
    return sum(a != b for a, b in pairwise([start, *tools, home]))


def test_tools_are_grouped_where_changes_are_dear(by_clocks):
    """Six tasks of two tools: no more than the two changes there and back, which the plain order has more of."""
    problem = replace(by_clocks(3, "", 6, 1, 1), returns=True)
    tool = np.array([0, 1, 0, 1, 0, 1])
    own = with_tools(problem, 3, costly=100.0)
    own = replace(own, stands=(replace(own.stands[0], tool=tool),))
    counted = [
        changes([int(tool[t]) for t in exact_order(one).order.tasks(1)[0]], 0, 0)
        for one in (own, problem)
    ]
    assert counted[0] == 2 < counted[1]


def test_an_arm_that_waits_counts_its_changes_too(by_clocks):
    """With precedence all is timed by clocks: the same times between tasks."""
    problem = with_tools(by_clocks(7, "before", 4, 1, 1), 7)
    found = exact_order(problem)
    [row] = found.order.tasks(1)
    rank = {t: k for k, t in enumerate(row)}
    assert all(rank[a] < rank[b] for a, b in problem.before)
    allowed = [
        p for p in permutations(range(4)) if all(p.index(a) < p.index(b) for a, b in problem.before)
    ]
    assert found.total == pytest.approx(min(least_time(problem, 0, p) for p in allowed), abs=1e-9)
    assert timed(problem, found.order).total == found.total


def test_epochs_begin_with_the_tool_of_the_one_before(by_clocks):
    """Two epochs at one angle, without turns: their sum is the time of the whole order, changes once each."""
    problem = replace(by_clocks(11, "", 4, 1, 1), returns=True, turn=(0.0, 0.0))
    problem = with_tools(problem, 11)
    epochs = (Epoch(0, (0, 1)), Epoch(0, (2, 3)))
    found = EpochProblem({0: problem}, np.zeros((1, 1)), 0).evaluated(epochs, 10)
    order = [t for rows in found.rows for t in rows[0]]
    assert sorted(order[:2]) == [0, 1]
    assert found.total == pytest.approx(least_time(problem, 0, order), abs=1e-9)


def test_least_sums_are_those_of_all_ways_through():
    """Shapes (3, 4) and (4, 2)."""
    rng = np.random.default_rng(0)
    one, other = rng.random((3, 4)), rng.random((4, 2))
    naive = [[min(one[i, k] + other[k, j] for k in range(4)) for j in range(2)] for i in range(3)]
    assert minimum_sums(one, other) == pytest.approx(np.array(naive))
