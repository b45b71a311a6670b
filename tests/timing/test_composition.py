"""One after the other and side by side."""

from __future__ import annotations

import numpy as np
import pytest

from dualarm_cli.timing import TIMING_SOLVERS
from dualarm_cli.timing.composition import concatenate, hold, merge
from dualarm_cli.timing.problem import TransferProblem

JOINTS = ("s", "l", "e", "u", "r", "b", "t")


def transfer(limits, seed, joints=JOINTS, minimum=0.0):
    """A random transfer of some joints."""
    start, goal = np.random.default_rng(seed).uniform(-1, 1, (2, len(joints)))
    own = limits.select(joints)
    return TIMING_SOLVERS["ruckig"].transfer(TransferProblem(joints, start, goal, own, minimum))


def test_merging_loses_nothing(limits):
    """Two groups of joints, merged, are where each of them was, at any time."""
    one = transfer(limits, 1, ("s", "e"), 2.0)
    two = transfer(limits, 2, ("t", "l"), 2.0)
    both = merge([one, two], ("l", "s", "t", "e"))
    times = np.linspace(0, 2, 777)
    for rates in zip(both.at(times), one.at(times), two.at(times), strict=True):
        together, first, second = rates
        assert np.abs(together[:, [1, 3]] - first).max() < 1e-9
        assert np.abs(together[:, [2, 0]] - second).max() < 1e-9
    assert set(np.round(both.time, 8)) == set(np.round([*one.time, *two.time], 8))


def test_a_shorter_group_stands_at_its_end(limits):
    """The motion of the longer one goes on."""
    one, two = transfer(limits, 3, ("s",)), transfer(limits, 4, ("e",), 5.0)
    both = merge([one, two], ("s", "e"))
    assert both.duration == 5.0
    assert both.position[-1, 0] == pytest.approx(one.position[-1, 0], abs=1e-12)


def test_knots_a_nanosecond_apart_become_one():
    """The distance of any two knots is more than rounding, or nothing at all."""
    one = hold(("a",), np.zeros(1), 1.0)
    two = concatenate([hold(("b",), np.zeros(1), 0.5), hold(("b",), np.zeros(1), 0.5 + 4e-10)])
    step = np.diff(merge([one, two], ("a", "b")).time)
    assert ((step == 0) | (step > 1e-9)).all()


def test_following_trajectories_share_their_knot(limits):
    """Time runs on, joints do not jump, the knot in the middle is one."""
    first = transfer(limits, 5)
    second = hold(JOINTS, first.position[-1], 0.25)
    both = concatenate([first, second])
    assert both.duration == pytest.approx(first.duration + 0.25, abs=1e-12)
    assert len(both.time) == len(first.time) + 1
    assert (np.diff(both.time) > 0).all()


def test_strangers_are_refused(limits):
    """Other joints cannot follow, nor stand twice side by side."""
    one, two = transfer(limits, 6, ("s",)), transfer(limits, 7, ("e",))
    with pytest.raises(ValueError, match="different joints"):
        concatenate([one, two])
    with pytest.raises(ValueError, match="groups hold"):
        merge([one, one], ("s",))
