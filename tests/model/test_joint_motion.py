"""Motion by groups: nothing is lost, and nothing is said that follows."""

from __future__ import annotations

import numpy as np
import pytest

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.motion.joint_motion import (
    JointMotion,
    anchors,
    followed,
    jerk_knots,
    lean,
    merge,
)
from dualarm_cli.model.motion.trajectory import Trajectory

NAMES = ("time", "position", "velocity", "acceleration")


def random_group(seed: int, joints: tuple[str, ...], rests: int = 5) -> Trajectory:
    """Returns motions from rest to rest with a standstill after each: accelerations up, down, and back to none.

    Each is a polynomial of jerk j, -j, -j, j over equal times, which comes to rest by symmetry.
    """
    rng = np.random.default_rng(seed)
    rows: list[tuple[float, FloatArray, FloatArray, FloatArray]] = []
    q, t = rng.normal(size=len(joints)), 0.0
    zero = np.zeros(len(joints))
    for _ in range(rests):
        h, j = float(rng.uniform(0.05, 0.4)), rng.normal(size=len(joints)) * 20.0
        rows.append((t, q, zero, zero))
        rows.append((t + h, q + j * h**3 / 6, j * h**2 / 2, j * h))
        rows.append((t + 2 * h, q + j * h**3, j * h**2, zero))
        rows.append((t + 3 * h, q + j * h**3 * 11 / 6, j * h**2 / 2, -j * h))
        q, t = q + 2 * j * h**3, t + 4 * h
        rows.append((t, q, zero, zero))
        t += float(rng.uniform(0.1, 0.3))
    time, position, velocity, acceleration = (
        np.array(column) for column in zip(*rows, strict=True)
    )
    return Trajectory(joints, time, position, velocity, acceleration)


def equal(one: Trajectory, other: Trajectory) -> bool:
    """Tells whether two motions are the same to the last bit."""
    return one.joints == other.joints and all(
        getattr(one, name).tobytes() == getattr(other, name).tobytes() for name in NAMES
    )


def again(trajectory: Trajectory) -> Trajectory:
    """Returns what follows from a motion's accelerations and anchors alone."""
    known = anchors(trajectory)
    stated = known, trajectory.position[known], trajectory.velocity[known]
    return followed(trajectory.joints, trajectory.time, trajectory.acceleration, stated)


@pytest.mark.parametrize("seed", range(20))
def test_whatever_a_motion_is_it_follows_from_its_anchors_bit_by_bit(seed: int) -> None:
    """Motions that fit together, numbers that do not, signs of zeros, infinities, and what is not a number."""
    rng = np.random.default_rng(seed)
    fits = random_group(seed, ("a", "b"))
    assert equal(again(fits), fits)
    odd = rng.choice([0.0, -0.0, 1.0, -3.5, np.inf, np.nan, 5e-324, 1.7e308], size=(3, 40, 2))
    loose = Trajectory(("a", "b"), np.sort(rng.choice(np.linspace(0.0, 1.0, 30), 40)), *odd)
    assert equal(again(loose), loose)


@pytest.mark.parametrize("seed", range(10))
def test_a_lean_motion_is_the_same_with_few_anchors_and_jerk_knots(seed: int) -> None:
    """Three groups merged and taken apart again: each keeps its own knots, and anchors only where it comes to rest."""
    groups = {"platform": ("p",), "left": ("a", "b"), "right": ("c", "d", "e")}
    parts = [random_group(10 * seed + k, joints) for k, joints in enumerate(groups.values())]
    joints = ("a", "b", "p", "c", "d", "e")
    whole = merge(parts, joints)
    found = lean(whole, groups, {})
    assert found.joints == joints
    for part, (name, own) in zip(parts, groups.items(), strict=True):
        group = found.groups[name]
        assert group.joints == own
        # A shorter motion stands until the longest one ends: one knot more.
        assert group.time.size <= part.time.size + 1
        assert anchors(group).tolist() == [*range(0, part.time.size, 5)] or (
            anchors(group).size <= 2 * 5
        )
        assert equal(again(group), group)
    time = np.union1d(whole.time, np.linspace(0.0, whole.duration, 500))
    for one, other in zip(whole.at(time), found.trajectory.at(time), strict=True):
        assert np.abs(one - other).max() < 1e-10
    assert found.trajectory.duration == whole.duration


def test_knots_that_are_named_stay() -> None:
    """A joint in uniform motion needs none; an event of its arm takes place at one."""
    time = np.array([0.0, 0.25, 0.5, 1.0])
    still, moving = np.zeros((4, 1)), np.ones((4, 1))
    motion = Trajectory(("a",), time, time[:, None], moving, still)
    assert jerk_knots(motion).tolist() == [0, 3]
    assert jerk_knots(motion, np.array([0.5])).tolist() == [0, 2, 3]
    kept = lean(motion, {"left": ("a",)}, {"left": np.array([0.25])})
    assert kept.trajectory.time.tolist() == [0.0, 0.25, 1.0]


def test_another_groups_jump_of_acceleration_is_none_of_ones_own() -> None:
    """Joint a jumps from 1 to -1 rad/s² at 1 s; b, in uniform motion, has no knot there."""
    a = Trajectory(
        ("a",),
        np.array([0.0, 1.0, 1.0, 2.0]),
        np.array([[0.0], [0.5], [0.5], [1.0]]),
        np.array([[0.0], [1.0], [1.0], [0.0]]),
        np.array([[1.0], [1.0], [-1.0], [-1.0]]),
    )
    b = Trajectory(
        ("b",), np.array([0.0, 2.0]), np.array([[0.0], [2.0]]), np.ones((2, 1)), np.zeros((2, 1))
    )
    found = lean(merge([a, b], ("a", "b")), {"left": ("a",), "right": ("b",)}, {})
    assert found.groups["left"].time.tolist() == [0.0, 1.0, 1.0, 2.0]
    assert found.groups["right"].time.tolist() == [0.0, 2.0]
    assert found.trajectory.time.tolist() == [0.0, 1.0, 1.0, 2.0]


def test_rounding_does_not_grow_along_a_motion_without_rest() -> None:
    """A sine of 20,000 knots: positions stay within 1e-10 rad of what was given."""
    time = np.linspace(0.0, 200.0, 20_001)
    a = -np.sin(time)
    jerk_free = np.zeros_like(time)
    v, q = np.ones_like(time), jerk_free.copy()
    h = np.diff(time)
    for k in range(time.size - 1):
        v[k + 1] = v[k] + h[k] * (a[k] + a[k + 1]) / 2
        q[k + 1] = q[k] + h[k] * v[k] + h[k] ** 2 * (2 * a[k] + a[k + 1]) / 6
    motion = Trajectory(("a",), time, q[:, None], v[:, None], a[:, None])
    found = lean(motion, {"left": ("a",)}, {}).groups["left"]
    assert found.time.size == time.size
    assert np.abs(found.position[:, 0] - q).max() < 1e-12
    assert 200 < anchors(found).size < 400


def test_one_group_of_all_joints_is_the_trajectory_itself() -> None:
    """No copy, and no other order."""
    motion = random_group(1, ("a", "b"))
    assert JointMotion.of(motion).trajectory is motion
