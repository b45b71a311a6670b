"""Asynchronous arms: stages that overlap in time, by hand."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from dualarm_cli.model.motion.joint_motion import JointMotion
from dualarm_cli.report.comparison.schedule_comparison import compare_schedules
from dualarm_cli.report.measures import bottlenecks, elbow_imbalance
from dualarm_cli.report.sensitivity import sensitivity
from dualarm_cli.report.stage_parts import overlap, stage_parts


@pytest.fixture
def schedule(by_hand):
    """Left: a to 4 s, 1 s for the zone, b from 5 s to 8 s, return to 9 s. Right: c to 6 s, return from 7 s to 10 s."""
    left = by_hand.row(
        "left",
        ("transfer", "a", 3.0),
        ("approach", "a", 1.0),
        ("wait", "b", 1.0, "shared_zone"),
        ("transfer", "b", 2.0),
        ("dwell", "b", 1.0),
        ("return", "", 1.0),
        ("wait", "", 1.0, "end"),
    )
    right = by_hand.row(
        "right",
        ("transfer", "c", 4.0),
        ("dwell", "c", 2.0),
        ("wait", "", 1.0, "after"),
        ("return", "", 3.0),
    )
    stages = [
        by_hand.stage(0.0, 4.0, "a", platform=3.0, left=2.0),
        by_hand.stage(0.0, 6.0, "c", platform=1.0, right=4.0),
        by_hand.stage(4.0, 8.0, "b", platform=1.0, left=2.0),
        by_hand.stage(7.0, 10.0),
        by_hand.stage(8.0, 9.0),
    ]
    return by_hand.schedule([*left, *right], stages)


def test_parts_go_to_the_stage_of_their_task(schedule):
    """The dwell of c from 4 s to 6 s lies in b's stage as well; of two returns each arm has the one that it fills."""
    assert overlap(schedule.stages)
    found = [
        {arm: [(p.kind, p.start, p.end) for p in parts] for arm, parts in part.arms.items()}
        for part in stage_parts(schedule)
    ]
    assert found == [
        {"left": [("transfer", 0.0, 3.0), ("approach", 3.0, 4.0)]},
        {"right": [("transfer", 0.0, 4.0), ("dwell", 4.0, 6.0)]},
        {"left": [("transfer", 5.0, 7.0), ("dwell", 7.0, 8.0)]},
        {"right": [("return", 7.0, 10.0)]},
        {"left": [("return", 8.0, 9.0)]},
    ]


def test_stages_that_meet_do_not_overlap(by_hand):
    """Nor where rounding has one begin a picosecond early."""
    one, other = by_hand.stage(0.0, 2.0, "a"), by_hand.stage(2.0 - 1e-12, 3.0, "b")
    assert not overlap([one, other])
    assert overlap([one, by_hand.stage(1.9, 3.0, "b")])
    assert not overlap([])


def test_the_arm_that_is_done_last_decides_the_length(schedule):
    """Right: transfer 4 s by itself, dwell 2, return 3, and 1 s that it waits: 10 s, and nothing of left's."""
    found = bottlenecks(schedule)
    expected = {
        "platform": 0.0,
        "left": 0.0,
        "right": 7.0,
        "lines": 0.0,
        "dwells": 2.0,
        "other": 1.0,
    }
    assert found.time == pytest.approx(expected)
    assert sum(found.time.values()) == pytest.approx(schedule.duration)
    # The platform needs longer than left for a; b and its return are left's, c and its return right's.
    assert found.stages == {"left": 2, "right": 2, "platform": 1}


def test_what_adds_stages_up_says_nothing_of_stages_that_overlap(schedule, by_hand):
    """No sensitivity, though limits are assumed; no imbalance of elbows; a comparison says so in a note."""
    limits = dataclasses.replace(schedule.robot.limits, source=("assumed",) * 3)
    assumed = dataclasses.replace(
        schedule, robot=dataclasses.replace(schedule.robot, limits=limits)
    )
    assert sensitivity(assumed) == []
    own = [part for part in schedule.segments if part.arm == "left" and part.kind != "return"]
    stages = [by_hand.stage(0.0, 4.0, "a", left=2.0), by_hand.stage(4.0, 10.0, "b", left=2.0)]
    apart = by_hand.schedule([*own], stages)
    apart = dataclasses.replace(apart, robot=assumed.robot)
    assert len(sensitivity(apart)) > 0
    notes = compare_schedules(schedule, schedule, ("one", "two"))["notes"]
    assert [note.split(":")[0] for note in notes] == ["stages of A overlap", "stages of B overlap"]


def test_an_arm_that_leaves_late_arrives_later(by_hand):
    """Waits 1 s, then moves for 2 s: there at 3 s, where its elbow is looked at."""
    left = by_hand.row(
        "left", ("wait", "a", 1.0, "shared_zone"), ("transfer", "a", 2.0), ("dwell", "a", 1.0)
    )
    (part,) = stage_parts(by_hand.schedule(left, [by_hand.stage(0.0, 4.0, "a")]))
    assert part.arrival("left") == 3.0
    assert part.arrival("right") == 0.0


def test_elbows_are_looked_at_where_a_late_transfer_ends(by_hand):
    """Left waits 1 s and turns its elbow by 0.5 from 1 s to 3 s, right stands: 0.5, not half of it."""
    left = by_hand.row("left", ("wait", "a", 1.0, "shared_zone"), ("transfer", "a", 2.0))
    right = by_hand.row("right", ("transfer", "b", 3.0))
    made = by_hand.schedule([*left, *right], [by_hand.stage(0.0, 3.0, "a", "b")])
    names = {arm: tuple(f"{arm}_{k}" for k in range(7)) for arm in ("left", "right")}
    arms = {
        arm: dataclasses.replace(made.robot.arms[arm], joints=joints)
        for arm, joints in names.items()
    }
    joints = (*names["left"], *names["right"])
    time = np.array([0.0, 1.0, 3.0])
    q = np.zeros((3, 14))
    q[2, 3] = 0.5
    rest = np.zeros((3, 14))
    motion = type(made.trajectory)(joints, time, q, rest, rest)
    robot = dataclasses.replace(made.robot, arms=arms, platform=())
    seven = dataclasses.replace(made, robot=robot, motion=JointMotion.of(motion))
    assert elbow_imbalance(seven) == pytest.approx(0.5)
    twice = (seven.stages[0], by_hand.stage(1.0, 3.0, "b"))
    assert elbow_imbalance(dataclasses.replace(seven, stages=twice)) is None
