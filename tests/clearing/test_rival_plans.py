"""Collision-free plans compete as they are driven, and a refinement is taken only if it is shorter."""

from __future__ import annotations

from dataclasses import replace

import pytest

from dualarm_cli.clearing import blended_plan
from dualarm_cli.clearing.clear_plan import quickest_clear
from dualarm_cli.effort import EFFORTS
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.blending import LINES
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


def test_a_refinement_that_is_longer_is_left_out_and_its_stages_stay(problem):
    """Offered is the slower plan of `fixed`: at the next attempt the stage that grew and the one before stay."""
    kept_stages = []

    def refined(stages, holding, kept, attempt):
        assert (holding is None, attempt) == (False, len(kept_stages))
        kept_stages.append(set(kept))
        return _stages(replace(problem, holding=holding), "fixed")

    def solve(asked):
        return Decided(_stages(asked, "minimum_time"), refined=refined)

    timing = TIMING_SOLVERS["ruckig"]
    found = quickest_clear(problem, solve, timing)
    plain = quickest_clear(problem, lambda asked: replace(solve(asked), refined=None), timing)
    assert len(kept_stages) == EFFORTS["normal"].search.refinements
    assert not kept_stages[0]
    assert len(kept_stages[1]) >= 2
    assert found.cleared.duration <= plain.cleared.duration
    # Wider launches at the same postures are all that is left.
    for stage, same in zip(found.cleared.plans, plain.cleared.plans, strict=True):
        assert (stage.arrival == same.arrival).all()
