"""Stretches of a sequence are as long as in the whole, and parts make whole sequences."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dualarm_cli.background import allow_workers
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.postures.holding import Holding
from dualarm_cli.stages.method import MethodProblem
from dualarm_cli.stages.plans.clearance import NoGood
from dualarm_cli.stages.plans.problem import ArmWork, Decisions, SequenceProblem
from dualarm_cli.stages.plans.times import Evaluated, evaluate
from dualarm_cli.stages.search.plan_clearance import plan_clearance
from dualarm_cli.stages.search.search import search, search_in_parts
from dualarm_cli.stages.search.stretches import in_parts, loose_stretches, stretch_of
from dualarm_cli.stages.sequence import decisions_of
from dualarm_cli.stages.sequence_problem import sequence_problem
from dualarm_cli.stages.serving import with_stopping_room
from dualarm_cli.stages.stage_by_stage import choose_stages

Problems = Callable[..., SequenceProblem]


def _evaluated(problem: SequenceProblem, decisions: Decisions) -> Evaluated:
    return evaluate(problem, decisions)


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


def test_with_a_return_a_stage_that_counts_for_it_makes_one_stretch(
    random_problem: Problems,
) -> None:
    """The last one and arms' last stops do, as the cycle ends where everything begins; others do not."""
    problem = random_problem(1, (5, 5), returns=True)
    found = search(problem, [], "quick", 0)
    assert found is not None
    [stretch] = loose_stretches(problem, found.best, np.arange(5) == 4)
    assert stretch.problem is problem
    np.testing.assert_array_equal(stretch.stages, np.arange(5))
    [stretch] = loose_stretches(problem, found.best, np.arange(5) == 2)
    np.testing.assert_array_equal(stretch.stages, [2, 3])


@pytest.mark.parametrize("stages", [48, 60])
def test_parts_of_one_plan_make_that_plan(random_problem: Problems, stages: int) -> None:
    """Each decides its stages as the plan does: joined, they are it, with every stage in it."""
    problem = random_problem(3, (stages, stages))
    found = search(problem, [], "quick", 0)
    assert found is not None
    plan = found.best.decisions
    asked = []

    def decided(first: int, past: int, _progress: object = None) -> Decisions:
        asked.append((first, past))
        return plan.take(np.arange(first, past))

    joined = in_parts(problem, decided)
    assert joined is not None
    assert joined[0].total == pytest.approx(found.best.total, rel=1e-12)
    assert {k for span in asked for k in range(*span)} == set(range(stages))
    assert joined[1].any()
    assert in_parts(problem, lambda first, *to: None if first else decided(first, *to)) is None


def _with_margin(job: Job, model: CellModel) -> tuple[ArmWork, ...]:
    """The arms with limits that leave room."""
    found = with_stopping_room(MethodProblem(model, job, "arm_angle", "quick"))
    return sequence_problem(found.model, found.job).arms


def test_parts_keep_room_where_they_have_a_plan_with_it(random_job: Callable[..., Job]) -> None:
    """Joints are within narrower limits; from a start the plan is no slower; on two processes it is the same."""
    job = random_job(5, (48, 48), line=0.04)
    model = CellModel.from_cell(job.cell)
    problem, with_margin = sequence_problem(model, job), _with_margin(job, model)
    said: list[str] = []
    plain = search_in_parts(replace(problem, progress=said.append), [], "quick", 0)
    found = search_in_parts(replace(problem, with_margin=with_margin), [], "quick", 0)
    assert plain is not None
    assert found is not None
    for work, postures in zip(with_margin, found.best.arms, strict=True):
        assert work.kinematics.within_limits(postures.q_target).all()
    kept = [
        work.kinematics.within_limits(q.q_target)
        for work, q in zip(with_margin, plain.best.arms, strict=True)
    ]
    assert not np.concatenate(kept).all()
    # Progress: parts of equal length, one after the other, and the steps of each.
    shares = [int(text.split(" %")[0]) for text in said if text.endswith("done")]
    assert shares == [100 * k // len(shares) for k in range(len(shares))]
    assert all(f"{share} % of its parts done, step 1 of 3" in said for share in shares)
    assert said[-1] == "joining its parts"
    again = search_in_parts(problem, [found.best.decisions], "quick", 0)
    assert again is not None
    assert again.best.total <= found.best.total
    with allow_workers(True):
        shared = search_in_parts(replace(problem, with_margin=with_margin), [], "quick", 0)
    assert shared is not None
    np.testing.assert_array_equal(shared.best.stages, found.best.stages)


def test_parts_without_room_are_decided_without(random_job: Callable[..., Job]) -> None:
    """Where no joint may move, every part is decided as if nobody had asked for room."""
    job = random_job(6, (48, 48))
    model = CellModel.from_cell(job.cell)
    problem, with_margin = sequence_problem(model, job), _with_margin(job, model)
    fixed = tuple(
        replace(work, kinematics=replace(work.kinematics, lower=work.start, upper=work.start))
        for work in with_margin
    )
    plain = search_in_parts(problem, [], "quick", 0)
    found = search_in_parts(replace(problem, with_margin=fixed), [], "quick", 0)
    assert plain is not None
    assert found is not None
    np.testing.assert_array_equal(found.best.stages, plain.best.stages)


@pytest.mark.parametrize("seed", range(4))
def test_stretches_are_as_clear_as_in_the_whole(tasks_folder: Path, seed: int) -> None:
    """Stops, waits and no_goods, of a crowded job with idle arms, whose last stops are decided anew as well."""
    job = load_job(tasks_folder / "07_two_shelves" / "tasks.yaml")
    model = CellModel.from_cell(job.cell)
    plans = choose_stages(MethodProblem(model, job, "arm_angle"), "exact", refine=False)
    problem = replace(sequence_problem(model, job, Holding.of(job)), returns=False)
    one = decisions_of(problem, model, plans)
    found = search(replace(problem, clearance=None), [], "quick", seed)
    assert found is not None
    assert problem.clearance is not None
    problem = _uneven(problem, seed)
    everything = tuple(range(len(plans[0].start)))
    no_goods = tuple(NoGood(k, everything, plans[k].start, plans[k].arrival, 2.5) for k in (2, 7))
    problem = replace(problem, clearance=replace(problem.clearance, no_goods=no_goods))
    loose = np.random.default_rng(seed).random(problem.stages) < 0.25
    before = _evaluated(problem, one)
    after = _evaluated(problem, one.put(np.flatnonzero(loose), found.best.decisions))
    whole, seen = plan_clearance(problem, after), np.zeros(problem.stages, dtype=np.bool_)
    for stretch in loose_stretches(problem, before, loose):
        seen[stretch.stages] = True
        own = _evaluated(stretch.problem, after.decisions.take(stretch.stages))
        clear = plan_clearance(stretch.problem, own)
        np.testing.assert_array_equal(clear.stops, whole.stops[stretch.stages])
        np.testing.assert_allclose(clear.waits[:-1], whole.waits[stretch.stages], atol=1e-9)
    same = plan_clearance(problem, before)
    np.testing.assert_array_equal(whole.stops[~seen], same.stops[~seen])
    np.testing.assert_allclose(whole.waits[:-1][~seen], same.waits[:-1][~seen], atol=1e-9)


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
