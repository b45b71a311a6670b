"""Stages at the best platform angles against all angles tried one after the other."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from dualarm_cli.orders.paired.exact import best_of_all, side_by_side
from dualarm_cli.orders.paired.problem import IDLE
from dualarm_cli.orders.paired.search import Insertions, StageSearch
from dualarm_cli.orders.paired.times import LATE, Stretches, totals, with_angles

KINDS = ("", "before", "sequences", "windows", "file", "apart", "before windows apart")


def at_angles(problem, slots, angles, begin):
    """Returns when stages at given angles are over, word by word; too late stops count LATE times."""
    clock, here = 0.0, begin
    last = [problem.stops] * slots.shape[1]
    for row, angle in zip(slots.tolist(), angles, strict=True):
        active = [a for a, stop in enumerate(row) if stop != IDLE]
        if not active:
            continue
        part = max(problem.length[a][last[a], row[a], here, angle] for a in active)
        if problem.pair_cost is not None and len(active) == 2:
            part += problem.pair_cost[row[0], row[1], angle]
        clock += part
        if problem.not_before is not None and np.isfinite(clock):
            for a in active:
                if problem.not_before[row[a]] > 0.0:
                    opens = problem.not_before[row[a]] + problem.work[a][row[a], angle]
                    clock = max(clock, opens)
        if problem.not_after is not None and np.isfinite(clock):
            closes = min(problem.not_after[row[a]] for a in active)
            clock += LATE * max(0.0, clock - closes)
        for a in active:
            last[a] = row[a]
        here = angle
    if problem.returns:
        back = [0.0 if problem.free_start else problem.turn[here, 0]]
        back += [
            problem.length[a][stop, problem.stops, here, 0]
            for a, stop in enumerate(last)
            if stop != problem.stops
        ]
        clock += max(back)
    return clock


def naive(problem, slots):
    """Returns the least over the angles of all stages, and over the first one where it is free."""
    f = len(problem.turn)
    begins = range(f) if problem.free_start else (0,)
    return min(
        at_angles(problem, slots, angles, begin)
        for angles in product(range(f), repeat=len(slots))
        for begin in begins
    )


def some_order(problem, rng, idle=0.3):
    """Returns stops of random arms in random stages, each arm with idle slots, in any order; shape (n, arms)."""
    queues = [[] for _ in problem.length]
    for own in rng.permutation(len(problem.tasks)).tolist():
        arms = [a for a in range(len(queues)) if problem.allowed(a, own)]
        queues[int(rng.choice(arms))] += problem.tasks[own]
    for queue in queues:
        for _ in range(int(rng.binomial(3, idle))):
            queue.insert(int(rng.integers(len(queue) + 1)), IDLE)
    n = max(len(queue) for queue in queues)
    return np.array([[*queue, *[IDLE] * (n - len(queue))] for queue in queues]).T


@pytest.mark.parametrize("kind", KINDS)
def test_totals_are_those_of_the_best_angles(in_stages, kind):
    """Random orders with idle arms, idle stages too, of one arm and of two."""
    rng = np.random.default_rng(8)
    for seed in range(6):
        problem = in_stages(seed, kind, 3 if "sequences" not in kind else 4, 1 + (seed > 0))
        orders = [some_order(problem, rng) for _ in range(3)]
        orders = [slots[:6] for slots in orders]
        expected = [naive(problem, slots) for slots in orders]
        n = max(len(slots) for slots in orders)
        batch = np.full((len(orders), n, len(problem.length)), IDLE)
        for k, slots in enumerate(orders):
            batch[k, : len(slots)] = slots
        np.testing.assert_allclose(totals(problem, batch), expected, rtol=1e-12)
        for slots, least in zip(orders, expected, strict=True):
            found = with_angles(problem, slots)
            assert found.total == pytest.approx(least, rel=1e-12)
            if np.isfinite(least):
                begins = range(len(problem.turn)) if problem.free_start else (0,)
                again = min(at_angles(problem, slots, found.angles, b) for b in begins)
                assert again == pytest.approx(least, rel=1e-12)


def every_order(problem, every_row, kept):
    """Yields stages of all orders that keep the rules, each arm's next stop as soon as it may."""
    for rows in every_row(len(problem.tasks), len(problem.length)):
        if not kept(problem, rows):
            continue
        queues = [[s for t in row for s in problem.tasks[t]] for row in rows]
        of = {s: t for t, own in enumerate(problem.tasks) for s in own}
        slots, over = [], set()
        while any(queues):
            row = [IDLE] * len(queues)
            for a, queue in enumerate(queues):
                firsts = {one for one, other in problem.before if queue and other == of[queue[0]]}
                if queue and firsts <= over:
                    row[a] = queue.pop(0)
            if set(row) == {IDLE}:
                break
            over |= {of[s] for s in row if s != IDLE and s == problem.tasks[of[s]][-1]}
            slots.append(row)
        else:
            yield np.array(slots)


