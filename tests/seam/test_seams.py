"""Coordinate tasks from file to verified schedule: how parts are held, speeds, caps, ends, robots, mixed jobs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.bound.job_bound import job_bound
from dualarm_cli.errors import InfeasibleError, InputError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinds.planning import kind_of
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.report.sensitivity import sensitivity
from dualarm_cli.verification import verify

SDA10F = """\
robot: sda10f
tools:
  left:  {tcp: {xyz: [0, 0, 100 mm]}}
  right: {tcp: {xyz: [0, 0, 200 mm]}, shapes: [{capsule: {radius: 20 mm, length: 120 mm}, xyz: [0, 0, 80 mm]}]}
clearance: 5 mm
"""
PAIR = """\
robot:
  left:  {robot: iiwa14, base: {xyz: [-0.55, 0, 0]}}
  right: {robot: iiwa14, base: {xyz: [0.55, 0, 0], rpy: [0, 0, 180 deg]}}
tools: {left: {tcp: {xyz: [0, 0, 150 mm]}}, right: {tcp: {xyz: [0, 0, 150 mm]}}}
"""
QIN = """\
robot:
  left:  {robot: qin_150}
  right: {robot: qin_150, base: {xyz: [-2.8, 0, 0]}}
tools: {left: {tcp: {xyz: [0, 0, 200 mm]}}, right: {tcp: {xyz: [0, 0, 347 mm]}}}
"""
SMALL = (
    "robot: %s\ntools: {left: {tcp: {xyz: [0, 0, 80 mm]}}, right: {tcp: {xyz: [0, 0, 80 mm]}}}\n"
)
ALONE = "robot: iiwa14\ntools: {left: {tcp: {xyz: [0, 0, 100 mm]}}}\n"
LINE = "{kind: line, start: [-30 mm, 0, 0], end: [30 mm, 0, 0]}"
ARC = "{kind: arc, radius: 30 mm, begin: 0, finish: 180 deg}"
LENGTH = 0.06
TURNS, KEEPS = "", ", tool: keeps"
CAPPED = "start: free\nlimits: {tool_speed: 60 mm/s}\n"
PICK = """\
  - id: %s
    arm: left
    pick: {xyz: [0.5, 0.3, 0.9], rpy: [180 deg, 0, 0]}
    place: {xyz: [0.45, 0.4, 0.9], rpy: [180 deg, 0, 0]}
    approach: 40 mm
    dwell: 0.1 s
