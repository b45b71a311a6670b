"""How late one arm may be: against hand arithmetic and brute force, and the clocks of what is there."""

from __future__ import annotations

from itertools import pairwise

import coal
import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.collision.solids import Pair, Solid, geometry_model
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.verification.delay_checks import ALWAYS, ArmPair, DelayProof, DelaySearch

RADIUS = 0.05
"""Radius of both balls [m]."""


def slides(*, torso=False):
    """Two joints that slide along x, each with a ball at its origin, perhaps on a turntable; and these balls."""
    model, mount = pin.Model(), 0
    if torso:
        mount = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "turn")
    solids = []
    for name in ("one", "other"):
        joint = model.addJoint(mount, pin.JointModelPX(), pin.SE3.Identity(), name)
        ball = coal.Sphere(RADIUS)
        solids.append(Solid(name, joint, pin.SE3.Identity(), ball, RADIUS))
    model.lowerPositionLimit[:], model.upperPositionLimit[:] = -10.0, 10.0
    return model, solids


def straight(joints, start, rates, duration):
    """Motion of joints at constant rates from where they start."""
    start, rates = np.array(start), np.array(rates)
    position = np.stack([start, start + duration * rates])
    velocity, still = np.tile(rates, (2, 1)), np.zeros((2, len(rates)))
    return Trajectory(tuple(joints), np.array([0.0, duration]), position, velocity, still)


def both(proof, asked=()):
    """Brackets with the one arm late and with the other."""
    return proof.bracket(0, asked), proof.bracket(1, asked)


@pytest.mark.parametrize("torso", [False, True])
@pytest.mark.parametrize(("gap", "rate", "required"), [(0.05, 1.0, 0.01), (0.2, 2.5, 0.0)])
def test_a_leader_that_is_late_is_caught_up_with_after_gap_over_rate(gap, rate, required, torso):
    """Two balls in a row at one rate: late by d the leader is d times the rate nearer; its follower never is.

    What both stand on may turn meanwhile.
    """
    model, solids = slides(torso=torso)
    joints, start, rates = ["one", "other"], [2.0 * RADIUS + gap, 0.0], [rate, rate]
    if torso:
        joints, start, rates = ["turn", *joints], [0.0, *start], [0.8, *rates]
    motion = straight(joints, start, rates, 0.5)
    leader, follower = both(DelayProof(model, motion, solids, [ArmPair(Pair(0, 1, required))], 0.5))
    exact = (gap - required) / rate
    assert leader.proven <= exact + 1e-6
    assert exact <= leader.broken + 1e-6
    assert leader.broken - leader.proven <= 6e-4
    assert follower == type(follower)(0.5)


def test_boxes_enclose_what_moves_in_their_stretch():
    """A box off its joint's origin, and a ball, at instants of every stretch of time."""
    model, solids = slides()
    corners = coal.StdVec_Vec3s()
    for corner in np.ndindex(2, 2, 2):
        corners.append(np.array(corner, dtype=float))
    brick = coal.ConvexBase.convexHull(corners, True, "Qt")
    off = pin.SE3(np.eye(3), np.array([0.0, 0.3, 0.0]))
    solids[0] = Solid("brick", solids[0].joint, off, brick, 0.0)
    motion = straight(["one", "other"], [0.5, -0.3], [1.0, -0.7], 0.5)
    proof = DelayProof(model, motion, solids, [ArmPair(Pair(0, 1, 0.0))], 0.5)
    low, high = proof._boxes[-1]
    step = proof._side / 2**proof._search.levels
    first = -proof._before << proof._search.levels
    for k in range(low.shape[1]):
        for time in np.linspace((first + k) * step, (first + k + 1) * step, 5):
            x = motion.clamped(np.array([time]))[0][0]
            assert (low[0, k] <= [x[0] + 1e-9, 0.3 + 1e-9, 1e-9]).all()
            assert (high[0, k] >= [x[0] + 1.0 - 1e-9, 1.3 - 1e-9, 1.0 - 1e-9]).all()
            assert (low[1, k] <= np.array([x[1], 0.0, 0.0]) - RADIUS + 1e-9).all()
            assert (high[1, k] >= np.array([x[1], 0.0, 0.0]) + RADIUS - 1e-9).all()


def test_a_figure_that_is_asked_for_is_decided():
    """40 ms are clear and 40.4 ms are not: a bracket that ends at half a millisecond would leave both open."""
    model, solids = slides()
    motion = straight(["one", "other"], [2.0 * RADIUS + 0.0402, 0.0], [1.0, 1.0], 0.3)
    proof = DelayProof(model, motion, solids, [ArmPair(Pair(0, 1, 0.0))], 0.5)
    assert proof.bracket(0, [0.04]).proven >= 0.04
    assert proof.bracket(0, [0.0404]).broken <= 0.0404


