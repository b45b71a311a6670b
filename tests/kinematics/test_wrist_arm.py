"""Closed forms of six-axis arms with a spherical wrist: pinocchio, the numeric inverse, and hand arithmetic."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.errors import UnsupportedError
from dualarm_cli.kinematics.closed_arm import with_closed_forms
from dualarm_cli.kinematics.general_arm import GeneralArm
from dualarm_cli.kinematics.serial_chain import pose_error
from dualarm_cli.kinematics.srs.srs_limits import wrap
from dualarm_cli.kinematics.wrist_arm import WristArm

KINDS = ("elbow", "elbow_meeting", "meeting", "parallel", "any")


@pytest.fixture(scope="module")
def heavy(wrist_arms) -> WristArm:
    """Links of 1.2 and 1.05 m, the shoulder 0.35 m in front of axis 1 and 0.335 m high; limits of one turn."""
    return WristArm.of(wrist_arms.dh_arm(wrist_arms.HEAVY).arm)


def away(found: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Largest difference of joints, whole turns apart [rad]."""
    return np.abs(wrap(found - q)).max(axis=-1)


def errors(arm: GeneralArm, found, R: np.ndarray, p: np.ndarray) -> np.ndarray:
    """What reachable branches miss their poses by."""
    assert np.isfinite(found.q).all()
    R_now, p_now = arm.forward(found.q)
    error = np.abs(pose_error(R_now, p_now, R[..., None, :, :], p[..., None, :])).max(axis=-1)
    return error[found.reachable]


@pytest.mark.parametrize("orthogonal", [True, False])
@pytest.mark.parametrize("kind", KINDS)
def test_every_posture_is_among_the_solutions_of_its_pose(wrist_arms, kind, orthogonal):
    """Twelve random arms in space, 150 postures each: all solutions meet the pose by pinocchio's arithmetic."""
    rng = np.random.default_rng(17)
    several, served = 0, 0
    for _ in range(12):
        built = wrist_arms.random_arm(kind, rng, orthogonal)
        arm = with_closed_forms(WristArm, built.arm)
        if not isinstance(arm, WristArm):
            # Axes 1 and 2 of a random arm may nearly meet.
            assert kind == "any"
            continue
        served += 1
        assert arm.shoulder.family == wrist_arms.FAMILY[kind]
        q = rng.uniform(-np.pi, np.pi, (150, 6))
        R, p = built.forward(q)
        found = arm.solve(R, p)
        distance = np.where(found.reachable, away(found.q, q[:, None]), np.inf)
        assert distance.min(axis=1).max() < 1e-6
        assert (arm.branch(q) == distance.argmin(axis=1)).all()
        pose, branch = np.nonzero(found.reachable)
        R_now, p_now = built.forward(found.q[pose, branch])
        assert np.abs(pose_error(R_now, p_now, R[pose], p[pose])).max() < 1e-10
        for one in range(8):
            for other in range(one):
                both = found.reachable[:, one] & found.reachable[:, other]
                apart = away(found.q[both, one], found.q[both, other])
                assert (apart > 1e-6).all()
        several += int((found.reachable.sum(axis=1) == 8).sum())
    assert served >= 10
    assert several > 20


def test_branches_are_shoulder_elbow_and_wrist(heavy):
    """Told by where elbow and wrist centre are and by the sign of joint 5, without any inverse kinematics."""
    q = np.random.default_rng(3).uniform(-np.pi, np.pi, (500, 6))
    R, p = heavy.forward(q)
    found = heavy.solve(R, p)
    joints = found.q[found.reachable]
    branch = np.nonzero(found.reachable)[1]
    c1, s1 = np.cos(joints[:, 0]), np.sin(joints[:, 0])
    forward = np.stack([c1, s1, np.zeros_like(c1)], axis=1)
    # alpha1 = -90 deg: joint 2 turns from x1 downwards.
    down = np.array([0.0, 0.0, -1.0])
    upper = forward * np.cos(joints[:, 1:2]) + down * np.sin(joints[:, 1:2])
    shoulder = 0.35 * forward + np.array([0.0, 0.0, 0.335])
    elbow = shoulder + 1.2 * upper
    wrist = heavy.wrist_center(*heavy.forward(joints))
    assert np.linalg.norm(wrist - elbow, axis=1) == pytest.approx(1.05)
    behind = (wrist * forward).sum(axis=1) < 0.0
    axis2 = np.stack([-s1, c1, np.zeros_like(c1)], axis=1)
    clockwise = (np.cross(elbow - shoulder, wrist - elbow) * axis2).sum(axis=1) < 0.0
    assert (branch == 4 * behind + 2 * clockwise + (joints[:, 4] < 0.0)).all()
    assert set(branch.tolist()) == set(range(8))
    assert (heavy.branch(joints) == branch).all()


