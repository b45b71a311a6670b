"""One after the other and side by side."""

from __future__ import annotations

import numpy as np
import pytest

from dualarm_cli.model.motion.joint_motion import merge
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.timing import TIMING_SOLVERS
from dualarm_cli.timing.composition import concatenate, hold
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


def test_what_does_not_follow_is_refused():
    """Nothing at all, and a start that is not where the last one ended."""
    with pytest.raises(ValueError, match="no trajectories"):
        concatenate([])
    here, there = (hold(("s",), np.array([q]), 0.5) for q in (0.0, 0.1))
    with pytest.raises(ValueError, match=r"starts at \[0.1\], 0.5 s after the first"):
        concatenate([here, there])


def test_a_chain_of_near_knots_does_not_swallow_a_far_one():
    """Knots 0.8 ns apart: every second one stays, since each is compared with the last one kept."""
    time = np.array([0.0, 0.8e-9, 1.6e-9, 2.4e-9, 1.0])
    rest = np.zeros((5, 1))
    both = merge([Trajectory(("s",), time, rest, rest, rest)], ("s",))
    assert both.time.tolist() == [0.0, 1.6e-9, 1.0]


def test_only_the_joint_whose_acceleration_jumps_has_two_values(limits, without_jerk):
    """A jerk-limited group beside one without: double knots, but the first goes on smoothly."""
    smooth = transfer(limits, 8, ("s", "l"), 2.0)
    jumping = transfer(without_jerk, 9, ("e", "u"), 2.0)
    both = merge([smooth, jumping], ("s", "l", "e", "u"))
    double = np.flatnonzero(np.diff(both.time) == 0)
    assert len(double) >= 4
    assert np.array_equal(both.acceleration[double, :2], both.acceleration[double + 1, :2])
    assert (both.acceleration[double, 2:] != both.acceleration[double + 1, 2:]).any(axis=1).all()


def test_a_thousand_stages_are_what_their_pieces_are(limits):
    """Knots add up, and the thousandth piece is where it should be."""
    there = transfer(limits, 10, ("s", "l"))
    back = transfer(limits, 10, ("s", "l"))
    back = Trajectory(
        back.joints,
        back.duration - back.time[::-1],
        back.position[::-1],
        -back.velocity[::-1],
        back.acceleration[::-1],
    )
    chain = concatenate([there, back] * 500)
    whole = merge([chain, hold(("e",), np.zeros(1), chain.duration)], ("s", "l", "e"))
    assert len(chain.time) == 500 * (len(there.time) + len(back.time)) - 999
    assert len(whole.time) == len(chain.time)
    last = 998 * there.duration
    times = np.linspace(0, there.duration, 50)
    assert np.abs(whole.at(last + times)[0][:, :2] - there.at(times)[0]).max() < 1e-9


def test_a_knot_that_stands_in_for_another_keeps_its_acceleration() -> None:
    """Two joints leave full deceleration 0.3 ns apart; at the one knot that is left neither exceeds its limit."""
    full = 9.9
    parts = []
    for name, later in (("a", 0.0), ("b", 3e-10)):
        time = np.array([0.0, 0.5 + later, 0.6 + later])
        acceleration = np.array([[-full], [-full], [0.0]])
        velocity = np.array([[5.0], [5.0 - full * (0.5 + later)], [0.0]])
        velocity[2] = velocity[1] - 0.5 * full * 0.1
        position = np.zeros((3, 1))
        position[1] = 5.0 * time[1] - 0.5 * full * time[1] ** 2
        position[2] = position[1] + velocity[1] * 0.1 - full * 0.01 / 3
        parts.append(Trajectory((name,), time, position, velocity, acceleration))
    merged = merge(parts, joints=("a", "b"))
    assert np.abs(merged.acceleration).max() <= full


