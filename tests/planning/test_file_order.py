"""The order of the file among those that are found."""

from __future__ import annotations

import dataclasses
import json
from types import SimpleNamespace

import pytest

from dualarm_cli.effort import EFFORTS
from dualarm_cli.errors import BlockedError, InfeasibleError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.orders.decided_jobs import file_order
from dualarm_cli.orders.free_orders import free_orders
from dualarm_cli.orders.watch import Watch
from dualarm_cli.planning import free_ordered_plan, ordered_plan, planner
from dualarm_cli.planning import sections as path_jobs
from dualarm_cli.planning.notes import order_note
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.refusals import Refusal
from dualarm_cli.verification import verify

QUICK = PlanSettings(effort="quick")


def move(name, y, **more):
    """A bare move in front of the robot."""
    return {
        "id": name,
        "arm": "any",
        "move": {"xyz": [0.5, y, 0.85], "rpy": ["180 deg", 0, 0]},
    } | more


@pytest.fixture
def made(tmp_path):
    """Makes a job of tasks in an open order."""
    (tmp_path / "cell.yaml").write_text("dualarm: cell/1\nrobot: sda10f\n")

    def job(tasks, **changes):
        document = {"dualarm": "tasks/1", "cell": "cell.yaml", "order": "optimise", "tasks": tasks}
        (tmp_path / "tasks.yaml").write_text(json.dumps(document | changes))
        return load_job(tmp_path / "tasks.yaml")

    return job


def filed(job):
    """Arms and names in the order of the file, None where that is none."""
    found = file_order(job)
    return found and [(task.arm, task.id) for task in found.tasks]


def test_tasks_stay_in_their_order_and_arms_stay_open(made):
    tasks = [move("a", 0.1), move("b", -0.1), move("c", 0.0, arm="right")]
    assert filed(made(tasks)) == [("any", "a"), ("any", "b"), ("right", "c")]


def test_a_given_order_is_not_among_those_of_a_search(made):
    assert filed(made([move("a", 0.1), move("b", -0.1)], order="given")) is None


def test_a_sequence_that_the_file_tears_apart_is_not_kept(made):
    """One arm does a, b and c in turn: b comes between; next to each other they stay together."""
    tasks = [move(name, 0.1, arm="left") for name in "abc"]
    assert filed(made(tasks, sequences=[["a", "c"]])) is None
    assert filed(made(tasks, sequences=[["b", "c"]])) == [("left", name) for name in "abc"]


def test_a_file_that_brings_what_waits_first_is_planned_in_another_order(made):
    """The first task waits for one of its own arm that comes later."""
    job = made([move("a", 0.1, arm="left", after=["b"]), move("b", 0.1, arm="left")])
    found = plan_without_bound(job, QUICK)
    assert verify(found, job, clearance=True).failures == ()


@pytest.mark.parametrize("mode", ["paired", "free"])
def test_where_the_search_finds_none_the_order_of_the_file_is_planned(made, monkeypatch, mode):
    """On its grid there may be none; and what the file says is said to be of the file."""

    def none(*_, **__):
        raise InfeasibleError(Refusal("no_plan_on_grid"))

    def none_of_the_open(order, *more):
        found = free_orders(order, *more)
        return found if order.job.is_decided else dataclasses.replace(found, ranked=())

    job = made([move("a", 0.3, arm="left"), move("b", -0.3, arm="right")], mode=mode)
    monkeypatch.setattr(ordered_plan.PairedSearch, "of", none)
    monkeypatch.setattr(free_ordered_plan, "free_orders", none_of_the_open)
    monkeypatch.setattr(free_ordered_plan, "epoch_orders", lambda *_: [])
    schedule = plan_without_bound(job, QUICK)
    assert verify(schedule, job, clearance=True).failures == ()
    assert order_note("of_file") in schedule.notes
    assert schedule.order_grid_gap is None
    monkeypatch.setattr(planner, "file_order", lambda _: None)
    with pytest.raises(InfeasibleError, match="on the grid"):
        plan_without_bound(job, QUICK)


def test_where_every_order_collides_one_arm_does_the_tasks_of_either(made, monkeypatch):
    """The faster one of the two arms; a task of a fixed arm stays with it."""

    def blocked(*_, **__):
        raise BlockedError(Refusal("not_clear"), stages=(0,))

    monkeypatch.setattr(ordered_plan, "_searched", blocked)
    job = made([move("a", 0.3), move("b", 0.1), move("c", -0.4, arm="right")])
    schedule = plan_without_bound(job, QUICK)
    assert verify(schedule, job, clearance=True).failures == ()
    arms = {event.task: event.arm for event in schedule.events}
    assert arms["a"] == arms["b"] and arms["c"] == "right"
    assert order_note("one_arm") in schedule.notes
    alone = []
    for arm in ("left", "right"):
        tasks = [move("a", 0.3, arm=arm), move("b", 0.1, arm=arm), move("c", -0.4, arm="right")]
        alone.append(plan_without_bound(made(tasks, order="given"), QUICK).duration)
    assert schedule.duration == pytest.approx(min(alone), abs=1e-9)


