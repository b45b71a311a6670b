"""Jobs with paths from file to verified schedule: every follower, both arms, stops in between, limits, errors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.bound.job_bound import job_bound
from dualarm_cli.errors import InfeasibleError, InputError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinds.path.following import PATH_SOLVERS
from dualarm_cli.kinds.path.measures import path_measures
from dualarm_cli.kinds.path.planning import check_paths
from dualarm_cli.model.job import Job
from dualarm_cli.model.motion.joint_motion import JointMotion
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.verification import verify

CELL = """\
dualarm: cell/1
robot: {robot}
tools:
  left: {{tcp: {{xyz: [0, 0, 120 mm]}}}}
  right: {{tcp: {{xyz: [0, 0, 120 mm]}}}}
clearance: 5 mm
{more}
"""
WIPE = """\
  - id: wipe
    path:
      arm: left
      speed: 150 mm/s
      through:
        - {xyz: [0.50, 0.20, 0.85], rpy: [180 deg, 0, 0]}
        - {xyz: [0.58, 0.20, 0.85]}
        - {arc: {via: {xyz: [0.63, 0.25, 0.85]}, to: {xyz: [0.58, 0.30, 0.85]}}}
        - {xyz: [0.50, 0.30, 0.85]}
"""
BOTH = """\
  - id: both
    path:
      speed: 200 mm/s
      left:
        through:
          - {xyz: [0.45, 0.30, 0.90], rpy: [180 deg, 0, 0]}
          - {turn: {about: [0.5, 0.3, 0.9], axis: [0, 0, 1], angle: 180 deg, tool: keeps}}
      right:
        through:
          - {xyz: [0.45, -0.30, 0.90], rpy: [180 deg, 0, 0]}
          - {turn: {about: [0.5, -0.3, 0.9], axis: [0, 0, -1], angle: 180 deg, tool: keeps}}
"""
PICK = """\
  - id: part
    arm: left
    pick: {xyz: [0.5, 0.3, 0.9], rpy: [180 deg, 0, 0]}
    place: {xyz: [0.45, 0.4, 0.9], rpy: [180 deg, 0, 0]}
    approach: 40 mm
