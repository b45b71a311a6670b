"""Plans with parts on conveyors: met where they are then, in their windows, both arms in one stage each at its time."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dualarm_cli.clearing.clear_plan import quickest_clear
from dualarm_cli.clearing.repairs import TimedPlan
from dualarm_cli.errors import InfeasibleError, UnsupportedError
from dualarm_cli.exporting.schedule_json import to_json
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinds.conveyor import planning as conveyor_plan
from dualarm_cli.kinds.conveyor.measures import conveyor_lines, conveyor_rows
from dualarm_cli.kinds.conveyor.meeting import MeetingTime
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.motion.motion import realise
from dualarm_cli.planning.planner import plan, plan_without_bound
from dualarm_cli.report.report import build_report
from dualarm_cli.stages.platform_moves import stage_move
from dualarm_cli.verification import verify

GREEDY = PlanSettings(platform="minimum_time", effort="quick")
BELT = np.array([0.0, -0.15, 0.0])


def timed(job, windows):
    """Returns a job in which parts pass at other times, or with another `within`, by task."""

    def changed(task, stop):
        if stop.belt is None or task.id not in windows:
            return stop
        passes, within = windows[task.id]
        belt = dataclasses.replace(stop.belt, passes=passes, within=within, at=passes)
        return dataclasses.replace(stop, belt=belt)

    tasks = tuple(
        dataclasses.replace(task, stops=tuple(changed(task, stop) for stop in task.stops))
        for task in job.tasks
    )
    return dataclasses.replace(job, tasks=tasks)


@pytest.fixture(scope="module")
def belt(tasks_folder):
    """The shipped job with four parts on a belt."""
    return load_job(tasks_folder / "15_conveyor" / "tasks.yaml")


@pytest.fixture(scope="module")
def planned(belt):
    """Its plan by the method that is quickest to ask."""
    return plan(belt, GREEDY)


def test_every_part_is_met_where_it_is_then(belt, planned):
    """By the file's own numbers: pose plus 0.15 m/s along -y since it passes; and every check, clearance proven."""
    verification = verify(planned, belt, clearance=True)
    assert verification.passed, verification.failures
    passes = {t.id: (t.stops[0].belt.passes, t.stops[0].target.pose) for t in belt.tasks}
    picks = [event for event in planned.events if event.action == "pick"]
    assert len(picks) == 4
    for event in picks:
        since, pose = event.time - passes[event.task][0], passes[event.task][1]
        assert -1e-9 <= since <= 0.5 / 0.15 + 1e-9
        assert event.pose.translation == pytest.approx(pose.translation + since * BELT, abs=1e-9)
        assert event.velocity == pytest.approx(tuple(BELT))
    assert all(not event.moves for event in planned.events if event.action == "place")
    assert planned.lower_bound is None


@given(
    zero=st.floats(0.2, 3.0),
    slope=st.floats(-0.9, 0.9),
    bend=st.floats(-0.05, 0.05),
    begin=st.floats(0.0, 1.0),
)
def test_the_meeting_time_is_found_wherever_the_arm_is_how_soon(zero, slope, bend, begin):
    """When the arm can be there changes by up to 0.95 s with every second: no earlier, and later by 1 ms at most."""

    def arrival(time):
        return zero + slope * (time - begin) + bend * np.sin(time - begin)

    one = MeetingTime(0.0, 100.0, begin)
    for _ in range(14):
        if one.note(arrival(one.time)):
            break
        assert one.next()
    time, spare = one.possible
    assert spare == pytest.approx(time - arrival(time))
    assert 0.0 <= spare <= 1e-3 or time == 0.0


def test_there_is_no_meeting_time_where_the_last_is_too_early():
    """An arm that can be there at 5 s however soon the part is to be met does not get it by 4 s."""
    one = MeetingTime(1.0, 4.0, 1.0)
    assert not one.note(5.0)
    assert one.next()
    assert one.time == 4.0
    assert not one.note(5.0)
    assert not one.next()


