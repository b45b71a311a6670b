"""Launches at lines' outer ends, for transfers that begin or end moving.

They estimate the times of these transfers.

A launch is a number: 0 at rest, else a profile and cut of `timing/launch`, counted as in `timing/line_ends`. A search
begins with one default launch everywhere, and polishes postures with the launches that suit them best.
`motion/blending` chooses launches again, exactly, for the final postures. At rest remain line ends without a
neighbouring transfer of the same arm, hand-overs and the return. Our own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from dualarm_cli.background import map_halves
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.stages.plans.passing import outwards
from dualarm_cli.stages.plans.problem import ArmWork, SequenceProblem
from dualarm_cli.stages.plans.times import (
    Evaluated,
    TransferChain,
    evaluate,
    platform_times,
    start_angle,
    start_joints,
)
from dualarm_cli.timing.launch import CUTS
from dualarm_cli.timing.line_ends import Passings, quickest_pair
from dualarm_cli.timing.problem import LineProblem, TransferProblem


def default_launches(problem: SequenceProblem) -> tuple[IntArray, ...]:
    """Return the default launches of line ends by arm, shape (n, 2) each."""
    launches, settings = [], problem.settings
    for work in problem.arms:
        jerky = not np.isfinite(work.limits.jerk).all()
        profile, cut = settings.passing_without_jerk if jerky else settings.passing
        launches.append(np.where(_passes(problem, work), 1 + profile * len(CUTS) + cut, 0))
    return tuple(launches)


def _passes(problem: SequenceProblem, work: ArmWork) -> BoolArray:
    """Flag the line ends that each stage may pass in motion, shape (n, 2)."""
    stops = [(0.0, 0.0) if stop is None else (stop.approach, stop.retract) for stop in work.stops]
    passes = np.array(stops) > 0.0
    active = np.array([stop is not None for stop in work.stops], dtype=np.bool_)
    passes[:, 1] &= np.append(active[1:], False)
    if problem.free_start:
        # A free start is the outer end of the first approach, at rest.
        passes[0, 0] = False
    passes[problem.handover_stages] = False
    return passes


def with_best_launches(
    problem: SequenceProblem, plan: Evaluated, *, near: bool = False
) -> tuple[SequenceProblem, Evaluated]:
    """Evaluate a plan with its best launches, or at rest if the problem has none.

    Args:
        problem: the sequence.
        plan: its plan.
        near: whether the problem's launches suit a similar plan; the best ones are then near them.
    """
    if problem.launches is not None:
        given = problem.launches if near else None
        problem = replace(problem, launches=best_launches(problem, plan, given))
    return problem, evaluate(problem, plan.decisions)


def best_launches(
    problem: SequenceProblem, plan: Evaluated, near: tuple[IntArray, ...] | None = None
) -> tuple[IntArray, ...]:
    """Select the fastest launches for a plan's postures by arm, shape (n, 2) each.

    Each transfer is optimised by itself.

    Args:
        problem: the sequence.
        plan: its plan.
        near: launches that suit a similar plan; the search then begins there.
    """
    angle = plan.decisions.angle
    before = np.concatenate([[start_angle(problem, angle)], angle[:-1]])
    platform = platform_times(problem, angle - before)
    arm_launches = []
    for a, work in enumerate(problem.arms):
        launches = np.zeros((problem.stages, 2), dtype=np.int64)
        given = None if near is None else near[a]
        of = partial(_best_launches, problem, plan, a, platform, given)
        stages = TransferChain.of(work).active
        stage_launches = map_halves(of, stages.tolist(), problem.settings.shared_transfers)
        for k, pair in zip(stages.tolist(), stage_launches, strict=True):
            launches[k, 0] = pair[1]
            if k:
                launches[k - 1, 1] = pair[0]
        arm_launches.append(launches)
    return tuple(arm_launches)


def _best_launches(
    problem: SequenceProblem,
    plan: Evaluated,
    a: int,
    platform: FloatArray,
    given: IntArray | None,
    stages: Sequence[int],
) -> list[tuple[int, int]]:
    """Select the launches of the retract before and the approach of each given stage."""
    work, postures = problem.arms[a], plan.arms[a]
    limits, passes = work.robot_limits or work.limits, _passes(problem, work)
    chain = TransferChain.of(work)
    start = start_joints(problem, work, chain, postures)

    def passings(k: int, line: int) -> Passings:
        if k < 0 or not passes[k, line]:
            return Passings.none(work.joints)
        path = outwards(postures.take(np.array([k])), line)[0]
        rest = (postures.retract if line else postures.approach)[k].max()
        timed_line = LineProblem(limits.joints, path, np.linspace(0.0, 1.0, len(path)), limits)
        return Passings.along(timed_line, float(rest), away=line == 1)

    pairs = []
    for k in stages:
        previous, goal = int(chain.previous[k]), postures.q_approach[k]
        q = postures.q_retract[previous] if previous >= 0 else start
        transfer = TransferProblem(limits.joints, q, goal, limits, float(platform[k]))
        rest = max(float(platform[k]), float(work.law.duration(goal - q)))
        # At k = 0 this reads the last row: there is no line then, so that any launch is at rest.
        pair = None if given is None else (int(given[k - 1, 1]), int(given[k, 0]))
        i, j, _ = quickest_pair(passings(k - 1, 1), passings(k, 0), transfer, rest, start=pair)
        pairs.append((i, j))
    return pairs
