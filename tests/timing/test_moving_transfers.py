"""Transfers between states of motion: least time, limits, exact ends, None instead of something wrong."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import linprog

from dualarm_cli.model.motion.rest_to_rest import RestToRest
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.timing import ruckig_
from dualarm_cli.timing.problem import TransferProblem
from dualarm_cli.timing.ruckig_ import MovingTransfer, StatesToStates, solve_moving_transfer

JOINTS = ("s", "l", "e", "u", "r", "b", "t")


def random_problems(limits, count, seed, most=0.6):
    """Starts, goals and states of motion that velocity and jerk limits allow."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        start, goal = rng.uniform(-1.5, 1.5, (2, 7))
        rates = rng.uniform(-most, most, (2, 2, 7))
        rates[:, 0] *= limits.velocity
        rates[:, 1] *= limits.acceleration
        yield TransferProblem(JOINTS, start, goal, limits, 0.0, *rates)


def wrong_with(problem, motion):
    """Integrates the jerk between knots and says what does not hold."""
    limits = problem.limits
    step = np.diff(motion.time)
    with np.errstate(divide="ignore", invalid="ignore"):
        jerk = np.where(
            step[:, None] > 0, np.diff(motion.acceleration, axis=0) / step[:, None], 0.0
        )
    share = np.linspace(0.0, 1.0, 21)
    q, v, a = (x.copy() for x in (motion.position[0], motion.velocity[0], motion.acceleration[0]))
    leaving, arriving = problem.rates()
    found = []
    if np.abs([q - problem.start, v - leaving[0], a - leaving[1]]).max() > 1e-9:
        found.append("start")
    for dt, j in zip(step, jerk, strict=True):
        t = (share * dt)[:, None]
        at = q + t * (v + t * (a / 2 + t * j / 6))
        speed, strength = v + t * (a + t * j / 2), a + t * j
        if ((at < limits.lower - 1e-9) | (at > limits.upper + 1e-9)).any():
            found.append("position")
        if (np.abs(speed) > limits.velocity * (1 + 1e-9)).any():
            found.append("velocity")
        if (np.abs(strength) > limits.acceleration * (1 + 1e-9)).any():
            found.append("acceleration")
        q, v, a = at[-1], speed[-1], strength[-1]
    steps = (
        np.abs(np.diff(motion.acceleration, axis=0)) > limits.jerk * step[:, None] + 1e-6
    ).any()
    if steps:
        found.append("jerk")
    gap = [q - problem.goal, v - arriving[0], a - arriving[1]]
    if np.abs(gap).max() > 1e-8:
        found.append(f"end {np.abs(gap).max()}")
    return found


def test_random_transfers_in_motion_keep_all_limits_and_end_exactly(limits):
    """1,000 states at random; ruckig's ends up to 1e-8 rad beside the goal are corrected, so hardly any has none."""
    missing = 0
    for problem in random_problems(limits, 1000, 3):
        motion = solve_moving_transfer(problem)
        if motion is None:
            # Where it says none a joint cannot but pass a limit of position, or ruckig fails.
            asked = MovingTransfer(problem)
            found = asked.calculated(*problem.rates())
            missing += found is not None and asked.is_within(found)
            continue
        assert wrong_with(problem, motion) == []
    assert missing <= 1


@pytest.mark.parametrize("jerk", [True, False])
@pytest.mark.parametrize("size", [1e-14, 1e-12, 1e-10, 1e-8, 1e-6])
def test_joints_that_rest_but_for_rounding_change_no_transfer(limits, without_jerk, jerk, size):
    """20 states at random, in which up to three joints stand: their rounding neither refuses nor slows a transfer."""
    rng = np.random.default_rng(5)
    own = limits if jerk else without_jerk
    for problem in random_problems(own, 20, 9):
        rests = rng.choice(7, rng.integers(1, 4), replace=False)
        goal, rates = problem.goal.copy(), np.stack(problem.rates())
        goal[rests], rates[..., rests] = problem.start[rests], 0.0
        exact = solve_moving_transfer(
            TransferProblem(JOINTS, problem.start, goal, own, 0.0, *rates)
        )
        goal[rests] += rng.uniform(-1, 1, len(rests)) * size
        # A line's end has a hundred times larger accelerations.
        rates[..., rests] += rng.uniform(-1, 1, (2, 2, len(rests))) * size * [[1], [100]]
        rounded = TransferProblem(JOINTS, problem.start, goal, own, 0.0, *rates)
        motion = solve_moving_transfer(rounded)
        assert motion is not None
        assert motion.duration == pytest.approx(exact.duration, abs=10 * size)
        if jerk:
            assert wrong_with(rounded, motion) == []


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_joint_at_its_limit_may_rest_there_but_for_rounding(limits, sign):
    """A limit at 0 rad, from which numbers as small as rounding differ, and rates of rounding that lead beyond it."""
    zero = dataclasses.replace(limits, lower=np.zeros(7), upper=np.full(7, 3.2))
    for own in (zero, dataclasses.replace(limits, lower=np.full(7, -3.2), upper=np.zeros(7))):
        away = 1.0 if own is zero else -1.0
        start, goal = np.full(7, 0.5 * away), np.full(7, 1.5 * away)
        start[2] = goal[2] = 0.0
        leaving = np.zeros((2, 7))
        leaving[:, 2] = sign * 1e-14, sign * 1e-12
        problem = TransferProblem(JOINTS, start, goal, own, 0.0, leaving, np.zeros((2, 7)))
        assert np.isfinite(MovingTransfer(problem).duration(*problem.rates()))
        assert solve_moving_transfer(problem) is not None


