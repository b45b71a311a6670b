"""Path checks on a planned job of both arms, and on what became of it by tampering."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinds.path.checks import (
    CRITERIA,
    _double_s,
    _excess_time,
    along_path,
    check_paths,
)
from dualarm_cli.model.motion.joint_motion import JointMotion
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.verification import verify
from dualarm_cli.verification.measuring.tool_model import ToolModel

CELL = """\
dualarm: cell/1
robot: sda10f
tools:
  left:  {tcp: {xyz: [0, 0, 120 mm]}}
  right: {tcp: {xyz: [0, 0, 120 mm]}}
"""
TASKS = """\
dualarm: tasks/1
cell: cell.yaml
start: free
tasks:
  - id: seam
    path:
      redundancy: arm_angle
      speed: 100 mm/s
      left:
        through:
          - {xyz: [0.45, 0.25, 0.90], rpy: [180 deg, 0, 0]}
          - {xyz: [0.50, 0.25, 0.90]}
          - {turn: {about: [0.50, 0.29, 0.90], axis: [0, 0, 1], angle: 60 deg, tool: keeps}}
      right:
        through:
          - {xyz: [0.45, -0.25, 0.90], rpy: [180 deg, 0, 0]}
          - {xyz: [0.50, -0.25, 0.90]}
"""
LENGTH = 0.05 + 0.04 * np.pi / 3
"""Length of the left path, the longer one [m]."""
SPEED = 0.1


@pytest.fixture(scope="module")
def planned(tmp_path_factory):
    """Two tools that follow a path each, and nothing else: the whole motion is the path."""
    folder = tmp_path_factory.mktemp("seam")
    (folder / "dualarm.toml").write_text("")
    (folder / "cell.yaml").write_text(CELL)
    (folder / "tasks.yaml").write_text(TASKS)
    job = load_job(folder / "tasks.yaml")
    return SimpleNamespace(job=job, schedule=plan_without_bound(job, PlanSettings()))


def paths(schedule, job):
    """The path checks by name."""
    return {check.name: check for check in check_paths(schedule, job, ToolModel(schedule))}


def failed(checks):
    """Names of those that failed."""
    return {name for name, check in checks.items() if check.verdict == "failed"}


def with_motion(schedule, time, position, velocity, acceleration):
    """The schedule with another motion, its path segments and events as long as that."""
    trajectory = Trajectory(schedule.trajectory.joints, time, position, velocity, acceleration)
    end = float(time[-1])
    return dataclasses.replace(
        schedule,
        motion=JointMotion.of(trajectory),
        segments=tuple(dataclasses.replace(s, end=end) for s in schedule.segments),
        events=tuple(dataclasses.replace(e, time=end) for e in schedule.events),
        stages=tuple(dataclasses.replace(s, end=end) for s in schedule.stages),
    )


def knots(schedule):
    """Time, position, velocity and acceleration at the knots, to be written to."""
    t = schedule.trajectory
    return tuple(np.array(a) for a in (t.time, t.position, t.velocity, t.acceleration))


def test_what_is_planned_passes(planned):
    """All checks, each of something but rounded corners, which it has none of; and the rest of the verifier."""
    checks = paths(planned.schedule, planned.job)
    assert tuple(checks) == tuple(CRITERIA)
    assert checks.pop("path_corners").verdict == "not checked"
    assert {check.verdict for check in checks.values()} == {"passed"}
    assert verify(planned.schedule, planned.job).passed


def test_a_joint_off_by_a_milliradian_fails_the_distance(planned, bumped):
    """In the middle, for some milliseconds: 0.6 m from the axis that is 0.6 mm; 0.1 mm is allowed."""
    middle = len(planned.schedule.trajectory.time) // 2
    schedule = bumped(planned.schedule, middle, {"left_s": 1e-3})
    check = paths(schedule, planned.job)["path_distance"]
    assert check.verdict == "failed"
    assert "seam (left)" in check.detail
    # By hand: how far that knot's tool is from the planned one's. Both are on the path to 25 um.
    model, time = ToolModel(schedule), schedule.trajectory.time[[middle + 2]]
    there = model.poses("left", schedule.trajectory.clamped(time)[0])[1]
    planned_there = model.poses("left", planned.schedule.trajectory.clamped(time)[0])[1]
    moved = float(np.linalg.norm(there - planned_there))
    assert moved > 2e-4
    assert 1.0 < check.measured <= moved / 1e-4 + 0.3


def test_the_other_arm_is_not_blamed(planned, bumped):
    """The same on the right."""
    schedule = bumped(planned.schedule, 100, {"right_s": -1e-3})
    assert "seam (right)" in paths(schedule, planned.job)["path_distance"].detail


def test_a_turned_tool_fails_the_angle_and_not_the_distance(planned, bumped):
    """The last joint's axis goes through the tool centre point: 2 mrad where 0.1 mm / 0.1 m = 1 mrad is allowed."""
    schedule = bumped(planned.schedule, 100, {"left_t": 2e-3})
    checks = paths(schedule, planned.job)
    assert failed(checks) == {"path_angle"}
    assert checks["path_angle"].measured == pytest.approx(2.0, rel=1e-3)
    half = paths(bumped(planned.schedule, 100, {"left_t": 0.9e-3}), planned.job)["path_angle"]
    assert half.verdict == "passed"
    assert half.measured == pytest.approx(0.9, rel=1e-3)


