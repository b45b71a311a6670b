"""What a schedule made of an open job."""

from __future__ import annotations

import dataclasses

from dualarm_cli.verification.as_done import events_by_stage, job_as_done


def test_a_job_that_says_all_is_left_as_it_is(clean):
    """Whatever the schedule does."""
    none = dataclasses.replace(clean.schedule, events=())
    assert job_as_done(none, clean.job) is clean.job
    free = dataclasses.replace(clean.job, mode="free")
    assert job_as_done(clean.schedule, free) is free


def test_tasks_go_to_who_did_them_in_the_order_in_which_they_were_begun(by_clocks):
    """Turn is at its target at 0.8 s, fill at 1.2 s, fit at 4.4 s, look at 4.8 s."""
    done = job_as_done(by_clocks.schedule, by_clocks.job)
    assert [(t.id, t.arm) for t in done.tasks] == [
        ("turn", "right"),
        ("fill", "left"),
        ("fit", "right"),
        ("look", "left"),
    ]
    assert done.is_decided
    assert (done.mode, done.pairing, done.sequences) == ("free", None, by_clocks.job.sequences)
    assert done.tasks[0].not_before == 0.5


def test_what_nobody_did_stays_any_arms_and_what_two_did_is_the_firsts(by_clocks):
    """Turn is not done; the right arm takes fill's place; a robot without the middle arm is none of its."""
    events = []
    for event in by_clocks.schedule.events:
        if event.task == "turn":
            event = dataclasses.replace(event, arm="middle")
        elif event.action == "place" and event.task == "fill":
            event = dataclasses.replace(event, arm="right")
        events.append(event)
    schedule = dataclasses.replace(by_clocks.schedule, events=tuple(events))
    done = job_as_done(schedule, by_clocks.job)
    assert [(t.id, t.arm) for t in done.tasks] == [
        ("fill", "left"),
        ("fit", "right"),
        ("look", "left"),
        ("turn", "any"),
    ]


def open_job(job):
    """Returns the clean job, its arms and order left open."""
    tasks = tuple(dataclasses.replace(task, arm="any") for task in job.tasks)
    return dataclasses.replace(job, tasks=tasks, order="optimise")


def test_the_stages_say_what_was_paired(clean):
    """Two stages of both arms and the return, which is no pair."""
    done = job_as_done(clean.schedule, open_job(clean.job))
    assert done.pairing == tuple(
        (("left", "left-part", action), ("right", "right-part", action))
        for action in ("pick", "place")
    )
    keys = [{arm: (t.id, s.action) for arm, (t, s) in row.items()} for row in done.stages()]
    assert keys == [
        {arm: (f"{arm}-part", action) for arm in ("left", "right")} for action in ("pick", "place")
    ]
    assert done.tasks == clean.job.tasks


def test_a_stage_with_one_arm_and_an_empty_one_keep_their_numbers(clean):
    """The first stage takes no time and no stop; the left arm has nothing to place."""
    first = dataclasses.replace(clean.schedule.stages[0], end=0.0, tasks=())
    job = open_job(clean.job)
    left = dataclasses.replace(job.tasks[0], stops=job.tasks[0].stops[:1])
    events = tuple(e for e in clean.schedule.events if (e.task, e.action) != ("left-part", "place"))
    schedule = dataclasses.replace(
        clean.schedule, stages=(first, *clean.schedule.stages), events=events
    )
    done = job_as_done(schedule, dataclasses.replace(job, tasks=(left, job.tasks[1])))
    assert done.pairing == (
        (),
        (("left", "left-part", "pick"), ("right", "right-part", "pick")),
        (("right", "right-part", "place"),),
    )


def test_what_is_done_again_is_paired_once(clean):
    """The right arm picks in the second stage as well: the first time counts."""
    again = dataclasses.replace(clean.schedule.events[1], time=clean.schedule.events[3].time - 0.1)
    assert (again.arm, again.action) == ("right", "pick")
    schedule = dataclasses.replace(clean.schedule, events=(*clean.schedule.events, again))
    done = job_as_done(schedule, open_job(clean.job))
    assert done.pairing == (
        (("left", "left-part", "pick"), ("right", "right-part", "pick")),
        (("left", "left-part", "place"),),
    )


def test_an_event_on_the_border_of_two_stages_belongs_to_one(clean):
    """Bare moves end with their stage, where the next one starts: each event has the stage that it ends."""
    stages = [
        dataclasses.replace(clean.schedule.stages[0], start=k, end=k + 1.0, tasks=("a", "b"))
        for k in (0.0, 1.0, 2.0)
    ]
    blank = dataclasses.replace(clean.schedule.events[0], dwell=0.0)
    times = {"left": (1.0, 2.0, 3.0), "right": (1.0, 1.0, 2.5)}
    events = [
        dataclasses.replace(blank, time=t, arm=arm, task="a" if arm == "left" else "b")
        for arm, row in times.items()
        for t in row
    ]
    schedule = dataclasses.replace(clean.schedule, stages=tuple(stages), events=tuple(events))
    found = [[(e.arm, e.time) for e in row] for row in events_by_stage(schedule)]
    assert found == [
        [("left", 1.0), ("right", 1.0)],
        [("left", 2.0), ("right", 1.0)],
        [("left", 3.0), ("right", 2.5)],
    ]


def test_an_event_needs_a_stage_that_names_it_is_its_arms_and_has_room_for_its_dwell(clean):
    """Four reasons to be in none, and a fifth: the arm's one stop there is another."""
    stage, event = clean.schedule.stages[0], clean.schedule.events[0]

    def count(events, **changes):
        schedule = dataclasses.replace(
            clean.schedule, stages=(dataclasses.replace(stage, **changes),), events=tuple(events)
        )
        return len(events_by_stage(schedule)[0])

    assert count([event]) == 1
    assert count([event], arm="left") == 1
    assert count([event], arm="right") == 0
    assert count([event], tasks=("right-part",)) == 0
    assert count([event], end=event.time + event.dwell - 1e-6) == 0
    assert count([event], start=event.time + 1e-6) == 0
    assert count([event, event]) == 1