def test_front_is_axis_2_times_axis_1_where_they_meet(wrist_arms):
    """Axis 1 up, axis 2 to the left (y): in front is x, as long as joint 1 is at 0."""
    axes = np.array([[0, 0, 1], [0, 1, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0.0]])
    points = np.array([[0, 0, 0.4]] * 2 + [[0.4, 0, 0.4]] + [[0.8, 0, 0.4]] * 3)
    arm = WristArm.of(wrist_arms.build(axes, points, pin.SE3(np.eye(3), points[5])).arm)
    q = np.random.default_rng(1).uniform(-3.0, 3.0, (100, 6))
    q[:, 0] = 0.0
    x = arm.wrist_center(*arm.forward(q))[:, 0]
    assert (arm.branch(q) >= 4).tolist() == (x < 0.0).tolist()
    assert 10 < (x < 0.0).sum() < 90


def test_front_is_where_the_shoulder_stands_off_axis_1(wrist_arms):
    """The shoulder 0.35 m behind axis 1: the wrist centre there, away from x1, is shoulder 0."""
    rows = wrist_arms.HEAVY.copy()
    rows[0, 0] = -0.35
    arm = WristArm.of(wrist_arms.dh_arm(rows).arm)
    q = np.random.default_rng(2).uniform(-3.0, 3.0, (100, 6))
    center = arm.wrist_center(*arm.forward(q))
    x = center[:, 0] * np.cos(q[:, 0]) + center[:, 1] * np.sin(q[:, 0])
    assert (arm.branch(q) >= 4).tolist() == (x > 0.0).tolist()
    assert 10 < (x > 0.0).sum() < 90


def test_of_any_axes_the_shoulder_is_the_sign_of_the_determinant(wrist_arms):
    """Joints 1 to 3 carry the wrist centre with Jacobians of one sign in branches 0 to 3, of the other in 4 to 7."""
    rng = np.random.default_rng(23)
    for _ in range(5):
        arm = WristArm.of(wrist_arms.random_arm("any", rng, orthogonal=True).arm)
        R, p = arm.forward(rng.uniform(-np.pi, np.pi, (100, 6)))
        found = arm.solve(R, p)
        branch, q = np.nonzero(found.reachable)[1], found.q[found.reachable]
        _, flange, J = arm.linearised(q)
        to_wrist = arm.wrist_center(*arm.forward(q)) - flange
        linear = J[:, :3, :3] + np.cross(J[:, 3:, :3], to_wrist[:, :, None], axis=1)
        sign = np.sign(np.linalg.det(linear))
        assert len(set(zip(sign.tolist(), (branch >= 4).tolist(), strict=True))) == 2
        assert 0.3 < (branch >= 4).mean() < 0.7


def test_the_wrist_centre_on_axis_2_leaves_joint_2_at_its_reference(wrist_arms):
    """Links of 1.05 m both, folded: the wrist centre is the shoulder, 0.35 m ahead and 0.335 m high."""
    rows = wrist_arms.HEAVY.copy()
    rows[1, 0] = 1.05
    arm = WristArm.of(wrist_arms.dh_arm(rows).arm)
    R, p = at_wrist(arm, (0.35, 0.0, 0.335))
    found = arm.solve(R, p, np.array([0, 0.6, 0, 0, 0, 0]))
    front = np.arange(4)
    assert found.singular[front].all()
    assert found.q[front, 1] == pytest.approx(np.full(4, 0.6))
    assert errors(arm, found, R, p).max() < 1e-10


