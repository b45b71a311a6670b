"""Jobs that leave arms and order open, from the file to a plan that passes every check."""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.job import PoseTarget
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.orders.decided_jobs import stage_by_stage
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.verification import verify

QUICK = PlanSettings(effort="quick")
STEPS = PlanSettings(effort="quick", timing="trapezoid")


def changed(job, changes):
    """Returns a job with some tasks changed, by their ids."""
    tasks = [dataclasses.replace(t, **changes.get(t.id, {})) for t in job.tasks]
    return dataclasses.replace(job, tasks=tuple(tasks))


@pytest.fixture(scope="module")
def packing(tasks_folder):
    """Four parts for any arm: one after another, two in a row, two with windows."""
    job = load_job(tasks_folder / "04_packing" / "tasks.yaml")
    names = ("left[1,1]", "left[1,2]", "right[1,1]", "right[1,2]")
    tasks = tuple(dataclasses.replace(t, arm="any") for t in job.tasks if t.id in names)
    job = dataclasses.replace(
        job, tasks=tasks, order="optimise", sequences=(("right[1,1]", "left[1,2]"),)
    )
    return changed(
        job,
        {
            "left[1,1]": {"after": ("right[1,2]",), "not_after": 40.0},
            "right[1,2]": {"not_before": 5.0},
        },
    )


@pytest.fixture(scope="module")
def bricks(tmp_path_factory):
    """The first moves of two robots that build with bricks, in free mode, some of them in need of others."""
    import importlib
    import sys
    from pathlib import Path

    folder = str(Path(__file__).parents[2])
    sys.path.insert(0, folder)
    try:
        gp4 = importlib.import_module("benchmarks.instances.gp4")
    finally:
        sys.path.remove(folder)
    made = {
        mode: load_job(gp4.write_instance("cliff", tmp_path_factory.mktemp(mode), mode))
        for mode in ("paired", "free")
    }
    job = made["free"]
    left = [t for t in job.tasks if t.arm == "left"][:6]
    right = [t for t in job.tasks if t.arm == "right"][:6]
    right[0] = dataclasses.replace(right[0], after=(left[1].id,))
    right[3] = dataclasses.replace(right[3], not_before=2.0)
    left[4] = dataclasses.replace(left[4], after=(right[1].id,))
    made["some"] = dataclasses.replace(job, tasks=(*left, *right))
    return made


@pytest.mark.parametrize("mode", ["paired", "free"])
def test_a_job_with_every_rule_has_a_plan_that_keeps_them(packing, mode):
    """All checks, those of rules among them."""
    job = dataclasses.replace(packing, mode=mode)
    schedule = plan_without_bound(job, QUICK)
    judged = verify(schedule, job, clearance=True)
    assert judged.failures == ()
    verdicts = {check.name: check.verdict for check in judged.checks}
    for name in ("order", "precedence", "windows", "collisions"):
        assert verdicts[name] == "passed", name
    first = min(e.time for e in schedule.events if e.task == "right[1,2]")
    assert first >= 5.0


def same_motion(one, other):
    """Says whether two schedules have the same motion and events, to the last bit."""
    return one.events == other.events and all(
        getattr(one.trajectory, name).tobytes() == getattr(other.trajectory, name).tobytes()
        for name in ("time", "position", "velocity", "acceleration")
    )


@pytest.mark.parametrize("mode", ["paired", "free"])
def test_the_same_settings_give_the_same_motion(bricks, mode):
    """To the last bit."""
    job = dataclasses.replace(bricks["some"], order="optimise", mode=mode)
    first, again = (plan_without_bound(job, STEPS) for _ in range(2))
    assert same_motion(first, again)


@pytest.mark.parametrize("order", ["given", "optimise"])
def test_arms_by_their_own_clocks_keep_precedence_and_windows(bricks, order):
    """Bare moves, which are over as soon as they are there; two robots, no platform."""
    job = bricks["some"]
    if order == "optimise":
        left = [t.id for t in job.tasks if t.arm == "left"]
        job = dataclasses.replace(job, order=order, sequences=((left[2], left[0]),))
    schedule = plan_without_bound(job, STEPS)
    judged = verify(schedule, job, clearance=True)
    assert judged.failures == ()
    verdicts = {check.name: check.verdict for check in judged.checks}
    assert verdicts["precedence"] == verdicts["windows"] == "passed"


def test_clocks_of_their_own_are_never_slower_than_stage_by_stage(bricks):
    """Two robots, 82 and 89 moves: paired every one of 203 steps is waited for by both."""
    paired = plan_without_bound(bricks["paired"], STEPS)
    free = plan_without_bound(bricks["free"], STEPS)
    assert free.duration <= paired.duration
    assert verify(free, bricks["free"]).passed
    assert any("the arms run asynchronously" in note for note in free.notes)


