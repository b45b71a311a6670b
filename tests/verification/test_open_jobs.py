"""Plans of jobs that leave arms and order open, broken one way at a time."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.schedule import Segment
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.verification import verify

OTHER = {"left": "right", "right": "left"}


@pytest.fixture(scope="module")
def planned(tasks_folder):
    """Four parts for any arm, two of them in a sequence, one after another; a plan, and who does what in it."""
    job = load_job(tasks_folder / "04_packing" / "tasks.yaml")
    names = ("left[1,1]", "left[1,2]", "right[1,1]", "right[1,2]")
    tasks = tuple(
        dataclasses.replace(t, arm="any", after=("right[1,2]",) if t.id == "left[1,1]" else ())
        for t in job.tasks
        if t.id in names
    )
    job = dataclasses.replace(
        job, tasks=tasks, order="optimise", sequences=(("right[1,1]", "left[1,2]"),)
    )
    schedule = plan_without_bound(job, PlanSettings(effort="quick", platform="fixed"))
    doer = {event.task: event.arm for event in schedule.events}
    return SimpleNamespace(job=job, schedule=schedule, doer=doer)


def with_task(job, name, **changes):
    """Returns the job with one task changed."""
    tasks = [dataclasses.replace(t, **changes) if t.id == name else t for t in job.tasks]
    return dataclasses.replace(job, tasks=tuple(tasks))


def instants(schedule, name):
    """Returns when a task is at its targets."""
    return sorted(event.time for event in schedule.events if event.task == name)


def test_the_plan_passes_every_check_and_none_is_left_out(planned):
    """Order and precedence among them; windows are not asked for."""
    judged = verify(planned.schedule, planned.job, clearance=True)
    assert judged.failures == ()
    verdicts = {check.name: check.verdict for check in judged.checks}
    for name in ("order", "precedence", "pairing", "stages", "segments", "dwells", "line_lengths"):
        assert verdicts[name] == "passed", name
    assert verdicts["collisions"] == "passed"
    assert verdicts["windows"] == "not checked"


def test_a_task_that_is_handed_over_is_found(planned, failing):
    """The other arm is said to place what one has picked."""
    name, arm = "left[1,1]", planned.doer["left[1,1]"]
    events = tuple(
        dataclasses.replace(e, arm=OTHER[arm]) if (e.task, e.action) == (name, "place") else e
        for e in planned.schedule.events
    )
    found = failing(dataclasses.replace(planned.schedule, events=events), planned.job)
    assert found["order"] == "left[1,1] is done by left and right; one arm does all of a task"
    # Nor is the other arm there.
    assert "tool_position_at_events" in found


def test_a_task_that_is_left_out_is_found(planned, failing):
    """Its segments are waits, in which the arm moves, no stage names it: its targets and its lines are missing."""
    name = "left[1,2]"
    schedule = dataclasses.replace(
        planned.schedule,
        events=tuple(e for e in planned.schedule.events if e.task != name),
        segments=tuple(
            Segment(s.arm, "wait", "", "", s.start, s.end) if s.task == name else s
            for s in planned.schedule.segments
        ),
        stages=tuple(
            dataclasses.replace(s, tasks=tuple(task for task in s.tasks if task != name))
            for s in planned.schedule.stages
        ),
    )
    found = failing(schedule, planned.job)
    assert set(found) == {"order", "line_lengths", "segment_kinds"}
    assert found["order"] == "left[1,2] pick is not done"
    less = tuple(task for task in planned.job.tasks if task.id != name)
    job = dataclasses.replace(planned.job, tasks=less, sequences=())
    assert set(failing(schedule, job)) == {"segment_kinds"}
    # The other way round: a schedule that does more than it was asked for.
    assert (
        failing(planned.schedule, job)["order"] == "left[1,2] pick is done, which no task requires"
    )


def test_a_target_that_is_done_twice_is_found(planned, failing):
    """All about it is right, but that it is there."""
    again = next(e for e in planned.schedule.events if e.task == "right[1,2]")
    schedule = dataclasses.replace(planned.schedule, events=(*planned.schedule.events, again))
    assert failing(schedule, planned.job) == {"order": "right[1,2] pick is done 2 times"}


def test_an_arm_that_may_not_is_named(planned, failing):
    """The same plan for a file in which the task is the other arm's; its lines are due of that arm."""
    arm = planned.doer["left[1,1]"]
    found = failing(planned.schedule, with_task(planned.job, "left[1,1]", arm=OTHER[arm]))
    assert found["order"] == f"left[1,1] is the {OTHER[arm]} arm's, the {arm} arm does it"
    assert set(found) == {"order", "line_lengths", "pairing"}
    assert failing(planned.schedule, with_task(planned.job, "left[1,1]", arm=arm)) == {}


