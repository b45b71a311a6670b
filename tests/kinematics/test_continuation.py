"""Continuation along lines, self-motion and branches of general arms."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.continuation import (
    FlangeLines,
    moved_along,
    spare_directions,
)
from dualarm_cli.kinematics.general_arm import GeneralArm
from dualarm_cli.kinematics.parallel_arm import ParallelArm
from dualarm_cli.kinematics.self_motion import CURVE_STEP, branches, self_motions
from dualarm_cli.kinematics.serial_chain import pose_error
from dualarm_cli.kinematics.srs.srs_limits import wrap
from dualarm_cli.kinematics.wrist_arm import WristArm


def arm_of(general_robots, name, side="left"):
    """One arm in its root's frame."""
    robot = general_robots.ROBOTS[name]
    model = pin.buildModelFromXML(robot.urdf)
    joints = [f"{side}_j{k}" for k in range(1, len(robot.home[side]) + 1)]
    columns = [model.idx_qs[model.getJointId(joint)] for joint in joints]
    limits = model.lowerPositionLimit[columns], model.upperPositionLimit[columns]
    return GeneralArm.from_model(model, joints, f"{side}_flange", pin.SE3.Identity(), limits)


def random_lines(arm, count, length):
    """Random postures, their poses, and shifts of a length in random directions."""
    rng = np.random.default_rng(9)
    q = rng.uniform(np.maximum(arm.lower, -2), np.minimum(arm.upper, 2), (count, arm.axes))
    R, p = arm.forward(q)
    shift = rng.normal(size=(count, 3))
    return q, R, p, length * shift / np.linalg.norm(shift, axis=1, keepdims=True)


@pytest.mark.parametrize("name", ["yumi", "nextage", "spherical"])
@pytest.mark.parametrize("samples", [7, 65])
def test_every_sample_is_on_its_line_and_no_joint_jumps(general_robots, name, samples):
    """Exact poses to 1e-9; limits; and the steps are those of a smooth curve."""
    arm = arm_of(general_robots, name)
    q, R, p, shift = random_lines(arm, 60, 0.06)
    course = arm.follow_lines(q, FlangeLines(R, p, shift), np.full(60, 0.1), samples)
    assert 10 < course.ok.sum() < 60
    for k, share in enumerate(np.linspace(0.0, 1.0, samples)):
        found = course.q[k, course.ok]
        R_found, p_found = arm.forward(found)
        wanted = (p + share * shift)[course.ok]
        assert np.abs(pose_error(R_found, p_found, R[course.ok], wanted)).max() < 1e-9
        assert arm.within_limits(found).all()
    steps = np.abs(np.diff(course.q[:, course.ok], axis=0)).max(axis=2)
    assert (steps.max(axis=0) < 0.7).all()


def test_a_line_is_the_same_however_finely_it_is_sampled(general_robots):
    """7, 13 and 97 samples: what they have in common is equal to 1e-9 rad, self-motion included."""
    arm = arm_of(general_robots, "yumi")
    q, R, p, shift = random_lines(arm, 60, 0.06)
    courses = [
        arm.follow_lines(q, FlangeLines(R, p, shift), np.full(60, 0.2), n) for n in (7, 13, 97)
    ]
    ok = np.logical_and.reduce([course.ok for course in courses])
    assert ok.sum() > 10
    coarse, middle, fine = (course.q[:, ok] for course in courses)
    assert np.abs(coarse - middle[::2]).max() < 1e-9
    assert np.abs(coarse - fine[::16]).max() < 1e-9


def test_the_drift_is_the_way_along_the_self_motion(general_robots):
    """Against scipy's null space of the Jacobian at the start."""
    from scipy.linalg import null_space

    arm = arm_of(general_robots, "yumi")
    q, R, p, shift = random_lines(arm, 30, 0.04)
    course = arm.follow_lines(q, FlangeLines(R, p, shift), np.full(30, 0.15), 17)
    assert course.ok.sum() > 5
    for k in np.flatnonzero(course.ok):
        direction = null_space(arm.jacobian(q[k]))[:, 0]
        direction *= np.sign(direction[np.abs(direction).argmax()])
        assert direction @ (course.q[-1, k] - q[k]) == pytest.approx(0.15, abs=1e-8)
        assert spare_directions(arm, q[[k]])[0, 0] == pytest.approx(direction, abs=1e-9)


