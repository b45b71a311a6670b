"""Arms whose first joint slides: kinematics against pinocchio and finite differences, plans verified."""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.cli.run import run
from dualarm_cli.errors import InputError
from dualarm_cli.files.robots.robots import load_robot
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import MeasuredRobot
from dualarm_cli.kinematics.continuation import FlangeLines, spare_directions
from dualarm_cli.kinematics.general_arm import GeneralArm
from dualarm_cli.kinematics.serial_chain import FEW
from dualarm_cli.kinematics.whole_body import WholeBody
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan
from dualarm_cli.verification import verify

AXES = ("0 1 0", "0 0 1", "0.36 -0.48 0.8")


def arm_on_slide(
    folder: Path, sliding_robots: ModuleType, axis: str, joints: int
) -> tuple[GeneralArm, pin.Model, list[str]]:
    """Returns the left arm on a slide of its own from -4 to 4 m, the whole robot, and the arm's joints."""
    slide = sliding_robots.Slide(axis, -4.0, 4.0)
    sliding_robots.write_robot(folder, {}, joints=joints, own=slide)
    robot = load_robot(str(folder / "robot.yaml")).robot
    model = pin.buildModelFromXML(robot.urdf)
    base = pin.SE3.Identity()
    arm = robot.arm("left")
    return MeasuredRobot.of(robot, base).general(arm), model, list(arm.joints)


def some_joints(arm: GeneralArm, count: int, seed: int) -> np.ndarray:
    """Returns random joints within limits, shape (count, n)."""
    return np.random.default_rng(seed).uniform(arm.lower, arm.upper, (count, arm.axes))


@pytest.mark.parametrize(("axis", "joints"), itertools.product(AXES, (6, 7)))
def test_forward_kinematics_is_pinocchio_s(axis, joints, tmp_path, sliding_robots):
    """Few postures and many, which go different ways."""
    arm, model, names = arm_on_slide(tmp_path, sliding_robots, axis, joints)
    assert arm.slides == (0,)
    assert arm.axes == joints + 1
    data, flange = model.createData(), model.getFrameId("left_flange")
    columns = [model.joints[model.getJointId(name)].idx_q for name in names]
    q = some_joints(arm, 3 * FEW, 5)
    many, few = arm.forward(q), arm.forward(q[:9])
    for k, row in enumerate(q):
        position = pin.neutral(model)
        position[columns] = row
        pin.framesForwardKinematics(model, data, position)
        np.testing.assert_allclose(many[1][k], data.oMf[flange].translation, atol=1e-13)
        np.testing.assert_allclose(many[0][k], data.oMf[flange].rotation, atol=1e-13)
    np.testing.assert_allclose(few[1], many[1][:9], atol=1e-14)
    np.testing.assert_allclose(few[0], many[0][:9], atol=1e-14)


@pytest.mark.parametrize(("axis", "joints"), itertools.product(AXES, (6, 7)))
def test_the_jacobian_is_that_of_finite_differences(axis, joints, tmp_path, sliding_robots):
    """Central differences of positions and rotations; the slide's column is its axis, without rotation."""
    arm, _, _ = arm_on_slide(tmp_path, sliding_robots, axis, joints)
    h = 1e-6
    for q in some_joints(arm, 5, 6):
        J = arm.jacobian(q)
        for k, step in enumerate(h * np.eye(arm.axes)):
            (R1, p1), (R0, p0) = arm.forward(q + step), arm.forward(q - step)
            np.testing.assert_allclose(J[:3, k], (p1 - p0) / (2 * h), atol=1e-8)
            np.testing.assert_allclose(J[3:, k], pin.log3(R1 @ R0.T) / (2 * h), atol=1e-8)
        np.testing.assert_allclose(
            J[:, 0], [*(float(v) for v in axis.split()), 0, 0, 0], atol=1e-14
        )


@pytest.mark.parametrize("joints", [6, 7])
def test_poses_all_along_the_slide_are_reached(joints, tmp_path, sliding_robots):
    """Random postures' poses: reached within limits to 1e-10, wherever on eight metres; one beyond the end is not."""
    arm, _, _ = arm_on_slide(tmp_path, sliding_robots, "0 1 0", joints)
    q = some_joints(arm, 24, 7)
    q[:, 4] = 0.3 + np.abs(q[:, 4]) / 3.0
    R, p = arm.forward(q)
    found = arm.postures(R, p)
    assert set(found.pose.tolist()) == set(range(len(q)))
    R_found, p_found = arm.forward(found.q)
    np.testing.assert_allclose(p_found, p[found.pose], atol=1e-9)
    np.testing.assert_allclose(R_found, R[found.pose], atol=1e-9)
    assert arm.within_limits(found.q).all()
    away = p[:1] + np.array([0.0, 20.0, 0.0])
    assert not len(arm.postures(R[:1], away).q)


