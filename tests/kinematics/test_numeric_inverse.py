"""Numeric inverse kinematics: random reachable poses, branches against brute force, misses."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.kinematics.general_arm import GeneralArm
from dualarm_cli.kinematics.numeric_inverse import descend, least_distances
from dualarm_cli.kinematics.serial_chain import pose_error


def arm_of(general_robots, name, side="left"):
    """One arm in its root's frame."""
    robot = general_robots.ROBOTS[name]
    model = pin.buildModelFromXML(robot.urdf)
    joints = [f"{side}_j{k}" for k in range(1, len(robot.home[side]) + 1)]
    columns = [model.idx_qs[model.getJointId(joint)] for joint in joints]
    limits = model.lowerPositionLimit[columns], model.upperPositionLimit[columns]
    return GeneralArm.from_model(model, joints, f"{side}_flange", pin.SE3.Identity(), limits)


@pytest.mark.parametrize("name", ["yumi", "nextage"])
def test_random_reachable_poses_are_solved(general_robots, name):
    """At least 99.5 % of 400 poses of random postures within limits; every solution within 1e-9 and limits."""
    arm = arm_of(general_robots, name)
    q = np.random.default_rng(8).uniform(arm.lower, arm.upper, (400, arm.axes))
    R, p = arm.forward(q)
    found = arm.postures(R, p)
    assert len(np.unique(found.pose)) >= 398
    R_found, p_found = arm.forward(found.q)
    assert np.abs(pose_error(R_found, p_found, R[found.pose], p[found.pose])).max() < 1e-9
    assert arm.within_limits(found.q).all()
    solved = np.isin(np.arange(400), found.pose)
    assert (found.miss[solved] == 0.0).all()


def nearest(q, others):
    """How far each posture is from the nearest of others [rad], whole turns apart."""
    apart = np.angle(np.exp(1j * (q[:, None] - others[None])))
    return np.abs(apart).max(axis=2).min(axis=1)


@pytest.mark.parametrize("name", ["nextage", "spherical"])
def test_six_axes_have_all_branches_that_brute_force_finds(general_robots, name):
    """15 poses, each with 800 random starts of another kind than the Halton ones."""
    arm = arm_of(general_robots, name)
    rng = np.random.default_rng(4)
    R, p = arm.forward(rng.uniform(arm.lower, arm.upper, (15, 6)))
    found = arm.postures(R, p)
    several = 0
    for k in range(len(p)):
        starts = rng.uniform(arm.lower, arm.upper, (800, 6))
        q, error = descend(arm, R[[k] * 800], p[[k] * 800], starts)
        good = (error < 1e-10).all(axis=1) & arm.within_limits(q)
        ours = found.q[found.pose == k]
        assert nearest(q[good], ours).max() < 1e-6
        for i in range(len(ours)):
            others = np.delete(ours, i, axis=0)
            assert not len(others) or nearest(ours[[i]], others)[0] > 1e-5
        several += len(ours) > 1
    assert several >= 2


def test_a_flipped_spherical_wrist_is_found_with_its_twin(general_robots):
    """(q4 + pi, -q5, q6 + pi) reaches the same pose: it is there wherever limits allow it."""
    arm = arm_of(general_robots, "spherical")
    R, p = arm.forward(np.random.default_rng(6).uniform(arm.lower, arm.upper, (40, 6)))
    found = arm.postures(R, p)
    twins = found.q.copy()
    twins[:, [3, 5]] += np.pi
    twins[:, 4] *= -1.0
    twins = arm.nearest_turns(twins, arm.middle)
    allowed = np.flatnonzero(arm.within_limits(twins))
    assert len(allowed) > 40
    for k in allowed:
        assert nearest(twins[[k]], found.q[found.pose == found.pose[k]])[0] < 1e-6


def test_what_is_out_of_reach_is_missed_by_what_arithmetic_says(general_robots):
    """Links of 0.4 and 0.4 m, the wrist wanted 1 m straight ahead of the shoulder: 0.2 m are missing.

    The shoulder is at (0, 0.3, 0.4), the flange 50 mm beyond the wrist and parallel to the stretched arm.
    """
    arm = arm_of(general_robots, "spherical")
    R, _ = arm.forward(np.zeros(6))
    p = np.array([1.05, 0.3, 0.4])
    assert not len(arm.postures(R[None], p[None]).q)
    assert least_distances(arm, R[None], p[None])[0] == pytest.approx(0.2, abs=2e-4)


def test_a_pose_has_the_same_solutions_alone_and_among_others(general_robots):
    """But for rounding: few postures are computed otherwise than many."""
    arm = arm_of(general_robots, "yumi")
    R, p = arm.forward(np.random.default_rng(2).uniform(arm.lower, arm.upper, (5, 7)))
    together = arm.postures(R, p)
    alone = arm.postures(R[3:4], p[3:4])
    assert np.allclose(together.q[together.pose == 3], alone.q, rtol=0.0, atol=1e-8)
