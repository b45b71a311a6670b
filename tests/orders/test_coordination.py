"""Two arms' quickest way together against every way, step by step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dualarm_cli.orders.asynchronous.coordination import Diagram, quickest_path


def free(diagram, i, j):
    """Says whether two places may be taken together."""
    c = j - i + diagram.band
    return 0 <= c <= 2 * diagram.band and not diagram.blocked[i, c]


def naive(diagram):
    """Returns how many steps the quickest way takes, None for no way: all states, instant by instant."""
    n, m = diagram.steps
    may_wait = [{*rests, steps} for rests, steps in zip(diagram.rests, diagram.steps, strict=True)]
    opens = [{}, {}]
    for a in (0, 1):
        for place, time in diagram.opens[a]:
            opens[a][place] = max(opens[a].get(place, 0), time)
    needs = [{}, {}]
    for a in (0, 1):
        for place, other in diagram.needs[a]:
            needs[a][place] = max(needs[a].get(place, 0), other)
    now = {(0, 0)} if free(diagram, 0, 0) else set()
    longest = n + m + max([time for own in opens for time in own.values()], default=0) + 1
    for time in range(longest + 1):
        if (n, m) in now:
            return time
        then = set()
        for i, j in now:
            for di in (0, 1):
                for dj in (0, 1):
                    if i + di > n or j + dj > m:
                        continue
                    if (not di and i not in may_wait[0]) or (not dj and j not in may_wait[1]):
                        continue
                    if (di and time < opens[0].get(i, 0)) or (dj and time < opens[1].get(j, 0)):
                        continue
                    if (di and j < needs[0].get(i, 0)) or (dj and i < needs[1].get(j, 0)):
                        continue
                    if free(diagram, i + di, j + dj):
                        then.add((i + di, j + dj))
        now = then
    return None


def gone(diagram, found):
    """Follows a way: both arms go on but where they wait; returns its steps of time. Fails where it must not be."""
    places = []
    for a in (0, 1):
        may_wait = {*diagram.rests[a], diagram.steps[a]}
        waits = dict(found.waits[a])
        assert set(waits) <= may_wait
        own = []
        for place in range(diagram.steps[a] + 1):
            own += [place] * (1 + waits.get(place, 0))
            for where, time in diagram.opens[a]:
                if where == place and place < diagram.steps[a]:
                    assert len(own) - 1 >= time
        places.append(own)
    length = max(len(own) for own in places) - 1
    for own in places:
        own += [own[-1]] * (length + 1 - len(own))
    for i, j in zip(*places, strict=True):
        assert free(diagram, i, j), (i, j)
    for a, own in enumerate(places):
        for here, there, other in zip(own, own[1:], places[1 - a], strict=False):
            assert here == there or all(o <= other for p, o in diagram.needs[a] if p == here)
    return length


def some_diagram(rng, share, *, opens=False, needs=False):
    """Returns a random plane; its corners are free."""
    steps = tuple(rng.integers(2, 9, 2).tolist())
    band = int(rng.integers(max(1, abs(steps[0] - steps[1])), max(steps) + 1))
    blocked = rng.random((steps[0] + 1, 2 * band + 1)) < share
    blocked[0, band] = blocked[steps[0], band + steps[1] - steps[0]] = False
    rests = tuple(
        tuple(sorted({0, *rng.integers(0, n, int(rng.integers(0, n))).tolist()})) for n in steps
    )
    times = ((), ())
    if opens:
        times = tuple(
            tuple((int(rng.choice(own)), int(rng.integers(1, 12))) for _ in range(2))
            for own in rests
        )
    after = ((), ())
    if needs:
        after = tuple(
            tuple((int(rng.choice(own)), int(rng.integers(0, n + 1))) for _ in range(2))
            for own, n in zip(rests, steps[::-1], strict=True)
        )
    return Diagram(steps, rests, blocked, times, after)


@pytest.mark.parametrize("needs", [False, True])
@pytest.mark.parametrize("share", [0.0, 0.2, 0.4])
def test_it_is_the_quickest_of_all_ways(share, needs):
    """300 planes each; what it says of waits is a way of just that length, also where arms need each other ahead."""
    rng = np.random.default_rng(int(10 * share))
    none = 0
    for k in range(300):
        diagram = some_diagram(rng, share, needs=needs)
        least, found = naive(diagram), quickest_path(diagram)
        assert (found is None) == (least is None), k
        if found is None:
            none += 1
            continue
        assert found.length == least, k
        assert gone(diagram, found) == least
    assert none < 300
    assert (none > 0) == (share > 0.0 or needs)


@pytest.mark.parametrize("share", [0.0, 0.15, 0.3])
def test_no_arm_goes_on_before_it_may(share):
    """Windows at rests; a way that is found can be gone, and without obstacles none is quicker.

    Among obstacles the least time at which a state is reached may not be the best one: an arm may have to leave a rest
    later so as not to be stuck, while the other one waits for its window. At most a sixth is missed or slower by that.
    """
    rng = np.random.default_rng(30 + int(100 * share))
    worse = 0
    for k in range(300):
        diagram = some_diagram(rng, share, opens=True)
        if share == 0.0:
            blocked = np.zeros((diagram.steps[0] + 1, 2 * max(diagram.steps) + 1), dtype=bool)
            diagram = replace(diagram, blocked=blocked)
        least, found = naive(diagram), quickest_path(diagram)
        if found is not None:
            assert gone(diagram, found) == found.length, k
            assert least is not None
            assert found.length >= least
        worse += least is not None and (found is None or found.length > least)
    assert worse <= (50 if share else 0)


def test_one_arm_lets_the_other_pass():
    """By hand: four steps each, together at no place but the ends; rests at 0 and 2.

    The arms may be at (0, 1..4) and (1..4, 4), say: the first waits for three of the second's four steps, and goes on
    with the last one.
    """
    blocked = np.ones((5, 9), dtype=bool)
    for j in range(5):
        blocked[0, 4 + j] = False
    for i in range(1, 5):
        blocked[i, 4 + 4 - i] = False
    found = quickest_path(Diagram((4, 4), ((0, 2), (0, 2)), blocked))
    assert found.length == 7
    assert found.waits == (((0, 3),), ())
    # Not from its start: the second arm may not wait at its end forever, the first must not wait at 0.
    assert quickest_path(Diagram((4, 4), ((2,), (0, 2)), blocked)) is None


def test_no_way_leads_out_of_the_band():
    """The second arm has three steps more than the first, which may not be that far behind."""
    blocked = np.zeros((3, 3), dtype=bool)
    assert quickest_path(Diagram((2, 5), ((0,), (0,)), blocked)) is None
    wide = np.zeros((3, 7), dtype=bool)
    assert quickest_path(Diagram((2, 5), ((0,), (0,)), wide)).length == 5
