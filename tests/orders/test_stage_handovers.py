"""Hand-overs in the search for orders: both shares meet in one stage, and all places for them are looked at."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations, product

import numpy as np
import pytest

from dualarm_cli.effort import ProofEffort, StageEffort
from dualarm_cli.orders.paired.alignment import any_alignment
from dualarm_cli.orders.paired.exact import side_by_side
from dualarm_cli.orders.paired.orders import good_orders, is_few, never_touching
from dualarm_cli.orders.paired.problem import IDLE, StageProblem, stage_units
from dualarm_cli.orders.paired.search import Insertions, StageSearch, meeting_places
from dualarm_cli.orders.paired.times import totals
from dualarm_cli.orders.proof.proof import prove_order
from dualarm_cli.orders.rules.stores import Stores

PICK, GIVE, TAKE, PUT = 0, 1, 2, 3
TASKS = ((PICK, GIVE), (TAKE, PUT), (4, 5), (6,))
"""A hand-over's two shares, a task of two stops and one of one."""


def made(seed, *, giver=None, before=(), in_file_order=False, tasks=TASKS):
    """A problem of random lengths on two platform angles; either arm may give unless one is named."""
    rng = np.random.default_rng(seed)
    s, f = sum(len(own) for own in tasks), 2
    turn = np.array([[0.0, 0.7], [0.7, 0.0]])
    lengths, works = [], []
    for a in range(2):
        work = rng.uniform(0.2, 0.8, (s, f))
        if giver is not None:
            work[[TAKE, PUT] if a == giver else [PICK, GIVE]] = np.inf
        length = np.empty((s + 1, s + 2, f, f))
        length[:, :s] = np.maximum(rng.uniform(0.1, 2.0, (s + 1, s, f, f)), turn) + work[:, None, :]
        length[:, s], length[:, s + 1] = 0.0, -np.inf
        lengths.append(length)
        works.append(work)
    return StageProblem(
        tuple(lengths),
        tuple(works),
        turn,
        tasks,
        False,
        before=before,
        in_file_order=in_file_order,
        handovers=((0, 1),),
    )


def faults(problem, slots):
    """What is wrong with stages, word by word."""
    found = []
    if sorted(slots[slots != IDLE].tolist()) != list(range(problem.stops)):
        found.append("a stop is missing or twice")
    at = {s: (k, a) for k, row in enumerate(slots.tolist()) for a, s in enumerate(row) if s != IDLE}
    if at[GIVE][0] != at[TAKE][0] or at[GIVE][1] == at[TAKE][1]:
        found.append("the arms do not meet")
    for own in problem.tasks:
        arms = {at[s][1] for s in own}
        row = [s for s in slots[:, at[own[0]][1]].tolist() if s != IDLE]
        k = row.index(own[0])
        if len(arms) > 1 or tuple(row[k : k + len(own)]) != own:
            found.append(f"{own} is torn")
        if not np.isfinite(problem.work[at[own[0]][1]][own[0]]).any():
            found.append(f"{own} is not that arm's")
    of = {s: t for t, own in enumerate(problem.tasks) for s in own}
    for one, other in problem.before:
        if at[problem.tasks[one][-1]][0] >= at[problem.tasks[other][0]][0]:
            found.append(f"{other} is before {one}")
    if problem.in_file_order:
        for a in range(2):
            row = [of[s] for s in slots[:, a].tolist() if s != IDLE]
            if row != sorted(row):
                found.append("not in the file's order")
    return found


def woven(one, other):
    """Yields all stages of two queues in which give and take fall together; idle stages of both left out."""
    if not one and not other:
        yield []
        return
    heads = [queue[0] if queue else IDLE for queue in (one, other)]
    for pair in ((True, True), (True, False), (False, True)):
        row = [stop if moves else IDLE for stop, moves in zip(heads, pair, strict=True)]
        if any(moves and stop == IDLE for stop, moves in zip(heads, pair, strict=True)):
            continue
        if ({GIVE, TAKE} & set(row)) and not {GIVE, TAKE} <= set(row):
            continue
        for rest in woven(one[pair[0] :], other[pair[1] :]):
            yield [row, *rest]