def least_by_programs(d, v0, a0, v1, a1, v, a, j, steps=80):
    """Least time of one joint: the shortest for which a linear program over constant jerks is feasible."""

    def feasible(T):
        h = T / steps
        lower = np.tril(np.ones((steps, steps)))
        # a_k, v_k, q_k after k + 1 steps are linear in the jerks.
        A = h * lower
        age = np.arange(steps)[:, None] - np.arange(steps)
        V = np.where(age >= 0, h * h * (age + 0.5), 0.0)
        Q = np.where(age >= 0, h**3 * (age * age / 2 + age / 2 + 1 / 6), 0.0)
        t = h * np.arange(1, steps + 1)
        free_v, free_q = v0 + a0 * t, v0 * t + a0 * t * t / 2
        G = np.vstack([A, -A, V, -V])
        b = np.concatenate([np.full(steps, a - a0), np.full(steps, a + a0), v - free_v, v + free_v])
        ends = np.vstack([A[-1], V[-1], Q[-1]])
        want = [a1 - a0, v1 - free_v[-1], d - free_q[-1]]
        scale = np.abs(ends).max(axis=1)
        return linprog(
            np.zeros(steps), G, b, ends / scale[:, None], want / scale, bounds=(-j, j)
        ).success

    low, high = 0.0, 0.1
    while not feasible(high):
        low, high = high, 1.3 * high
        assert high < 20.0
    while high - low > 1e-3 * high:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if feasible(middle) else (middle, high)
    return high


def test_one_joint_takes_the_least_time_that_linear_programs_find():
    """Twelve states at random: constant jerk on a grid of 80 can be no faster and is hardly slower."""
    rng = np.random.default_rng(8)
    for _ in range(12):
        d, (v0, v1), (a0, a1) = rng.uniform(0.2, 1.5), rng.uniform(-1, 2, 2), rng.uniform(-4, 4, 2)
        own = JointLimits(("s",), [-50.0], [50.0], [3.0], [10.0], [100.0], ("assumed",))
        rates = np.array([[v0], [a0]]), np.array([[v1], [a1]])
        motion = solve_moving_transfer(TransferProblem(("s",), [0.0], [d], own, 0.0, *rates))
        assert motion is not None
        least = least_by_programs(d, v0, a0, v1, a1, 3.0, 10.0, 100.0)
        assert motion.duration == pytest.approx(least, rel=1.5e-2)
        assert motion.duration <= least * (1 + 1e-3)


def test_its_jerks_integrated_by_scipy_lead_to_the_goal(limits):
    """An integrator that knows nothing of splines."""
    for problem in random_problems(limits, 3, 5):
        motion = solve_moving_transfer(problem)
        if motion is None:
            continue
        state = np.concatenate([problem.start, *problem.rates()[0]])
        for t0, t1, a0, a1 in zip(
            motion.time[:-1],
            motion.time[1:],
            motion.acceleration[:-1],
            motion.acceleration[1:],
            strict=True,
        ):
            jerk = (a1 - a0) / (t1 - t0)

            def rates(_, x, jerk=jerk):
                return np.concatenate([x[7:], jerk])

            state = solve_ivp(rates, (t0, t1), state, rtol=1e-10, atol=1e-12).y[:, -1]
        expected = np.concatenate([problem.goal, *problem.rates()[1]])
        np.testing.assert_allclose(state, expected, atol=1e-7)


def test_from_rest_to_rest_it_takes_the_closed_form_s_time(limits):
    """And the minimum duration where that is longer."""
    start, goal = np.zeros(7), np.linspace(-1, 1, 7)
    rest = np.zeros((2, 7))
    expected = float(
        RestToRest(limits.velocity, limits.acceleration, limits.jerk).duration(goal - start)
    )
    for minimum in (0.0, 2.0):
        problem = TransferProblem(JOINTS, start, goal, limits, minimum, rest, rest)
        motion = solve_moving_transfer(problem)
        assert motion.duration == pytest.approx(max(expected, minimum), rel=1e-9)


