"""Plans whose tools pass the outer ends of lines in motion, all in one way: an estimate that postures are chosen by.

Which way is best at a transfer depends on the postures beside it (`motion/blending` looks for it when they are chosen).
Here every line is the first part of one profile, a middling one, which fixes the state of motion at its outer end; the
transfer between two such states is ruckig's, its limits of position left out. At rest remain ends beside which the arm
does not move on, hand-overs, and the return. Our own.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.compiled import trajectories
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.stages.plans.candidates import CandidatePostures
from dualarm_cli.stages.plans.problem import ArmWork, SequenceProblem
from dualarm_cli.timing.launch import CUTS, PROFILES
from dualarm_cli.timing.ruckig_ import StatesToStates
from dualarm_cli.timing.shapes import lagrange_basis

WAY = 0, 6
"""A profile and a cut, as indices, by which all lines are passed under jerk limits."""
EVEN = 8, 6
"""Those without."""
SAMPLES = 17
"""Samples of a line, interpolated from the four that are known."""
STEP = 1e-6
"""Step of the differences that give a transfer time's slopes [rad]."""
STEEPEST = 50.0
"""Most that a slope of a transfer time counts [s/rad]: where ways jump it means nothing."""


def passed(
    problem: SequenceProblem, arm: int, stage: IntArray, found: CandidatePostures
) -> CandidatePostures:
    """Returns candidates with their lines' outer ends passed in motion, wherever the arm moves on there.

    Args:
        problem: the sequence.
        arm: index of the arm.
        stage: stage of each candidate, shape (n,).
        found: the candidates, at rest at both ends of lines.
    """
    work = problem.arms[arm]
    asked = _passes(problem, work)[stage] & found.possible[:, None]
    rest = np.stack([found.approach.max(axis=1), found.retract.max(axis=1)], axis=1)
    asked &= rest > 0.0
    between, target = found.q_between, found.q_target
    outwards = (
        np.stack([target, between[:, 1], between[:, 0], found.q_approach], axis=1),
        np.stack([target, between[:, 2], between[:, 3], found.q_retract], axis=1),
    )
    four = np.concatenate([q[asked[:, line]] for line, q in enumerate(outwards)])
    profile, cut = WAY if np.isfinite(work.limits.jerk).all() else EVEN
    time, velocity, acceleration = trajectories.launched_lines(
        np.einsum("sf,nfj->nsj", _INTERPOLATION, four),
        (work.limits.velocity, work.limits.acceleration, work.limits.jerk),
        np.array(PROFILES[profile]),
        CUTS[cut],
    )
    shares, rates = np.ones(rest.shape), np.zeros(found.rates.shape)
    count = int(asked[:, 0].sum())
    for line, part, sign in ((0, slice(0, count), -1.0), (1, slice(count, None), 1.0)):
        rows = asked[:, line]
        shares[rows, line] = time[part] / rest[rows, line]
        rates[rows, line, 0], rates[rows, line, 1] = sign * velocity[part], acceleration[part]
    spent = found.work + ((shares - 1.0) * rest).sum(axis=1)
    return replace(found, work=spent, shares=shares, rates=rates)


_INTERPOLATION = lagrange_basis(np.linspace(0.0, 1.0, 4), np.linspace(0.0, 1.0, SAMPLES))


def _passes(problem: SequenceProblem, work: ArmWork) -> BoolArray:
    """Returns whether an arm passes the outer ends of its approach and retract in each stage, shape (stages, 2)."""
    active = np.array([stop is not None for stop in work.stops], dtype=np.bool_)
    passes = np.stack([active, active & np.append(active[1:], False)], axis=1)
    if problem.free_start:
        # It begins where the first approach does.
        passes[0, 0] = False
    passes[problem.together] = False
    return passes


def transfer_times(
    work: ArmWork,
    leaving: tuple[FloatArray, FloatArray],
    arriving: tuple[FloatArray, FloatArray],
) -> FloatArray:
    """Returns how long transfers take from every state to every state of the same row [s], shape (r, p, m).

    Infinite where ruckig has none.

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
        time[row, one, other] = np.inf if found is None else found.duration
    return time


def _moving(rates: FloatArray) -> BoolArray:
    moving: BoolArray = np.any(rates, axis=(-2, -1))
    return moving


def _states(q: FloatArray, rates: FloatArray) -> list[list[list[list[float]]]]:
    """Returns positions, velocities and accelerations of every row's states."""
    found: list[list[list[list[float]]]] = np.concatenate([q[:, :, None], rates], axis=2).tolist()
    return found


def timed_slopes(
    work: ArmWork,
    leaving: tuple[FloatArray, FloatArray],
    arriving: tuple[FloatArray, FloatArray],
    rest: tuple[FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Returns each joint's time [s] and its slope by the displacement [s/rad], its rates kept, shape (r, joints).

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

    def alone(k: int, step: float) -> FloatArray | None:
        position, *rates = goals[k]
        found = solver.calculated(starts[k], [[q + step for q in position], *rates])
        return None if found is None else np.array(found.independent_min_durations)

    for k in np.flatnonzero(_moving(leaving[1]) | _moving(arriving[1])).tolist():
        here, ahead, behind = (alone(k, step) for step in (0.0, STEP, -STEP))
        if here is None or ahead is None or behind is None:
            continue
        time[k] = here
        slope[k] = np.clip((ahead - behind) / (2.0 * STEP), -STEEPEST, STEEPEST)
    return time, slope
