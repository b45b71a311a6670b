"""Budgets compared with schedules: at the figure, a little beyond it, and where pairs have clearances of their own."""

from __future__ import annotations

from dataclasses import replace

import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.budget import Budget
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.model.verification import Verification
from dualarm_cli.planning.planner import plan
from dualarm_cli.verification import verify
from dualarm_cli.verification.budget_checks import judge_budget, least_clearance


@pytest.fixture(scope="module")
def planned(tasks_folder):
    """The smallest job of two arms, with its plan, verified."""
    job = load_job(tasks_folder / "01_first_pick" / "tasks.yaml")
    schedule = plan(job, PlanSettings(effort="quick").naming(platform="fixed"))
    return job, replace(schedule, verification=verify(schedule, job, clearance=True))


def kept(schedule, job, **budget):
    """Returns whether each line of a budget is kept."""
    return [line.kept for line in judge_budget(schedule, replace(job, budget=Budget(**budget)))]


def test_a_cycle_time_is_kept_up_to_its_figure(planned):
    """Exactly, and by less than a nanosecond beyond it; not by a microsecond."""
    job, schedule = planned
    time = schedule.duration
    assert judge_budget(schedule, job) == ()
    assert kept(schedule, job, cycle_time=time) == [True]
    assert kept(schedule, job, cycle_time=time - 5e-10) == [True]
    assert kept(schedule, job, cycle_time=time - 1e-6) == [False]


def test_a_clearance_is_kept_down_to_its_figure(planned):
    """That which is proven of bodies that a cell can change; a hundredth of a millimetre more is not."""
    job, schedule = planned
    proven = schedule.verification.clearances
    least = min(stage.clearance for stage in proven if not stage.near)
    assert least_clearance(schedule, job) == least
    assert kept(schedule, job, clearance=least) == [True]
    assert kept(schedule, job, clearance=least + 1e-5, cycle_time=1.0) == [False, False]
    # Near links are nearer; they count where they lack clearance, or where there is nothing else.
    near = tuple(stage for stage in proven if stage.near)
    assert (closest := min(stage.clearance for stage in near)) < least
    for others in (near, (*proven, replace(near[0], clearance=-1.0, margin=-1.0))):
        judged = replace(schedule, verification=Verification((), others))
        assert least_clearance(judged, job) == (closest if others is near else -1.0)


def test_what_was_not_proven_is_missed_whatever_pairs_have_to_keep(planned):
    """Without a verification; pairs with a clearance of their own change nothing of it."""
    job, schedule = planned
    own = replace(job, cell=replace(job.cell, clearances=(("left_link_t", "right_link_t", 0.1),)))
    bare = replace(schedule, verification=None)
    for asked in (job, own):
        assert least_clearance(bare, asked) is None
        assert kept(bare, asked, clearance=0.0) == [False]


def test_it_is_the_distance_that_counts_and_not_what_is_left_of_it(planned):
    """A cell that demands 10 mm everywhere has the same least distance; its margin is 10 mm less."""
    job, schedule = planned
    demanding = replace(job, cell=replace(job.cell, clearance=0.01))
    judged = replace(schedule, verification=verify(schedule, demanding, clearance=True))
    least = least_clearance(schedule, job)
    assert least_clearance(judged, demanding) == pytest.approx(least, abs=5e-4)


def test_a_pair_with_a_clearance_of_its_own_does_not_hide_the_nearest_one(planned):
    """A pair from which much is demanded is nearest to its demand; the least distance is another pair's.

    Demanding 10 m of one pair makes it the one that every stage names.
    """
    job, schedule = planned
    least = least_clearance(schedule, job)
    hands = ("left_link_t", "right_link_t", 10.0)
    demanding = replace(job, cell=replace(job.cell, clearances=(hands,)))
    judged = replace(schedule, verification=verify(schedule, demanding, clearance=True))
    named = min(judged.verification.clearances, key=lambda stage: stage.margin)
    assert named.required == 10.0
    assert named.clearance > least
    # Both proofs stop within half a millimetre of the distance itself.
    assert least_clearance(judged, demanding) == pytest.approx(least, abs=5e-4)
    assert kept(judged, demanding, clearance=least + 1e-3) == [False]


def test_what_was_not_proven_is_not_kept(planned):
    """Without the proof there is no figure."""
    job, schedule = planned
    unproven = replace(schedule, verification=None)
    lines = judge_budget(unproven, replace(job, budget=Budget(clearance=0.0)))
    assert [(line.measured, line.kept) for line in lines] == [(None, False)]
    assert "not proven" in str(lines[0])


def test_a_missed_line_says_where_it_is_written_and_a_kept_one_does_not(planned):
    """For people: figures in their units."""
    from dualarm_cli.model.place import Place

    job, schedule = planned
    budget = Budget(1.5, 0.0, Place("t.yaml", 3, 9), Place("t.yaml", 3, 20))
    missed, good = (str(line) for line in judge_budget(schedule, replace(job, budget=budget)))
    assert missed.endswith("at most 1.5 s: MISSED (t.yaml:3:9)")
    assert good.endswith("at least 0 mm: kept")
