"""What a controller logged: errors and delays that were put in are found, and told by joint."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dualarm_cli.files.source.bundled import bundled_tasks
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.geometry.interpolation import INTERPOLATIONS
from dualarm_cli.model.motion.joint_motion import LoggedMotion
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan
from dualarm_cli.verification.recorded_motion import TrackingLimits, judge_recorded

ALLOWED = TrackingLimits(np.deg2rad(0.1), 1e-3, 2e-3)
UNPROVEN = replace(ALLOWED, clearance=False)


@pytest.fixture(scope="module")
def job():
    """The first job."""
    return load_job(bundled_tasks()["01_first_pick"])


@pytest.fixture(scope="module")
def schedule(job):
    """Its plan."""
    return plan(job, PlanSettings(effort="quick"))


def logged(schedule, delays=None, error=None, rate=250.0, joints=None):
    """Returns a log of a motion that is late by delays [s] and off by a function of time [rad], by joint."""
    delays, error = delays or {}, error or {}
    joints = joints or schedule.trajectory.joints
    time = np.arange(0.0, schedule.duration + 0.05, 1.0 / rate)
    rates = np.empty((3, len(time), len(joints)))
    for k, joint in enumerate(joints):
        own = schedule.trajectory.select([joint]).clamped(time - delays.get(joint, 0.0))
        rates[:, :, k] = [row[:, 0] for row in own]
        if joint in error:
            rates[0, :, k] += error[joint](time)
    return LoggedMotion(tuple(joints), time, *rates)


def moving(schedule):
    """Returns the joints that turn by so much that a delay can be told, by a wide margin."""
    turned = np.ptp(schedule.trajectory.position, axis=0)
    assert not ((turned > 0.01) & (turned < 0.05)).any()
    return [j for j, way in zip(schedule.trajectory.joints, turned, strict=True) if way > 0.02]


def verdicts(tracking):
    """Returns the verdict of each check."""
    return {check.name: check.verdict for check in tracking.verification.checks}


@pytest.mark.parametrize("kind", INTERPOLATIONS)
def test_a_log_of_the_plan_itself_passes(schedule, job, kind):
    """No delay, no error, tools at their events, and the clearance of the plan."""
    found = judge_recorded(schedule, job, logged(schedule), kind, ALLOWED)
    assert found.verification.passed
    assert abs(found.delay) < 1e-6
    assert max(joint.error for joint in found.joints) < 1e-4
    assert max(event.distance for event in found.events) < 1e-5
    assert {c.stage for c in found.verification.clearances} == set(range(len(schedule.stages)))


@pytest.mark.parametrize(
    "shape",
    [
        lambda t: np.sin(2 * np.pi * 0.7 * t),
        lambda t: np.sin(2 * np.pi * 5.0 * t),
        lambda t: np.ones_like(t),
        lambda t: np.random.default_rng(1).uniform(-1.0, 1.0, t.size),
    ],
    ids=["slow swing", "vibration", "offset", "noise"],
)
def test_half_a_degree_and_eight_milliseconds_are_found_by_joint(schedule, job, shape):
    """All joints are 8 ms late and one is 0.5° off: each is told of the joint that it was put in."""
    joints = schedule.trajectory.joints
    log = logged(
        schedule,
        dict.fromkeys(joints, 0.008),
        {"left_e": lambda t: np.deg2rad(0.5) * shape(t)},
    )
    found = judge_recorded(schedule, job, log, "linear", UNPROVEN)
    assert not found.verification.passed
    assert found.delay == pytest.approx(0.008, abs=2e-4)
    rows = {joint.joint: joint for joint in found.joints}
    assert all((row.delay is None) == (name not in moving(schedule)) for name, row in rows.items())
    rows = {name: rows[name] for name in moving(schedule)}
    for name, row in rows.items():
        # Half a degree of noise is as much as a joint of 1 rad/s turns in 9 ms.
        assert row.delay == pytest.approx(0.008, abs=2e-3 if name == "left_e" else 1e-4)
    assert np.rad2deg(rows.pop("left_e").error) == pytest.approx(0.5, abs=0.02)
    assert all(np.rad2deg(row.error) < 0.02 for row in rows.values())
    checks = {check.name: check for check in found.verification.checks}
    assert checks["tracking_error"].verdict == "failed"
    assert checks["tracking_error"].detail.startswith("left_e 0.")
    assert checks["delay"].verdict == "failed"
    assert all(f"{joint} 8." in checks["delay"].detail for joint in rows)


def test_an_offset_alone_is_the_joints_mean_error(schedule, job):
    """With its sign, and no delay."""
    log = logged(schedule, error={"right_t": lambda t: np.full_like(t, -0.01)})
    found = judge_recorded(schedule, job, log, "linear", UNPROVEN)
    [row] = [joint for joint in found.joints if joint.joint == "right_t"]
    assert row.offset == pytest.approx(-0.01, abs=1e-5)
    assert row.error == pytest.approx(0.01, abs=1e-4)
    assert row.delay == pytest.approx(0.0, abs=1e-5)
    assert verdicts(found)["delay"] == "passed"


@pytest.mark.parametrize("late", [-0.3, 0.0004, 0.05, 0.7])
def test_delays_of_any_size_are_measured(schedule, job, late):
    """Early or late, up to most of a second."""
    log = logged(schedule, dict.fromkeys(schedule.trajectory.joints, late))
    found = judge_recorded(schedule, job, log, "linear", UNPROVEN)
    assert found.delay == pytest.approx(late, abs=1e-4)


def test_one_arm_that_is_late_is_told_and_counts_for_the_clearance(schedule, job):
    """The other arm is in time: there is no common delay, and the tools of the late arm are off at no event."""
    late = {joint: 0.02 for joint in schedule.robot.arms["left"].joints}
    found = judge_recorded(schedule, job, logged(schedule, late), "cubic", ALLOWED)
    assert found.delay == pytest.approx(0.0, abs=1e-5)
    rows = {row.joint: row for row in found.joints}
    for joint in moving(schedule):
        assert rows[joint].delay == pytest.approx(late.get(joint, 0.0), abs=1e-4)
    assert verdicts(found)["delay"] == "failed"
    assert verdicts(found)["tracking_error"] == "passed"


def test_an_arm_that_moved_far_away_touches_something(schedule, job):
    """The proof is that of the recorded motion: a joint that is off by more than a radian collides somewhere."""
    off = {
        joint: (lambda t: 2.0 * np.sin(np.pi * t / t[-1]) ** 2) for joint in ("left_l", "left_e")
    }
    found = judge_recorded(schedule, job, logged(schedule, error=off), "linear", ALLOWED)
    assert verdicts(found)["collisions"] == "failed"
    least = min(stage.clearance for stage in found.verification.clearances)
    assert least <= 0.0


def test_a_log_that_goes_too_far_for_a_proof_fails_at_once(schedule, job):
    """Positions that jump by 100,000 rad from sample to sample: a proof would take as many intervals."""
    far = {"left_l": lambda t: 1e5 * (np.arange(len(t)) % 2)}
    found = judge_recorded(schedule, job, logged(schedule, error=far), "linear", ALLOWED)
    [check] = [one for one in found.verification.checks if one.name == "collisions"]
    assert (check.verdict, found.verification.clearances) == ("failed", ())
    assert "cannot be proven: on average a joint moves at " in check.detail


def test_the_tools_of_a_turned_joint_are_off_as_far_as_the_lever_says(schedule, job):
    """The base joint of an arm off by 0.01 rad moves its tool by 0.01 times its distance from the joint's axis."""
    import pinocchio as pin

    log = logged(schedule, error={"left_s": lambda t: np.full_like(t, 0.01)})
    found = judge_recorded(schedule, job, log, "linear", UNPROVEN)
    model = pin.buildModelFromXML(schedule.robot.urdf)
    data = model.createData()
    joint = model.getJointId("left_s")
    for row in found.events:
        if row.event.arm != "left":
            assert row.distance < 1e-5
            continue
        q = np.zeros(model.nq)
        names = schedule.trajectory.joints
        values = schedule.trajectory.clamped(np.array([row.event.time]))[0][0]
        for name, value in zip(names, values, strict=True):
            q[model.idx_qs[model.getJointId(name)]] = value
        pin.computeJointJacobians(model, data, q)
        spatial = pin.getJointJacobian(model, data, joint, pin.WORLD)[:, model.idx_vs[joint]]
        tool = schedule.robot.base.actInv(row.event.pose).translation
        lever = np.linalg.norm(spatial[:3] + np.cross(spatial[3:], tool))
        assert row.distance == pytest.approx(0.01 * lever, rel=1e-2)
        assert row.angle == pytest.approx(0.01, rel=1e-3)