def test_the_tolerance_of_the_file_decides(planned, bumped):
    """What fails at 0.1 mm passes at 10 mm."""
    schedule = bumped(planned.schedule, 100, {"left_s": 1e-3})
    work = dataclasses.replace(planned.job.tasks[0].path, tolerance=1e-2)
    job = dataclasses.replace(
        planned.job, tasks=tuple(dataclasses.replace(t, path=work) for t in planned.job.tasks)
    )
    checks = paths(schedule, job)
    assert checks["path_distance"].verdict == "passed"
    assert checks["path_distance"].measured < 0.1


def test_a_path_played_backwards_makes_no_progress(planned):
    """It is on the path all the time and not too fast, but begins at its end."""
    time, q, v, a = knots(planned.schedule)
    schedule = with_motion(planned.schedule, time[-1] - time[::-1], q[::-1], -v[::-1], a[::-1])
    checks = paths(schedule, planned.job)
    assert failed(checks) == {"path_progress"}
    assert checks["path_progress"].measured == pytest.approx(LENGTH, rel=1e-6)
    assert not verify(schedule, planned.job).passed


def test_going_back_a_little_fails_the_progress(planned):
    """Forwards to 60 %, back to 40 %, forwards again: the tool is 20 % of the way behind where it was."""
    time, q, v, a = knots(planned.schedule)
    n = len(time)
    high, low = int(0.6 * n), int(0.4 * n)
    order = np.concatenate([np.arange(high + 1), np.arange(high, low - 1, -1), np.arange(low, n)])
    sign = np.ones(len(order))
    sign[high + 1 : 2 * high - low + 2] = -1.0
    # Where it turns round two knots are at one time.
    step = np.abs(np.diff(time[order]))
    there = np.concatenate([[0.0], np.cumsum(step)])
    schedule = with_motion(planned.schedule, there, q[order], sign[:, None] * v[order], a[order])
    checks = paths(schedule, planned.job)
    assert "path_progress" in failed(checks)
    assert "path_distance" not in failed(checks)
    # Between those knots the speed is the one asked for.
    back = SPEED * (time[high] - time[low])
    assert checks["path_progress"].measured == pytest.approx(back, rel=0.02)


def test_stopping_short_fails_the_progress(planned):
    """The path is left off 20 knots before its end."""
    time, q, v, a = knots(planned.schedule)
    schedule = with_motion(planned.schedule, time[:-20], q[:-20], v[:-20], a[:-20])
    checks = paths(schedule, planned.job)
    assert failed(checks) == {"path_progress"}
    model = ToolModel(schedule)
    goal = planned.job.tasks[0].stops[0].target.pose.translation
    missing = np.linalg.norm(model.poses("left", q[[-21]])[1][0] - goal)
    assert checks["path_progress"].measured == pytest.approx(missing, rel=0.01)


