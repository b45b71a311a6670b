"""Particle swarm over all continuous decisions of a sequence at once."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.stages.search.candidates import CandidatePostures
from dualarm_cli.stages.search.corridor import candidates_of
from dualarm_cli.stages.search.problem import Decisions, SequenceProblem
from dualarm_cli.stages.search.stops import StopTable
from dualarm_cli.stages.search.times import Evaluated, evaluate, stage_times
from dualarm_cli.stages.search.variables import Variables

INERTIA, PULL = 0.7298, 1.49618
"""Constriction coefficients [Clerc2002]."""
PARTICLES = 40
"""Size of the swarm, the customary one."""
ITERATIONS = {"quick": 60, "normal": 500, "thorough": 3000}
"""By effort."""
SPREADS = (0.0005, 0.05)
"""Least and greatest standard deviation of the first positions around the start, and of the speeds [rad]: with many
variables all wide steps are worse than the start, and a swarm that begins with nothing else falls back to it."""


def particle_swarm(
    problem: SequenceProblem,
    tables: tuple[StopTable, ...],
    start: Evaluated,
    effort: str,
    seed: int,
) -> Evaluated:
    """Returns the best plan that a particle swarm finds; never slower than the start.

    Variables are platform angles, arm angles and free yaws; branches stay. One particle begins at the start, the others
    around it, from very near to farther away. A stage that a particle makes impossible stays as it is at the start.

    Args:
        problem: the sequence.
        tables: the arms' stops.
        start: a possible plan.
        effort: one of ITERATIONS.
        seed: of the swarm.
    """
    variables = Variables.of(problem)
    if not variables.count:
        return start
    random = np.random.default_rng(seed)
    scale = np.geomspace(*SPREADS, PARTICLES)[:, None]
    place, speed = scale * random.normal(size=(2, PARTICLES, variables.count))
    place[0] = 0.0
    best_place, best_value = place.copy(), np.full(PARTICLES, np.inf)
    for _ in range(ITERATIONS[effort]):
        value = _totals(problem, tables, variables, start, place)
        better = value < best_value
        best_place[better], best_value[better] = place[better], value[better]
        leader = best_place[int(np.argmin(best_value))]
        own, common = random.uniform(size=(2, *place.shape))
        speed = INERTIA * speed + PULL * (own * (best_place - place) + common * (leader - place))
        place = place + speed
    step = best_place[int(np.argmin(best_value))]
    found = evaluate(problem, tables, _plan(problem, variables, start, step))
    lost = np.flatnonzero(
        ~np.all([_possible(problem, a, arm) for a, arm in enumerate(found.arms)], axis=0)
    )
    if len(lost):
        decisions = found.decisions
        angle = np.array(decisions.angle)
        angle[lost] = start.decisions.angle[lost]
        arms = tuple(
            mine.put(lost, other.take(lost))
            for mine, other in zip(decisions.arms, start.decisions.arms, strict=True)
        )
        found = evaluate(problem, tables, Decisions(angle, arms))
    return found if found.total < start.total else start


def _plan(
    problem: SequenceProblem, variables: Variables, start: Evaluated, step: FloatArray
) -> Decisions:
    moved = variables.moved(start.decisions, step)
    if not problem.turns:
        return moved
    return Decisions(np.clip(moved.angle, *problem.platform_range), moved.arms)


def _totals(
    problem: SequenceProblem,
    tables: tuple[StopTable, ...],
    variables: Variables,
    start: Evaluated,
    places: FloatArray,
) -> FloatArray:
    """Returns the cycle time of every particle [s]; the postures of all of them in one batch."""
    plans = [_plan(problem, variables, start, place) for place in places]
    angle = np.stack([plan.angle for plan in plans], axis=1)
    found = [candidates_of(problem, tables, plans, angle, a) for a in range(len(tables))]
    possible = np.all([_possible(problem, a, arm) for a, arm in enumerate(found)], axis=0)
    angle = np.where(possible, angle, start.decisions.angle[:, None])
    found = [arm.where(possible, start.arms[a]) for a, arm in enumerate(found)]
    totals = np.empty(len(plans))
    for m in range(len(plans)):
        arms = tuple(arm.of_plan(m) for arm in found)
        stages, closing = stage_times(problem, angle[:, m], arms)
        totals[m] = stages.sum() + closing
    return totals


def _possible(problem: SequenceProblem, a: int, found: CandidatePostures) -> BoolArray:
    """Returns where an arm can be, or has nothing to do; shape (n, ...)."""
    idle = np.array([stop is None for stop in problem.arms[a].stops])
    return np.asarray(found.possible | idle.reshape(-1, *(1,) * (found.work.ndim - 1)))
