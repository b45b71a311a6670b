"""The lower bound of sequences with paths and seams among their stages, against all sequences of configurations."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from itertools import product

import numpy as np
import pytest

from dualarm_cli.bound.bound import OtherWork, lower_bound
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.motion.rest_to_rest import PassingLaw
from dualarm_cli.stages.plans.problem import SequenceProblem, StopTarget

STAGES = 4
Chosen = dict[tuple[int, int], FloatArray]
"""Joints (7,) by arm and stage [rad]."""


def random_sequence(
    problem: SequenceProblem, random: np.random.Generator
) -> tuple[SequenceProblem, OtherWork]:
    """One or two configurations at every other stop, some arms idle; some stages are the ends of paths or seams."""
    arms = []
    for work in problem.arms:
        stops: list[StopTarget | None] = []
        for _ in range(STAGES):
            away = random.choice([0.1, 1.0]) * random.normal(size=(random.integers(1, 3), 7))
            q = np.clip(work.start + away, work.limits.lower, work.limits.upper)
            some = work.stops[0]
            assert some is not None
            idle = random.random() < 0.3
            stops.append(None if idle else dataclasses.replace(some, configurations=q))
        arms.append(dataclasses.replace(work, stops=tuple(stops)))
    free, returns = random.random() < 0.3, random.random() < 0.7
    problem = dataclasses.replace(problem, arms=tuple(arms), free_start=free, returns=returns)
    other = OtherWork(
        least=random.choice([0.0, 0.5, 2.0], STAGES),
        earliest=random.choice([0.0, 0.0, 1.0, 4.0], STAGES),
        moved=random.random((2, STAGES)) < 0.25,
    )
    return problem, other


def shortest(problem: SequenceProblem, other: OtherWork) -> float:
    """The end of the shortest sequence of configurations [s]; the platform stands still, as nothing asks it to turn."""
    keys = [
        (a, k)
        for a, work in enumerate(problem.arms)
        for k, stop in enumerate(work.stops)
        if stop is not None
    ]
    rows = [problem.arms[a].stops[k].configurations for a, k in keys]
    return min(_end(problem, other, dict(zip(keys, some, strict=True))) for some in product(*rows))


def _end(problem: SequenceProblem, other: OtherWork, chosen: Chosen) -> float:
    """When a sequence of configurations is over [s]; stops without lines are at rest."""
    # Where each arm is, None for anywhere, and when it left its last stop.
    here: list[FloatArray | None] = [work.start for work in problem.arms]
    clocks = [0.0, 0.0]

    def transfer(a: int, q: FloatArray) -> float:
        before = here[a]
        return 0.0 if before is None else float(problem.arms[a].law.duration(np.abs(q - before)))

    for k in range(STAGES):
        begin = max(*clocks, float(other.earliest[k]))
        clocks = [begin, begin]
        for a in (0, 1):
            if other.moved[a, k] or (k == 0 and problem.free_start and (a, 0) in chosen):
                here[a] = None
            if (a, k) in chosen:
                clocks[a] += transfer(a, chosen[a, k])
                here[a] = chosen[a, k]
        clocks = [max(*clocks, begin + float(other.least[k]))] * 2
    if not problem.returns or problem.free_start:
        return max(clocks)
    # An arm without any stop has nothing to return from.
    stopped = {a for a, _ in chosen}
    ends = [clocks[a] + transfer(a, problem.arms[a].start) for a in stopped]
    return max([*clocks, *ends])


@pytest.mark.parametrize("blended", [False, True])
def test_no_sequence_of_configurations_is_shorter_and_the_best_is_hardly_longer(
    random_problem: Callable[..., SequenceProblem], blended: bool
) -> None:
    """Stages with all that paths and seams bring; tables of times have steps, and both arms are bounded apart."""
    random, ratios = np.random.default_rng(7), []
    whole = random_problem(0, (1, 1))
    for _ in range(150):
        problem, other = random_sequence(whole, random)
        bound = lower_bound(
            problem.under(PassingLaw.of) if blended else problem, "quick", other
        ).value
        best = shortest(problem, other)
        assert bound <= best + 1e-9
        ratios.append(bound / best if best > 0.0 else 1.0)
    assert np.median(ratios) > 0.99
    assert np.mean(ratios) > 0.97


def test_where_both_arms_go_on_from_anywhere_bounds_add_up(
    random_problem: Callable[..., SequenceProblem],
) -> None:
    """What comes before and what comes after such a stage: whichever arm needs longer in either."""
    nothing_told = np.array([[False, False, True, False]] * 2)
    for seed in range(6):
        problem = random_problem(seed, (STAGES, STAGES), line=0.05, returns=True)
        other = dataclasses.replace(OtherWork.none(problem), moved=nothing_told)
        parts = []
        for first, last in ((0, 2), (2, STAGES)):
            arms = tuple(
                dataclasses.replace(work, stops=work.stops[first:last]) for work in problem.arms
            )
            part = dataclasses.replace(problem, arms=arms, returns=first > 0)
            begun = np.array([[first > 0, False]] * 2)
            own = dataclasses.replace(OtherWork.none(part), moved=begun)
            parts.append(lower_bound(part, "quick", own).value)
        assert lower_bound(problem, "quick", other).value == pytest.approx(sum(parts), rel=1e-5)


def test_while_an_arm_is_idle_the_other_one_s_stage_counts(
    random_problem: Callable[..., SequenceProblem],
) -> None:
    """Left: at its start or far away, then far away: one far transfer either way. In between the right arm has one."""
    whole = random_problem(0, (1, 1))
    far = []
    for work in whole.arms:
        q = work.start.copy()
        q[3] = work.limits.lower[3] if q[3] > 0.0 else work.limits.upper[3]
        far.append(q)
    some = whole.arms[0].stops[0]
    assert some is not None
    either, left, right = (
        dataclasses.replace(some, configurations=np.array(rows))
        for rows in ((whole.arms[0].start, far[0]), far[:1], far[1:])
    )
    stops = (either, None, left), (None, right, None)
    arms = tuple(
        dataclasses.replace(work, stops=own) for work, own in zip(whole.arms, stops, strict=True)
    )
    problem = dataclasses.replace(whole, arms=arms)
    times = [
        float(work.law.duration(q - work.start)) for work, q in zip(whole.arms, far, strict=True)
    ]
    assert 0.99 * sum(times) < lower_bound(problem, "quick").value <= sum(times)
