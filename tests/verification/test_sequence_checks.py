"""Order, pairing, dwells, segments, start and end: every fault is found by its own check."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from dualarm_cli.model.dwell import Dwell
from dualarm_cli.model.schedule import Event, Segment
from dualarm_cli.verification import verify
from dualarm_cli.verification.measuring.tool_model import ToolModel
from dualarm_cli.verification.order_checks import check_dwells


def replaced(rows, index, **changes):
    """Returns rows with one of them changed."""
    rows = list(rows)
    rows[index] = dataclasses.replace(rows[index], **changes)
    return tuple(rows)


def find(schedule, arm, kind, action):
    """Returns the index of a segment."""
    return [(s.arm, s.kind, s.action) for s in schedule.segments].index((arm, kind, action))


def test_stops_in_another_order_are_found(clean, failing):
    """The job wants the left arm to place before it picks: order, and with it the stages."""
    task = clean.job.tasks[0]
    job = dataclasses.replace(
        clean.job, tasks=(dataclasses.replace(task, stops=task.stops[::-1]), clean.job.tasks[1])
    )
    found = failing(clean.schedule, job)
    assert set(found) == {"order", "pairing"}
    assert found["order"] == "left arm: expected left-part place, found left-part pick"


def test_an_event_that_is_missing_is_named_as_due(clean, failing):
    """The last of the left arm; its lines and its transfer lead nowhere, its stage has no such target."""
    events = tuple(
        event for event in clean.schedule.events if (event.arm, event.action) != ("left", "place")
    )
    found = failing(dataclasses.replace(clean.schedule, events=events), clean.job)
    assert set(found) == {"order", "pairing", "lines_straight", "dwells", "segment_kinds"}
    assert found["dwells"] == "left-part (place) stands still without an event"
    assert found["order"] == "left arm: expected left-part place, found nothing"


def test_an_event_that_nobody_asked_for_is_named(clean, failing):
    """The right arm picks twice; everything about the second is right but that it is there."""
    again = clean.schedule.events[1]
    schedule = dataclasses.replace(clean.schedule, events=(*clean.schedule.events, again))
    found = failing(schedule, clean.job)
    assert found == {"order": "right arm: expected right-part place, found right-part pick"}


@pytest.mark.parametrize("what", ["events", "segments"])
def test_work_of_an_arm_that_the_robot_does_not_have_is_a_finding(clean, failing, what):
    """Not a crash: `arms` names it, all other work is judged as before."""
    rows = replaced(getattr(clean.schedule, what), 0, arm="middle")
    found = failing(dataclasses.replace(clean.schedule, **{what: rows}), clean.job)
    kind = what[:-1]
    assert found["arms"] == f"{kind} of left-part names arm 'middle'; the robot has left, right"
    assert ("order" in found) == (what == "events")


def test_a_gap_between_stages_is_found(clean, failing):
    """The second starts 10 ms after the first has ended."""
    start = clean.schedule.stages[1].start + 0.01
    stages = replaced(clean.schedule.stages, 1, start=start)
    found = failing(dataclasses.replace(clean.schedule, stages=stages), clean.job)
    assert found == {"stages": "stage 2 does not start where the one before ends"}


def test_a_last_stage_that_ends_before_the_motion_is_found(clean, failing):
    """By 0.1 s."""
    stages = replaced(clean.schedule.stages, -1, end=clean.schedule.duration - 0.1)
    found = failing(dataclasses.replace(clean.schedule, stages=stages), clean.job)
    assert found == {"stages": "the last stage does not end the motion"}
    assert failing(dataclasses.replace(clean.schedule, stages=stages)) == found


def test_a_stage_that_is_missing_is_named(clean, failing):
    """One stage for two pairs of targets."""
    stage = dataclasses.replace(clean.schedule.stages[0], end=clean.schedule.duration)
    found = failing(dataclasses.replace(clean.schedule, stages=(stage,)), clean.job)
    assert found == {"pairing": "stage 2 is missing"}


def test_a_target_outside_its_stage_is_named(clean, failing):
    """The first stage ends at 1 s, before the picks at 1.2 s."""
    stages = replaced(clean.schedule.stages, 0, end=1.0)
    stages = replaced(stages, 1, start=1.0)
    found = failing(dataclasses.replace(clean.schedule, stages=stages), clean.job)
    assert found == {"pairing": "left-part (pick) is outside stage 1"}


def test_segments_that_overlap_are_found(clean, failing):
    """The left arm's transfer ends 0.1 s after its approach has begun; the same of the other arm is none."""
    k = find(clean.schedule, "left", "transfer", "pick")
    segments = replaced(clean.schedule.segments, k, end=0.9)
    found = failing(dataclasses.replace(clean.schedule, segments=segments), clean.job)
    assert found == {"segments": "left approach of left-part at 0.800 s"}


