"""How full buffers are, and who serves what waits for them, in schedules made by hand."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import pinocchio as pin
import pytest

from dualarm_cli.kinds.buffer.measures import buffer_lines, buffer_rows
from dualarm_cli.model.part_flow import Buffer
from dualarm_cli.model.schedule import Event
from dualarm_cli.report.report import wait_rows


def event(arm, task, action, time, dwell):
    """An event somewhere."""
    return Event(time, arm, task, action, f"{arm}_tcp", pin.SE3.Identity(), dwell)


@pytest.fixture
def used(by_hand):
    """Left puts at 1 s and 3 s, right takes at 4 s after a wait, dwells of half a second, 6 s in all; room for two."""
    left = by_hand.row("left", ("transfer", "a", 1.0), ("dwell", "a", 0.5), ("transfer", "b", 4.5))
    right = by_hand.row(
        "right", ("wait", "c", 2.0, "buffer"), ("transfer", "c", 2.0), ("dwell", "c", 2.0)
    )
    right = [dataclasses.replace(part, action="pick") for part in right]
    schedule = by_hand.schedule([*left, *right])
    events = (
        event("left", "a", "place", 1.0, 0.5),
        event("left", "b", "place", 3.0, 0.5),
        event("right", "c", "pick", 4.0, 0.5),
    )
    stop = SimpleNamespace(buffer="tray")
    job = SimpleNamespace(
        tasks=[SimpleNamespace(id=name, after=()) for name in "abc"],
        buffers={"tray": Buffer(2), "spare": Buffer(3, 1)},
        stops_by_key=lambda: {(e.arm, e.task, e.action): stop for e in events},
    )
    return dataclasses.replace(schedule, events=events), job


def test_a_place_is_taken_from_the_place_to_the_end_of_the_pick(used):
    """Empty until 1 s, full from 3 s to 4.5 s, one part at the end; a buffer that nobody uses stays as it is."""
    rows = buffer_rows(*used)
    assert rows["tray"] == {
        "capacity": 2,
        "initial": 0,
        "final": 1,
        "most": 2,
        "empty": pytest.approx(1.0),
        "full": pytest.approx(1.5),
    }
    assert (rows["spare"]["most"], rows["spare"]["empty"], rows["spare"]["full"]) == (1, 0.0, 0.0)
    [line, _] = buffer_lines({"buffers": rows})
    assert line == (
        "buffer tray: at most 2 of 2, empty 1.00 s, full 1.50 s, 0 at the start, 1 at the end"
    )


def test_a_wait_for_a_buffer_is_for_who_serves_it(used):
    """The right arm waits for a part: the last one that is there by then is b's."""
    schedule, job = used
    [row] = wait_rows(schedule, job)
    assert (row["reason"], row["task"]) == ("buffer", "c")
    assert row["for"] == {"arm": "left", "task": "b"}
    # One whose dwell is over only after that did not serve it.
    late = dataclasses.replace(schedule.events[1], dwell=1.5)
    events = (schedule.events[0], late, schedule.events[2])
    [row] = wait_rows(dataclasses.replace(schedule, events=events), job)
    assert row["for"] == {"arm": "left", "task": "a"}
