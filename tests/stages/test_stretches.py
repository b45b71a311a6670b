"""Stretches of a sequence are as long as in the whole, and parts make whole sequences."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from dualarm_cli.beside import copies
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.stages.search.problem import Decisions, SequenceProblem
from dualarm_cli.stages.search.search import search, search_in_parts
from dualarm_cli.stages.search.stops import StopTable
from dualarm_cli.stages.search.stretches import in_parts, loose_stretches, stretch_of
from dualarm_cli.stages.search.times import Evaluated, evaluate
from dualarm_cli.stages.sequence_problem import sequence_problem

Problems = Callable[..., SequenceProblem]


def _evaluated(problem: SequenceProblem, decisions: Decisions) -> Evaluated:
    return evaluate(problem, tuple(StopTable.of(work) for work in problem.arms), decisions)


def _uneven(problem: SequenceProblem, seed: int) -> SequenceProblem:
    """The same with some stops left out, so that arms are idle, one of them for several stages."""
    random = np.random.default_rng(seed)
    arms = []
    for a, work in enumerate(problem.arms):
        stops: list[object] = list(work.stops)
        for k in range(len(stops)):
            if random.random() < 0.4 and (a == 0 or arms[0].stops[k] is not None):
                stops[k] = None
        arms.append(replace(work, stops=tuple(stops)))
    return replace(problem, arms=tuple(arms))


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("start", ["home", "free"])
def test_stages_of_a_stretch_take_as_long_as_in_the_whole(
    random_problem: Problems, seed: int, start: str
) -> None:
    """Loose stages drawn at random, decided otherwise by another plan; what no stretch has does not change."""
    problem = random_problem(seed, (9, 9), line=0.05, start=start)
    plans = [
        search(problem, [], "quick", 0),
        search(replace(problem, free_start=True), [], "quick", 1),
    ]
    one, other = (found.best.decisions for found in plans if found is not None)
    problem = _uneven(problem, seed)
    loose = np.random.default_rng(seed).random(problem.stages) < 0.3
    before = _evaluated(problem, one)
    after = _evaluated(problem, one.put(np.flatnonzero(loose), other))
    seen = np.zeros(problem.stages, dtype=np.bool_)
    for stretch in loose_stretches(problem, before, loose):
        assert not seen[stretch.stages].any()
        seen[stretch.stages] = True
        np.testing.assert_array_equal(stretch.loose, loose[stretch.stages])
        alone = _evaluated(stretch.problem, after.decisions.take(stretch.stages))
        np.testing.assert_allclose(alone.stages, after.stages[stretch.stages], rtol=1e-12)
    assert seen[loose].all()
    np.testing.assert_allclose(after.stages[~seen], before.stages[~seen], rtol=1e-12)


def test_with_a_return_the_whole_is_one_stretch(random_problem: Problems) -> None:
    """It ends where everything begins."""
    problem = random_problem(1, (5, 5), returns=True)
    found = search(problem, [], "quick", 0)
    assert found is not None
    loose = np.arange(5) == 2
    [stretch] = loose_stretches(problem, found.best, loose)
    assert stretch.problem is problem
    np.testing.assert_array_equal(stretch.stages, np.arange(5))


@pytest.mark.parametrize("stages", [48, 60])
def test_parts_of_one_plan_make_that_plan(random_problem: Problems, stages: int) -> None:
    """Each decides its stages as the plan does: joined, they are it, with every stage in it."""
    problem = random_problem(3, (stages, stages))
    found = search(problem, [], "quick", 0)
    assert found is not None
    plan = found.best.decisions
    asked = []

    def decided(first: int, past: int) -> Decisions:
        asked.append((first, past))
        return plan.take(np.arange(first, past))

    joined = in_parts(problem, decided)
    assert joined is not None
    assert joined[0].total == pytest.approx(found.best.total, rel=1e-12)
    assert {k for span in asked for k in range(*span)} == set(range(stages))
    assert joined[1].any()
    assert in_parts(problem, lambda first, past: None if first else decided(first, past)) is None


def test_a_part_without_room_alone_is_decided_without(random_job: Callable[..., Job]) -> None:
    """Others keep it; the plan is nearly as fast as one that is decided as a whole, on any number of processes."""
    job = random_job(5, (48, 48), line=0.04)
    problem = sequence_problem(CellModel.from_cell(job.cell), job)
    whole = search(problem, [], "quick", 0)
    assert whole is not None
    narrow = tuple(
        replace(work, limits=replace(work.limits, lower=work.limits.lower + 0.02))
        for work in problem.arms
    )
    found = []
    for allowed in (False, True):
        with copies(allowed):
            parts = search_in_parts(problem, narrow, [], "quick", 0)
        assert parts is not None
        found.append(parts.best)
    np.testing.assert_array_equal(found[0].stages, found[1].stages)
    assert found[0].total <= 1.02 * whole.best.total


def test_a_stretch_begins_where_its_plan_is_or_anywhere(random_problem: Problems) -> None:
    """Without a plan its first transfer takes no time."""
    problem = random_problem(2, (6, 6))
    found = search(problem, [], "quick", 0)
    assert found is not None
    decisions = found.best.decisions.take(np.arange(3, 6))
    bound = _evaluated(stretch_of(problem, 3, 6, found.best), decisions)
    free = _evaluated(stretch_of(problem, 3, 6), decisions)
    np.testing.assert_allclose(bound.stages, found.best.stages[3:], rtol=1e-12)
    assert free.stages[0] < bound.stages[0]
    np.testing.assert_allclose(free.stages[1:], bound.stages[1:], rtol=1e-12)