def test_the_first_line_of_a_free_start_waits_as_well(tasks_folder):
    """Two robots that begin at their first lines: one has to wait until the other's part is placed."""
    job = load_job(tasks_folder / "05_two_robots" / "tasks.yaml")
    job = dataclasses.replace(job, mode="free", tasks=job.tasks[:2])
    job = changed(job, {"b": {"after": ("a",)}, "a": {"not_before": 1.0}})
    schedule = plan_without_bound(job, QUICK, check_collisions=False)
    assert verify(schedule, job).failures == ()
    picked = {(e.task, e.action): e.time for e in schedule.events}
    assert picked["a", "pick"] >= 1.0
    assert picked["b", "pick"] > picked["a", "place"]


def test_one_arm_may_be_without_any_task(tasks_folder):
    """All tasks are one robot's, with a rule that must be kept; the other robot only is collision-free."""
    job = load_job(tasks_folder / "05_two_robots" / "tasks.yaml")
    tasks = tuple(t for t in job.tasks if t.id in ("a", "d"))
    job = changed(dataclasses.replace(job, order="optimise", tasks=tasks), {"a": {"after": ("d",)}})
    schedule = plan_without_bound(job, QUICK)
    assert verify(schedule, job, clearance=True).failures == ()
    assert {event.arm for event in schedule.events} == {"left"}


def test_stage_by_stage_what_comes_before_is_over(bricks):
    """Every stage in turn: who is in it has all that it is to come after behind it."""
    job = stage_by_stage(bricks["some"])
    over, left = set(), [task.id for task in job.tasks]
    for work in job.stages():
        for task, stop in work.values():
            assert stop is not task.stops[0] or over.issuperset(task.after)
        over |= {task.id for task, stop in work.values() if stop is task.stops[-1]}
    assert sorted(over) == sorted(left)
    first, later = (next(t.id for t in job.tasks if t.arm == arm) for arm in ("left", "right"))
    ends = [[t.id for t in job.tasks if t.arm == arm][-1] for arm in ("left", "right")]
    tasks = tuple(
        dataclasses.replace(t, after={first: (ends[1],), later: (ends[0],)}.get(t.id, ()))
        for t in job.tasks
    )
    with pytest.raises(InfeasibleError, match="wait forever for tasks that come later"):
        stage_by_stage(dataclasses.replace(job, tasks=tasks, pairing=None))


@pytest.mark.parametrize("mode", ["paired", "free"])
def test_a_window_that_is_too_soon_is_said_with_its_place(packing, mode):
    """Half a second does not do for a pick and a place."""
    job = changed(dataclasses.replace(packing, mode=mode), {"left[1,2]": {"not_after": 0.5}})
    task = next(t for t in job.tasks if t.id == "left[1,2]")
    with pytest.raises(InfeasibleError) as caught:
        plan_without_bound(job, QUICK)
    assert str(task.place) in str(caught.value)
    assert "'left[1,2]' not_after" in str(caught.value)


@pytest.mark.parametrize("mode", ["paired", "free"])
def test_a_target_that_no_arm_reaches_is_said_with_its_place(packing, mode):
    """Five metres up; both arms are named."""
    task = next(t for t in packing.tasks if t.id == "left[1,2]")
    pose = task.stops[0].target.pose.copy()
    pose.translation = np.array([0.0, 0.0, 5.0])
    stops = (dataclasses.replace(task.stops[0], target=PoseTarget(pose)), *task.stops[1:])
    job = changed(dataclasses.replace(packing, mode=mode), {"left[1,2]": {"stops": stops}})
    with pytest.raises(InfeasibleError) as caught:
        plan_without_bound(job, QUICK)
    text = str(caught.value)
    assert text.startswith(f"{task.place}: no arm does task 'left[1,2]'")
    assert "left arm:" in text
    assert "right arm:" in text


@pytest.fixture(scope="module")
def handed(tasks_folder):
    """A hand-over with one task of each arm, in any order; who gives is left open."""
    job = load_job(tasks_folder / "13_hand_over" / "tasks.yaml")
    packing = load_job(tasks_folder / "04_packing" / "tasks.yaml")
    shares = tuple(
        dataclasses.replace(
            task, arm="any", handover=dataclasses.replace(task.handover, giver="any", taker="any")
        )
        for task in job.tasks[:2]
    )
    others = tuple(t for t in packing.tasks if t.id in ("left[1,1]", "right[1,1]"))
    return dataclasses.replace(job, tasks=(*shares, *others), order="optimise")


