"""Dwells of task files with least, nominal and greatest times."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.budget import TimeRange

Change = Callable[..., None]
GRIPPER = "gripper: 0.12 s"


def test_three_times_are_a_spread_around_what_is_planned(project: object, change: Change) -> None:
    """The plan uses the nominal time; a part with one time does not vary."""
    change("tasks.yaml", GRIPPER, "gripper: [80 ms, 0.12, 200 ms]")
    change("tasks.yaml", "mode: paired", "budget: {cycle_time: 9 s, cycle: 95%}")
    job = load_job("tasks.yaml")
    pick = job.tasks[0].stops[0]
    assert (pick.dwell.gripper, pick.dwell.settle) == (0.12, 0.03)
    assert pick.varying == (TimeRange(0.08, 0.12, 0.2),)
    assert job.budget is not None and job.budget.cycle_kind == "95%"
    assert job.tasks[1].stops[0].varying == ()  # a move


@pytest.mark.parametrize(
    ("old", "new", "wanted"),
    [
        (GRIPPER, "gripper: [0.1, 0.2]", "a list of 2; give least, nominal and greatest time"),
        (GRIPPER, "gripper: [0.2, 0.1, 0.3]", "0.2, 0.1, 0.3 s: give least, nominal and greatest"),
        (GRIPPER, "gripper: [0.1, 0.2, 1 mm]", "unit 'mm' in '1 mm' is not one of time"),
        (GRIPPER, "gripper: [-1, 0.2, 1]", "time must be at least 0"),
        (GRIPPER, "gripper: {least: 1}", "must be a number such as"),
        ("mode: paired", "budget: {cycle: worst, skew: 1 ms}", "give cycle_time, too"),
        ("mode: paired", "budget: {cycle_time: 9, cycle: 99%}", "'99%' is not allowed"),
    ],
)
def test_times_that_say_nothing_are_refused(
    project: object, change: Change, messages: Callable[..., list[str]], old: str, new: str, wanted: str
) -> None:  # fmt: skip
    """With the place and what to write."""
    change("tasks.yaml", old, new)
    found = messages(lambda: load_job("tasks.yaml"))
    assert any(wanted in message for message in found), found
    assert all(message.startswith("tasks.yaml:") for message in found)
