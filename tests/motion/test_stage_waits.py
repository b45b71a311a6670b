"""What a stage waits for: windows and parts on conveyors, told by plain numbers, no robot involved."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from dualarm_cli.motion.motion import StageWaits, stage_waits

LEFT, RIGHT = 1.0, 1.5
"""When the arms are at their targets in the stage if nobody is held back [s]."""


def stage(left=None, right=None, opens=0.0):
    """Returns a stage in which parts are met at some times; the right arm's task may have a window."""

    def stop(meets, not_before):
        belt = None if meets is None else SimpleNamespace(at=meets)
        target = SimpleNamespace(action="pick", belt=belt)
        task = SimpleNamespace(not_before=not_before, stops=(target,))
        return SimpleNamespace(stop=target, task=task, tracked=belt)

    return SimpleNamespace(stops={"left": stop(left, 0.0), "right": stop(right, opens)})


def waits(plan, clock):
    """Returns what it waits for with arms that are as much later as they are held back."""

    def arrivals(delays):
        return {"left": LEFT + delays.get("left", 0.0), "right": RIGHT + delays.get("right", 0.0)}

    return stage_waits(plan, arrivals, ["left", "right"], clock)


def test_a_stage_without_parts_or_windows_waits_for_nothing():
    """Nor is anything timed for it."""
    assert stage_waits(stage(), lambda delays: 1 / 0, ["left", "right"], 3.0) == StageWaits()


def test_all_wait_together_for_one_part():
    """It comes at 9 s, the arm would be there at 5 + 1 s: 3 s, and the other one waits for its partner."""
    found = waits(stage(left=9.0), 5.0)
    assert found.common == pytest.approx(3.0)
    assert found.reasons == {"left": "conveyor", "right": "partner"}
    assert found.delays == {}


def test_two_parts_hold_one_arm_back():
    """Parts at 8 and 10 s, arms at 3.5 + 1 and 3.5 + 1.5 s: 3.5 and 5 s of waiting, 1.5 s between for the right one."""
    found = waits(stage(left=8.0, right=10.0), 3.5)
    assert found.common == pytest.approx(3.5)
    assert found.delays == pytest.approx({"left": 0.0, "right": 1.5})
    assert set(found.reasons.values()) == {"conveyor"}
    # By itself, too, so that what is looked at for clearance is what will be done.
    alone = waits(stage(left=8.0, right=10.0), None)
    assert (alone.common, alone.delays) == (0.0, pytest.approx({"left": 0.0, "right": 1.5}))


def test_the_longest_wait_counts_and_has_its_own_reason():
    """The window opens 4 s after the arm would be there, the part comes after 2 s: all wait 4 s, the part is missed."""
    found = waits(stage(left=8.0, opens=10.5), 5.0)
    assert found.common == pytest.approx(4.0)
    assert found.reasons == {"left": "partner", "right": "window"}


def test_what_is_late_is_not_waited_for():
    """A part that came a second ago: nothing is held back for it."""
    assert waits(stage(left=5.0), 5.0).common == 0.0