"""


def seam(
    *more: str,
    curve: str = LINE,
    master: str | None = "left",
    slave: str = "right",
    part: str = "{xyz: [0, 0, 200 mm]}",
    tool: str = "{standoff: 2 mm, free: spin}",
    name: str = "seam",
) -> str:
    """A coordinate task."""
    lines = [f"slave: {slave}", f"curve: {curve}", f"part: {part}", f"tool: {tool}", *more]
    lines = lines if master is None else [f"master: {master}", *lines]
    return f"  - id: {name}\n    coordinate:\n" + "".join(f"      {text}\n" for text in lines)


def job_of(folder: Path, cell: str, *tasks: str, head: str = "start: free\n") -> Job:
    """A job of some tasks in a cell."""
    (folder / "dualarm.toml").write_text("")
    (folder / "cell.yaml").write_text("dualarm: cell/1\n" + cell)
    text = f"dualarm: tasks/1\ncell: cell.yaml\n{head}tasks:\n" + "".join(tasks)
    (folder / "tasks.yaml").write_text(text)
    return load_job(folder / "tasks.yaml")


def planned(job: Job, **settings: str) -> Schedule:
    """A plan that the verifier passes, clearance included, and that is not below its bound."""
    schedule = plan_without_bound(job, replace(PlanSettings(effort="quick"), **settings))
    verdict = verify(schedule, job, clearance=True)
    assert verdict.passed, [check for check in verdict.checks if check.verdict == "failed"]
    return schedule


def spans(schedule: Schedule, kind: str = "seam", arm: str = "right") -> list[tuple[float, float]]:
    """When an arm does something of a kind."""
    return [(s.start, s.end) for s in schedule.segments if (s.kind, s.arm) == (kind, arm)]


def parts(job: Job, schedule: Schedule, time: np.ndarray) -> list[pin.SE3]:
    """Where the part on the left flange is, by pinocchio."""
    robot = job.cell.robot
    model = pin.buildModelFromXML(robot.urdf)
    data = model.createData()
    order = [robot.joints.index(name) for name in model.names[1:]]
    work = next(task.seam for task in job.tasks if task.seam is not None)
    found = []
    for q in schedule.trajectory.at(time)[0]:
        pin.framesForwardKinematics(model, data, q[order])
        flange = data.oMf[model.getFrameId(robot.arm("left").flange)]
        found.append(job.cell.base * flange * work.part)
    return found


def test_a_plan_may_begin_and_end_on_a_seam(tmp_path: Path) -> None:
    """start: free, no approach: two segments, the first stage without length, 60 mm at 100 mm/s and two ramps."""
    job = job_of(tmp_path, SDA10F, seam("speed: 100 mm/s", "hold: still"))
    schedule = planned(job)
    assert [(s.kind, s.start, s.end) for s in schedule.segments] == [
        ("seam", 0.0, schedule.duration)
    ] * 2
    assert 0.6 < schedule.duration < 1.0
    # One part of the ramps is covered at half the speed.
    assert job_bound(job, "quick").value == pytest.approx(0.6, rel=2e-5)
    assert schedule.stages[0].end == 0.0
    poses = parts(job, schedule, np.linspace(0.0, schedule.duration, 11))
    for pose in poses:
        np.testing.assert_allclose(pose.homogeneous, poses[0].homogeneous, atol=1e-9)


def test_a_part_stands_at_its_pose_or_follows_its_way(tmp_path: Path) -> None:
    """A pose; a turn of 20 degrees about its own centre; a circle on which it keeps its rotation; `duration` exact."""
    pose = "xyz: [0.5, 0.1, 1.0], rpy: [90 deg, 0, 0]"
    turn = "{turn: {about: [%s, 0.1, 1.0], axis: [0, 0, 1], angle: 20 deg%s}}"
    start = np.array([0.5, 0.1, 1.0])
    for text, centre, turned in (
        (f"{{{pose}}}", None, 0.0),
        (f"{{way: {{through: [{{{pose}}}, {turn % (0.5, TURNS)}]}}}}", start, 20.0),
        (
            f"{{way: {{through: [{{{pose}}}, {turn % (0.4, KEEPS)}]}}}}",
            np.array([0.4, 0.1, 1.0]),
            0.0,
        ),
    ):
        job = job_of(tmp_path, SDA10F, seam("duration: 2 s", f"hold: {text}"))
        schedule = planned(job)
        assert spans(schedule) == [(0.0, pytest.approx(2.0, rel=1e-9))]
        first, *_, last = parts(job, schedule, np.linspace(0.0, schedule.duration, 3))
        np.testing.assert_allclose(first.translation, start, atol=1e-6)
        R = pin.utils.rotate("z", np.radians(turned)) @ pin.utils.rotate("x", np.pi / 2)
        np.testing.assert_allclose(last.rotation, R, atol=1e-6)
        about = start if centre is None else centre
        angle = 0.0 if centre is None else np.radians(20.0)
        end = about + pin.utils.rotate("z", angle) @ (start - about)
        np.testing.assert_allclose(last.translation, end, atol=1e-6)


@pytest.mark.parametrize(
    ("tool", "told"),
    [
        ("{standoff: 2 mm, free: spin}", ["left", "right"]),
        ("{standoff: 2 mm, work_angle: 20 deg}", ["left", "right"]),
        ("{standoff: 2 mm, free: spin, tilt: 5 deg}", ["left"]),
    ],
)
def test_poses_of_the_bound_are_where_the_plan_has_the_tools_at_rest(
    tmp_path: Path, tool: str, told: list[str]
) -> None:
    """Before the approach to a seam on a part that turns, and after the retract; the slave's but for its spin."""
    pose = "xyz: [0.5, 0.1, 1.0], rpy: [90 deg, 0, 0]"
    turn = f"{{turn: {{about: [0.5, 0.1, 1.0], axis: [0, 0, 1], angle: 20 deg{TURNS}}}}}"
    more = (
        "speed: 50 mm/s",
        f"hold: {{way: {{through: [{{{pose}}}, {turn}]}}}}",
        "entry: {approach: 40 mm, dwell: 0.2 s}",
        "exit: {retract: 30 mm, dwell: 0.1 s}",
    )
    job = job_of(tmp_path, SDA10F, seam(*more, tool=tool), head="start: home\nreturn: true\n")
    schedule, model = planned(job), CellModel.from_cell(job.cell)
    [section] = job.sections()
    kind = kind_of(section)
    assert kind is not None
    instants = spans(schedule, "approach")[0][0], spans(schedule, "retract")[0][1]
    for time, poses in zip(instants, kind.ends(job, section), strict=True):
        position, velocity, *_ = schedule.trajectory.at(np.array([time]))
        np.testing.assert_allclose(velocity, 0.0, atol=1e-6)
        assert sorted(poses) == told
        for arm, target in poses.items():
            there = model.tool_pose(arm, position[0])
            off = target.pose.actInv(there)
            np.testing.assert_allclose(off.translation, 0.0, atol=1e-5)
            np.testing.assert_allclose(off.rotation[:, 2], [0.0, 0.0, 1.0], atol=1e-5)
            assert target.free_yaw == (arm == "right" and "spin" in tool)
            if not target.free_yaw:
                np.testing.assert_allclose(off.rotation, np.eye(3), atol=1e-5)
    # The seam and its dwells; both transfers take more.
    bound = job_bound(job, "quick").value
    assert LENGTH / 0.05 + 0.2 + 0.1 < bound <= schedule.duration
    # The file's time for the transfer, approach and dwell takes the place of what poses tell.
    timed = seam(*more, tool=tool).replace("dwell: 0.2 s", "dwell: 0.2 s, duration: 6 s")
    job = job_of(tmp_path, SDA10F, timed, head="start: home\n")
    assert job_bound(job, "quick").value == pytest.approx(6.0 + LENGTH / 0.05 + 0.1, rel=2e-5)


