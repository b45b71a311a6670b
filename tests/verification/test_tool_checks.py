"""Poses, dwells, lines, targets and the platform: every fault is found by its own check."""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.model.dwell import Dwell
from dualarm_cli.model.job import JointTarget
from dualarm_cli.model.motion.joint_motion import JointMotion
from dualarm_cli.model.schedule import Segment
from dualarm_cli.verification import verify

LINK, TCP, LINE = 0.4, 0.1, 0.05
APPROACH, DWELL = 4, 8
"""First knots of the first approach and the first dwell, each of four intervals of 0.1 s."""


def with_event(schedule, index, **changes):
    """Returns the schedule with one event changed."""
    events = list(schedule.events)
    events[index] = dataclasses.replace(events[index], **changes)
    return dataclasses.replace(schedule, events=tuple(events))


def with_segments(schedule, change):
    """Returns the schedule with every segment replaced by change(segment); None drops it."""
    segments = tuple(new for s in schedule.segments if (new := change(s)) is not None)
    return dataclasses.replace(schedule, segments=segments)


def with_stop(job, arm, action, **changes):
    """Returns the job with one stop changed."""
    tasks = []
    for task in job.tasks:
        stops = tuple(
            dataclasses.replace(stop, **changes)
            if (task.arm, stop.action) == (arm, action)
            else stop
            for stop in task.stops
        )
        tasks.append(dataclasses.replace(task, stops=stops))
    return dataclasses.replace(job, tasks=tuple(tasks))


def shifted(pose, x=0.0, y=0.0, z=0.0):
    """Returns a pose moved along its own axes."""
    return pose * pin.SE3(np.eye(3), np.array([x, y, z]))


def turned(pose, axis, angle):
    """Returns a pose turned about one of its own axes."""
    return pose * pin.SE3(pin.utils.rotate(axis, angle), np.zeros(3))


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_an_event_two_micrometres_from_its_tool_is_found(clean, failing, axis):
    """At its instant, throughout its dwell and, with the job, from its target; half a micrometre is none."""
    pose = clean.schedule.events[3].pose
    at_event = {"tool_position_at_events", "tool_still_in_dwells"}
    far = with_event(clean.schedule, 3, pose=shifted(pose, **{axis: 2e-6}))
    assert set(found := failing(far)) == at_event
    assert found["tool_position_at_events"] == "right-part (place) at 3.200000 s"
    assert set(found := failing(far, clean.job)) == at_event | {"events_at_targets"}
    assert found["events_at_targets"].startswith("right-part (place)")
    near = with_event(clean.schedule, 3, pose=shifted(pose, **{axis: 0.5e-6}))
    assert failing(near, clean.job) == {}


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_an_event_turned_by_two_microradians_is_found(clean, failing, axis):
    """As above, for angles."""
    pose = clean.schedule.events[0].pose
    far = with_event(clean.schedule, 0, pose=turned(pose, axis, 2e-6))
    assert set(found := failing(far, clean.job)) == {
        "tool_angle_at_events",
        "tool_steady_in_dwells",
        "events_at_targets",
    }
    assert found["tool_angle_at_events"] == "left-part (pick) at 1.200000 s"
    near = with_event(clean.schedule, 0, pose=turned(pose, axis, 0.5e-6))
    assert failing(near, clean.job) == {}


def test_an_event_between_two_knots_is_found(clean, failing):
    """1.25 s lies half-way between knots; approach and dwell go along, so that nothing else is wrong."""
    schedule = with_event(clean.schedule, 0, time=1.25, dwell=0.35)

    def later(segment):
        if (segment.arm, segment.action) != ("left", "pick"):
            return segment
        if segment.kind == "approach":
            return dataclasses.replace(segment, end=1.25)
        return dataclasses.replace(segment, start=1.25) if segment.kind == "dwell" else segment

    schedule = with_segments(schedule, later)
    assert failing(schedule) == {"events_at_knots": "left-part (pick) at 1.250000 s"}


def test_a_nan_among_the_measurements_is_not_covered_up_by_later_ones(clean, failing):
    """The first of four events has no finite pose."""
    pose = pin.SE3(np.eye(3), np.array([np.nan, 0.0, 0.0]))
    found = failing(with_event(clean.schedule, 0, pose=pose))
    assert found["tool_position_at_events"].startswith("left-part (pick)")


