# ruff: noqa: E501 (tables of exact messages, one a line)
"""Tools that are taken and left: a planned schedule passes, and every change of it that breaks a rule is named."""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinds.tool_change.checks import check_tool_changes
from dualarm_cli.model.schedule import Event
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.model.shape import Shape
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.verification import verify
from dualarm_cli.verification.as_done import job_as_done


@pytest.fixture(scope="module")
def job(tasks_folder):
    """A plate by suction, then a screw by fingers, by the left arm; one screw by the right one; as the file has them."""
    job = load_job(tasks_folder / "14_two_grippers" / "tasks.yaml")
    tasks = tuple(t for t in job.tasks if t.id in ("plate-1", "screw-1", "screw-3"))
    return dataclasses.replace(job, tasks=tasks, order="given")


@pytest.fixture(scope="module")
def schedule(job):
    """Planned."""
    return plan_without_bound(job, PlanSettings(effort="quick"))


LEAVE, TAKE = "leave fingers (plate-1)", "take suction (plate-1)"
BACK, AGAIN = "leave suction (screw-1)", "take fingers (screw-1)"


def names(schedule, arm="left"):
    """Returns task and action of an arm's events in time."""
    own = sorted((e for e in schedule.events if e.arm == arm), key=lambda e: e.time)
    return [(e.task, e.action) for e in own]


def test_a_planned_change_passes_every_check(schedule, job):
    """What comes when, the time at the stands, lines of 80 mm there, clearance of tools that are on."""
    assert names(schedule) == [
        (LEAVE, "leave_tool"),
        (TAKE, "take_tool"),
        ("plate-1", "pick"),
        ("plate-1", "place"),
        (BACK, "leave_tool"),
        (AGAIN, "take_tool"),
        ("screw-1", "pick"),
        ("screw-1", "place"),
    ]
    judged = verify(schedule, job, clearance=True)
    assert judged.failures == ()
    verdicts = {check.name: check.verdict for check in judged.checks}
    for name in ("tool_changes", "order", "pairing", "dwells", "line_lengths", "collisions"):
        assert verdicts[name] == "passed", name
    stands = job.cell.tool_changes["left"].tools
    for event in schedule.events:
        if event.action in ("take_tool", "leave_tool"):
            stand = stands["fingers" if "fingers" in event.task else "suction"].stand
            assert np.abs(event.pose.homogeneous - stand.homogeneous).max() < 1e-9
            assert event.dwell == 0.8


def only(events):
    """Returns what `check_tool_changes` sees of events by name, one second apart, at the stands of named tools."""

    def made(job):
        tools = job.cell.tool_changes["left"].tools
        found = []
        for k, (task, action) in enumerate(events):
            pose = pin.SE3.Identity()
            if action in ("take_tool", "leave_tool"):
                pose = tools[task.split()[1]].stand
            found.append(Event(float(k), "left", task, action, "left_tcp", pose, 0.8))
        return tuple(found)

    return made


PLATE = [("plate-1", "pick"), ("plate-1", "place")]
SCREW = [("screw-1", "pick"), ("screw-1", "place")]
THERE = [("leave fingers 1", "leave_tool"), ("take suction 1", "take_tool")]
HOME = [("leave suction 2", "leave_tool"), ("take fingers 2", "take_tool")]


@pytest.mark.parametrize(
    ("events", "fault"),
    [
        ([*THERE, *PLATE, *HOME, *SCREW], ""),
        ([*THERE, *PLATE, (THERE[1][0], "leave_tool"), HOME[1], *SCREW], "take suction 1 is the name of 2 visits to stands"),
        ([*SCREW, *THERE, *PLATE, *HOME], ""),
        ([*PLATE, *SCREW], "plate-1 pick has tool fingers mounted; it needs tool suction"),
        ([*THERE, *PLATE, *SCREW], "screw-1 pick has tool suction mounted; it needs tool fingers"),
        ([*SCREW, *THERE, *PLATE], "suction is mounted at the end, fingers at the start"),
        ([THERE[1], *PLATE, *HOME, *SCREW], "take suction 1: suction is taken while fingers is mounted"),
        ([THERE[0], *PLATE, *HOME, *SCREW], "plate-1 pick has no tool mounted; it needs tool suction"),
        ([HOME[0], THERE[1], *PLATE, *HOME, *SCREW], "leave suction 2: fingers is left at the stand of suction"),
        ([*THERE, PLATE[0], *HOME, PLATE[1], *SCREW], "leave suction 2 is done within plate-1"),
        ([*THERE, *HOME, *SCREW, ("leave fingers 3", "leave_tool"), ("take suction 3", "take_tool"), *PLATE, ("leave suction 4", "leave_tool"), ("take fingers 4", "take_tool")], "leave suction 2: suction is left without having been used for a task"),
        ([THERE[0], HOME[1], *SCREW], "fingers was already mounted before screw-1"),
        ([THERE[0], ("leave fingers 5", "leave_tool"), THERE[1], *PLATE, *HOME, *SCREW], "leave fingers 5: fingers is left, but no tool is mounted"),
        ([*THERE, *PLATE, *HOME, *SCREW, ("leave fingers 3", "leave_tool"), ("take fingers 4", "take_tool")], "tools are changed after the last task, to fingers, for nothing"),
    ],
)  # fmt: skip
def test_what_is_on_is_followed_from_event_to_event(schedule, job, events, fault):
    """Missing, wrong, doubled and useless changes, changes within a task, and a cycle that does not close."""
    check = check_tool_changes(dataclasses.replace(schedule, events=only(events)(job)), job)
    assert check.verdict == ("failed" if fault else "passed"), check.detail
    assert fault in check.detail