def test_a_part_without_a_pose_tells_none(tmp_path: Path) -> None:
    """The planner chooses where the part is: its seam may be right where the arms come from."""
    head = "start: home\nreturn: true\n"
    job = job_of(tmp_path, SDA10F, seam("speed: 100 mm/s", "hold: still"), head=head)
    assert job_bound(job, "quick").value == pytest.approx(0.6, rel=2e-5)


@pytest.mark.slow
def test_a_part_in_the_cell_is_worked_with_the_platform_still_or_turning(tmp_path: Path) -> None:
    """Asked for 2 m/s both are slower; with the platform still its joint does not move, turning helps."""
    cell = job_of(
        tmp_path,
        SDA10F,
        seam("speed: 2 m/s", "slower: allowed", master=None, part="{xyz: [0.5, -0.2, 0.9]}"),
    )
    still, moving = (planned(cell, seam_solver=name) for name in ("still", "moving"))
    column = still.trajectory.joints.index("torso_b1")
    assert np.ptp(still.trajectory.position[:, column]) < 1e-12
    assert moving.duration <= still.duration
    if moving.duration < still.duration:
        assert np.ptp(moving.trajectory.position[:, column]) > 0.0
    for schedule in (still, moving):
        assert any("because of limits, instead of 2000 mm/s" in note for note in schedule.notes)
        assert {s.kind for s in schedule.segments if s.arm == "left"} == {"wait"}