def test_joints_that_were_not_logged_count_as_planned(schedule, job):
    """Where that is asked for: it is said which joints are missing, and the rest is judged."""
    own = schedule.robot.arms["right"].joints
    log = logged(schedule, joints=own)
    found = judge_recorded(schedule, job, log, "cubic", ALLOWED, as_planned=True)
    assert found.verification.passed
    [check] = [check for check in found.verification.checks if check.name == "joints"]
    assert check.verdict == "not checked"
    assert "left_s" in check.detail
    assert "right_s" not in check.detail


def test_what_was_not_logged_is_not_checked_and_does_not_pass(schedule, job):
    """One joint, two samples: no figure of the plan is shown for one of the motion. One arm: its tool is judged."""
    one = logged(schedule, joints=["left_s"])
    found = judge_recorded(schedule, job, one, "linear", ALLOWED)
    assert not found.verification.passed
    told = verdicts(found)
    assert told["joints"] == "failed"
    assert told["tool_at_events"] == told["collisions"] == "not checked"
    assert found.events == found.verification.clearances == ()
    robot = schedule.robot
    own = (*robot.platform, *robot.arms["left"].joints)
    found = judge_recorded(schedule, job, logged(schedule, joints=own), "linear", ALLOWED)
    assert not found.verification.passed
    assert verdicts(found)["tool_at_events"] == "passed"
    assert {row.event.arm for row in found.events} == {"left"}
    [check] = [check for check in found.verification.checks if check.name == "tool_at_events"]
    assert "only of the left arm" in check.detail


