"""How long stages take: by hand, and against two arms' own clocks played step by step."""

from __future__ import annotations

import numpy as np
import pytest

from dualarm_cli.timing.stage_length import stage_length


def test_a_stage_lasts_as_long_as_its_slower_arm():
    """1 s there and 2 s of work against 2.5 s there and 0.4 s: 3 s; the arm that is idle counts as nothing."""
    assert stage_length([1.0, 2.5], [2.0, 0.4]) == 3.0
    assert stage_length([1.0, 2.5], [2.0, 0.4], [0.0, -np.inf]) == 3.0
    assert stage_length([1.0, 2.5], [2.0, 0.4], [0.1, 0.9]) == pytest.approx(3.8, abs=1e-12)
    assert stage_length([], []) == 0.0


def test_in_a_hand_over_both_wait_for_the_later_one_and_then_for_each_other():
    """The same two: both are there after 2.5 s, and 2.4 s of work follow one after the other: 4.9 s."""
    assert stage_length([1.0, 2.5], [1.5, 0.3], [0.5, 0.1], True) == pytest.approx(4.9, abs=1e-12)


def test_many_stages_are_each_by_itself():
    """Random ones of both kinds against clocks that are set forward one event after the other."""
    rng = np.random.default_rng(0)
    there, work = rng.uniform(0.0, 3.0, (2, 2, 50))
    is_handover = rng.random(50) < 0.5
    found = stage_length(there, work, is_handover=is_handover)
    for k in range(50):
        clock = list(there[:, k])
        if is_handover[k]:
            clock = [max(clock)] * 2
            for arm in (1, 0):
                clock = [clock[arm] + work[arm, k]] * 2
        else:
            clock = [clock[arm] + work[arm, k] for arm in (0, 1)]
        assert found[k] == pytest.approx(max(clock), abs=1e-12)


def test_choices_of_both_arms_broadcast():
    """Three ways of one arm beside two of the other one: all six pairs, by a double loop."""
    one, other = np.array([1.0, 2.0, 3.0])[:, None], np.array([0.5, 2.5])
    for is_handover in (False, True):
        found = stage_length([one, other], [0.1 * one, 0.2 * other], is_handover=is_handover)
        for i, a in enumerate((1.0, 2.0, 3.0)):
            for j, b in enumerate((0.5, 2.5)):
                ends = max(1.1 * a, 1.2 * b)
                met = max(a, b) + 0.1 * a + 0.2 * b
                assert found[i, j] == pytest.approx(met if is_handover else ends, abs=1e-12)
