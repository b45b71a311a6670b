"""Stages with tool changes: lengths over all angles in between, and every way to put two arms' stops in one stage."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise, product

import numpy as np
import pytest

from dualarm_cli.orders.paired.changes import (
    EARLY,
    StageStands,
    StageTools,
    best_stages,
    stages_with_changes,
    with_whole_changes,
)
from dualarm_cli.orders.paired.exact import best_of_all
from dualarm_cli.orders.paired.problem import IDLE
from dualarm_cli.orders.paired.times import totals
from dualarm_cli.orders.rules.stores import Stores
from dualarm_cli.orders.rules.tool_stands import NO_TOOL


def all_stages(rows):
    """Yields every way to make two rows of stops in stages."""

    def made(i, j):
        if i == len(rows[0]) and j == len(rows[1]):
            yield []
        for one, other in ((1, 1), (1, 0), (0, 1)):
            if i + one <= len(rows[0]) and j + other <= len(rows[1]):
                stage = [rows[0][i] if one else IDLE, rows[1][j] if other else IDLE]
                for rest in made(i + one, j + other):
                    yield [stage, *rest]

    for stages in made(0, 0):
        yield np.array(stages, dtype=np.int64).reshape(-1, 2)


def keeps_precedence(problem, stages):
    """Returns whether tasks are over in an earlier stage than those begin that come after them."""
    when = {stop: k for k, row in enumerate(stages.tolist()) for stop in row if stop != IDLE}
    return all(
        when[problem.tasks[a][-1]] < when[problem.tasks[b][0]]
        for a, b in problem.before
        if problem.tasks[a][-1] in when and problem.tasks[b][0] in when
    )


@pytest.mark.parametrize("kind", ["", "apart", "windows", "before", "before apart"])
def test_two_rows_of_stops_are_put_side_by_side_as_is_quickest(in_stages, kind):
    """Against all 321 or fewer ways, each at its best angles."""
    compared = 0
    for seed in range(12):
        problem = in_stages(seed, kind, 4)
        rows: list[list[int]] = [[], []]
        for t, own in enumerate(problem.tasks):
            arms = [a for a in (0, 1) if problem.allowed(a, t)]
            rows[arms[t % len(arms)]] += own
        every = [s for s in all_stages(rows) if keeps_precedence(problem, s)]
        least = min((float(totals(problem, s[None])[0]) for s in every), default=np.inf)
        found = best_stages(problem, rows)
        for a in (0, 1):
            assert [s for s in found[:, a].tolist() if s != IDLE] == rows[a]
        if not np.isfinite(least):
            continue
        compared += 1
        assert keeps_precedence(problem, found)
        total = float(totals(problem, found[None])[0])
        assert least - 1e-9 <= total <= least + EARLY * len(found)
    assert compared > 5


def keeps_levels(change, capacity, initial, stages):
    """Returns whether a buffer has a part for each pick and room for each place, whichever arm is the first."""
    level = initial
    for row in stages.tolist():
        puts = sum(change[stop] == 1 for stop in row if stop != IDLE)
        takes = sum(change[stop] == -1 for stop in row if stop != IDLE)
        if takes > level or level + puts > capacity:
            return False
        level += puts - takes
    return True


def test_two_rows_of_stops_keep_a_buffer(in_stages):
    """The first arm's stops put parts into a buffer for one, the second arm's take them out, against all ways."""
    waited = 0
    for seed in range(8):
        tables = replace(in_stages(seed, "", 6, one_stop=True), pair_cost=None)
        lengths = [np.where(np.isinf(x) & (x > 0), 2.0, x) for x in tables.length]
        change = [1, 1, 1, -1, -1, -1]
        stores = Stores(np.array([*change, 0])[:, None], np.array([1]), np.array([0]))
        problem = replace(tables, length=tuple(lengths), stores=stores)
        rows = [[0, 1, 2], [3, 4, 5]]
        every = [s for s in all_stages(rows) if keeps_levels(change, 1, 0, s)]
        plain = replace(problem, stores=None)
        least = min(float(totals(plain, s[None])[0]) for s in every)
        found = best_stages(problem, rows)
        assert keeps_levels(change, 1, 0, found)
        assert float(totals(plain, found[None])[0]) <= least + EARLY * len(found)
        waited += not keeps_levels(change, 1, 0, best_stages(plain, rows))
    assert waited == 8


def test_stops_at_stands_leave_buffers_alone(in_stages):
    """Task 1 puts the part in that task 2 takes out: the other arm waits for the tool change that is between."""
    stands = with_stands(in_stages, 6)
    change = [0, 1, -1, 0, 0, 0, 0]
    stores = Stores(np.array([*change, 0])[:, None], np.array([1]), np.array([0]))
    stands = replace(stands, whole=replace(stands.whole, stores=stores))
    assert with_whole_changes(stands, 3).stores.change[:, 0].tolist() == [0, 1, -1, 0]
    stages = stages_with_changes(stands, np.array([[0, IDLE], [1, IDLE], [IDLE, 2]]))
    assert [s for s in stages[:, 0].tolist() if s != IDLE] == [0, 3, 6, 1, 5, 4]
    assert keeps_levels(change, 1, 0, stages)


def test_one_arms_stops_have_stages_of_their_own(in_stages):
    """One after the other."""
    problem = in_stages(0, "", 3, 1)
    assert best_stages(problem, [[0, 1, 2]]).tolist() == [[0], [1], [2]]


def with_stands(in_stages, seed, *, returns=True):
    """Returns tables of five stops of three tasks and four stands of the first arm, and what is for what."""
    tables = replace(in_stages(seed, "", 7, 2, one_stop=True), returns=returns)
    works = [np.where(np.isfinite(w), w, 1.0) for w in tables.work]
    lengths = [np.where(np.isinf(x) & (x > 0), 2.0, x) for x in tables.length]
    if not returns:
        lengths = [np.concatenate([x[:, :7], 0.0 * x[:, 7:8], x[:, 8:]], 1) for x in lengths]
    whole = replace(tables, length=tuple(lengths), work=tuple(works))
    tools = StageTools((0, 1, 0), 0, {0: 3, 1: 5}, {0: 4, 1: 6})
    return StageStands(whole, (tools, None))


@pytest.mark.parametrize("returns", [True, False])
def test_a_length_has_the_whole_change_in_it_at_the_best_angles(in_stages, returns):
    """Left at one angle, taken at another: the least of all of them; without another tool nothing changes."""
    stands = with_stands(in_stages, 5, returns=returns)
    whole, f = stands.whole, len(stands.whole.turn)
    found = with_whole_changes(stands, 3)
    L = whole.length[0]
    assert found.tasks == whole.tasks[:3]
    assert [x.shape for x in found.length] == [(4, 5, f, f)] * 2
    np.testing.assert_array_equal(found.length[0][0, 2], L[0, 2])
    np.testing.assert_array_equal(
        found.length[1], whole.length[1][np.ix_([0, 1, 2, 7], [0, 1, 2, 7, 8])]
    )
    for g, h in product(range(f), repeat=2):
        through = [
            (
                L[0, 3, g, a] + L[3, 6, a, b] + L[6, 1, b, h],
                L[7, 3, g, a] + L[3, 6, a, b] + L[6, 1, b, h],
            )
            for a, b in product(range(f), repeat=2)
        ]
        assert found.length[0][0, 1, g, h] == pytest.approx(min(one for one, _ in through))
        assert found.length[0][3, 1, g, h] == pytest.approx(min(other for _, other in through))
        home = [
            L[1, 5, g, a] + L[5, 4, a, b] + L[4, 7, b, h] for a, b in product(range(f), repeat=2)
        ]
        assert found.length[0][1, 3, g, h] == pytest.approx(min(home) if returns else 0.0)


def test_changes_are_put_into_an_order(in_stages):
    """Left and taken between tasks of two tools, and at the end for the tool of the start; the other arm goes on."""
    stands = with_stands(in_stages, 6)
    slots = np.array([[0, IDLE], [1, 2]])
    stages = stages_with_changes(stands, slots)
    assert [s for s in stages[:, 0].tolist() if s != IDLE] == [0, 3, 6, 1, 5, 4]
    assert [s for s in stages[:, 1].tolist() if s != IDLE] == [2]
    own = [[0, 3, 6, 1, 5, 4], [2]]
    least = min(float(totals(stands.whole, s[None])[0]) for s in all_stages(own))
    assert float(totals(stands.whole, stages[None])[0]) == pytest.approx(least, abs=1e-3)


def test_no_tool_is_neither_left_nor_taken():
    """From none to one: taken; from one to none: left."""
    tools = StageTools((0, NO_TOOL), NO_TOOL, {0: 2}, {0: 3})
    assert tools.changes(NO_TOOL, 0) == (3,)
    assert tools.changes(0, NO_TOOL) == (2,)
    assert tools.changes(0, 0) == tools.changes(NO_TOOL, NO_TOOL) == ()


def test_the_best_order_of_stages_groups_tools(in_stages):
    """Four tasks of two tools, changes dearer than all else: two changes, there and back."""
    tables = replace(in_stages(9, "", 8, 1, one_stop=True), returns=True)
    L = np.where(np.isinf(tables.length[0]) & (tables.length[0] > 0), 2.0, tables.length[0])
    L[:, 4:8] += 50.0
    whole = replace(tables, length=(L,), work=(np.ones((8, 3)),))
    tools = StageTools((0, 1, 0, 1), 0, {0: 4, 1: 6}, {0: 5, 1: 7})
    problem = with_whole_changes(StageStands(whole, (tools,)), 4)
    plain = with_whole_changes(StageStands(whole, (None,)), 4)
    counted = []
    for one in (problem, plain):
        row = [tools.tool[s] for s in best_of_all(one).slots[:, 0].tolist()]
        counted.append(sum(a != b for a, b in pairwise([0, *row, 0])))
    assert counted[0] == 2 < counted[1]


def test_visits_to_stands_keep_buffers(in_stages):
    """The other arm's stop takes the part that a stop of the second tool puts: it is made after that, never before."""
    stands = with_stands(in_stages, 6)
    change = np.zeros((len(stands.whole.work[0]) + 1, 1), dtype=np.int64)
    change[1], change[2] = 1, -1
    whole = replace(stands.whole, stores=Stores(change, np.array([1]), np.array([0])))
    stands = replace(stands, whole=whole)
    plain = with_whole_changes(stands, 3)
    np.testing.assert_array_equal(plain.stores.change, change[[0, 1, 2, 7]])
    stages = stages_with_changes(stands, np.array([[0, IDLE], [1, IDLE], [IDLE, 2]]))
    own = [[0, 3, 6, 1, 5, 4], [2]]
    at = {stop: k for k, row in enumerate(stages.tolist()) for stop in row}
    assert at[1] < at[2]
    kept = [s for s in all_stages(own) if _first(s, 1) < _first(s, 2)]
    least = min(float(totals(whole, s[None])[0]) for s in kept)
    assert float(totals(whole, stages[None])[0]) == pytest.approx(least, abs=1e-3)


def _first(stages, stop):
    """Returns the stage in which a stop is made."""
    return int(np.flatnonzero((stages == stop).any(axis=1))[0])
