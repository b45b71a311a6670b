"""Every tolerance from both sides: a fault of 0.9 of it passes, one of 1.1 of it fails, with the table's numbers."""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.model.budget import Budget
from dualarm_cli.model.motion.joint_motion import JointMotion
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.verification import StageClearance, Verification
from dualarm_cli.verification import verify
from dualarm_cli.verification.budget_checks import judge_budget
from dualarm_cli.verification.motion_checks import jerk_fraction
from dualarm_cli.verification.order_checks import check_precedence
from dualarm_cli.verification.stage_checks import first_move

LINE = 0.05
DWELL = 8
"""First knot of the first dwell, of four intervals."""
MIDDLE = 18
"""A knot in the middle of the second transfer."""


def verdict(schedule, job, name):
    """The verdict of one check."""
    [check] = [c for c in verify(schedule, job).checks if c.name == name]
    return check.verdict


def knot(rate, place, joint):
    """A fault: one number of one knot is off."""

    def made(schedule, job, size):
        values = np.array(getattr(schedule.trajectory, rate))
        values[place, schedule.trajectory.joints.index(joint)] += size
        trajectory = dataclasses.replace(schedule.trajectory, **{rate: values})
        return dataclasses.replace(schedule, motion=JointMotion.of(trajectory)), job

    return made


def limit(rate, joint):
    """A fault: a joint is beyond its limit by a share of it."""

    def made(schedule, job, size):
        column = schedule.trajectory.joints.index(joint)
        top = np.abs(getattr(schedule.trajectory, rate)[:, column]).max()
        return schedule, with_limit(job, rate, joint, top / (1.0 + size))

    return made


def with_limit(job, rate, joint, value):
    robot = job.cell.robot
    values = np.array(getattr(robot.limits, rate))
    values[robot.joints.index(joint)] = value
    limits = dataclasses.replace(robot.limits, **{rate: values})
    cell = dataclasses.replace(job.cell, robot=dataclasses.replace(robot, limits=limits))
    return dataclasses.replace(job, cell=cell)


def beyond(side, sign):
    """A fault: the platform, which stands at 0.4 and at -0.3 rad at the stops, is beyond a position limit."""

    def made(schedule, job, size):
        top = (sign * schedule.trajectory.position[:, 0]).max()
        return schedule, with_limit(job, side, "turn", sign * (top - size))

    return made


def posture(schedule, job, size):
    """A fault: the job's start is another posture."""
    ready = np.array(job.cell.robot.postures["ready"])
    ready[4] += size
    robot = dataclasses.replace(job.cell.robot, postures={"ready": ready})
    return schedule, dataclasses.replace(job, cell=dataclasses.replace(job.cell, robot=robot))


def late(schedule, job, size):
    """A fault: the motion begins late."""
    time = schedule.trajectory.time + size
    trajectory = dataclasses.replace(schedule.trajectory, time=time)
    return dataclasses.replace(schedule, motion=JointMotion.of(trajectory)), job


def event(**changes):
    """A fault: the right arm's place, the last event, is off; a number is added, a function is applied."""

    def made(schedule, job, size):
        *others, last = schedule.events
        new = {
            name: change(getattr(last, name), size) if callable(change) else change
            for name, change in changes.items()
        }
        last = dataclasses.replace(last, **new)
        return dataclasses.replace(schedule, events=(*others, last)), job

    return made


def plus(value, size):
    return value + size


def minus(value, size):
    return value - size


def aside(pose, size):
    """A pose moved along its own y axis."""
    return pose * pin.SE3(np.eye(3), np.array([0.0, size, 0.0]))


def turned(pose, size):
    """A pose turned about its own z axis."""
    return pose * pin.SE3(pin.utils.rotate("z", size), np.zeros(3))


def segment(kind, end, change):
    """A fault: a segment of the right arm's second stop begins or ends at another time."""

    def made(schedule, job, size):
        def off(s):
            if (s.arm, s.kind, s.action) != ("right", kind, "place"):
                return s
            return dataclasses.replace(s, **{end: change(getattr(s, end), size)})

        return dataclasses.replace(schedule, segments=tuple(map(off, schedule.segments))), job

    return made


def stage(end, change):
    """A fault: the second stage begins or ends at another time."""

    def made(schedule, job, size):
        one, two, *rest = schedule.stages
        two = dataclasses.replace(two, **{end: change(getattr(two, end), size)})
        return dataclasses.replace(schedule, stages=(one, two, *rest)), job

    return made


