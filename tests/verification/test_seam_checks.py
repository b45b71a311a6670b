"""Seam checks on planned seams, and on what became of them by tampering with the motion, its list or the task."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
from scipy.special import erf

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinds.seam.checks import (
    CRITERIA,
    MeasuredSeam,
    _part_errors,
    _rotation_errors,
    _speed_deviation,
    check_seams,
    seam_touches,
)
from dualarm_cli.model.cell import Tool
from dualarm_cli.model.motion.joint_motion import JointMotion
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.process_work import Hold, SeamTool
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.model.shape import Shape
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.verification import verify
from dualarm_cli.verification.measuring.line_spans import line_spans
from dualarm_cli.verification.measuring.tool_model import ToolModel

SDA10F = """\
dualarm: cell/1
robot: sda10f
tools:
  left:  {tcp: {xyz: [0, 0, 100 mm]}}
  right: {tcp: {xyz: [0, 0, 200 mm]}}
"""
LINE = """\
dualarm: tasks/1
cell: cell.yaml
start: free
tasks:
  - id: seam
    coordinate:
      master: left
      slave: right
      curve: {kind: line, start: [-30 mm, 0, 0], end: [30 mm, 0, 0]}
      part: {xyz: [0, 0, 200 mm]}
      tool: {standoff: 2 mm}
      hold: still
      downhand: 20 deg
      speed: 100 mm/s
"""
PAIR = """\
dualarm: cell/1
robot:
  left:  {robot: iiwa14, base: {xyz: [-0.55, 0, 0]}}
  right: {robot: iiwa14, base: {xyz: [0.55, 0, 0], rpy: [0, 0, 180 deg]}}
tools:
  left:  {tcp: {xyz: [0, 0, 150 mm]}}
  right: {tcp: {xyz: [0, 0, 150 mm]}}
"""
ARC = """\
dualarm: tasks/1
cell: cell.yaml
start: free
tasks:
  - id: seam
    coordinate:
      master: left
      slave: right
      curve: {kind: arc, radius: 30 mm, begin: 0, finish: 120 deg}
      part: {xyz: [10 mm, 0, 150 mm], rpy: [0, 20 deg, 0]}
      tool: {work_angle: 10 deg, free: spin, tilt: 5 deg}
      speed: 100 mm/s
"""
LENGTH = 0.06


def planned(folder, cell, tasks):
    """Job and schedule of a seam and nothing else: the whole motion is the seam."""
    (folder / "dualarm.toml").write_text("")
    (folder / "cell.yaml").write_text(cell)
    (folder / "tasks.yaml").write_text(tasks)
    job = load_job(folder / "tasks.yaml")
    return SimpleNamespace(job=job, schedule=plan_without_bound(job, PlanSettings(effort="quick")))


@pytest.fixture(scope="module")
def line(tmp_path_factory):
    """A line on a part that an SDA10F holds still, its torch's spin fixed."""
    return planned(tmp_path_factory.mktemp("line"), SDA10F, LINE)


@pytest.fixture(scope="module")
def arc(tmp_path_factory):
    """An arc on a part between two iiwas, spin free and 5 degrees of tilt; the part may move."""
    return planned(tmp_path_factory.mktemp("arc"), PAIR, ARC)


ENTRY = (
    LINE.replace("start: free", "start: home")
    + """\
      entry: {approach: 20 mm, dwell: 0.3 s}
      exit: {dwell: 0.3 s, retract: 20 mm}
"""
)


@pytest.fixture(scope="module")
def entry(tmp_path_factory):
    """The line with its tool coming, standing and leaving, from home."""
    return planned(tmp_path_factory.mktemp("entry"), SDA10F, ENTRY)


def moved_in(schedule, job, kind, action, by):
    """The schedule with the master's fourth joint aside by up to an angle within one of the slave's segments."""
    [segment] = [
        s
        for s in schedule.segments
        if (s.arm, s.kind, s.action) == (job.tasks[0].seam.slave, kind, action)
    ]
    time = np.unique([*schedule.trajectory.time, *np.linspace(segment.start, segment.end, 101)])
    q, v, a = schedule.trajectory.at(time)
    x = np.clip((time - segment.start) / (segment.end - segment.start), 0.0, 1.0)
    column = schedule.trajectory.joints.index("left_e")
    q[:, column] += by * 16.0 * (x * (1.0 - x)) ** 2
    motion = Trajectory(schedule.trajectory.joints, time, q, v, a)
    return dataclasses.replace(schedule, motion=JointMotion.of(motion))


def with_work(job, **changes):
    """The job with another seam."""
    work = dataclasses.replace(job.tasks[0].seam, **changes)
    return dataclasses.replace(
        job, tasks=tuple(dataclasses.replace(task, seam=work) for task in job.tasks)
    )


