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


def passed(work: ArmWork, launches: IntArray, found: CandidatePostures) -> CandidatePostures:
    """Apply launches to candidates, so that their line ends are passed in motion.

    Args:
        work: their arm.
        launches: of approach and retract, shape (n, 2).
        found: the candidates, at rest at both ends of lines.
    """
    rest = np.stack([found.approach.max(axis=1), found.retract.max(axis=1)], axis=1)
    asked = (launches > 0) & found.possible[:, None] & (rest > 0.0)
    paths = np.concatenate([outwards(found, line)[asked[:, line]] for line in (0, 1)])
    way = np.concatenate([launches[asked[:, line], line] for line in (0, 1)]) - 1
    limits = work.limits.velocity, work.limits.acceleration, work.limits.jerk
    _, *estimates = trajectories.launched_lines(
        trajectories.Path.of(paths, limits),
        np.array(PROFILES)[way // len(CUTS), None],
        np.array(CUTS)[way % len(CUTS), None],
        COMPARED,
    )
    time, velocity, acceleration = (x[:, 0] for x in estimates)
    shares, rates = np.ones(rest.shape), np.zeros(found.rates.shape)
    count = int(asked[:, 0].sum())
    for line, part, sign in ((0, slice(0, count), -1.0), (1, slice(count, None), 1.0)):
        rows = asked[:, line]
        shares[rows, line] = time[part] / rest[rows, line]
        rates[rows, line, 0], rates[rows, line, 1] = sign * velocity[part], acceleration[part]
    spent = found.work + ((shares - 1.0) * rest).sum(axis=1)
    return replace(found, work=spent, shares=shares, rates=rates)


_INTERPOLATION = lagrange_basis(np.linspace(0.0, 1.0, 4), np.linspace(0.0, 1.0, 17))
"""Matrix from the four known samples of a line to many, shape (17, 4)."""


def outwards(found: CandidatePostures, line: int) -> FloatArray:
    """Return joints along approaches (0) or retracts (1), target first, (n, 17, joints)."""
    near, far = (1, 0) if line == 0 else (2, 3)
    ends = found.q_retract if line else found.q_approach
    four = np.stack(
        [found.q_target, found.q_between[:, near], found.q_between[:, far], ends], axis=1
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
    for row, one, other in np.argwhere(moving & np.isfinite(time)).tolist():
        found = solver.calculated(starts[row][one], goals[row][other])
        if found is not None:
            time[row, one, other] = found.duration
    return time


def _moving(rates: FloatArray) -> BoolArray:
    moving: BoolArray = np.any(rates, axis=(-2, -1))
    return moving


def _states(q: FloatArray, rates: FloatArray) -> list[list[list[list[float]]]]:
    """Return position, velocity and acceleration of every row's states."""
    found: list[list[list[list[float]]]] = np.concatenate([q[:, :, None], rates], axis=2).tolist()
    return found


def timed_slopes(
    work: ArmWork,
    leaving: tuple[FloatArray, FloatArray],
    arriving: tuple[FloatArray, FloatArray],
    rest: tuple[FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Compute joint times [s] and their slopes by displacement [s/rad], shape (r, joints).

    Args:
        work: the arm.
        leaving: joints [rad], shape (r, joints), and rates, shape (r, 2, joints).
        arriving: the same.
        rest: what is returned of transfers from rest to rest, and where ruckig has none.
    """
    time, slope = (x.copy() for x in rest)
    solver = StatesToStates(work.limits)
    starts, goals = (
        _states(*(x[None] for x in leaving))[0],
        _states(*(x[None] for x in arriving))[0],
    )

    step, steepest = 1e-6, 50.0  # Where launches jump a steeper slope means nothing.

    def alone(k: int, moved: float) -> FloatArray | None:
        position, *rates = goals[k]
        found = solver.calculated(starts[k], [[q + moved for q in position], *rates])
        return None if found is None else np.array(found.independent_min_durations)

    for k in np.flatnonzero(_moving(leaving[1]) | _moving(arriving[1])).tolist():
        here, ahead, behind = (alone(k, moved) for moved in (0.0, step, -step))
        if here is None or ahead is None or behind is None:
            continue
        time[k] = here
        slope[k] = np.clip((ahead - behind) / (2.0 * step), -steepest, steepest)
    return time, slope