def test_the_last_motion_of_a_late_arm_counts_while_the_other_one_rests():
    """The leader leaves the other's way in the last 0.1 s: where it is late it still does so after the plan's end."""
    model, solids = slides()
    # Both stand until 0.9 s, then the leader goes 0.3 m and the follower to where the leader was, 0.2 m off.
    time = np.array([0.0, 0.9, 0.9, 1.0])
    position = np.array([[0.0, -0.2], [0.0, -0.2], [0.0, -0.2], [0.3, 0.0]])
    velocity = np.array([[0.0, 0.0], [0.0, 0.0], [3.0, 2.0], [3.0, 2.0]])
    motion = Trajectory(("one", "other"), time, position, velocity, np.zeros((4, 2)))
    leader, follower = both(DelayProof(model, motion, solids, [ArmPair(Pair(0, 1, 0.0))], 0.5))
    # The follower touches the standing leader after 0.1 m, 0.05 s after it left.
    assert leader.proven <= 0.05 <= leader.broken + 1e-6
    assert leader.broken - leader.proven <= 1e-3
    assert leader.broken + 0.9 - 1e-3 <= leader.time <= 1.0 + leader.broken
    assert follower.proven == 0.5


def test_what_is_not_there_and_what_may_touch_does_not_count():
    """The leader's ball is taken off at 1.5 s by its own clock, or both may touch from then on by either clock."""
    model, solids = slides()
    start, rates = [2.0 * RADIUS + 0.4, 0.0], [1.0, 1.2]
    motion = straight(["one", "other"], start, rates, 3.0)

    def broken(**pair):
        return DelayProof(model, motion, solids, [ArmPair(Pair(0, 1, 0.0), **pair)], 0.5).bracket(0)

    # The follower gains 0.2 m/s: 0.4 - 0.2 t is left at t, and a delay of d takes d * 1 m/s of it.
    assert broken().broken < 1e-3
    # At the latest 1.5 s + d: 0.4 - 0.2 (1.5 + d) - d = 0.
    gone = broken(there=(((-np.inf, 1.5),), ALWAYS))
    exact = (0.4 - 0.2 * 1.5) / 1.2
    assert gone.proven <= exact <= gone.broken + 1e-6
    assert gone.broken - gone.proven <= 2e-3
    # By the follower's clock, or by either one: 0.4 - 0.2 * 1.5 - d = 0.
    for pair in ({"there": (ALWAYS, ((0.0, 1.5),))}, {"excused": ((1.5, 9.0),)}):
        gone = broken(**pair)
        assert gone.proven <= 0.1 <= gone.broken + 1e-6
        assert gone.broken - gone.proven <= 2e-3


def test_squares_that_are_not_looked_at_are_not_proven():
    """With few distances what is proven is less, and never too much."""
    model, solids = slides()
    motion = straight(["one", "other"], [2.0 * RADIUS + 0.05, 0.0], [1.0, 1.0], 3.0)
    few = DelaySearch(distances=50)
    found = DelayProof(model, motion, solids, [ArmPair(Pair(0, 1, 0.0))], 0.5, few).bracket(0)
    assert found.proven < 0.049


def test_an_arm_that_rests_all_the_time_makes_no_delay_matter():
    """It is where it is; also where both are nearer than required, which is for the proof of clearance to find."""
    model, solids = slides()
    motion = straight(["one", "other"], [0.2, 0.0], [1.0, 0.0], 1.0)
    found = both(DelayProof(model, motion, solids, [ArmPair(Pair(0, 1, 0.3))], 0.5))
    assert [one.proven for one in found] == [0.5, 0.5]


@pytest.mark.parametrize("late", [0, 1])
def test_what_a_resting_arm_holds_from_some_time_on_comes_or_stays_late(late):
    """A ball at rest is there from 0.5 s on, by its own clock; the other one passes it until 0.4 s, 0.1 s before.

    Where the passing arm is late it meets the ball after 0.1 s; where the other one is, the ball comes later still.
    """
    model, solids = slides()
    # From x = -1 at 2.5 m/s: both balls overlap from (1 - 2 RADIUS) / 2.5 s to (1 + 2 RADIUS) / 2.5 s = 0.44 s.
    motion = straight(["one", "other"], [-1.0, 0.0], [2.5, 0.0], 1.0)
    pair = ArmPair(Pair(0, 1, 0.0), (ALWAYS, ((0.5, np.inf),)))
    found = DelayProof(model, motion, solids, [pair], 0.2).bracket(late)
    exact = 0.5 - (1.0 + 2.0 * RADIUS) / 2.5
    if late == 0:
        assert found.proven <= exact <= found.broken + 1e-6
        assert found.broken - found.proven <= 1e-3
    else:
        assert found.proven == 0.2


