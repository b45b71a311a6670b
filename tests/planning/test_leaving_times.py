"""Exact instants for ways that were found in steps: hand arithmetic, and rules kept by the least waits at random."""

from __future__ import annotations

import numpy as np
import pytest

from dualarm_cli.planning.asynchronous.own_clock import (
    ClockSteps,
    NotBefore,
    Since,
    leaving_times,
    waits_at,
)


def test_every_rest_has_a_step_of_its_own_and_its_exact_instant():
    """By hand, steps of 20 ms: 0.959 s is within step 48, two rests of 1 ms apart are one step apart."""
    clock = ClockSteps.of((0.0, 0.001, 0.959), 0.96, 0.02)
    assert clock.places == (0, 1, 48)
    assert clock.count == 49  # the last rest is left within the clock
    times = clock.times()
    assert times[[0, 1, 2, 47, 48, 49]] == pytest.approx([0.0, 0.001, 0.04, 0.94, 0.959, 0.96])
    assert clock.rest_at(0.959) == 2
    assert clock.rest_at(0.5) is None


def test_a_clock_without_length_has_a_step_in_which_its_rest_is_left():
    """One bare move of a free start: the arm is there at once, and waits before that counts."""
    clock = ClockSteps.of((0.0,), 0.0, 0.02)
    assert (clock.places, clock.count) == ((0,), 1)
    assert ClockSteps.of((), 0.0, 0.02).count == 0
    assert clock.left(0.0) == Since(0, 0.0)
    assert clock.arrived(0.0) == Since(-1, 0.0)


def test_instants_move_with_the_rest_before_them():
    """By hand: 1.5 s is 0.5 s behind the rest at 1 s; what is at a rest just then is before or behind its wait."""
    clock = ClockSteps.of((0.0, 1.0), 2.0, 0.02)
    assert clock.arrived(1.5) == clock.left(1.5) == Since(1, 0.5)
    assert clock.arrived(1.0) == Since(0, 1.0)
    assert clock.left(1.0) == Since(1, 0.0)
    assert clock.reached(50) == Since(0, 1.0)  # before the wait there
    assert clock.reached(51) == Since(1, pytest.approx(0.02))


def test_a_task_is_let_go_when_the_other_is_over_to_the_instant():
    """By hand, the figures of the plan that began 20 ms too soon: a is over at 2.939 s, b's line is at 0.959 s."""
    clocks = (ClockSteps.of((0.0, 0.9), 2.939, 0.02), ClockSteps.of((0.0, 0.959), 3.0, 0.02))
    rule = NotBefore(1, 1, "after", 0.0, clocks[0].arrived(2.939))
    found = leaving_times(clocks, [rule, NotBefore(0, 1, "platform", 1.0)])
    assert found == (pytest.approx((0.0, 1.0)), pytest.approx((0.0, 3.039)))
    assert waits_at(clocks[1], found[1]) == pytest.approx([0.0, 3.039 - 0.959])
    assert waits_at(clocks[0], found[0]) == pytest.approx([0.0, 0.1])


def test_arms_that_wait_for_each_other_have_no_times():
    """Each before the other."""
    clocks = (ClockSteps.of((0.0, 1.0), 2.0, 0.02), ClockSteps.of((0.0, 1.0), 2.0, 0.02))
    rules = [NotBefore(a, 0, "after", 0.0, clocks[1 - a].left(1.5)) for a in (0, 1)]
    assert leaving_times(clocks, rules) is None


@pytest.mark.parametrize("seed", range(40))
def test_all_rules_are_kept_and_nobody_waits_longer(seed):
    """Random clocks and rules: each rest is left as soon as the arm is there and its rules allow, in any order of them.

    What is left as soon as it may be is left at the largest of those instants: each is one of them, and none is less.
    """
    rng = np.random.default_rng(seed)
    clocks = tuple(
        ClockSteps.of(
            tuple(np.cumsum(rng.uniform(0.01, 1.0, 6)).tolist()), float(rng.uniform(7.0, 8.0)), 0.02
        )
        for _ in range(2)
    )
    rules = []
    for _ in range(8):
        arm, rest = int(rng.integers(2)), int(rng.integers(6))
        if rng.random() < 0.3:
            rules.append(NotBefore(arm, rest, "window", float(rng.uniform(0.0, 6.0))))
        else:
            since = Since(int(rng.integers(-1, rest + 1)), float(rng.uniform(0.0, 0.5)))
            rules.append(NotBefore(arm, rest, "after", float(rng.uniform(-0.2, 0.2)), since))
    found = leaving_times(clocks, rules)
    again = leaving_times(clocks, [rules[k] for k in rng.permutation(len(rules))])
    assert (found is None) == (again is None)
    if found is None:
        return
    for one, other in zip(found, again, strict=True):
        assert one == pytest.approx(other, abs=1e-8)
    for a, (clock, own) in enumerate(zip(clocks, found, strict=True)):
        gone = 0.0
        for k, time in enumerate(clock.rests):
            allowed = [time + gone]
            for rule in rules:
                if (rule.arm, rule.rest) != (a, k):
                    continue
                if rule.reference is None:
                    allowed.append(rule.time)
                else:
                    left = found[1 - a][rule.reference.rest] if rule.reference.rest >= 0 else 0.0
                    allowed.append(left + rule.reference.after + rule.time)
            assert own[k] == pytest.approx(max(allowed), abs=1e-8)
            gone = own[k] - time
        assert waits_at(clock, own) == pytest.approx(np.diff([0.0, *(np.array(own) - clock.rests)]))
