"""Bounds on orders of stages, and the best orders: against all orders, found state by state."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dualarm_cli.effort import CloseOrders, ProofEffort
from dualarm_cli.orders.paired.problem import IDLE, StageOrder, StageProblem
from dualarm_cli.orders.paired.search import StageSearch
from dualarm_cli.orders.paired.times import totals, with_angles
from dualarm_cli.orders.proof import labels
from dualarm_cli.orders.proof.graph import (
    ENDS,
    DenseEdges,
    StageGraph,
    count_nodes,
    edges_from_rows,
    sparse_edges,
)
from dualarm_cli.orders.proof.labels import MOST_STOPS, Continuations, LabelSearch, StageSteps
from dualarm_cli.orders.proof.near_optimal import near_optimal_orders
from dualarm_cli.orders.proof.prices import Paths, Prices, best_prices, good_prices, needed
from dualarm_cli.orders.proof.proof import can_prove, keeps_rules, prove_order
from dualarm_cli.orders.proof.relaxation import pair_bound

SEEDS = st.integers(0, 10_000)
KINDS = [
    "",
    "apart",
    "before",
    "windows",
    "sequences",
    "before apart windows",
    "file",
    "file before",
]
CLOSE = 2e-4
"""What single precision may add up to [s]."""
THOROUGH = ProofEffort(80, 100_000)


def least_of_all(problem, *, idle=True, more=None):
    """Returns the least total of all orders: by what is made, each arm's last stop and the angle, stage by stage.

    The rules are read as StageProblem says; late orders do not count.

    Args:
        problem: two arms, few stops, no stores and no hand-overs.
        idle: whether an arm may be idle in a stage.
        more: what a move takes longer [s], from and to stops of both arms and an angle, None for the ends.
    """
    s, f = problem.stops, len(problem.turn)
    more = more or (lambda *_: 0.0)
    task = {stop: t for t, own in enumerate(problem.tasks) for stop in own}
    rows = [*problem.sequences, *((t,) for t in range(len(problem.tasks)))]
    chains = [[stop for t in row for stop in problem.tasks[t]] for row in rows]
    after = {one: other for chain in chains for one, other in pairwise(chain)}
    before = {other: one for one, other in after.items()}
    first_needs = {}
    for one, other in problem.before:
        first_needs.setdefault(problem.tasks[other][0], []).append(problem.tasks[one][-1])
    own = [[IDLE, *np.flatnonzero(np.isfinite(work).any(axis=1)).tolist()] for work in problem.work]
    stages = [(i, j) for i in own[0] for j in own[1] if i != j and (idle or IDLE not in (i, j))]
    starts = range(f) if problem.free_start else [0]
    states = {(frozenset(), s, s, g, None): 0.0 for g in starts}
    best = np.inf
    while states:
        grown = {}
        for (made, c0, c1, f0, last), over in states.items():
            if len(made) == s:
                best = min(best, over + _back(problem, (c0, c1), f0) + more(last, None))
                continue
            for stage in stages:
                doing = [stop for stop in stage if stop != IDLE]
                if any(stop in made for stop in doing):
                    continue
                if len({task[stop] for stop in doing}) < len(doing):
                    continue
                if any(need not in made for stop in doing for need in first_needs.get(stop, [])):
                    continue
                if not all(
                    _follows(after, before, came, stop)
                    and (
                        not problem.in_file_order
                        or IDLE in (came, stop)
                        or task.get(came, 0) <= task[stop]
                    )
                    for came, stop in zip((c0, c1), stage, strict=True)
                ):
                    continue
                for g in range(f):
                    end = _over(problem, stage, (c0, c1), f0, g, over)
                    node = (*stage, g)
                    end += more(last, node)
                    if not np.isfinite(end):
                        continue
                    came = [x if x != IDLE else c for x, c in zip(stage, (c0, c1), strict=True)]
                    key = (made | set(doing), *came, g, node)
                    if end < grown.get(key, np.inf):
                        grown[key] = end
        states = grown
    return best


def _follows(after, before, came, stop):
    """Returns whether an arm may make a stop, or nothing, after its last one."""
    if stop == IDLE:
        return True
    if came in after and stop != after[came]:
        return False
    return stop not in before or came == before[stop]


def _over(problem, stage, came, f0, g, over):
    """Returns when a stage is over, infinite where it cannot be or is late."""
    parts = [problem.length[a][came[a], stage[a], f0, g] for a in (0, 1) if stage[a] != IDLE]
    end = over + max(parts)
    if problem.pair_cost is not None and IDLE not in stage:
        end += problem.pair_cost[(*stage, g)]
    for a, stop in enumerate(stage):
        if stop != IDLE and problem.not_before is not None and problem.not_before[stop] > 0.0:
            end = max(end, problem.not_before[stop] + problem.work[a][stop, g])
    late = problem.not_after is not None and any(
        stop != IDLE and end > problem.not_after[stop] for stop in stage
    )
    return np.inf if late else end


def _back(problem, came, f0):
    if not problem.returns:
        return 0.0
    ways = [problem.length[a][c, problem.stops, f0, 0] for a, c in enumerate(came)]
    there = [w for w, c in zip(ways, came, strict=True) if c != problem.stops]
    return max([0.0 if problem.free_start else problem.turn[f0, 0], *there])


def length_of(graph, nodes):
    """Returns how long a path without idle arms takes, from the problem's own tables."""
    problem, came, over = graph.problem, (graph.problem.stops,) * 2, 0.0
    angles = graph.angle[nodes].tolist()
    at = angles[0] if problem.free_start else 0
    starts = range(len(problem.turn)) if problem.free_start else [0]
    first = tuple(graph.stops[nodes[0]].tolist())
    over = min(_over(problem, first, came, f0, angles[0], 0.0) for f0 in starts)
    came, at = first, angles[0]
    for node, g in zip(nodes[1:], angles[1:], strict=True):
        stage = tuple(graph.stops[node].tolist())
        over = _over(problem, stage, came, at, g, over)
        came, at = stage, g
    return over + _back(problem, came, at)


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=12, deadline=None)
@given(seed=SEEDS, one_stop=st.booleans())
def test_no_order_takes_less_than_any_bound_and_the_best_known_is_never_lost(
    in_stages, kind, seed, one_stop
):
    problem = in_stages(seed, kind, 4 if one_stop else 3, one_stop=one_stop)
    start = StageSearch(problem, seed).first()
    if start is None or not np.isfinite(start.total):
        return
    least = least_of_all(problem)
    assert pair_bound(problem) <= least + CLOSE
    # At each angle what either arm can make, alone or with the other one's.
    can = [np.isfinite(work).sum(axis=0) for work in problem.work]
    assert count_nodes(problem) == ((can[0] + 1) * (can[1] + 1) - 1).sum()
    assert can_prove(problem, count_nodes(problem))
    assert not can_prove(problem, count_nodes(problem) - 1)
    for effort in (ProofEffort(1, 2), ProofEffort(30, 20), THOROUGH):
        proof = prove_order(problem, start, effort)
        assert proof.bound <= least + CLOSE
        assert proof.order.total <= start.total
        if np.isfinite(least):
            assert proof.order.total >= least - CLOSE
            if effort is THOROUGH:
                # Idle arms, windows and rules among it.
                assert proof.order.total == pytest.approx(least, abs=CLOSE)
                assert proof.bound == pytest.approx(least, abs=2 * CLOSE)
        assert proof.order.total == pytest.approx(totals(problem, proof.order.slots[None])[0])
        assert keeps_rules(problem, proof.order.slots)


