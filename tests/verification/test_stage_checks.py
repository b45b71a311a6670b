"""Stages of asynchronous arms, and pairing where the file leaves it open."""

from __future__ import annotations

import dataclasses

import pytest

from dualarm_cli.model.schedule import Segment
from dualarm_cli.verification import verify
from dualarm_cli.verification.as_done import job_as_done
from dualarm_cli.verification.stage_checks import check_pairing, check_stages


def open_job(job):
    """Returns the clean job, its arms and order left open."""
    tasks = tuple(dataclasses.replace(task, arm="any") for task in job.tasks)
    return dataclasses.replace(job, tasks=tasks, order="optimise")


def changed(schedule, **by_number):
    """Returns a schedule with stages changed: s1 for the first."""
    stages = list(schedule.stages)
    for name, changes in by_number.items():
        number = int(name[1:]) - 1
        stages[number] = dataclasses.replace(stages[number], **changes)
    return dataclasses.replace(schedule, stages=tuple(stages))


def test_a_schedule_by_clocks_passes_with_and_without_its_job(by_clocks):
    """Stages overlap in time, waits are between them; of pairing nothing is asked."""
    judged = verify(by_clocks.schedule, by_clocks.job)
    assert judged.failures == ()
    checks = {check.name: check for check in judged.checks}
    for name in ("stages", "order", "precedence", "windows", "dwells", "events_at_targets"):
        assert checks[name].verdict == "passed"
    assert checks["pairing"].verdict == "not checked"
    assert checks["pairing"].detail == "the arms run asynchronously"
    assert verify(by_clocks.schedule).failures == ()


# In order of their start: 1 fill pick 0-2 s, 2 turn 0-0.8 s, 3 fill place 2-4 s, 4 fit pick 3.2-5.2 s, 5 look 4-4.8 s,
# 6 return of the left arm 4.8-5.6 s, 7 fit place 5.2-7.2 s, 8 return of the right arm 7.2-8 s.
@pytest.mark.parametrize(
    ("changes", "measured", "detail"),
    [
        ({"s3": {"start": 1.9}}, 0.1, "stage 3 starts before the left arm has finished stage 1"),
        ({"s1": {"end": 2.1}}, 0.1, "stage 3 starts before the left arm has finished stage 1"),
        ({"s2": {"start": 0.9}}, 0.1, "stage 2 ends before it starts"),
        ({"s1": {"start": -0.1}}, 0.1, "stage 1 starts before the motion"),
        ({"s8": {"end": 8.1}}, 0.1, "stage 8 ends after the motion"),
        ({"s8": {"arm": ""}}, None, None),
        (
            {"s6": {"arm": "", "start": 5.3}},
            0.4,
            "stage 7 starts before the right arm has finished stage 6",
        ),
        ({"s4": {"arm": ""}}, 1.2, "stage 5 starts before the left arm has finished stage 4"),
        ({"s4": {"start": 3.3}}, None, None),
        ({"s4": {"end": 5.1}}, None, None),
        ({"s1": {"arm": "right"}}, 0.8, "stage 1 starts before the right arm has finished stage 2"),
        # The longest overlap, with the stage that lasts longest.
        (
            {
                "s1": {"end": 4.6},
                "s3": {"start": 3.9, "end": 4.1},
                "s5": {"start": 1.0, "end": 8.0},
            },
            3.6,
            "stage 5 starts before the left arm has finished stage 1",
        ),
        # No length, a picosecond after the next one's start or before the end of the one before.
        ({"s3": {"start": 4.0 + 1e-12, "end": 4.0 + 1e-12, "tasks": ()}}, None, None),
        ({"s3": {"start": 2.0 - 1e-12, "end": 2.0 - 1e-12, "tasks": ()}}, None, None),
    ],
)
def test_stages_of_one_arm_and_of_both_do_not_overlap(by_clocks, changes, measured, detail):
    """By how much, and the stage that comes too early; gaps are waits. A stage with no arm is both arms'."""
    # What is done in stages is another matter.
    schedule = dataclasses.replace(changed(by_clocks.schedule, **changes), events=())
    check = check_stages(schedule, by_clocks.job)
    assert check.verdict == ("passed" if detail is None else "failed")
    if detail is not None:
        assert check.measured == pytest.approx(measured, abs=1e-9)
        assert check.detail == detail