def test_the_dh_arm_meets_the_products_of_its_rows(heavy, wrist_arms):
    """Eight postures of a pose in the middle of the reach, each against the product of six DH matrices."""
    T = pin.SE3(pin.exp3(np.array([0.2, 2.5, 0.3])), np.array([0.9, 0.3, 0.4]))
    found = heavy.solve(T.rotation, T.translation)
    assert found.q.shape == (8, 6)
    assert found.reachable.all()
    for q in found.q:
        now = wrist_arms.dh_pose(wrist_arms.HEAVY, q)
        assert np.abs(now.homogeneous - T.homogeneous).max() < 1e-12


@pytest.mark.parametrize("kind", ["elbow", "meeting", "any"])
def test_the_numeric_inverse_finds_the_same_postures(wrist_arms, kind):
    """20 poses of a random arm: the same sets, limits of one turn."""
    rng = np.random.default_rng(5)
    general = wrist_arms.random_arm(kind, rng, orthogonal=True).arm
    arm = WristArm.of(general)
    R, p = general.forward(rng.uniform(-3.0, 3.0, (20, 6)))
    ours, theirs = arm.postures(R, p), general.postures(R, p)
    for k in range(20):
        a, b = ours.q[ours.pose == k], theirs.q[theirs.pose == k]
        assert len(a) == len(b) >= 2
        assert away(a[:, None], b[None]).min(axis=1).max() < 1e-6


def test_axes_4_and_6_in_line_leave_joint_4_at_its_reference(heavy):
    """Joint 5 at 0, or 1e-13 from it: joint 4 is the reference's, joint 6 has the rest of the turn."""
    q = np.random.default_rng(6).uniform(-1.2, 1.2, (50, 6))
    q[:, 4] = np.where(np.arange(50) % 2, 0.0, 1e-13)
    R, p = heavy.forward(q)
    reference = np.full(6, 0.7)
    found = heavy.solve(R, p, reference)
    assert errors(heavy, found, R, p).max() < 1e-10
    own = heavy.branch(q)
    assert found.singular[np.arange(50), own].all()
    mine = found.q[np.arange(50), own]
    assert mine[:, 3] == pytest.approx(np.full(50, 0.7))
    assert wrap(mine[:, 3] + mine[:, 5] - q[:, 3] - q[:, 5]) == pytest.approx(
        np.zeros(50), abs=1e-9
    )


def test_the_wrist_centre_on_axis_1_leaves_joint_1_at_its_reference(heavy):
    """0.35 + 1.2 cos q2 + 1.05 cos = 0 by hand: upper arm straight up, forearm back by asin(0.35/1.05).

    With q2 = -90 deg the elbow is 1.2 m above the shoulder; the forearm is turned by q2 + q3 + 90 deg = q3 from x1
    downwards, of which the cosine is to be -1/3.
    """
    q = np.array([0.4, -np.pi / 2, np.arccos(-1.0 / 3.0), 0.3, 0.8, -0.2])
    R, p = heavy.forward(q)
    assert np.hypot(*heavy.wrist_center(R, p)[:2]) < 1e-12
    found = heavy.solve(R, p, np.array([-0.9, 0, 0, 0, 0, 0]))
    assert found.singular.any()
    assert errors(heavy, found, R, p).max() < 1e-10
    assert found.q[found.singular][:, 0] == pytest.approx(np.full(found.singular.sum(), -0.9))


def test_a_stretched_and_a_folded_elbow_have_finite_postures(heavy):
    """Joint 3 at -90 deg stretches the arm, at 90 deg folds it; the two elbows coincide."""
    rng = np.random.default_rng(8)
    for q3 in (-np.pi / 2, np.pi / 2):
        q = rng.uniform(-1.0, 1.0, (50, 6))
        q[:, 2] = q3
        R, p = heavy.forward(q)
        found = heavy.solve(R, p)
        assert errors(heavy, found, R, p).max() < 1e-10
        distance = np.where(found.reachable, away(found.q, q[:, None]), np.inf)
        assert found.reachable.any(axis=1).all()
        assert distance.min(axis=1).max() < 1e-5