def test_the_files_order_is_planned_where_a_joint_without_an_arms_load_is_overloaded(
    made, monkeypatch
):
    """Weight that no arm carries, such as on the platform, excludes no arms: those of the file are searched."""
    searched, calls = ordered_plan._searched, []

    def blocked_at_first(*arguments, **named):
        calls.append(arguments)
        if len(calls) == 1:
            raise BlockedError(Refusal("not_clear"), stages=())
        return searched(*arguments, **named)

    monkeypatch.setattr(ordered_plan, "_searched", blocked_at_first)
    schedule = plan_without_bound(made([move("a", 0.3), move("b", -0.3)]), QUICK)
    assert order_note("of_file") in schedule.notes


def test_an_open_order_is_not_slower_than_the_same_file_with_its_order_given(made, monkeypatch):
    """Also where the search estimates less than its plan takes: nothing better than one stop after the other."""

    def one_by_one(search, orders, settings, watch, planned):
        job = file_order(search.order.job)
        pairing = tuple((key,) for stage in job.stages() for key in keys(stage))
        one = ordered_plan.DecidedOrder(dataclasses.replace(job, pairing=pairing), 9.0)
        return planned(one, orders, repair_touching_stops=True)

    def keys(stage):
        return [(arm, task.id, stop.action) for arm, (task, stop) in stage.items()]

    tasks = [move("a", 0.3, arm="left"), move("b", -0.3, arm="right"), move("c", 0.1, arm="left")]
    job = made(tasks, **{"return": True})
    given = plan_without_bound(dataclasses.replace(job, order="given"), QUICK)
    monkeypatch.setattr(ordered_plan, "_searched", one_by_one)
    found = plan_without_bound(job, QUICK)
    assert found.duration <= given.duration
    assert verify(found, job, clearance=True).failures == ()


def test_by_own_clocks_the_order_of_the_file_is_planned_as_well(made, monkeypatch):
    """Also where the search has another one first."""

    def reversed_orders(order, *more):
        found = free_orders(order, *more)
        if order.job.is_decided:
            return found
        tasks = found.ranked[0].job.tasks[::-1]
        job = dataclasses.replace(found.ranked[0].job, tasks=tasks)
        return dataclasses.replace(found, ranked=(dataclasses.replace(found.ranked[0], job=job),))

    tasks = [move(f"m{k}", 0.6 - 0.15 * k, arm="left") for k in range(4)]
    job = made(tasks, mode="free", start="free")
    given = plan_without_bound(dataclasses.replace(job, order="given"), QUICK)
    monkeypatch.setattr(free_ordered_plan, "free_orders", reversed_orders)
    found = plan_without_bound(job, QUICK)
    assert found.duration <= given.duration


def test_between_paths_the_order_of_the_file_is_planned_as_well(made, monkeypatch):
    """Also where the search for an order of what is between them finds none."""

    def none(*_, **__):
        raise InfeasibleError(Refusal("no_plan_on_grid"))

    points = [{"xyz": [0.5, 0.1, 0.85], "rpy": ["180 deg", 0, 0]}, {"xyz": [0.55, 0.1, 0.85]}]
    path = {"id": "path", "path": {"arm": "left", "speed": 0.1, "through": points}}
    job = made([move("a", 0.3, arm="left"), move("b", -0.3, arm="right"), path])
    given = plan_without_bound(dataclasses.replace(job, order="given"), QUICK)
    assert plan_without_bound(job, QUICK).duration <= given.duration
    monkeypatch.setattr(path_jobs.PairedSearch, "of", none)
    found = plan_without_bound(job, QUICK)
    assert found.duration == given.duration
    assert any("the file's order of all tasks is the fastest" in note for note in found.notes)


def test_an_order_of_the_file_that_is_far_slower_is_not_planned(made):
    """To and fro eight times, which the platform need not do; in the order of where they are it is planned as well."""
    where = (-0.45, 0.45, -0.35, 0.35, -0.25, 0.25, -0.15, 0.15, -0.05, 0.05)
    told = []
    for ys in (where, sorted(where)):
        tasks = [move(f"t{k}", y, arm="left") for k, y in enumerate(ys)]
        watch = Watch(report=lambda text: told[-1].append(text))
        told.append([])
        job = made(tasks, **{"return": True})
        schedule = plan_without_bound(job, QUICK, watch)
        assert verify(schedule, job, clearance=True).failures == ()
        assert watch.file_order_best is None or watch.file_order_best >= watch.best - 1e-9
    assert "planning the file's order" not in told[0]
    assert "planning the file's order" in told[1]


@pytest.mark.parametrize(
    ("duration", "filed", "left_out"),
    [(9.0, 10.81, True), (9.0, 10.79, False), (10.1, 20.0, False), (9.0, None, False)],
)
def test_it_is_left_out_where_the_plan_is_as_quick_as_the_search_said(duration, filed, left_out):
    """The best order takes 10 s as the search times it, with all stops: what blending gains does not count."""
    watch = Watch(best=10.0, file_order_best=filed)
    for plan in (
        SimpleNamespace(duration=duration, blend_gain=None),
        SimpleNamespace(duration=duration - 2.0, blend_gain=2.0),
    ):
        assert planner._is_slower_as_filed(plan, watch, EFFORTS["quick"].trials) == left_out