def test_a_log_of_few_samples_is_not_excused_by_its_steps(schedule, job):
    """Two samples, the second one amid the plan: twice the step would be more than what is missing."""
    log = logged(schedule)
    ends = [0, int(0.4 * len(log.time))]
    short = LoggedMotion(log.joints, log.time[ends], log.position[ends])
    found = judge_recorded(schedule, job, short, "linear", UNPROVEN)
    assert verdicts(found)["time_span"] == "failed"


def test_a_log_that_ends_early_fails(schedule, job):
    """Half of the motion is no evidence of the other half."""
    log = logged(schedule)
    half = len(log.time) // 2
    rates = (log.position[:half], log.velocity[:half], log.acceleration[:half])
    short = LoggedMotion(log.joints, log.time[:half], *rates)
    found = judge_recorded(schedule, job, short, "cubic", UNPROVEN)
    assert verdicts(found)["time_span"] == "failed"


def test_limits_are_those_of_the_interpolation(schedule, job):
    """A motion played twice as fast has twice the velocities and four times the accelerations."""
    log = logged(schedule)
    fast = LoggedMotion(
        log.joints, log.time / 2.0, log.position, log.velocity * 2.0, log.acceleration * 4.0
    )
    found = judge_recorded(schedule, job, fast, "cubic", UNPROVEN)
    checks = {check.name: check for check in found.verification.checks}
    plain = judge_recorded(schedule, job, log, "cubic", UNPROVEN)
    before = {check.name: check for check in plain.verification.checks}
    for name, factor in (("velocity", 2.0), ("acceleration", 4.0)):
        assert checks[name].measured == pytest.approx(factor * before[name].measured, rel=1e-9)
        assert checks[name].verdict == "failed"


@pytest.mark.parametrize("kind", ["cubic", "quintic"])
def test_an_interpolation_needs_its_derivatives(schedule, job, kind):
    """Positions alone are linear."""
    log = logged(schedule)
    bare = LoggedMotion(log.joints, log.time, log.position)
    with pytest.raises(ValueError, match=f"{kind} interpolation needs velocities"):
        judge_recorded(schedule, job, bare, kind, ALLOWED)