def test_what_is_reported_is_what_was_done(belt, planned):
    """A row for every part, its sentence in millimetres, and the velocity in schedule.json."""
    report = build_report(planned, belt)
    assert [row["task"] for row in report["conveyors"]] == [
        e.task for e in planned.events if e.action == "pick"
    ]
    for row, line in zip(report["conveyors"], conveyor_lines(report), strict=True):
        assert row["gone"] == pytest.approx(0.15 * (row["time"] - row["passes"]))
        assert f"{row['task']} picked by the {row['arm']} arm" in line
        assert f"{max(0.0, row['gone']) * 1e3:.0f} mm on of 500 mm" in line
    named = [{**row, "conveyor": "belt [1]"} for row in report["conveyors"]]
    assert conveyor_lines({"conveyors": named})[0].startswith("conveyor belt [1]: ")
    assert report["sensitivity"] == []
    assert b"".join(to_json(planned, "robot.urdf", {})).count(b'"velocity": [0.0, -0.15, 0.0]') == 4
    assert any("the cycle repeats every" in note for note in planned.notes)


def test_another_velocity_or_time_is_no_longer_kept(belt, planned):
    """The same schedule fails for a belt or parts that are 1 % off: the checks are about this job."""
    stop = belt.tasks[0].stops[0]
    conveyor = dataclasses.replace(stop.belt.conveyor, velocity=1.01 * BELT)
    for change in ({"conveyor": conveyor}, {"passes": 0.51, "at": 0.51}):
        other = dataclasses.replace(stop, belt=dataclasses.replace(stop.belt, **change))
        task = dataclasses.replace(belt.tasks[0], stops=(other, *belt.tasks[0].stops[1:]))
        job = dataclasses.replace(belt, tasks=(task, *belt.tasks[1:]))
        assert "conveyor_part" in {check.name for check in verify(planned, job).failures}


def test_both_arms_of_a_stage_meet_their_parts_each_at_its_time(belt):
    """The second part comes 2 s after the first can be met; alone the stage would have both arms there at once."""
    job = dataclasses.replace(belt, tasks=belt.tasks[:2])
    far = dataclasses.replace(
        job.tasks[1].stops[0].target,
        pose=job.tasks[1].stops[0].target.pose.copy(),
    )
    far.pose.translation = np.array([0.60, -0.25, 0.80])
    stop = dataclasses.replace(job.tasks[1].stops[0], target=far)
    task = dataclasses.replace(job.tasks[1], stops=(stop, job.tasks[1].stops[1]))
    job = timed(
        dataclasses.replace(job, tasks=(job.tasks[0], task)),
        {"part-1": (0.5, 0.3), "part-2": (3.5, 0.1)},
    )
    found = plan_without_bound(job, GREEDY)
    assert verify(found, job).passed
    one, other = conveyor_rows(found, job)
    assert one["time"] < 2.0
    assert 3.5 <= other["time"] <= 3.5 + 0.1 / 0.15
    assert other["waited"] > 1.0
    [wait] = [s for s in found.segments if s.reason == "conveyor" and s.end - s.start > 1.0]
    assert (wait.arm, wait.task) == ("right", "part-2")


def test_an_order_is_found_in_which_parts_are_in_time(belt):
    """In the file's order the arm would wait 9 s for the first part, and the second would be gone."""
    tasks = tuple(task for task in belt.tasks if task.arm == "left")
    job = timed(
        dataclasses.replace(belt, tasks=tasks), {"part-1": (9.0, 0.3), "part-3": (0.5, 0.3)}
    )
    with pytest.raises(InfeasibleError, match=r"part-3.*cannot be at the pick before"):
        plan_without_bound(job, GREEDY)
    free = dataclasses.replace(job, order="optimise")
    found = plan_without_bound(free, GREEDY)
    assert verify(found, free).passed
    assert [e.task for e in found.events] == ["part-3", "part-3", "part-1", "part-1"]


def test_what_cannot_be_in_time_is_told_with_its_window(belt):
    """Nobody is 0.5 m away after 0.1 s: the task, the time, how far the part is, and the window in m and s."""
    job = timed(belt, {"part-2": (0.1, 0.015)})
    with pytest.raises(InfeasibleError) as caught:
        plan_without_bound(job, GREEDY)
    words = str(caught.value)
    assert "tasks.yaml:" in words
    assert "task 'part-2': the right arm cannot be at the pick before" in words
    # 15 mm at 0.15 m/s take 0.1 s.
    assert "conveyor 'belt' (0.15 m/s) passes at 0.1 s and is 0.015 m farther at 0.200 s" in words
    assert "; give a later 'passes'" in words


