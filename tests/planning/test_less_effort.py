"""Jobs in a given order, and short ones, are planned with less effort as well: the shorter plan is taken."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import pytest

from dualarm_cli.bound.bound import LowerBound
from dualarm_cli.errors import BlockedError, InfeasibleError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.schedule import Provenance
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning import planner
from dualarm_cli.planning.notes import order_note
from dualarm_cli.refusals import Refusal


@dataclass
class Plan:
    """As much of a schedule as the choice looks at."""

    duration: float
    provenance: Provenance
    notes: tuple[str, ...] = ()
    lower_bound: float | None = None


@pytest.fixture
def chosen(monkeypatch: pytest.MonkeyPatch):
    """Plans a job whose plans take as long as is said by effort, None for none; says which were made as well."""

    def found(job: Any, durations: Mapping[str, float | None], settings: PlanSettings):
        asked = []

        def made(work: Any, watch: Any) -> Plan:
            own = work.settings
            asked.append(own.effort)
            duration = durations[own.effort]
            if duration is None:
                raise BlockedError(Refusal("not_clear"), stages=(0,))
            # As where a solver is replaced that does not serve the robot.
            return Plan(duration, Provenance("", {}, own.as_dict() | {"redundancy": "numeric"}, 0))

        monkeypatch.setattr(planner, "_planned", made)
        monkeypatch.setattr(planner.JobBound, "value", lambda _: LowerBound(1.0, ()))
        return planner.plan(job, settings), asked

    return found


@pytest.fixture(scope="module")
def job(tasks_folder):
    """A short job."""
    return load_job(tasks_folder / "01_first_pick" / "tasks.yaml")


@pytest.mark.parametrize(
    ("durations", "effort", "expected"),
    [
        ({"quick": 3.0, "normal": 2.0}, "normal", 2.0),
        ({"quick": 2.0, "normal": 3.0}, "normal", 2.0),
        ({"quick": 2.0, "normal": None}, "normal", 2.0),
        ({"quick": None, "normal": 3.0}, "normal", 3.0),
        ({"quick": 2.0, "normal": 4.0, "thorough": 3.0}, "thorough", 2.0),
        ({"quick": 4.0, "normal": 2.0, "thorough": 3.0}, "thorough", 2.0),
        ({"quick": 2.0, "normal": None, "thorough": 3.0}, "thorough", 2.0),
        ({"quick": 2.0}, "quick", 2.0),
    ],
)
def test_the_shortest_plan_is_taken_and_says_the_effort_asked_for(
    chosen, job, durations, effort, expected
):
    """Each effort up to the one asked for is tried, with the bound of the one asked for."""
    plan, asked = chosen(job, durations, PlanSettings(effort=effort))
    assert (plan.duration, plan.lower_bound) == (expected, 1.0)
    assert plan.provenance.settings["effort"] == effort
    assert plan.provenance.settings["redundancy"] == "numeric"
    assert sorted(asked) == sorted(durations)


@pytest.mark.parametrize(
    ("durations", "expected"),
    [
        ({"quick": 2.5, "normal": 3.0}, ["it is 0.5 s shorter than that of normal"]),
        ({"quick": 2.5, "normal": None}, ["normal found none"]),
        ({"quick": 3.0, "normal": 3.0}, []),
        ({"quick": 3.0 - 1e-12, "normal": 3.0}, []),
    ],
)
def test_a_plan_of_less_effort_says_that_it_is_one(chosen, job, durations, expected):
    """With the reason; rounding is none."""
    plan, _ = chosen(job, durations, PlanSettings(effort="normal"))
    taken = "effort: the plan of quick effort was taken, as "
    assert list(plan.notes) == [taken + reason for reason in expected]


def test_without_any_plan_the_refusal_is_that_of_the_effort_asked_for(chosen, job):
    """No plan at either effort."""
    with pytest.raises(BlockedError):
        chosen(job, {"quick": None, "normal": None}, PlanSettings(effort="normal"))


def test_a_task_in_time_at_less_effort_alone_is_planned(chosen, job, monkeypatch):
    """Whatever the refusal is: here a window that closes too early."""

    def late(work: Any, watch: Any) -> Plan:
        settings = work.settings
        if settings.effort == "normal":
            raise InfeasibleError(Refusal("late"))
        return Plan(2.0, Provenance("", {}, settings.as_dict(), 0))

    chosen(job, {"quick": 2.0}, PlanSettings(effort="quick"))
    monkeypatch.setattr(planner, "_planned", late)
    assert planner.plan(job, PlanSettings(effort="normal")).duration == 2.0


@pytest.mark.parametrize(("more", "limit"), [(13, None), (1, 10.0)])
def test_long_jobs_and_searches_with_a_time_limit_are_planned_once(chosen, job, more, limit):
    """A task has two stops at least: thirteen times as many are more than 24."""
    long = replace(job, tasks=job.tasks * more, order="optimise")
    durations = {"quick": 2.0, "normal": 3.0}
    plan, asked = chosen(long, durations, PlanSettings(effort="normal", time_limit=limit))
    assert (plan.duration, asked) == (3.0, ["normal"])


@pytest.mark.parametrize("effort", ["normal", "thorough"])
def test_long_jobs_in_a_given_order_take_no_longer_with_more_effort(chosen, job, effort):
    """As short ones: 52 stops at least are planned with each effort up to the one asked for."""
    durations = {"quick": 2.0, "normal": 3.0, "thorough": 2.5}
    durations = dict(list(durations.items())[: 2 + (effort == "thorough")])
    plan, asked = chosen(replace(job, tasks=job.tasks * 13), durations, PlanSettings(effort=effort))
    assert (plan.duration, sorted(asked)) == (2.0, sorted(durations))


def test_a_time_limit_has_no_effect_where_the_file_fixes_the_order(chosen, job):
    """As the plan's note says."""
    durations = {"quick": 2.0, "normal": 3.0}
    plan, _ = chosen(job, durations, PlanSettings(effort="normal", time_limit=10.0))
    assert plan.duration == 2.0
    assert order_note("fixed") in plan.notes