"""


def job_of(folder: Path, *tasks: str, head: str = "", robot: str = "sda10f", more: str = "") -> Job:
    """A job of some tasks."""
    (folder / "cell.yaml").write_text(CELL.format(robot=robot, more=more))
    text = f"dualarm: tasks/1\ncell: cell.yaml\n{head}tasks:\n" + "".join(tasks)
    (folder / "tasks.yaml").write_text(text)
    return load_job(folder / "tasks.yaml")


def planned(job: Job, **settings: str) -> Schedule:
    """A plan that the verifier passes, clearance included."""
    schedule = plan_without_bound(job, PlanSettings(effort="quick", **settings))
    verdict = verify(schedule, job, clearance=True)
    assert verdict.passed, [check for check in verdict.checks if check.verdict == "failed"]
    return schedule


@pytest.mark.parametrize("follower", PATH_SOLVERS.names)
def test_every_follower_makes_a_verified_plan(tmp_path: Path, follower: str) -> None:
    """Both arms on half circles on a turning platform; as printed springs have no bounds and are soft."""
    softer = BOTH.replace("speed:", "tolerance: 1 mm\n      stiffness: 2\n      speed:")
    text = softer if "damped" in follower else BOTH
    schedule = planned(job_of(tmp_path, text), follower=follower)
    assert [stage.platform_solver for stage in schedule.stages] == [follower]


def test_stops_and_paths_follow_one_another_and_the_cycle_closes(tmp_path: Path) -> None:
    """Pick, place, a path of one arm, a path of both, home again: four stages and the return, no jump anywhere."""
    job = job_of(tmp_path, PICK, WIPE, BOTH, head="return: true\n")
    schedule = planned(job)
    assert [stage.tasks for stage in schedule.stages] == [
        ("part",), ("part",), ("wipe",), ("both",), ()
    ]  # fmt: skip
    trajectory = schedule.trajectory
    # Machines round differently: on some of them the platform ends 8e-17 rad beside zero.
    np.testing.assert_allclose(trajectory.position[0], trajectory.position[-1], rtol=0, atol=1e-15)
    moved = np.abs(np.diff(trajectory.position, axis=0)).max(axis=0)
    allowed = job.cell.robot.limits.velocity * np.diff(trajectory.time).max()
    assert (moved <= allowed + 1e-12).all()
    # Both arms are at the same share of their paths: half circles of one size, mirrored.
    events = {(event.arm, event.task): event for event in schedule.events if event.action == "path"}
    np.testing.assert_allclose(events["left", "both"].pose.translation, [0.55, 0.30, 0.90])
    np.testing.assert_allclose(events["right", "both"].pose.translation, [0.55, -0.30, 0.90])
    assert events["left", "both"].time == events["right", "both"].time


def test_the_bound_is_what_paths_take_at_full_speed_at_least(tmp_path: Path) -> None:
    """Two lines of 80 mm and half a circle of radius 50 mm at 150 mm/s; the other path pi 0.05 m at 200 mm/s."""
    ways = {WIPE: (0.16 + np.pi * 0.05) / 0.15, BOTH: np.pi * 0.05 / 0.2}
    for path, expected in ways.items():
        job = job_of(tmp_path, path, head="start: free\n")
        assert job_bound(job, "quick").value == pytest.approx(expected, rel=2e-5)
        assert planned(job).duration >= expected


def test_half_speed_takes_twice_as_long_and_a_cap_binds(tmp_path: Path) -> None:
    """speed: 50% doubles the path's time exactly; under a cap of 75 mm/s it is its length at that speed and a ramp."""
    full = planned(job_of(tmp_path, WIPE, head="start: free\n"))
    half = planned(job_of(tmp_path, WIPE, head="start: free\nspeed: 50%\n"))
    assert half.duration == pytest.approx(2.0 * full.duration, rel=1e-9)
    capped = planned(job_of(tmp_path, WIPE, head="start: free\nlimits: {tool_speed: 75 mm/s}\n"))
    # Up to the speed in 0.2 s at constant acceleration, which itself takes 0.1 s to build up; as long at the end.
    length = 0.16 + np.pi * 0.05
    assert capped.duration == pytest.approx(length / 0.075 + 0.3, rel=1e-3)
    assert any("limit of the tools' speed" in note for note in capped.notes)
    # Limits of the task hold for the motion to its path as well.
    for start, key, whole in (
        ("home", "speed: 50%", None),
        ("free", "tool_speed: 75 mm/s", capped),
    ):
        careful = WIPE.replace("    path:", f"    {key}\n    path:")
        schedule = planned(job_of(tmp_path, careful, head=f"start: {start}\n"))
        whole = whole or planned(job_of(tmp_path, WIPE, head=f"start: {start}\n{key}\n"))
        assert schedule.duration == whole.duration
        [care] = [
            check
            for check in verify(
                schedule, job_of(tmp_path, careful, head=f"start: {start}\n")
            ).checks
            if check.name == "care"
        ]
        assert care.verdict == "passed" and care.measured > 0.99


def test_tools_on_paths_lean_no_farther_than_allowed(tmp_path: Path) -> None:
    """From 180 to 170 degrees: 10 are measured, 7.5 of 8 refused; a tenth of the accelerations is used up."""
    leaning = WIPE.replace("[0.58, 0.20, 0.85]}", "[0.58, 0.20, 0.85], rpy: [170 deg, 0, 0]}")
    leaning = leaning.replace("speed:", "slower: allowed\n      speed:").replace("150", "400")

    def careful(tilt: int) -> Job:
        keys = f"    acceleration: 10 %\n    tilt: {tilt} deg\n    path:"
        return job_of(tmp_path, leaning.replace("    path:", keys), head="start: free\n")

    schedule = planned(careful(12))
    checks = {check.name: check for check in verify(schedule, careful(12)).checks}
    assert checks["tilt"].measured == pytest.approx(10.0 / 12.0, abs=1e-5)
    time = np.arange(0.0, schedule.duration, 5e-4)
    joints = schedule.robot.arms["left"].joints
    q = schedule.trajectory.select(joints).clamped(time)[0]
    used = np.abs(np.diff(q, 2, axis=0)).max(axis=0) / 5e-4**2
    limits = careful(12).limits.select(joints)
    assert checks["care"].verdict == "passed"
    assert 0.09 < (used / limits.acceleration).max() < 0.1001
    strict = careful(8)
    [check] = [check for check in verify(schedule, strict).checks if check.name == "tilt"]
    assert check.verdict == "failed" and check.measured == pytest.approx(10.0 / 8.0, abs=1e-5)
    [fault] = check_paths(strict)
    assert str(fault).endswith(
        "E300 tilt: the left tool leans 10.0 deg from its attitude at the start, and 7.5 deg are allowed; turn the "
        "poses, or raise tilt"
    )


