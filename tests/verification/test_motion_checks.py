"""Numbers, agreement, limits and rest: every fault is found by its own check, with joint and time."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.motion.joint_motion import JointMotion
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.verification import verify
from dualarm_cli.verification.measuring.criteria import judge
from dualarm_cli.verification.motion_checks import (
    check_agreement,
    check_limits,
    check_time,
    position_extrema,
    velocity_extrema,
)

RATES = ("position", "velocity", "acceleration")
MIDDLE = 18
"""A knot in the middle of the second transfer, where no event is."""


def edited(schedule, name, knot, joint, change):
    """Returns one array of the trajectory with one number changed."""
    values = np.array(getattr(schedule.trajectory, name))
    if name == "time":
        values[knot] += change
    else:
        values[knot, schedule.trajectory.joints.index(joint)] += change
    return {name: values}


@pytest.mark.parametrize("name", ["time", *RATES])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_numbers_that_are_not_finite_are_a_finding_and_end_the_judgement(clean, moved, name, value):
    """One NaN: `finite` fails and counts it, everything else is said not to be checked."""
    schedule = moved(clean.schedule, **edited(clean.schedule, name, MIDDLE, "l2", value))
    verification = verify(schedule, clean.job)
    finite, rest = verification.checks
    assert (finite.name, finite.verdict, finite.measured) == ("finite", "failed", 1.0)
    assert finite.detail == f"1 in {name} not finite"
    assert rest.verdict == "not checked"
    assert not verification.passed


def test_time_that_runs_backwards_is_found_at_its_knot(clean, moved, failing):
    """Knot 19 at 2.39 s after knot 18 at 2.4 s."""
    change = 2.39 - clean.schedule.trajectory.time[MIDDLE + 1]
    schedule = moved(clean.schedule, **edited(clean.schedule, "time", MIDDLE + 1, "", change))
    assert failing(schedule, clean.job) == {"time": f"runs backwards at knot {MIDDLE + 1}"}


def test_time_that_runs_backwards_by_half_a_nanosecond_is_found_in_a_stand_still(
    clean, refined, moved, failing
):
    """In the first dwell no position, velocity or acceleration shows it: only time itself does."""
    schedule = refined(clean.schedule, [1.25])
    time = np.array(schedule.trajectory.time)
    knot = int(np.searchsorted(time, 1.25))
    time[knot] = time[knot - 1] - 5e-10
    assert failing(moved(schedule, time=time)) == {"time": f"runs backwards at knot {knot}"}


def test_time_that_does_not_start_at_zero_is_found(clean, moved, failing):
    """All knots a second later."""
    schedule = moved(clean.schedule, time=clean.schedule.trajectory.time + 1.0)
    assert failing(schedule, clean.job) == {"time": "starts at 1 s"}


def test_one_knot_alone_has_a_time_without_steps():
    """A trajectory of one knot is no motion and no fault of time."""
    zero = np.zeros((1, 1))
    assert (
        check_time(JointMotion.of(Trajectory(("a",), np.zeros(1), zero, zero, zero))).verdict
        == "passed"
    )


def test_a_position_that_is_a_microradian_off_names_joint_and_time(clean, moved, failing):
    """1e-6 rad at 2.4 s is a hundred times the tolerance; 5e-9 rad is none."""
    for change, expected in ((1e-6, {"position_agreement"}), (5e-9, set())):
        arrays = edited(clean.schedule, "position", MIDDLE, "l2", change)
        found = failing(moved(clean.schedule, **arrays), clean.job)
        assert set(found) == expected
        assert found.get("position_agreement", "l2 at 2.4").startswith("l2 at 2.")


@pytest.mark.parametrize(("step", "verdict"), [(1e-12, "passed"), (1e-10, "failed")])
def test_rounding_in_hours_is_not_added_up(step, verdict):
    """In five hours knots with 1e-12 rad each are 3.6e-7 rad, in a minute 1.2e-9; with 1e-10 rad 1.2e-7 there."""
    time = 0.05 * np.arange(360_000)
    position, zero = step * np.arange(len(time))[:, None], np.zeros((len(time), 1))
    found = check_agreement(Trajectory(("a",), time, position, zero, zero))
    assert [check.verdict for check in found] == [verdict, "passed"]


def test_a_velocity_that_is_off_names_joint_and_time(clean, moved, failing):
    """1e-6 rad/s breaks the integral of the velocity and that of the position (0.2 s later)."""
    arrays = edited(clean.schedule, "velocity", MIDDLE, "r3", 1e-6)
    found = failing(moved(clean.schedule, **arrays), clean.job)
    assert set(found) == {"position_agreement", "velocity_agreement"}
    assert all(detail.startswith("r3 at 2.") for detail in found.values())


def test_an_acceleration_that_is_off_is_found_by_its_integrals(clean, moved, failing):
    """1e-4 rad/s² times 0.1 s is 1e-5 rad/s."""
    arrays = edited(clean.schedule, "acceleration", MIDDLE, "turn", 1e-4)
    found = failing(moved(clean.schedule, **arrays), clean.job)
    assert set(found) == {"position_agreement", "velocity_agreement"}


def peak(schedule, rate, joint):
    """Returns the largest rate of a joint by dense sampling and differences of knots."""
    trajectory = schedule.trajectory
    column = trajectory.joints.index(joint)
    if rate == "jerk":
        return np.abs(np.diff(trajectory.acceleration[:, column]) / np.diff(trajectory.time)).max()
    times = np.union1d(np.linspace(0, trajectory.duration, 20_001), trajectory.time)
    return np.abs(trajectory.at(times)[("position", "velocity", "acceleration").index(rate)]).max(
        axis=0
    )[column]


@pytest.mark.parametrize("rate", ["velocity", "acceleration", "jerk"])
@pytest.mark.parametrize("joint", ["turn", "l1", "r2"])
def test_half_a_limit_is_exceeded_twice_by_the_joint_that_is_named(
    clean, limited, failing, rate, joint
):
    """The limit at half of what the joint does: that check alone fails, at 2."""
    top = peak(clean.schedule, rate, joint)
    job = limited(clean.job, rate, joint, top / 2)
    found = failing(clean.schedule, job)
    assert set(found) == {rate}
    assert found[rate].startswith(f"{joint}, limit ")
    check = next(c for c in verify(clean.schedule, job).checks if c.name == rate)
    # A jerk is allowed a millionth of the acceleration limit more: 2e-4 rad/s² over 0.1 s at least.
    assert check.measured == pytest.approx(2.0, rel=2e-3)


@pytest.mark.parametrize("rate", ["velocity", "acceleration", "jerk"])
def test_a_limit_that_is_used_to_the_full_is_kept(clean, limited, failing, rate):
    """Exactly the peak passes; a hundredth less does not."""
    top = peak(clean.schedule, rate, "r2")
    assert failing(clean.schedule, limited(clean.job, rate, "r2", top)) == {}
    assert set(failing(clean.schedule, limited(clean.job, rate, "r2", 0.99 * top))) == {rate}


def test_without_a_job_the_schedule_is_held_to_its_own_limits(clean, limited, failing):
    """The same limit, stated by the schedule."""
    job = limited(clean.job, "velocity", "l1", peak(clean.schedule, "velocity", "l1") / 2)
    robot = dataclasses.replace(clean.schedule.robot, limits=job.cell.robot.limits)
    schedule = dataclasses.replace(clean.schedule, robot=robot)
    assert set(failing(schedule)) == {"velocity"}
    # With a job the schedule's own statement counts for nothing.
    assert failing(schedule, clean.job) == {}


def test_the_speed_of_a_job_scales_its_limits(clean, limited):
    """At half speed a motion at its limits is 2, 4 and 8 times too fast in velocity, acceleration, jerk."""
    job = clean.job
    for rate in ("velocity", "acceleration", "jerk"):
        job = limited(job, rate, "turn", peak(clean.schedule, rate, "turn"))
    assert verify(clean.schedule, job).passed
    slow = verify(clean.schedule, dataclasses.replace(job, speed=0.5))
    shares = {check.name: check.measured for check in slow.failures}
    assert shares == pytest.approx({"velocity": 2.0, "acceleration": 4.0, "jerk": 8.0}, rel=1e-3)


def test_a_position_limit_that_is_exceeded_between_two_knots_only_is_found(
    clean, limited, refined, bumped, failing
):
    """Two swings one knot apart have their summit between knots, above every knot."""
    knots = clean.schedule.trajectory.time
    schedule = refined(clean.schedule, list((knots[16:20] + knots[17:21]) / 2))
    for knot in (17, 18):
        schedule = bumped(schedule, knot, {"r1": 0.5})
    trajectory = schedule.trajectory
    at_knots = trajectory.position[:, 4].max()
    between = trajectory.at(np.linspace(0, trajectory.duration, 100_001))[0][:, 4].max()
    assert between > at_knots + 1e-3
    limit = (between + at_knots) / 2
    assert failing(schedule, limited(clean.job, "upper", "r1", limit)) == {"position": "r1"}
    assert failing(schedule, limited(clean.job, "upper", "r1", between + 1e-6)) == {}


@pytest.mark.parametrize(("side", "sign"), [("lower", -1), ("upper", 1)])
def test_one_sided_position_limits_are_checked(clean, side, sign):
    """Only lower or only upper limits are stated, all others are infinite."""
    n = len(clean.schedule.trajectory.joints)
    lower, upper = np.full(n, -np.inf), np.full(n, np.inf)
    # r2 is between -1.79 and -1.01 rad.
    (lower if side == "lower" else upper)[5] = -1.4
    limits = dataclasses.replace(clean.job.cell.robot.limits, lower=lower, upper=upper)
    position = check_limits(clean.schedule.trajectory, limits)[0]
    assert (position.name, position.verdict, position.detail) == ("position", "failed", "r2")
    extreme = (sign * clean.schedule.trajectory.position[:, 5]).max()
    assert position.measured == pytest.approx(extreme + sign * 1.4)


def test_limits_that_nobody_states_are_not_checked_and_the_reason_is_given(clean):
    """All infinite: four times not checked; one limit of seven: the others are listed."""
    joints = clean.schedule.trajectory.joints
    none = np.full(len(joints), np.inf)
    limits = JointLimits(joints, -none, none, none, none, none, ("unstated",) * len(joints))
    checks = check_limits(clean.schedule.trajectory, limits)
    assert [check.verdict for check in checks] == ["not checked"] * 4
    assert all(check.detail for check in checks)
    some = none.copy()
    some[0] = 1000.0
    checks = check_limits(clean.schedule.trajectory, dataclasses.replace(limits, jerk=some))
    assert checks[3].verdict == "passed"
    assert checks[3].detail.endswith("without such a limit: l1, l2, l3, r1, r2, r3")


def turning(schedule, rise, top, joints=("turn",)):
    """Returns a schedule in which joints speed up and slow down at full strength, nothing else.

    Double knots at the start, in the middle and at the end: the acceleration jumps 0, A, -A, 0.
    """
    n = len(schedule.trajectory.joints)
    shape = np.zeros(n)
    shape[[schedule.trajectory.joints.index(joint) for joint in joints]] = top
    time = np.array([0, 0, rise, rise, 2 * rise, 2 * rise])
    angle = np.array([0, 0, 0.5, 0.5, 1.0, 1.0]) * rise**2
    speed = np.array([0, 0, 1, 1, 0, 0]) * rise
    strength = np.array([0.0, 1, 1, -1, -1, 0])
    start = schedule.trajectory.position[0]
    trajectory = dataclasses.replace(
        schedule.trajectory,
        time=time,
        position=start + np.outer(angle, shape),
        velocity=np.outer(speed, shape),
        acceleration=np.outer(strength, shape),
    )
    return dataclasses.replace(
        schedule, motion=JointMotion.of(trajectory), events=(), segments=(), stages=()
    )


def test_a_jump_of_acceleration_is_for_joints_without_a_jerk_limit_only(clean, failing):
    """Two knots at one time: no finite jerk does that; the joint is named."""
    schedule = turning(clean.schedule, 0.05, 50.0, ("l2",))
    assert set(found := failing(schedule)) == {"jerk"}
    assert found["jerk"].startswith("l2, limit 2000")
    free = np.array(schedule.robot.limits.jerk)
    free[2] = np.inf
    limits = dataclasses.replace(schedule.robot.limits, jerk=free)
    robot = dataclasses.replace(schedule.robot, limits=limits)
    assert failing(dataclasses.replace(schedule, robot=robot)) == {}


def test_a_jump_of_position_or_velocity_is_a_fault_even_without_a_jerk_limit(clean, failing):
    """At a double knot only the acceleration may differ."""
    schedule = turning(clean.schedule, 0.05, 50.0)
    limits = dataclasses.replace(schedule.robot.limits, jerk=np.full(7, np.inf))
    schedule = dataclasses.replace(
        schedule, robot=dataclasses.replace(schedule.robot, limits=limits)
    )
    for name in ("position", "velocity"):
        values = np.array(getattr(schedule.trajectory, name))
        values[3:, 0] += 1e-6
        trajectory = dataclasses.replace(schedule.trajectory, **{name: values})
        found = failing(dataclasses.replace(schedule, motion=JointMotion.of(trajectory)))
        assert found[f"{name}_agreement"] == "turn at 0.050000 s"


@pytest.mark.parametrize("end", [0, -1])
def test_a_motion_that_does_not_begin_or_end_at_rest_is_found(clean, moved, failing, end):
    """A jerk that is 5e-7 rad/s³ off in the outermost 0.2 s: 1e-7 rad/s² at the end, 7e-10 rad off."""
    h, off = 0.2, 5e-7
    sign = -1 if end == 0 else 1
    arrays = {name: np.array(getattr(clean.schedule.trajectory, name)) for name in RATES}
    for name, change in zip(
        RATES, (sign * off * h**3 / 6, off * h**2 / 2, sign * off * h), strict=True
    ):
        arrays[name][end, 3] += change
    found = failing(moved(clean.schedule, **arrays), clean.job)
    assert found == {"rest": f"l3 at the {'start' if end == 0 else 'end'}"}


def random_trajectory(jerks, steps, start):
    """Returns the motion of one joint under piecewise constant jerks from a start (q, v, a)."""
    rows = [start]
    for jerk, h in zip(jerks, steps, strict=True):
        q, v, a = rows[-1]
        rows.append((
            q + h * (v + h * (a / 2 + h * jerk / 6)),
            v + h * (a + h * jerk / 2),
            a + h * jerk,
        ))  # fmt: skip
    q, v, a = np.array(rows).T[..., None]
    return Trajectory(("a",), np.concatenate([[0.0], np.cumsum(steps)]), q, v, a)


jerk = st.one_of(st.just(0.0), st.floats(-100, 100), st.floats(-1e-9, 1e-9))
rate = st.one_of(st.just(0.0), st.floats(-5, 5))


@settings(max_examples=150, deadline=None)
@given(
    pieces=st.lists(st.tuples(jerk, st.floats(1e-3, 1.0)), min_size=1, max_size=5),
    start=st.tuples(rate, rate, rate),
)
def test_extrema_are_those_of_dense_sampling(pieces, start):
    """A thousand instants per piece miss a summit by at most |a| δ²/8, a velocity by |j| δ²/8."""
    jerks, steps = np.array(pieces).T
    trajectory = random_trajectory(jerks, steps, start)
    times = np.unique(np.linspace(trajectory.time[:-1], trajectory.time[1:], 1001))
    q, v, a = (values[:, 0] for values in trajectory.at(times))
    low, high = (float(values[0]) for values in position_extrema(trajectory))
    fastest = float(velocity_extrema(trajectory)[0])
    fine = (steps.max() / 1000) ** 2 / 8
    rounding = 1e-9 * (1 + np.abs(q).max() + np.abs(v).max() + np.abs(a).max())
    allowed = 1.01 * np.abs(a).max() * fine + rounding
    assert q.min() - allowed <= low <= q.min() + rounding
    assert q.max() - rounding <= high <= q.max() + allowed
    # The jerk is a quotient of differences: where it is small beside the acceleration it is rounded.
    assert np.abs(v).max() - rounding <= fastest
    assert fastest <= np.abs(v).max() + 1.01 * np.abs(jerks).max() * fine + rounding


def test_a_summit_by_hand_is_found():
    """The position 1 + t - t² on [0, 1]: 1.25 at 0.5 s. The speed t - t²: 0.25 at 0.5 s."""
    trajectory = random_trajectory([0.0], [1.0], (1.0, 1.0, -2.0))
    low, high = position_extrema(trajectory)
    assert (low[0], high[0]) == pytest.approx((1.0, 1.25), abs=1e-15)
    assert velocity_extrema(random_trajectory([-2.0], [1.0], (0.0, 0.0, 1.0)))[0] == pytest.approx(
        0.25, abs=1e-15
    )


def test_a_single_knot_has_its_own_extrema():
    """No interval, no root."""
    trajectory = random_trajectory([], [], (0.5, -2.0, 3.0))
    assert [float(x[0]) for x in position_extrema(trajectory)] == [0.5, 0.5]
    assert velocity_extrema(trajectory)[0] == 2.0


@pytest.mark.parametrize(
    ("measured", "verdict", "value"),
    [
        (1.0, "passed", 1.0),
        (1.0000001, "failed", 1.0000001),
        (np.nan, "failed", None),
        (np.inf, "failed", None),
    ],
)
def test_a_measurement_passes_up_to_what_is_allowed_and_nan_never(measured, verdict, value):
    """Numbers that JSON does not know are said as null."""
    check = judge("windows", measured, 1.0, "here")
    assert (check.verdict, check.measured) == (verdict, value)


def test_a_group_whose_time_runs_backwards_or_starts_late_is_named() -> None:
    """All joints together have rising times from 0 on, as they are sorted; the group's own have not."""
    joints, zero = ("a", "b"), np.zeros((3, 1))
    for times, words in (
        ([0.0, 2.0, 1.0], "runs backwards at knot 2 of right"),
        ([0.5, 1.0, 2.0], "starts at 0.5 s of right"),
    ):
        groups = {
            "left": Trajectory(("a",), np.array([0.0, 1.0, 2.0]), zero, zero, zero),
            "right": Trajectory(("b",), np.array(times), zero, zero, zero),
        }
        motion = JointMotion(joints, groups)
        assert (np.diff(motion.trajectory.time) > 0).all()
        found = check_time(motion)
        assert (found.verdict, found.detail) == ("failed", words)


def test_a_motion_within_the_margin_of_a_limit_fails(quick_plan, tasks_folder):
    """A margin that ends 10 mrad below the highest knot of the plan; without it the plan passes."""
    path = tasks_folder / "01_first_pick" / "tasks.yaml"
    schedule, job = quick_plan("01_first_pick"), load_job(path)
    joint = "left_b"
    highest = float(schedule.joint(joint).position.max())
    room = float(job.cell.robot.limits.upper[job.cell.robot.joints.index(joint)]) - highest
    margin = {f"robot:/limits/{joint}/position_margin": room + 0.01}
    [failed] = verify(schedule, load_job(path, overrides=margin)).failures
    assert (failed.name, failed.detail) == ("position", joint)
    assert failed.measured == pytest.approx(0.01, abs=1e-3)  # between knots it is a little more
    assert verify(schedule, job).passed
