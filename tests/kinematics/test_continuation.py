"""Continuation along lines, self-motion and branches of general arms."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.continuation import (
    FlangeLines,
    follow_lines,
    moved_along,
    spare_directions,
)
from dualarm_cli.kinematics.general_arm import GeneralArm, pose_error
from dualarm_cli.kinematics.numeric_inverse import solve_poses
from dualarm_cli.kinematics.self_motion import CURVE_STEP, branches, self_motions
from dualarm_cli.kinematics.srs.srs_limits import wrap


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
    course = follow_lines(arm, q, FlangeLines(R, p, shift), np.full(60, 0.1), samples)
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
        follow_lines(arm, q, FlangeLines(R, p, shift), np.full(60, 0.2), n) for n in (7, 13, 97)
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
    course = follow_lines(arm, q, FlangeLines(R, p, shift), np.full(30, 0.15), 17)
    assert course.ok.sum() > 5
    for k in np.flatnonzero(course.ok):
        direction = null_space(arm.jacobian(q[k]))[:, 0]
        direction *= np.sign(direction[np.abs(direction).argmax()])
        assert direction @ (course.q[-1, k] - q[k]) == pytest.approx(0.15, abs=1e-8)
        assert spare_directions(arm, q[[k]])[0, 0] == pytest.approx(direction, abs=1e-9)


def test_a_line_through_a_straight_wrist_is_dropped(general_robots):
    """Joint 5 passes zero, where axes 4 and 6 are one; up to just before the line can be followed.

    The forearm pitches from +0.4 to -0.2 rad while the tool stays level.
    """
    arm = arm_of(general_robots, "spherical")

    def level(q2, q3):
        return np.array([0.0, q2, q3, 0.0, -(q2 + q3), 0.0])

    start, before, after = level(-0.6, 1.0), level(-0.7, 0.9), level(-0.8, 0.6)
    R, p = arm.forward(start)
    for end, passes in ((before, True), (after, False)):
        shift = arm.forward(end)[1] - p
        course = follow_lines(
            arm, start[None], FlangeLines(R[None], p[None], shift[None]), np.zeros(1), 33
        )
        assert course.ok[0] == passes


def test_a_line_that_leaves_limits_or_reach_is_dropped(general_robots):
    """The stretched arm has nowhere to go ahead; and a joint that may not move holds its line back."""
    arm = arm_of(general_robots, "spherical")
    start = np.array([0.0, -0.6, 1.2, 0.0, -0.5, 0.0])
    R, p = arm.forward(start)
    up = np.array([[0.0, 0.0, 0.1]])
    assert follow_lines(arm, start[None], FlangeLines(R[None], p[None], up), np.zeros(1), 33).ok[0]
    ahead = np.array([[0.5, 0.0, 0.0]])
    assert not follow_lines(
        arm, start[None], FlangeLines(R[None], p[None], ahead), np.zeros(1), 33
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
    assert not follow_lines(
        tight, start[None], FlangeLines(R[None], p[None], up), np.zeros(1), 33
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
    found = solve_poses(arm, R, p)
    curves = self_motions(arm, found.q, R[found.pose], p[found.pose])
    branch = branches(arm, found.pose, found.q, curves)
    shared = 0
    for pose in range(len(p)):
        for number in np.unique(branch[found.pose == pose]):
            some = found.q[(found.pose == pose) & (branch == number)]
            assert len(np.unique(closed.branch(some))) == 1
            shared += len(some) > 1
    assert shared > 5