@pytest.mark.parametrize("kind", ["", "apart", "windows", "before"])
@settings(max_examples=12, deadline=None)
@given(seed=SEEDS)
def test_enough_labels_find_the_best_order_without_idle_arms_and_prove_it(in_stages, kind, seed):
    problem = in_stages(seed, kind, 4, one_stop=True)
    least = least_of_all(problem, idle=False)
    graph = StageGraph.of(problem, singles=False)
    upper = 40.0
    prices = best_prices(graph, upper, 40)
    found = LabelSearch(graph, prices, upper, 10_000).run()
    if not np.isfinite(least):
        assert not found.orders
        assert found.bound == upper
        return
    assert found.bound == pytest.approx(least, abs=CLOSE)
    assert length_of(graph, found.orders[0]) == pytest.approx(least, abs=CLOSE)
    assert set(found.orders[0].tolist()) <= set(needed(graph, prices, least + 0.01).tolist())


@settings(max_examples=20, deadline=None)
@given(seed=SEEDS, most=st.integers(1, 30))
def test_what_labels_drop_counts_in_their_bound(in_stages, seed, most):
    problem = in_stages(seed, "apart", 6, one_stop=True)
    graph = StageGraph.of(problem, singles=False)
    prices = best_prices(graph, 20.0, 25)
    whole = LabelSearch(graph, prices, 40.0, 100_000).run()
    few = LabelSearch(graph, prices, 40.0, most).run(3)
    assert few.bound <= whole.bound + CLOSE
    assert prices.bound <= whole.bound + CLOSE
    lengths = [length_of(graph, nodes) for nodes in few.orders]
    assert all(length >= whole.bound - CLOSE for length in lengths)