def test_starting_late_fails_the_progress(planned):
    """The motion begins 40 knots behind the path's start."""
    time, q, v, a = knots(planned.schedule)
    schedule = with_motion(planned.schedule, time[40:] - time[40], q[40:], v[40:], a[40:])
    checks = paths(schedule, planned.job)
    assert failed(checks) == {"path_progress"}
    start = planned.job.tasks[0].path.paths["left"].pose(0.0).translation
    missing = np.linalg.norm(ToolModel(schedule).poses("left", q[[40]])[1][0] - start)
    assert checks["path_progress"].measured == pytest.approx(missing, rel=0.01)


def test_a_squeezed_clock_fails_the_speed(planned):
    """In 0.8 of the time everything is 1.25 times as fast: a quarter too fast where the speed is constant."""
    time, q, v, a = knots(planned.schedule)
    schedule = with_motion(planned.schedule, 0.8 * time, q, v / 0.8, a / 0.64)
    checks = paths(schedule, planned.job)
    assert failed(checks) == {"path_speed"}
    assert checks["path_speed"].measured == pytest.approx(0.25, abs=0.005)
    # As joints go it is a good motion: nothing else of the verifier minds.
    names = {check.name for check in verify(schedule, planned.job).failures}
    assert names == {"path_speed"}


def test_a_stretched_clock_is_slower_than_asked_and_passes(planned):
    """Nothing says how slow it may be."""
    time, q, v, a = knots(planned.schedule)
    schedule = with_motion(planned.schedule, 1.25 * time, q, 0.8 * v, 0.64 * a)
    assert failed(paths(schedule, planned.job)) == set()


def test_half_the_job_s_speed_halves_what_is_allowed(planned):
    """A job at 50 % lets its tools go 50 mm/s: the schedule is twice as fast."""
    job = dataclasses.replace(planned.job, speed=0.5)
    check = paths(planned.schedule, job)["path_speed"]
    assert check.verdict == "failed"
    assert check.measured == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(("share", "expected"), [(0.9, "passed"), (1.1, "failed")])
def test_tolerances_of_paths(planned, bumped, share, expected):
    """Faults of 0.9 and 1.1 of what is allowed: the file's own tolerance, 0.5 % of speed, a nanosecond of the event."""
    middle = len(planned.schedule.trajectory.time) // 2
    spoilt = {
        "path_distance": bumped(planned.schedule, middle, {"left_s": 1e-3}),
        "path_angle": bumped(planned.schedule, middle, {"left_t": 2e-3}),
    }

    def asked(**changes):
        tasks = tuple(
            dataclasses.replace(t, path=dataclasses.replace(t.path, **changes))
            for t in planned.job.tasks
        )
        return dataclasses.replace(planned.job, tasks=tasks)

    work = planned.job.tasks[0].path
    for name, schedule in spoilt.items():
        off = paths(schedule, planned.job)[name].measured
        job = asked(tolerance=work.tolerance * off / share)
        assert paths(schedule, job)[name].verdict == expected, name
    slow = asked(speed=0.5 * work.speed)
    times = 1.0 + paths(planned.schedule, slow)["path_speed"].measured
    job = asked(speed=0.5 * work.speed * times / (1.0 + share * 5e-3))
    assert paths(planned.schedule, job)["path_speed"].verdict == expected
    for sign in (1.0, -1.0):
        events = tuple(
            dataclasses.replace(e, time=e.time + sign * share * 1e-9)
            for e in planned.schedule.events
        )
        schedule = dataclasses.replace(planned.schedule, events=events)
        assert paths(schedule, planned.job)["path_progress"].verdict == expected


def test_a_path_without_a_segment_is_missed(planned):
    """The left arm's share is not in the list; the right one's still is."""
    segments = tuple(s for s in planned.schedule.segments if s.arm == "right")
    schedule = dataclasses.replace(planned.schedule, segments=segments)
    checks = paths(schedule, planned.job)
    assert "path_progress" in failed(checks)
    assert "seam (left): 0 segments of kind path" in checks["path_progress"].detail
    assert checks["path_distance"].verdict == "passed"
    assert checks["paths_together"].verdict == "not checked"


