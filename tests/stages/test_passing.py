"""Plans polished for motion through lines' outer ends: estimates against exact motions, and what it gains."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dualarm_cli import effort
from dualarm_cli.background import allow_workers
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.postures.stop_lines import line_path
from dualarm_cli.stages.plans import launches as plan_launches
from dualarm_cli.stages.plans.launches import best_launches, default_launches, with_best_launches
from dualarm_cli.stages.plans.passing import outwards, passed, timed_slopes, transfer_times
from dualarm_cli.stages.plans.source import postures
from dualarm_cli.stages.plans.times import TransferChain, evaluate
from dualarm_cli.stages.search.corridor import Pool, stage_costs
from dualarm_cli.stages.search.search import search
from dualarm_cli.stages.search.stretches import stretch_of
from dualarm_cli.stages.search.variables import Variables
from dualarm_cli.stages.sequence import stage_plans
from dualarm_cli.stages.sequence_problem import sequence_problem
from dualarm_cli.timing.launch import CUTS, PROFILES, launches, solve_launch
from dualarm_cli.timing.line_ends import Passings, quickest_pair
from dualarm_cli.timing.problem import LineProblem, TransferProblem
from dualarm_cli.timing.ruckig_ import MovingTransfer


@pytest.fixture(scope="module", params=[1, 2])
def sequence(request, random_job):
    """A job with lines, its problem with the same way for all lines' ends, its stops, and a plan from rest to rest."""
    job = random_job(request.param, (5, 4), line=0.08, dwell=0.1)
    problem = sequence_problem(CellModel.from_cell(job.cell), job)
    plan = search(problem, [], "normal", 0).best
    return job, replace(problem, launches=default_launches(problem)), plan