def test_one_way_the_tool_of_the_start_need_not_be_on_again(schedule, job):
    """But what nobody asks for is not changed at the end either."""
    once = dataclasses.replace(job, returns=False)
    for events, verdict in (
        ([*SCREW, *THERE, *PLATE], "passed"),
        ([*SCREW, *THERE, *PLATE, *HOME], "failed"),
    ):
        own = dataclasses.replace(schedule, events=only(events)(job))
        assert check_tool_changes(own, once).verdict == verdict


def with_events(schedule, change):
    """Returns the schedule with other events: what `change` makes of each, None for nothing."""
    events = tuple(new for event in schedule.events if (new := change(event)) is not None)
    return dataclasses.replace(schedule, events=events)


def without_stage(schedule, task):
    """Returns the schedule without what it says of a task: event, segments, name in its stage."""
    return dataclasses.replace(
        with_events(schedule, lambda e: None if e.task == task else e),
        segments=tuple(
            dataclasses.replace(s, task="", action="", kind="wait") if s.task == task else s
            for s in schedule.segments
        ),
        stages=tuple(
            dataclasses.replace(s, tasks=tuple(t for t in s.tasks if t != task))
            for s in schedule.stages
        ),
    )


def failed(schedule, job, **kinds):
    """Returns the names of the checks that fail."""
    return {check.name for check in verify(schedule, job, **kinds).failures}


def test_a_change_that_is_left_out_is_missed(schedule, job):
    """Whichever of the four."""
    for task in (LEAVE, TAKE, BACK, AGAIN):
        assert "tool_changes" in failed(without_stage(schedule, task), job)


def test_a_stand_is_where_the_cell_has_it(schedule, job):
    """A tool is left a millimetre beside its stand: the cell's, not the schedule's, counts."""
    changes = job.cell.tool_changes["left"]
    fingers = changes.tools["fingers"]
    moved = fingers.stand * pin.SE3(np.eye(3), np.array([1e-3, 0.0, 0.0]))
    tools = {**changes.tools, "fingers": dataclasses.replace(fingers, stand=moved)}
    own = dataclasses.replace(changes, tools=tools)
    cell = dataclasses.replace(job.cell, tool_changes={"left": own})
    assert failed(schedule, dataclasses.replace(job, cell=cell)) == {"events_at_targets"}


@pytest.mark.parametrize(
    ("change", "check"),
    [({"time": 0.9}, "dwells"), ({"approach": 0.09}, "line_lengths"), ({"retract": 0.07}, "line_lengths")],
)  # fmt: skip
def test_times_and_lines_at_stands_are_those_of_the_cell(schedule, job, change, check):
    """A longer time, a longer or shorter line: the schedule's are too short or too long then."""
    own = dataclasses.replace(job.cell.tool_changes["left"], **change)
    cell = dataclasses.replace(job.cell, tool_changes={"left": own})
    assert check in failed(schedule, dataclasses.replace(job, cell=cell))


def test_a_task_with_another_tool_is_refused(schedule, job):
    """The file asks for fingers for the plate: the changes are useless then, and the plate is done with suction."""
    tasks = tuple(dataclasses.replace(t, tool="fingers" if t.tool else "") for t in job.tasks)
    assert failed(schedule, dataclasses.replace(job, tasks=tasks)) == {"tool_changes"}


