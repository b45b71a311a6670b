"""Estimated times of lines and transfers that pass line ends in motion.

A launch (`plans/launches`) makes a line the first part of one profile, which fixes the motion at its outer end;
the transfer between two such states is ruckig's, its limits of position left out. Our own.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.compiled import trajectories
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.stages.plans.candidates import CandidatePostures
from dualarm_cli.stages.plans.problem import ArmWork
from dualarm_cli.timing.launch import COMPARED, CUTS, PROFILES
from dualarm_cli.timing.ruckig_ import StatesToStates
from dualarm_cli.timing.shapes import lagrange_basis


def passed(work: ArmWork, launches: IntArray, candidates: CandidatePostures) -> CandidatePostures:
    """Apply launches to candidates, so that their line ends are passed in motion.

    Args:
        work: their arm.
        launches: of approach and retract, shape (n, 2).
        candidates: the candidates, at rest at both ends of lines.
    """
    rest = np.stack([candidates.approach.max(axis=1), candidates.retract.max(axis=1)], axis=1)
    passed_ends = (launches > 0) & candidates.possible[:, None] & (rest > 0.0)
    paths = np.concatenate([outwards(candidates, line)[passed_ends[:, line]] for line in (0, 1)])
    launch = np.concatenate([launches[passed_ends[:, line], line] for line in (0, 1)]) - 1
    limits = work.limits.velocity, work.limits.acceleration, work.limits.jerk
    _, *estimates = trajectories.launched_lines(
        trajectories.Path.of(paths, limits),
        np.array(PROFILES)[launch // len(CUTS), None],
        np.array(CUTS)[launch % len(CUTS), None],
        COMPARED,
    )
    time, velocity, acceleration = (x[:, 0] for x in estimates)
    shares, rates = np.ones(rest.shape), np.zeros(candidates.rates.shape)
    count = int(passed_ends[:, 0].sum())
    for line, part, sign in ((0, slice(0, count), -1.0), (1, slice(count, None), 1.0)):
        rows = passed_ends[:, line]
        shares[rows, line] = time[part] / rest[rows, line]
        rates[rows, line, 0], rates[rows, line, 1] = sign * velocity[part], acceleration[part]
    work_times = candidates.work + ((shares - 1.0) * rest).sum(axis=1)
    return replace(candidates, work=work_times, shares=shares, rates=rates)


_INTERPOLATION = lagrange_basis(np.linspace(0.0, 1.0, 4), np.linspace(0.0, 1.0, 17))
"""Matrix from the four known samples of a line to many, shape (17, 4)."""


def outwards(postures: CandidatePostures, line: int) -> FloatArray:
    """Return joints along approaches (0) or retracts (1), target first, (n, 17, joints)."""
    near, far = (1, 0) if line == 0 else (2, 3)
    ends = postures.q_retract if line else postures.q_approach
    four = np.stack(
        [postures.q_target, postures.q_between[:, near], postures.q_between[:, far], ends], axis=1
    )
    joints: FloatArray = np.einsum("sf,nfj->nsj", _INTERPOLATION, four)
    return joints


def transfer_times(
    work: ArmWork,
    leaving: tuple[FloatArray, FloatArray],
    arriving: tuple[FloatArray, FloatArray],
) -> FloatArray:
    """Time transfers between all states of the same row [s], shape (r, p, m).

    As long as from rest to rest where ruckig has none; limits of position do not count.

    Args:
        work: the arm.
        leaving: joints [rad], shape (r, p, joints), and rates, shape (r, p, 2, joints).
        arriving: the same, shapes (r, m, joints) and (r, m, 2, joints).
    """
    time = work.law.duration(arriving[0][:, None] - leaving[0][:, :, None])
    moving = _moving(leaving[1])[:, :, None] | _moving(arriving[1])[:, None]
    solver = StatesToStates(work.limits)
    starts, goals = _states(*leaving), _states(*arriving)
    for row, i, j in np.argwhere(moving & np.isfinite(time)).tolist():
        trajectory = solver.calculated(starts[row][i], goals[row][j])
        if trajectory is not None:
            time[row, i, j] = trajectory.duration
    return time


def _moving(rates: FloatArray) -> BoolArray:
    moving: BoolArray = np.any(rates, axis=(-2, -1))
    return moving


def _states(q: FloatArray, rates: FloatArray) -> list[list[list[list[float]]]]:
    """Return position, velocity and acceleration of every row's states."""
    states: list[list[list[list[float]]]] = np.concatenate([q[:, :, None], rates], axis=2).tolist()
    return states


def timed_slopes(
    work: ArmWork,
    leaving: tuple[FloatArray, FloatArray],
    arriving: tuple[FloatArray, FloatArray],
    rest: tuple[FloatArray, FloatArray],
    *,
    by_rates: bool = False,
) -> tuple[FloatArray, FloatArray]:
    """Compute joint times [s], shape (r, joints), and their slopes, shape (r, s, joints).

    The first slope is by displacement [s/rad]. With `by_rates` those by velocity and acceleration at the start and at
    the end follow, s = 5; they are 0 from rest to rest.

    Args:
        work: the arm.
        leaving: joints [rad], shape (r, joints), and rates, shape (r, 2, joints).
        arriving: the same.
        rest: times and slopes by displacement from rest to rest, and where ruckig has none.
        by_rates: whether slopes by rates are computed, too.
    """
    # Entries of both end states, (start, goal), that are moved; the steepest slopes, beyond which launches jump.
    moved = ((1, 0), (0, 1), (0, 2), (1, 1), (1, 2))[: 5 if by_rates else 1]
    steepest = np.array([50.0, 20.0, 2.0, 20.0, 2.0])[: len(moved), None]
    time = rest[0].copy()
    slope = np.zeros((len(time), len(moved), time.shape[1]))
    slope[:, 0] = rest[1]
    solver, step = StatesToStates(work.limits), 1e-6
    starts, goals = (
        np.concatenate([q[:, None], rates], axis=1) for q, rates in (leaving, arriving)
    )

    def alone(ends: FloatArray) -> FloatArray | None:
        trajectory = solver.calculated(*ends.tolist())
        return None if trajectory is None else np.array(trajectory.independent_min_durations)

    def difference(ends: FloatArray, side: int, row: int) -> FloatArray | None:
        ahead, behind = ends.copy(), ends.copy()
        ahead[side, row] += step
        behind[side, row] -= step
        times = alone(ahead), alone(behind)
        return None if times[0] is None or times[1] is None else times[0] - times[1]

    for k in np.flatnonzero(_moving(leaving[1]) | _moving(arriving[1])).tolist():
        ends = np.stack([starts[k], goals[k]])
        here = alone(ends)
        differences = [difference(ends, *entry) for entry in moved]
        changes = [change for change in differences if change is not None]
        if here is not None and len(changes) == len(moved):
            time[k] = here
            slope[k] = np.clip(np.array(changes) / (2.0 * step), -steepest, steepest)
    return time, slope