def every_order(problem):
    """Yields all stages of all orders and assignments."""
    for giver, *arms in product((0, 1), repeat=len(problem.tasks) - 1):
        who = (giver, 1 - giver, *arms)
        own = [[t for t, a in enumerate(who) if a == arm] for arm in (0, 1)]
        for rows in product(*(permutations(some) for some in own)):
            queues = [[s for t in row for s in problem.tasks[t]] for row in rows]
            for slots in woven(*queues):
                yield np.array(slots)


def test_nothing_is_better_than_what_is_found():
    """All orders of a hand-over, a task of two stops and a move, woven in every way, timed one by one."""
    exact = 0
    for seed in range(4):
        problem = made(seed, giver=None if seed % 2 else 0)
        every = list(every_order(problem))
        longest = max(len(slots) for slots in every)
        batch = np.full((len(every), longest, 2), IDLE)
        for k, slots in enumerate(every):
            batch[k, : len(slots)] = slots
        least = float(totals(problem, batch).min())
        found = good_orders(problem, StageEffort(2, 400, 1.0), seed)[0]
        assert faults(problem, found.slots) == []
        assert found.total >= least - 1e-9
        assert found.total <= 1.06 * least
        exact += found.total <= least + 1e-9
        proof = prove_order(problem, found, ProofEffort(40, 100_000))
        assert faults(problem, proof.order.slots) == []
        assert proof.order.total == pytest.approx(least, abs=2e-4)
        assert proof.bound == pytest.approx(least, abs=4e-4)
    assert exact >= 3


@pytest.mark.parametrize(
    "rules", [{}, {"before": ((1, 2),)}, {"before": ((3, 0), (3, 1))}, {"in_file_order": True}]
)
def test_all_rules_are_kept(rules):
    """Two hand-overs and four more tasks; every order that is told of, not the last one only."""
    tasks = (*TASKS, (7, 8), (9,))
    for seed in range(3):
        problem = made(seed, tasks=tasks, **rules)
        search = StageSearch(problem, seed)
        first = search.first()
        if first is None:
            continue
        told = []
        found = search.improve(first, 60, told.append)
        for one in (first, *told, found):
            assert faults(problem, one.slots) == []
            assert totals(problem, one.slots[None])[0] == pytest.approx(one.total, rel=1e-12)
        assert found.total <= first.total + 1e-9


def test_arms_meet_where_buffers_make_them_wait_as_well():
    """What is handed over is put into a buffer for one, from which the giver takes it: against all ways."""
    seen = set()
    for initial, order in product((0, 1), permutations((0, 2, 3))):
        problem = made(1, giver=0)
        # The taker puts in, task 2 takes out and puts back, task 3 takes out; the other arm has the rest.
        change = np.array([0, 0, 0, 1, -1, 1, -1, 0])[:, None]
        stores = Stores(change, np.array([1]), np.array([initial]))
        queues = [[s for t in order for s in problem.tasks[t]], [TAKE, PUT]]
        possible = [w for w in woven(*queues) if stores.missing(np.array([w]))[0] == 0.0]
        found = any_alignment(stores, problem.tasks, (), queues, [(GIVE, TAKE)])
        assert found.is_whole == bool(possible)
        seen.add(found.is_whole)
        if found.is_whole:
            assert found.slots.tolist() in possible
    assert seen == {True, False}


def test_a_handover_put_in_costs_what_all_stages_cost():
    """Insertion looks at the stages about a place only: the same totals as of the whole order."""
    problem = made(5, tasks=(*TASKS[:2], (4,), (5,), (6,)))
    slots = np.array([[4, IDLE], [5, 6]])
    still = [np.zeros(3, dtype=bool)] * 2
    for giver in (0, 1):
        tries = meeting_places(slots, giver, (PICK, GIVE, TAKE, PUT), (0, 2), still)
        cost = Insertions(problem, slots, None).totals(tries)
        whole = [float(totals(problem, place.done(slots)[None])[0]) for place in tries]
        np.testing.assert_allclose(cost, whole, rtol=1e-12)
        assert all(faults(problem, place.done(slots)) == [] for place in tries)
        # By hand: three places, and where the giver is idle before (the taker after) one stage less.
        idle_before = sum(slots[k - 1, giver] == IDLE for k in (1, 2))
        idle_after = sum(slots[k, 1 - giver] == IDLE for k in (0, 1))
        assert len(tries) >= 3 + idle_before + idle_after


