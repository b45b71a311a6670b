"""Removing and putting back, where arms go from stage to stage together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dualarm_cli.effort import ProofEffort, StageEffort
from dualarm_cli.orders.paired.exact import best_of_all
from dualarm_cli.orders.paired.orders import (
    good_orders,
    in_file_order,
    is_few,
    nearest_stages,
    short_search,
)
from dualarm_cli.orders.paired.problem import IDLE, split_pairs
from dualarm_cli.orders.paired.search import StageSearch
from dualarm_cli.orders.paired.times import totals, with_angles
from dualarm_cli.orders.proof.proof import prove_order

KINDS = ("", "before", "sequences", "windows", "file", "apart", "before sequences windows")


def keeps_all(problem, slots, kept):
    """Says whether stages do every stop once, on an arm that can, and keep every rule, word by word."""
    stops = slots[slots != IDLE].tolist()
    if sorted(stops) != list(range(problem.stops)) or (slots == IDLE).all(axis=1).any():
        return False
    of = {s: t for t, own in enumerate(problem.tasks) for s in own}
    rows = []
    for a in range(slots.shape[1]):
        own = [s for s in slots[:, a].tolist() if s != IDLE]
        row = list(dict.fromkeys(of[s] for s in own))
        # Each task's stops one right after the other.
        if own != [s for t in row for s in problem.tasks[t]]:
            return False
        if any(not np.isfinite(problem.work[a][s]).any() for s in own):
            return False
        rows.append(tuple(row))
    stage = {s: k for k, row in enumerate(slots.tolist()) for s in row if s != IDLE}
    in_time = all(
        stage[problem.tasks[one][-1]] < stage[problem.tasks[other][0]]
        for one, other in problem.before
    )
    return in_time and kept(problem, tuple(rows))


@pytest.mark.parametrize("kind", KINDS)
def test_all_rules_are_kept_and_nothing_gets_worse(in_stages, kept, kind):
    """Ten tasks; every order that is told of, not the last one only."""
    for seed in range(2):
        problem = in_stages(seed, kind, 10, 1 + (seed > 0))
        search = StageSearch(problem, seed)
        first = search.first()
        told = []
        found = search.improve(first, 60, told.append)
        for one in (first, *told, found):
            assert keeps_all(problem, one.slots, kept)
            assert totals(problem, one.slots[None])[0] == pytest.approx(one.total, rel=1e-12)
        assert found.total <= first.total
        sums = [one.total for one in told]
        assert sums == sorted(sums, reverse=True)


@pytest.mark.parametrize("kind", ["", "before", "sequences", "file", "apart"])
def test_stretches_of_long_orders_get_better_by_as_much_as_all(in_stages, kept, kind):
    """Thirty tasks; what a stretch is told to be worth is what the order is worth."""
    for seed in range(1):
        problem = in_stages(seed, kind, 30)
        search = StageSearch(problem, seed)
        first = search.first()
        told = []
        found = search.improve_stretches(first, 6, told.append)
        assert found.total <= first.total + 1e-9
        for one in (*told, found):
            assert keeps_all(problem, one.slots, kept)
        if "windows" not in kind:
            for one in told:
                assert totals(problem, one.slots[None])[0] == pytest.approx(one.total, rel=1e-9)
        assert told or kind in ("file", "windows")


def test_the_same_seed_gives_the_same_order(in_stages):
    """To the last bit; another seed goes another way."""
    problem = in_stages(3, "before", 12)

    def way(seed):
        search = StageSearch(problem, seed)
        told = []
        search.improve(search.first(), 60, told.append)
        return [(one.slots.tolist(), one.total) for one in told]

    assert way(5) == way(5)
    assert way(5) != way(6)
    effort = StageEffort(1, 200, 0.5)
    one, other = (good_orders(problem, effort, 1) for _ in range(2))
    assert [x.slots.tolist() for x in one] == [x.slots.tolist() for x in other]
    assert [x.total for x in one] == [x.total for x in other]


@pytest.mark.parametrize("kind", KINDS)
def test_few_tasks_are_done_at_least_as_soon_as_in_the_best_of_all(in_stages, kept, kind):
    """The search may leave an arm idle where it could go on, so it may even be quicker."""
    for seed in range(2):
        problem = in_stages(60 + seed, kind, 5)
        best = best_of_all(problem)
        search = StageSearch(problem, seed)
        first = search.first()
        if best is None:
            continue
        found = search.improve(first, 150)
        assert keeps_all(problem, found.slots, kept)
        assert found.total <= best.total + 1e-9, seed


@pytest.mark.parametrize("kind", ["", "before", "file", "before sequences windows"])
def test_good_orders_are_different_and_the_best_comes_first(in_stages, kept, kind):
    """Nine tasks by search, five by all orders; none slower than the order in the file."""
    problem = in_stages(7, kind, 9)
    assert not is_few(problem)
    told = []
    found = good_orders(problem, StageEffort(2, 300, 0.5), 0, None, told.append)
    assert found
    sums = [one.total for one in found]
    assert sums == sorted(sums)
    assert len({one.slots.tobytes() for one in found}) == len(found)
    assert all(keeps_all(problem, one.slots, kept) for one in found)
    assert min(told) == pytest.approx(sums[0])
    given = in_file_order(problem, StageSearch(problem, 0).units)
    if given is not None:
        assert sums[0] <= with_angles(problem, given).total + 1e-9
    few = in_stages(8, kind, 5)
    assert is_few(few)
    assert good_orders(few, StageEffort(2, 300, 0.5), 0)[0].total == best_of_all(few).total


def test_one_that_is_told_to_stop_has_an_order_all_the_same(in_stages, kept):
    """The first one, however it is."""
    problem = in_stages(2, "", 12)
    found = good_orders(problem, StageEffort(8, 10_000, 1.0), 0, stop=lambda: True)
    assert keeps_all(problem, found[0].slots, kept)


def test_a_good_start_is_never_lost(in_stages, kept):
    """The search goes on from there."""
    problem = in_stages(5, "", 9)
    start = good_orders(problem, StageEffort(2, 900, 0.5), 0)[0]
    again = good_orders(problem, StageEffort(1, 50, 0.5), 9, start.slots)
    assert again[0].total <= start.total
    assert keeps_all(problem, again[0].slots, kept)


def test_stops_that_touch_are_put_into_stages_of_their_own():
    """Pairs are by arm: the reverse of a pair is none."""
    slots = np.array([[0, 1], [2, IDLE], [3, 4], [1, 0]])
    np.testing.assert_array_equal(
        split_pairs(slots, {(0, 1), (4, 3)}),
        [[0, IDLE], [IDLE, 1], [2, IDLE], [3, 4], [1, 0]],
    )
    np.testing.assert_array_equal(split_pairs(slots, set()), slots)


def test_stops_that_touch_everywhere_are_never_side_by_side(in_stages):
    """A table that lets no two stops meet: as many stages as stops."""
    problem = in_stages(1, "", 8)
    table = np.zeros((problem.stops + 2, problem.stops + 2, 3))
    table[: problem.stops, : problem.stops] = np.inf
    lonely = replace(problem, pair_cost=table)
    found = good_orders(lonely, StageEffort(1, 100, 0.5), 0)
    assert len(found[0].slots) == problem.stops
    assert np.isfinite(found[0].total)


def test_the_search_is_never_worse_than_the_nearest_neighbour_that_it_may_begin_with(in_stages):
    """Without rules; an arm that can do nothing more is idle, and what no arm can do has no order."""
    seen = 0
    for seed in range(6):
        problem = in_stages(seed, "", 9, 2)
        nearest = nearest_stages(problem)
        if nearest is None:
            continue
        assert sorted(k for row in nearest.tolist() for k in row if k != IDLE) == list(
            range(problem.stops)
        )
        least = float(totals(problem, nearest[None])[0])
        found = good_orders(problem, StageEffort(1, 1, 0.0), seed)
        seen += np.isfinite(least)
        assert found[0].total <= least + 1e-9
    assert seen >= 3
    never = tuple(np.full_like(x, np.inf) for x in problem.length)
    assert nearest_stages(replace(problem, length=never)) is None


def test_a_short_search_comes_near_the_best_order_of_all(in_stages):
    """In the order of the file, of six tasks; never below what is proven by dynamic programming."""
    near = looked = 0
    for seed in range(10):
        problem = in_stages(seed, "file", 6, one_stop=True)
        best, found = best_of_all(problem), short_search(problem, StageEffort(1, 1, 1.0), 0)
        if best is None or found is None or not np.isfinite(found):
            continue
        proven = prove_order(problem, best, ProofEffort(40, 20_000))
        assert found >= proven.bound - 1e-3
        looked += 1
        near += found <= 1.05 * proven.order.total
    assert looked >= 6
    assert near >= 0.8 * looked
