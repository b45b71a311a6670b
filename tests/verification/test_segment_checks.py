"""What segments are called, one rule after the other, on the schedule made by hand.

The left arm: transfer to 0.8 s, approach to 1.2 s, pick until 1.6 s, retract to 2.0 s; the same for the place 2 s
later; return from 4.0 to 4.8 s.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dualarm_cli.model.motion.joint_motion import JointMotion
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.verification.stage_checks import check_segment_kinds, first_move

FIRST, APPROACH, DWELL, SECOND, LAST_DWELL, BACK = 0, 1, 2, 4, 6, 8
"""Numbers of the left arm's segments."""


def changed(schedule, number, events=None, **changes):
    """The schedule with one segment of the left arm, and events by their numbers, changed."""
    segments, found = list(schedule.segments), list(schedule.events)
    assert segments[number].arm == "left"
    segments[number] = replace(segments[number], **changes)
    for k, values in (events or {}).items():
        found[k] = replace(found[k], **values)
    return replace(schedule, segments=tuple(segments), events=tuple(found))


NOTHING = {"task": "", "action": ""}


@pytest.mark.parametrize(
    ("number", "changes", "fault"),
    [
        # Reasons are for waits.
        (FIRST, {"reason": "partner"}, "a reason for waiting is given ('partner')"),
        (BACK, {"reason": "end"}, "a reason for waiting is given ('end')"),
        # An arm that waits stands; one that has work left does not wait for the end.
        (APPROACH, {"kind": "wait", **NOTHING}, "the arm moves at 0.8"),
        (DWELL, {"kind": "wait", **NOTHING}, ""),
        (DWELL, {"kind": "wait", **NOTHING, "reason": "partner"}, ""),
        (DWELL, {"kind": "wait", "reason": "end"}, "its work is not done: left-part place follows"),
        (LAST_DWELL, {"kind": "wait", "reason": "end"}, ""),
        # Returns come last and belong to nothing.
        (BACK, {"task": "left-part"}, "a return belongs to no task"),
        (BACK, {"action": "place"}, "a return belongs to no task"),
        (SECOND, {"kind": "return", **NOTHING}, "left-part place follows, returns come last"),
        # Transfers lead to the next event, or to none where they make room.
        (FIRST, {"action": "place"}, "next event is left-part pick, not left-part place"),
        (FIRST, {"action": ""}, "next event is left-part pick, not left-part"),
        (FIRST, {"task": ""}, "next event is left-part pick, not"),
        (FIRST, NOTHING, ""),
        (SECOND, NOTHING, ""),
        (
            BACK,
            {"kind": "transfer", **NOTHING},
            "nothing follows; a motion back to the start is a return",
        ),
        (BACK, {"kind": "transfer", "task": "left-part", "action": "place"}, "event is none, not"),
        # Without lines a transfer ends at its event, up to rounding.
        (FIRST, {"end": 1.2 + 5e-10}, ""),
        (FIRST, {"end": 1.2 + 2e-9}, "next event is left-part place, not left-part pick"),
        # Paths and seams belong to events of their own.
        (APPROACH, {"kind": "path", "action": "path"}, "has no event left-part path"),
        (APPROACH, {"kind": "seam", "action": "seam_end"}, "has no event left-part seam_end"),
    ],
)
def test_each_segment_is_what_the_motion_and_the_events_show(clean, number, changes, fault):
    """One change, and what is said of it."""
    check = check_segment_kinds(changed(clean.schedule, number, **changes))
    assert check.verdict == ("failed" if fault else "passed")
    assert check.measured == (1 if fault else 0)
    if fault:
        assert fault in check.detail
        assert check.detail.startswith("left ")


@pytest.mark.parametrize(
    ("kind", "own", "good", "bad"),
    [("path", "path", "path", "pick"), ("seam", "seam_end", "seam_end", "seam_start")],
)
def test_paths_and_seams_lead_to_their_own_event(clean, kind, own, good, bad):
    """With the event there, the segment's action counts."""
    left = next(k for k, e in enumerate(clean.schedule.events) if e.arm == "left")
    for action, verdict in ((good, "passed"), (bad, "failed")):
        schedule = changed(
            clean.schedule, APPROACH, {left: {"action": own}}, kind=kind, action=action
        )
        # The transfer before it leads to the same event.
        schedule = changed(schedule, FIRST, action=own)
        assert check_segment_kinds(schedule).verdict == verdict


def test_an_event_that_is_over_is_not_ahead(clean):
    """A transfer of no length right after an event of no length leads to the next one."""
    left = next(k for k, e in enumerate(clean.schedule.events) if e.arm == "left")
    time = clean.schedule.events[left].time
    for dwell, action in ((0.0, "place"), (0.4, "pick")):
        schedule = changed(
            clean.schedule, FIRST, {left: {"dwell": dwell}}, start=time, end=time, action=action
        )
        assert check_segment_kinds(schedule).verdict == "passed"
        other = {"place": "pick", "pick": "place"}[action]
        schedule = changed(schedule, FIRST, action=other)
        assert check_segment_kinds(schedule).verdict == "failed"


def test_an_arm_that_makes_room_leaves_before_the_last_event_of_either_arm(clean):
    """The last event is the right arm's, later: the left one's way back may make room until it."""
    right = max(k for k, e in enumerate(clean.schedule.events) if e.arm == "right")
    for time, verdict in ((4.0 + 2e-9, "passed"), (4.0, "failed")):
        schedule = changed(
            clean.schedule, BACK, {right: {"time": time}}, kind="transfer", **NOTHING
        )
        own = replace(schedule, segments=tuple(s for s in schedule.segments if s.arm == "left"))
        assert check_segment_kinds(own).verdict == verdict


def test_every_fault_counts_and_the_first_is_told(clean):
    """Both arms' returns have a reason; without segments nothing is judged."""
    segments = tuple(
        replace(s, reason="end") if s.kind == "return" else s for s in clean.schedule.segments
    )
    check = check_segment_kinds(replace(clean.schedule, segments=segments))
    assert check.measured == 2
    assert check.detail.startswith("left return from 4.0000 to 4.8000 s: ")
    bare = replace(clean.schedule, segments=())
    assert check_segment_kinds(bare).verdict == "not checked"


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("joint", ["l1", "l3"])
def test_a_joint_is_seen_to_move_beyond_what_rounding_does(clean, way, joint):
    """A micrometre's worth: 0.9 µrad stand, 1.1 µrad do not, whichever way; other arms' joints do not count."""
    joints = clean.schedule.trajectory.joints
    for far, seen in ((0.9e-6, False), (1.1e-6, True)):
        q = np.zeros((2, len(joints)))
        q[1, joints.index(joint)] = way * far
        still = np.zeros_like(q)
        schedule = replace(
            clean.schedule,
            motion=JointMotion.of(Trajectory(joints, np.array([0.0, 1.0]), q, still, still)),
        )
        assert (first_move(schedule, "left", 0.0, 1.0) > 0.0) == seen
        assert first_move(schedule, "right", 0.0, 1.0) == 0.0
        assert first_move(schedule, "left", 1.0, 0.0) == 0.0
        assert first_move(schedule, "left", 0.0, 0.0) == 0.0
    robot = clean.schedule.robot
    unknown = replace(robot, arms={a: replace(arm, joints=()) for a, arm in robot.arms.items()})
    assert first_move(replace(clean.schedule, robot=unknown), "left", 0.0, 1.0) == 0.0