def with_tool(job, **changes):
    """The job with the tool standing otherwise."""
    return with_work(job, tool=dataclasses.replace(job.tasks[0].seam.tool, **changes))


def seams(schedule, job):
    """The seam checks by name."""
    model = ToolModel(schedule)
    lines = line_spans(schedule, job, model)
    return {check.name: check for check in check_seams(schedule, job, model, lines)}


def failed(schedule, job):
    """Names of those that failed."""
    return {name for name, check in seams(schedule, job).items() if check.verdict == "failed"}


def retimed(schedule, old, duration):
    """The schedule whose joints are at every new instant where they were at `old(t)`, by knots 1 ms apart.

    Args:
        schedule: of one seam.
        old: returns old instants, their first and their second derivatives.
        duration: new.
    """
    time = np.linspace(0.0, duration, round(duration / 1e-3) + 1)
    tau, rate, second = old(time)
    q, v, a = schedule.trajectory.at(np.clip(tau, 0.0, schedule.trajectory.time[-1]))
    rate, second = rate[:, None], second[:, None]
    motion = Trajectory(schedule.trajectory.joints, time, q, v * rate, a * rate**2 + v * second)
    return dataclasses.replace(
        schedule,
        motion=JointMotion.of(motion),
        segments=tuple(dataclasses.replace(s, end=duration) for s in schedule.segments),
        events=tuple(
            dataclasses.replace(e, time=duration) if e.action == "seam_end" else e
            for e in schedule.events
        ),
        stages=tuple(
            dataclasses.replace(s, end=duration if s.end > 0.0 else 0.0) for s in schedule.stages
        ),
    )


def dented(middle, width, depth):
    """Old instants that lag by up to a depth around a middle, as a smooth bump, caught up again."""

    def old(t):
        x = (t - middle) / width
        inside = np.abs(x) < 1.0
        x = np.where(inside, x, 0.0)
        bump = np.where(inside, (1 - x**2) ** 4, 0.0)
        first = np.where(inside, -8 * x * (1 - x**2) ** 3, 0.0)
        second = np.where(inside, -8 * (1 - x**2) ** 3 + 48 * x**2 * (1 - x**2) ** 2, 0.0)
        return t - depth * bump, 1.0 - depth * first / width, -depth * second / width**2

    return old


def poses(job, q):
    """Part and tool in the world by pinocchio at configurations (k, n), from URDF, base, flanges and the file."""
    robot, work = job.cell.robot, job.tasks[0].seam
    model = pin.buildModelFromXML(robot.urdf)
    data = model.createData()
    order = [robot.joints.index(name) for name in model.names[1:]]
    found = []
    for row in q:
        pin.framesForwardKinematics(model, data, row[order])
        flange = {
            arm.name: job.cell.base * data.oMf[model.getFrameId(arm.flange)] for arm in robot.arms
        }
        tool = flange[work.slave] * job.cell.tools[work.slave].tcp
        found.append((flange[work.master] * work.part, tool))
    return found


@pytest.mark.parametrize("which", ["line", "arc"])
def test_what_is_planned_passes(which, request):
    """All that there is to check of it, and the rest of the verifier, clearance included."""
    one = request.getfixturevalue(which)
    checks = seams(one.schedule, one.job)
    assert tuple(checks) == tuple(CRITERIA)
    still = {"seam_part", "seam_downhand"} if which == "arc" else set()
    assert {name for name, c in checks.items() if c.verdict == "not checked"} == still
    assert failed(one.schedule, one.job) == set()
    assert verify(one.schedule, one.job, clearance=True).passed


