"""Jobs with hand-overs: where the arms meet, and what each arm holds from where to where."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from dualarm_cli.model.cell import Cell, Tool
from dualarm_cli.model.dwell import Dwell
from dualarm_cli.model.job import Job, Place, PoseTarget, Stop, Task
from dualarm_cli.model.part_flow import Handover, part_as_held
from dualarm_cli.model.robot import Arm, JointLimits, Robot
from dualarm_cli.model.schedule import Event

HERE = pin.SE3.Identity()


def stop(action):
    """A stop somewhere."""
    return Stop(action, PoseTarget(HERE), 0.0, 0.0, Dwell(), Place("tasks.yaml", 1, 1))


def carry(name, arm):
    """A pick and a place."""
    return Task(name, arm, (stop("pick"), stop("place")))


def hand(name, giver):
    """Both shares of a hand-over."""
    taker = "right" if giver == "left" else "left"
    work = Handover(giver, taker, HERE)
    return (
        Task(name, giver, (stop("pick"), stop("give")), part="box", handover=work),
        Task(
            name,
            taker,
            (stop("take"), stop("place")),
            part=part_as_held("box", name),
            handover=work,
        ),
    )


def job(*tasks):
    """A job of two arms with one joint each."""
    n = 2
    limits = JointLimits(
        ("l", "r"), -np.ones(n), np.ones(n), np.ones(n), np.ones(n), np.ones(n), ("assumed",) * n
    )
    arms = tuple(Arm(side, (side[0],), f"{side}_flange", "general") for side in ("left", "right"))
    robot = Robot("two", "", (), arms, limits)
    return Job(Cell(robot, HERE, {arm.name: Tool(HERE) for arm in arms}), tasks, "home", False)


def stages(found):
    """What left and right do in each stage."""
    return [
        tuple(
            f"{stage[arm][0].id} {stage[arm][1].action}" if arm in stage else ""
            for arm in ("left", "right")
        )
        for stage in found
    ]


def test_arms_meet_at_handovers_and_the_early_one_waits():
    """By hand: the right arm has one move before it is handed something, the left one a task and the pick."""
    move = Task("m", "right", (stop("move"),))
    found = job(carry("a", "left"), move, *hand("h", "left"), carry("b", "left")).stages()
    assert stages(found) == [
        ("a pick", "m move"),
        ("a place", ""),
        ("h pick", ""),
        ("h give", "h take"),
        ("b pick", "h place"),
        ("b place", ""),
    ]


def test_a_part_may_come_back():
    """There and back: after each meeting the k-th targets are paired anew."""
    found = job(*hand("there", "left"), *hand("back", "right")).stages()
    assert stages(found) == [
        ("there pick", ""),
        ("there give", "there take"),
        ("", "there place"),
        ("", "back pick"),
        ("back take", "back give"),
        ("back place", ""),
    ]


def test_without_handovers_all_is_as_it_was():
    """The k-th target of each arm."""
    found = job(carry("a", "left"), carry("b", "right")).stages()
    assert stages(found) == [("a pick", "b pick"), ("a place", "b place")]


def test_each_arm_holds_its_own_end_of_the_part():
    """The giver from the pick on, the taker until the place; nothing before and after."""
    giving, taking = hand("h", "left")
    held = [
        (s.action, t.held_before(s.action), t.held_after(s.action))
        for t in (giving, taking)
        for s in t.stops
    ]
    assert held == [
        ("pick", "", "box"),
        ("give", "box", ""),
        ("take", "", "box@h"),
        ("place", "box@h", ""),
    ]


def test_somebody_holds_the_part_at_any_time():
    """The taker from the end of its dwell, which is when the giver's event is."""
    take = Event(2.0, "right", "h", "take", "right_tcp", HERE, 0.3)
    give = Event(2.3, "left", "h", "give", "left_tcp", HERE, 0.3)
    assert take.changes_held == give.changes_held == 2.3
