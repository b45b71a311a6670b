"""Epochs of a platform that turns now and then, against all ways to share tasks out to them."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations, product

import numpy as np
import pytest

from dualarm_cli.effort import EpochEffort
from dualarm_cli.orders.asynchronous.epochs import Epoch, EpochProblem, EpochSearch
from dualarm_cli.orders.rules.stores import Stores

EFFORT = EpochEffort(sets=12, moves=80, glance=20, close=50)
ANGLES = (0, 1, 2)


def epoch_problem(by_clocks, seed, kind="", n=4):
    """Returns a job at three platform angles, from none of which all tasks are reached."""
    rng = np.random.default_rng(seed + 900)
    base = by_clocks(seed, kind, n, 1, restricted=False)
    out = rng.permutation(n)[: len(ANGLES)]
    seen = np.ones((len(ANGLES), n), dtype=bool)
    seen[np.arange(len(ANGLES)), out] = False
    problems = {}
    for f in ANGLES:
        arms = []
        for arm in base.arms:
            moved = rng.normal(0.0, 0.4, arm.entry.shape)
            first = np.where(seen[f][:, None], arm.first, np.inf)
            arms.append(
                replace(arm, entry=arm.entry + moved, leaving=arm.leaving + moved, first=first)
            )
        problems[f] = replace(base, arms=tuple(arms), turn=(0.0, 0.0))
    way = np.abs(np.arange(len(ANGLES))[:, None] - np.arange(len(ANGLES))[None])
    return EpochProblem(problems, rng.uniform(0.2, 0.8) * way.astype(float), seed)


def epoch_times(problem, epoch, starts, here, *, last):
    """Yields every way to do one epoch: how long it takes, and where it leaves the arms."""
    whole, arms = problem.problems[epoch.angle], range(2)
    turn = problem.turn[here, epoch.angle]
    back = problem.turn[epoch.angle, 0]
    for who in product(arms, repeat=len(epoch.tasks)):
        own = [[t for t, a in zip(epoch.tasks, who, strict=True) if a == arm] for arm in arms]
        for rows in product(*(permutations(row) for row in own)):
            times, ends = [], []
            for arm, row, start in zip(whole.arms, rows, starts, strict=True):
                clock, joints = 0.0, start
                for k, t in enumerate(row):
                    transfer = float(arm.law.duration(arm.entry[t, 0] - joints))
                    clock += max(transfer, turn) if k == 0 else transfer
                    clock += float(arm.first[t, 0] + arm.second[t, 0])
                    joints = arm.leaving[t, 0]
                if last and whole.returns:
                    home = float(arm.law.duration(arm.start - joints))
                    clock += max(home, back) if row else home
                times.append(clock)
                ends.append(joints)
            if kept(whole, rows):
                yield max(times), ends


def kept(whole, rows):
    """Returns whether an order within an epoch keeps precedence; arms do not wait here."""
    return not any(
        a in row and b in row and row.index(a) > row.index(b)
        for row in rows
        for a, b in whole.before
    )


def least(problem, epochs, starts, here):
    """Returns the least time of epochs one after the other, by trying all."""
    if not epochs:
        return 0.0
    rest = epochs[1:]
    return min(
        (
            length + least(problem, rest, ends, epochs[0].angle)
            for length, ends in epoch_times(problem, epochs[0], starts, here, last=not rest)
            if np.isfinite(length)
        ),
        default=np.inf,
    )


def all_epochs(n, before=()):
    """Yields all ways to share n tasks out to two epochs at different angles."""
    for angles in permutations(ANGLES, 2):
        for place in product((0, 1), repeat=n):
            if len(set(place)) < 2 or any(place[a] > place[b] for a, b in before):
                continue
            yield tuple(
                Epoch(angle, tuple(t for t in range(n) if place[t] == e))
                for e, angle in enumerate(angles)
            )


def test_all_ways_of_sharing_tasks_out_are_no_better(by_clocks):
    """Two epochs: never less than the least of all, nearly always that itself."""
    shares = []
    for seed in range(14):
        problem = epoch_problem(by_clocks, seed)
        starts = [arm.start for arm in problem.sample.arms]
        brute = min(least(problem, epochs, starts, 0) for epochs in all_epochs(4))
        found = EpochSearch(problem, EFFORT).best(4)
        if not np.isfinite(brute):
            continue
        two = [one for one in found if len(one.epochs) == 2]
        assert all(one.total >= brute - 1e-9 for one in two)
        assert found[0].total <= 1.04 * brute
        shares.append(found[0].total <= brute + 1e-9)
    assert len(shares) >= 8
    assert np.mean(shares) >= 0.6


def test_a_total_is_the_sum_of_what_its_epochs_take(by_clocks):
    """The order that is told, timed by hand: transfers, turns, work, and the way home."""
    for seed in range(8):
        problem = epoch_problem(by_clocks, seed)
        for one in EpochSearch(problem, EFFORT).best(3):
            clock, here = 0.0, 0
            joints = [arm.start for arm in problem.sample.arms]
            for k, (epoch, rows) in enumerate(zip(one.epochs, one.rows, strict=True)):
                whole = problem.problems[epoch.angle]
                spent = []
                for a, (arm, row) in enumerate(zip(whole.arms, rows, strict=True)):
                    own = 0.0
                    for m, t in enumerate(row):
                        way = float(arm.law.duration(arm.entry[t, 0] - joints[a]))
                        own += max(way, problem.turn[here, epoch.angle]) if m == 0 else way
                        own += float(arm.first[t, 0] + arm.second[t, 0])
                        joints[a] = arm.leaving[t, 0]
                    if k == len(one.epochs) - 1 and whole.returns:
                        home = float(arm.law.duration(arm.start - joints[a]))
                        own += max(home, problem.turn[epoch.angle, 0] if row else 0.0)
                    spent.append(own)
                clock += max(spent)
                here = epoch.angle
            assert one.total == pytest.approx(clock, abs=1e-9)
            assert sorted(t for rows in one.rows for row in rows for t in row) == list(range(4))


@pytest.mark.parametrize("kind", ["before", "sequences", "file", "before sequences"])
def test_rules_hold_across_epochs(by_clocks, kind):
    """Precedence, sequences in one epoch by one arm right after one another, the file's order on each arm."""
    seen = 0
    for seed in range(10):
        problem = epoch_problem(by_clocks, seed, kind, 5)
        sample = problem.sample
        for one in EpochSearch(problem, EFFORT).best(2):
            seen += 1
            place = {t: e for e, epoch in enumerate(one.epochs) for t in epoch.tasks}
            assert all(place[a] <= place[b] for a, b in sample.before)
            flat = [[t for rows in one.rows for t in rows[a]] for a in range(2)]
            for row in sample.sequences:
                (own,) = [rank for rank in flat if row[0] in rank]
                first = own.index(row[0])
                assert tuple(own[first : first + len(row)]) == row
                assert len({place[t] for t in row}) == 1
            if sample.in_file_order:
                assert all(rank == sorted(rank) for rank in flat)
    assert seen >= 5