def test_a_segment_of_another_kind_is_no_path(planned):
    """A transfer where a path should be: nothing is on the path, and that is a failure."""
    segments = tuple(dataclasses.replace(s, kind="transfer") for s in planned.schedule.segments)
    schedule = dataclasses.replace(planned.schedule, segments=segments)
    assert "path_progress" in failed(paths(schedule, planned.job))


def test_the_shorter_path_is_to_be_followed_slower(planned):
    """The right tool in 0.8 of the time, then resting: 68 mm/s are less than 100, but its share is 54 mm/s."""
    time, q, v, a = knots(planned.schedule)
    right = [k for k, j in enumerate(planned.schedule.trajectory.joints) if j.startswith("right")]
    fast = planned.schedule.trajectory.clamped(time / 0.8)
    for values, early, factor in zip((q, v, a), fast, (1.0, 0.8, 0.64), strict=True):
        values[:, right] = early[:, right] / factor
    checks = paths(with_motion(planned.schedule, time, q, v, a), planned.job)
    assert failed(checks) == {"path_speed", "paths_together"}
    assert "seam (right)" in checks["path_speed"].detail
    assert checks["path_speed"].measured == pytest.approx(0.25, abs=0.005)


def test_an_arm_that_comes_later_fails_together(planned):
    """The right arm five knots behind: its tool lags by the speed times that, in lengths of the longer path."""
    time, q, v, a = knots(planned.schedule)
    lag, n = 5, len(time)
    h = time[1] - time[0]
    later = np.arange(n + lag) * h
    right = [k for k, j in enumerate(planned.schedule.trajectory.joints) if j.startswith("right")]
    rows_left = np.minimum(np.arange(n + lag), n - 1)
    rows_right = np.maximum(np.arange(n + lag) - lag, 0)
    moved = []
    for values in (q, v, a):
        new = values[rows_left]
        new[:, right] = values[rows_right][:, right]
        moved.append(new)
    # All is at rest at both ends, so that standing still before or behind is a motion like any other.
    schedule = with_motion(planned.schedule, later, *moved)
    checks = paths(schedule, planned.job)
    assert failed(checks) == {"paths_together"}
    assert checks["paths_together"].measured == pytest.approx(SPEED * lag * h, rel=0.01)


def test_without_paths_or_tasks_nothing_is_checked(clean, planned):
    """Five checks that say why."""
    for schedule, job, why in (
        (clean.schedule, clean.job, "the job has no paths"),
        (planned.schedule, None, "no task file was given (--tasks)"),
    ):
        checks = check_paths(schedule, job, ToolModel(schedule))
        assert [check.name for check in checks] == list(CRITERIA)
        assert {(check.verdict, check.detail) for check in checks} == {("not checked", why)}


def test_one_arm_alone_has_nobody_to_be_together_with(planned):
    """The left arm's task only."""
    work = dataclasses.replace(
        planned.job.tasks[0].path, paths={"left": planned.job.tasks[0].path.paths["left"]}
    )
    job = dataclasses.replace(
        planned.job, tasks=(dataclasses.replace(planned.job.tasks[0], path=work),)
    )
    checks = paths(planned.schedule, job)
    assert failed(checks) == set()
    assert checks["paths_together"].verdict == "not checked"
    assert checks["paths_together"].detail == "no path has both arms"


def test_a_path_whose_event_is_elsewhere_is_found(planned):
    """The left tool's event is moved to the middle of its path: the motion is right, what is said of it is not."""
    events = tuple(
        dataclasses.replace(e, time=0.5 * e.time) if e.arm == "left" else e
        for e in planned.schedule.events
    )
    schedule = dataclasses.replace(planned.schedule, events=events)
    assert "path_progress" in failed(paths(schedule, planned.job))


def test_a_path_that_is_listed_twice_is_found(planned):
    """A second segment of the same path: which one is it?"""
    segments = planned.schedule.segments
    [left] = [s for s in segments if s.kind == "path" and s.arm == "left"]
    twice = dataclasses.replace(left, end=left.start + 0.1)
    schedule = dataclasses.replace(planned.schedule, segments=(*segments, twice))
    assert "path_progress" in failed(paths(schedule, planned.job))