@pytest.mark.parametrize("which", ["line", "arc"])
def test_distances_and_angles_are_those_by_pinocchio(which, request):
    """Against a task that has the part 3 mm aside and turned: not small, and computed by hand from two poses."""
    one = request.getfixturevalue(which)
    aside = pin.SE3(pin.exp3(np.array([0.02, -0.01, 0.0])), np.array([0.0, 0.003, 0.001]))
    job = with_work(one.job, part=one.job.tasks[0].seam.part * aside)
    work = job.tasks[0].seam
    segment = next(s for s in one.schedule.segments if s.kind == "seam")
    found = MeasuredSeam(one.schedule, job, ToolModel(one.schedule), work).during(segment)
    some = np.linspace(0, len(found.time) - 1, 9).astype(int)[1:-1]
    for k, (part, tool) in zip(
        some, poses(job, one.schedule.trajectory.at(found.time[some])[0]), strict=True
    ):
        seen = part.actInv(tool)
        tip = seen.act(np.array([0.0, 0.0, work.tool.standoff]))
        if which == "line":
            place = np.array([np.clip(tip[0], -0.03, 0.03), 0.0, 0.0])
            x, z = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
        else:
            angle = np.clip(np.arctan2(tip[1], tip[0]), 0.0, np.radians(120.0))
            place = 0.03 * np.array([np.cos(angle), np.sin(angle), 0.0])
            x, z = np.array([-np.sin(angle), np.cos(angle), 0.0]), np.array([0.0, 0.0, 1.0])
        assert found.distance[k] == pytest.approx(np.linalg.norm(tip - place), abs=1e-9)
        # The tool points against z, turned by the work angle about x.
        down = pin.exp3(work.tool.work_angle * x) @ -z
        lean = np.arccos(np.clip(seen.rotation[:, 2] @ down, -1.0, 1.0))
        if which == "line":
            # A small turn: lean and spin are its parts across and along the axis.
            should = np.column_stack([x, np.cross(down, x), down])
            turn = pin.log3(should.T @ seen.rotation)
            assert found.angle[k] == pytest.approx(max(lean, abs(turn[2])), abs=2e-4)
            assert np.hypot(turn[0], turn[1]) == pytest.approx(lean, rel=1e-3)
        else:
            assert found.angle[k] == pytest.approx(max(lean - work.tool.tilt, 0.0), abs=1e-9)
        np.testing.assert_allclose(found.R_part[k], part.rotation, atol=1e-12)
        np.testing.assert_allclose(found.p_part[k], part.translation, atol=1e-12)


@pytest.mark.parametrize("off", [[0, 2e-6, 0], [0, 0, -2e-6]])
def test_two_micrometres_beside_the_seam_fail_the_distance(line, off):
    """One is allowed, planned is 0.4 at most; half a micrometre passes."""
    aside = pin.SE3(np.eye(3), np.array(off, dtype=float))
    part = line.job.tasks[0].seam.part
    job = with_work(line.job, part=part * aside)
    assert failed(line.schedule, job) == {"seam_distance"}
    assert seams(line.schedule, job)["seam_distance"].measured == pytest.approx(2e-6, abs=4.1e-7)
    aside = pin.SE3(np.eye(3), 0.25 * np.array(off, dtype=float))
    assert failed(line.schedule, with_work(line.job, part=part * aside)) == set()


def test_a_standoff_off_by_two_micrometres_fails_the_distance(line):
    """The tool is nearer to the part than the task says."""
    assert failed(line.schedule, with_tool(line.job, standoff=0.002 + 2e-6)) == {"seam_distance"}


def to_be_off(schedule, asked, name, size, start):
    """The job by a fault of which a check measures a size: a fault and what is measured grow alike."""
    fault = start
    for _ in range(3):
        fault += size - seams(schedule, asked(fault))[name].measured
    job = asked(fault)
    assert seams(schedule, job)[name].measured == pytest.approx(size, rel=0.02)
    return job


@pytest.mark.parametrize(("share", "expected"), [(0.9, "passed"), (1.1, "failed")])
def test_tolerances_of_seams(line, share, expected):
    """Faults of 0.9 and 1.1 of a micrometre, a microradian, a thousandth of speed, time and acceleration."""
    schedule, work = line.schedule, line.job.tasks[0].seam

    def beside(off):
        aside = pin.SE3(np.eye(3), np.array([0.0, off, 0.0]))
        return with_work(line.job, part=work.part * aside)

    def leaning(angle):
        return with_tool(line.job, work_angle=work.tool.work_angle + angle)

    lean = work.downhand if work.downhand is not None else 0.1
    for name, asked, start in (
        ("seam_distance", beside, 5e-6),
        ("seam_angle", leaning, 1e-5),
        ("seam_downhand", lambda less: with_work(line.job, downhand=lean - less), lean),
    ):
        job = to_be_off(schedule, asked, name, share * 1e-6, start)
        assert seams(schedule, job)[name].verdict == expected, name
    slow = 0.5 * work.speed
    times = 1.0 + seams(schedule, with_work(line.job, speed=slow))["seam_speed"].measured
    [own] = [s for s in schedule.segments if (s.kind, s.arm) == ("seam", work.slave)]
    taken, late = own.end - own.start, own.start + share * 1e-9
    small = with_work(line.job, acceleration=0.1)
    most = 0.1 * (1.0 + seams(schedule, small)["seam_as_asked"].measured)
    off = 1.0 + share * 1e-3
    for name, changes in (
        ("seam_speed", {"speed": slow * times / off}),
        ("seam_as_asked", {"speed": None, "duration": taken / off, "slower": False}),
        ("seam_as_asked", {"acceleration": most / off}),
        ("seam_as_asked", {"not_before": late}),
    ):
        assert seams(schedule, with_work(line.job, **changes))[name].verdict == expected, changes


