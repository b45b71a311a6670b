"""When tools are on lines and in dwells: of a schedule made by hand, instants are sums of its durations."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from dualarm_cli.verification.measuring.tool_model import ToolModel

TCP, LINK, LINE = 0.1, 0.4, 0.05
"""The hand, both links, and the lines of the schedule made by hand [m]."""
MIDDLE = 0.7 - LINE / 2
"""How far the right tool is from its shoulder in the middle of its first approach [m]."""
APPROACH, RETRACT = 4, 12
"""First knots of the first approach and of the first retract, each of four intervals of 0.1 s."""
EXPECTED = [(0.8, 2.0), (0.8, 2.0), (2.8, 4.0), (2.8, 4.0)]
"""Transfers take 0.8 s, lines and dwells 0.4 s each [s]."""


def spans(found):
    """Starts and ends."""
    return [(span.start, span.end) for span in found]


def with_stop(job, **changes):
    """The job with the right arm's pick changed."""
    task = job.tasks[1]
    stops = (dataclasses.replace(task.stops[0], **changes), task.stops[1])
    return dataclasses.replace(job, tasks=(job.tasks[0], dataclasses.replace(task, stops=stops)))


def across(distance):
    """Joint angles that move the right tool across its hand without turning it."""
    angle = distance / (MIDDLE - TCP)
    return {"r1": angle, "r3": -angle}


def about_its_tip(angle):
    """Joint angles that turn the right tool without moving its tip."""
    theta = np.arccos((MIDDLE - TCP) / (2 * LINK))
    points = np.array([[0, 0], [LINK * np.cos(theta), LINK * np.sin(theta)], [MIDDLE - TCP, 0]])
    arms = np.array([MIDDLE, 0]) - points
    matrix = np.vstack([-arms[:, 1], arms[:, 0], np.ones(3)])
    return dict(zip(("r1", "r2", "r3"), np.linalg.solve(matrix, [0, 0, angle]), strict=True))


def test_spans_are_those_of_the_motion_whatever_is_listed(clean, measured_lines):
    """Without segments and stages, and with events in any order."""
    found = measured_lines(clean.schedule, clean.job)
    assert [span.event for span in found] == list(clean.schedule.events)
    assert spans(found) == pytest.approx(np.array(EXPECTED), abs=1e-9)
    assert [span.dwell_end for span in found] == pytest.approx([1.6, 1.6, 3.6, 3.6], abs=1e-9)
    bare = dataclasses.replace(clean.schedule, segments=(), stages=())
    assert spans(measured_lines(bare, clean.job)) == spans(found)
    back = dataclasses.replace(bare, events=clean.schedule.events[::-1])
    assert spans(measured_lines(back, clean.job)) == spans(found)[::-1]


@pytest.mark.parametrize(("knot", "early", "late"), [(APPROACH, 1.0, 1.2), (RETRACT, 1.6, 1.8)])
@pytest.mark.parametrize("swing", [across(2e-4), across(-2e-4), about_its_tip(2e-4)])
def test_a_line_begins_and_ends_where_the_tool_leaves_it(
    clean, bumped, measured_lines, knot, early, late, swing
):
    """0.2 mm across or 0.2 mrad aside at 1.0 s, and at 1.8 s: only what is between there and the target is left."""
    _, right, *others = measured_lines(bumped(clean.schedule, knot, swing), clean.job)
    if knot == APPROACH:
        assert early < right.start < late
        assert right.end == pytest.approx(2.0, abs=1e-9)
    else:
        assert right.start == pytest.approx(0.8, abs=1e-9)
        assert early < right.end < late
    assert spans(others) == pytest.approx(np.array(EXPECTED[2:]), abs=1e-9)


@pytest.mark.parametrize("swing", [across(8e-5), about_its_tip(8e-5)])
@pytest.mark.parametrize("knot", [APPROACH, RETRACT])
def test_what_a_line_may_be_off_is_no_end_of_it(clean, bumped, measured_lines, knot, swing):
    """Less than 0.1 mm, and less than 0.1 mrad."""
    found = measured_lines(bumped(clean.schedule, knot, swing), clean.job)
    assert spans(found) == pytest.approx(np.array(EXPECTED), abs=1e-9)


@pytest.mark.parametrize("length", [0.02, 0.035])
def test_a_line_is_no_longer_than_the_job_asks(clean, measured_lines, length):
    """From where the tool is as far out as that, looked for four times in each interval of 0.1 s, to its target."""
    tool = clean.schedule.events[1].pose.translation

    def distance(time):
        return np.linalg.norm(_tip(clean, time) - tool)

    job = with_stop(clean.job, approach=length, retract=length)
    right = measured_lines(clean.schedule, job)[1]
    for inside, outside in ((right.start, right.start - 0.025), (right.end, right.end + 0.025)):
        assert distance(inside) <= length + 1e-4
        assert distance(outside) > length + 1e-4


def _tip(clean, time):
    """The right tool by pinocchio [m]."""
    q = clean.schedule.trajectory.at(np.array([time]))[0][0]
    return ToolModel(clean.schedule).pose("right", q).translation


def test_a_stop_without_lines_is_its_dwell(clean, measured_lines):
    """From the event to the end of the dwell."""
    job = with_stop(clean.job, approach=0.0, retract=0.0)
    right = measured_lines(clean.schedule, job)[1]
    assert (right.start, right.end) == pytest.approx((1.2, 1.6), abs=1e-9)


def test_a_line_that_is_longer_than_the_motion_goes_is_as_long_as_that(clean, measured_lines):
    """100 mm are asked for, the tool comes from 50 mm, from elsewhere before: the line is what it is."""
    job = with_stop(clean.job, approach=0.1, retract=0.1)
    right = measured_lines(clean.schedule, job)[1]
    assert (right.start, right.end) == pytest.approx((0.8, 2.0), abs=0.05)


def test_a_line_does_not_reach_beyond_another_event_of_its_arm(clean, measured_lines):
    """One half-way down and one half-way up: they are where the line begins and ends."""
    pick = clean.schedule.events[1]
    early, late = (
        dataclasses.replace(pick, time=time, dwell=0.0, action="move") for time in (1.1, 1.7)
    )
    schedule = dataclasses.replace(clean.schedule, events=(early, *clean.schedule.events, late))
    [right] = [s for s in measured_lines(schedule, clean.job) if s.event == pick]
    assert (right.start, right.end) == pytest.approx((1.1, 1.7), abs=1e-9)


def test_what_the_job_does_not_ask_for_has_no_span(clean, measured_lines):
    """The left arm's task is another one."""
    other = dataclasses.replace(clean.job.tasks[0], id="other")
    job = dataclasses.replace(clean.job, tasks=(other, clean.job.tasks[1]))
    found = measured_lines(clean.schedule, job)
    assert {span.event.arm for span in found} == {"right"}