def with_gap(arm: GeneralArm, gap: float) -> GeneralArm:
    """The same arm with axis 6 moved across axes 5 and 6 [m]."""
    p = np.array(arm.p_parent_joint)
    p[5] += gap * np.cross([0.0, 0.0, 1.0], arm.R_parent_joint[5][:, 2])
    return replace(arm, p_parent_joint=p)


def at_wrist(arm: WristArm, center) -> tuple[np.ndarray, np.ndarray]:
    """The flange pose of some rotation whose wrist centre is there."""
    R = pin.exp3(np.array([0.3, -0.4, 0.5]))
    return R, np.asarray(center) - arm.wrist_center(R, np.zeros(3))


@pytest.mark.parametrize(
    ("center", "miss", "shoulders"),
    [
        # Stretched: 0.35 + 1.2 + 1.05 = 2.6 m from axis 1 at the height of the shoulder.
        ((3.6, 0.0, 0.335), 1.0, ()),
        ((0.0, -2.9, 0.335), 0.3, ()),
        # Above the shoulder: 0.335 + 2.25 = 2.585 m.
        ((0.35, 0.0, 3.085), 0.5, ()),
        # In the hole of 0.15 m about the shoulder, but the arm turned round reaches it overhead.
        ((0.35, 0.0, 0.335), 0.0, (1,)),
        ((0.9, 0.2, 0.5), 0.0, (0, 1)),
        # Turned round it stands at -0.35 m and reaches 1.9 m.
        ((0.0, 2.2, 0.335), 0.0, (0,)),
    ],
)
def test_what_is_out_of_reach_is_missed_by_what_arithmetic_says(heavy, center, miss, shoulders):
    """Distances of the wrist centre from the ring that the two links reach."""
    R, p = at_wrist(heavy, center)
    assert heavy.reach_miss(R, p) == pytest.approx(miss, abs=1e-9)
    reachable = heavy.solve(R, p).reachable.reshape(2, 4).any(axis=1)
    assert np.flatnonzero(reachable).tolist() == list(shoulders)


def test_a_shoulder_beside_axis_1_leaves_a_hole_along_it(wrist_arms):
    """Shoulder offset 0.2 m along axis 2: on axis 1, at any height within the links' reach, 0.2 m are missing."""
    rows = wrist_arms.HEAVY.copy()
    rows[0, 0], rows[1, 2] = 0.0, 0.2
    arm = WristArm.of(wrist_arms.dh_arm(rows).arm)
    assert arm.reach_miss(*at_wrist(arm, (0.0, 0.0, 1.2))) == pytest.approx(0.2, abs=1e-9)
    assert arm.reach_miss(*at_wrist(arm, (0.15, 0.0, 1.2))) == pytest.approx(0.05, abs=1e-9)
    assert arm.reach_miss(*at_wrist(arm, (0.25, 0.0, 1.2))) == 0.0


def test_limits_of_the_elbow_shorten_the_reach(heavy):
    """Bent by a right angle at least: sqrt(1.2² + 1.05²) = 1.5945 m from the shoulder instead of 2.25 m."""
    lower, upper = np.array(heavy.lower), np.array(heavy.upper)
    lower[2], upper[2] = 0.0, 1.0
    tight = replace(heavy, lower=lower, upper=upper)
    R, p = at_wrist(heavy, (0.35 + 2.0, 0.0, 0.335))
    assert tight.reach_miss(R, p) == pytest.approx(2.0 - np.hypot(1.2, 1.05), abs=1e-9)
    assert heavy.reach_miss(R, p) == 0.0


def test_postures_are_those_within_limits_on_their_turns(heavy):
    """Joint 1 from 90 to 450 deg, joint 6 +-20 deg: as many as a loop over turns lets through, the rest is missed."""
    lower, upper = np.array(heavy.lower), np.array(heavy.upper)
    lower[0], upper[0] = 0.5 * np.pi, 2.5 * np.pi
    lower[5], upper[5] = -0.35, 0.35
    arm = replace(heavy, lower=lower, upper=upper)
    R, p = heavy.forward(np.random.default_rng(9).uniform(-np.pi, np.pi, (100, 6)))
    every = arm.solve(R, p)
    found = arm.postures(R, p)
    expected = 0
    for pose in range(100):
        for branch in range(8):
            q = every.q[pose, branch]
            turns = [q + 2 * np.pi * np.array([k, 0, 0, 0, 0, 0]) for k in (0, 1)]
            expected += every.reachable[pose, branch] and any(arm.within_limits(t) for t in turns)
    assert len(found.q) == expected > 20
    assert arm.within_limits(found.q).all()
    assert (arm.branch(found.q) == found.branch).all()
    solved = np.isin(np.arange(100), found.pose)
    assert (found.miss[solved] == 0.0).all()
    assert (found.miss[~solved].max(axis=1) > 0.0).all()


