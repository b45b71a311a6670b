"""Joints that turn back between a transfer and an approach: laws by linear programs, cells by samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linprog

from dualarm_cli.bound.cells import LineToTarget, pose_cells
from dualarm_cli.bound.job_bound import job_bound
from dualarm_cli.effort import Resolution
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.platform_chain import rotation_z
from dualarm_cli.model.motion.rest_to_rest import PassingLaw, RestToRest
from dualarm_cli.stages.plans.launches import default_launches, with_best_launches
from dualarm_cli.stages.plans.times import evaluate
from dualarm_cli.stages.search.search import search
from dualarm_cli.stages.search.variables import Variables
from dualarm_cli.stages.sequence_problem import sequence_problem
from dualarm_cli.timing.transfer_table import Pairs, PostureBoxes, TransferTable
from tests.posture_cells_numpy import within_reach

STEPS = 100
"""Steps of constant jerk of a linear program."""


def farthest(
    duration: float, limits: tuple[float, float, float], begin: tuple[float, float] | None
) -> float:
    """Greatest distance of a joint that ends at speed zero, with any acceleration [rad], by a linear program.

    Args:
        duration: time [s].
        limits: speed [rad/s], acceleration [rad/s²] and jerk [rad/s³].
        begin: speed and acceleration at first; None for any.
    """
    h, n = duration / STEPS, STEPS
    # Unknown are the jerks, the first speed and the first acceleration; a, v and x at the ends of all steps.
    a = np.hstack([h * np.tril(np.ones((n, n))), np.zeros((n, 1)), np.ones((n, 1))])
    before = np.vstack([np.zeros(n + 2), a[:-1]])
    before[0, n + 1] = 1.0
    jerks = np.hstack([np.eye(n), np.zeros((n, 2))])
    first = np.zeros((n, n + 2))
    first[:, n] = 1.0
    v = first + np.cumsum(h * before + 0.5 * h**2 * jerks, axis=0)
    v_before = np.vstack([first[0], v[:-1]])
    x = (h * v_before + 0.5 * h**2 * before + h**3 / 6.0 * jerks).sum(axis=0)
    speed, acceleration, jerk = limits
    bounds = [(-jerk, jerk)] * n + [(-speed, speed), (-acceleration, acceleration)]
    if begin is not None:
        bounds[n:] = [(value, value) for value in begin]
    most = linprog(
        -x,
        A_ub=np.vstack([a, -a, v, -v]),
        b_ub=np.repeat([acceleration, acceleration, speed, speed], n),
        A_eq=v[-1:],
        b_eq=[0.0],
        bounds=bounds,
    )
    assert most.status == 0
    return -float(most.fun)


def farthest_between(
    durations: tuple[float, float, float], limits: tuple[float, float, float]
) -> float:
    """Greatest distance in the middle of three times, from rest before the first to rest after the last [rad]."""
    n = STEPS
    h = sum(durations) / n
    a = h * np.tril(np.ones((n, n)))
    v = np.cumsum(h * 0.5 * (a + np.vstack([np.zeros(n), a[:-1]])), axis=0)
    middles = h * (np.arange(n) + 0.5)
    inside = (middles > durations[0]) & (middles < durations[0] + durations[1])
    x = (h * 0.5 * (v + np.vstack([np.zeros(n), v[:-1]])))[inside].sum(axis=0)
    speed, acceleration, jerk = limits
    most = linprog(
        -x,
        A_ub=np.vstack([a, -a, v, -v]),
        b_ub=np.repeat([acceleration, acceleration, speed, speed], n),
        A_eq=np.vstack([a[-1:], v[-1:]]),
        b_eq=[0.0, 0.0],
        bounds=[(-jerk, jerk)] * n,
    )
    assert most.status == 0
    return -float(most.fun)


@pytest.mark.parametrize("jerk", [8.0, 40.0, 2000.0])
@pytest.mark.parametrize("distance", [0.02, 0.2, 1.0])
def test_no_motion_from_a_turn_to_rest_is_faster(jerk, distance):
    """Reversed in time: from rest to speed zero. In that time no motion gets farther, and the best one as far."""
    limits = (2.0, 8.0, jerk)
    law = PassingLaw.of(RestToRest(*(np.array([x]) for x in limits)))
    time = float(law.from_turn(np.array([[distance]]))[0, 0])
    most = farthest(time, limits, (0.0, 0.0))
    assert 0.985 * distance <= most <= distance * (1.0 + 1e-3)
    assert time <= float(law.rest_law.per_joint(np.array([distance]))[0])


@pytest.mark.parametrize("way", [0.05, 0.24, 0.9])
def test_no_motion_comes_to_a_turn_faster(way):
    """From any motion: constant deceleration from 2 rad/s takes 0.25 s and 0.25 rad, the rest is at full speed.

    Between turns it takes as long as both halves.
    """
    limits = (2.0, 8.0, 300.0)
    law = PassingLaw.of(RestToRest(*(np.array([x]) for x in limits)))
    to_turn, at_rest, to_any, from_turn, between = law.chain_times(np.array([[way]]))[:, 0, 0]
    time = way / 2.0 + 0.125 if way > 0.25 else float(np.sqrt(2.0 * way / 8.0))
    assert from_turn == pytest.approx(time)
    assert 0.985 * way <= farthest(time, limits, None) <= way * (1.0 + 1e-3)
    halves = law.chain_times(np.array([[0.5 * way]]))[3, 0, 0]
    assert between == pytest.approx(2.0 * halves)
    assert to_turn <= at_rest
    assert from_turn <= between
    # With jerk limits from rest: between none and full deceleration at the end.
    assert from_turn <= to_any + 1e-3 <= to_turn + 1e-3
    reached = law.reachable_distance(np.array([to_any]))[0]
    assert 0.999 * way <= reached <= way * (1.0 + 1e-9)
    assert (law.chain_times(np.zeros((1, 1))) == 0.0).all()


def transfer_bounds(
    limits: tuple[float, float, float], distance: float, lines: tuple[float, float]
) -> tuple[float, float]:
    """Bounds of a joint's transfer after a retract and before an approach of given least times [s].

    After this retract, and after any motion.
    """
    law = PassingLaw.of(RestToRest(*(np.array([x]) for x in limits)))
    table = TransferTable.of([law], np.array([-3.0]), np.array([3.0]))
    zero, none = np.zeros(1, dtype=np.int64), np.zeros(1, dtype=np.float32)

    def ends(q: float, line: float) -> PostureBoxes:
        box = table.box(np.array([[q]]), np.array([[q]]))
        unknown = np.full((2, 1, 1), -1, dtype=np.int16)
        return PostureBoxes(zero, zero, *box, np.array([line], dtype=np.float32), unknown, 0.2)

    pairs = Pairs(table, ends(-0.5 * distance, lines[0]), ends(0.5 * distance, lines[1]), ())
    after_retract, after_any = pairs.least_from(none, none, none[:, None], none)
    return float(after_retract[0]), float(after_any[0])


@pytest.mark.parametrize("lines", [(0.2, 0.25), (0.05, 0.3), (0.0, 0.0), (0.6, 0.12)])
@pytest.mark.parametrize("distance", [0.03, 0.4, 1.2])
def test_joints_transfer_no_faster_than_speeds_at_line_ends_allow(distance, lines):
    """One joint from rest to rest over both lines, by a linear program; retracts that take longer do not help."""
    limits = (2.0, 8.0, 80.0)
    after_retract, after_any = transfer_bounds(limits, distance, lines)
    assert distance / limits[0] - 3e-4 <= after_any  # two steps of the table
    assert after_any <= after_retract
    whole = lines[0] + after_retract + lines[1]
    for retract in (lines[0], lines[0] + 0.05, lines[0] + 0.3):
        window = whole - retract - lines[1]
        if window > 0.0:
            most = farthest_between((retract, window, lines[1]), limits)
            assert most <= distance * (1.0 + 2e-3) + 1e-3


def test_times_between_speeds_are_those_of_the_fastest_profile():
    """Speeds grow and fall by the acceleration limit; without jerk limits speeds after lines are a T."""
    speed, acceleration = 2.0, 8.0
    random = np.random.default_rng(3)
    for distance in random.uniform(0.01, 1.5, 20):
        lines = random.uniform(0.0, 0.3, 2)
        found = transfer_bounds((speed, acceleration, np.inf), float(distance), tuple(lines))
        begin, end = np.minimum(speed, acceleration * lines)
        for time, first in zip(found, (begin, speed), strict=True):
            t = np.linspace(0.0, time, 20_001)
            profile = np.minimum(first + acceleration * t, end + acceleration * (time - t))
            area = np.minimum(profile, speed).mean() * time
            assert area == pytest.approx(distance, abs=1e-3)


@pytest.mark.parametrize("late", [0.02, 0.2])
def test_turns_hold_for_all_lines_that_are_not_late(random_problem, late):
    """SDA10F: random postures, all arm angles and branches at the target. Each joint moves as far as its cell says."""
    random, told = np.random.default_rng(11), 0
    work = random_problem(1, (1, 1)).arms[0]
    arm, law = work.closed_form, PassingLaw.of(work.law)
    resolution = Resolution(np.radians(12.0), 24, 2, late)
    edges = np.linspace(-2.9, 2.9, 30)
    around = np.linspace(-np.pi, np.pi, 360, endpoint=False)
    for _ in range(6):
        q = random.uniform(0.7 * arm.lower, 0.7 * arm.upper)
        R, p = arm.forward(q)
        end = p + 0.08 * R[:, 2]
        to = LineToTarget(end, law, lambda block: np.zeros(len(block.index)))
        cells = pose_cells(
            arm, (R, p), within_reach(arm, R, p, edges, resolution), resolution, False, to
        )
        phi = np.append(0.0, random.uniform(-2.9, 2.9, 40))
        turn, psi = rotation_z(-phi), np.append(arm.arm_angle(q), random.uniform(-3.0, 3.0, 40))
        outer = arm.solve(turn @ R, turn @ p, psi)
        ends = arm.solve((turn @ R)[:, None], (turn @ end)[:, None], around)
        joints = arm.nearest_turns(outer.q, np.zeros(7))
        some = outer.reachable & ends.reachable[:, 0]
        for i, branch in zip(*np.nonzero(some[:, None] & arm.within_limits(joints)), strict=True):
            point = np.append(joints[i, branch], phi[i])
            inside = ((point >= cells.low - 1e-9) & (point <= cells.high + 1e-9)).all(axis=1)
            moved = ends.q[i].reshape(-1, 7) - joints[i, branch]
            moved -= 2.0 * np.pi * np.round(moved / (2.0 * np.pi))
            step, reach = law.reach_table
            times = step * np.max(
                [np.searchsorted(row, np.abs(x)) for row, x in zip(reach, moved.T, strict=True)],
                axis=0,
            )
            for cell in np.flatnonzero(inside):
                lines = moved[times < cells.line[cell] + late - 2.0 * step]
                for k, ways in enumerate((lines, -lines)):
                    least = cells.displacement[cell, k]
                    assert ((least == -1.0) | (least <= ways + 1e-9)).all()
                    told += int((least > 0.0).sum()) * bool(len(lines))
    assert told > 100


@pytest.mark.parametrize("blend", ["none", "lines"])
@pytest.mark.parametrize("seed", [1, 2])
def test_no_perturbed_plan_is_faster_than_the_bound(random_job, seed, blend):
    """Plans of eight stages about the best, angles moved at random, a little or a lot: with stops and in motion."""
    job = random_job(seed, (8, 8), line=0.08, dwell=0.15)
    random = np.random.default_rng(seed)
    problem = sequence_problem(CellModel.from_cell(job.cell), job)
    bound = job_bound(job, "normal", blend).value
    found = search(problem, [], "quick", seed)
    assert found is not None and bound is not None
    moving = problem
    if blend == "lines":
        moving = replace(problem, launches=default_launches(problem))
        quickest = with_best_launches(moving, found.best)[1].total
        assert bound <= quickest < found.best.total
    variables = Variables.of(problem)
    possible = 0
    for _ in range(60):
        step = 10.0 ** random.uniform(-3.0, -1.0) * random.normal(size=variables.count)
        plan = evaluate(moving, variables.moved(found.best.decisions, step))
        assert bound <= plan.total
        possible += np.isfinite(plan.total)
    assert possible > 10
