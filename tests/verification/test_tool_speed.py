"""The cap on tool speeds: measured against the Jacobian, and at the instants where it matters."""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.model.motion.joint_motion import JointMotion
from dualarm_cli.verification import verify


def fastest(schedule, arm):
    """Returns the largest speed of a tool by pinocchio's Jacobian, every 0.5 ms [m/s]."""
    model = pin.buildModelFromXML(schedule.robot.urdf)
    data = model.createData()
    part = schedule.robot.arms[arm]
    frame = model.getFrameId(part.flange)
    times = np.linspace(0, schedule.duration, 9_601)
    top = 0.0
    for q, v in zip(*schedule.trajectory.at(times)[:2], strict=True):
        J = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL)
        twist = part.tcp.actInv(pin.Motion(J @ v))
        top = max(top, float(np.linalg.norm(twist.linear)))
    return top


def speed_check(schedule, job=None):
    """Returns the check of the cap."""
    return next(check for check in verify(schedule, job).checks if check.name == "tool_speed")


def test_the_speed_is_that_of_the_jacobian_and_the_faster_tool_is_named(clean):
    """The cap a thousandth below fails, a thousandth above passes."""
    tops = {arm: fastest(clean.schedule, arm) for arm in ("left", "right")}
    arm, top = max(tops.items(), key=lambda item: item[1])
    below = speed_check(clean.schedule, dataclasses.replace(clean.job, tool_speed=0.999 * top))
    assert below.verdict == "failed"
    assert below.detail.startswith(f"{arm} tool at ")
    assert below.measured == pytest.approx(top, rel=1e-5)
    above = speed_check(clean.schedule, dataclasses.replace(clean.job, tool_speed=1.001 * top))
    assert above.verdict == "passed"


def test_a_tool_may_be_faster_than_its_cap_by_a_ten_thousandth(clean):
    """0.9 of that passes, 1.1 of it does not."""
    top = speed_check(clean.schedule, dataclasses.replace(clean.job, tool_speed=1.0)).measured
    for share, expected in ((0.9, "passed"), (1.1, "failed")):
        job = dataclasses.replace(clean.job, tool_speed=top / (1.0 + share * 1e-4))
        assert speed_check(clean.schedule, job).verdict == expected


def test_without_a_job_the_cap_is_the_schedules_own(clean, failing):
    """Stated 0.1 m/s; a job that sets none overrules it."""
    robot = dataclasses.replace(clean.schedule.robot, tool_speed=0.1)
    schedule = dataclasses.replace(clean.schedule, robot=robot)
    assert set(failing(schedule)) == {"tool_speed"}
    assert failing(schedule, clean.job) == {}
    assert speed_check(schedule, clean.job).detail == "no cap is set"


def turning(schedule, rise, top, duration_scale=1.0):
    """Returns a schedule in which only the platform turns, with jumps of acceleration."""
    n = len(schedule.trajectory.joints)
    first = np.eye(n)[0] * top
    t = rise * duration_scale
    a = np.array([0.0, 1, 1, -1, -1, 0]) / duration_scale**2
    trajectory = dataclasses.replace(
        schedule.trajectory,
        time=np.array([0, 0, t, t, 2 * t, 2 * t]),
        position=schedule.trajectory.position[0]
        + np.outer(np.array([0, 0, 0.5, 0.5, 1, 1]) * rise**2, first),
        velocity=np.outer(np.array([0, 0, 1, 1, 0, 0]) * rise / duration_scale, first),
        acceleration=np.outer(a, first),
    )
    limits = dataclasses.replace(schedule.robot.limits, jerk=np.full(n, np.inf))
    robot = dataclasses.replace(schedule.robot, limits=limits)
    return dataclasses.replace(
        schedule, motion=JointMotion.of(trajectory), robot=robot, events=(), segments=(), stages=()
    )


def capped(schedule, cap):
    """Returns a schedule that states a cap."""
    return dataclasses.replace(schedule, robot=dataclasses.replace(schedule.robot, tool_speed=cap))


def test_a_summit_of_speed_at_a_knot_between_milliseconds_is_found(clean, failing):
    """100 rad/s² for 50.5 ms: 5.05 rad/s at the knot, 5.00 rad/s half a millisecond away."""
    schedule = turning(clean.schedule, 0.0505, 100.0)
    # The right tool's distance from the platform's axis, by plane trigonometry: reach 0.6 at φ = 0.1.
    radius = np.hypot(0.6 * np.cos(0.1), -0.5 + 0.6 * np.sin(0.1))
    left = np.hypot(0.6, 0.5)
    top = 5.05 * max(radius, left)
    assert failing(capped(schedule, top * 0.995))["tool_speed"] == "left tool at 0.051 s"
    assert failing(capped(schedule, top * 1.0001)) == {}


def test_the_width_of_the_difference_is_right_at_both_ends(clean, failing):
    """A motion of 30 µs: a window of 20 µs is cut short everywhere, yet nothing is taken for faster."""
    schedule = turning(clean.schedule, 15e-6, 100.0)
    top = 100 * 15e-6 * np.hypot(0.6, 0.5)
    assert failing(capped(schedule, top)) == {}
    assert set(failing(capped(schedule, top / 3))) == {"tool_speed"}


def test_a_motion_too_long_to_measure_fails_and_says_so(clean):
    """1e9 s at 1 kHz would need a terabyte; the judgement ends at once and is not good."""
    check = speed_check(capped(turning(clean.schedule, 0.05, 10.0, 1e10), 1.0))
    assert (check.verdict, check.measured) == ("failed", None)
    assert check.detail == "a motion of 1e+09 s is too long to check, at most 7200 s are checked"


def test_a_robot_that_never_moves_has_no_speed(clean):
    """One knot, no time: 0 m/s."""
    trajectory = clean.schedule.trajectory
    one = dataclasses.replace(
        trajectory,
        time=trajectory.time[:1],
        **{k: getattr(trajectory, k)[:1] for k in ("position", "velocity", "acceleration")},
    )
    still = dataclasses.replace(
        clean.schedule, motion=JointMotion.of(one), events=(), segments=(), stages=()
    )
    check = speed_check(capped(still, 0.1))
    assert (check.verdict, check.measured) == ("passed", 0.0)
