"""Joint paths of all branches along poses: against paths of joints, and where they end by construction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.kinematics.branch_paths import follow
from dualarm_cli.kinematics.general_arm import pose_error
from dualarm_cli.kinematics.wrist_arm import WristArm, with_closed_forms

KINDS = ("elbow", "elbow_meeting", "meeting", "parallel", "any")
FREE = np.full(6, 6.0 * np.pi)


@pytest.fixture(scope="module")
def heavy(wrist_arms) -> WristArm:
    """The industrial arm, joints within three turns."""
    return WristArm.of(replace(wrist_arms.dh_arm(wrist_arms.HEAVY).arm, lower=-FREE, upper=FREE))


def smooth_path(rng: np.random.Generator, m: int) -> np.ndarray:
    """Joints along two random waves, shape (m, 6)."""
    s = np.linspace(0.0, 1.0, m)[:, None]
    q = rng.uniform(-np.pi, np.pi, 6) + s * rng.uniform(-1.5, 1.5, 6)
    return q + rng.uniform(-0.4, 0.4, 6) * np.sin(2.0 * np.pi * s)


def keeps_off_singularities(arm, q: np.ndarray) -> bool:
    """Whether the Jacobian's determinant stays on one side of zero with room."""
    det = np.linalg.det(arm.jacobian(q))
    return bool(np.ptp(np.sign(det)) == 0 and np.abs(det).min() > 0.1 * np.abs(det).max() > 0.002)


@pytest.mark.parametrize("kind", KINDS)
def test_a_path_of_joints_away_from_singularities_is_one_branch(wrist_arms, kind):
    """Random smooth paths of random arms: one of the eight is the path itself, whole turns included."""
    rng = np.random.default_rng(21)
    looked_at, whole = 0, 0
    for _ in range(60):
        arm = with_closed_forms(wrist_arms.random_arm(kind, rng, orthogonal=True).arm)
        q = smooth_path(rng, 150)
        if not isinstance(arm, WristArm) or not keeps_off_singularities(arm, q):
            continue
        looked_at += 1
        arm = replace(arm, lower=-FREE, upper=FREE)
        R, p = arm.forward(q)
        own = int(arm.branch(q[0]))
        if kind != "any":
            # Numbers are kept along the path.
            assert (arm.branch(q) == own).all()
        found = follow(arm, R, p, q[0])
        assert found.whole[own]
        assert found.ending[own] == ""
        assert found.joint[own] == -1
        assert np.abs(found.q[own] - q).max() < 1e-7
        for branch in np.flatnonzero(found.whole):
            R_now, p_now = arm.forward(found.q[branch])
            assert np.abs(pose_error(R_now, p_now, R, p)).max() < 1e-10
            assert np.abs(np.diff(found.q[branch], axis=0)).max() < 0.7
        whole += int(found.whole.sum())
    assert looked_at >= 5
    assert whole > looked_at


def straight(arm: WristArm, begin, end, m: int) -> tuple[np.ndarray, np.ndarray]:
    """Flange poses with the wrist centre along a line and one rotation."""
    R = pin.exp3(np.array([0.3, 1.9, 0.5]))
    centers = np.linspace(begin, end, m)
    return np.broadcast_to(R, (m, 3, 3)), centers - arm.wrist_center(R, np.zeros(3))


def test_a_line_out_of_reach_ends_where_the_arm_is_stretched(heavy):
    """Wrist centre from 1.6 to 3.6 m along x in steps of 0.1 m: 2.6 m is reached by hand, the eleventh; not the next.

    Turned round the shoulder stands at -0.35 m: 1.9 m is the fourth.
    """
    R, p = straight(heavy, (1.6, 0.0, 0.335), (3.6, 0.0, 0.335), 21)
    found = follow(heavy, R, p, largest_step=3.0)
    assert found.end.tolist() == [11] * 4 + [4] * 4
    assert set(found.ending) == {"reach"}
    assert (found.joint == -1).all()
    held = found.q[0, 11:]
    assert (held == found.q[0, 10]).all()


