"""Buffers and asynchronous arms, against a simulation that knows levels at all instants."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from dualarm_cli.orders.asynchronous.exact import exact_order, is_small
from dualarm_cli.orders.asynchronous.recreate import Recreator
from dualarm_cli.orders.asynchronous.times import StoredOrder, best_options, timed
from dualarm_cli.orders.paired.exact import best_of_all
from dualarm_cli.orders.proof.cp_sat import prove
from dualarm_cli.orders.proof.relaxation import relax_options, relax_stages
from dualarm_cli.orders.rules.stores import Stores

KINDS = ("", "before", "windows", "sequences", "file")


def legs(problem, order):
    """Returns each arm's stops as dicts: way and work, without any wait."""
    first = np.concatenate([[0], np.cumsum(problem.stops)])
    found = []
    for a, nodes in enumerate(order.nodes):
        own, last = [], problem.start_node
        for node in nodes:
            t, way = divmod(node, problem.options)
            for s in range(problem.stops[t]):
                work = problem.arms[a].second[t, way] if s else problem.arms[a].first[t, way]
                go = 0.0 if s else problem.between[a][last, node]
                own.append({"task": t, "s": s, "stop": int(first[t] + s), "go": go, "work": work})
            last = node
        found.append((own, last))
    return found


def interleaved(problem, order):
    """Returns the least total of all sequences of events, each played by itself; infinite for none.

    One sequence says which arm's event comes next. Each event is at the earliest instant at which all levels hold,
    looked for among all instants at which anything is over.
    """
    rows = legs(problem, order)
    n = len(rows[0][0]) + (len(rows[1][0]) if len(rows) > 1 else 0)
    best = np.inf
    for chosen in combinations(range(n), len(rows[0][0])):
        sequence = [0 if k in chosen else 1 for k in range(n)]
        best = min(best, played(problem, rows, sequence))
    return best


def levels_hold(problem, done, time):
    """Says whether there are parts and room at an instant, with all that is done: (stop, event, over)."""
    stores = problem.stores
    for k, capacity in enumerate(stores.capacity.tolist()):
        there = room = int(stores.initial[k])
        for stop, event, over in done:
            change = int(stores.change[stop, k])
            if change > 0:
                there += over <= time
                room += event <= time
            elif change < 0:
                there -= event <= time
                room -= over <= time
        if there < 0 or room > capacity:
            return False
    return True


def played(problem, rows, sequence):
    """Returns when all is done where events come in a sequence; infinite where that cannot be or is late."""
    clock, place = [0.0] * len(rows), [0] * len(rows)
    done, over, last_event = [], {}, 0.0
    for a in sequence:
        leg = rows[a][0][place[a]]
        end = clock[a] + leg["go"] + leg["work"]
        if leg["s"] == 0:
            begin = clock[a] + leg["go"]
            if len(problem.not_before):
                begin = max(begin, problem.not_before[leg["task"]])
            for one, other in problem.before:
                if other == leg["task"]:
                    if one not in over:
                        return np.inf
                    begin = max(begin, over[one])
            end = begin + leg["work"]
        lead, tail = problem.lasts[leg["stop"]]
        soonest = max(end - lead, last_event)
        tries = sorted({soonest, *(o for _, _, o in done if o > soonest)})
        for event in tries:
            if levels_hold(problem, [*done, (leg["stop"], event, event + lead - tail)], event):
                break
        else:
            return np.inf
        last_event = event
        done.append((leg["stop"], event, event + lead - tail))
        clock[a] = event + lead
        place[a] += 1
        if leg["s"] == problem.stops[leg["task"]] - 1:
            over[leg["task"]] = clock[a]
            if len(problem.not_after) and clock[a] > problem.not_after[leg["task"]] + 1e-9:
                return np.inf
    home = problem.start_node
    return max(clock[a] + problem.between[a][rows[a][1], home] for a in range(len(rows)))


