"""Buffers in stages, against all orders, assignments and pairings one after the other, and parts counted by hand."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from dualarm_cli.effort import StageEffort
from dualarm_cli.orders.paired.alignment import any_alignment
from dualarm_cli.orders.paired.exact import best_of_all
from dualarm_cli.orders.paired.orders import good_orders, is_few
from dualarm_cli.orders.paired.problem import IDLE, StageProblem
from dualarm_cli.orders.paired.search import Insertions, StageSearch
from dualarm_cli.orders.paired.times import Stretches, totals, with_angles
from dualarm_cli.orders.rules.stores import MISSING, Stores

EFFORT = StageEffort(3, 2_000, 1.0)


def counts(problem: StageProblem, stages: list[tuple[int, ...]]) -> int:
    """Returns how many parts are missing or without room: in each stage puts first, then takes first, the worse."""
    stores, wrong = problem.stores, 0
    for k, capacity in enumerate(stores.capacity.tolist()):
        level = int(stores.initial[k])
        for row in stages:
            change = [int(stores.change[stop, k]) for stop in row if stop != IDLE]
            puts, takes = change.count(1), change.count(-1)
            wrong += max(0, level + puts - capacity) if puts else 0
            wrong += max(0, takes - level) if takes else 0
            level += puts - takes
    return wrong


def pairings(queues: tuple[tuple[int, ...], ...]) -> Iterator[list[tuple[int, ...]]]:
    """Yields every way in which the stops of one or two arms fall into stages."""
    if not any(queues):
        yield []
        return
    for goes in np.ndindex(*(2 for _ in queues)):
        if not any(goes) or any(one and not own for one, own in zip(goes, queues, strict=True)):
            continue
        row = tuple(own[0] if one else IDLE for one, own in zip(goes, queues, strict=True))
        rest = tuple(own[1:] if one else own for one, own in zip(goes, queues, strict=True))
        for more in pairings(rest):
            yield [row, *more]


def aligned(problem: StageProblem, queues):
    """Returns any stages of some rows of stops."""
    return any_alignment(problem.stores, problem.tasks, problem.before, queues)


def in_order(problem: StageProblem, stages: list[tuple[int, ...]]) -> bool:
    """Says whether tasks that come before others are over in a stage before."""
    at = {stop: k for k, row in enumerate(stages) for stop in row if stop != IDLE}
    return all(
        at[problem.tasks[one][-1]] < at[problem.tasks[other][0]] for one, other in problem.before
    )


def every(problem, every_row, kept) -> list[list[tuple[int, ...]]]:
    """Returns the stages of all orders that keep all rules."""
    arms, found = len(problem.length), []
    for rows in every_row(len(problem.tasks), arms):
        if not kept(problem, rows):
            continue
        if any(not problem.allowed(a, t) for a, row in enumerate(rows) for t in row):
            continue
        queues = tuple(tuple(s for t in row for s in problem.tasks[t]) for row in rows)
        found += [
            one for one in pairings(queues) if counts(problem, one) == 0 and in_order(problem, one)
        ]
    return found


def least(problem, orders) -> float:
    """Returns the least total of some orders, the buffers left out, infinite for none."""
    plain = replace(problem, stores=None)
    length = max((len(one) for one in orders), default=0)
    batch = np.full((len(orders), length, len(problem.length)), IDLE)
    for k, one in enumerate(orders):
        batch[k, : len(one)] = one
    return float(totals(plain, batch).min()) if orders else np.inf


@pytest.mark.parametrize("kind", ["", "before", "sequences", "file", "apart", "before apart"])
def test_few_tasks_the_best_of_all_orders_and_pairings(
    in_stages, with_stores, every_row, kept, kind
):
    """Ten instances a kind, three or four tasks, one with one arm; some have no order at all."""
    there = 0
    for k in range(10):
        arms = 1 if k == 9 else 2
        problem = with_stores(in_stages(400 + k, kind, 3 + k % 2, arms), 900 + k)
        assert is_few(problem)
        value = least(problem, every(problem, every_row, kept))
        found = best_of_all(problem)
        assert (found is not None) == np.isfinite(value), k
        if found is None:
            assert good_orders(problem, EFFORT, 0) == []
            continue
        there += 1
        assert found.total == pytest.approx(value, abs=1e-9), k
        stages = [tuple(row) for row in found.slots.tolist()]
        assert counts(problem, stages) == 0
        assert in_order(problem, stages)
        assert sorted(s for row in stages for s in row if s != IDLE) == list(range(problem.stops))
    assert there >= 2


def test_the_search_finds_the_best_of_few_tasks_too(in_stages, with_stores, every_row, kept):
    """Ruin and recreate from an order put together by insertion, on instances that have orders."""
    ratios = []
    for k in range(8):
        problem = with_stores(in_stages(500 + k, "", 4), 950 + k)
        value = least(problem, every(problem, every_row, kept))
        if not np.isfinite(value):
            continue
        search = StageSearch(problem, k)
        first = search.first()
        found = search.improve(first, 200)
        stages = [tuple(row) for row in found.slots.tolist()]
        assert found.total >= value - 1e-9
        assert counts(problem, stages) == 0
        ratios.append(found.total / value)
    assert len(ratios) >= 4
    assert np.mean(ratios) < 1.02


def test_missing_parts_count_as_by_hand(in_stages, with_stores):
    """Random stages of random stops, rules or not; at once, and after some other stages."""
    rng = np.random.default_rng(3)
    for k in range(20):
        problem = with_stores(in_stages(k, "", 5), k)
        slots = rng.permutation(np.append(np.arange(problem.stops), [IDLE] * problem.stops))
        slots = slots.reshape(-1, 2)
        wrong = counts(problem, [tuple(row) for row in slots.tolist()])
        assert problem.stores.missing(slots[None])[0] == MISSING * wrong
        half = len(slots) // 2
        level = problem.stores.after(slots[:half])
        parts = (
            problem.stores.missing(slots[None, :half]),
            problem.stores.missing(slots[None, half:], level),
        )
        assert sum(parts)[0] == MISSING * wrong


def test_both_orders_within_a_stage_have_to_be_possible():
    """A part goes in while one is taken: there has to be one already, and room for one more."""
    stores = Stores(np.array([[1], [-1], [0]]), np.array([2]), np.array([0]))
    stage = np.array([[[0, 1]]])
    wrong = [stores.missing(stage, np.array([level]))[0] / MISSING for level in range(3)]
    assert wrong == [1.0, 0.0, 1.0]


def test_every_place_is_priced_with_its_parts(in_stages, with_stores):
    """Insertion against the whole order with the stops in it, alone and as a stretch of a longer one."""
    rng = np.random.default_rng(8)
    looked = 0
    for k in range(12):
        problem = with_stores(in_stages(k, "", 6), 40 + k)
        search = StageSearch(problem, k)
        whole = search.first().slots
        for u in range(len(search.units)):
            left = search.without(whole, {u})
            tries = search._places(left, u, None)
            found = Insertions(problem, left, None).totals(tries)
            for place, total in zip(tries, found.tolist(), strict=True):
                assert total == pytest.approx(with_angles(problem, place.done(left)).total)
                looked += 1
        begin = int(rng.integers(len(whole)))
        span = int(rng.integers(1, len(whole) - begin + 1))
        ends = Stretches(problem, whole).ends(begin, begin + span)
        part = totals(problem, whole[None, begin : begin + span], ends)[0]
        before = problem.stores.missing(whole[None, :begin])[0]
        after = begin + span + len(ends.next_stages)
        level = problem.stores.after(whole[:after])
        rest = problem.stores.missing(whole[None, after:], level)[0]
        assert part + before + rest == pytest.approx(with_angles(problem, whole).total)
    assert looked > 100


def test_arms_wait_where_going_on_would_lead_nowhere(in_stages):
    """Side by side both puts fill the buffer, and what is next is a put and a part that is not there yet."""
    made = in_stages(0, "", 5, one_stop=True)
    # The left arm: puts one into A, takes one out of B. The right arm: puts two into A, and one into B.
    change = np.zeros((6, 2), dtype=np.int64)
    change[[0, 2, 3], 0] = 1
    change[1, 1], change[4, 1] = -1, 1
    problem = replace(made, stores=Stores(change, np.array([2, 1]), np.array([0, 0])))
    assert not aligned(problem, [[0, 1], [2, 3, 4]]).is_whole
    # Three puts into room for two: at most all of the right arm's own are made.
    assert aligned(problem, [[0, 1], [2, 3, 4]]).at == (0, 3)
    roomy = replace(problem, stores=replace(problem.stores, capacity=np.array([3, 1])))
    slots = aligned(roomy, [[0, 1], [2, 3, 4]]).slots
    assert counts(roomy, [tuple(row) for row in slots.tolist()]) == 0
    # With a take of A by the right arm after its two puts there is one way: the left arm's put comes last.
    change = np.zeros((6, 2), dtype=np.int64)
    change[[0, 2, 3], 0], change[4, 0] = 1, -1
    tight = replace(made, stores=Stores(change, np.array([2, 1]), np.array([0, 0])))
    slots = aligned(tight, [[0, 1], [2, 3, 4]]).slots
    order = [stop for row in slots.tolist() for stop in row if stop != IDLE]
    assert order.index(4) < order.index(0)
    assert counts(tight, [tuple(row) for row in slots.tolist()]) == 0


@pytest.mark.parametrize("kind", ["", "before", "file"])
def test_any_alignment_is_found_where_there_is_one(in_stages, with_stores, every_row, kept, kind):
    """Against all pairings of every two rows of three tasks."""
    seen = set()
    for k in range(6):
        problem = with_stores(in_stages(700 + k, kind, 3), 70 + k, 1)
        for rows in every_row(3, 2):
            queues = tuple(tuple(s for t in row for s in problem.tasks[t]) for row in rows)
            some = [p for p in pairings(queues) if counts(problem, p) == 0 and in_order(problem, p)]
            found = aligned(problem, queues)
            assert found.is_whole == bool(some)
            if found.is_whole:
                assert [tuple(row) for row in found.slots.tolist()] in some
            seen.add(found.is_whole)
    assert seen == {True, False}


def test_many_tasks_have_an_order_that_keeps_their_buffer(in_stages):
    """Twelve loads of one arm or both into room for two, and twelve unloads."""
    for seed in range(3):
        made = in_stages(seed, "", 24, one_stop=True)
        change = np.zeros((25, 1), dtype=np.int64)
        change[:12], change[12:24] = 1, -1
        problem = replace(made, stores=Stores(change, np.array([2]), np.array([0])))
        found = good_orders(problem, StageEffort(1, 1_000, 0.2), seed)
        assert found
        for one in found:
            assert counts(problem, [tuple(row) for row in one.slots.tolist()]) == 0