def test_a_handover_takes_its_place_in_any_order(handed):
    """The planner says who gives: only the left arm gets to the pick, only the right one to the place."""
    schedule = plan_without_bound(handed, PlanSettings(effort="quick", platform="exact"))
    assert [check.name for check in verify(schedule, handed, clearance=True).failures] == []
    arms = {e.action: e.arm for e in schedule.events if e.task == "flip-1"}
    assert arms == {"pick": "left", "give": "left", "take": "right", "place": "right"}
    meets = {
        e.action: k
        for k, stage in enumerate(schedule.stages)
        for e in schedule.events
        if e.task == "flip-1" and stage.start < e.time <= stage.end
    }
    assert meets["pick"] < meets["give"] == meets["take"] < meets["place"]


def test_a_handover_comes_after_what_it_is_to_come_after(handed):
    """The pick after the left arm's task is over, the right arm's task after the place."""
    rules = {"flip-1": {"after": ("left[1,1]",)}, "right[1,1]": {"after": ("flip-1",)}}
    job = changed(handed, rules)
    schedule = plan_without_bound(job, PlanSettings(effort="quick", platform="exact"))
    assert [check.name for check in verify(schedule, job, clearance=True).failures] == []
    first = [event.task for event in schedule.events if event.action == "pick"]
    assert first == ["left[1,1]", "flip-1", "right[1,1]"]


def test_with_arms_left_open_the_file_s_order_is_kept(handed):
    """order: given: each arm does its tasks in the file's order, whoever gives."""
    job = dataclasses.replace(handed, order="given", tasks=(*handed.tasks[2:], *handed.tasks[:2]))
    schedule = plan_without_bound(job, PlanSettings(effort="quick", platform="exact"))
    assert [check.name for check in verify(schedule, job, clearance=True).failures] == []
    picks = [event.task for event in schedule.events if event.action == "pick"]
    assert picks[-1] == "flip-1"


def test_arms_that_cannot_meet_are_told_so(handed):
    """Tools 5 mm from each other that have to keep 10: whoever gives, at any platform angle."""
    near = pin.SE3(pin.utils.rotate("x", np.pi), np.array([0.0, 0.0, 0.005]))
    giving, taking, *others = handed.tasks
    work = dataclasses.replace(giving.handover, grip=near)
    meets = dataclasses.replace(
        taking.stops[0], target=PoseTarget(giving.stops[1].target.pose * near)
    )
    tasks = (
        dataclasses.replace(giving, handover=work),
        dataclasses.replace(taking, handover=work, stops=(meets, taking.stops[1])),
        *others,
    )
    with pytest.raises(InfeasibleError) as caught:
        plan_without_bound(dataclasses.replace(handed, tasks=tasks), QUICK)
    assert "task 'flip-1': neither arm can give while the other one takes" in str(caught.value)
    assert "tasks.yaml:19:7" in str(caught.value)


@pytest.mark.parametrize("order", ["given", "optimise"])
def test_arms_with_clocks_of_their_own_meet_stage_by_stage(handed, order):
    """A note says so; what comes after the hand-over waits for its place, also on the giver's arm."""
    named = [
        dataclasses.replace(
            task, arm=arm, handover=dataclasses.replace(task.handover, giver="left", taker="right")
        )
        for task, arm in zip(handed.tasks[:2], ("left", "right"), strict=True)
    ]
    job = dataclasses.replace(handed, mode="free", order=order, tasks=(*named, *handed.tasks[2:]))
    job = changed(job, {"left[1,1]": {"after": ("flip-1",)}})
    schedule = plan_without_bound(job, PlanSettings(effort="quick", platform="exact"))
    assert [check.name for check in verify(schedule, job, clearance=True).failures] == []
    assert any("hand-overs, both arms start each stage together" in note for note in schedule.notes)
    times = {(e.task, e.action): e.time + e.dwell for e in schedule.events}
    begins = min(
        s.start for s in schedule.segments if s.task == "left[1,1]" and s.kind == "approach"
    )
    assert begins > times["flip-1", "place"]


def test_an_idle_arm_stays_as_it_was_left_wherever_the_platform_turns():
    """Where its last stop is out of reach it is taken as it is at the nearest angle from which that is in reach."""
    from dualarm_cli.orders.model.stage_order_model import _fill_unreachable

    angles = np.array([[0.0], [-1.0], [-0.4], [0.5]])
    seen = np.array([[0.0, np.nan, 2.0, np.nan], [np.nan] * 4, [np.nan, 1.0, np.nan, np.nan]])
    found = _fill_unreachable(seen[..., None], angles)[..., 0]
    np.testing.assert_array_equal(found[0], [0.0, 2.0, 2.0, 0.0])
    assert np.isnan(found[1]).all()
    np.testing.assert_array_equal(found[2], [1.0, 1.0, 1.0, 1.0])