@pytest.mark.parametrize("times", [{"start": -0.1}, {"start": 0.5, "end": 0.4}])
def test_segments_before_the_start_or_with_negative_length_are_found(clean, failing, times):
    """Of the right arm's first transfer."""
    k = find(clean.schedule, "right", "transfer", "pick")
    segments = replaced(clean.schedule.segments, k, **times)
    found = failing(dataclasses.replace(clean.schedule, segments=segments), clean.job)
    assert found == {
        "segments": f"right transfer of right-part at {times['start']:.3f} s",
        "pairing": "the arms do not start stage 1 together",
    }


def test_segments_beyond_the_end_are_found(clean, failing):
    """The return of the right arm lasts 0.1 s longer than the motion."""
    end = clean.schedule.duration + 0.1
    segments = replaced(clean.schedule.segments, -1, end=end)
    found = failing(dataclasses.replace(clean.schedule, segments=segments), clean.job)
    assert found == {"segments": "right arm works beyond the end"}


def test_a_dwell_beyond_the_end_is_found(clean, failing):
    """The tool rests where it is when the motion is over, but the next cycle begins: 0.5 s are not there."""
    schedule = clean.schedule
    end = schedule.duration
    pose = ToolModel(schedule).pose("left", schedule.trajectory.position[-1])
    late = Event(end, "left", "left-part", "move", "left_tcp", pose, 0.5)
    found = failing(dataclasses.replace(schedule, events=(*schedule.events, late)))
    assert found["segments"] == "dwell of left-part (move) goes beyond the end"
    # The motion's last segment is listed as a return, which nothing follows.
    assert set(found) == {"segments", "segment_kinds"}


def test_a_schedule_without_segments_and_events_is_not_judged_by_them(clean):
    """The reason is given."""
    bare = dataclasses.replace(clean.schedule, segments=(), events=(), stages=())
    check = next(c for c in verify(bare).checks if c.name == "segments")
    assert (check.verdict, check.detail) == ("not checked", "the schedule lists none")


def test_a_dwell_that_is_too_short_is_named(clean, failing):
    """0.4 s where the job asks for 0.41 s; longer than asked is allowed."""
    for gripper, expected in ((0.31, {"dwells"}), (0.29, set())):
        task = clean.job.tasks[1]
        stops = replaced(task.stops, 0, dwell=Dwell(gripper, 0.06, 0.04))
        job = dataclasses.replace(
            clean.job, tasks=(clean.job.tasks[0], dataclasses.replace(task, stops=stops))
        )
        found = failing(clean.schedule, job)
        assert set(found) == expected
        assert found.get("dwells", "right-part (pick)").startswith("right-part (pick)")


def test_a_dwell_that_is_too_short_is_named_also_where_no_segments_are_listed(clean, failing):
    """Events alone say 0.4 s; the job asks the right arm for 0.41 s and for no lines."""

    def bare(stop, gripper):
        return dataclasses.replace(stop, approach=0, retract=0, dwell=Dwell(gripper, 0.06, 0.04))

    tasks = tuple(
        dataclasses.replace(task, stops=tuple(bare(stop, gripper) for stop in task.stops))
        for task, gripper in zip(clean.job.tasks, (0.3, 0.31), strict=True)
    )
    job = dataclasses.replace(clean.job, tasks=tasks)
    schedule = dataclasses.replace(clean.schedule, segments=())
    assert failing(schedule, job) == {"dwells": "right-part (pick) dwells 0.4 s"}