def test_clocks_of_their_own_go_stage_by_stage(belt):
    """With a note that says so."""
    job = dataclasses.replace(belt, tasks=belt.tasks[:2], mode="free")
    found = plan_without_bound(job, GREEDY)
    assert verify(found, job).passed
    assert any("start each stage together" in note for note in found.notes)


def test_placing_on_a_belt_gives_the_part_when_the_dwell_is_over(belt):
    """A place on a conveyor is met and followed as a pick is."""
    one = belt.tasks[0]
    pick, place = one.stops
    swapped = (
        dataclasses.replace(pick, target=place.target, belt=None),
        dataclasses.replace(place, target=pick.target, belt=pick.belt),
    )
    job = timed(
        dataclasses.replace(belt, tasks=(dataclasses.replace(one, stops=swapped),)),
        {"part-1": (2.0, 0.4)},
    )
    found = plan_without_bound(job, GREEDY)
    assert verify(found, job).passed
    [row] = conveyor_rows(found, job)
    assert (row["action"], row["task"]) == ("place", "part-1")
    assert 2.0 - 1e-9 <= row["time"] <= 2.0 + 0.4 / 0.15


def test_a_single_move_does_not_know_when_parts_are_met(belt):
    """`dualarm platform` has no clock."""
    with pytest.raises(UnsupportedError, match="conveyor"):
        stage_move(belt, 1)


def test_an_arm_that_turns_out_late_for_its_part_meets_it_later(belt, monkeypatch):
    """Avoiding collisions lets the left arm wait 0.3 s each time: the plan is made again with that much more time."""
    calls = []

    def repaired(problem, solve, timing, **how):
        found = quickest_clear(problem, solve, timing, **how)
        first, *others = found.cleared.plans
        plans = [dataclasses.replace(first, waits={"left": 0.3}), *others]
        motion = realise(problem.model, problem.job, plans, timing)
        calls.append(motion.events[0])
        return dataclasses.replace(found, cleared=TimedPlan(plans, motion))

    job = dataclasses.replace(belt, tasks=belt.tasks[:1])
    monkeypatch.setattr(conveyor_plan, "quickest_clear", repaired)
    found = plan_without_bound(job, GREEDY, check_collisions=False)
    assert len(calls) >= 2
    # The first one was late for the part, and no check would have passed it.
    assert verify(found, job).passed
    [wait] = [s for s in found.segments if s.reason == "shared_zone"]
    assert wait.end - wait.start == pytest.approx(0.3)


def test_lateness_counts_where_it_comes_up():
    """0.2 s late in a first stage and 0.3 s in a third: 0.2 and 0.1 s more; all of it if it was in time between."""

    def stop(task, at):
        belt = SimpleNamespace(at=at)
        return SimpleNamespace(
            stop=SimpleNamespace(action="pick", belt=belt), task=SimpleNamespace(id=task)
        )

    def event(task, time):
        return SimpleNamespace(arm="left", task=task, action="pick", time=time)

    plans = [
        SimpleNamespace(stops={"left": stop(task, at)})
        for task, at in zip("abc", (1.0, 3.0, 4.0), strict=True)
    ]
    late = SimpleNamespace(events=[event("a", 1.2), event("b", 3.2), event("c", 4.3)])
    found = SimpleNamespace(cleared=SimpleNamespace(plans=plans, motion=late))
    assert conveyor_plan._delays(found, late) == pytest.approx({(0, "left"): 0.2, (2, "left"): 0.1})
    back = SimpleNamespace(events=[event("a", 1.2), event("b", 3.0), event("c", 4.3)])
    again = SimpleNamespace(cleared=SimpleNamespace(plans=plans, motion=back))
    assert conveyor_plan._delays(again, back) == pytest.approx({(0, "left"): 0.2, (2, "left"): 0.3})
