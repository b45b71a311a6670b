"""Collision-free plans compete as they are driven, and a refinement is taken only if it is shorter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dualarm_cli.background import allow_workers
from dualarm_cli.clearing import blended_plan, repairs
from dualarm_cli.clearing.clear_plan import quickest_clear
from dualarm_cli.clearing.repairs import Clearing
from dualarm_cli.clearing.stage_samples import stage_samples
from dualarm_cli.effort import EFFORTS
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.blending import LINES, STOPPING
from dualarm_cli.refusals import Refusal
from dualarm_cli.stages.method import Decided, MethodProblem
from dualarm_cli.stages.stage_by_stage import choose_stages
from dualarm_cli.timing import TIMING_SOLVERS


@pytest.fixture(scope="module")
def problem(tasks_folder):
    """Two tasks at the shelves, with lines that pass their ends in motion."""
    job = load_job(tasks_folder / "07_two_shelves" / "tasks.yaml")
    job = replace(job, tasks=job.tasks[:2])
    return MethodProblem(CellModel.from_cell(job.cell), job, "arm_angle", blending=LINES)


def _stages(problem, method):
    """Returns a simpler method's plan for stops."""
    given = problem.model, problem.job, problem.redundancy
    return choose_stages(MethodProblem(*given, holding=problem.holding), method)


@pytest.mark.parametrize(("share", "count"), [(10.0, 2), (0.0, 1)])
def test_plans_of_all_efforts_are_compared_blended(problem, monkeypatch, share, count):
    """The plan of normal effort waits; that of quick effort has other postures. A slow rival is left out."""
    normal, compared = EFFORTS["normal"], []
    clearing = replace(normal.clearing, blending_rival=share, sufficient_gain=-1.0)
    monkeypatch.setitem(EFFORTS, "normal", replace(normal, clearing=clearing))

    def solve(asked):
        if asked.effort == "quick":
            return Decided(_stages(asked, "minimum_time"))
        wait = 0.0 if asked.holding is None else 0.5
        stages = _stages(asked, "exact")
        return Decided([replace(stage, waits={"left": wait} if wait else {}) for stage in stages])

    blended = blended_plan.blended_plan

    def recorded(problem, plan, timing):
        result = blended(problem, plan, timing)
        compared.append((plan.cleared.duration, result.cleared.duration))
        return result

    monkeypatch.setattr(blended_plan, "blended_plan", recorded)
    found = quickest_clear(problem, solve, TIMING_SOLVERS["ruckig"])
    assert len({stopping for stopping, _ in compared}) == len(compared) == count
    assert found.cleared.duration == min(duration for _, duration in compared)
    assert found.cost >= 0.0


def test_a_refinement_that_is_longer_is_left_out(problem, monkeypatch):
    """Offered is the slower plan of `fixed`, then the plan itself with wider launches."""
    normal, driven = EFFORTS["normal"], []
    once = replace(normal, search=replace(normal.search, further_meshes=()))
    monkeypatch.setitem(EFFORTS, "normal", once)

    def refined(asked, stages, given, driver):
        assert asked.holding is not None
        longer = driver(_stages(asked, "fixed"), None)
        driven.extend((given.duration, longer.duration, driver(list(stages), 6).duration))

    def solve(asked):
        return Decided(_stages(asked, "minimum_time"))

    timing = TIMING_SOLVERS["ruckig"]
    found = quickest_clear(replace(problem, refine=refined), solve, timing)
    plain = quickest_clear(problem, solve, timing)
    assert driven[0] == pytest.approx(plain.cleared.duration, abs=1e-9)
    assert driven[1] > driven[0]
    assert found.cleared.duration == pytest.approx(min(driven), abs=1e-9)
    # Wider launches at the same postures are all that is left.
    for stage, same in zip(found.cleared.plans, plain.cleared.plans, strict=True):
        assert (stage.arrival == same.arrival).all()


@pytest.mark.parametrize("workers", [False, True])
def test_the_shortest_plan_of_all_grids_stays(problem, workers):
    """Each grid has the plan of another method; the grid of the effort has the slow one of `fixed`.

    Plans of further grids are made in a second process if there may be one.
    """
    grids = (), *((mesh,) for mesh in EFFORTS["normal"].search.further_meshes)
    methods = dict(zip(grids, ("fixed", "minimum_time", "exact"), strict=True))

    def planned(solve, refine=None):
        asked = replace(problem, refine=refine)
        return quickest_clear(asked, solve, TIMING_SOLVERS["ruckig"]).cleared

    def unchanged(_, stages, __, driver):
        driver(list(stages), None)

    def solve(asked):
        seen.add(asked.meshes)
        return Decided(_stages(asked, methods[asked.meshes]))

    seen = set()
    with allow_workers(workers):
        found = planned(solve, unchanged)
    assert seen == ({()} if workers else set(grids))
    alone = [
        planned(lambda asked, name=name: Decided(_stages(asked, name))) for name in methods.values()
    ]
    assert found.duration <= min(plan.duration for plan in alone) < alone[0].duration


