"""Why a case got slower: the joint, its limit then and now, the files."""

from __future__ import annotations

import math

import pytest

from dualarm_cli.scoring.gate import why_slower

DEG = math.pi / 180.0


def limits(**velocities):
    """Velocity limits [deg/s] by joint."""
    return {joint: {"velocity": value * DEG} for joint, value in velocities.items()}


def test_the_joint_that_takes_more_is_named_with_its_lowered_limit(evaluation, recorded):
    """Both cycle times, the share, the joint, 170 and 120 deg/s, the file that changed."""
    before = recorded(
        cycle_time=12.3,
        limiting={"left_s": 5.0, "left_l": 7.3},
        limits=limits(left_s=170, left_l=170),
    )
    now = evaluation(
        cycle_time=12.915,
        limiting={"left_s": 5.5, "left_l": 7.415},
        limits=limits(left_s=120, left_l=170),
        inputs={"cell.yaml": "changed", "tasks.yaml": "bb"},
    )
    assert why_slower(before, now) == (
        "cycle time 12.300 s -> 12.915 s (+5.0 %): left_s takes more of it (5.000 s -> 5.500 s); its velocity limit "
        "was 170 deg/s, now 120 deg/s; changed since: cell.yaml"
    )


def test_a_lowered_joint_is_named_before_one_that_grew_more(evaluation, recorded):
    """The joint whose limit went down is the cause, though the plan's other joint grew more."""
    before = recorded(limiting={"a": 1.0, "b": 1.0}, limits=limits(a=100, b=100))
    now = evaluation(cycle_time=11.0, limiting={"a": 1.2, "b": 1.8}, limits=limits(a=90, b=100))
    assert ": a takes more of it (1.000 s -> 1.200 s); its velocity limit was 100" in why_slower(
        before, now
    )


def test_a_lowered_joint_that_the_plan_avoids_is_named_all_the_same(evaluation, recorded):
    """Its share is smaller than it was; another one's grew for it."""
    before = recorded(limiting={"a": 3.0, "b": 1.0}, limits=limits(a=100, b=100))
    now = evaluation(cycle_time=11.0, limiting={"a": 0.5, "b": 4.0}, limits=limits(a=50, b=100))
    text = why_slower(before, now)
    assert "a's velocity limit was 100 deg/s, now 50 deg/s" in text
    assert "so the plan differs: b takes more of it" in text


@pytest.mark.parametrize(
    ("then", "now", "sliding", "words"),
    [
        ({}, {"jerk": 10.0 * DEG}, (), "its jerk limit was none deg/s³, now 10 deg/s³"),
        (
            {"acceleration": 2.0},
            {"acceleration": 1.5},
            ("a",),
            "its acceleration limit was 2000 mm/s², now 1500 mm/s²",
        ),
        ({"upper": 1.0}, {"upper": 0.5}, ("a",), "its upper limit was 1000 mm, now 500 mm"),
        (
            {"lower": -90.0 * DEG},
            {"lower": -45.0 * DEG},
            (),
            "its lower limit was -90 deg, now -45 deg",
        ),
    ],
)
def test_every_kind_of_limit_is_told_in_its_unit(evaluation, recorded, then, now, sliding, words):
    """Rates and ranges, of joints that turn and that slide."""
    before = recorded(limiting={"a": 1.0}, limits={"a": then})
    slower = evaluation(cycle_time=11.0, limiting={"a": 2.0}, limits={"a": now}, sliding=sliding)
    assert words in why_slower(before, slower)


def test_a_wider_limit_is_no_cause_and_without_one_the_share_is_named(evaluation, recorded):
    """Dwells that grew; a limit that was raised is not mentioned."""
    before = recorded(limiting={"dwells": 1.0}, limits=limits(a=100))
    now = evaluation(cycle_time=11.0, limiting={"dwells": 2.0}, limits=limits(a=110))
    text = why_slower(before, now)
    assert "dwells take more of it (1.000 s -> 2.000 s)" in text
    assert "deg/s" not in text


def test_files_that_did_not_change_point_at_the_programs(evaluation, recorded):
    """Then it is dualarm or a library."""
    text = why_slower(recorded(), evaluation(cycle_time=11.0))
    assert "no file has changed, so the cause is dualarm or one of its libraries" in text