def test_what_an_epoch_leaves_in_a_buffer_is_there_in_the_next(by_clocks):
    """Tasks 0 and 2 put a part in at their ends, 1 and 3 take one out first; room for two, and for one."""
    made = by_clocks(3, "", 4, 1, restricted=False)
    first = np.concatenate([[0], np.cumsum(made.stops)])
    change = np.zeros((first[-1] + 1, 1), dtype=np.int64)
    for t in range(4):
        change[first[t + 1] - 1 if t % 2 == 0 else first[t]] = 1 if t % 2 == 0 else -1
    lasts = np.tile([0.1, 0.05], (first[-1], 1))

    def total(room, *epochs):
        stores = Stores(change, np.array([room]), np.array([0]))
        base = replace(made, stores=stores, lasts=lasts, turn=(0.0, 0.0))
        problem = EpochProblem({0: base, 1: base}, np.array([[0.0, 0.5], [0.5, 0.0]]), 0)
        rows = tuple(Epoch(angle, tasks) for angle, tasks in epochs)
        return problem.evaluated(rows, 10).total

    assert np.isfinite(total(2, (0, (0, 2)), (1, (1, 3))))
    assert np.isinf(total(1, (0, (0, 2)), (1, (1, 3))))
    assert np.isinf(total(2, (0, (1, 3)), (1, (0, 2))))
    assert np.isinf(total(2, (0, (0, 1, 3)), (1, (2,))))
    assert np.isfinite(total(1, (0, (0, 1)), (1, (2, 3))))
    # Within an epoch as well as between: both puts, with one take by then, have room for one part.
    assert np.isfinite(total(1, (0, (0, 1, 2)), (1, (3,))))
    base = replace(made, stores=Stores(change, np.array([2]), np.array([0])), lasts=lasts)
    problem = EpochProblem({0: base}, np.zeros((1, 1)), 0)
    starts = [arm.start for arm in base.arms]
    epochs = [Epoch(0, tasks) for tasks in ((0,), (1, 2), (3,))]
    own = problem.restricted(epochs, 1, starts, 0.0)
    assert own.stores.initial.tolist() == [1]
    assert len(own.lasts) == made.stops[1] + made.stops[2]
    rows = [*range(first[1], first[3])]
    assert own.stores.change[:-1].tolist() == change[rows].tolist()


def test_where_the_platform_comes_from_counts_though_the_arms_stand_alike(by_clocks):
    """Joint targets are the same from every angle: what was found after one turn is no answer after a longer one."""
    same = by_clocks(3, "", 2, 1, restricted=False)
    open_to_all = tuple(replace(arm, first=np.full_like(arm.first, 0.5)) for arm in same.arms)
    alike = dict.fromkeys(ANGLES, replace(same, arms=open_to_all))
    turn = np.array([[0.0, 40.0, 1.0], [40.0, 0.0, 20.0], [1.0, 20.0, 0.0]])
    near, far = ((Epoch(f, (0,)), Epoch(2, (1,))) for f in (0, 1))
    both = EpochProblem(alike, turn, 0)
    for epochs in (near, far):
        alone = EpochProblem(alike, turn, 0).evaluated(epochs, 5).total
        assert both.evaluated(epochs, 5).total == alone