@pytest.mark.parametrize("angle", ["work_angle", "travel_angle"])
def test_a_lean_of_ten_microradians_fails_the_angle(line, angle):
    """Ten where one is allowed, forwards or sideways."""
    job = with_tool(line.job, **{angle: 1e-5})
    assert failed(line.schedule, job) == {"seam_angle"}
    assert seams(line.schedule, job)["seam_angle"].measured == pytest.approx(1e-5, rel=0.5)
    # Within the tilt that a task leaves it is no matter.
    assert failed(line.schedule, with_tool(job, tilt=1e-4)) == set()


def test_spin_fails_where_it_is_fixed_and_not_where_it_is_free(line, bumped):
    """The last joint turns about the tool's axis: 20 microradians."""
    middle = len(line.schedule.trajectory.time) // 2
    schedule = bumped(line.schedule, middle, {"right_t": 2e-5})
    assert failed(schedule, line.job) == {"seam_angle"}
    assert seams(schedule, line.job)["seam_angle"].measured == pytest.approx(2e-5, abs=1e-6)
    assert failed(schedule, with_tool(line.job, free_spin=True)) == set()


def test_a_tilt_beyond_what_is_left_fails_the_angle(arc):
    """A task that leaves 10 microradians less than the planned tool's largest lean."""
    work = arc.job.tasks[0].seam
    leans = []
    time = np.linspace(0.0, arc.schedule.duration, 2001)
    for part, tool in poses(arc.job, arc.schedule.trajectory.at(time)[0]):
        seen = part.actInv(tool)
        angle = np.arctan2(seen.translation[1], seen.translation[0])
        x = np.array([-np.sin(angle), np.cos(angle), 0.0])
        down = pin.exp3(work.tool.work_angle * x) @ np.array([0.0, 0.0, -1.0])
        cross = np.linalg.norm(np.cross(seen.rotation[:, 2], down))
        leans.append(np.arctan2(cross, seen.rotation[:, 2] @ down))
    most = max(leans)
    assert most <= work.tool.tilt
    assert failed(arc.schedule, with_tool(arc.job, tilt=most - 1e-5)) == {"seam_angle"}
    assert failed(arc.schedule, with_tool(arc.job, tilt=most + 1e-8)) == set()


def test_a_joint_off_by_ten_microradians_fails_the_distance(line, bumped):
    """The elbow of the slave, half a metre from the tool, or of the master."""
    middle = len(line.schedule.trajectory.time) // 2
    for joint in ("right_e", "left_u"):
        found = failed(bumped(line.schedule, middle, {joint: 5e-5}), line.job)
        assert "seam_distance" in found


def test_a_platform_that_turns_moves_the_part_alone(line, bumped):
    """Chain and speed do not mind, but the part has to stand: 0.1 mrad half a metre from the axis."""
    middle = len(line.schedule.trajectory.time) // 2
    schedule = bumped(line.schedule, middle, {"torso_b1": 1e-4})
    assert failed(schedule, line.job) == {"seam_part"}
    # With the part free to move there is nothing to it.
    free = with_work(line.job, hold=Hold())
    assert failed(schedule, free) == set()
    assert seams(schedule, free)["seam_part"].verdict == "not checked"


def test_a_part_beside_its_given_pose_is_found(line):
    """The pose where it stands, and that pose 2 um and 2 microradians aside."""
    [(part, _)] = poses(line.job, line.schedule.trajectory.position[:1])
    assert failed(line.schedule, with_work(line.job, hold=Hold(pose=part))) == set()
    moved = pin.SE3(part.rotation, part.translation + np.array([0.0, 2e-6, 0.0]))
    turned = pin.SE3(part.rotation @ pin.exp3(np.array([0.0, 2e-6, 0.0])), part.translation)
    for pose in (moved, turned):
        job = with_work(line.job, hold=Hold(pose=pose))
        assert failed(line.schedule, job) == {"seam_part"}
        assert seams(line.schedule, job)["seam_part"].measured == pytest.approx(2e-6, rel=0.01)


def test_half_a_percent_too_fast_fails_the_speed_alone(line):
    """A thousandth is allowed."""
    T = line.schedule.duration
    fast = retimed(line.schedule, lambda t: (1.005 * t, np.full_like(t, 1.005), 0 * t), T / 1.005)
    assert failed(fast, line.job) == {"seam_speed"}
    assert seams(fast, line.job)["seam_speed"].measured == pytest.approx(5e-3, abs=5e-4)


def test_half_a_percent_too_slow_fails_where_slower_is_forbidden(line):
    """And passes where it is allowed."""
    T = line.schedule.duration
    slow = retimed(line.schedule, lambda t: (0.995 * t, np.full_like(t, 0.995), 0 * t), T / 0.995)
    assert failed(slow, line.job) == {"seam_as_asked"}
    assert failed(slow, with_work(line.job, slower=True)) == set()