def test_other_stages_than_those_of_the_changes_are_refused(schedule, job):
    """The right arm's first stop is the left arm's first visit's partner, not its pick's."""
    stages = list(schedule.stages)
    assert sorted(stages[0].tasks) == [LEAVE, "screw-3"]
    stages[0] = dataclasses.replace(stages[0], tasks=("plate-1", "screw-3"))
    own = dataclasses.replace(schedule, stages=tuple(stages))
    assert "pairing" in failed(own, job)


def test_tools_count_only_while_they_are_on(schedule, job):
    """A huge suction cup touches the robot; not where suction is never taken, and not while the fingers are on."""
    judged = {}
    for name in ("suction", "fingers"):
        changes = job.cell.tool_changes["left"]
        tool = changes.tools[name]
        huge = dataclasses.replace(
            tool.tool, shapes=(Shape("sphere", (0.35,), pin.SE3.Identity()),)
        )
        tools = {**changes.tools, name: dataclasses.replace(tool, tool=huge)}
        own = dataclasses.replace(changes, tools=tools)
        cell = dataclasses.replace(job.cell, tool_changes={"left": own})
        found = verify(schedule, dataclasses.replace(job, cell=cell), clearance=True)
        judged[name] = [stage for stage in found.clearances if stage.margin < 0.0]
    begin, end = (next(e.time for e in schedule.events if e.task == task) for task in (TAKE, BACK))
    assert judged["suction"]
    placed = next(e.time for e in schedule.events if (e.task, e.action) == ("plate-1", "place"))
    assert any(stage.time > placed + 1.0 for stage in judged["suction"])
    assert all(begin - 1e-6 <= stage.time <= end + 0.8 + 1e-6 for stage in judged["suction"])
    assert judged["fingers"]
    left = next(e.time for e in schedule.events if e.task == LEAVE) + 0.8
    again = next(e.time for e in schedule.events if e.task == AGAIN)
    assert not any(left + 1e-6 < stage.time < again - 1e-6 for stage in judged["fingers"])
    assert any(stage.time < left for stage in judged["fingers"])
    assert any(stage.time > again for stage in judged["fingers"])


def test_changes_of_a_schedule_become_tasks_before_what_they_are_for(schedule, job):
    """In the file's order where it is given, by time where it is open; what no arm may do is no change."""
    ids = [task.id for task in job_as_done(schedule, job).tasks if task.arm == "left"]
    assert ids == [LEAVE, TAKE, "plate-1", BACK, AGAIN, "screw-1"]
    free = dataclasses.replace(job, order="optimise")
    assert [t.id for t in job_as_done(schedule, free).tasks if t.arm == "left"] == ids
    assert failed(schedule, free) == set()
    plain = dataclasses.replace(job, cell=dataclasses.replace(job.cell, tool_changes={}))
    assert [task.id for task in job_as_done(schedule, plain).tasks] == [t.id for t in job.tasks]
    assert "order" in failed(schedule, plain)


def test_a_visit_with_the_name_of_another_one_is_no_way_around_the_stand(schedule, job):
    """Taken half a metre beside its stand under the name of what was left: all other checks know visits by name."""

    def elsewhere(event):
        if event.task != TAKE:
            return event
        pose = pin.SE3(event.pose.rotation, event.pose.translation + np.array([0.0, 0.0, 0.5]))
        return dataclasses.replace(event, task=LEAVE, pose=pose, dwell=0.0)

    fooled = with_events(schedule, elsewhere)
    assert "tool_changes" in [check.name for check in verify(fooled, job).failures]


@pytest.mark.parametrize(("raised", "verdict"), [(0.0, "passed"), (0.0155, "failed")])
def test_a_tool_at_its_stand_need_not_keep_clear_of_it_but_not_reach_into_it(
    schedule, job, raised, verdict
):
    """The changer's face at 0.95 m, fingers 95 mm longer, the rack's top at 0.84 m: 15 mm where 16 are asked."""

    def lifted(obstacle):
        pose = obstacle.shape.pose.copy()
        pose.translation = pose.translation + np.array([0.0, 0.0, raised])
        return dataclasses.replace(obstacle, shape=dataclasses.replace(obstacle.shape, pose=pose))

    obstacles = tuple(lifted(o) if o.name == "rack" else o for o in job.cell.obstacles)
    pair = ("left_fingers", "rack", 0.016)
    cell = dataclasses.replace(job.cell, obstacles=obstacles, clearances=(pair,))
    check = verify(schedule, dataclasses.replace(job, cell=cell), clearance=True).checks[-1]
    assert (check.name, check.verdict) == ("collisions", verdict)
    if raised:
        assert "left_fingers and rack" in check.detail
        assert "0.5 mm of penetration" in check.detail