def null_motion(reach, angle):
    """Returns joint angles that turn a tool by `angle` about itself without moving it.

    In the plane, with the hand along x: joint i moves the tip by z × (tip - p_i).
    """
    theta = np.arccos((reach - TCP) / (2 * LINK))
    points = np.array([[0, 0], [LINK * np.cos(theta), LINK * np.sin(theta)], [reach - TCP, 0]])
    arms = np.array([reach, 0]) - points
    matrix = np.vstack([-arms[:, 1], arms[:, 0], np.ones(3)])
    return dict(zip(("r1", "r2", "r3"), np.linalg.solve(matrix, [0, 0, angle]), strict=True))


def sideways(reach, distance):
    """Returns joint angles that move a tool across the hand without turning it: out, and the wrist back."""
    angle = distance / (reach - TCP)
    return {"r1": angle, "r3": -angle}


def test_a_tool_that_moves_in_a_dwell_is_found(clean, bumped, failing):
    """10 µm across during the first dwell, not at its ends; 0.5 µm is none."""
    found = failing(bumped(clean.schedule, DWELL, sideways(0.7, 1e-5)), clean.job)
    assert found == {"tool_still_in_dwells": "right-part (pick) at 1.200000 s"}
    assert failing(bumped(clean.schedule, DWELL, sideways(0.7, 5e-7)), clean.job) == {}


def test_a_tool_that_turns_in_a_dwell_is_found(clean, bumped, failing):
    """10 µrad about the tool centre point."""
    found = failing(bumped(clean.schedule, DWELL, null_motion(0.7, 1e-5)), clean.job)
    assert found == {"tool_steady_in_dwells": "right-part (pick) at 1.200000 s"}


def test_a_tool_that_moves_in_a_dwell_between_knots_only_is_found(clean, failing):
    """Out by c t² (t - h) and back by c t (h - t)²: zero at the knots, 4 c h³ / 27 between them."""
    trajectory = clean.schedule.trajectory
    columns = {name: np.array(getattr(trajectory, name)) for name in ("position", "velocity")}
    h, shape = 0.1, np.zeros(7)
    c = 1e-3 / (4 * h**3 / 27)
    shape[[4, 6]] = [c, -c]
    columns["velocity"][DWELL + 1] += shape * h**2
    jumps = {DWELL: (0, -2 * h), DWELL + 1: (4 * h, -4 * h), DWELL + 2: (2 * h, 0)}
    rows = np.sort(np.concatenate([np.arange(trajectory.time.size), list(jumps)]))
    acceleration = np.array(trajectory.acceleration)[rows]
    for knot, change in jumps.items():
        for row, a in zip(np.flatnonzero(rows == knot), change, strict=True):
            acceleration[row] += shape * a
    trajectory = dataclasses.replace(
        trajectory,
        time=trajectory.time[rows],
        acceleration=acceleration,
        **{name: values[rows] for name, values in columns.items()},
    )
    robot = clean.schedule.robot
    limits = dataclasses.replace(robot.limits, jerk=np.full(7, np.inf))
    schedule = dataclasses.replace(
        clean.schedule,
        motion=JointMotion.of(trajectory),
        robot=dataclasses.replace(robot, limits=limits),
    )
    assert failing(schedule) == {"tool_still_in_dwells": "right-part (pick) at 1.200000 s"}


def test_a_bent_line_is_found(clean, bumped, failing):
    """0.2 mm across in the middle of an approach; 0.05 mm is allowed."""
    reach = 0.7 - LINE / 2
    found = failing(bumped(clean.schedule, APPROACH, sideways(reach, 2e-4)), clean.job)
    assert found == {"lines_straight": "approach of right-part (pick) at 0.800 s"}
    assert failing(bumped(clean.schedule, APPROACH, sideways(reach, 5e-5)), clean.job) == {}


def test_a_tool_that_turns_on_its_line_is_found(clean, bumped, failing):
    """0.2 mrad in the middle of an approach."""
    swing = null_motion(0.7 - LINE / 2, 2e-4)
    found = failing(bumped(clean.schedule, APPROACH, swing), clean.job)
    assert found == {"lines_steady": "approach of right-part (pick) at 0.800 s"}


def test_a_tool_that_goes_back_on_its_line_is_found(clean, bumped, failing):
    """θ swings by 0.15 rad on a line of 0.1 rad: straight, but there and back."""
    swing = {"l1": -0.15, "l2": 0.3, "l3": -0.15}
    found = failing(bumped(clean.schedule, APPROACH, swing), clean.job)
    assert found == {"line_lengths": "approach of left-part (pick) at 0.800 s"}