def test_a_dip_of_the_speed_in_the_middle_fails_the_steadiness(line):
    """Behind by 2 ms for a while: slower than asked by a slope, then faster by it, which is the top."""
    T = line.schedule.duration
    schedule = retimed(line.schedule, dented(T / 2, 0.1, 2e-3), T)
    checks = seams(schedule, line.job)
    # The bump's steepest slope: 8 x (1 - x²)³ at x = 1/sqrt(7).
    slope = 8 / np.sqrt(7) * (6 / 7) ** 3 * 2e-3 / 0.1
    found = failed(schedule, line.job)
    assert found == {"seam_steady", "seam_speed"}
    assert checks["seam_speed"].measured == pytest.approx(slope, rel=0.1)
    assert checks["seam_steady"].measured == pytest.approx(slope / (1 + slope), rel=0.1)


def test_going_back_for_a_moment_fails_the_progress(line):
    """The tool goes back by some millimetres in the middle and forth again."""
    T = line.schedule.duration
    old = dented(T / 2, 0.15, 0.12)
    schedule = retimed(line.schedule, old, T)
    assert "seam_progress" in failed(schedule, line.job)
    assert "seam_distance" not in failed(schedule, line.job)
    tau = old(np.linspace(0.0, T, 20_001))[0]
    back = 0.1 * (np.maximum.accumulate(tau) - tau).max()
    assert back > 1e-4
    assert seams(schedule, line.job)["seam_progress"].measured == pytest.approx(back, rel=0.02)


@pytest.mark.parametrize("lean", [0.0, 1e-9, 1e-4, 0.05, 0.6])
def test_spin_is_what_is_left_once_a_lean_is_taken_back(lean):
    """Tools spun about their axis, then leant by the shortest turn, about 40 axes: by pinocchio's exponentials."""
    rng = np.random.default_rng(1)
    heading, spin = rng.uniform(-np.pi, np.pi, 40), rng.uniform(-1.0, 1.0, 40)
    about = np.column_stack([np.cos(heading), np.sin(heading), np.zeros(40)])
    E = np.array(
        [
            pin.exp3(lean * axis) @ pin.exp3(np.array([0.0, 0.0, turn]))
            for axis, turn in zip(about, spin, strict=True)
        ]
    )
    leans = np.full(40, lean)

    def work(**tool):
        return SimpleNamespace(tool=SeamTool(**tool))

    away = _rotation_errors(E, leans, work(tilt=0.02))
    assert away == pytest.approx(np.maximum(max(lean - 0.02, 0.0), np.abs(spin)), abs=1e-7)
    free = _rotation_errors(E, leans, work(tilt=0.02, free_spin=True))
    assert free == pytest.approx(np.full(40, max(lean - 0.02, 0.0)), abs=1e-12)


def test_a_seam_from_its_end_fails_the_progress(line):
    """Backwards all the way: the tool stands as it should, on a line that is there in both directions."""
    T = line.schedule.duration
    back = retimed(line.schedule, lambda t: (T - t, np.full_like(t, -1.0), 0 * t), T)
    assert "seam_progress" in failed(back, line.job)
    assert seams(back, line.job)["seam_progress"].measured == pytest.approx(LENGTH, rel=1e-3)


def test_a_seam_left_off_early_fails_the_progress(line):
    """The last 10 ms are missing: 50 um or so of a ramp, judged by where the tool is."""
    T = line.schedule.duration
    short = retimed(line.schedule, lambda t: (t, np.ones_like(t), 0 * t), T - 0.1)
    [(part, tool)] = poses(line.job, short.trajectory.position[-1:])
    missing = 0.03 - part.actInv(tool).translation[0]
    assert missing > 1e-4
    assert failed(short, line.job) == {"seam_progress"}
    assert seams(short, line.job)["seam_progress"].measured == pytest.approx(missing, rel=1e-3)


def test_segments_that_are_missing_doubled_or_not_together_are_found(line):
    """The slave's or the master's; none of it can be judged, which is no pass."""
    [left, right] = line.schedule.segments
    assert {left.kind, right.kind} == {"seam"}
    later = dataclasses.replace(left, start=left.start + 1e-3)
    other = dataclasses.replace(left, kind="wait")
    for segments in (
        (left,),
        (right,),
        (left, right, right),
        (left, left, right),
        (later, right),
        (other, right),
    ):
        schedule = dataclasses.replace(line.schedule, segments=segments)
        assert failed(schedule, line.job) == {"seam_progress"}
        assert not verify(schedule, line.job).passed