def test_no_handover_is_put_into_the_middle_of_other_work():
    """Between the stops of a task neither arm meets the other."""
    slots = np.array([[4, IDLE], [5, IDLE]])
    middle = [np.array([False, True, False]), np.zeros(3, dtype=bool)]
    for giver in (0, 1):
        tries = meeting_places(slots, giver, (PICK, GIVE, TAKE, PUT), (0, 2), middle)
        assert tries
        for place in tries:
            row = [s for s in place.done(slots)[:, 0].tolist() if s != IDLE]
            assert row.index(5) == row.index(4) + 1


def test_the_file_s_order_lets_the_arms_meet():
    """Queues by hand: the giver's other task first, the taker waits."""
    problem = made(0, giver=0)
    giving, taking = stage_units(problem)[0].shares(0)
    two, one = stage_units(problem)[1:]
    found = side_by_side(problem, [[two, giving], [one, taking]])
    np.testing.assert_array_equal(
        found, [[4, 6], [5, IDLE], [PICK, IDLE], [GIVE, TAKE], [IDLE, PUT]]
    )
    assert not is_few(problem)


def test_stops_that_touch_are_taken_apart_but_for_handovers():
    """Where no angle lets arms meet, nothing else repairs it."""
    problem = made(0, giver=0)
    apart = np.zeros((9, 9, 2))
    apart[GIVE, TAKE] = apart[4, 6] = np.inf
    problem = StageProblem(
        problem.length,
        problem.work,
        problem.turn,
        TASKS,
        False,
        handovers=((0, 1),),
        pair_cost=apart,
    )
    slots = np.array([[PICK, IDLE], [GIVE, TAKE], [4, PUT], [5, IDLE]])
    np.testing.assert_array_equal(never_touching(problem, slots), slots)
    slots = np.array([[4, 6], [5, IDLE]])
    np.testing.assert_array_equal(never_touching(problem, slots), [[4, IDLE], [IDLE, 6], [5, IDLE]])


def test_long_orders_are_improved_in_stretches_and_arms_still_meet():
    """Thirty tasks of two stops beside the hand-over: stretches begin and end within it as well."""
    more = tuple((7 + 2 * k, 8 + 2 * k) for k in range(30))
    problem = made(7, tasks=(*TASKS, *more))
    search = StageSearch(problem, 1)
    first = search.first()
    assert len(first.slots) > 30
    told = []
    found = search.improve_stretches(first, 25, told.append)
    assert told
    for one in (*told, found):
        assert faults(problem, one.slots) == []
    assert found.total < first.total
    assert totals(problem, found.slots[None])[0] == pytest.approx(found.total, rel=1e-12)


def with_parts(problem, changes, capacity, initial):
    """The problem with one buffer, by stop what is put or taken."""
    change = np.zeros((problem.stops + 1, 1), dtype=np.int64)
    for stop, by in changes.items():
        change[stop] = by
    return replace(problem, stores=Stores(change, np.array([capacity]), np.array([initial])))


@pytest.mark.parametrize("in_file_order", [True, False])
def test_arms_meet_where_buffers_make_them_wait(in_file_order):
    """What is handed over comes out of a buffer that another task fills: both rules are kept by all that is found."""
    for seed in range(4):
        problem = with_parts(made(seed, in_file_order=in_file_order), {PICK: -1, 5: 1}, 1, 0)
        units = stage_units(problem)
        meeting = next(unit for unit in units if unit.meets)
        others = [unit for unit in units if not unit.meets]
        giving, taking = meeting.shares(0)
        slots = side_by_side(problem, [[giving], [*others, taking]])
        assert faults(replace(problem, in_file_order=False), slots) == []
        assert problem.stores.missing(slots[None])[0] == 0.0
        for one in good_orders(problem, StageEffort(2, 200, 1.0), seed):
            assert faults(problem, one.slots) == []
            assert problem.stores.missing(one.slots[None])[0] == 0.0


def test_an_arm_that_would_wait_for_the_other_to_meet_for_ever_is_told():
    """The part for the hand-over is put by the giving arm itself, later: there is no way."""
    problem = with_parts(made(0), {PICK: -1, 5: 1}, 1, 0)
    other = next(unit for unit in stage_units(problem) if unit.stops == (4, 5))
    giving, taking = next(unit for unit in stage_units(problem) if unit.meets).shares(0)
    assert side_by_side(problem, [[giving, other], [taking]]) is None