@pytest.mark.slow
def test_too_fast_is_refused_with_joint_kind_and_place(tmp_path: Path) -> None:
    """5 m/s on a line of 60 mm are over 400 m/s² at both ends: no joint can."""
    text = seam("speed: 5 m/s", "hold: still", "method: least_motion")
    with pytest.raises(InfeasibleError) as error:
        planned(job_of(tmp_path, SDA10F, text))
    message = str(error.value)
    for word in (
        "tasks.yaml:7:7",
        "task 'seam'",
        "too fast: 5000 mm/s",
        "of joint ",
        "mm along the seam",
        "say 'slower: allowed'",
    ):
        assert word in message, message
    assert any(kind in message for kind in ("velocity", "acceleration", "jerk"))


@pytest.mark.slow
def test_slower_where_allowed_and_asking_for_more_is_never_less(tmp_path: Path) -> None:
    """5 m/s and 0.15 m/s: the first is worked no slower than the second, though bodies are in each other's way."""
    fast, slow = (
        planned(
            job_of(
                tmp_path, SDA10F, seam(f"speed: {v}", "hold: still", "slower: allowed", curve=ARC)
            )
        )
        for v in ("5 m/s", "150 mm/s")
    )
    assert fast.duration <= slow.duration
    assert any("because of limits, instead of 5000 mm/s" in note for note in fast.notes)


def test_the_way_to_a_seam_takes_the_time_that_the_file_gives_it(tmp_path: Path) -> None:
    """Drawn out to 6 s with approach and dwell, 12 s at half speed; refused below the least; no limit changes it.

    A schedule in which it is as quick as can be fails the verifier for such a file.
    """
    more = ("speed: 100 mm/s", "posture: home")
    entry = "entry: {approach: 40 mm, dwell: 0.2 s%s}"
    head = "start: home\n"
    slow = job_of(tmp_path, SDA10F, seam(*more, entry % ", duration: 6 s"), head=head)
    schedule = planned(slow)
    assert spans(schedule)[0][0] == pytest.approx(6.0, abs=1e-9)
    # Approach and dwell are within the 6 s; 60 mm at 100 mm/s come after them.
    assert job_bound(slow, "quick").value == pytest.approx(6.6, rel=2e-5)
    kinds = [s.kind for s in schedule.segments if s.arm == "right"]
    assert kinds == ["transfer", "approach", "dwell", "seam"]
    assert schedule.stages[0].bottleneck == "duration"
    everything = [entry for entry in sensitivity(schedule) if entry.joint is None]
    [approach] = spans(schedule, "approach")
    assert everything
    # Of what comes before the seam only the approach changes, by no more than 1 / sqrt(0.9).
    for entry_ in everything:
        assert abs(entry_.lower - schedule.duration) < 0.06 * (approach[1] - approach[0]) + 1e-9
    half = job_of(
        tmp_path, SDA10F, seam(*more, entry % ", duration: 6 s"), head=f"{head}speed: 50%\n"
    )
    assert spans(planned(half))[0][0] == pytest.approx(12.0, abs=1e-9)
    assert job_bound(half, "quick").value == pytest.approx(13.2, rel=2e-5)
    quick = planned(job_of(tmp_path, SDA10F, seam(*more, entry % ""), head=head))
    failed = [c.name for c in verify(quick, slow).checks if c.verdict == "failed"]
    assert failed == ["seam_as_asked"]
    with pytest.raises(InfeasibleError, match=r"takes \d\.\d+ s, more than the 1 s"):
        planned(job_of(tmp_path, SDA10F, seam(*more, entry % ", duration: 1 s"), head=head))
    # Begun on the seam there is no way to draw out: it is waited for.
    free = planned(job_of(tmp_path, SDA10F, seam("speed: 100 mm/s", "entry: {duration: 2 s}")))
    assert spans(free)[0][0] == pytest.approx(2.0, abs=1e-9)