@pytest.mark.parametrize("kind", ["approach", "retract"])
@pytest.mark.parametrize("asked", [LINE + 2e-4, LINE - 2e-4, 0.0])
def test_lines_that_are_too_short_too_long_or_not_asked_for_are_found(clean, failing, kind, asked):
    """The lines are 50 mm long; an arm that goes on beyond the retract that is asked for has left its stage."""
    job = with_stop(clean.job, "left", "place", **{kind: asked})
    found = failing(clean.schedule, job)
    leaves = {"pairing"} if kind == "retract" and asked < LINE else set()
    assert set(found) == {"line_lengths"} | leaves
    assert found["line_lengths"].startswith(f"{kind} of left-part (place) at ")


@pytest.mark.parametrize("kind", ["approach", "retract"])
def test_a_line_that_is_missing_is_named(clean, failing, kind):
    """One segment is called a wait, in which the arm moves."""
    key = ("right", "pick", kind)
    schedule = with_segments(
        clean.schedule,
        lambda s: (
            dataclasses.replace(s, kind="wait", task="", action="")
            if (s.arm, s.action, s.kind) == key
            else s
        ),
    )
    found = failing(schedule, clean.job)
    assert set(found) == {"line_lengths", "segment_kinds"}
    assert found["line_lengths"] == f"{kind} of right-part (pick) is missing"
    assert set(failing(schedule)) == {"segment_kinds"}


def test_a_line_that_leads_to_no_event_is_named(clean, failing):
    """The task of a line is misspelt."""
    schedule = with_segments(
        clean.schedule,
        lambda s: dataclasses.replace(s, task="lost") if s.kind == "retract" else s,
    )
    assert failing(schedule)["lines_straight"].endswith("no event belongs to it")


def test_a_tool_that_wanders_between_its_stand_still_and_its_line_is_found(
    clean, refined, bumped, failing
):
    """The dwell asked for is over at 1.4 s; the tool swings out by 6 mm before it retracts at 1.6 s."""
    job, schedule = clean.job, refined(clean.schedule, list(np.arange(1.25, 1.6, 0.1)))
    for index, arm in enumerate(("left", "right")):
        job = with_stop(job, arm, "pick", dwell=Dwell(gripper=0.2))
        schedule = with_event(schedule, index, dwell=0.2)

    def shorter(segment):
        pick = segment.kind == "dwell" and segment.action == "pick"
        return dataclasses.replace(segment, end=1.4, dwell=None) if pick else segment

    schedule = bumped(with_segments(schedule, shorter), 12, {"r1": 0.01})
    waits = tuple(Segment(arm, "wait", "", "", 1.4, 1.6) for arm in ("left", "right"))
    schedule = dataclasses.replace(schedule, segments=schedule.segments + waits)
    found = failing(schedule, job)
    assert found["lines_at_events"] == "retract of left-part (pick) at 1.600 s"
    # The right arm moves while it is said to wait.
    assert set(found) == {"lines_at_events", "segment_kinds", "pairing"}


def test_an_approach_that_is_over_before_its_event_is_found(clean, refined, failing):
    """The tool has arrived at 1.2 s, the event says 1.25 s, a wait is listed between them."""
    schedule = with_event(refined(clean.schedule, [1.25]), 0, time=1.25, dwell=0.35)

    def later(segment):
        mine = (segment.arm, segment.action, segment.kind) == ("left", "pick", "dwell")
        return dataclasses.replace(segment, start=1.25, dwell=None) if mine else segment

    schedule = with_segments(schedule, later)
    wait = Segment("left", "wait", "", "", 1.2, 1.25)
    schedule = dataclasses.replace(schedule, segments=(*schedule.segments, wait))
    assert failing(schedule) == {"lines_at_events": "approach of left-part (pick) at 0.800 s"}


def test_a_platform_that_moves_in_a_dwell_is_found(clean, bumped, failing):
    """1e-8 rad: the tools move by some nanometres only, but the platform is not still."""
    found = failing(bumped(clean.schedule, DWELL, {"turn": 1e-8}), clean.job)
    assert found == {"platform_still": "dwell of left-part at 1.200 s"}


@pytest.mark.parametrize("knot", [APPROACH, DWELL + 4])
def test_a_platform_that_moves_on_a_line_is_found(clean, bumped, failing, knot):
    """1e-8 rad in an approach and in a retract; in a transfer it is free to."""
    assert set(failing(bumped(clean.schedule, knot, {"turn": 1e-8}), clean.job)) == {
        "platform_still"
    }
    assert failing(bumped(clean.schedule, DWELL + 8, {"turn": 1e-3}), clean.job) == {}