def test_a_slide_knows_no_whole_turns(tmp_path, sliding_robots):
    """Its position stays what it is, 2π m or not, where turning joints take the nearest turn."""
    arm, _, _ = arm_on_slide(tmp_path, sliding_robots, "0 1 0", 6)
    wide = arm.without_limits
    q = np.full((1, arm.axes), 0.1)
    reference = q + 2.0 * np.pi
    near = wide.nearest_turns(q, reference)
    assert near[0, 0] == 0.1
    np.testing.assert_allclose(near[0, 1:], 0.1 + 2.0 * np.pi)
    less = arm.less_turns(reference - q)
    assert less[0, 0] == pytest.approx(2.0 * np.pi)
    np.testing.assert_allclose(less[0, 1:], 0.0, atol=1e-15)


def test_self_motion_of_six_joints_on_a_slide_moves_the_slide(tmp_path, sliding_robots):
    """The spare direction does not move the flange, and the slide takes part in it; lines are followed."""
    arm, _, _ = arm_on_slide(tmp_path, sliding_robots, "0 1 0", 6)
    start = np.array([[0.5, 0.3, -0.7, 1.7, 0.2, 0.5, 0.1]])
    W = spare_directions(arm, start)
    np.testing.assert_allclose(arm.jacobian(start[0]) @ W[0, 0], 0.0, atol=1e-12)
    assert abs(W[0, 0, 0]) > 0.05
    R, p = arm.forward(start)
    shift = np.array([[0.0, 0.0, -0.1]])
    course = arm.follow_lines(start, FlangeLines(R, p, shift), np.zeros(1), 33)
    assert course.ok[0]
    R_end, p_end = arm.forward(course.q[-1])
    np.testing.assert_allclose(p_end, p + shift, atol=1e-9)
    np.testing.assert_allclose(R_end, R, atol=1e-9)


def test_shoulder_and_elbow_are_found_behind_the_slide(tmp_path, sliding_robots):
    """The upper arm of 400 mm, of six joints and of seven, with and without a slide."""
    for joints, own in itertools.product((6, 7), (None, sliding_robots.RAIL)):
        sliding_robots.write_robot(tmp_path, {"lift": sliding_robots.LIFT}, joints=joints, own=own)
        (tmp_path / "cell.yaml").write_text("dualarm: cell/1\nrobot: robot.yaml\n")
        (tmp_path / "tasks.yaml").write_text(
            "dualarm: tasks/1\ncell: cell.yaml\ntasks:\n"
            "  - {id: a, arm: left, move: {xyz: [0.5, 0.3, 0.8], rpy: [180 deg, 0, 0]}}\n"
        )
        places, lengths = WholeBody(load_job(tmp_path / "tasks.yaml").cell).shoulders()
        np.testing.assert_allclose(lengths, 0.4, atol=1e-12)
        np.testing.assert_allclose(places[:, 1], [0.25, -0.25], atol=1e-12)


FAR = """\
dualarm: tasks/1
cell: cell.yaml
return: true
defaults: {approach: 50 mm, retract: 50 mm}
tasks:
  - id: a
    arm: left
    pick: {xyz: [0.55, 0.3, 0.8], rpy: [180 deg, 0, 0]}
    place: {xyz: [0.5, 3.6, 0.8], rpy: [180 deg, 0, 0.3]}
  - id: b
    arm: right
    pick: {xyz: [0.55, -0.3, 0.8], rpy: [180 deg, 0, 0]}
    place: {xyz: [0.5, -1.5, 0.8], rpy: [180 deg, 0, 0], free: yaw}
"""