@pytest.mark.parametrize("kind", ["", "apart", "before", "sequences", "file before"])
def test_ways_are_what_rules_allow_and_last_as_long_as_tables_say(in_stages, kind):
    """Every pair of nodes, word by word; an arm that was idle comes from wherever is best."""
    allowed = 0
    for seed in range(4):
        problem = in_stages(seed, kind, 4)
        graph = StageGraph.of(problem, singles=True)
        task = {stop: t for t, own in enumerate(problem.tasks) for stop in own}
        rows = [*problem.sequences, *((t,) for t in range(len(problem.tasks)))]
        chains = [[stop for t in row for stop in problem.tasks[t]] for row in rows]
        after = {one: other for chain in chains for one, other in pairwise(chain)}
        before = {other: one for one, other in after.items()}
        table = graph.edges.rows(np.arange(graph.nodes))
        stops, angle = graph.stops.tolist(), graph.angle.tolist()
        for u in range(graph.nodes):
            for v in range(graph.nodes):
                made, goes = ([x for x in stops[k] if x != IDLE] for k in (u, v))
                wrong = bool(set(made) & set(goes)) or any(
                    (task[y], task[x]) in problem.before for x in made for y in goes
                )
                whole = 0.0
                for a, (came, then) in enumerate(zip(stops[u], stops[v], strict=True)):
                    if then == IDLE:
                        continue
                    if came != IDLE:
                        wrong |= not _follows(after, before, came, then)
                        wrong |= problem.in_file_order and task[came] > task[then]
                    own = problem.length[a][:, then, angle[u], angle[v]]
                    others = np.delete(np.arange(problem.stops + 1), then)
                    whole = max(whole, own[came] if came != IDLE else own[others].min())
                if problem.pair_cost is not None:
                    whole += problem.pair_cost[(*stops[v], angle[v])]
                assert table[u, v] == pytest.approx(np.inf if wrong else whole, abs=1e-5)
                allowed += bool(np.isfinite(table[u, v]))
    assert allowed > 1000


@pytest.mark.parametrize("seed", range(6))
def test_windows_that_open_within_the_first_second_count(in_stages, seed):
    """Everything ten times as quick: what waits less than a second waits all the same."""
    problem = in_stages(seed, "windows", 3, one_stop=True)
    opens = np.where(np.arange(problem.stops) % 2 == seed % 2, 0.9, problem.not_before)
    quick = replace(
        problem,
        length=tuple(x * 0.1 for x in problem.length),
        work=tuple(x * 0.1 for x in problem.work),
        turn=problem.turn * 0.1,
        not_before=opens,
        not_after=np.full(problem.stops, np.inf),
    )
    start, least = StageSearch(quick, seed).first(), least_of_all(quick)
    assert start is not None
    proof = prove_order(quick, start, THOROUGH)
    assert proof.order.total == pytest.approx(least, abs=CLOSE)
    assert proof.bound == pytest.approx(least, abs=2 * CLOSE)


