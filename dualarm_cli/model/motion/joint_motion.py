"""Motion of all joints, in groups with their own knots or merged.

The joints of a group are timed together and share knots. Accelerations at the knots determine the motion: velocities
and positions follow from knot to knot by one formula in one order, so that every evaluation gives the same doubles. At
some knots, the anchors, position and velocity are stored, so that rounding errors do not grow.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray, distinct, frozen
from dualarm_cli.model.motion.trajectory import SAME_TIME, Trajectory
from dualarm_cli.records import dataclass

SAME_JERK = 1e-9
"""Relative difference below which jerks are equal, per largest jerk of the joint."""
DEVIATION = 1e-11
"""Largest position error where a knot is removed [rad or m]."""
ANCHORS_APART = 64
"""Largest number of knots between anchors where a group does not stop."""
BLOCK = 1 << 16
"""Knots per block, which limits memory for long motions."""
ALL = "all"
"""Name of the group of all joints."""


@dataclass(frozen=True)
class JointMotion:
    """Motion of all joints, in groups with their own knots."""

    joints: tuple[str, ...]
    """Names of all joints, in the robot's column order."""
    groups: Mapping[str, Trajectory]
    """Motion of each group by name; each joint belongs to one group."""

    @classmethod
    def of(cls, trajectory: Trajectory) -> JointMotion:
        """Build the motion of joints that share all knots."""
        return cls(trajectory.joints, {ALL: trajectory})

    @cached_property
    def trajectory(self) -> Trajectory:
        """Motion of all joints, with the knots of all groups."""
        parts = list(self.groups.values())
        if len(parts) == 1 and parts[0].joints == self.joints:
            return parts[0]
        return merge(parts, self.joints)


def anchors(trajectory: Trajectory) -> IntArray:
    """Return the knots whose position and velocity must be stored, the first included.

    Those of all other knots follow from the knot before.
    """
    q, v = trajectory.position, trajectory.velocity
    step, gain, travel = _steps(trajectory.time, trajectory.acceleration)
    with np.errstate(invalid="ignore", over="ignore"):
        ahead = v[:-1] + gain, q[:-1] + (step * v[:-1] + travel)
    # Compare bits: zero has two signs, and NaN does not equal itself.
    follows = (ahead[0].view(np.int64) == np.ascontiguousarray(v[1:]).view(np.int64)) & (
        ahead[1].view(np.int64) == np.ascontiguousarray(q[1:]).view(np.int64)
    )
    return np.append(0, 1 + np.flatnonzero(~follows.all(axis=1)))


def followed(
    joints: tuple[str, ...],
    time: FloatArray,
    acceleration: FloatArray,
    stated: tuple[IntArray, FloatArray, FloatArray],
) -> Trajectory:
    """Integrate accelerations from knot to knot, starting at each anchor.

    Args:
        joints: names of the n joints.
        time: knots [s], shape (k,).
        acceleration: at the knots [rad/s² or m/s²], shape (k, n).
        stated: anchors, rising from 0, shape (m,); positions [rad or m] and velocities [rad/s or m/s] there, (m, n).
    """
    anchor, position, velocity = stated
    count = len(time)
    q, v = np.empty(acceleration.shape), np.empty(acceleration.shape)
    q[anchor], v[anchor] = position, velocity
    step, gain, travel = _steps(time, acceleration)
    ends = np.append(anchor[1:], count)
    with np.errstate(invalid="ignore", over="ignore"):
        for first, end in zip(anchor.tolist(), ends.tolist(), strict=True):
            if end - first < 2:
                continue
            intervals = slice(first, end - 1)
            v[first + 1 : end] = gain[intervals]
            np.add.accumulate(v[first:end], axis=0, out=v[first:end])
            q[first + 1 : end] = step[intervals] * v[intervals] + travel[intervals]
            np.add.accumulate(q[first:end], axis=0, out=q[first:end])
    return Trajectory(joints, time, frozen(q), frozen(v), acceleration)