def test_a_distance_that_is_no_number_proves_nothing(monkeypatch):
    model, solids = slides()
    motion = straight(["one", "other"], [2.0 * RADIUS + 0.05, 0.0], [1.0, 1.0], 0.3)
    monkeypatch.setattr(coal, "distance", lambda *_: np.nan)
    search = DelaySearch(distances=5_000)
    found = DelayProof(model, motion, solids, [ArmPair(Pair(0, 1, 0.0))], 0.5, search).bracket(0)
    assert found.proven < 0.05


def arms(random):
    """Two arms of three turning joints in random directions, with a capsule, a box and a ball each."""
    model, solids = pin.Model(), []
    for name, side in (("one", 0.35), ("other", -0.35)):
        joint = 0
        for k in range(3):
            axis = random.normal(size=3)
            place = pin.SE3(np.eye(3), np.array([0.0, side, 0.0] if k == 0 else [0.3, 0.0, 0.0]))
            turning = pin.JointModelRevoluteUnaligned(axis / np.linalg.norm(axis))
            joint = model.addJoint(joint, turning, place, f"{name}{k}")
            form = (coal.Capsule(0.05, 0.2), coal.Box(0.25, 0.08, 0.05), coal.Sphere(0.07))[k]
            pose = pin.SE3(pin.utils.rotate("y", np.pi / 2), np.array([0.15, 0.0, 0.0]))
            solids.append(Solid(f"{name}{k}", joint, pose, form, 0.35))
    return model, solids


def wavy(model, random):
    """A motion of all joints through random positions, from rest to rest in each stretch."""
    count, knots = model.nq, random.uniform(-0.9, 0.9, (5, model.nq))
    time, rows = [0.0], [(knots[0], np.zeros(count), np.zeros(count))]
    for start, end in pairwise(knots):
        length = random.uniform(0.4, 0.9)
        jerk, h = 32.0 * (end - start) / length**3, length / 4.0
        for sign in (1.0, -1.0, -1.0, 1.0):
            q, v, a = rows[-1]
            j = sign * jerk
            rows.append(
                (q + h * v + h**2 / 2 * a + h**3 / 6 * j, v + h * a + h**2 / 2 * j, a + h * j)
            )
            time.append(time[-1] + h)
    q, v, a = (np.array(column) for column in zip(*rows, strict=True))
    return Trajectory(tuple(model.names[1:]), np.array(time), q, v, a)


@pytest.mark.parametrize("seed", range(6))
def test_random_arms_agree_with_dense_samples(seed):
    """No sample within what is proven lacks clearance; the delay that is said to lack it does so, where it is said."""
    random = np.random.default_rng(seed)
    model, solids = arms(random)
    motion = wavy(model, random)
    pairs = [ArmPair(Pair(i, j, 0.01)) for i in range(3) for j in range(3, 6)]
    data = model.createData()
    geometry = geometry_model(solids, [(one.pair.first, one.pair.second) for one in pairs])
    distances = pin.GeometryData(geometry)

    def margin(times, late, delay):
        """Least margin at some times with one arm late."""
        q, own = motion.clamped(times)[0], slice(3 * late, 3 * late + 3)
        q[:, own] = motion.clamped(times - delay)[0][:, own]
        least = np.inf
        for row in q:
            pin.computeDistances(model, data, geometry, distances, row)
            least = min(least, *(one.min_distance for one in distances.distanceResults))
        return least - 0.01

    # As planned they must be clear: the required distance is lowered to what there is.
    times = np.arange(0.0, motion.duration + 0.5, 0.01)
    nominal = margin(times, 0, 0.0)
    spare = min(0.0, nominal) - 0.01
    pairs = [ArmPair(Pair(one.pair.first, one.pair.second, 0.01 + spare)) for one in pairs]
    for late, found in enumerate(both(DelayProof(model, motion, solids, pairs, 0.5))):
        for delay in np.linspace(0.0, found.proven, 5):
            assert margin(times, late, delay) >= spare - 1e-6
        if np.isfinite(found.broken):
            assert margin(np.array([found.time]), late, found.broken) < spare
            assert found.broken - found.proven <= max(1e-3, 0.02 * found.broken)