@pytest.mark.parametrize("seed", range(200))
def test_the_least_time_of_a_distance_is_that_of_its_peak_speed(seed):
    """Ramps to a peak speed w take w/a + a/j, or 2 sqrt(w/j) below a^2/j; the peak by bisection, at most the limit."""
    rng = np.random.default_rng(seed)
    d, v, a, j = 10.0 ** rng.uniform([-4, -2, -1, 0], [1, 0.5, 1.5, 3])

    def ramp(w):
        return w / a + a / j if w * j >= a * a else 2.0 * np.sqrt(w / j)

    low, high = 0.0, v
    for _ in range(200):
        w = 0.5 * (low + high)
        low, high = (w, high) if w * ramp(w) <= d else (low, w)
    expected = 2.0 * ramp(low) + (d - low * ramp(low)) / low
    assert _double_s(d, v, a, j) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("speed", [1.0, 0.5])
@pytest.mark.parametrize("given", [(0.5, 5.0), (None, None)])
@pytest.mark.parametrize("cap", [None, 0.04])
def test_how_late_a_path_is_follows_from_its_stretches(speed, given, cap):
    """A metre with a corner after 250 mm at 100 mm/s: d/v + v/a + a/j for each stretch, half a second more is late.

    What is not given: 0.8 s to the speed and 0.4 s to the acceleration at full speed. Speeds may be 0.5 % lower.
    """
    v = min(0.1 * speed, cap or 1.0)
    to_speed, to_acceleration = 0.8 / speed, 0.4 / speed
    a = v / to_speed if given[0] is None else given[0] * speed**2
    j = a / to_acceleration if given[1] is None else given[1] * speed**3
    v *= 0.995
    # A ramp that never comes to its acceleration takes twice the root of v/j.
    ramp = v / a + a / j if v * j >= a * a else 2.0 * np.sqrt(v / j)
    asked = sum(d / v + ramp for d in (0.25, 0.75))
    work = SimpleNamespace(
        speed=0.1, acceleration=given[0], jerk=given[1], length=1.0, corners=lambda: (0.25,)
    )
    job = SimpleNamespace(speed=speed, tool_speed=cap)
    for more, late in ((0.5, 0.5), (0.0, 0.0), (-0.5, 0.0)):
        segment = SimpleNamespace(start=3.0, end=3.0 + asked + more)
        assert _excess_time(job, work, segment) == pytest.approx(late, abs=1e-9)
    twice = SimpleNamespace(**{**vars(work), "length": 2.0})
    segment = SimpleNamespace(start=0.0, end=asked + 1.0 / v)
    assert _excess_time(job, twice, segment) == pytest.approx(0.0, abs=1e-9)


def test_a_path_that_ends_where_it_begins_is_followed_from_its_start():
    """Once round a circle of 0.1 m at a steady pace, turning with it, 0.02 mm outside: places by angle."""
    length = 0.2 * np.pi

    def at(s):
        angle = np.asarray(s) / 0.1
        places = 0.1 * np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])
        return np.array([pin.utils.rotate("z", turn) for turn in angle]), places

    time = np.linspace(0.0, 2.0, 41)
    zero = np.zeros((41, 1))
    motion = Trajectory(("share",), time, time[:, None] / 2.0, zero + 0.5, zero)

    def poses(arm, q):
        R, p = at(q[:, 0] * length)
        return R, 1.0002 * p

    circle = SimpleNamespace(at=at, length=length, corners=())
    segment = SimpleNamespace(arm="left", start=0.0, end=2.0)
    schedule, model = SimpleNamespace(trajectory=motion), SimpleNamespace(poses=poses)
    found = along_path(schedule, model, segment, circle)
    assert found.length == pytest.approx(found.time / 2.0 * length, abs=1e-9)
    assert found.distance == pytest.approx(np.full(len(found.time), 2e-5), abs=1e-9)
    assert found.angle == pytest.approx(np.zeros(len(found.time)), abs=1e-12)