def test_the_bound_by_pairs_is_the_best_partners_by_hand():
    """One angle, no rules. Arm 0 takes 1, 5 and 9 s for stops 0 to 2, arm 1 takes 4, 2 and 3 s.

    0 with 1 lasts max(1, 2) = 2 s, 0 with 2 lasts 3 s, 1 with 2 at least 5 s; alone they take 1, 2 and 3 s. Each stop
    is counted with half of its stage: 0 with 1 and 2 alone are 5 s, 0 with 2 and 1 alone too; round in a circle
    (0 with 1, 1 with 2, 2 with 0) (2 + 5 + 3) / 2 s.
    """
    works = (np.array([[1.0], [5.0], [9.0]]), np.array([[4.0], [2.0], [3.0]]))
    lengths = []
    for work in works:
        length = np.zeros((4, 5, 1, 1))
        length[:, :3] = work[None, :, :, None]
        length[:, 3] = 0.7
        length[:, 4] = -np.inf
        lengths.append(length)
    problem = StageProblem(tuple(lengths), works, np.zeros((1, 1)), ((0,), (1,), (2,)), False)
    assert pair_bound(problem) == pytest.approx(5.0)
    assert pair_bound(replace(problem, returns=True)) == pytest.approx(5.7)
    two = replace(
        problem,
        length=tuple(x[np.ix_([0, 1, 3], [0, 1, 3, 4])] for x in lengths),
        work=tuple(work[:2] for work in works),
        tasks=((0,), (1,)),
    )
    assert pair_bound(two) == pytest.approx(2.0)
    assert pair_bound(replace(two, length=two.length[::-1], work=works[::-1])) == pytest.approx(2.0)
    alone = replace(two, length=two.length[:1], work=works[:1])
    assert pair_bound(alone) == pytest.approx(6.0)
    # What takes next to nothing makes no partner of what has none.
    short = np.array([1e-3, 1.0])[:, None]
    little = replace(
        alone,
        length=(alone.length[0] * np.append(short[:, 0], [1.0, 1.0])[None, :, None, None],),
        work=(alone.work[0][:2] * short,),
    )
    assert pair_bound(little) == pytest.approx(5.001)


def test_a_few_labels_prove_less_than_many(in_stages):
    """Bounds get better with labels, or the search that drops some would prove nothing."""
    gained = 0
    for seed in range(8):
        problem = in_stages(seed, "apart", 8, one_stop=True)
        graph = StageGraph.of(problem, singles=False)
        prices = best_prices(graph, 20.0, 25)
        bounds = [LabelSearch(graph, prices, 40.0, most).run().bound for most in (3, 30, 100_000)]
        assert bounds == sorted(bounds)
        gained += bounds[0] < bounds[2] - 0.01
    assert gained >= 4


@settings(max_examples=15, deadline=None)
@given(seed=SEEDS)
def test_prices_are_of_paths_that_have_as_many_stops_as_there_are(in_stages, seed):
    """At any prices: the least path of all sequences of nodes, one after the other."""
    problem = in_stages(seed, "apart", 3, one_stop=True, f=2)
    graph = StageGraph.of(problem, singles=True)
    rng = np.random.default_rng(seed)
    price = rng.uniform(0.0, 1.0, problem.stops)
    paths = Paths(graph)
    to, on = paths.forward(price), paths.backward(price)
    paid = np.append(price, 0.0)[graph.stops].sum(axis=1)
    every = [[u] for u in range(graph.nodes)]
    best, through = np.inf, np.full(graph.nodes, np.inf)
    table = graph.edges.rows(np.arange(graph.nodes))
    while every:
        grown = []
        for nodes in every:
            count = graph.weight[nodes].sum()
            if count == problem.stops:
                whole = graph.first[nodes[0]] + graph.last[nodes[-1]] - paid[nodes].sum()
                whole += sum(table[u, v] for u, v in pairwise(nodes))
                best = min(best, whole)
                through[nodes] = np.minimum(through[nodes], whole)
            elif count < problem.stops:
                grown += [[*nodes, v] for v in np.flatnonzero(np.isfinite(table[nodes[-1]]))]
        every = grown
    least = float((to[-1] + graph.last).min())
    assert least == pytest.approx(best, abs=CLOSE)
    if np.isfinite(best):
        assert graph.length(paths.path(to)) - paid[paths.path(to)].sum() == pytest.approx(
            best, abs=CLOSE
        )
    both = (to + on[::-1]).min(axis=0)
    np.testing.assert_allclose(both, through, atol=CLOSE)
    # A node is needed where its least path, at its prices, may be shorter than what is known.
    whole = through + price.sum()
    for upper in (
        0.0,
        *(np.quantile(whole[np.isfinite(whole)], (0.2, 0.8)) if np.isfinite(best) else ()),
    ):
        found = np.isin(np.arange(graph.nodes), needed(graph, Prices(price, 0.0), upper))
        clear = np.abs(whole - 1e-4 - upper) > CLOSE
        assert (found == (whole - 1e-4 < upper))[clear].all()