@pytest.mark.parametrize("kind", KINDS)
def test_the_best_of_all_orders_is_found(in_stages, every_row, kept, kind):
    """Three tasks, four where two of them are a sequence, with all platform angles of every stage."""
    for seed in range(4):
        n = 4 if "sequences" in kind else 3
        problem = in_stages(20 + seed, kind, n, 1 + (seed > 0), 2)
        orders = list(every_order(problem, every_row, kept))
        least = min((naive(problem, slots) for slots in orders), default=np.inf)
        told = []
        found = best_of_all(problem, told.append)
        if not np.isfinite(least):
            assert found is None
            continue
        assert found.total == pytest.approx(least, rel=1e-12)
        assert naive(problem, found.slots) == pytest.approx(least, rel=1e-12)
        assert told[-1] == pytest.approx(least)
        assert told == sorted(told, reverse=True)


def test_four_tasks_of_one_stop_with_all_angles(in_stages, every_row, kept):
    """The same once more with more to choose from."""
    problem = in_stages(3, "before", 4, one_stop=True)
    least = min(naive(problem, slots) for slots in every_order(problem, every_row, kept))
    assert best_of_all(problem).total == pytest.approx(least, rel=1e-12)


def test_arms_that_wait_for_one_another_for_ever_have_no_stages(in_stages):
    """0 is before 3 and behind 1 on its arm, 2 is before 1 and behind 3."""
    problem = replace(in_stages(0, "", 4, one_stop=True), before=((0, 3), (2, 1)))
    units = StageSearch(problem, 0).units
    rows = ([units[1], units[0]], [units[3], units[2]])
    assert side_by_side(problem, rows) is None
    np.testing.assert_array_equal(
        side_by_side(problem, (rows[0][::-1], rows[1])), [[0, -1], [-1, 3], [-1, 2], [1, -1]]
    )


@pytest.mark.parametrize("kind", ["", "apart", "windows"])
def test_a_stretch_with_its_ends_is_worth_the_whole_order(in_stages, kind):
    """Every stretch of random orders; what comes after it is not looked at again, so without windows after it."""
    rng = np.random.default_rng(4)
    for seed in range(6):
        problem = in_stages(seed, kind, 5, 1 + (seed > 0))
        slots = some_order(problem, rng)
        slots = slots[(slots != IDLE).any(axis=1)]
        whole = totals(problem, slots[None])[0]
        values = Stretches(problem, slots)
        for first in range(len(slots) + 1):
            for last in range(first, len(slots) + 1):
                ends = values.ends(first, last)
                if kind == "windows" and ends.remaining is not None:
                    continue
                found = totals(problem, slots[None, first:last], ends)[0]
                assert found == pytest.approx(whole, rel=1e-12), (first, last)


@pytest.mark.parametrize("kind", ["", "apart", "windows", "before"])
@pytest.mark.parametrize("stretch", [False, True])
def test_insertions_cost_what_the_whole_order_costs(in_stages, kind, stretch):
    """Every place of every removed unit, in whole orders and in stretches of them."""
    rng, looked = np.random.default_rng(6), 0
    for seed in range(8):
        problem = in_stages(40 + seed, kind, 5, 1 + (seed > 0))
        search = StageSearch(problem, seed)
        if kind == "before":
            slots = search.first().slots
        else:
            # Idle slots, but no idle stages.
            slots = some_order(problem, rng)
            slots = slots[(slots != IDLE).any(axis=1)]
        begin, end = (1, len(slots) - 1) if stretch else (0, len(slots))
        ends = Stretches(problem, slots).ends(begin, end) if stretch else None
        if ends is not None and ends.remaining is not None and kind == "windows":
            continue
        inside = slots[begin:end]
        for u in search._whole(inside):
            left = search.without(inside, {u})
            tries = search._places(left, u, ends)
            assert tries
            found = Insertions(problem, left, ends).totals(tries)
            whole = [np.concatenate([slots[:begin], one.done(left), slots[end:]]) for one in tries]
            expected = [totals(problem, one[None])[0] for one in whole]
            np.testing.assert_allclose(found, expected, rtol=1e-12)
            looked += len(tries)
    assert looked > 100