@pytest.mark.parametrize("workers", [False, True])
def test_the_second_shortest_plan_may_win_once_refined(problem, workers):
    """Its refinement alone shortens the waits, and reports no progress. One grid has no plan."""
    own, (further, last) = (), EFFORTS["normal"].search.further_meshes
    waits, reported, refinements = {own: 0.2, (further,): 0.3}, [], []

    def waiting(stages, wait):
        return [replace(stage, waits={"left": wait}) for stage in stages]

    def refined(asked, stages, _, driver):
        asked.progress("refining")
        waits = 0.1 if stages[0].waits["left"] > 0.2 else 0.2
        refinements.append(driver(waiting(stages, waits), None))

    def solve(asked):
        if asked.meshes == (last,):
            raise InfeasibleError(Refusal("no_plan_on_grid"))
        return Decided(waiting(_stages(asked, "exact"), waits[asked.meshes]))

    asked = replace(problem, refine=refined, progress=reported.append)
    with allow_workers(workers):
        found = quickest_clear(asked, solve, TIMING_SOLVERS["ruckig"])
    assert {stage.waits["left"] for stage in found.cleared.plans} == {0.1}
    assert found.holding is not None
    assert reported.count("refining") == 1
    assert len(refinements) == (1 if workers else 2)


def test_thorough_effort_refines_plans_of_normal_effort(problem):
    """Searches of both efforts, the own one first; refinements at thorough effort alone."""
    searched, refined_at = [], []

    def refined(asked, stages, _, driver):
        refined_at.append(asked.effort)
        driver(list(stages), None)

    def solve(asked):
        searched.append(asked.effort)
        return Decided(_stages(asked, "minimum_time" if asked.effort == "normal" else "exact"))

    asked = replace(problem, effort="thorough", refine=refined)
    found = quickest_clear(asked, solve, TIMING_SOLVERS["ruckig"])
    assert searched[0] == "thorough"
    assert set(searched) == {"thorough", "normal"}
    assert refined_at == ["thorough"] * 2
    plain = quickest_clear(
        problem, lambda asked: Decided(_stages(asked, "exact")), TIMING_SOLVERS["ruckig"]
    )
    assert found.cleared.duration <= plain.cleared.duration


def test_only_the_launch_that_collides_is_left_out(problem, monkeypatch):
    """Said to collide is the right arm's transfer into stage 1 with one line passed in motion: the other line stays."""
    timing, stopping = TIMING_SOLVERS["ruckig"], replace(problem, blending=STOPPING, effort="quick")
    plan = quickest_clear(stopping, lambda asked: Decided(_stages(asked, "minimum_time")), timing)
    monkeypatch.setattr(Clearing, "colliding_stages", lambda *_: [])
    of_all = blended_plan.blended_plan(problem, plan, timing).cleared
    for stage, line in ((0, "retract"), (1, "approach")):
        key = ("right", line)

        def colliding(_, plans, motion, stage=stage, key=key):
            return [1] if key in plans[stage].passes else []

        def is_clear_at(_, plans, k, start, stage=stage, key=key):
            return k != 1 or key not in plans[stage].passes

        monkeypatch.setattr(Clearing, "colliding_stages", colliding)
        monkeypatch.setattr(Clearing, "is_clear_at", is_clear_at)
        found = blended_plan.blended_plan(problem, plan, timing).cleared
        passes = [set(plan.passes) for plan in of_all.plans]
        passes[stage].remove(key)
        assert [set(plan.passes) for plan in found.plans] == passes
        assert of_all.duration <= found.duration < plan.cleared.duration


def test_a_plan_whose_fewer_launches_have_no_timing_keeps_its_stops(problem, monkeypatch):
    """Said to collide is stage 1 of every blended plan, and only the first one can be timed."""
    timing, stopping = TIMING_SOLVERS["ruckig"], replace(problem, blending=STOPPING, effort="quick")
    plan = quickest_clear(stopping, lambda asked: Decided(_stages(asked, "minimum_time")), timing)
    realise, calls = blended_plan.realise, []

    def realise_once(*args):
        calls.append(args)
        if len(calls) > 1:
            raise InfeasibleError(Refusal("no_plan_on_grid"))
        return realise(*args)

    monkeypatch.setattr(blended_plan, "realise", realise_once)
    monkeypatch.setattr(Clearing, "colliding_stages", lambda *_: [1])
    found = blended_plan.blended_plan(problem, plan, timing).cleared
    assert len(calls) > 2 and found.duration == plan.cleared.duration


def test_two_stages_alone_move_as_in_the_whole_plan(problem, monkeypatch):
    """What is checked of stages k - 1 and k, timed with the one before, is their part of the whole motion."""
    timing, stopping = TIMING_SOLVERS["ruckig"], replace(problem, blending=STOPPING, effort="quick")
    plan = quickest_clear(stopping, lambda asked: Decided(_stages(asked, "minimum_time")), timing)
    blended = blended_plan.blended_plan(problem, plan, timing).cleared
    checked, clearing, stages = [], plan.clearing(problem, timing), blended.motion.stages

    def which_are_clear(_, samples):
        checked.extend(samples)
        return np.ones(len(samples), dtype=bool)

    monkeypatch.setattr(repairs, "which_are_clear", which_are_clear)
    for k in range(len(stages)):
        assert clearing.is_clear_at(blended.plans, k, stages[max(0, k - 2)].start)
        numbers = range(max(0, k - 1), k + 1)
        whole = [stage_samples(blended.motion, n, n, clearing.holding) for n in numbers]
        for found, expected in zip(checked, whole, strict=True):
            np.testing.assert_allclose(found.position, expected.position, atol=1e-9)
        checked.clear()