def test_dwells_hold_the_platform_also_where_no_segments_are_listed(clean, bumped, failing):
    """Events alone say when tools stand."""
    schedule = dataclasses.replace(clean.schedule, segments=())
    assert failing(schedule) == {}
    assert set(failing(bumped(schedule, DWELL, {"turn": 1e-8}))) == {"platform_still"}


def test_a_robot_without_a_platform_has_nothing_to_keep_still(clean):
    """The reason is given."""
    robot = dataclasses.replace(clean.schedule.robot, platform=())
    schedule = dataclasses.replace(clean.schedule, robot=robot)
    check = next(c for c in verify(schedule).checks if c.name == "platform_still")
    assert (check.verdict, check.detail) == ("not checked", "the robot has no platform")


@pytest.mark.parametrize(
    ("freedom", "turn", "kept"),
    [
        ({}, 0.0, True),
        ({}, 1e-5, False),
        ({}, np.pi, False),
        ({"free_yaw": True}, 1.0, True),
        ({"free_yaw": True}, np.pi, True),
        ({"symmetry": 3}, 2 * np.pi / 3, True),
        ({"symmetry": 3}, -2 * np.pi / 3, True),
        ({"symmetry": 3}, np.pi / 3, False),
        ({"symmetry": 2}, np.pi, True),
        ({"symmetry": 4}, np.pi / 2 + 1e-5, False),
    ],
)
def test_turns_about_the_tool_axis_are_judged_by_the_freedom_of_the_target(
    clean, failing, freedom, turn, kept
):
    """The target is turned about its z axis, the tool is not."""
    target = clean.job.tasks[0].stops[0].target
    target = dataclasses.replace(target, pose=turned(target.pose, "z", turn), **freedom)
    found = failing(clean.schedule, with_stop(clean.job, "left", "pick", target=target))
    assert set(found) == (set() if kept else {"events_at_targets"})


@pytest.mark.parametrize("freedom", [{"free_yaw": True}, {"symmetry": 3}])
@pytest.mark.parametrize("fault", ["x", "z", "tilt"])
def test_no_freedom_about_the_axis_excuses_a_shift_or_a_tilt(clean, failing, freedom, fault):
    """2 µm or 2 µrad away from any allowed pose."""
    target = clean.job.tasks[0].stops[0].target
    pose = (
        turned(target.pose, "x", 2e-6) if fault == "tilt" else shifted(target.pose, **{fault: 2e-6})
    )
    target = dataclasses.replace(target, pose=pose, **freedom)
    found = failing(clean.schedule, with_stop(clean.job, "left", "pick", target=target))
    assert set(found) == {"events_at_targets"}


def test_one_of_several_configurations_is_enough(clean, failing):
    """Targets given by joints: one alternative fits, or none, or one is 2 µrad off."""
    trajectory = clean.schedule.trajectory
    reached = trajectory.at(np.array([1.2]))[0][0, 1:4]
    for rows, kept in (
        ([reached + 0.1, reached], True),
        ([reached + 0.1], False),
        ([reached + np.array([0, 2e-6, 0])], False),
    ):
        target = JointTarget(np.array(rows))
        found = failing(clean.schedule, with_stop(clean.job, "left", "pick", target=target))
        assert set(found) == (set() if kept else {"events_at_targets"})


def test_what_nothing_was_measured_of_is_not_passed(clean):
    """Without events and segments no pose, dwell, line or stand-still was looked at: each says so."""
    bare = dataclasses.replace(clean.schedule, events=(), segments=())
    verdicts = {check.name: (check.verdict, check.detail) for check in verify(bare).checks}
    for name in ("events_at_knots", "tool_position_at_events", "tool_angle_at_events"):
        assert verdicts[name] == ("not checked", "the schedule lists no events")
    for name in ("tool_still_in_dwells", "tool_steady_in_dwells"):
        assert verdicts[name] == ("not checked", "no event has a dwell in which the tool stands")
    for name in ("lines_straight", "lines_steady", "line_lengths", "lines_at_events"):
        assert verdicts[name][0] == "not checked"
        assert "no approach or retract" in verdicts[name][1]
    assert verdicts["platform_still"] == (
        "not checked",
        "the schedule lists no lines and no dwells in which it has to stand",
    )


def test_lines_that_the_job_asks_for_are_missed_where_no_segments_are_listed(clean, failing):
    """That nothing was measured is no excuse if there was something to measure."""
    schedule = dataclasses.replace(clean.schedule, segments=())
    assert failing(schedule, clean.job) == {
        "line_lengths": "approach of left-part (pick) is missing"
    }