def target(change):
    """A fault: the file has the last stop's target elsewhere."""

    def made(schedule, job, size):
        *others, last = job.tasks
        pick, place = last.stops
        pose = change(place.target.pose, size)
        place = dataclasses.replace(place, target=dataclasses.replace(place.target, pose=pose))
        last = dataclasses.replace(last, stops=(pick, place))
        return schedule, dataclasses.replace(job, tasks=(*others, last))

    return made


def stop(**changes):
    """A fault: the file has the last stop otherwise."""

    def made(schedule, job, size):
        *others, last = job.tasks
        pick, place = last.stops
        new = {name: change(getattr(place, name), size) for name, change in changes.items()}
        last = dataclasses.replace(last, stops=(pick, dataclasses.replace(place, **new)))
        return schedule, dataclasses.replace(job, tasks=(*others, last))

    return made


def window(key, action, sign):
    """A fault: a task's window opens after its first event, or closes before its last one."""

    def made(schedule, job, size):
        [time] = [e.time for e in schedule.events if (e.task, e.action) == ("right-part", action)]
        *others, last = job.tasks
        last = dataclasses.replace(last, **{key: time + sign * size})
        return schedule, dataclasses.replace(job, tasks=(*others, last))

    return made


def bound(schedule, job, size):
    """A fault: the stated lower bound is above the duration."""
    return dataclasses.replace(schedule, lower_bound=schedule.duration + size), job


def more_gripper(dwell, size):
    return dataclasses.replace(dwell, gripper=dwell.gripper + size)


FAULTS = {
    ("time", "late"): (1e-9, late),
    ("position_agreement", "knot"): (1e-8, knot("position", MIDDLE, "l2")),
    ("velocity_agreement", "knot"): (1e-7, knot("velocity", MIDDLE, "r3")),
    ("position", "upper"): (1e-9, beyond("upper", 1.0)),
    ("position", "lower"): (1e-9, beyond("lower", -1.0)),
    ("velocity", "limit"): (1e-9, limit("velocity", "l1")),
    ("acceleration", "limit"): (1e-9, limit("acceleration", "r2")),
    ("rest", "speed at the start"): (1e-9, knot("velocity", 0, "l3")),
    ("rest", "acceleration at the end"): (1e-9, knot("acceleration", -1, "turn")),
    ("start_posture", "joint"): (1e-9, posture),
    ("return", "joint"): (1e-9, knot("position", -1, "r1")),
    ("events_at_knots", "event"): (1e-9, event(time=plus)),
    ("tool_position_at_events", "aside"): (1e-6, event(pose=aside)),
    ("tool_angle_at_events", "turned"): (1e-6, event(pose=turned)),
    ("tool_still_in_dwells", "aside"): (1e-6, event(pose=aside)),
    ("tool_steady_in_dwells", "turned"): (1e-6, event(pose=turned)),
    ("events_at_targets", "aside"): (1e-6, target(aside)),
    ("events_at_targets", "turned"): (1e-6, target(turned)),
    ("lines_straight", "aside"): (1e-4, event(pose=aside)),
    ("lines_steady", "turned"): (1e-4, event(pose=turned)),
    ("line_lengths", "longer approach"): (1e-4, stop(approach=plus)),
    ("line_lengths", "shorter retract"): (1e-4, stop(retract=minus)),
    ("lines_at_events", "approach"): (1e-9, segment("approach", "end", minus)),
    ("lines_at_events", "retract"): (1e-9, segment("retract", "start", plus)),
    ("platform_still", "angle"): (1e-9, knot("position", DWELL + 2, "turn")),
    ("platform_still", "speed"): (1e-9, knot("velocity", DWELL + 2, "turn")),
    ("stages", "start"): (1e-9, stage("start", plus)),
    ("stages", "end"): (1e-9, stage("end", minus)),
    ("pairing", "start"): (1e-9, segment("transfer", "start", plus)),
    ("dwells", "shorter"): (1e-9, event(dwell=minus)),
    ("dwells", "share"): (1e-9, stop(dwell=more_gripper)),
    ("windows", "early"): (1e-9, window("not_before", "pick", 1.0)),
    ("windows", "late"): (1e-9, window("not_after", "place", -1.0)),
    ("lower_bound", "above"): (1e-9, bound),
}
"""Of each check: its tolerance and a fault of a size."""


@pytest.mark.parametrize(("name", "what"), FAULTS)
def test_a_fault_passes_within_its_tolerance_and_fails_beyond_it(clean, name, what):
    """0.9 and 1.1 of it on a schedule that is good otherwise."""
    allowed, fault = FAULTS[name, what]
    for share, expected in ((0.9, "passed"), (1.1, "failed")):
        assert verdict(*fault(clean.schedule, clean.job, share * allowed), name) == expected


