"""Refinement of collision-free plans: small and large random steps with the launches that suit the postures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dualarm_cli import effort
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.postures.stage_plan import Detour
from dualarm_cli.stages.method import DrivenStages, MethodProblem
from dualarm_cli.stages.plans.launches import default_launches, with_best_launches
from dualarm_cli.stages.plans.times import evaluate
from dualarm_cli.stages.refinement import refined_sequence, shorter_stages, shorter_steps
from dualarm_cli.stages.search.polish import Polishing
from dualarm_cli.stages.search.search import search
from dualarm_cli.stages.sequence_problem import sequence_problem
from dualarm_cli.stages.stage_by_stage import choose_stages
from dualarm_cli.verification import verify


@pytest.fixture(scope="module", params=["lines in motion", "stops"])
def sequence(request, random_job):
    """A sequence with lines that pass their ends in motion or stop there, and a plan from rest to rest."""
    job = random_job(5, (5, 4), line=0.08, dwell=0.1, returns=True)
    problem = sequence_problem(CellModel.from_cell(job.cell), job)
    plan = search(problem, [], "quick", 0).best
    if request.param == "lines in motion":
        problem = replace(problem, launches=default_launches(problem))
    return problem, plan


def test_refinement_shortens_the_plan_as_it_is_timed(sequence):
    """Compared with the best launches of either plan, within joint limits; twice the same is the same."""
    problem, plan = sequence
    refined = Polishing(problem, seed=3).refined(plan, 8)
    again = Polishing(problem, seed=3).refined(plan, 8)
    before, after = (with_best_launches(problem, each)[1].total for each in (plan, refined))
    assert after < before
    assert refined.total == again.total
    for work, postures in zip(problem.arms, refined.arms, strict=True):
        active = [k for k, stop in enumerate(work.stops) if stop is not None]
        for q in (postures.q_approach, postures.q_target, postures.q_retract):
            assert (q[active] >= work.limits.lower).all()
            assert (q[active] <= work.limits.upper).all()


def test_refinement_leaves_given_stages_as_they_are(sequence):
    """Stages 0 and 2 keep platform angles and arm angles to the last bit, stage 3 does not."""
    problem, plan = sequence
    loose = np.array([False, True, False, True, True])
    refined = Polishing(problem, loose=loose).refined(plan, 8).decisions
    same = np.array([refined.angle[k] == plan.decisions.angle[k] for k in range(problem.stages)])
    assert same[~loose].all()
    assert not same[loose].all()
    for given, arm in zip(plan.decisions.arms, refined.arms, strict=True):
        np.testing.assert_array_equal(arm.psi_target[~loose], given.psi_target[~loose])


def test_nothing_to_refine_is_returned_as_it_is(sequence):
    """No rounds, and no stage that may change."""
    problem, plan = sequence
    assert Polishing(problem).refined(plan, 0) is plan
    assert Polishing(problem, loose=np.zeros(5, dtype=np.bool_)).refined(plan, 8) is plan


def test_single_steps_change_one_stage_and_most_are_shorter(sequence):
    """By the best launches of the whole plan. A step starts from the last one that was kept; fixed stages stay."""
    problem, plan = sequence
    loose = np.array([False, True, False, True, True])
    steps = shorter_steps(problem, plan.decisions, loose, seed=1)
    before, kept, step, shorter = plan.decisions, 0, next(steps), []
    for _ in range(60):
        if step is None:
            step = steps.send(False)
            continue
        changed = np.flatnonzero(_differs(before, step))
        assert len(changed) == 1
        assert loose[changed[0]]
        at_rest = replace(problem, launches=None)
        totals = [
            with_best_launches(problem, evaluate(at_rest, each))[1].total for each in (before, step)
        ]
        shorter.append(totals[1] < totals[0])
        is_kept = kept < 3
        before, kept = (step, kept + 1) if is_kept else (before, kept)
        step = steps.send(is_kept)
    assert kept == 3
    assert np.mean(shorter) > 0.7


def _differs(one, other):
    """Returns which stages have other angles."""
    differs = one.angle != other.angle
    for a, b in zip(one.arms, other.arms, strict=True):
        differs |= (a.psi_target != b.psi_target) | (a.yaw != b.yaw)
        differs |= (a.psi_approach != b.psi_approach) | (a.psi_retract != b.psi_retract)
    return differs


def test_a_stage_is_better_if_it_shrinks_with_the_next_one():
    """The third grows by less than the fourth shrinks; the last one has the return behind it."""
    growth = np.array([-0.3, 0.2, 0.1, -0.4, 0.1, 0.2])
    assert shorter_stages(growth, 5).tolist() == [0, 2, 3]
    assert shorter_stages(growth[:5], 5).tolist() == [0, 2, 3]
    assert shorter_stages(np.array([0.1, -0.2, 0.3]), 2).tolist() == [0]


@pytest.fixture(scope="module")
def problem_and_stages(random_job):
    """Four stages of two arms, planned by a simpler method."""
    job = random_job(8, (4, 4), line=0.08, dwell=0.1)
    model = CellModel.from_cell(job.cell)
    problem = MethodProblem(model, job, "arm_angle", effort="normal")
    return problem, choose_stages(problem, "exact")


def refined_with(problem, stages, lengths):
    """Returns the joints after the transfers of a plan and of all that a refinement drives, timed by turns as given."""
    driven, times = [], iter(lengths)

    def driver(plans, widths):
        driven.append(np.array([plan.arrival for plan in plans]))
        return next(times, None)

    refined_sequence(problem, stages, DrivenStages(np.ones(len(stages))), driver)
    return np.array([plan.arrival for plan in stages]), driven


def test_the_shorter_stages_of_an_attempt_are_put_into_the_plan(problem_and_stages):
    """The first two of four shrink: the second plan that is driven has these, and the others as they were."""
    attempt = DrivenStages(np.array([0.8, 0.9, 1.0, 1.5]))
    given, (tried, mixed, *_) = refined_with(*problem_and_stages, [attempt])
    assert (np.abs(tried - given).max(axis=1) > 1e-6).all()
    np.testing.assert_allclose(mixed[:2], tried[:2], atol=1e-9)
    np.testing.assert_allclose(mixed[2:], given[2:], atol=1e-9)


@pytest.mark.parametrize(
    "failed",
    [DrivenStages(np.array([1.1, 1.1, 1.5, 1.1])), DrivenStages(np.zeros(0), (2,))],
    ids=["longer", "colliding"],
)
def test_stages_of_an_attempt_that_failed_stay_in_the_next_one(problem_and_stages, failed):
    """The third one and the one before; all others are tried again. No plan of the first attempt is driven on."""
    given, (_, again, *_) = refined_with(*problem_and_stages, [failed])
    stays = np.abs(again - given).max(axis=1) < 1e-9
    assert stays.tolist() == [False, True, True, False]


def test_waits_and_detours_stay_while_both_ends_of_their_transfers_move(problem_and_stages):
    """Of every plan that is driven, in the third stage; the driver judges whether they still avoid a collision."""
    problem, stages = problem_and_stages
    arms = [*stages[2].stops]
    detours = {arms[0]: Detour(stages[2].start[None, problem.model.arms[arms[0]].columns], False)}
    repaired = [*stages]
    repaired[2] = replace(stages[2], waits={arms[-1]: 0.1}, detours=detours)
    driven = []

    def driver(plans, widths):
        driven.append(plans)

    refined_sequence(problem, repaired, DrivenStages(np.ones(len(stages))), driver)
    assert driven
    for plans in driven:
        assert [(plan.waits, plan.detours) for plan in plans] == [
            (plan.waits, plan.detours) for plan in repaired
        ]
    (first, *_) = driven
    for name in {arms[0], arms[-1]}:
        columns = problem.model.arms[name].columns
        for moved, given in (
            (first[2].start, stages[2].start),
            (first[2].arrival, stages[2].arrival),
        ):
            assert not np.allclose(moved[columns], given[columns], atol=1e-6)


def test_a_plan_with_a_detour_is_refined_with_it(tasks_folder, monkeypatch):
    """The platform stands elsewhere in every stage, also before and after the detour; the verifier passes the plan."""
    job = load_job(tasks_folder / "13_hand_over" / "tasks.yaml")
    quick, plans = effort.EFFORTS["quick"], []
    for refinements in (0, 2):
        changed = replace(quick, search=replace(quick.search, refinements=refinements))
        monkeypatch.setitem(effort.EFFORTS, "quick", changed)
        plans.append(plan_without_bound(job, PlanSettings(effort="quick")))
        assert any("detour" in str(note) for note in plans[-1].notes)
    before, refined = plans
    assert refined.duration < before.duration
    pairs = list(zip(before.stages, refined.stages, strict=True))[:-1]
    assert all(a.platform_angle != b.platform_angle for a, b in pairs)
    assert verify(refined, job, clearance=True).passed


@pytest.mark.parametrize("blend", ["lines", "none"])
def test_a_refined_plan_is_shorter_and_collision_free(random_job, monkeypatch, blend):
    """Without refinement, with it, and with steps of single stages after it; the verifier passes the last one."""
    job = random_job(8, (4, 4), line=0.08, dwell=0.1)
    quick, plans = effort.EFFORTS["quick"], []
    for how in ({}, {"refinements": 2}, {"refinements": 2, "single_steps": 40}):
        changed = replace(quick, search=replace(quick.search, **how))
        monkeypatch.setitem(effort.EFFORTS, "quick", changed)
        plans.append(plan_without_bound(job, PlanSettings(effort="quick", blend=blend)))
    before, refined, stepped = plans
    assert stepped.duration < refined.duration < before.duration
    assert stepped.clearance_cost >= 0.0
    assert verify(stepped, job, clearance=True).passed


@pytest.mark.parametrize(
    ("effort_name", "capped"), [("normal", False), ("normal", True), ("quick", False)]
)
def test_plans_are_refined_where_the_effort_says_so_and_times_are_known(
    random_job, effort_name, capped
):
    """Not at quick effort, and not with a limit of the tools' speed, which the search does not time."""
    job = replace(random_job(8, (2, 2), line=0.08), tool_speed=0.8 if capped else None)
    model, how = CellModel.from_cell(job.cell), {"effort": effort_name, "refine": refined_sequence}
    problem = MethodProblem(model, job, "arm_angle", **how)
    assert problem.refines == (effort_name == "normal" and not capped)
    assert not replace(problem, refine=None).refines
    assert not replace(problem, job=replace(job, tasks=())).refines