def test_estimated_lines_are_near_exact_ones(sequence):
    """Time and state of motion at the outer end, from four samples, against the timed spline along 65 exact ones.

    Lines that bend so sharply that four samples do not show it are left out: at most four of sixteen.
    """
    job, problem, plan = sequence
    model = CellModel.from_cell(job.cell)
    stages = stage_plans(model, job, problem, plan.decisions, "sequence")
    wrong: list[float] = []
    for a, work in enumerate(problem.arms):
        found = evaluate(problem, plan.decisions).arms[a]
        for k in range(problem.stages):
            for line, name in enumerate(("approach", "retract")):
                number = int(problem.launches[a][k, line])
                if not number:
                    assert not found.rates[k, line].any()
                    continue
                stop = stages[k].stops[work.name]
                q, length = line_path(stop.problem, stop.posture, name, 65)
                path = q if line else q[::-1]
                seen = outwards(found.take(np.array([k])), line)[0]
                if np.abs(seen - path[:: 64 // (len(seen) - 1)]).max() > 1e-4:
                    continue
                asked = LineProblem(work.limits.joints, path, length, work.limits)
                exact = solve_launch(asked, launches(asked).launches[number - 1])
                rest = (found.retract if line else found.approach)[k].max()
                wrong.append(abs(found.shares[k, line] * rest / exact.duration - 1.0))
                sign = 1.0 if line else -1.0
                scale = np.abs(exact.velocity[-1]).max()
                np.testing.assert_allclose(
                    found.rates[k, line, 0], sign * exact.velocity[-1], atol=0.06 * scale
                )
    assert len(wrong) >= 12 and max(wrong) < 0.03


def test_a_way_is_estimated_as_in_its_family(sequence):
    """One launch of each of many lines, against all launches of each line."""
    _, problem, plan = sequence
    random = np.random.default_rng(0)
    for work, found in zip(problem.arms, plan.arms, strict=True):
        rows = [k for k, stop in enumerate(work.stops) if stop is not None]
        at_rest = found.take(np.array(rows).repeat(20))
        chosen = random.integers(0, 1 + len(PROFILES) * len(CUTS), (len(at_rest.work), 2))
        moving = passed(work, chosen, at_rest)
        for line, whole in ((0, at_rest.approach.max(axis=1)), (1, at_rest.retract.max(axis=1))):
            for k, path in enumerate(outwards(at_rest, line)):
                share = np.linspace(0.0, 1.0, len(path))
                asked = LineProblem(work.limits.joints, path, share, work.limits)
                family = Passings.along(asked, float(whole[k]), away=line == 1)
                way = chosen[k, line]
                assert moving.shares[k, line] * whole[k] == pytest.approx(
                    family.time[way], rel=1e-12
                )
                np.testing.assert_array_equal(moving.rates[k, line], family.rates[way])
        rest = np.stack([at_rest.approach.max(axis=1), at_rest.retract.max(axis=1)], axis=1)
        spent = (moving.shares - 1.0) * rest
        np.testing.assert_allclose(moving.work, at_rest.work + spent.sum(axis=1), rtol=1e-12)


def test_work_is_dwell_and_both_lines_as_they_are_passed(sequence):
    """By hand from what it is made of; from rest to rest without launches."""
    _, problem, plan = sequence
    for chosen in (problem.launches, None):
        asked = replace(problem, launches=chosen)
        for a, work in enumerate(problem.arms):
            found = evaluate(asked, plan.decisions).arms[a]
            for k, stop in enumerate(work.stops):
                if stop is None:
                    continue
                lines = found.approach[k].max(), found.retract[k].max()
                assert found.work[k] == pytest.approx(stop.dwell + lines @ found.shares[k])
                assert chosen is not None or (found.shares[k] == 1.0).all()


def test_ends_beside_which_an_arm_does_not_move_on_are_at_rest(random_job):
    """Behind an arm's last stop; at a free start; in hand-overs, which a sequence can have anywhere."""
    job = random_job(3, (4, 2), line=0.05, start="free")
    problem = sequence_problem(CellModel.from_cell(job.cell), job)
    left, right = (chosen > 0 for chosen in default_launches(problem))
    np.testing.assert_array_equal(left, [[False, True], [True, True], [True, True], [True, False]])
    np.testing.assert_array_equal(right, [[False, True], [True, False], [False] * 2, [False] * 2])
    handing = replace(problem, handing=(False, True, False, False))
    left, _ = (chosen > 0 for chosen in default_launches(handing))
    np.testing.assert_array_equal(left[:, 0], [False, False, True, True])
    np.testing.assert_array_equal(left[:, 1], [True, False, True, False])
    part = stretch_of(replace(problem, launches=default_launches(problem)), 1, 3)
    assert [len(chosen) for chosen in part.launches] == [2, 2]


def test_transfers_take_what_ruckig_needs_between_their_states(sequence):
    """Every pair of postures on its own; from rest to rest the closed form."""
    _, problem, plan = sequence
    moving = evaluate(problem, plan.decisions)
    work, found = problem.arms[0], moving.arms[0]
    q, rates = found.q_retract[:3, None], found.rates[:3, None, 1]
    goal, arriving = found.q_approach[1:4, None], found.rates[1:4, None, 0]
    time = transfer_times(work, (q, rates), (goal, arriving))
    assert time.shape == (3, 1, 1)
    free = replace(work.limits, lower=np.full(7, -np.inf), upper=np.full(7, np.inf))
    for k in range(3):
        asked = TransferProblem(free.joints, q[k, 0], goal[k, 0], free)
        exact = MovingTransfer(asked).duration(rates[k, 0], arriving[k, 0])
        assert time[k, 0, 0] == pytest.approx(exact, rel=1e-12)
    rest = transfer_times(work, (q, 0 * rates), (goal, 0 * arriving))
    np.testing.assert_array_equal(rest[:, 0, 0], work.law.duration(goal[:, 0] - q[:, 0]))


def test_slopes_of_transfers_are_those_of_the_slowest_joint(sequence):
    """Finite differences of the whole transfer's time, where one joint alone decides it."""
    _, problem, plan = sequence
    moving = evaluate(problem, plan.decisions)
    work, found = problem.arms[0], moving.arms[0]
    leaving = found.q_retract[:3], found.rates[:3, 1]
    goal, arriving = found.q_approach[1:4], found.rates[1:4, 0]
    nothing = np.zeros((3, 7)), np.zeros((3, 7))
    time, slopes = timed_slopes(work, leaving, (goal, arriving), nothing, by_rates=True)
    whole = transfer_times(
        work, tuple(x[:, None] for x in leaving), (goal[:, None], arriving[:, None])
    )
    np.testing.assert_allclose(time.max(axis=1), whole[:, 0, 0], rtol=1e-9)
    checked = 0
    for k in range(3):
        slowest, second = np.argsort(time[k])[[-1, -2]]
        if time[k, slowest] - time[k, second] < 1e-3:
            continue
        moved = 1e-5 * np.eye(7)[slowest]
        rows = [x[k : k + 1, None].copy() for x in (*leaving, goal, arriving)]
        entries = [(2, ()), (1, 0), (1, 1), (3, 0), (3, 1)]
        for slope, (which, row) in zip(slopes[k], entries, strict=True):
            ends = []
            for side in (1.0, -1.0):
                q, rates, q_goal, rates_there = (x.copy() for x in rows)
                (q, rates, q_goal, rates_there)[which][0, 0][row] += side * moved
                times = transfer_times(work, (q, rates), (q_goal, rates_there))
                ends.append(times[0, 0, 0])
            expected = (ends[0] - ends[1]) / 2e-5
            assert slope[slowest] == pytest.approx(expected, rel=1e-3, abs=1e-6)
        checked += 1
    assert checked


def test_stage_costs_of_a_plan_are_its_stages(sequence):
    """A pool's costs along each of its plans, with tools in motion, are what that plan is evaluated to."""
    _, problem, plan = sequence
    best = evaluate(problem, plan.decisions)
    variables = Variables.of(problem)
    random = np.random.default_rng(0)
    moved = [
        variables.moved(plan.decisions, random.normal(scale=0.01, size=variables.count))
        for _ in range(2)
    ]
    pool = Pool.of(problem, best, moved)
    cost = stage_costs(problem, best, pool.arms, pool.angle)
    for m, decisions in enumerate([plan.decisions, *moved]):
        own = evaluate(problem, decisions).stages
        np.testing.assert_allclose(cost[1:, m, m], own[1:], rtol=1e-12)


def test_stages_within_a_stretch_take_as_long_as_in_the_whole(sequence):
    """All but the first one, into which the stage before it is left in motion."""
    _, problem, plan = sequence
    moving = replace(problem, launches=best_launches(problem, plan))
    whole = evaluate(moving, plan.decisions)
    for first in (0, 1, 2):
        part = stretch_of(moving, first, problem.stages, whole)
        alone = evaluate(part, plan.decisions.take(np.arange(first, problem.stages)))
        if first == 0:
            assert alone.stages[0] == pytest.approx(whole.stages[0])
        np.testing.assert_allclose(alone.stages[1:], whole.stages[first + 1 :], rtol=1e-12)


def test_best_launches_are_the_same_with_a_second_process(sequence):
    """Which has half of the transfers."""
    _, problem, plan = sequence
    alone = best_launches(problem, plan)
    settings = replace(problem.settings, shared_transfers=2)
    with allow_workers(True):
        shared = best_launches(replace(problem, settings=settings), plan)
    for one, other in zip(alone, shared, strict=True):
        np.testing.assert_array_equal(one, other)


def test_best_launches_begin_with_given_ones(sequence, monkeypatch):
    """Those of the retract before and of the approach; none where none are given."""
    _, problem, plan = sequence
    begun = []

    def recorded(*given, start):
        begun.append(start)
        return quickest_pair(*given, start=start)

    monkeypatch.setattr(plan_launches, "quickest_pair", recorded)
    near = tuple(
        100 * a + np.arange(2 * problem.stages).reshape(-1, 2) for a in range(len(problem.arms))
    )
    best_launches(problem, plan, near)
    active = [
        (a, int(k)) for a, work in enumerate(problem.arms) for k in TransferChain.of(work).active
    ]
    assert len(begun) == len(active) > 2
    for (a, k), start in zip(active, begun, strict=True):
        assert start[1] == near[a][k, 0]
        if k:
            assert start[0] == near[a][k - 1, 1]
    begun.clear()
    with_best_launches(replace(problem, launches=near), plan)
    assert set(begun) == {None}


@pytest.mark.parametrize("jerk", ["limited", "unlimited"])
def test_best_launches_are_no_slower_than_rest_at_any_transfer(sequence, jerk):
    """A retract, the transfer after it and the approach after that, for each arm alone."""
    job, problem, plan = sequence
    if jerk == "unlimited":
        robot = job.cell.robot
        limits = replace(robot.limits, jerk=np.full(len(robot.joints), np.inf))
        cell = replace(job.cell, robot=replace(robot, limits=limits))
        job = replace(job, cell=cell)
        problem = sequence_problem(CellModel.from_cell(cell), job)
        plan = evaluate(problem, plan.decisions)
        [number] = {int(n) for chosen in default_launches(problem) for n in chosen.ravel() if n}
        assert divmod(number - 1, len(CUTS)) == problem.settings.passing_without_jerk
    chosen = best_launches(problem, plan)
    moving = evaluate(replace(problem, launches=chosen), plan.decisions)
    gained = []
    for a, work in enumerate(problem.arms):
        own, rest = moving.arms[a], plan.arms[a]
        lines = np.stack([rest.approach.max(axis=1), rest.retract.max(axis=1)], axis=1)
        for k in range(1, problem.stages):
            if work.stops[k] is None:
                continue
            leaving = own.q_retract[k - 1][None, None], own.rates[k - 1, 1][None, None]
            arriving = own.q_approach[k][None, None], own.rates[k, 0][None, None]
            transfer = transfer_times(work, leaving, arriving)[0, 0, 0]
            platform = problem.platform_law.duration(np.diff(plan.decisions.angle)[k - 1, None])
            still = float(work.law.duration(own.q_approach[k] - own.q_retract[k - 1]))
            passed = lines[k - 1, 1] * own.shares[k - 1, 1] + lines[k, 0] * own.shares[k, 0]
            stopped = lines[k - 1, 1] + lines[k, 0]
            gained.append(stopped + max(still, platform) - passed - max(transfer, platform))
    assert min(gained) > -1e-9
    assert np.mean(gained) > 0.1


def test_ways_know_the_robots_own_limits_of_position(sequence):
    """Where joints may not leave the range of their postures, fewer lines' ends are passed in motion."""
    _, problem, plan = sequence
    every = [np.concatenate([arm.q_approach, arm.q_retract]) for arm in plan.arms]
    arms = tuple(
        replace(work, robot_limits=replace(work.limits, lower=q.min(axis=0), upper=q.max(axis=0)))
        for work, q in zip(problem.arms, every, strict=True)
    )
    free = sum(int((chosen > 0).sum()) for chosen in best_launches(problem, plan))
    kept = sum(
        int((chosen > 0).sum()) for chosen in best_launches(replace(problem, arms=arms), plan)
    )
    assert kept < free


def test_postures_chosen_for_motion_give_shorter_cycles(random_job, monkeypatch):
    """Random jobs without collision checking, with that polishing and without it: shorter together."""
    jobs = [random_job(seed, (6, 6), line=0.08, dwell=0.1) for seed in (11, 12, 13, 14)]
    settings, quick = PlanSettings(effort="quick"), effort.EFFORTS["quick"]

    def planned(cycles):
        other = replace(quick, search=replace(quick.search, cycles=cycles))
        monkeypatch.setitem(effort.EFFORTS, "quick", other)
        return [plan_without_bound(job, settings, check_collisions=False) for job in jobs]

    with_it, at_rest = planned(quick.search.cycles), planned(0)
    ours, theirs = (sum(one.trajectory.duration for one in plans) for plans in (with_it, at_rest))
    assert ours < 0.997 * theirs


def test_candidates_that_cannot_be_stay_impossible(sequence):
    """Whatever way their lines would be passed."""
    _, problem, plan = sequence
    rows = np.arange(problem.stages)
    far = plan.decisions.arms[0]
    far = replace(far, psi_target=far.psi_target + 2.0)
    found = postures(problem, 0, rows, plan.decisions.angle, far)
    impossible = ~found.possible
    assert impossible.any()
    assert (found.shares[impossible] == 1.0).all()
    assert not found.rates[impossible].any()