@pytest.mark.parametrize("kind", KINDS)
def test_few_tasks_the_best_of_all_orders_and_sequences_of_events(
    by_clocks, with_stores, every_row, kept, kind
):
    """Eight instances a kind, of three tasks in one or two ways, or four in one; one with one arm."""
    there = 0
    for k in range(8):
        n = 3 + k % 2
        made = by_clocks(300 + k, kind, n, 2 - k % 2, 1 if k == 6 else 2)
        problem = with_stores(made, 60 + k)
        assert is_small(problem)
        least = np.inf
        for rows in every_row(n, len(problem.arms)):
            if kept(problem, rows):
                order = best_options(problem, rows)
                if np.isfinite(timed(replace(problem, stores=None), order).total):
                    least = min(least, interleaved(problem, order))
        found = exact_order(problem)
        assert (found is not None) == np.isfinite(least), k
        if found is not None:
            there += 1
            assert found.total == pytest.approx(least, abs=1e-9), k
            assert kept(problem, found.order.tasks(problem.options))
    assert there >= 3


def test_first_served_is_best_where_each_buffer_has_one_giver(by_clocks):
    """The first arm puts what the second one takes: against all sequences of events."""
    for seed in range(6):
        made = by_clocks(seed, "", 6, 1, restricted=False)
        sizes = made.stops
        first = np.concatenate([[0], np.cumsum(sizes)])
        change = np.zeros((first[-1] + 1, 1), dtype=np.int64)
        for t in range(6):
            # Last stops of the first three tasks put, first stops of the others take.
            change[first[t + 1] - 1 if t < 3 else first[t]] = 1 if t < 3 else -1
        lasts = np.tile([0.15, 0.05], (first[-1], 1))
        stores = Stores(change, np.array([1 + seed % 2]), np.array([0]))
        problem = replace(made, stores=stores, lasts=lasts)
        order = best_options(problem, ((0, 1, 2), (3, 4, 5)))
        found = timed(problem, order)
        assert found.total == pytest.approx(interleaved(problem, order), abs=1e-9)
        assert found.total >= timed(replace(problem, stores=None), order).total - 1e-9


def test_where_both_arms_give_and_take_every_sequence_of_events_is_looked_at(by_clocks):
    """Random orders of six tasks of one stop, long dwells: who comes first must not always be served first."""
    differ = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        made = by_clocks(seed, "", 6, 1, restricted=False)
        arms = tuple(replace(arm, second=np.zeros((6, 1))) for arm in made.arms)
        change = np.append(rng.permutation([1, 1, 1, -1, -1, -1]), 0)[:, None]
        stores = Stores(change, np.array([1 + seed % 2]), np.array([seed % 3 % 2]))
        lasts = np.sort(rng.uniform(0.0, 0.9, (6, 2)), axis=1)[:, ::-1]
        problem = replace(made, stops=(1,) * 6, arms=arms, stores=stores, lasts=lasts)
        names = rng.permutation(6).tolist()
        order = best_options(problem, (names[:3], names[3:]))
        least, found = interleaved(problem, order), timed(problem, order)
        assert np.isfinite(found.total) == np.isfinite(least), seed
        if np.isfinite(least):
            assert found.total == pytest.approx(least, abs=1e-9), seed
        served = StoredOrder(problem, order)
        first = served._served()
        differ += np.isfinite(least) and (
            served.left(first) > 0 or served.done(first) > least + 1e-6
        )
    assert differ >= 3