def test_a_task_before_what_it_waits_for_is_found(planned, failing):
    """The file asks for the reverse: the one begins as much too early as both take together."""
    job = with_task(
        with_task(planned.job, "left[1,1]", after=()), "right[1,2]", after=("left[1,1]",)
    )
    found = failing(planned.schedule, job)
    assert set(found) == {"precedence"}
    assert found["precedence"].startswith("right[1,2] begins at ")


@pytest.mark.parametrize("late", [False, True])
def test_a_window_that_is_missed_is_found(planned, failing, late):
    """By a microsecond; a nanosecond less than it takes is still right."""
    first, last = instants(planned.schedule, "left[1,2]")
    name = "left[1,2]"
    off = {"not_after": last - 1e-6} if late else {"not_before": first + 1e-6}
    assert set(failing(planned.schedule, with_task(planned.job, name, **off))) == {"windows"}
    on = with_task(planned.job, name, not_before=first, not_after=last)
    assert failing(planned.schedule, on) == {}


def test_a_sequence_that_is_not_done_as_one_is_found(planned, failing):
    """The reverse of what was asked, and one of tasks of both arms or with others between them."""
    one, other = "right[1,1]", "left[1,2]"
    job = dataclasses.replace(planned.job, sequences=((other, one),))
    found = failing(planned.schedule, job)
    assert set(found) == {"order"}
    assert f"{one} must follow {other} directly" in found["order"]
    job = dataclasses.replace(planned.job, sequences=(("right[1,2]", "left[1,2]"),))
    assert set(failing(planned.schedule, job)) == {"order"}


def test_the_files_order_is_asked_for_where_it_is_given(planned, failing):
    """The plan's own order of tasks is right for order: given, the reverse is not for an arm with two of them."""
    begun = {task.id: instants(planned.schedule, task.id)[0] for task in planned.job.tasks}
    in_order = sorted(planned.job.tasks, key=lambda task: begun[task.id])
    given = dataclasses.replace(planned.job, order="given", sequences=(), tasks=tuple(in_order))
    assert failing(planned.schedule, given) == {}
    back = dataclasses.replace(given, tasks=tuple(in_order[::-1]))
    found = failing(planned.schedule, back)
    assert set(found) == {"order"}
    assert found["order"].endswith("not as order: given has it")


def test_an_arm_that_starts_a_stage_late_is_found(planned, failing):
    """A microsecond of the first transfer of a stage of both arms is a wait before it; an arm in motion moves in it."""
    both = next(stage for stage in planned.schedule.stages if len(set(stage.tasks)) == 2)
    segments = []
    for segment in planned.schedule.segments:
        starts = abs(segment.start - both.start) < 1e-9 and segment.kind == "transfer"
        if starts and segment.arm == "right":
            begin = segment.start
            segments.append(Segment("right", "wait", "", "", begin, begin + 1e-6))
            segment = dataclasses.replace(segment, start=begin + 1e-6)
        segments.append(segment)
    number = planned.schedule.stages.index(both) + 1
    found = failing(dataclasses.replace(planned.schedule, segments=tuple(segments)), planned.job)
    assert found.pop("pairing") == f"the arms do not start stage {number} together"
    assert all("the arm moves" in detail for detail in found.values())


def test_names_that_are_exchanged_are_found_by_the_targets(planned, failing):
    """Two tasks' names exchanged everywhere: the order may be as good, the tools are not where the tasks are."""
    swap = {"left[1,2]": "right[1,2]", "right[1,2]": "left[1,2]"}

    def renamed(rows):
        return tuple(dataclasses.replace(row, task=swap.get(row.task, row.task)) for row in rows)

    schedule = dataclasses.replace(
        planned.schedule,
        events=renamed(planned.schedule.events),
        segments=renamed(planned.schedule.segments),
        stages=tuple(
            dataclasses.replace(s, tasks=tuple(swap.get(task, task) for task in s.tasks))
            for s in planned.schedule.stages
        ),
    )
    free = dataclasses.replace(planned.job, sequences=())
    free = with_task(free, "left[1,1]", after=())
    assert set(failing(schedule, free)) == {"events_at_targets"}


def test_a_paired_plan_is_one_by_clocks_as_well_and_not_the_reverse(planned, by_clocks, failing):
    """Both arms' stages are stages by clocks; stages by clocks pair nothing."""
    assert failing(planned.schedule, dataclasses.replace(planned.job, mode="free")) == {}
    paired = dataclasses.replace(by_clocks.job, mode="paired")
    assert set(failing(by_clocks.schedule, paired)) == {"stages", "pairing"}