def test_a_path_too_fast_is_refused_with_time_place_and_joint_or_slowed(tmp_path: Path) -> None:
    """4 m/s round an arc of 50 mm is 320 m/s²: no joint can; allowed to be slower it eases off there."""
    fast = WIPE.replace("150 mm/s", "4 m/s")
    with pytest.raises(InfeasibleError) as error:
        planned(job_of(tmp_path, fast, head="start: free\n"), follower="arm_angle")
    text = str(error.value)
    for part in (
        "tasks.yaml:7:7",
        "task 'wipe' (left)",
        "mm along its path at (",
        "joint ",
        "slower: allowed",
    ):
        assert part in text, text
    slower = fast.replace("speed:", "slower: allowed\n      speed:")
    schedule = planned(job_of(tmp_path, slower, head="start: free\n"), follower="arm_angle")
    assert any(
        note.startswith("wipe: takes") and "because of the joints' limits" in note
        for note in schedule.notes
    )


def test_easing_off_is_local(tmp_path: Path) -> None:
    """A long line with a tight bend in its middle takes less than twice as long as where it had no bend."""
    bend = """\
  - id: wipe
    path:
      arm: left
      speed: 500 mm/s
      slower: allowed
      through:
        - {xyz: [0.30, 0.20, 0.90], rpy: [180 deg, 0, 0]}
        - {xyz: [0.55, 0.20, 0.90]}
        - {arc: {via: {xyz: [0.56, 0.21, 0.90]}, to: {xyz: [0.55, 0.22, 0.90]}}}
        - {xyz: [0.30, 0.22, 0.90]}
"""
    schedule = planned(job_of(tmp_path, bend, head="start: free\n"), follower="arm_angle")
    # All of it as slow as in the bend: v² / r = v² / 0.01 m at 2 m/s² is 0.14 m/s, so 0.53 m take 3.8 s.
    [segment] = [s for s in schedule.segments if s.kind == "path"]
    assert segment.end - segment.start < 3.0


@pytest.mark.slow
def test_an_unreachable_stretch_is_told_with_its_place(tmp_path: Path) -> None:
    """A line that ends 3 m away: exit 3 by every kind of method, with the time and the tool's place."""
    away = WIPE.replace("{xyz: [0.50, 0.30, 0.85]}", "{xyz: [3.0, 0.30, 0.85]}")
    for follower in ("arm_angle", "min_norm", "manipulability"):
        with pytest.raises(InfeasibleError, match=r"after \d+\.\d+ s, left tool \d+\.\d mm along"):
            planned(job_of(tmp_path, away, head="start: free\n"), follower=follower)


def test_a_start_out_of_reach_says_by_how_much(tmp_path: Path) -> None:
    """The path begins 3 m away: the start is told, with the distance at the best platform angle."""
    away = WIPE.replace("0.50, 0.20", "3.0, 0.20").replace("0.58, 0.20", "3.1, 0.20")
    away = away.replace("via: {xyz: [0.63, 0.25", "via: {xyz: [3.15, 0.25").replace(
        "0.58, 0.30", "3.1, 0.30"
    )
    with pytest.raises(InfeasibleError, match=r"begins: the target is \d+\.\d mm beyond"):
        planned(job_of(tmp_path, away, head="start: free\n"))


def test_obstacles_on_the_way_are_kept_clear_of_or_named(tmp_path: Path) -> None:
    """A block where the path is: every start collides, and the message names the bodies; beside it all is well."""
    block = "obstacles:\n  - {name: block, box: [0.1, 0.1, 0.2], xyz: [%s, 0.25, 0.9]}"
    with pytest.raises(InfeasibleError, match="block"):
        planned(job_of(tmp_path, WIPE, head="start: free\n", more=block % "0.6"))
    planned(job_of(tmp_path, WIPE, head="start: free\n", more=block % "0.9"))