def test_a_joint_that_must_pass_its_limit_has_no_transfer():
    """At 2 rad/s it needs 2²/(2 10) = 0.2 rad at least to stop; with 0.1 rad left there is none, with 0.5 there is."""
    rates = np.array([[2.0], [0.0]]), np.zeros((2, 1))
    for upper, possible in ((0.1, False), (0.5, True)):
        own = JointLimits(("s",), [-3.0], [upper], [3.0], [10.0], [1000.0], ("assumed",))
        problem = TransferProblem(("s",), [0.0], [-0.5], own, 0.0, *rates)
        motion = solve_moving_transfer(problem)
        assert (motion is not None) == possible
        assert np.isfinite(MovingTransfer(problem).duration(*rates)) == possible
        if motion is not None:
            assert wrong_with(problem, motion) == []


def test_a_state_beyond_a_limit_has_no_transfer(limits):
    """Twice the velocity limit at the start."""
    leaving = np.zeros((2, 7))
    leaving[0, 0] = 2.0 * limits.velocity[0]
    problem = TransferProblem(
        JOINTS, np.zeros(7), np.ones(7), limits, 0.0, leaving, np.zeros((2, 7))
    )
    assert solve_moving_transfer(problem) is None


def test_without_jerk_limits_accelerations_jump_and_the_ends_are_kept(without_jerk):
    """500 states at random."""
    for problem in random_problems(without_jerk, 500, 4):
        motion = solve_moving_transfer(problem)
        if motion is None:
            continue
        leaving, arriving = problem.rates()
        np.testing.assert_allclose(motion.velocity[0], leaving[0], atol=1e-12)
        np.testing.assert_allclose(motion.velocity[-1], arriving[0], atol=1e-9)
        np.testing.assert_allclose(motion.position[-1], problem.goal, atol=1e-12)
        assert (np.abs(motion.velocity) <= without_jerk.velocity * (1 + 1e-9)).all()
        assert (np.abs(motion.acceleration) <= without_jerk.acceleration * (1 + 1e-9)).all()


def test_what_takes_too_long_is_no_candidate(limits):
    """A time is only given if it is less than asked for."""
    problem = next(iter(random_problems(limits, 1, 3, most=0.2)))
    asked = MovingTransfer(dataclasses.replace(problem, leaving=None, arriving=None))
    taken = asked.duration(*problem.rates())
    assert np.isfinite(taken)
    assert asked.duration(*problem.rates(), taken) == np.inf
    assert asked.duration(*problem.rates(), taken * 1.001) == taken


def test_where_ruckig_fails_there_is_none(limits, monkeypatch):
    """Its binding raises ValueError for result codes that it does not know."""
    import ruckig

    def broken(*_):
        raise ValueError("unknown result")

    problem = next(iter(random_problems(limits, 1, 3)))
    monkeypatch.setattr(ruckig.Ruckig, "calculate", broken)
    assert ruckig_.solve_moving_transfer(problem) is None


def test_transfers_between_many_states_are_those_of_one_transfer(limits):
    """The same durations, whatever was asked before; limits of position do not count."""
    many = StatesToStates(limits)
    for problem in random_problems(limits, 40, 11):
        one = MovingTransfer(problem).calculated(*problem.rates())
        start = [problem.start.tolist(), *problem.leaving.tolist()]
        found = many.calculated(start, [problem.goal.tolist(), *problem.arriving.tolist()])
        assert (found is None) == (one is None)
        if found is not None:
            assert found.duration == one.duration


@pytest.mark.parametrize("room", [0.0, 0.05])
def test_a_transfer_with_room_keeps_away_from_limits_of_position(limits, room):
    """Sampled densely: what is said to be possible leaves that room, up to where it begins and ends."""
    seen = refused = 0
    for problem in random_problems(limits, 300, 4, most=0.15):
        ends = np.stack([problem.start, problem.goal])
        narrow = dataclasses.replace(
            limits, lower=ends.min(axis=0) - 0.06, upper=ends.max(axis=0) + 0.06
        )
        transfer = MovingTransfer(dataclasses.replace(problem, limits=narrow), room)
        duration = transfer.duration(*problem.rates())
        found = transfer.calculated(*problem.rates())
        if found is None:
            continue
        at = np.array([found.at_time(t)[0] for t in np.linspace(0.0, found.duration, 2001)])
        beyond = np.maximum(at - ends.max(axis=0), ends.min(axis=0) - at).max()
        allowed = 0.06 - room
        if np.isfinite(duration):
            assert beyond <= allowed + 1e-6
            seen += 1
        else:
            assert beyond >= allowed - 1e-4
            refused += 1
    assert seen and refused