@pytest.mark.parametrize(
    ("changes", "detail"),
    [
        (
            {"s1": {"tasks": ("look",)}},
            "fill (pick) at 1.200 s is within none of the left arm's stages that name it",
        ),
        ({"s6": {"tasks": ("look",)}}, "stage 6 names look, which has no stop in it"),
        (
            {"s2": {"tasks": ("turn", "fit")}},
            "stage 2 names fit, which has no stop in it",
        ),
        (
            {"s4": {"end": 4.7}},
            "fit (pick) at 4.400 s is within none of the right arm's stages that name it",
        ),
        (
            {"s3": {"start": 3.3}},
            "fill (place) at 3.200 s is within none of the left arm's stages that name it",
        ),
        (
            {"s1": {"end": 4.0}, "s3": {"start": 4.0}},
            "fill (place) is more than one stop of the left arm in stage 1",
        ),
    ],
)
def test_each_stage_has_its_own_arms_one_stop(by_clocks, changes, detail):
    """Which event is in none, or which stage has none; with and without a job."""
    schedule = changed(by_clocks.schedule, **changes)
    for job in (by_clocks.job, None):
        check = check_stages(schedule, job)
        assert (check.verdict, check.measured, check.detail) == ("failed", None, detail)


def test_a_stage_of_an_arm_that_the_robot_does_not_have_is_a_finding(by_clocks):
    """And no stage is where the arm's own was."""
    found = verify(changed(by_clocks.schedule, s2={"arm": "middle"}), by_clocks.job)
    failures = {check.name: check.detail for check in found.failures}
    assert failures["arms"] == "stage 2 names arm 'middle'; the robot has left, right"
    assert "turn (move) at 0.800 s" in failures["stages"]


def test_without_a_job_one_stage_of_one_arm_tells_that_arms_go_by_their_own_clocks(clean):
    """A stage of both arms from 0 to 1 s, the left one's until the end, the right one's for a second."""
    end = clean.schedule.duration
    spans = (("", 0.0, 1.0), ("left", 1.0, end), ("right", 1.0, 2.0))
    template = clean.schedule.stages[0]
    stages = tuple(
        dataclasses.replace(template, arm=arm, start=start, end=over) for arm, start, over in spans
    )
    schedule = dataclasses.replace(clean.schedule, stages=stages, events=())
    assert check_stages(schedule).verdict == "passed"
    assert check_stages(schedule, clean.job).verdict == "failed"


def test_paired_arms_have_no_stages_of_their_own(by_clocks, clean, measured_lines):
    """Overlapping they fail as before; one after the other they are still no pairs."""
    paired = dataclasses.replace(by_clocks.job, mode="paired")
    assert check_stages(by_clocks.schedule, paired).verdict == "failed"
    schedule = changed(clean.schedule, s2={"arm": "left"})
    for job in (clean.job, open_job(clean.job)):
        assert check_stages(schedule, job).verdict == "passed"
        lines = measured_lines(schedule, job)
        check = check_pairing(schedule, job_as_done(schedule, job), lines)
        assert check.detail == (
            "stage 2 is the left arm's alone, but with mode: paired both arms start every stage together"
        )
        assert check.verdict == "failed"


def test_both_arms_may_play_a_paired_schedule_by_their_clocks(clean):
    """Every stage is both arms'; paired is one way to go by clocks."""
    free = dataclasses.replace(open_job(clean.job), mode="free")
    assert verify(clean.schedule, free).failures == ()


def test_an_open_job_is_held_to_the_pairs_of_the_stages(clean, failing, measured_lines):
    """As it is, no fault; the checks of a job that says all would find the same pairs."""
    job = open_job(clean.job)
    assert failing(clean.schedule, job) == {}
    done = job_as_done(clean.schedule, job)
    lines = measured_lines(clean.schedule, job)
    expected = check_pairing(clean.schedule, clean.job, lines)
    assert check_pairing(clean.schedule, done, lines) == expected


def test_open_arms_that_do_not_start_a_stage_together_are_found(clean, failing):
    """The right arm is said to wait for 0.1 s before its first transfer; it moves from 0 s on."""
    segments = list(clean.schedule.segments)
    k = [(s.arm, s.kind, s.action) for s in segments].index(("right", "transfer", "pick"))
    segments[k] = dataclasses.replace(segments[k], start=0.1)
    segments.insert(k, Segment("right", "wait", "", "", 0.0, 0.1))
    schedule = dataclasses.replace(clean.schedule, segments=tuple(segments))
    found = failing(schedule, open_job(clean.job))
    assert set(found) == {"pairing", "segment_kinds"}
    assert found["pairing"] == "the arms do not start stage 1 together"