def test_a_seam_before_its_time_is_found(line):
    """It begins at once; half a second later is asked for."""
    assert failed(line.schedule, with_work(line.job, not_before=0.5)) == {"seam_as_asked"}


def test_a_duration_is_to_be_met(line):
    """To a thousandth; a seam that may be slower has no such check."""
    T = line.schedule.duration
    for factor, expected in ((1.0, set()), (1.002, {"seam_as_asked"}), (0.998, {"seam_as_asked"})):
        job = with_work(line.job, speed=None, duration=factor * T)
        assert failed(line.schedule, job) == expected
        assert failed(line.schedule, dataclasses.replace(job, speed=0.5)) == {"seam_as_asked"}
    slower = with_work(line.job, speed=None, duration=0.5 * T, slower=True)
    assert failed(line.schedule, slower) == set()


def test_an_acceleration_along_the_seam_is_kept(line):
    """The planned one by second differences of where pinocchio has the tool on the line."""
    time = np.linspace(0.0, line.schedule.duration, 4001)
    q = line.schedule.trajectory.at(time)[0]
    along = np.array([part.actInv(tool).translation[0] for part, tool in poses(line.job, q)])
    most = np.abs(np.diff(along, 2)).max() / (time[1] - time[0]) ** 2
    gentle = with_work(line.job, acceleration=0.97 * most)
    assert failed(line.schedule, gentle) == {"seam_as_asked"}
    assert failed(line.schedule, with_work(line.job, acceleration=1.02 * most)) == set()


def test_a_surface_that_leans_too_far_is_found(line):
    """The planned lean of z from upwards by pinocchio; a task that leaves 10 microradians less."""
    [(part, _)] = poses(line.job, line.schedule.trajectory.position[:1])
    up = part.rotation[:, 2]
    lean = np.arctan2(np.hypot(up[0], up[1]), up[2])
    assert lean <= np.radians(20.0)
    job = with_work(line.job, downhand=lean - 1e-5)
    assert failed(line.schedule, job) == {"seam_downhand"}
    assert seams(line.schedule, job)["seam_downhand"].measured == pytest.approx(1e-5, rel=1e-2)
    assert failed(line.schedule, with_work(line.job, downhand=lean + 1e-6)) == set()


def test_half_the_job_s_speed_halves_what_is_allowed(line):
    """A job at 50 %: the schedule is twice as fast."""
    job = dataclasses.replace(line.job, speed=0.5)
    assert seams(line.schedule, job)["seam_speed"].measured == pytest.approx(1.0, abs=2e-3)


def test_a_tool_may_touch_its_part_but_not_reach_into_it(line):
    """A rod of 5 mm that ends at the tool centre point, 2 mm over a block; then the block is 3 mm higher."""
    rod = Shape("capsule", (0.005, 0.15), pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.12])))

    def verdict(height, touches):
        # The block's top is at the height over the flange; the seam at 200 mm.
        at = pin.SE3(np.eye(3), np.array([0.0, 0.0, height - 0.01]))
        block = Shape("box", (0.1, 0.04, 0.02), at)
        tools = line.job.cell.tools
        cell = dataclasses.replace(
            line.job.cell,
            tools={
                "left": Tool(tools["left"].tcp, shapes=(block,)),
                "right": Tool(tools["right"].tcp, shapes=(rod,)),
            },
            clearance=0.005,
        )
        job = with_work(dataclasses.replace(line.job, cell=cell), touches=touches)
        checks = verify(line.schedule, job, clearance=True).checks
        return next(c for c in checks if c.name == "collisions")

    assert verdict(0.200, ("left_tool",)).verdict == "passed"
    assert verdict(0.200, ()).verdict == "failed"
    found = verdict(0.203, ("left_tool",))
    assert found.verdict == "failed"
    assert "left_tool" in found.detail and "right_tool" in found.detail


def test_without_seams_or_tasks_nothing_is_checked(clean, line):
    """Checks that say why."""
    for schedule, job, why in (
        (clean.schedule, clean.job, "the job has no seams"),
        (line.schedule, None, "no task file was given (--tasks)"),
    ):
        checks = check_seams(schedule, job, ToolModel(schedule), ())
        assert [check.name for check in checks] == list(CRITERIA)
        assert {(check.verdict, check.detail) for check in checks} == {("not checked", why)}


def test_a_seam_with_entry_and_exit_passes(entry):
    """Untouched."""
    assert failed(entry.schedule, entry.job) == set()
    assert verify(entry.schedule, entry.job).passed


