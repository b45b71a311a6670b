"""Annealing of stages without rules: what changes are said to be worth, and what comes of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dualarm_cli.effort import StageEffort
from dualarm_cli.orders.paired import orders as stage_orders
from dualarm_cli.orders.paired.exact import best_of_all
from dualarm_cli.orders.paired.orders import (
    NearOptimalOrders,
    StageAnnealing,
    good_orders,
    in_file_order,
    is_supported,
)
from dualarm_cli.orders.paired.problem import IDLE, StageOrder
from dualarm_cli.orders.paired.search import StageSearch
from dualarm_cli.orders.paired.times import totals, with_angles

SEEDS = st.integers(0, 10_000)


def length_of(problem, slots, angles, start):
    """Returns how long an order takes at given angles, stage by stage as StageProblem says."""
    came, at, whole = [problem.stops] * 2, start, 0.0
    for row, angle in zip(slots.tolist(), angles.tolist(), strict=True):
        if row == [IDLE, IDLE]:
            # Nothing is done: the platform has to stand.
            whole += 0.0 if angle == at else np.inf
            continue
        parts = [problem.length[a][came[a], row[a], at, angle] for a in (0, 1) if row[a] != IDLE]
        extra = (
            0.0 if problem.pair_cost is None or IDLE in row else problem.pair_cost[(*row, angle)]
        )
        whole += max(parts) + extra
        came = [stop if stop != IDLE else c for stop, c in zip(row, came, strict=True)]
        at = angle
    if not problem.returns:
        return whole
    back = [0.0 if problem.free_start else problem.turn[at, 0]]
    back += [
        problem.length[a][came[a], problem.stops, at, 0] for a in (0, 1) if came[a] != problem.stops
    ]
    return whole + max(back)


@settings(max_examples=60, deadline=None)
@given(seed=SEEDS, one_stop=st.booleans(), hot=st.floats(0.01, 2.0))
def test_changes_are_worth_what_the_order_then_takes_less(in_stages, seed, one_stop, hot):
    """Hundreds of changes of all kinds, from one order to the next; the order's length as StageProblem says it."""
    problem = in_stages(seed, "apart", 9, one_stop=one_stop)
    first = StageSearch(problem, seed).first()
    if first is None or not np.isfinite(first.total):
        return
    annealing = StageAnnealing(problem, seed)
    line = annealing.line(first.slots)
    assert line.total == pytest.approx(first.total, rel=1e-12)
    start = length_of(problem, line.slots, line.angles[1:], int(line.angles[0]))
    assert start == pytest.approx(line.total, rel=1e-12)
    for k in range(6):
        before, claimed = line.total, line.predicted
        annealing.anneal(line, range(k, k + 1), (hot, 1.0))
        now = length_of(problem, line.slots, line.angles[1:], int(line.angles[0]))
        assert now == pytest.approx(line.total, rel=1e-12)
        # At last all angles are chosen anew, which makes it no longer.
        assert now <= before + line.predicted - claimed + 1e-9
        assert now == pytest.approx(with_angles(problem, line.slots).total, rel=1e-12)
    best = with_angles(problem, line.best_slots).total
    assert best <= line.best + 1e-9


@pytest.mark.parametrize("one_stop", [True, False])
def test_at_one_angle_changes_are_worth_exactly_that(in_stages, one_stop):
    """There is nothing to choose anew."""
    changed = 0
    for seed in range(8):
        problem = in_stages(seed, "apart", 11, f=1, one_stop=one_stop)
        first = StageSearch(problem, seed).first()
        if first is None or not np.isfinite(first.total):
            continue
        annealing = StageAnnealing(problem, seed)
        line = annealing.line(first.slots)
        for k in range(8):
            before, claimed, slots = line.total, line.predicted, line.slots.tolist()
            annealing.anneal(line, range(k, k + 1), (1.0, 1.0))
            assert line.total == pytest.approx(before + line.predicted - claimed, abs=1e-9)
            changed += line.slots.tolist() != slots
    assert changed > 20


def test_of_few_tasks_the_best_order_of_all_is_found(in_stages):
    """Against every order, all angles tried; from the tasks one after the other."""
    found = 0
    for seed in range(12):
        problem = in_stages(seed, "", 6, one_stop=True)
        best = best_of_all(problem)
        rows = in_file_order(problem, StageSearch(problem, 0).units)
        start = with_angles(problem, rows)
        if best is None or not np.isfinite(start.total):
            continue
        annealed = StageAnnealing(problem, seed).improve(start, 200, heat=1.0)
        assert annealed.total <= best.total + 1e-9
        found += 1
    assert found >= 8


