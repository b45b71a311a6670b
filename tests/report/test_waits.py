"""Waits of schedules made by hand: how long for what, and for whom."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from dualarm_cli.report.console import wait_lines
from dualarm_cli.report.report import REASONS, drawn_out, wait_rows, waited


def _job(**after):
    """What the rows ask a job: which tasks come after which."""
    return SimpleNamespace(
        tasks=[SimpleNamespace(id=name, after=before) for name, before in after.items()]
    )


@pytest.fixture
def schedule(by_hand):
    """Left 12 s: 1 zone, a 3, 2 partner, b 2, 1 platform, 1, end 2. Right: c 5, 1 after a, d 4, 2 unsaid."""
    left = by_hand.row(
        "left",
        ("wait", "a", 1.0, "shared_zone"),
        ("transfer", "a", 3.0),
        ("wait", "", 2.0, "partner"),
        ("transfer", "b", 2.0),
        ("wait", "b", 1.0, "platform"),
        ("approach", "b", 1.0),
        ("wait", "", 2.0, "end"),
    )
    right = by_hand.row(
        "right",
        ("transfer", "c", 5.0),
        ("wait", "d", 1.0, "after"),
        ("transfer", "d", 4.0),
        ("wait", "", 2.0),
    )
    return by_hand.schedule([*left, *right])


def test_waits_are_added_up_by_reason(schedule):
    """All reasons are named, also those of which there is nothing; what is not said is `unstated`."""
    none = dict.fromkeys(REASONS, 0.0)
    left = {"shared_zone": 1.0, "partner": 2.0, "platform": 1.0, "end": 2.0}
    assert waited(schedule, "left") == none | left
    assert waited(schedule, "right") == none | {"after": 1.0, "unstated": 2.0}


def test_a_wait_says_what_for_and_for_whom(schedule):
    """In time order; the other arm's task when the wait ends, or the task that has to be done before."""
    rows = wait_rows(schedule, _job(a=(), b=(), c=(), d=("a", "b")))
    assert [
        (r["arm"], r["start"], r["end"], r["length"], r["reason"], r["task"]) for r in rows
    ] == [
        ("left", 0.0, 1.0, 1.0, "shared_zone", "a"),
        ("left", 4.0, 6.0, 2.0, "partner", None),
        ("right", 5.0, 6.0, 1.0, "after", "d"),
        ("left", 8.0, 9.0, 1.0, "platform", "b"),
        ("left", 10.0, 12.0, 2.0, "end", None),
        ("right", 10.0, 12.0, 2.0, "unstated", None),
    ]
    # Left leaves while right is on c; c is over at 5 s, so that from 4 s to 6 s it is what left waited for. Of a and
    # b only a is done by 6 s. From 10 s on nobody works.
    assert [row["for"] for row in rows] == [
        {"arm": "right", "task": "c"},
        {"arm": "right", "task": "c"},
        {"arm": "left", "task": "a"},
        None,
        None,
        None,
    ]


def test_waits_of_rounding_are_none(by_hand):
    """A picosecond between two arms that end together is not worth a row."""
    left = by_hand.row("left", ("transfer", "a", 1.0), ("wait", "", 1e-12, "partner"))
    assert wait_rows(by_hand.schedule(left), _job(a=())) == []


def test_transfers_as_long_as_the_platforms_are_drawn_out_by_what_the_arm_alone_is_quicker(by_hand):
    """The platform needs 3 s, left alone 1 s, right alone 4 s: left's transfer is 2 s longer for it, right's is not."""
    left = by_hand.row("left", ("transfer", "a", 3.0), ("wait", "", 1.0, "partner"))
    right = by_hand.row("right", ("transfer", "b", 4.0))
    stage = by_hand.stage(0.0, 4.0, "a", "b", platform=3.0, left=1.0, right=4.0)
    assert drawn_out(by_hand.schedule([*left, *right], [stage])) == {"left": 2.0, "right": 0.0}


def test_an_arm_that_waits_for_the_platform_was_not_drawn_out_as_well(by_hand):
    """One second on the way by a detour and two of waiting are three together: counted once, as waiting."""
    left = by_hand.row("left", ("transfer", "a", 1.0), ("wait", "a", 2.0, "platform"))
    stage = by_hand.stage(0.0, 3.0, "a", platform=3.0, left=0.5)
    schedule = by_hand.schedule(left, [stage])
    assert drawn_out(schedule)["left"] == 0.0
    assert waited(schedule, "left")["platform"] == 2.0


def test_the_console_says_the_longest_waits_first_and_leaves_out_nothings():
    """Two lines; an arm that does not wait is not named, nor is a reason of less than what is printed."""
    none = dict.fromkeys(REASONS, 0.0)
    left = none | {"partner": 0.4, "platform": 0.6, "shared_zone": 0.2, "end": 0.004}
    report = {
        "arms": {
            "left": {"waited": left, "drawn_out_for_platform": 0.25},
            "right": {"waited": none | {"end": 1.5}, "drawn_out_for_platform": 0.0},
        }
    }
    assert wait_lines(report) == [
        "waits: left 1.20 s (platform 0.60, partner 0.40, shared zone 0.20), right 1.50 s (end 1.50)",
        "transfers slowed down until the platform arrives: left 0.25 s",
    ]
    report["arms"]["left"] = report["arms"]["right"] = {"waited": none, "drawn_out_for_platform": 0}
    assert wait_lines(report) == []