def _steps(time: FloatArray, acceleration: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute interval lengths and the changes of velocity and position.

    Returns:
        Length of each interval [s], shape (k-1, 1); velocity change, shape (k-1, n);
        position rises on top of what the velocity at its begin brings, shape (k-1, n).
    """
    step = np.diff(time)[:, None]
    begin, end = acceleration[:-1], acceleration[1:]
    with np.errstate(invalid="ignore", over="ignore"):
        return step, step * ((begin + end) / 2.0), np.square(step) * ((begin + begin + end) / 6.0)


def lean(
    trajectory: Trajectory, groups: Mapping[str, Sequence[str]], keep: Mapping[str, FloatArray]
) -> JointMotion:
    """Remove the knots and anchors that groups of joints do not need.

    Positions stay within 1e-10 rad of the given motion.

    Args:
        trajectory: of all joints.
        groups: names of the joints of each group; every joint belongs to one.
        keep: times of knots that are not removed, by group [s], in any order.
    """
    motions = {}
    for name, joints in groups.items():
        group = trajectory.select(joints)
        reduced = _at_knots(group, jerk_knots(group, keep.get(name)))
        moves = np.hstack([reduced.velocity, reduced.acceleration]).any(axis=1)
        anchor = _few_anchors(np.logical_not(moves))
        stated = anchor, reduced.position[anchor], reduced.velocity[anchor]
        motions[name] = followed(reduced.joints, reduced.time, reduced.acceleration, stated)
    return JointMotion(trajectory.joints, motions)


def _few_anchors(at_rest: BoolArray) -> IntArray:
    """Select anchors: the first knot of each rest, and at regular intervals."""
    begins = at_rest & ~np.append(False, at_rest[:-1])
    first = distinct(np.append(0, np.flatnonzero(begins)))
    ends = np.append(first[1:], len(at_rest))
    rows = [np.arange(*pair, ANCHORS_APART) for pair in zip(first, ends, strict=True)]
    return np.concatenate(rows)


def _at_knots(trajectory: Trajectory, knots: IntArray) -> Trajectory:
    return Trajectory(
        trajectory.joints,
        trajectory.time[knots],
        trajectory.position[knots],
        trajectory.velocity[knots],
        trajectory.acceleration[knots],
    )


def jerk_knots(trajectory: Trajectory, keep: FloatArray | None = None) -> IntArray:
    """Select the knots at which a jerk changes, and the first and last one.

    Args:
        trajectory: motion that may also have the knots of other joints.
        keep: times of knots that are not removed [s].
    """
    time, count = trajectory.time, trajectory.time.size
    if count <= 2:
        return np.arange(count)
    # A jump of another joint's acceleration has two knots, which these joints do not need.
    differs = (np.diff(time) != 0.0) | np.diff(trajectory.acceleration, axis=0).any(axis=1)
    if not differs.all():
        distinct = np.append(0, 1 + np.flatnonzero(differs))
        return distinct[jerk_knots(_at_knots(trajectory, distinct), keep)]
    jerk = trajectory.jerk
    largest = np.maximum(1.0, np.abs(jerk).max(axis=0))
    changes = (np.abs(np.diff(jerk, axis=0)) > SAME_JERK * largest).any(axis=1)
    kept = np.concatenate([[True], changes, [True]])
    # A jump of acceleration is two knots at one time; both stay.
    jumps = np.flatnonzero(np.diff(time) <= 0.0)
    kept[jumps] = kept[jumps + 1] = True
    if keep is not None and len(keep):
        after = np.clip(np.searchsorted(time, keep), 1, count - 1)
        kept[np.where(keep - time[after - 1] < time[after] - keep, after - 1, after)] = True
    while True:
        knots = np.flatnonzero(kept)
        wrong = _deviation(trajectory, knots) > DEVIATION
        if not wrong.any():
            return knots
        # The first wrong knot of each stretch stays; later errors are measured from there.
        kept |= wrong & ~np.append(False, wrong[:-1])


def _deviation(trajectory: Trajectory, knots: IntArray) -> FloatArray:
    """Compute the largest position error at each knot without the removed ones, shape (k,)."""
    part = _at_knots(trajectory, knots)
    index = np.searchsorted(knots, np.arange(trajectory.time.size), "right") - 1
    dt = (trajectory.time - part.time[index])[:, None]
    jerk = np.vstack([part.jerk, np.zeros((1, len(part.joints)))])[index]
    q, v, a = part.position[index], part.velocity[index], part.acceleration[index]
    off = np.abs(q + dt * (v + dt * (a / 2 + dt * jerk / 6)) - trajectory.position)
    errors: FloatArray = off.max(axis=1)
    return errors


def merge(groups: Sequence[Trajectory], joints: tuple[str, ...]) -> Trajectory:
    """Merge trajectories of different joints into one over all of them.

    Args:
        groups: trajectories that all start at 0; a shorter one stands at its end.
        joints: order of the columns; every joint of every group once.

    Returns:
        Knots at the union of all knots; times nearer than SAME_TIME become one.
    """
    names = [name for group in groups for name in group.joints]
    if sorted(names) != sorted(joints):
        raise ValueError(f"groups hold {names}, not {joints}")
    time, cluster = distinct_times(np.concatenate([group.time for group in groups]))
    jumps = []
    for group in groups:
        own_cluster, cluster = np.split(cluster, [group.time.size])
        jumps.append(_jumps(group, own_cluster, len(time)))
    # A jump of acceleration is two knots at one time: the left limit goes before the right one.
    jump = np.logical_or.reduce(jumps)
    index = np.repeat(np.arange(len(time)), 1 + jump)
    left_limits = np.flatnonzero(index[:-1] == index[1:])
    rates = [np.empty((len(index), len(joints))) for _ in range(3)]
    column = {name: k for k, name in enumerate(joints)}
    for group, own_jump in zip(groups, jumps, strict=True):
        columns = [column[name] for name in group.joints]
        for k in range(0, len(index), BLOCK):
            block = _side(group, time[index[k : k + BLOCK]], "right")
            for rate, values in zip(rates, block, strict=True):
                rate[k : k + BLOCK, columns] = values
        # The two limits of a group differ only where its own acceleration jumps.
        rows = left_limits[own_jump[index[left_limits]]]
        for rate, values in zip(rates, _side(group, time[index[rows]], "left"), strict=True):
            rate[rows[:, None], columns] = values
    return Trajectory(joints, time[index], *map(frozen, rates))


def distinct_times(time: FloatArray) -> tuple[FloatArray, IntArray]:
    """Merge nearly equal times; return the knots and each time's knot index.

    Times within SAME_TIME after a knot belong to that knot.
    """
    order = np.argsort(time, kind="stable")
    risen = time[order]
    starts = np.concatenate([[True], np.diff(risen) > 0.0])
    # Nearly equal times are rare; only among them does it matter which one came first.
    candidates = np.flatnonzero(starts)
    last = -np.inf
    if len(candidates) > 1 and np.diff(risen[candidates]).min() <= SAME_TIME:
        for k in candidates.tolist():
            starts[k] = risen[k] - last > SAME_TIME
            last = float(risen[k]) if starts[k] else last
    knots = risen[starts]
    # The last time is kept exactly.
    knots[-1] = risen[-1]
    cluster = np.empty(len(time), dtype=np.int64)
    cluster[order] = np.cumsum(starts) - 1
    return knots, cluster


def _jumps(group: Trajectory, cluster: IntArray, knots: int) -> BoolArray:
    """Find the merged knots at which a group's acceleration jumps, shape (knots,)."""
    jump = np.zeros(knots, dtype=np.bool_)
    changes = (group.acceleration[1:] != group.acceleration[:-1]).any(axis=1)
    jump[cluster[1:][(np.diff(group.time) == 0.0) & changes]] = True
    return jump


def _side(trajectory: Trajectory, time: FloatArray, side: str) -> FloatArray:
    """Evaluate position, velocity and acceleration as one-sided limits, shape (3, k, n).

    A time within SAME_TIME of a knot of the trajectory is evaluated at that knot.
    """
    shift = -SAME_TIME if side == "left" else SAME_TIME
    interval = np.searchsorted(trajectory.time, time + shift, side="right") - 1
    # The trajectory is constant before its first and after its last knot.
    index = np.clip(interval, 0, trajectory.time.size - 1)
    dt = np.clip(time, trajectory.time[0], trajectory.time[-1]) - trajectory.time[index]
    dt = dt[:, None]
    q, v, a = (
        getattr(trajectory, name)[index] for name in ("position", "velocity", "acceleration")
    )
    j = np.vstack([trajectory.jerk, np.zeros((1, q.shape[1]))])[index]
    # A merged knot shortly before a knot of the trajectory has that knot's velocity and acceleration: extrapolated
    # back, they could exceed their limits.
    ahead = np.maximum(dt, 0.0)
    return np.stack(
        [q + dt * (v + dt * (a / 2 + dt * j / 6)), v + ahead * (a + ahead * j / 2), a + ahead * j]
    )


@dataclass(frozen=True)
class LoggedMotion:
    """Samples of some of a robot's joints; time 0 is the plan's start."""

    joints: tuple[str, ...]
    """Names of the n joints, in column order."""
    time: FloatArray
    """Sample times, rising [s], shape (k,) with k > 1."""
    position: FloatArray
    """Positions [rad], or [m] of prismatic joints, shape (k, n)."""
    velocity: FloatArray | None = None
    """Velocities [rad/s or m/s], shape (k, n); None unless known for every joint."""
    acceleration: FloatArray | None = None
    """Accelerations [rad/s² or m/s²], shape (k, n); None unless known for every joint."""