def test_a_pose_in_reach_without_a_posture_within_limits_is_missed_by_turned_joints(heavy):
    """Joint 6 is 0.1 rad beyond its limit in each branch that its limits leave: the flange is turned by 0.1 rad."""
    q = np.array([0.3, -0.8, 0.4, 0.2, 0.9, 0.5])
    R, p = heavy.forward(q)
    tight = replace(heavy, lower=q - 0.1, upper=np.append(q[:5] + 0.1, 0.4))
    found = tight.postures(R[None], p[None])
    assert not len(found.q)
    # The flange lies on axis 6 of these rows.
    assert found.miss[0] == pytest.approx([0.0, 0.1], abs=1e-9)


def test_where_axes_4_and_6_are_in_line_many_postures_stand_for_all(heavy):
    """Distinct ones, each of which meets the pose within limits."""
    q = np.array([[0.3, -0.8, 0.4, 0.2, 0.0, 0.5]])
    R, p = heavy.forward(q)
    found = heavy.postures(R, p)
    R_now, p_now = heavy.forward(found.q)
    assert np.abs(pose_error(R_now, p_now, R, p)).max() < 1e-10
    assert len(np.unique(found.q[:, 3].round(6))) >= 8


def test_a_wrist_that_is_rounded_in_its_file_is_polished(wrist_arms):
    """0.3 um between axes 5 and 6: errors of 1e-7 without polish, below 1e-10 with it."""
    built = wrist_arms.dh_arm(wrist_arms.HEAVY)
    arm = WristArm.of(with_gap(built.arm, 3e-7))
    assert 5e-8 < arm.wrist_gap < 3e-7
    q = np.random.default_rng(12).uniform(-np.pi, np.pi, (300, 6))
    R, p = arm.forward(q)
    found = arm.solve(R, p)
    assert errors(arm, found, R, p).max() < 1e-10
    distance = np.where(found.reachable, away(found.q, q[:, None]), np.inf).min(axis=1)
    assert (distance < 1e-6).mean() > 0.97


def test_arms_without_closed_forms_say_why(wrist_arms):
    """A wrist that misses its point, parallel wrist axes, three parallel axes; they stay general."""
    built = wrist_arms.dh_arm(wrist_arms.HEAVY).arm
    gap = with_gap(built, 1e-3)
    with pytest.raises(UnsupportedError, match=r"miss a common point by 0\.\d+ mm"):
        WristArm.of(gap)
    assert with_closed_forms(WristArm, gap) is gap
    rows = wrist_arms.HEAVY.copy()
    rows[4, 1] = 0.0
    with pytest.raises(UnsupportedError, match="axes 5 and 6 are parallel"):
        WristArm.of(wrist_arms.dh_arm(rows).arm)
    rows = wrist_arms.HEAVY.copy()
    rows[0, 1] = 0.0
    with pytest.raises(UnsupportedError, match="first three axes"):
        WristArm.of(wrist_arms.dh_arm(rows).arm)


def test_shapes_go_through_and_the_same_pose_has_the_same_postures_alone(heavy):
    """(4, 5) poses at once and one alone."""
    q = np.random.default_rng(13).uniform(-2.0, 2.0, (4, 5, 6))
    R, p = heavy.forward(q)
    found = heavy.solve(R, p)
    assert found.q.shape == (4, 5, 8, 6)
    alone = heavy.solve(R[2, 3], p[2, 3])
    assert np.array_equal(alone.q, found.q[2, 3])
    assert heavy.branch(q).shape == (4, 5)
    assert heavy.reach_miss(R, p).shape == (4, 5)