@pytest.mark.parametrize("one_stop", [True, False])
@pytest.mark.parametrize("kind", ["", "apart"])
def test_annealing_keeps_every_task_whole_and_never_gets_worse(in_stages, kind, one_stop):
    """Every order that is told of is what it is said to be, or better; each task is one arm's, stop after stop."""
    better = 0
    for seed in range(5):
        problem = in_stages(seed, kind, 14, one_stop=one_stop)
        first = StageSearch(problem, seed).first()
        if first is None or not np.isfinite(first.total):
            continue
        told = []
        found = StageAnnealing(problem, seed).improve(first, 40, told.append)
        better += found.total < first.total - 1e-6
        for one in (*told, found):
            assert sorted(s for s in one.slots.ravel().tolist() if s != IDLE) == list(
                range(problem.stops)
            )
            for a in range(2):
                own = [s for s in one.slots[:, a].tolist() if s != IDLE]
                tasks = [t for t in problem.tasks if t[0] in own]
                tasks.sort(key=lambda t: own.index(t[0]))
                assert own == [s for t in tasks for s in t]
            assert totals(problem, one.slots[None])[0] <= one.total + 1e-9
        assert totals(problem, found.slots[None])[0] == pytest.approx(found.total, rel=1e-12)
        assert found.total <= first.total
        sums = [one.total for one in told]
        assert sums == sorted(sums, reverse=True)
    assert better >= 2


@pytest.mark.parametrize("one_stop", [True, False])
def test_where_it_is_cold_no_round_makes_an_order_longer(in_stages, one_stop):
    """Not even where arms take turns, so that each is idle after every stop, also amid its tasks."""
    for seed in range(4):
        problem = in_stages(seed, "", 12, one_stop=one_stop)
        arms = [0 if problem.allowed(0, t) else 1 for t in range(12)]
        own = [
            [s for t, stops in enumerate(problem.tasks) if arms[t] == a for s in stops]
            for a in (0, 1)
        ]
        rows = []
        for k in range(max(len(stops) for stops in own)):
            rows += [[own[0][k], IDLE]] if k < len(own[0]) else []
            rows += [[IDLE, own[1][k]]] if k < len(own[1]) else []
        annealing = StageAnnealing(problem, seed)
        line = annealing.line(np.array(rows))
        if not np.isfinite(line.total):
            continue
        for k in range(40):
            before = line.total
            annealing.anneal(line, range(k, k + 1), (1e-12, 1.0))
            assert line.total <= before + 1e-9
            assert sorted(s for s in line.slots.ravel().tolist() if s != IDLE) == list(
                range(problem.stops)
            )
        assert len(line.slots) < len(rows)


def test_an_arm_that_is_never_asked_has_no_way_back(in_stages):
    """The other one does the only task."""
    seen = 0
    for seed in range(12):
        problem = in_stages(seed, "", 1, one_stop=True)
        problem = replace(problem, free_start=False, returns=True)
        # The way back of an arm that never left would take longest of all.
        length = np.array(problem.length[1])
        length[-1, problem.stops] = 100.0
        problem = replace(problem, length=(problem.length[0], length))
        slots = np.array([[0, IDLE]])
        order = with_angles(problem, slots)
        if np.isfinite(order.total):
            seen += 1
            line = StageAnnealing(problem, seed).line(slots)
            assert line.total == pytest.approx(order.total, rel=1e-12)
            assert order.total < 100.0
    assert seen >= 6


def test_the_same_seed_gives_the_same_order_and_a_stop_the_one_to_begin_with(in_stages):
    """To the last bit."""
    problem = in_stages(4, "apart", 16, one_stop=True)
    first = StageSearch(problem, 0).first()
    one, other = (StageAnnealing(problem, 3).improve(first, 30) for _ in range(2))
    assert one.slots.tolist() == other.slots.tolist()
    assert one.total == other.total
    stopped = StageAnnealing(problem, 3).improve(first, 10_000, stop=lambda: True)
    assert stopped.total == pytest.approx(first.total, rel=1e-12)