def test_both_tools_keep_their_relative_pose_on_one_turn(tmp_path: Path) -> None:
    """Turning a rigid part: the right tool seen from the left one never changes, to 1e-7 between all knots."""
    carry = """\
  - id: carry
    path:
      speed: 100 mm/s
      left:
        through:
          - {xyz: [0.50, 0.15, 0.90], rpy: [90 deg, 0, 0]}
          - {turn: {about: [0.5, 0, 0.95], axis: [0, 1, 0], angle: 40 deg}}
      right:
        through:
          - {xyz: [0.50, -0.15, 0.90], rpy: [-90 deg, 0, 0]}
          - {turn: {about: [0.5, 0, 0.95], axis: [0, 1, 0], angle: 40 deg}}
"""
    job = job_of(tmp_path, carry, head="start: free\n")
    for follower in ("arm_angle", "virtual_spring"):
        schedule = planned(job, follower=follower)
        model = pin.buildModelFromXML(job.cell.robot.urdf)
        data = model.createData()
        joints = list(model.names)[1:]
        columns = [schedule.trajectory.joints.index(name) for name in joints]
        times = np.linspace(0.0, schedule.duration, 301)
        relative = []
        for q in schedule.trajectory.at(times)[0][:, columns]:
            pin.framesForwardKinematics(model, data, q)
            poses = [
                data.oMf[model.getFrameId(arm.flange)] * job.cell.tools[arm.name].tcp
                for arm in job.cell.robot.arms
            ]
            relative.append((poses[0].inverse() * poses[1]).homogeneous)
        assert np.ptp(np.array(relative), axis=0).max() < 1e-7


@pytest.mark.parametrize("robot", ["yumi", "nextage"])
def test_general_arms_follow_paths(tmp_path: Path, robot: str) -> None:
    """Half circles from near home; no closed form, so the accelerations' program is the default."""
    job = load_job(_general(tmp_path, robot))
    schedule = planned(job)
    assert schedule.stages[0].platform_solver == "manipulability"


def _general(folder: Path, robot: str) -> Path:
    """A task file for a robot without closed forms, from its home pose on."""
    (folder / "cell.yaml").write_text(f"dualarm: cell/1\nrobot: {robot}\n")
    (folder / "tasks.yaml").write_text(
        "dualarm: tasks/1\ncell: cell.yaml\ntasks: [{id: a, arm: left, move: {xyz: [0, 0, 0]}}]\n"
    )
    cell = load_job(folder / "tasks.yaml").cell
    model = pin.buildModelFromXML(cell.robot.urdf)
    data = model.createData()
    order = [cell.robot.joints.index(name) for name in list(model.names)[1:]]
    pin.framesForwardKinematics(model, data, cell.robot.postures["home"][order])
    ways = []
    for arm, side in zip(cell.robot.arms, (1.0, -1.0), strict=True):
        x, y, z = data.oMf[model.getFrameId(arm.flange)].translation
        ways.append(
            f"      {arm.name}: {{through: [{{xyz: [{x}, {y}, {z}], rpy: [180 deg, 0, 0]}}, "
            f"{{turn: {{about: [{x}, {y + side * 0.04}, {z}], axis: [0, 0, {side}], angle: 180 deg, "
            "tool: keeps}}]}\n"
        )
    text = "dualarm: tasks/1\ncell: cell.yaml\ntasks:\n  - id: p\n    path:\n      speed: 80 mm/s\n"
    (folder / "tasks.yaml").write_text(text + "".join(ways))
    return folder / "tasks.yaml"


def test_torque_limits_are_kept_or_refused(tmp_path: Path) -> None:
    """OpenArm lifts 1 kg within its motors' torques, and cannot hold 6 kg: the joint and the torque are named."""
    lift = """\
  - id: lift
    path:
      arm: left
      speed: 300 mm/s
      torque: limited
      redundancy: manipulability
      through:
        - {xyz: [0.38, 0.20, 0.45], rpy: [-90 deg, -90 deg, -90 deg]}
        - {xyz: [0.38, 0.20, 0.60]}
"""
    cell = CELL.replace("0, 0, 120 mm", "0, 0, 100 mm").replace(
        "]}}}}\n  right", "]}}, mass: MASS}}\n  right"
    )
    for mass, holds in (("1 kg", True), ("6 kg", False)):
        (tmp_path / "cell.yaml").write_text(
            cell.format(robot="openarm", more="").replace("MASS", mass)
        )
        (tmp_path / "tasks.yaml").write_text(
            "dualarm: tasks/1\ncell: cell.yaml\nstart: free\ntasks:\n" + lift
        )
        job = load_job(tmp_path / "tasks.yaml")
        if holds:
            schedule = planned(job)
            [check] = [c for c in verify(schedule, job).checks if c.name == "torque"]
            assert check.verdict == "passed"
            assert check.measured is not None and 0.05 < check.measured <= 1.001
        else:
            with pytest.raises(InfeasibleError, match=r"needs \d+\.?\d* N m, allowed"):
                planned(job)