@pytest.mark.parametrize(("joints", "platform"), [(6, False), (7, False), (6, True)])
def test_an_arm_on_a_slide_is_planned_and_verified(joints, platform, tmp_path, sliding_robots):
    """3.3 m along the slide at 0.5 m/s: no faster than the textbook says for what the arm leaves of it."""
    own = sliding_robots.Slide("0 1 0", -2.0, 4.0)
    # Without a lift the arms' slides are on the base: 1 m lower.
    chain = {"lift": sliding_robots.LIFT} if platform else {"waist": None}
    frozen = "" if platform else "waist: 0"
    sliding_robots.write_robot(tmp_path, chain, joints=joints, own=own, frozen=frozen)
    (tmp_path / "cell.yaml").write_text(
        "dualarm: cell/1\nrobot: robot.yaml\ntools: {left: {tcp: {}}, right: {tcp: {}}}\n"
    )
    (tmp_path / "tasks.yaml").write_text(FAR)
    job = load_job(tmp_path / "tasks.yaml")
    schedule = plan(job, PlanSettings(effort="quick"))
    verification = verify(schedule, job, clearance=True)
    assert verification.passed, [c for c in verification.checks if c.verdict == "failed"]
    assert schedule.lower_bound is None
    trajectory = schedule.trajectory
    column = trajectory.joints.index("left_slide")
    at = trajectory.at(np.array([stage.end for stage in schedule.stages]))[0][:, column]
    way = abs(float(at[1] - at[0]))
    reach = sliding_robots.UPPER + sliding_robots.FORE + sliding_robots.HAND
    assert way >= 3.3 - 2.0 * reach
    v, a, j = sliding_robots.SPEED, sliding_robots.ACCELERATION, sliding_robots.JERK
    second = schedule.stages[1]
    # Along the lines the slide moves as well; in the transfer alone it moves what is left.
    left = way - 2.0 * 0.05
    assert second.end - second.start >= left / v + v / a + a / j
    stated = second.joint_times["left_slide"]
    moved = (stated - v / a - a / j) * v
    assert abs(moved - way) < 0.1
    speed = np.abs(trajectory.velocity[:, column]).max()
    assert 0.9 * v <= speed <= v * (1.0 + 1e-9)


def test_a_joint_that_slides_further_on_is_refused_where_it_is_named(tmp_path, sliding_robots):
    """Only the first joint of an arm may."""
    sliding_robots.write_robot(tmp_path, {"lift": sliding_robots.LIFT}, joints=6)
    urdf = tmp_path / "robot.urdf"
    urdf.write_text(
        urdf.read_text().replace('name="left_4" type="revolute"', 'name="left_4" type="prismatic"')
    )
    with pytest.raises(
        InputError, match=r"robot\.yaml:6:35: E300 'left_4' slides; of an arm's joints"
    ):
        load_robot(str(tmp_path / "robot.yaml"))


def test_robot_show_says_which_joint_slides(tmp_path, sliding_robots, capsys):
    """And what serves such an arm; JSON says it of each joint."""
    sliding_robots.write_robot(tmp_path, {}, joints=6, own=sliding_robots.RAIL)
    file = str(tmp_path / "robot.yaml")
    assert run(["robot", "show", file]) == 0
    said = capsys.readouterr().out
    assert "joint left_slide slides; inverse kinematics: numeric" in said
    assert "1500 mm" in said
    assert run(["robot", "show", file, "--json"]) == 0
    joints = json.loads(capsys.readouterr().out)["joints"]
    assert joints["left_slide"]["slides"] is True
    assert joints["left_slide"]["upper"] == 1.5
    assert joints["left_1"]["slides"] is False


def _judged(
    seed: int, folder: Path, random_valid_jobs: ModuleType, sliding_robots: ModuleType
) -> int:
    """Plans a random job for arms on slides, on a lift or a waist; returns the exit code."""
    random = np.random.default_rng([seed, 4])
    axis = " ".join(str(v) for v in np.eye(3)[seed % 3])
    own = sliding_robots.Slide(
        axis, -round(random.uniform(0.1, 1.0), 3), round(random.uniform(0.1, 6.0), 3)
    )
    platform = {"waist": None} if seed % 2 else {"lift": sliding_robots.LIFT}
    sliding_robots.write_robot(folder, platform, joints=6 + seed // 2 % 2, own=own)
    bench = random_valid_jobs.Bench(
        "robot.yaml",
        ((0.40, 0.12, 0.62), (0.60, 0.45, 0.85)),
        ((0.45, -0.1, 0.65), (0.6, 0.1, 0.85)),
        changes=True,
        seams=True,
    )
    # Every fifth seed: those in a row differ in the kind of work.
    what = random_valid_jobs.write_random_job(5 * seed, folder, bench)
    tasks, out = str(folder / "tasks.yaml"), str(folder / "plan")
    code = run(["plan", tasks, "--out", out, "--effort", "quick", "--quiet"])
    if code == 0:
        assert run(["verify", out, "--tasks", tasks, "--quiet"]) == 0, what
    return code


@pytest.mark.parametrize("seed", [5, 9])
def test_a_random_job_of_arms_on_slides_is_verified(
    seed, tmp_path, random_valid_jobs, sliding_robots
):
    """Exit 0 for a hand-over and a seam that are known to have a plan."""
    assert _judged(seed, tmp_path, random_valid_jobs, sliding_robots) == 0


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(40))
def test_no_random_job_of_arms_on_slides_crashes(seed, tmp_path, random_valid_jobs, sliding_robots):
    """Exit 0 or 3: a valid file is never refused as input, and no plan is unsound."""
    assert _judged(seed, tmp_path, random_valid_jobs, sliding_robots) in (0, 3)