@pytest.mark.parametrize(
    ("kind", "action"),
    [
        ("dwell", "seam_start"),
        ("dwell", "seam_end"),
        ("approach", "seam_start"),
        ("retract", "seam_end"),
    ],
)
def test_a_part_that_moves_while_the_tool_comes_stands_or_leaves_is_found(entry, kind, action):
    """By a hundredth of a radian and back: millimetres at the part; in dwells the tool is off the seam as well."""
    schedule = moved_in(entry.schedule, entry.job, kind, action, 0.01)
    expected = {"seam_part", "seam_distance"} if kind == "dwell" else {"seam_part"}
    assert failed(schedule, entry.job) == expected


@pytest.mark.parametrize("action", ["seam_start", "seam_end"])
def test_events_that_are_not_at_the_ends_of_the_seam_are_found(entry, action):
    """Moved by a millisecond, and left out."""
    events = entry.schedule.events
    later = tuple(
        dataclasses.replace(e, time=e.time + 1e-3) if e.action == action else e for e in events
    )
    fewer = tuple(e for e in events if e.action != action)
    for some in (later, fewer):
        schedule = dataclasses.replace(entry.schedule, events=some)
        assert failed(schedule, entry.job) == {"seam_progress"}


def test_a_dwell_of_no_length_elsewhere_is_found_and_hides_no_contact(entry):
    """Listed at the plan's start it must not make the time in which tool and part may touch any longer."""
    segments = entry.schedule.segments
    [dwell] = [s for s in segments if (s.kind, s.action) == ("dwell", "seam_start")]
    early = dataclasses.replace(dwell, start=0.0, end=0.0, dwell=None)
    schedule = dataclasses.replace(entry.schedule, segments=(early, *segments))
    assert failed(schedule, entry.job) == {"seam_progress"}
    for some in (schedule, entry.schedule):
        [touch] = seam_touches(entry.job, line_spans(some, entry.job, ToolModel(some)))
        assert touch.bodies == {("", "left_tool"), ("", "right_tool")}
        assert touch.start == min(s.start for s in segments if s.kind == "approach")
        assert touch.end == max(s.end for s in segments if s.kind == "retract")


def test_a_seam_that_creeps_to_its_speed_is_found(line):
    """A bell of ten times its time, to its speed for an instant: ramps may take 1.2 s each."""
    T = line.schedule.duration

    def bell(t):
        x = t / (10.0 * T)
        way = x - np.sin(2.0 * np.pi * x) / (2.0 * np.pi)
        return (
            T * way,
            0.1 * (1.0 - np.cos(2.0 * np.pi * x)),
            0.02 * np.pi / T * np.sin(2.0 * np.pi * x),
        )

    slow = retimed(line.schedule, bell, 10.0 * T)
    assert "seam_as_asked" in failed(slow, line.job)


def test_a_seam_that_is_at_its_speed_for_an_instant_only_is_found(line):
    """A clock that runs as it should in the middle and all but stands before and after: eleven times as long."""
    T = line.schedule.duration
    D = T / (0.05 * np.sqrt(np.pi))

    def bell(t):
        x = (t / D - 0.5) / 0.05
        return T * 0.5 * (1.0 + erf(x)), np.exp(-(x**2)), -2.0 * x / (0.05 * D) * np.exp(-(x**2))

    check = seams(retimed(line.schedule, bell, D), line.job)["seam_as_asked"]
    assert check.verdict == "failed"
    work = line.job.tasks[0].seam
    longest = work.length / work.speed + 1.2
    assert check.measured == pytest.approx(D / longest - 1.0, rel=1e-6)


def test_a_part_is_off_by_its_place_or_by_its_turn():
    """Either alone, from a given pose and from where it stands at first: the larger of both counts."""
    turns = np.array([pin.utils.rotate("y", angle) for angle in (0.0, 0.0, 0.3)])
    places = np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0], [0.1, 0.0, 0.0]])
    found = SimpleNamespace(R_part=turns, p_part=places, length=np.zeros(3))
    for hold in (Hold(pose=pin.SE3.Identity()), Hold(still=True)):
        work = SimpleNamespace(hold=hold, length=1.0)
        assert _part_errors(found, work) == pytest.approx([0.0, 0.2, 0.3], abs=1e-12)


def test_the_way_to_a_seam_takes_the_time_that_is_asked_for(entry):
    """From where the slave leaves to where the seam begins; at half speed twice as long."""
    own = [s for s in entry.schedule.segments if s.arm == entry.job.tasks[0].seam.slave]
    [begin] = [s.start for s in own if s.kind == "seam"]
    way = begin - min(s.start for s in own)
    for asked, found in (
        (way, set()),
        (1.1 * way, {"seam_as_asked"}),
        (0.9 * way, {"seam_as_asked"}),
    ):
        assert failed(entry.schedule, with_work(entry.job, entry_duration=asked)) == found
    # A seam that may not begin before is waited for.
    late = with_work(entry.job, entry_duration=0.9 * way, not_before=begin)
    assert failed(entry.schedule, late) == set()