def test_torques_cannot_be_limited_where_none_are_known(tmp_path: Path) -> None:
    """The SDA10F's URDF has no efforts: an error of the file, at the path, that names joints."""
    text = WIPE.replace("speed:", "torque: limited\n      speed:")
    with pytest.raises(InputError, match=r"tasks\.yaml:6:7: E300 torque: limited needs .*torso_b1"):
        planned(job_of(tmp_path, text))


def test_the_same_job_gives_the_same_motion(tmp_path: Path) -> None:
    """Twice the same numbers, to the last bit."""
    job = job_of(tmp_path, BOTH)
    one, other = (
        plan_without_bound(job, PlanSettings(follower="manipulability", effort="quick"))
        for _ in range(2)
    )
    np.testing.assert_array_equal(one.trajectory.position, other.trajectory.position)
    np.testing.assert_array_equal(one.trajectory.time, other.trajectory.time)


def test_out_and_back_on_one_line_is_followed_and_judged(tmp_path: Path) -> None:
    """An insertion: the way back is the way in, and the tool stops in between."""
    insertion = """\
  - id: insert
    path:
      arm: left
      speed: 100 mm/s
      through:
        - {xyz: [0.50, 0.25, 1.00], rpy: [180 deg, 0, 0]}
        - {xyz: [0.50, 0.25, 0.90]}
        - {xyz: [0.50, 0.25, 1.00]}
"""
    schedule = planned(job_of(tmp_path, insertion, head="start: free\n"))
    assert any("stops at one corner" in note for note in schedule.notes)


@pytest.mark.slow
def test_a_cap_holds_for_a_tool_that_only_the_platform_moves(tmp_path: Path) -> None:
    """The right arm follows, the waist turns by [Choi2020], and the left tool, 0.7 m from the axis, is swung along."""
    seam = """\
  - id: seam
    path:
      arm: right
      speed: 60 mm/s
      slower: allowed
      redundancy: virtual_spring
      through:
        - {xyz: [0.50, -0.30, 0.90], rpy: [180 deg, 0, 0]}
        - {xyz: [0.50, -0.10, 0.90]}
"""
    free = planned(job_of(tmp_path, seam, head="start: free\n"))
    capped_job = job_of(tmp_path, seam, head="start: free\nlimits: {tool_speed: 60 mm/s}\n")
    capped = planned(capped_job)
    [check] = [c for c in verify(capped, capped_job).checks if c.name == "tool_speed"]
    assert check.verdict == "passed"
    assert capped.duration > free.duration


def test_dawdling_is_found_where_it_is_forbidden(tmp_path: Path) -> None:
    """The same motion at a third of its speed fails the check of its time, and nothing else of the paths."""
    job = job_of(tmp_path, BOTH, head="start: free\n")
    schedule = planned(job)
    motion = schedule.trajectory
    slow = replace(
        schedule,
        motion=JointMotion.of(
            replace(
                motion,
                time=3.0 * motion.time,
                velocity=motion.velocity / 3.0,
                acceleration=motion.acceleration / 9.0,
            )
        ),
        stages=tuple(replace(s, start=3.0 * s.start, end=3.0 * s.end) for s in schedule.stages),
        segments=tuple(replace(s, start=3.0 * s.start, end=3.0 * s.end) for s in schedule.segments),
        events=tuple(replace(e, time=3.0 * e.time) for e in schedule.events),
    )
    failed = {check.name for check in verify(slow, job).checks if check.verdict == "failed"}
    # pi 0.05 m at 0.2 m/s is 0.8 s, and twice the longest ramp 2.4 s: 3.2 s; three times 1.1 s are more.
    assert failed == {"path_time"}


def test_a_start_that_touches_is_told_first(tmp_path: Path) -> None:
    """A block about the left elbow at home: the start is named, not the path."""
    block = "obstacles:\n  - {name: block, box: [0.3, 0.3, 0.3], xyz: [0.1, 0.7, 1.1]}"
    with pytest.raises(InfeasibleError, match=r"start: in posture 'home' .*block"):
        planned(job_of(tmp_path, WIPE, more=block))