def test_two_tours_of_points_in_a_ring_are_found(in_stages):
    """Two arms between stops on a ring each, from one to the next in no time: it takes as long as the ring is."""
    n = 24
    problem = in_stages(0, "", 2 * n, one_stop=True, f=1)
    at = np.arange(n)
    ring = np.minimum(np.abs(at[:, None] - at), n - np.abs(at[:, None] - at)).astype(float)
    lengths = []
    for a in range(2):
        length = np.full((2 * n + 1, 2 * n + 2, 1, 1), np.inf)
        own = slice(a * n, (a + 1) * n)
        length[own, own, 0, 0] = ring
        # From the start to anywhere, and back from anywhere.
        length[2 * n, own], length[:, 2 * n] = 1.0, 0.0
        length[:, 2 * n + 1] = -np.inf
        lengths.append(length)
    work = tuple(np.where((np.arange(2 * n) // n == a)[:, None], 0.0, np.inf) for a in range(2))
    ringed = replace(
        problem, length=tuple(lengths), work=work, turn=np.zeros((1, 1)), returns=False
    )
    assert is_supported(ringed)
    rng = np.random.default_rng(1)
    slots = np.stack([rng.permutation(n), n + rng.permutation(n)], axis=1)
    start = with_angles(ringed, slots)
    assert start.total > 3 * n
    found = StageAnnealing(ringed, 0).improve(start, 400, heat=0.5)
    assert found.total == pytest.approx(n)


@pytest.mark.parametrize("kind", ["before", "sequences", "windows", "file"])
def test_problems_with_rules_are_left_to_ruin_and_recreate(in_stages, kind):
    """Rounds of annealing change nothing for them."""
    problem = in_stages(7, kind, 9)
    assert not is_supported(problem)
    one, other = (
        good_orders(problem, StageEffort(1, 200, 0.5, rounds), 0)[0] for rounds in (0, 50)
    )
    assert one.slots.tolist() == other.slots.tolist()


def test_annealing_is_no_worse_than_the_file_s_order(in_stages):
    """Nor than the nearest neighbour's; from a good order on it gets no worse either."""
    problem = in_stages(7, "apart", 12, one_stop=True)
    found = good_orders(problem, StageEffort(2, 100, 0.5, 300), 0)
    given_order = in_file_order(problem, StageSearch(problem, 0).units)
    assert found[0].total <= with_angles(problem, given_order).total + 1e-9
    again = good_orders(problem, StageEffort(1, 100, 0.5, 300), 1, found[0].slots)
    assert again[0].total <= found[0].total + 1e-9


def test_quicker_coolings_come_first_so_that_ending_early_leaves_a_good_order(
    in_stages, monkeypatch
):
    """15 of 60 stages: a quarter of the rounds; before 6400 of them 800, before those 100; one of a good order."""
    problem = in_stages(6, "", 30, one_stop=True)
    first = StageSearch(problem, 0).first()
    seen = []

    def improve(_annealing, start, rounds, *_, met=None):
        seen.append((start, rounds))
        return replace(start, total=start.total - 1.0)

    monkeypatch.setattr(StageAnnealing, "improve", improve)
    monkeypatch.setattr(StageSearch, "first", lambda _: replace(first, slots=first.slots[:15]))
    monkeypatch.setattr(stage_orders, "by_nearest", lambda *_: None)
    monkeypatch.setattr(stage_orders, "in_file_order", lambda *_: None)
    monkeypatch.setattr(stage_orders, "by_suited_arms", lambda *_: None)
    monkeypatch.setattr(StageSearch, "improve", lambda _search, start, *_: start)
    found = good_orders(problem, StageEffort(1, 1, 0.0, 25_600), 0)[0]
    assert [rounds for _, rounds in seen] == [100, 800, 6400]
    # Each goes on from what the one before found.
    assert [start.total for start, _ in seen] == [first.total - k for k in range(3)]
    assert found.total == first.total - 3.0
    # An order that is known to be good is only annealed gently, once.
    seen.clear()
    good_orders(problem, StageEffort(1, 1, 0.0, 25_600), 0, first.slots[:15])
    assert [rounds for _, rounds in seen] == [2560]


def test_orders_that_are_nearly_as_good_are_kept_with_every_cooling(in_stages):
    """Different ones, each as long as it is said to be, none longer than the best of its cooling by 2 %; best first."""
    problem = replace(in_stages(6, "", 30, one_stop=True), free_start=False)
    assert is_supported(problem)
    few = good_orders(problem, StageEffort(1, 100, 0.5, 4000), 0)
    many = good_orders(problem, StageEffort(1, 100, 0.5, 4000, coolings=3, near=8), 0)
    # What was found at first is still there, and no cooling gives more than its own and eight others.
    assert many[0].total <= few[0].total
    assert len(few) + 2 < len(many) <= len(few) + 2 + 3 * 8
    assert len({one.slots.tobytes() for one in many}) == len(many)
    assert [one.total for one in many] == sorted(one.total for one in many)
    for one in many:
        assert length_of(problem, one.slots, one.angles, 0) == pytest.approx(one.total, rel=1e-6)
    assert sum(one.total < 1.05 * many[0].total for one in many) >= len(many) - 2


def test_of_more_orders_than_there_is_room_for_the_shortest_stay():
    """An order that comes again takes no room."""
    angles = np.zeros(1, dtype=np.int64)
    orders = [StageOrder(np.array([[k, IDLE]]), angles, 10.0 + 0.1 * k) for k in range(6)]
    near = NearOptimalOrders(3)
    for k in (5, 2, 4, 2, 0, 3, 0):
        near.add(orders[k])
    assert sorted(one.total for one in near.of(10.0)) == [10.0]
    assert sorted(one.total for one in near.of(10.15)) == pytest.approx([10.0, 10.2, 10.3])
    nothing = NearOptimalOrders(0)
    nothing.add(orders[0])
    assert nothing.of(10.0) == []
