"""Closed forms of six axes, the second to fourth of them parallel: every branch, singularities, limits, misses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.errors import UnsupportedError
from dualarm_cli.geometry.joint_axes import measured_kind
from dualarm_cli.kinematics.closed_arm import with_closed_forms
from dualarm_cli.kinematics.numeric_inverse import least_distances
from dualarm_cli.kinematics.parallel_arm import ParallelArm
from dualarm_cli.kinematics.serial_chain import pose_error
from dualarm_cli.kinematics.srs.srs_limits import wrap

TURN = 2.0 * np.pi


@pytest.fixture(scope="module")
def ur5(wrist_arms) -> ParallelArm:
    """The UR5 of its maker's rows, joints of one turn."""
    return ParallelArm.of(wrist_arms.dh_arm(wrist_arms.UR5).arm)


def away(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The largest joint difference modulo a turn."""
    return np.abs(wrap(a - b)).max(axis=-1)


def errors(arm, q, R, p) -> float:
    """The largest error of poses (b, ...) at joints (b, 6)."""
    R_now, p_now = arm.forward(q)
    return float(np.abs(pose_error(R_now, p_now, R, p)).max())


@pytest.mark.parametrize("orthogonal", [True, False])
@pytest.mark.parametrize("meeting", [True, False])
def test_every_posture_is_among_the_solutions_of_its_pose(wrist_arms, meeting, orthogonal):
    """30 random arms, 40 postures of each by pinocchio: all branches reach the pose, one is the posture."""
    for seed in range(30):
        rng = np.random.default_rng([seed, meeting, orthogonal])
        built = wrist_arms.random_parallel_arm(rng, meeting, orthogonal)
        arm = ParallelArm.of(built.arm)
        q = rng.uniform(-np.pi, np.pi, (40, 6))
        R, p = built.forward(q)
        found = arm.solve(R, p)
        row, branch = np.nonzero(found.reachable)
        assert errors(arm, found.q[row, branch], R[row], p[row]) < 1e-9
        distance = np.where(found.reachable, away(found.q, q[:, None]), np.inf)
        assert distance.min(axis=1).max() < 1e-5
        assert (found.reachable.sum(axis=1) % 2 == 0).all()  # both elbows or none
        assert (arm.branch(q) == distance.argmin(axis=1)).all()


@pytest.mark.parametrize("meeting", [True, False])
def test_the_numeric_inverse_finds_the_same_postures(wrist_arms, meeting):
    """20 poses of each of three random arms: the same sets, limits of one turn."""
    for seed in range(3):
        rng = np.random.default_rng([seed, 7])
        general = wrist_arms.random_parallel_arm(rng, meeting, True).arm
        arm = ParallelArm.of(general)
        R, p = general.forward(rng.uniform(-3.0, 3.0, (20, 6)))
        ours, theirs = arm.postures(R, p), general.postures(R, p)
        for k in range(20):
            a, b = ours.q[ours.pose == k], theirs.q[theirs.pose == k]
            assert len(a) == len(b) >= 2
            assert away(a[:, None], b[None]).min(axis=1).max() < 1e-6


def test_the_ur5_meets_the_products_of_its_rows(ur5, wrist_arms):
    """Eight postures of a pose in the middle of the reach, each against the product of six DH matrices."""
    T = pin.SE3(pin.exp3(np.array([0.2, 2.9, 0.3])), np.array([0.35, 0.25, 0.2]))
    found = ur5.solve(T.rotation, T.translation)
    assert found.reachable.all()
    for q in found.q:
        now = wrist_arms.dh_pose(wrist_arms.UR5, q)
        assert np.abs(now.homogeneous - T.homogeneous).max() < 1e-12
    # Slots: shoulder, wrist, elbow; a shoulder has one joint 1, a wrist the opposite joint 5.
    by = found.q.reshape(2, 2, 2, 6)
    assert np.ptp(by[..., 0], axis=(1, 2)) == pytest.approx(np.zeros(2), abs=1e-12)
    assert by[:, 0, :, 4] == pytest.approx(-by[:, 1, :, 4])


def test_axes_4_and_6_in_line_leave_the_sum_of_joints_2_to_4_at_its_reference(ur5):
    """Joint 5 at 0, or 1e-13 from it; the posture itself is found where it is the reference."""
    q = np.random.default_rng(6).uniform(-1.2, 1.2, (50, 6))
    q[:, 4] = np.where(np.arange(50) % 2, 0.0, 1e-13)
    R, p = ur5.forward(q)
    found = ur5.solve(R, p, q)
    own = away(found.q, q[:, None]).argmin(axis=1)
    assert found.singular[np.arange(50), own].all()
    assert away(found.q[np.arange(50), own], q).max() < 1e-6
    row, branch = np.nonzero(found.reachable)
    assert errors(ur5, found.q[row, branch], R[row], p[row]) < 1e-9
    # Without a reference there are samples of the self-motion, which may be as short as one likes.
    free = ParallelArm.of(ur5.without_limits)
    every = free.postures(R, p)
    assert errors(ur5, every.q, R[every.pose], p[every.pose]) < 1e-9
    assert (np.bincount(every.pose, minlength=50) >= 2).all()


@pytest.mark.parametrize("q3", [0.0, np.pi])
def test_a_stretched_and_a_folded_elbow_have_finite_postures(ur5, q3):
    """The two elbows coincide."""
    q = np.random.default_rng(8).uniform(-1.0, 1.0, (50, 6))
    q[:, 2] = q3
    R, p = ur5.forward(q)
    found = ur5.solve(R, p)
    distance = np.where(found.reachable, away(found.q, q[:, None]), np.inf)
    assert distance.min(axis=1).max() < 1e-5
    row, branch = np.nonzero(found.reachable)
    assert errors(ur5, found.q[row, branch], R[row], p[row]) < 1e-9


def test_the_wrist_beside_axis_1_has_one_joint_1_and_nearer_there_is_none(ur5):
    """Axis 4 is 109.15 mm beside axis 1: so is the meeting point of axes 5 and 6, at least."""
    R = pin.exp3(np.array([np.pi, 0.0, 0.0]))  # axis 6 downwards
    above = np.array([0.0, 0.0, 0.0823 + 0.3])
    for distance, reached in ((0.10915, True), (0.1093, True), (0.109, False)):
        # The flange is 82.3 mm below the meeting point.
        p = np.array([distance, 0.0, 0.0]) + above - [0.0, 0.0, 2 * 0.0823]
        found = ur5.solve(R, p)
        assert found.reachable.any() == reached
    p = np.array([0.10915, 0.0, 0.0]) + above - [0.0, 0.0, 2 * 0.0823]
    found = ur5.solve(R, p)
    assert np.ptp(wrap(found.q[found.reachable][:, 0])) < 1e-5


def test_a_pose_out_of_reach_is_missed_by_what_it_is_beyond(ur5):
    """A stretched arm is 30 mm short along its links; descents with the same rotation mostly come hardly nearer."""
    q = np.random.default_rng(3).uniform(-1.0, 1.0, (40, 6))
    q[:, 2] = 0.0
    R, p = ur5.forward(q)
    # By hand: the links of 425 and 392.25 mm point against x of frame 1, turned by joints 1 and 2.
    level = -np.cos(q[:, 1])
    along = np.column_stack([level * np.cos(q[:, 0]), level * np.sin(q[:, 0]), -np.sin(q[:, 1])])
    p = p + 0.03 * along
    out = ~ur5.solve(R, p).reachable.any(axis=1)
    assert out.sum() >= 5
    found = ur5.postures(R[out], p[out])
    assert not len(found.q)
    least = least_distances(ur5, R[out], p[out])
    assert (found.miss[:, 0] <= 0.03 + 1e-9).all()
    assert (found.miss[:, 0] > 0.0).all()
    assert np.median(found.miss[:, 0] / least) < 1.1
    assert found.miss[:, 1].max() < 1e-9


def test_limits_leave_out_what_no_turn_brings_within_them(ur5):
    """Two turns of every joint: the turn nearest to the middle; a window of joint 1: only what is in it."""
    wide = replace(ur5, lower=np.full(6, -TURN), upper=np.full(6, TURN))
    q = np.random.default_rng(2).uniform(-TURN, TURN, (60, 6))
    R, p = wide.forward(q)
    found = wide.postures(R, p)
    assert np.abs(found.q).max() <= np.pi + 1e-12
    assert (np.bincount(found.pose) == ur5.solve(R, p).reachable.sum(axis=1)).all()
    # Joint 1 within [4, 5]: postures beyond a half turn, with their turn.
    window = replace(ur5, lower=np.array([4.0, *[-TURN] * 5]), upper=np.array([5.0, *[TURN] * 5]))
    some = window.postures(R, p)
    assert len(some.q)
    assert ((some.q[:, 0] >= 4.0) & (some.q[:, 0] <= 5.0)).all()
    every = ur5.solve(R, p)
    inside = every.reachable & (np.abs(wrap(every.q[..., 0] - 4.5)) <= 0.5)
    assert len(some.q) == inside.sum()


def test_axes_that_are_rounded_in_their_file_are_polished(wrist_arms):
    """Axes 3 and 4 turned by 3e-7 rad against axis 2: still exact, and called by its kind."""
    axes, points = _ur5_axes(wrist_arms)
    for angle, kind in ((3e-7, "parallel_axes"), (1e-3, "general")):
        turned = axes.copy()
        turned[2] = pin.exp3(angle * np.array([1.0, 0.0, 0.0])) @ axes[2]
        turned[3] = pin.exp3(angle * np.array([0.0, 0.0, 1.0])) @ axes[3]
        assert measured_kind(turned, points) == kind
        built = wrist_arms.build(turned, points, pin.SE3(np.eye(3), points[5]))
        arm = with_closed_forms(ParallelArm, built.arm)
        assert isinstance(arm, ParallelArm) == (kind == "parallel_axes")
        if kind == "general":
            with pytest.raises(UnsupportedError, match=r"not parallel by 0\.00\d* rad"):
                ParallelArm.of(built.arm)
            continue
        q = np.random.default_rng(4).uniform(-2.0, 2.0, (60, 6))
        R, p = built.forward(q)
        found = arm.solve(R, p)
        distance = np.where(found.reachable, away(found.q, q[:, None]), np.inf)
        assert distance.min(axis=1).max() < 1e-6
        row, branch = np.nonzero(found.reachable)
        assert errors(arm, found.q[row, branch], R[row], p[row]) < 1e-10


def _ur5_axes(wrist_arms) -> tuple[np.ndarray, np.ndarray]:
    T = [wrist_arms.dh_pose(wrist_arms.UR5[:k], np.zeros(k)) for k in range(6)]
    return np.array([t.rotation[:, 2] for t in T]), np.array([t.translation for t in T])


def test_arms_without_closed_forms_say_why(wrist_arms):
    """Axis 1 along axis 2, axis 6 along axis 5, axes 2 and 3 the same, axes 5 and 6 apart by 0.1 mm."""
    good_axes, good_points = _ur5_axes(wrist_arms)
    cases = []
    for k, other, words in ((0, 1, "axes 1 and 2"), (5, 4, "axes 5 and 6"), (4, 3, "axes 4 and 5")):
        axes = good_axes.copy()
        axes[k] = axes[other]
        cases.append((axes, good_points, f"{words} are parallel"))
    points = good_points.copy()
    points[2] = points[1]
    cases.append((good_axes, points, "the same"))
    points = good_points.copy()
    points[5] = points[5] + 1e-4 * np.cross(good_axes[4], good_axes[5])
    cases.append((good_axes, points, "axes 5 and 6 nearly meet"))
    for axes, points, words in cases:
        arm = wrist_arms.build(axes, points, pin.SE3(np.eye(3), points[5])).arm
        with pytest.raises(UnsupportedError, match=words):
            ParallelArm.of(arm)
        assert with_closed_forms(ParallelArm, arm) is arm


def test_a_first_joint_that_slides_has_no_closed_form(ur5):
    """The same six frames, the first of them a rail."""
    with pytest.raises(UnsupportedError, match="joint 1 slides"):
        ParallelArm.of(replace(ur5.without_limits, slides=(0,)))