@pytest.mark.parametrize("follower", ["min_norm", "virtual_spring", "manipulability"])
def test_a_singular_start_is_refused_and_an_idle_singular_arm_is_no_matter(
    tmp_path: Path, follower: str
) -> None:
    """At posture zero both arms are stretched: as a start that is told, the idle arm is not asked."""
    stretched = """\
  - id: back
    path:
      arm: left
      speed: 50 mm/s
      posture: zero
      through:
        - {xyz: [%s], rpy: [%s]}
        - {xyz: [%s]}
"""
    robot = load_job_robot(tmp_path)
    from dualarm_cli.kinematics.whole_body import WholeBody

    state = WholeBody(robot).at(np.array(robot.robot.postures["zero"]))
    xyz = ", ".join(repr(float(v)) for v in state.p[0])
    rpy = ", ".join(repr(float(v)) for v in pin.rpy.matrixToRpy(state.R[0]))
    back = ", ".join(repr(float(v)) for v in state.p[0] - np.array([0.0, 0.05, 0.0]))
    job = job_of(tmp_path, stretched % (xyz, rpy, back), head="start: free\n")
    with pytest.raises(InfeasibleError):
        planned(job, follower=follower)
    idle = WIPE.replace("speed: 150 mm/s", "speed: 120 mm/s")
    planned(job_of(tmp_path, idle, head="start: zero\n"), follower=follower)


def load_job_robot(folder: Path):
    """The cell of these tests."""
    return job_of(folder, WIPE).cell


def test_manipulability_does_not_depend_on_an_arm_that_stands(tmp_path: Path) -> None:
    """The left arm's motion is the same whether the right one is bent or nearly stretched."""
    from dualarm_cli.kinds.path.context import PathContext
    from dualarm_cli.kinds.path.following import PathMotion
    from dualarm_cli.kinds.path.following.acceleration import follow_manipulability
    from dualarm_cli.kinds.path.starts import path_starts
    from dualarm_cli.kinematics.cell_model import CellModel

    job = job_of(tmp_path, WIPE, head="start: free\n")
    context = PathContext.of(CellModel.from_cell(job.cell), job)
    work = job.tasks[0].path
    assert work is not None
    robot = job.cell.robot
    right = robot.columns(robot.arm("right").joints)
    found = []
    for bend in (-1.2, -1e-4):
        here = np.array(robot.postures["home"])
        here[right] = 0.0
        here[right[3]] = bend
        start = path_starts(context, work, np.array(robot.postures["home"]), 0).configurations[0]
        start = start.copy()
        start[right] = here[right]
        motion = follow_manipulability(context.problem(work, start, context.clock(work)))
        assert isinstance(motion, PathMotion)
        left = robot.columns([*robot.platform, *robot.arm("left").joints])
        found.append(motion.position[:, left])
    np.testing.assert_allclose(found[0], found[1], atol=1e-9)


def test_chains_of_arcs_are_rounded_within_their_tolerance(tmp_path: Path) -> None:
    """Four short arcs of 50 mm that bend to and fro, and a wide arc that turns into a tight one: planned and judged."""
    chain = """\
  - id: chain
    path:
      arm: left
      speed: 100 mm/s
      slower: allowed
      through:
        - {xyz: [0.45, 0.15, 0.90], rpy: [180 deg, 0, 0]}
        - {xyz: [0.50, 0.15, 0.90]}
        - {turn: {about: [0.50, 0.20, 0.90], axis: [0, 0, 1], angle: 0.2, tool: keeps}}
        - {turn: {about: [%s, %s, 0.90], axis: [0, 0, -1], angle: 0.4, tool: keeps}}
"""
    # Where the first arc ends, its tangent is turned by 0.2; the next centre is as far to the right of it.
    x, y = 0.50 + 0.05 * np.sin(0.2), 0.20 - 0.05 * np.cos(0.2)
    text = chain % (x + 0.05 * np.sin(0.2), y - 0.05 * np.cos(0.2))
    planned(job_of(tmp_path, text, head="start: free\n"))


@pytest.mark.parametrize("given", ["acceleration: 0.1 m/s²", "jerk: 0.2 m/s³"])
def test_gentle_paths_are_not_called_late(tmp_path: Path, given: str) -> None:
    """A file that asks for gentle ramps gets them, and the check of its time allows them."""
    gentle = WIPE.replace(
        "speed: 150 mm/s", f"speed: 500 mm/s\n      slower: forbidden\n      {given}"
    )
    planned(job_of(tmp_path, gentle, head="start: free\n"))


