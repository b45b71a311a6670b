"""The length of a sampled plan with one stage decided otherwise, against judging the whole plan anew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.plan.planner import plan_without_bound
from dualarm_cli.stages import sampled
from dualarm_cli.stages.sampled_plan import Choice


@pytest.fixture(scope="module")
def two_trays(tasks_folder):
    """A job on a platform in which an arm is idle in some stages, and the plan that the search hands on."""
    seen = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sampled, "polished", lambda plan, sweeps: seen.append(plan) or plan)
        job = load_job(tasks_folder / "02_two_trays" / "tasks.yaml")
        tasks = (*job.tasks, replace(job.tasks[-1], id="again"))
        settings = PlanSettings(platform="sampled", redundancy="numeric", effort="quick")
        plan_without_bound(replace(job, tasks=tasks), settings, clear=False)
    return seen[0]


def varied(choice, rng, within):
    """Returns a choice whose arms end elsewhere, or only its way there, and whose platform stands elsewhere."""
    ways = {}
    for arm, way in choice.ways.items():
        shift = rng.uniform(-1.0, 1.0, way.ends.shape)
        shift[:, 1] *= not within
        ways[arm] = replace(way, ends=way.ends + shift)
    turn = 0.0 if within else rng.uniform(-0.5, 0.5, choice.angle.shape)
    return Choice(choice.angle + turn, ways)


@pytest.mark.parametrize("start", ["home", "free"])
@pytest.mark.parametrize("returns", [False, True])
@pytest.mark.parametrize("within", [False, True])
def test_another_choice_costs_what_the_whole_plan_with_it_takes(two_trays, start, returns, within):
    """Every stage, ends that change what follows and ends that do not."""
    plan = replace(two_trays, job=replace(two_trays.job, start=start, returns=returns))
    assert any(len(choice.ways) == 1 for choice in plan.choices)
    rng, changed = np.random.default_rng(5), 0
    for k, choice in enumerate(plan.choices):
        for _ in range(5):
            other = varied(choice, rng, within)
            found, whole = plan.duration_with(k, other), plan.with_choice(k, other).duration
            assert found == whole
            changed += found != plan.duration
    assert changed > 2 * len(plan.choices)