def test_steps_of_prices_prove_ever_more(in_stages):
    """Never less than fewer steps; sixty of them on average 7 % of the best order more than the first."""
    gained = []
    for seed in range(8):
        graph = StageGraph.of(in_stages(seed, "", 6, one_stop=True), singles=True)
        least = LabelSearch(graph, best_prices(graph, 20.0, 25), 40.0, 100_000).run().bound
        bounds = [best_prices(graph, 1.02 * least, steps).bound for steps in (1, 5, 20, 60)]
        assert bounds == sorted(bounds)
        assert good_prices(graph, 1.02 * least, 60).bound == bounds[-1]
        gained.append((bounds[-1] - bounds[0]) / least)
    assert np.mean(gained) > 0.07


def test_prices_of_many_nodes_by_way_of_some_prove_nearly_as_much(in_stages, monkeypatch):
    import dualarm_cli.orders.proof.prices as module

    for seed in range(4):
        problem = in_stages(seed, "", 8, one_stop=True)
        graph = StageGraph.of(problem, singles=False)
        whole = LabelSearch(graph, best_prices(graph, 15.0, 40), 40.0, 100_000).run()
        direct = good_prices(graph, whole.bound, 60).bound
        few = replace(module.PRICES, few_nodes=graph.nodes // 3)
        monkeypatch.setattr(module, "PRICES", few)
        by_some = good_prices(graph, whole.bound, 60).bound
        monkeypatch.undo()
        assert by_some <= whole.bound + CLOSE
        assert by_some >= 0.9 * direct


@settings(max_examples=12, deadline=None)
@given(seed=SEEDS, costly=st.floats(0.1, 0.6))
def test_orders_that_are_best_after_a_close_look_come_first(in_stages, seed, costly):
    """What moves take longer is drawn; the best order then is known from all orders."""
    problem = in_stages(seed, "apart", 4, one_stop=True)
    plain = least_of_all(problem, idle=False)
    if not np.isfinite(plain):
        return
    extra = {}

    def of(*move):
        if move not in extra:
            rng = np.random.default_rng([seed, len(extra)])
            extra[move] = 0.2 * plain * costly * float(rng.random() < costly)
        return extra[move]

    least = least_of_all(problem, idle=False, more=of)
    graph = StageGraph.of(problem, singles=False)

    def look(own, moves):
        names = [(*own.stops[u].tolist(), int(own.angle[u])) for u in range(own.nodes)] + [None]
        assert len({tuple(m) for m in moves.tolist()}) == len(moves)
        return np.array([of(names[u], names[v]) for u, v in moves.tolist()])

    prices = best_prices(graph, 2.0 * plain, 40)
    slots = graph.stops[LabelSearch(graph, prices, 40.0, 10_000).run().orders[0]]
    best = StageOrder(slots, np.zeros(0, dtype=np.int64), plain)
    found = near_optimal_orders(
        graph, prices, best, look, sizes=CloseOrders(labels=10_000, orders=30, rounds=60)
    )
    assert found
    assert len({one.slots.tobytes() for one in found}) == len(found)
    one = found[0]
    node = {
        (*stops, angle): k
        for k, (stops, angle) in enumerate(
            zip(map(tuple, graph.stops.tolist()), graph.angle.tolist(), strict=True)
        )
    }
    nodes = np.array(
        [node[(*row, g)] for row, g in zip(one.slots.tolist(), one.angles.tolist(), strict=True)]
    )
    assert one.total == pytest.approx(length_of(graph, nodes), abs=CLOSE)
    names = [
        None,
        *((*row, g) for row, g in zip(one.slots.tolist(), one.angles.tolist(), strict=True)),
        None,
    ]
    rated = one.total + sum(of(u, v) for u, v in pairwise(names))
    assert rated == pytest.approx(least, abs=CLOSE)


def test_orders_in_the_files_order_and_with_other_arms_are_told_apart(in_stages):
    problem = replace(in_stages(3, "", 4, one_stop=True), in_file_order=True)
    assert keeps_rules(problem, np.array([[0, 1], [2, 3]]))
    assert not keeps_rules(problem, np.array([[2, 1], [0, 3]]))
    pair = replace(problem, in_file_order=False, sequences=((0, 2),))
    assert keeps_rules(pair, np.array([[0, 1], [IDLE, 3], [2, IDLE]]))
    assert not keeps_rules(pair, np.array([[0, 1], [3, 2]]))
    assert not keeps_rules(pair, np.array([[0, 1], [3, IDLE], [2, IDLE]]))


def test_ends_of_moves_are_no_nodes(in_stages):
    problem = in_stages(5, "", 4, one_stop=True)
    graph = StageGraph.of(problem, singles=False)
    nodes = LabelSearch(graph, best_prices(graph, 20.0, 20), 40.0, 1000).run().orders[0]
    moves = np.array([[ENDS, nodes[0]], [nodes[0], nodes[1]], [nodes[1], ENDS]])
    longer = graph.longer(moves, np.array([0.5, 0.25, 0.125]))
    assert longer.length(nodes) == pytest.approx(graph.length(nodes) + 0.875, abs=1e-5)
    others = np.setdiff1d(np.arange(graph.nodes), nodes)
    np.testing.assert_array_equal(longer.first[others], graph.first[others])
    np.testing.assert_array_equal(longer.last[others], graph.last[others])


def test_a_proof_that_is_stopped_says_nothing_wrong(in_stages):
    """Stopped after any number of questions: the bound holds, the order is whole, and it ends soon after."""
    problem = in_stages(7, "apart", 4, one_stop=True)
    least = least_of_all(problem)
    start = StageSearch(problem, 0).first()
    asked = []

    def stop_after(count):
        asked.clear()

        def stop():
            asked.append(1)
            return len(asked) > count

        return stop

    for count in (0, 1, 3, 10, 30, 45):
        proof = prove_order(problem, start, THOROUGH, stop_after(count))
        assert proof.bound <= least + CLOSE
        assert least - CLOSE <= proof.order.total <= start.total
        assert len(asked) <= count + 8


@pytest.mark.parametrize("kind", KINDS)
def test_steps_whose_last_stops_are_known_last_as_long_as_tables_say(in_stages, kind):
    """Every node after every pair of last stops at every angle, and every way back, from the problem's own tables."""
    told = 0
    for seed in range(6):
        problem = replace(in_stages(seed, kind, 3), not_before=None, not_after=None)
        graph, s = StageGraph.of(problem, singles=True), problem.stops
        steps = StageSteps(graph)
        task = {stop: t for t, own in enumerate(problem.tasks) for stop in own}
        rows = [*problem.sequences, *((t,) for t in range(len(problem.tasks)))]
        chains = [[stop for t in row for stop in problem.tasks[t]] for row in rows]
        after = {one: other for chain in chains for one, other in pairwise(chain)}
        before = {other: one for one, other in after.items()}
        rng = np.random.default_rng(seed)
        node = rng.integers(0, graph.nodes, 300)
        came = rng.integers(0, s + 1, (300, 2))
        angle = rng.integers(0, len(problem.turn), 300)
        lengths = steps.lengths(came, angle, node)
        idle = steps.idle(came, node)
        then = steps.last_stops(node, idle)
        back = steps.return_time(node, idle)
        for k in range(300):
            stage, g = tuple(graph.stops[node[k]].tolist()), int(graph.angle[node[k]])
            last = tuple(came[k].tolist())
            expected = _over(problem, stage, last, int(angle[k]), g, 0.0)
            for c, stop in zip(last, stage, strict=True):
                at = IDLE if c == s else c
                if not _follows(after, before, at, stop):
                    expected = np.inf
                if problem.in_file_order and IDLE not in (at, stop) and task[at] > task[stop]:
                    expected = np.inf
            assert lengths[k] == pytest.approx(expected, abs=1e-6)
            now = tuple(c if x == IDLE else x for c, x in zip(last, stage, strict=True))
            assert tuple(then[k].tolist()) == now
            assert back[k] == pytest.approx(_back(problem, now, g), abs=1e-6)
            told += bool(np.isfinite(lengths[k]))
    assert told > 200


@pytest.mark.parametrize("most", [0, 7, 60, 10_000])
def test_continuations_are_counted_as_one_by_one(most):
    """Of each label what adds less than its room; where that is too much, all have less room, as little as will do."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        more = rng.normal(size=(5, 30)) * rng.choice([0.1, 3.0])
        more[rng.random(more.shape) < 0.2] = np.inf
        row = rng.integers(0, 5, 12)
        room = rng.normal(size=12)
        limit = np.array([room[row == k].max(initial=-np.inf) for k in range(5)])
        found = Continuations.of(more, limit)
        for k in range(5):
            own = found.column[found.begin[k] : found.begin[k + 1]]
            assert sorted(own.tolist()) == np.flatnonzero(more[k] < limit[k]).tolist()
            assert (np.diff(more[k, own]) >= 0.0).all()
        counts, less = found.counts(room, row, most)
        wanted = [int((more[r] < own - less).sum()) for r, own in zip(row, room, strict=True)]
        assert counts.tolist() == wanted
        whole = sum(int((more[r] < own).sum()) for r, own in zip(row, room, strict=True))
        assert counts.sum() <= most
        assert (less == 0.0) == (whole <= most)
        if less > 0.0:
            # Two thousandths more room would be too much: the halving is that close.
            wider = less - 2e-3
            assert (
                sum(int((more[r] < x - wider).sum()) for r, x in zip(row, room, strict=True))
                >= most
            )


def test_there_is_room_for_a_proof_of_sixty_two_stops_of_two_arms(in_stages):
    """Stops are the bits of an integer; no more nodes than told; no proof of nothing."""
    problem = in_stages(0, "", MOST_STOPS, f=1, one_stop=True)
    assert MOST_STOPS == 62
    nodes = count_nodes(problem)
    assert can_prove(problem, nodes)
    assert not can_prove(problem, nodes - 1)
    assert not can_prove(in_stages(0, "", MOST_STOPS + 1, f=1, one_stop=True), 10**9)
    assert not can_prove(in_stages(0, "", 4, arms=1), 10**9)


@pytest.mark.parametrize("kind", ["", "sequences", "file", "sequences file"])
def test_rules_that_an_order_keeps_are_those_of_its_rows(in_stages, kind):
    """Random orders: an arm's stops of a task, and tasks of a sequence, side by side; tasks in the file's order."""
    kept = {True: 0, False: 0}
    for seed in range(40):
        problem, rng = in_stages(seed, kind, 3), np.random.default_rng(seed)
        rows = [*problem.sequences, *((t,) for t in range(len(problem.tasks)))]
        chains = [[stop for t in row for stop in problem.tasks[t]] for row in rows]
        first = [own[0] for own in problem.tasks]
        for _ in range(30):
            who = rng.integers(0, 2, len(problem.tasks))
            rows = []
            for arm in (0, 1):
                tasks = [t for t in rng.permutation(len(problem.tasks)) if who[t] == arm]
                row = [stop for t in tasks for stop in problem.tasks[t]]
                rows.append(row if rng.random() < 0.7 else rng.permutation(row).tolist())
            slots = np.full((max(map(len, rows)) + 1, 2), IDLE)
            for arm, row in enumerate(rows):
                slots[np.sort(rng.choice(len(slots), len(row), replace=False)), arm] = row
            expected = True
            for row in rows:
                for one, other in (pair for chain in chains for pair in pairwise(chain)):
                    if one in row or other in row:
                        expected &= (one, other) in list(pairwise(row))
                begun = [stop for stop in row if stop in first]
                expected &= not problem.in_file_order or begun == sorted(begun)
            assert keeps_rules(problem, slots) == expected
            kept[expected] += 1
    assert min(kept.values()) > 30


@pytest.mark.parametrize("seed", range(6))
def test_few_ways_are_a_table_of_all_ways(seed):
    """Every question, of a table with and without holes, rows and columns of none: the answers are the table's."""
    rng = np.random.default_rng(seed)
    n, m = 7, 9
    table = rng.uniform(0.1, 2.0, (n, m)).astype(np.float32)
    table[rng.random((n, m)) < 0.6] = np.inf
    table[3], table[:, 5] = np.inf, np.inf
    goes, came = np.nonzero(np.isfinite(table))
    order = rng.permutation(len(goes))
    few = sparse_edges(goes[order], came[order], table[goes, came][order], n, m)
    values = rng.uniform(0.0, 3.0, m).astype(np.float32)
    some_came, some_goes = rng.permutation(m)[:5], rng.permutation(n)[:4]
    pairs = np.unique(np.column_stack([rng.integers(0, m, 30), rng.integers(0, n, 30)]), axis=0)
    more = rng.uniform(0.1, 1.0, len(pairs))
    longer = table.copy()
    longer[pairs[:, 1], pairs[:, 0]] += more
    for ways in (few, DenseEdges(table)):
        np.testing.assert_allclose(ways.least(values), (table + values).min(axis=1))
        np.testing.assert_array_equal(ways.rows(some_came), table[:, some_came].T)
        for node in range(n):
            np.testing.assert_array_equal(ways.into(node), table[node])
        found = ways.one_by_one(pairs[:, 0], pairs[:, 1])
        np.testing.assert_array_equal(found, table[pairs[:, 1], pairs[:, 0]])
        part = ways.part(some_came, some_goes)
        expected = table[np.ix_(some_goes, some_came)]
        np.testing.assert_array_equal(part.rows(np.arange(5)), expected.T)
        np.testing.assert_array_equal(ways.turned().rows(np.arange(n)), table)
        found = ways.longer(pairs[:, 0], pairs[:, 1], more).rows(np.arange(m))
        np.testing.assert_allclose(found, longer.T, rtol=1e-6)
    square = np.full((9, 9), np.inf, dtype=np.float32)
    square[:7] = table
    for whole in (square, np.where(np.isfinite(square), square, np.float32(4.0))):
        ways = edges_from_rows(iter([whole[:4], whole[4:6], whole[6:]]), 9)
        np.testing.assert_array_equal(ways.rows(np.arange(9)), whole.T)


def test_nodes_are_counted_before_they_are_made(in_stages):
    """As many as there are where nothing else forbids one: stops of one task are never beside each other."""
    for seed in range(6):
        problem = in_stages(seed, "", 5, one_stop=True)
        graph = StageGraph.of(problem, singles=True)
        can = [np.isfinite(work) for work in problem.work]
        alike = int((can[0] & can[1]).sum())
        assert count_nodes(problem) == graph.nodes + alike


@pytest.mark.parametrize("most", [1, 3, 10])
def test_continuations_that_are_left_out_count_in_the_bound(in_stages, monkeypatch, most):
    """One for each label that is kept: the best order is easily missed, and the bound says so."""
    monkeypatch.setattr(labels, "LABELS", replace(labels.LABELS, continuations=1))
    missed = 0
    for seed in range(10):
        problem = in_stages(seed, "", 4, one_stop=True)
        least = least_of_all(problem)
        graph = StageGraph.of(problem, singles=True)
        prices = good_prices(graph, 2.0 * least, 20)
        found = LabelSearch(graph, prices, 2.0 * least, most).run()
        assert found.bound <= least + CLOSE
        missed += found.bound < least - CLOSE
    assert missed > 3


def test_a_proof_without_prices_to_begin_with_takes_all_steps(in_stages):
    """Of three stops one arm is idle once, so that pairs alone have no prices: as many steps as the effort says."""
    for seed in range(4):
        problem = in_stages(seed, "", 3, one_stop=True)
        start = StageSearch(problem, 0).first()
        upper = with_angles(problem, start.slots).total
        graph = StageGraph.of(problem, singles=True)
        proof = prove_order(problem, start, ProofEffort(40, 1000))
        assert proof.prices.bound == good_prices(graph, upper, 40).bound