def test_a_knot_that_stands_in_for_another_keeps_its_velocity() -> None:
    """Two joints end their cruise 0.5 ns apart; at the one knot that is left neither is faster than it cruised."""
    full, cruise = 9.9, 2.967
    parts = []
    for name, later in (("a", 0.0), ("b", 5e-10)):
        edge, stop = 0.5 + later, 0.5 + later + cruise / full
        # Two knots at the edge: without a jerk limit the acceleration jumps there.
        time = np.array([0.0, edge, edge, stop])
        velocity = np.array([[cruise], [cruise], [cruise], [0.0]])
        acceleration = np.array([[0.0], [0.0], [-full], [-full]])
        position = np.array([[0.0], [cruise * edge], [cruise * edge], [cruise * edge]])
        position[3] += 0.5 * cruise * (stop - edge)
        parts.append(Trajectory((name,), time, position, velocity, acceleration))
    merged = merge(parts, joints=("a", "b"))
    assert len(merged.time) < 8
    assert np.abs(merged.velocity).max() <= cruise


def test_where_begins_are_known_rounding_does_not_add_up():
    """100,000 pieces of 0.1 s: summed up they end 19 nanoseconds too late."""
    piece = hold(("s",), np.zeros(1), 0.1)
    moved = Trajectory(
        ("s",), piece.time, np.zeros((2, 1)), np.zeros((2, 1)), np.array([[1.0], [-1.0]])
    )
    count = 100_000
    begins = {k: 0.1 * k for k in range(0, count, 10)}
    time = concatenate([moved] * count, begins).time.reshape(count, 2)
    expected = 0.1 * np.arange(count)
    assert np.abs(time[:, 0] - expected).max() < 1e-11
    assert (np.diff(time.ravel()) >= 0.0).all()
    np.testing.assert_array_equal(time[1:, 0], time[:-1, 1])
    assert concatenate([moved] * count).time[-1] - 0.1 * count > 1e-8


def test_a_known_begin_is_that_of_the_sum_but_for_rounding():
    piece = hold(("s",), np.zeros(1), 0.1)
    with pytest.raises(ValueError, match=r"starts 0\.3 s after the first"):
        concatenate([piece, piece], {1: 0.3})


def test_a_piece_of_no_length_keeps_a_jump_at_one_time():
    """Begun later by rounding, between standing and a jump to 1 rad/s²; merged with another group nothing is lost."""
    stands, nothing = hold(("s",), np.zeros(1), 0.7), hold(("s",), np.zeros(1), 0.0)
    jump = Trajectory(
        ("s",), np.array([0.0, 0.0, 1.0]), np.array([[0.0], [0.0], [0.5]]),
        np.array([[0.0], [0.0], [1.0]]), np.array([[0.0], [1.0], [1.0]]),
    )  # fmt: skip
    joined = concatenate([stands, nothing, jump], {1: 0.7 + 1e-12})
    both = merge([joined, hold(("e",), np.zeros(1), 1.7)], ("s", "e"))
    q, v, a = both.at(np.array([0.35, 0.6999, 1.2]))
    np.testing.assert_allclose(q[:, 0], [0.0, 0.0, 0.125], atol=1e-9)
    np.testing.assert_allclose(v[:, 0], [0.0, 0.0, 0.5], atol=1e-9)
    np.testing.assert_array_equal(a[:, 0], [0.0, 0.0, 1.0])


@pytest.mark.parametrize("defect", [np.nan, -0.5])
def test_a_defective_time_stays_for_the_verifier_to_find(defect):
    piece = Trajectory(("s",), np.array([0.0, defect, 1.0]), *[np.zeros((3, 1))] * 3)
    np.testing.assert_array_equal(concatenate([piece]).time, piece.time)


def test_in_very_long_motions_rounding_is_larger():
    """Six pieces a stage, begun after 1e7 s, where numbers are 2e-9 apart."""
    long, piece = hold(("s",), np.zeros(1), 1e7), hold(("s",), np.zeros(1), 0.1)
    begins = {1 + 6 * k: 1e7 + 0.6 * k for k in range(100)}
    joined = concatenate([long, *[piece] * 600], begins)
    assert abs(joined.time[-1] - (1e7 + 60.0)) < 1e-6