@pytest.fixture(scope="module")
def second(tmp_path_factory):
    """A line with entry and exit, and 3 s later the same line again."""
    [head, task] = ENTRY.split("tasks:\n")
    again = task.replace("id: seam", "id: again").replace(
        "0.3 s}\n      exit", "0.3 s, duration: 3 s}\n      exit"
    )
    return planned(tmp_path_factory.mktemp("second"), SDA10F, f"{head}tasks:\n{task}{again}")


def test_the_way_to_a_second_seam_begins_where_the_first_one_is_over(second):
    """It is planned in 3 s; of tasks that ask for more or less every one fails."""
    for asked, verdict in ((3.0, "passed"), (3.01, "failed"), (2.99, "failed")):
        tasks = tuple(
            dataclasses.replace(task, seam=dataclasses.replace(task.seam, entry_duration=asked))
            if task.id == "again"
            else task
            for task in second.job.tasks
        )
        job = dataclasses.replace(second.job, tasks=tasks)
        assert seams(second.schedule, job)["seam_as_asked"].verdict == verdict


@pytest.mark.parametrize("of", ["", "other"])
def test_what_the_way_to_a_seam_is_called_does_not_change_how_long_it_takes(entry, of):
    """The first half of the transfer under another task's name: a task that gives half the time to the rest fails."""
    slave = entry.job.tasks[0].seam.slave
    [begin] = [s.start for s in entry.schedule.segments if (s.arm, s.kind) == (slave, "seam")]
    segments = []
    for s in entry.schedule.segments:
        if (s.arm, s.kind) == (slave, "transfer"):
            middle = (s.start + s.end) / 2.0
            segments += [dataclasses.replace(s, end=middle, task=of)]
            s = dataclasses.replace(s, start=middle)
        segments.append(s)
    renamed = dataclasses.replace(entry.schedule, segments=tuple(segments))
    short = with_work(entry.job, entry_duration=begin - middle)
    assert failed(renamed, short) == {"seam_as_asked"}
    assert failed(renamed, with_work(entry.job, entry_duration=begin)) == set()


def test_a_part_that_stands_in_the_world_is_where_the_arm_that_stands_holds_it(line):
    """The same tool, places and angles whether an arm holds the part still or nothing does."""
    [segment] = [s for s in line.schedule.segments if (s.kind, s.arm) == ("seam", "right")]
    model, work = ToolModel(line.schedule), line.job.tasks[0].seam
    held = MeasuredSeam(line.schedule, line.job, model, work).during(segment)
    part = pin.SE3(held.R_part[0], held.p_part[0])
    alone = dataclasses.replace(work, master=None, part=part)
    stands = MeasuredSeam(line.schedule, line.job, model, alone).during(segment)
    np.testing.assert_allclose(stands.length, held.length, atol=1e-8)
    np.testing.assert_allclose(stands.distance, held.distance, atol=1e-8)
    np.testing.assert_allclose(stands.angle, held.angle, atol=1e-7)
    np.testing.assert_allclose(stands.p_part, held.p_part, atol=1e-8)


def test_a_profile_rises_stays_and_falls():
    """Random speeds: what each lacks to the greatest before the plateau, to the top on it, to the greatest after it."""
    for seed in range(200):
        random = np.random.default_rng(seed)
        ramp = np.linspace(0.0, 0.9, 8)
        speed = np.concatenate([ramp, np.ones(6), ramp[::-1]])
        speed -= 0.3 * random.random(len(speed)) * (random.random(len(speed)) < 0.2)
        top = speed.max()
        steady = [k for k, v in enumerate(speed) if v >= 0.999 * top]
        lacks = [
            max(speed[: k + 1]) - v
            if k < steady[0]
            else max(speed[k:]) - v
            if k > steady[-1]
            else top - v
            for k, v in enumerate(speed)
        ]
        dip, where = _speed_deviation(speed)
        assert dip == pytest.approx(max(lacks) / top)
        assert lacks[where] == max(lacks)
    assert _speed_deviation(np.zeros(5))[0] == np.inf


def test_half_the_job_s_speed_quarters_the_acceleration_that_is_allowed(line):
    """Accelerations are scaled by the square: what was 1 + m times as much as is asked is 4 (1 + m) times as much."""
    job = with_work(line.job, acceleration=0.05)
    times = 1.0 + seams(line.schedule, job)["seam_as_asked"].measured
    slow = seams(line.schedule, dataclasses.replace(job, speed=0.5))["seam_as_asked"]
    assert times > 1.0
    assert 1.0 + slow.measured == pytest.approx(4.0 * times)