@pytest.mark.parametrize(
    ("changes", "detail"),
    [
        (
            {"s1": {"tasks": ("left-part",)}},
            "right-part (pick) at 1.200 s is within none of the right arm's stages that name it",
        ),
        (
            {"s1": {"tasks": ("left-part", "right-part", "ghost")}},
            "stage 1 names left-part, right-part, ghost; the tasks are left-part, right-part",
        ),
        ({"s3": {"tasks": ("left-part",)}}, "stage 3 names left-part; the tasks are no task"),
    ],
)
def test_a_stage_of_an_open_job_that_names_other_tasks_is_found(clean, failing, changes, detail):
    """Two stages of work and the return."""
    found = failing(changed(clean.schedule, **changes), open_job(clean.job))
    assert found == {"pairing": detail}


def test_two_stops_of_one_arm_in_one_stage_are_no_pair(clean, failing):
    """The first stage goes on to the end of the second, which has no length."""
    end = clean.schedule.stages[1].end
    schedule = changed(clean.schedule, s1={"end": end}, s2={"start": end, "tasks": ()})
    found = failing(schedule, open_job(clean.job))
    assert found == {
        "pairing": "left-part (place) is more than one stop of the left arm in stage 1"
    }


def test_an_open_job_needs_stages(clean, failing):
    """Without them nothing says what is paired."""
    schedule = dataclasses.replace(clean.schedule, stages=())
    found = failing(schedule, open_job(clean.job))
    assert found == {
        "pairing": "left-part (pick) at 1.200 s is within none of the left arm's stages that name it"
    }


def side_by_side(by_clocks, measured_lines, late):
    """The check of two tasks side by side of which the right arm's begins late [s], and says so nowhere.

    Left: picks until 2.0 s and goes on at once. What it does until the right arm has picked is called its transfer to
    the pick, so that by the list both start the second stage together.
    """
    tasks = {task.id: dataclasses.replace(task, after=()) for task in by_clocks.job.tasks}
    own = (dataclasses.replace(tasks["fill"], arm="left"), tasks["fit"])
    job = dataclasses.replace(by_clocks.job, tasks=own, mode="paired", order="given", sequences=())
    waits = [(late, "partner")] if late else []
    schedule = by_clocks.play(left=["fill"], right=[*waits, "fit"])
    border = 2.0 + late
    segments = []
    for s in schedule.segments:
        if (s.arm, s.kind, s.action) == ("left", "transfer", "place") and late:
            segments.append(dataclasses.replace(s, action="pick", end=border))
            s = dataclasses.replace(s, start=border)
        if (s.kind, s.reason) == ("wait", "partner"):
            s = dataclasses.replace(s, task="fit", action="pick")
        segments.append(s)
    first = schedule.stages[0]
    names = (("fill", "fit"), ("fill", "fit"), ())
    edges = (0.0, border, border + 2.0, schedule.duration)
    stages = tuple(
        dataclasses.replace(first, start=start, end=end, tasks=tasks, arm="")
        for start, end, tasks in zip(edges, edges[1:], names, strict=False)
    )
    schedule = dataclasses.replace(schedule, segments=tuple(segments), stages=stages)
    return check_pairing(schedule, job, measured_lines(schedule, job)), verify(schedule, job)


def test_an_arm_that_goes_on_before_the_other_one_is_done_is_seen_in_the_motion(
    by_clocks, measured_lines
):
    """By 0.3 s; both arms' knots are 0.1 s apart, joints are looked at four times between them: 0.275 s are seen."""
    check, whole = side_by_side(by_clocks, measured_lines, 0.0)
    assert (check.verdict, whole.passed) == ("passed", True)
    check, whole = side_by_side(by_clocks, measured_lines, 0.3)
    assert check.verdict == "failed"
    assert check.measured == pytest.approx(0.275, abs=1e-9)
    # It leaves the second stage for its return as early.
    assert check.detail.startswith("the left arm leaves stage ")
    assert {"pairing", "segment_kinds"} <= {c.name for c in whole.failures}