@pytest.mark.parametrize(("share", "expected"), [(0.9, "passed"), (1.1, "failed")])
def test_a_task_may_begin_a_nanosecond_before_the_one_before_is_over(
    by_clocks, measured_lines, share, expected
):
    """`fit` comes after `fill`: the span of the one ends when that of the other begins, and so much later."""
    spans = measured_lines(by_clocks.schedule, by_clocks.job)
    begin = min(s.start for s in spans if s.event.task == "fit")
    spans = [
        dataclasses.replace(s, end=begin + share * 1e-9)
        if (s.event.task, s.event.action) == ("fill", "place")
        else s
        for s in spans
    ]
    check = check_precedence(by_clocks.schedule, by_clocks.job, spans)
    assert check.verdict == expected


def test_an_arm_stands_that_moves_by_less_than_a_microradian(by_clocks):
    """At a knot amid the right arm's wait of 2.4 s from 0.8 s on."""
    place = int(np.searchsorted(by_clocks.schedule.trajectory.time, 1.5))
    for share, expected in ((0.9, False), (1.1, True)):
        schedule, _ = knot("position", place, "r2")(by_clocks.schedule, None, share * 1e-6)
        assert (first_move(schedule, "right", 0.8, 3.2) > 0.0) is expected


def test_budgets_are_kept_within_a_nanosecond_and_a_micrometre(clean):
    """A cycle time below the duration, a clearance above the least one."""
    least = StageClearance(0, 0.02, 0.02, 0.0, ("a", "b"), 0.0)
    schedule = dataclasses.replace(clean.schedule, verification=Verification((), (least,)))
    for share, expected in ((0.9, True), (1.1, False)):
        budget = Budget(cycle_time=schedule.duration - share * 1e-9, clearance=0.02 + share * 1e-6)
        lines = judge_budget(schedule, dataclasses.replace(clean.job, budget=budget))
        assert [line.kept for line in lines] == [expected, expected]


def jumping(jumps, interval, acceleration, jerk):
    """The share of its jerk limit that one joint uses whose acceleration jumps by so much at equal intervals."""
    n = len(jumps) + 1
    a = np.concatenate([[0.0], np.cumsum(jumps)])[:, None]
    zero, inf = np.zeros((n, 1)), np.full(1, np.inf)
    motion = Trajectory(("a",), interval * np.arange(n), zero, zero, a)
    limits = JointLimits(("a",), -inf, inf, inf, np.array([acceleration]), np.array([jerk]), ("x",))
    return float(jerk_fraction(motion, limits)[0])


@pytest.mark.parametrize(("acceleration", "slack"), [(8.0, 8e-6), (np.inf, 1e-6)])
def test_a_jump_of_acceleration_is_measured_against_jerk_times_time_and_a_millionth(
    acceleration, slack
):
    """Of the acceleration limit, or of 1 rad/s² where there is none; at one instant the millionth is all there is."""
    for jump, interval in ((0.9 * slack, 0.0), (1.1 * slack, 0.0), (-0.3, 0.01), (0.7, 0.01)):
        share = jumping([jump], interval, acceleration, 50.0)
        assert share == pytest.approx(abs(jump) / (50.0 * interval + slack), rel=1e-9)
    # A joint without a jerk limit uses none of it.
    assert jumping([5.0], 0.0, acceleration, np.inf) == 0.0


def test_many_small_excesses_of_jerk_may_use_the_slack_up_ten_times():
    """Jumps of 0.5 of it at one instant, to and fro, 18 of them and 22; what lies before a slow knot is made up for."""
    slack = 8e-6
    for count in (18, 22):
        share = jumping(0.5 * slack * (-1.0) ** np.arange(count), 0.0, 8.0, 50.0)
        assert share == pytest.approx(max(0.5, 0.05 * count), rel=1e-9)
    # Twice 18 of them apart: between them nothing changes for so long that a jerk would have had ten times the way.
    some = 0.5 * slack * (-1.0) ** np.arange(18)
    motion = np.concatenate([some, [0.0], some])
    time = np.concatenate([np.zeros(19), np.full(19, 1.0)])
    zero, inf = np.zeros((len(time), 1)), np.full(1, np.inf)
    a = np.concatenate([[0.0], np.cumsum(motion)])[:, None]
    limits = JointLimits(("a",), -inf, inf, inf, np.array([8.0]), np.array([50.0]), ("x",))
    share = jerk_fraction(Trajectory(("a",), time, zero, zero, a), limits)
    assert share[0] == pytest.approx(0.9, rel=1e-9)