def in_plane(q2, q3, pitch=0.0, aside=0.0):
    """The arm `spherical` in its plane with a tool that is level but for its pitch; joint 4 turned aside."""
    return np.array([0.0, q2, q3, aside, pitch - (q2 + q3), 0.0])


def two_forms(general_robots):
    """The arm `spherical` by Newton's method and with closed forms."""
    arm = arm_of(general_robots, "spherical")
    return {"newton": arm, "closed": WristArm.of(arm)}


def line_between(arm, start, end):
    """The flange's line from one posture to where another one is."""
    R, p = arm.forward(start)
    return FlangeLines(R[None], p[None], (arm.forward(end)[1] - p)[None])


THROUGH = {
    "wrist": (in_plane(-0.6, 1.0), in_plane(-0.8, 0.6)),
    "shoulder": (in_plane(-1.0, -0.9, -1.0), in_plane(-1.35, -0.9, -1.0)),
}
"""Both ends of lines in the arm's plane: on one joint 5 passes 0, on the other the wrist passes above joint 1."""


@pytest.mark.parametrize("samples", [3, 7, 33, 65])
@pytest.mark.parametrize("form", ["newton", "closed"])
@pytest.mark.parametrize("where", ["wrist", "shoulder"])
def test_a_line_straight_through_a_singularity_is_followed(general_robots, where, form, samples):
    """All of it is in the arm's plane, so that joints 1, 4 and 6 stay 0: there is no reason to stop."""
    arm = two_forms(general_robots)[form]
    start, end = THROUGH[where]
    line = line_between(arm, start, end)
    course = arm.follow_lines(start[None], line, np.zeros(1), samples)
    assert course.ok[0]
    path = course.q[:, 0]
    assert np.abs(path[:, [0, 3, 5]]).max() < 1e-6
    R, p = arm.forward(path)
    wanted = line.p + np.linspace(0.0, 1.0, samples)[:, None] * line.shift
    assert np.abs(pose_error(R, p, line.R, wanted)).max() < 1e-6
    beyond = np.cos(path[:, 1]) + np.cos(path[:, 1] + path[:, 2])
    crossed = path[:, 4] if where == "wrist" else beyond
    assert crossed[0] * crossed[-1] < 0.0


@pytest.mark.parametrize("form", ["newton", "closed"])
@pytest.mark.parametrize("aside", [1e-2, 1e-3, 1e-4, 1e-5])
def test_a_line_beside_a_singularity_is_dropped(general_robots, form, aside):
    """The tool passes axis 4 at an angle of 0.39 times that of joint 4: this has to turn by half a turn within that."""
    arm = two_forms(general_robots)[form]
    start, end = in_plane(-0.6, 1.0, 0.0, aside), in_plane(-0.8, 0.6)
    for samples in (3, 7, 33):
        course = arm.follow_lines(start[None], line_between(arm, start, end), np.zeros(1), samples)
        assert not course.ok[0]


def test_a_ur_turns_its_level_tool_through_its_singularity(wrist_arms):
    """With axis 5 upright joint 5 only undoes joint 1: it passes 0, where axes 4 and 6 are one, and nothing else."""
    arm = ParallelArm.of(wrist_arms.dh_arm(wrist_arms.UR5).arm)
    start = np.array([0.3, -1.2, 1.9, -0.7, -0.1, 0.4])
    end = start + np.array([0.2, 0.0, 0.0, 0.0, 0.2, 0.0])
    assert np.abs(arm.forward(end)[0] - arm.forward(start)[0]).max() < 1e-9
    course = arm.follow_lines(start[None], line_between(arm, start, end), np.zeros(1), 33)
    assert course.ok[0]
    assert course.q[-1, 0] == pytest.approx(end, abs=1e-6)
    assert course.q[0, 0, 4] * course.q[-1, 0, 4] < 0.0