def test_a_start_in_another_posture_names_the_joint(clean, failing):
    """l3 of the posture is 1e-8 rad elsewhere; `free` leaves the start open."""
    robot = clean.job.cell.robot
    posture = np.array(robot.postures["ready"])
    posture[3] += 1e-8
    robot = dataclasses.replace(robot, postures={"ready": posture})
    job = dataclasses.replace(clean.job, cell=dataclasses.replace(clean.job.cell, robot=robot))
    assert failing(clean.schedule, job) == {"start_posture": "l3 from posture 'ready'"}
    free = dataclasses.replace(job, start="free")
    assert failing(clean.schedule, free) == {}
    check = next(c for c in verify(clean.schedule, free).checks if c.name == "start_posture")
    assert check.verdict == "not checked"


def test_a_motion_that_does_not_return_names_the_joint(clean, moved, failing):
    """The last move takes r3 0.01 rad further; a job that does not return does not mind."""
    arrays = {
        name: np.array(getattr(clean.schedule.trajectory, name))
        for name in ("position", "velocity", "acceleration")
    }
    h, d = 0.2, 0.01
    arrays["position"][-4:, 6] += d * np.array([1 / 12, 1 / 2, 11 / 12, 1])
    arrays["velocity"][-4:, 6] += d / h * np.array([1 / 4, 1 / 2, 1 / 4, 0])
    arrays["acceleration"][-4:, 6] += d / h**2 * np.array([1 / 2, 0, -1 / 2, 0])
    schedule = moved(clean.schedule, **arrays)
    assert failing(schedule, clean.job) == {"return": "r3"}
    assert failing(schedule, dataclasses.replace(clean.job, returns=False)) == {}


def test_a_stage_that_runs_backwards_is_found(clean, failing):
    """The first ends after the second, which starts there: no gap, but the second has negative length."""
    late = clean.schedule.duration + 1
    stages = replaced(replaced(clean.schedule.stages, 0, end=late), 1, start=late)
    found = failing(dataclasses.replace(clean.schedule, stages=stages))
    assert found == {"stages": "stage 2 ends before it starts"}


def test_arms_that_do_not_start_a_stage_together_are_found(clean, failing):
    """The right arm is said to wait for 0.1 s before its first transfer; nothing is missing or overlaps."""
    k = find(clean.schedule, "right", "transfer", "pick")
    segments = list(replaced(clean.schedule.segments, k, start=0.1))
    segments.insert(k, Segment("right", "wait", "", "", 0.0, 0.1))
    found = failing(dataclasses.replace(clean.schedule, segments=tuple(segments)), clean.job)
    assert set(found) == {"pairing", "segment_kinds"}
    assert found["pairing"] == "the arms do not start stage 1 together"
    assert found["segment_kinds"].startswith("right wait from 0.0000 to 0.1000 s: the arm moves")


@pytest.mark.parametrize(
    ("stage", "tasks", "detail"),
    [
        (
            0,
            ("ghost", "right-part"),
            "names ghost, right-part; the tasks are left-part, right-part",
        ),
        (1, (), "names no task; the tasks are left-part, right-part"),
        (2, ("left-part",), "names left-part; the tasks are no task"),
    ],
)
def test_a_stage_that_names_other_tasks_is_found(clean, failing, stage, tasks, detail):
    """Two stages of work and the return, which works on nothing."""
    stages = replaced(clean.schedule.stages, stage, tasks=tasks)
    found = failing(dataclasses.replace(clean.schedule, stages=stages), clean.job)
    assert found == {"pairing": f"stage {stage + 1} {detail}"}