def test_an_entry_shorter_than_what_it_holds_is_refused(tmp_path: Path) -> None:
    """Dwell and approach are within the entry's duration, also where the seam goes on from where the robot is.

    At half speed 0.3 s become 0.6 s, and the dwell stays 0.5 s.
    """
    entry = "entry: {dwell: 0.5 s, duration: 0.3 s}"
    tasks = seam("speed: 100 mm/s", name="one"), seam("speed: 100 mm/s", entry, name="two")
    job = job_of(tmp_path, SDA10F, *tasks)
    with pytest.raises(InputError) as refused:
        planned(job)
    [found] = refused.value.diagnostics
    assert (Path(found.file).name, found.line) == ("tasks.yaml", 15)
    assert "the dwell of 0.5 s does not fit into 0.3 s" in found.message
    assert dict(found.about) == {"task": "two", "value": 0.3, "allowed": 0.5}
    slow = job_of(tmp_path, SDA10F, *tasks, head="start: free\nspeed: 50%\n")
    kind = kind_of(job.sections()[0])
    assert (len(kind.check(job)), kind.check(slow)) == (1, [])
    # 40 mm take longer than the 0.1 s that the dwell leaves them.
    long = seam("speed: 100 mm/s", "entry: {approach: 40 mm, dwell: 0.2 s, duration: 0.3 s}")
    with pytest.raises(InfeasibleError, match=r"takes 0\.\d+ s, more than the 0\.3 s that entry"):
        planned(job_of(tmp_path, SDA10F, long))


def test_entry_and_exit_stand_where_the_seam_begins_and_ends_not_before_its_time(
    tmp_path: Path,
) -> None:
    """40 mm in, 0.2 s, the seam at 4 s, 0.1 s, 30 mm out; then home again."""
    text = seam(
        "speed: 100 mm/s",
        "posture: home",
        "entry: {approach: 40 mm, dwell: 0.2 s}",
        "exit: {retract: 30 mm, dwell: 0.1 s}",
        "not_before: 4 s",
    )
    job = job_of(tmp_path, SDA10F, text, head="start: home\nreturn: true\n")
    schedule = planned(job)
    # 4 s, 60 mm at 100 mm/s, 0.1 s: what comes before the seam is over by then.
    assert job_bound(job, "quick").value == pytest.approx(4.7, rel=2e-5)
    kinds = [s.kind for s in schedule.segments if s.arm == "right"]
    assert kinds == ["transfer", "wait", "approach", "dwell", "seam", "dwell", "retract", "return"]
    assert [s.reason for s in schedule.segments if s.arm == "right"] == ["", "window", *[""] * 6]
    # The left arm holds the part: it waits for the same time, for the right one's entry, and at last for its end.
    waits = [s for s in schedule.segments if s.arm == "left" and s.kind == "wait"]
    reasons = [s.reason for s in waits if s.end - s.start > 1e-6]
    assert reasons == ["window", *["partner"] * 2, *["end"] * 2]
    [(begin, end)] = spans(schedule)
    assert begin == pytest.approx(4.0, abs=1e-9)
    [first, second] = spans(schedule, "dwell")
    assert first == (pytest.approx(3.8), pytest.approx(4.0))
    assert second == (pytest.approx(end), pytest.approx(end + 0.1))
    np.testing.assert_array_equal(schedule.trajectory.position[0], schedule.trajectory.position[-1])


@pytest.mark.parametrize(
    ("speed", "pace"), [("50%", 0.5), pytest.param("1%", 0.01, marks=pytest.mark.slow)]
)
def test_a_job_s_speed_is_the_seam_s(tmp_path: Path, speed: str, pace: float) -> None:
    """60 mm at that share of 100 mm/s, and its ramps."""
    text = seam("speed: 100 mm/s", "hold: still")
    schedule = planned(job_of(tmp_path, SDA10F, text, head=f"start: free\nspeed: {speed}\n"))
    [(begin, end)] = spans(schedule)
    assert 0.6 / pace < end - begin < 1.0 / pace


def test_a_cap_holds_for_every_tool_and_is_named(tmp_path: Path) -> None:
    """60 mm/s: with the part still the tool cannot go 100 mm/s; it is slower where that is allowed."""
    head, still = CAPPED, ("speed: 100 mm/s", "hold: still")
    schedule = planned(job_of(tmp_path, SDA10F, seam(*still, "slower: allowed"), head=head))
    [(begin, end)] = spans(schedule)
    assert LENGTH / 0.06 < end - begin < LENGTH / 0.06 + 0.5
    assert any("because of the limit of the tools' speed" in note for note in schedule.notes)