def test_a_path_ends_at_the_limit_of_the_joint_that_meets_it_first(heavy):
    """The wrist centre goes round axis 1 by 3 rad; joint 1 may turn by 1 rad: a third of 301 poses and the first."""
    angle = np.linspace(0.0, 3.0, 301)
    q = np.tile([0.0, -0.8, 0.4, 0.2, 0.9, 0.5], (301, 1))
    q[:, 0] = angle
    R, p = heavy.forward(q)
    upper = np.array(heavy.upper)
    lower = np.array(heavy.lower)
    lower[0], upper[0] = -0.5, 1.0
    tight = replace(heavy, lower=lower, upper=upper)
    own = int(heavy.branch(q[0]))
    found = follow(tight, R, p, q[0])
    assert (found.end[own], found.ending[own], found.joint[own]) == (101, "limit", 0)
    assert np.abs(found.q[own, :101] - q[:101]).max() < 1e-9
    assert follow(heavy, R, p, q[0]).whole[own]


def test_a_path_begins_on_the_turn_that_lasts_longest(heavy):
    """Joint 6 turns from 3 rad by 5 rad, limits +-350 deg (6.11 rad): begun a turn lower (-3.28) all of it fits."""
    q = np.tile([0.3, -0.8, 0.4, 0.2, 0.9, 3.0], (200, 1))
    q[:, 5] += np.linspace(0.0, 5.0, 200)
    R, p = heavy.forward(q)
    limits = np.append(FREE[:5], np.radians(350.0))
    arm = replace(heavy, lower=-limits, upper=limits)
    own = int(arm.branch(q[0]))
    found = follow(arm, R, p, q[0])
    assert found.whole[own]
    assert found.q[own, 0, 5] == pytest.approx(3.0 - 2.0 * np.pi)
    # Where it fits without, it begins at the turn of the start.
    free = follow(heavy, R, p, q[0] + np.array([0, 0, 0, 0, 0, 2 * np.pi]))
    assert free.q[own, 0, 5] == pytest.approx(3.0 + 2.0 * np.pi)


def test_a_path_through_a_singular_wrist_ends_there(heavy):
    """Joint 5 from -0.5 to 0.5 rad in 100 steps: a branch keeps its sign, so that joints 4 and 6 would turn by pi."""
    q = np.tile([0.3, -0.8, 0.4, 0.2, 0.0, 0.5], (101, 1))
    q[:, 4] = np.linspace(-0.5, 0.5, 101)
    R, p = heavy.forward(q)
    own = int(heavy.branch(q[0]))
    found = follow(heavy, R, p, q[0])
    assert found.ending[own] == "singularity"
    # Joint 5 is 0 at the pose of index 50, where joint 4 is as it was before.
    assert found.end[own] == 51
    assert found.joint[own] in (3, 5)
    assert np.abs(found.q[own, :51] - q[:51]).max() < 1e-7


def test_a_free_joint_stays_as_it_was(heavy):
    """Joint 5 at 0 all along, joint 6 turning: joint 4 stays at the start's, joint 6 goes its way."""
    q = np.tile([0.3, -0.8, 0.4, 0.2, 0.0, 0.5], (60, 1))
    q[:, 5] += np.linspace(0.0, 4.0, 60)
    R, p = heavy.forward(q)
    found = follow(heavy, R, p, q[0])
    own = int(heavy.branch(q[0]))
    assert found.whole[own]
    assert np.abs(found.q[own] - q).max() < 1e-7


def test_a_joint_that_becomes_free_on_the_way_stays_where_it_came_to(heavy):
    """Joint 4 goes from 0.2 to 0.6 rad while joint 5 comes to 0 and stays there, joint 6 turning."""
    q = np.tile([0.3, -0.8, 0.4, 0.6, 0.0, 0.5], (100, 1))
    q[:50, 3], q[:50, 4] = np.linspace(0.2, 0.6, 50), np.linspace(0.5, 0.01, 50)
    q[50:, 5] += np.linspace(0.0, 4.0, 50)
    R, p = heavy.forward(q)
    for start in (q[0], None):
        found = follow(heavy, R, p, start)
        own = int(heavy.branch(q[0]))
        assert found.whole[own]
        assert np.abs(found.q[own] - q).max() < 1e-7


def test_one_pose_is_a_path(heavy):
    """Eight postures, one of them the start."""
    q = np.array([[0.3, -0.8, 0.4, 0.2, 0.9, 0.5]])
    found = follow(heavy, *heavy.forward(q), q[0])
    assert found.q.shape == (8, 1, 6)
    assert found.whole[heavy.branch(q[0])]