def test_endless_paths_are_refused_at_their_place(tmp_path: Path) -> None:
    """0.3 m at a micrometre a second take four days."""
    with pytest.raises(InputError, match=r"tasks\.yaml:6:7: E300 .* raise the speed"):
        planned(job_of(tmp_path, WIPE.replace("150 mm/s", "0.001 mm/s")))


def test_a_path_that_never_reaches_its_speed_is_not_called_late(tmp_path: Path) -> None:
    """100 mm at up to 1.5 m/s with 1 m/s² and 2 m/s³: planner and verifier compute one time in two ways."""
    short = """\
  - id: short
    path:
      arm: left
      speed: 1.5 m/s
      acceleration: 1 m/s²
      jerk: 2 m/s³
      through:
        - {xyz: [0.50, 0.25, 0.95], rpy: [180 deg, 0, 0]}
        - {xyz: [0.50, 0.25, 0.90]}
        - {xyz: [0.50, 0.30, 0.90]}
"""
    for shift in (0.0, 0.007):
        text = short.replace("0.95", repr(0.95 + shift))
        planned(job_of(tmp_path, text, head="start: free\n"))


SQUARE = """\
  - id: frame
    path:
      arm: left
      speed: {speed} mm/s
      slower: allowed
{blend}
      through:
        - {{xyz: [0.45, 0.20, 0.85], rpy: [180 deg, 0, 0]}}
        - {{xyz: [0.55, 0.20, 0.85]}}
        - {{xyz: [0.55, 0.30, 0.85]}}
        - {{xyz: [0.45, 0.30, 0.85], rpy: [180 deg, 0, 30 deg]}}
        - {{xyz: [0.45, 0.20, 0.85]}}
"""


def _square(folder: Path, blend: str, speed: int = 150) -> Job:
    given = f"      blend: {blend}" if blend else ""
    return job_of(folder, SQUARE.format(speed=speed, blend=given))


def test_rounded_corners_save_the_stops_and_are_left_by_no_more_than_allowed(
    tmp_path: Path,
) -> None:
    """A corner of 90 degrees whose curve takes d of each side is left by sqrt(2) (16 - 25 * 0.3) / 32 d."""
    job = _square(tmp_path, "15 mm")
    rounded = plan_without_bound(job, PlanSettings(effort="quick"))
    stopping = plan_without_bound(job, PlanSettings(effort="quick", blend="none"))
    assert verify(rounded, job, clearance=True).passed
    assert verify(stopping, job, clearance=True).passed
    assert rounded.duration < stopping.duration - 0.5
    [row] = path_measures(rounded, job)
    assert np.allclose(row["rounded_corners"], 0.015)
    reach = 0.015 / (np.sqrt(2.0) * 8.5 / 32.0)
    # A curve is longer than its chord, and shorter than the way by the corner.
    assert 0.4 - 3 * (2.0 - np.sqrt(2.0)) * reach < row["length"] < 0.4
    [asked] = [check for check in verify(rounded, job).checks if check.name == "path_corners"]
    assert 0.9 < asked.measured <= 1.0


def test_corners_that_are_rounded_more_than_allowed_fail(tmp_path: Path) -> None:
    """The same motion, judged by a file that allows less, or nothing."""
    rounded = plan_without_bound(_square(tmp_path, "15 mm"), PlanSettings(effort="quick"))
    for allowed in ("10 mm", ""):
        verdict = verify(rounded, _square(tmp_path, allowed))
        assert "path_distance" in {check.name for check in verdict.failures}
        if allowed:
            assert "path_corners" in {check.name for check in verdict.failures}


@pytest.mark.slow
def test_a_bend_that_takes_longer_than_a_stop_is_not_taken(tmp_path: Path) -> None:
    """0.5 mm at 1 m/s: the same cycle as with stops, and the plan is as good."""
    job = _square(tmp_path, "0.5 mm", speed=1000)
    found = plan_without_bound(job, PlanSettings(effort="quick"))
    stopping = plan_without_bound(job, PlanSettings(effort="quick", blend="none"))
    assert verify(found, job).passed
    assert found.duration == pytest.approx(stopping.duration)
    assert path_measures(found, job)[0]["rounded_corners"] == []