@pytest.mark.slow
def test_a_seam_too_fast_for_the_cap_is_refused(tmp_path: Path) -> None:
    """The same where it may not be slower."""
    head, still = CAPPED, ("speed: 100 mm/s", "hold: still")
    with pytest.raises(InfeasibleError, match="the limit of the tools' speed"):
        planned(job_of(tmp_path, SDA10F, seam(*still), head=head))


@pytest.mark.slow
def test_a_cap_holds_for_parts_that_move_too(tmp_path: Path) -> None:
    """Both tools of the master's and the slave's arms, in the world, while the part is free to move."""
    head = "start: free\nlimits: {tool_speed: 200 mm/s}\n"
    text = seam("speed: 1 m/s", "slower: allowed", curve=ARC)
    planned(job_of(tmp_path, SDA10F, text, head=head))


@pytest.mark.slow
def test_trapezoids_are_for_robots_without_jerk_limits(tmp_path: Path) -> None:
    """An iiwa pair without jerk limits; the seam is no longer than by ruckig, whose accelerations do not jump."""
    job = job_of(tmp_path, PAIR, seam("speed: 100 mm/s", "hold: still"))
    robot = job.cell.robot
    limits = replace(robot.limits, jerk=np.full(len(robot.joints), np.inf))
    job = replace(job, cell=replace(job.cell, robot=replace(robot, limits=limits)))
    jumping, smooth = (planned(job, timing=name) for name in ("trapezoid", "ruckig"))
    assert jumping.duration <= smooth.duration
    assert np.abs(jumping.trajectory.acceleration[[0, -1]]).max() == 0.0
    assert (np.diff(jumping.trajectory.time) == 0.0).sum() >= 4


@pytest.mark.slow
def test_seams_and_picks_follow_one_another(tmp_path: Path) -> None:
    """Pick, seam, pick, another seam the other way round, home; each stage once."""
    job = job_of(
        tmp_path,
        SDA10F,
        PICK % "first",
        seam("speed: 100 mm/s", "hold: still", name="one"),
        PICK % "second",
        seam("speed: 100 mm/s", "hold: still", name="two", master="right", slave="left"),
        head="start: home\nreturn: true\n",
    )
    schedule = planned(job)
    tasks = [stage.tasks for stage in schedule.stages]
    assert tasks == [
        (name,) for name in ("first", "first", "one", "one", "second", "second", "two", "two")
    ] + [()]


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["nextage", "yumi", "amiro_like"])
def test_arms_of_other_kinds_work_seams_too(tmp_path: Path, robot: str) -> None:
    """Six axes on a waist, seven that are not spherical-revolute-spherical."""
    text = seam("speed: 100 mm/s", part="{xyz: [0, 0, 100 mm]}")
    planned(job_of(tmp_path, SMALL % robot, text))


@pytest.mark.slow
def test_a_pair_of_robots_works_with_fixed_spin(tmp_path: Path) -> None:
    """Two iiwas with bases of their own."""
    planned(job_of(tmp_path, PAIR, seam("speed: 100 mm/s", "hold: still", tool="{}")))


def test_one_robot_works_on_a_part_on_the_table(tmp_path: Path) -> None:
    """There and back."""
    text = seam("speed: 100 mm/s", master=None, slave="left", part="{xyz: [0.5, 0.1, 0.4]}")
    job = job_of(tmp_path, ALONE, text, head="start: home\nreturn: true\n")
    schedule = planned(job)
    np.testing.assert_array_equal(schedule.trajectory.position[0], schedule.trajectory.position[-1])