def test_a_line_that_leaves_limits_or_reach_is_dropped(general_robots):
    """The stretched arm has nowhere to go ahead; and a joint that may not move holds its line back."""
    arm = arm_of(general_robots, "spherical")
    start = np.array([0.0, -0.6, 1.2, 0.0, -0.5, 0.0])
    R, p = arm.forward(start)
    up = np.array([[0.0, 0.0, 0.1]])
    assert arm.follow_lines(start[None], FlangeLines(R[None], p[None], up), np.zeros(1), 33).ok[0]
    ahead = np.array([[0.5, 0.0, 0.0]])
    assert not arm.follow_lines(
        start[None], FlangeLines(R[None], p[None], ahead), np.zeros(1), 33
    ).ok[0]
    lower = np.array(arm.lower)
    lower[1] = -0.61
    tight = GeneralArm(
        arm.R_parent_joint,
        arm.p_parent_joint,
        arm.R_last_flange,
        arm.p_last_flange,
        lower,
        arm.upper,
    )
    assert not tight.follow_lines(
        start[None], FlangeLines(R[None], p[None], up), np.zeros(1), 33
    ).ok[0]


def test_neighbours_along_the_self_motion_keep_the_pose(general_robots):
    """And are as far away as asked."""
    arm = arm_of(general_robots, "yumi")
    q, R, p, _ = random_lines(arm, 40, 0.0)
    found, met = moved_along(arm, q, R, p, np.full(40, -0.2))
    assert met.sum() > 20
    R_found, p_found = arm.forward(found[met])
    assert np.abs(pose_error(R_found, p_found, R[met], p[met])).max() < 1e-9
    along = (spare_directions(arm, q)[:, 0] * (found - q)).sum(axis=1)
    assert np.allclose(along[met], -0.2, atol=1e-8)


@pytest.fixture(scope="module")
def srs_arms(tasks_folder):
    """The left arm of the SDA10F in closed form, and as a general arm."""
    cell = load_job(tasks_folder / "01_first_pick" / "tasks.yaml").cell
    return (
        CellModel.from_cell(cell).arms["left"].kinematics,
        CellModel.from_cell(cell, numeric=True).arms["left"].kinematics,
    )


def test_self_motion_of_an_srs_arm_is_the_closed_form_over_the_arm_angle(srs_arms):
    """Every sample is the closed form of its own arm angle and branch."""
    closed, arm = srs_arms
    q = np.random.default_rng(5).uniform(
        np.maximum(arm.lower, -2), np.minimum(arm.upper, 2), (6, 7)
    )
    R, p = arm.forward(q)
    curves = self_motions(arm, q, R, p)
    assert np.array_equal(curves[len(curves) // 2], q)
    for k in range(len(q)):
        curve = curves[:, k][~np.isnan(curves[:, k, 0])]
        assert len(curve) > 5
        again, _ = closed.solve_branch(R[k], p[k], closed.arm_angle(curve), closed.branch(curve))
        assert np.abs(wrap(again - curve)).max() < 1e-7
        steps = np.linalg.norm(np.diff(curve, axis=0), axis=1)
        assert (steps > 0.9 * CURVE_STEP).all()
        assert (steps < 1.6 * CURVE_STEP).all()


def test_branches_of_an_srs_arm_do_not_mix_closed_form_branches(srs_arms):
    """Self-motion keeps the sides of elbow, shoulder and wrist; all eight and more pieces are told apart."""
    closed, arm = srs_arms
    q = np.random.default_rng(7).uniform(
        np.maximum(arm.lower, -2), np.minimum(arm.upper, 2), (8, 7)
    )
    R, p = arm.forward(q)
    found = arm.postures(R, p)
    curves = self_motions(arm, found.q, R[found.pose], p[found.pose])
    branch = branches(arm, found.pose, found.q, curves)
    shared = 0
    for pose in range(len(p)):
        for number in np.unique(branch[found.pose == pose]):
            some = found.q[(found.pose == pose) & (branch == number)]
            assert len(np.unique(closed.branch(some))) == 1
            shared += len(some) > 1
    assert shared > 5