@pytest.mark.parametrize("kind", ["transfer", "wait"])
def test_time_of_an_arm_of_which_nothing_is_said_is_found(clean, failing, kind):
    """0.1 s less of the transfer that follows a retract; as a wait of its own it is no gap, but the arm moves."""
    k = find(clean.schedule, "left", "transfer", "place")
    start = clean.schedule.segments[k].start
    segments = list(clean.schedule.segments)
    segments[k] = dataclasses.replace(segments[k], start=start + 0.1)
    if kind == "wait":
        segments.insert(k, Segment("left", "wait", "", "", start, start + 0.1))
    found = failing(dataclasses.replace(clean.schedule, segments=tuple(segments)))
    if kind == "wait":
        assert set(found) == {"segment_kinds"}
    else:
        assert found == {"segments": f"left transfer of left-part at {start + 0.1:.3f} s"}


def test_an_arm_whose_segments_end_early_is_found(clean, failing):
    """The return of the right arm is not listed."""
    segments = clean.schedule.segments[:-1]
    found = failing(dataclasses.replace(clean.schedule, segments=segments))
    end = clean.schedule.segments[-1].start
    assert found == {"segments": f"the right arm has no segment from {end:.3f} s to the end"}


@pytest.mark.parametrize(
    ("changes", "detail"),
    [
        ({"dwell": Dwell(9.0, 0.06, 0.04)}, "has shares that do not add up to its length"),
        ({"dwell": Dwell(0.2, 0.16, 0.04)}, "has too short a share: gripper"),
        ({"kind": "wait"}, "has no dwell listed"),
        ({"task": "ghost"}, "stands still without an event"),
        ({"dwell": None}, ""),
    ],
)
def test_a_dwell_that_is_listed_wrongly_is_found(clean, failing, changes, detail):
    """The left arm's first, 0.3 s of gripper, 0.06 s of settling, 0.04 s of handshake."""
    k = find(clean.schedule, "left", "dwell", "pick")
    segments = replaced(clean.schedule.segments, k, **changes)
    found = failing(dataclasses.replace(clean.schedule, segments=segments), clean.job)
    task = changes.get("task", "left-part")
    assert found == ({"dwells": f"{task} (pick) {detail}"} if detail else {})


@pytest.mark.parametrize(
    ("changes", "off", "detail"),
    [
        ({"start": 1.25, "end": 1.65}, 0.05, "does not stand still from its event on"),
        ({"end": 1.55}, 0.05, "lasts 0.35 s, its event states 0.4 s"),
        ({"end": 1.7}, 0.1, "lasts 0.5 s, its event states 0.4 s"),
    ],
)
def test_a_dwell_that_is_not_the_time_of_its_event_is_found(clean, changes, off, detail):
    """The left arm picks from 1.2 s to 1.6 s; shares are not stated, so that they cannot tell."""
    k = find(clean.schedule, "left", "dwell", "pick")
    segments = replaced(clean.schedule.segments, k, dwell=None, **changes)
    check = check_dwells(dataclasses.replace(clean.schedule, segments=segments), clean.job)
    assert (check.verdict, check.detail) == ("failed", f"left-part (pick) {detail}")
    assert check.measured == pytest.approx(off)


def test_a_short_dwell_is_found_by_its_event_alone(clean):
    """No segments are listed; the event stands still for 0.3 s where the job asks for 0.4 s."""
    events = replaced(clean.schedule.events, 0, dwell=0.3)
    schedule = dataclasses.replace(clean.schedule, events=events, segments=())
    check = check_dwells(schedule, clean.job)
    assert (check.verdict, check.detail) == ("failed", "left-part (pick) dwells 0.3 s")
    assert check.measured == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("over", "expected"), [(-0.1, set()), (0.0, set()), (0.1, {"lower_bound"})]
)
def test_a_bound_above_the_duration_is_no_bound(clean, failing, over, expected):
    """A schedule cannot be faster than a bound on every schedule."""
    bound = clean.schedule.duration + over
    assert set(failing(dataclasses.replace(clean.schedule, lower_bound=bound))) == expected