@pytest.mark.slow
def test_gentle_accelerations_find_their_ramps(tmp_path: Path) -> None:
    """1 mm/s² on 60 mm: 2 sqrt(0.06 / 0.001) = 15.5 s at least, a little more for jerk."""
    text = seam("speed: 100 mm/s", "acceleration: 0.001 m/s²", "slower: allowed", "hold: still")
    schedule = planned(job_of(tmp_path, SDA10F, text))
    assert 2.0 * np.sqrt(0.06 / 0.001) < schedule.duration < 18.0


def test_many_short_waves_are_followed_as_closely_as_a_straight_line(tmp_path: Path) -> None:
    """7 waves of 5 mm on 206 mm, 824 poses: the verifier finds the tool within 1 um of the curve everywhere."""
    way, count = 7.0 / 17.0 * 0.5, 824
    t = np.linspace(0.0, 1.0, count)
    phase = 2.0 * np.pi * 7.0 * t
    heading = np.arctan2(0.005 * 2.0 * np.pi * 7.0 * np.cos(phase), way)
    rows = np.stack(
        [
            way * (t - 0.5),
            0.005 * np.sin(phase),
            *np.zeros((3, count)),
            np.sin(heading / 2.0),
            np.cos(heading / 2.0),
        ],
        axis=1,
    )
    names = "x,y,z,qx,qy,qz,qw"
    np.savetxt(tmp_path / "waves.csv", rows, delimiter=",", fmt="%.17g", header=names, comments="")
    text = seam("speed: 20 mm/s", curve="{kind: poses, file: waves.csv}")
    schedule = planned(job_of(tmp_path, SDA10F, text))
    [(begin, end)] = spans(schedule)
    length = np.trapezoid(np.hypot(way, 0.005 * 14.0 * np.pi * np.cos(phase)), t)
    assert length / 0.02 < end - begin < length / 0.02 + 1.0


def test_poses_whose_x_is_not_along_their_curve_are_followed_all_the_same(tmp_path: Path) -> None:
    """A half circle of 30 mm from pi to 0 whose frames are 120 degrees off its direction all along."""
    angle = np.linspace(np.pi, 0.0, 61)
    circle = [0.03 * np.cos(angle), 0.03 * np.sin(angle)]
    half = (angle - np.pi / 2.0 + np.radians(120.0)) / 2.0
    rows = np.stack([*circle, *np.zeros((3, 61)), np.sin(half), np.cos(half)], axis=1)
    names = "x,y,z,qx,qy,qz,qw"
    np.savetxt(tmp_path / "arc.csv", rows, "%.17g", ",", header=names, comments="")
    text = seam("speed: 50 mm/s", curve="{kind: poses, file: arc.csv}")
    [(begin, end)] = spans(planned(job_of(tmp_path, SDA10F, text)))
    assert 0.03 * np.pi / 0.05 < end - begin < 0.03 * np.pi / 0.05 + 0.5


def _random_curve(rng: np.random.Generator, folder: Path) -> str:
    """A line, arc, ellipse, saddle, spline through points about an ellipse, or the poses of a wave, 20 mm to 1 m."""
    kind = rng.choice(["line", "arc", "ellipse", "saddle", "spline", "closed", "wave"])
    size = float(np.exp(rng.uniform(np.log(0.02), np.log(0.12))))
    if kind == "line":
        return f"{{kind: line, start: [{-2.0 * size}, 0, 0], end: [{2.0 * size}, 0, 0]}}"
    if kind == "arc":
        return f"{{kind: arc, radius: {size}, begin: 0, finish: {rng.uniform(60, 360)} deg}}"
    if kind == "ellipse":
        return f"{{kind: ellipse, semi_axes: [{size}, {0.75 * size}]}}"
    if kind == "saddle":
        part = rng.uniform(0.5, 0.9) * size
        return f"{{kind: saddle, main_radius: {size}, branch_radius: {part}, finish: 180 deg}}"
    if kind in ("spline", "closed"):
        angle = np.arange(12) * (2.0 * np.pi / 12.0)
        out = size * rng.uniform(0.95, 1.05, 12)
        points = np.stack([out * np.cos(angle), 0.75 * out * np.sin(angle), 0.0 * angle], axis=1)
        rows = points.round(5).tolist()
        rows += rows[:1] if kind == "closed" else []
        return f"{{kind: spline, points: {rows}, closed: {str(kind == 'closed').lower()}}}"
    count, waves, length = int(rng.integers(200, 3000)), rng.uniform(1.0, 15.0), 4.0 * size
    t, height = np.linspace(0.0, 1.0, count), rng.uniform(0.05, 0.15) * length / waves
    phase = 2.0 * np.pi * waves * t
    half = np.arctan2(height * 2.0 * np.pi * waves * np.cos(phase), length) / 2.0
    zero = np.zeros((3, count))
    columns = [length * (t - 0.5), height * np.sin(phase), *zero, np.sin(half), np.cos(half)]
    names = "x,y,z,qx,qy,qz,qw"
    rows = np.stack(columns, axis=1).round(int(rng.choice([6, 9, 15])))
    np.savetxt(folder / "wave.csv", rows, "%.15g", ",", header=names, comments="")
    return "{kind: poses, file: wave.csv}"