def test_an_order_with_a_buffer_is_timed_as_by_hand(by_clocks):
    """The first arm puts two parts into room for one, the second one takes them."""
    made = replace(by_clocks(0, "", 4, 1, restricted=False), stops=(1, 1, 1, 1), turn=(0.0, 0.0))
    arms = tuple(replace(arm, second=np.zeros((4, 1))) for arm in made.arms)
    stores = Stores(np.array([[1], [1], [-1], [-1], [0]]), np.array([1]), np.array([0]))
    lasts = np.tile([0.2, 0.05], (4, 1))
    problem = replace(made, arms=arms, returns=False, stores=stores, lasts=lasts)
    found = timed(problem, best_options(problem, ((0, 1), (2, 3))))
    work = [problem.length[a][t] for a, t in ((0, 0), (0, 1), (1, 2), (1, 3))]
    way = problem.between
    put = way[0][4, 0] + work[0]
    take = max(way[1][4, 2] + work[2], (put - 0.05) + 0.2)
    put_again = max(put + way[0][0, 1] + work[1], (take - 0.05) + 0.2)
    take_again = max(take + way[1][2, 3] + work[3], (put_again - 0.05) + 0.2)
    assert found.ends == (
        (pytest.approx(put), pytest.approx(put_again)),
        (pytest.approx(take), pytest.approx(take_again)),
    )
    assert found.begins[1] == (
        pytest.approx(take - work[2]),
        pytest.approx(take_again - work[3]),
    )
    assert found.total == pytest.approx(max(put_again, take_again))
    # One arm that puts two before it takes any: its second put is never made, nor what comes after.
    stuck = timed(problem, best_options(problem, ((0, 1, 2, 3), ())))
    assert np.isinf(stuck.total)
    assert stuck.left == 3
    assert not stuck.is_possible
    assert np.isfinite(stuck.objective)


def test_many_tasks_have_an_order_in_which_no_arm_waits_forever(by_clocks):
    """Sixteen tasks of either arm into room for two and out of it again: searched, played, levels counted anew."""
    for seed in range(3):
        made = by_clocks(seed, "", 16, 2, restricted=False)
        first = np.concatenate([[0], np.cumsum(made.stops)])
        change = np.zeros((first[-1] + 1, 1), dtype=np.int64)
        for t in range(16):
            change[first[t + 1] - 1 if t < 8 else first[t]] = 1 if t < 8 else -1
        lasts = np.tile([0.15, 0.05], (first[-1], 1))
        problem = replace(made, stores=Stores(change, np.array([2]), np.array([0])), lasts=lasts)
        search = Recreator(problem, seed)
        start = search.first()
        assert start.left == 0
        found = search.improve(start, 60)
        assert found.is_possible
        assert found.total <= start.total + 1e-9
        stored = StoredOrder(problem, found.order)
        last, done, seen = stored.played(), [], []
        while last.before is not None:
            a = next(a for a, k in enumerate(last.at) if k != last.before.at[a])
            stop = legs(problem, found.order)[a][0][last.at[a] - 1]["stop"]
            # What is over at the very instant of an event may be so by rounding.
            done.append((stop, last.event, last.event + 0.1 - 1e-9))
            last = last.before
        for stop, event, over in done:
            seen.append(stop)
            assert levels_hold(problem, done, event)
            assert levels_hold(problem, done, over)
        assert sorted(seen) == list(range(first[-1]))


@pytest.mark.parametrize("kind", ["", "before", "file"])
def test_the_bound_holds_with_buffers_and_what_is_impossible_is_proven(
    by_clocks, in_stages, with_stores, kind
):
    """Both ways to ask, of three and four tasks: no order is below the bound; where there is none it is known."""
    none = 0
    for k in range(10):
        n = 3 + k % 2
        problem = with_stores(
            by_clocks(300 + k, kind, n, 2 - k % 2, 1 if k % 3 == 2 else 2), 60 + k
        )
        stages = with_stores(in_stages(400 + k, kind, n, 1 if k % 3 == 2 else 2), 900 + k)
        for best, relaxed in (
            (exact_order(problem), relax_options(problem)),
            (best_of_all(stages), relax_stages(stages)),
        ):
            proven = prove(relaxed, None, 4.0, 0)
            if best is None:
                none += 1
            else:
                assert not proven.impossible, k
                assert proven.bound <= best.total + 1e-9
            # Without windows and with every task in some arm's reach only rules make it impossible.
            assert proven.impossible == (best is None), k
    assert none >= (1 if kind else 0)