@pytest.mark.parametrize(
    ("cell", "seed"),
    [
        # Once above the file's acceleration between its knots.
        pytest.param(SDA10F, 14, id="sda10f-14"),
        *(
            pytest.param(cell, seed, id=f"{name}-{seed}", marks=pytest.mark.slow)
            for name, cell in (("sda10f", SDA10F), ("iiwa14", PAIR), ("qin_150", QIN))
            for seed in range(20)
            if (name, seed) != ("sda10f", 14)
        ),
    ],
)
def test_random_seams_are_planned_or_refused_with_what_helps(
    tmp_path: Path, cell: str, seed: int
) -> None:
    """Plans pass the verifier; a refusal is a limit, a reach or a collision, with what the file may change."""
    rng = np.random.default_rng(seed)
    curve = _random_curve(rng, tmp_path)
    text = seam(
        f"speed: {float(np.exp(rng.uniform(np.log(5.0), np.log(1000.0))))} mm/s",
        *rng.choice(["slower: allowed", "hold: still", "acceleration: 2 m/s²"], 1),
        curve=curve,
        tool=str(rng.choice(["{}", "{free: spin}", "{free: spin, tilt: 10 deg}"])),
    )
    try:
        planned(job_of(tmp_path, cell, text))
    except InfeasibleError as refused:
        message = str(refused)
        helps = ("lower its speed", "shorten the curve", "make it shorter", "let the tool lean")
        assert any(word in message for word in helps), message
        assert "the closed chain has an error" not in message
        assert "between its knots" not in message


def test_seams_that_cannot_be_are_refused_at_their_place(tmp_path: Path) -> None:
    """Four metres long; a method that there is not; a micrometre a second."""
    long = "{kind: line, start: [-2, 0, 0], end: [2, 0, 0]}"
    with pytest.raises(
        InfeasibleError,
        match=r"tasks\.yaml:7:7: .* mm along the seam of 4000.0 mm.*; shorten the curve or divide it, ",
    ):
        planned(job_of(tmp_path, SDA10F, seam("speed: 100 mm/s", "method: still", curve=long)))
    with pytest.raises(InputError, match="no method 'stil' works seams"):
        planned(job_of(tmp_path, SDA10F, seam("speed: 100 mm/s", "method: stil")))
    with pytest.raises(InputError, match="raise the speed"):
        planned(job_of(tmp_path, SDA10F, seam("speed: 0.001 mm/s")))


@pytest.mark.slow
def test_the_same_seam_gives_the_same_motion(tmp_path: Path) -> None:
    """Twice the same numbers, to the last bit."""
    text = seam("speed: 100 mm/s", "hold: still")
    one, other = (
        plan_without_bound(job_of(tmp_path, SDA10F, text), PlanSettings(effort="quick"))
        for _ in range(2)
    )
    np.testing.assert_array_equal(one.trajectory.position, other.trajectory.position)
    np.testing.assert_array_equal(one.trajectory.time, other.trajectory.time)
