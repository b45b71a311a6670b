"""Motion of all joints, group by group: what each group needs to be told, and all of them as one trajectory.

The joints of a group are timed together and share knots. Accelerations at the knots say all of a motion but where it
begins: velocities and positions follow from knot to knot, by one formula and in one order, so that whoever follows it
gets the same doubles. At some knots, the anchors, they are stated anew, so that rounding does not grow.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray, distinct, frozen
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.records import dataclass

SAME_TIME = 1e-9
"""Difference of two instants that count as one [s], for plans, reports and checks alike."""
SAME_JERK = 1e-9
"""Jerks that differ by less than this share of the joint's largest one are the same."""
DEVIATION = 1e-11
"""How far the motion may be off at a knot that is left out [rad or m]."""
ANCHORS_APART = 64
"""Knots after which an anchor is set where a group does not come to rest before."""
BLOCK = 1 << 16
"""Knots that are worked on at a time: long motions take little more memory than their numbers."""
ALL = "all"
"""Name of the group of all joints together."""


@dataclass(frozen=True)
class JointMotion:
    """Motion of all joints of a robot, in groups with knots of their own."""

    joints: tuple[str, ...]
    """Names of all joints, in the order of the robot's columns."""
    groups: Mapping[str, Trajectory]
    """Motion of each group by its name; every joint belongs to one."""

    @classmethod
    def of(cls, trajectory: Trajectory) -> JointMotion:
        """Returns the motion of joints that share all knots."""
        return cls(trajectory.joints, {ALL: trajectory})

    @cached_property
    def trajectory(self) -> Trajectory:
        """All joints together, with the knots of all groups."""
        parts = list(self.groups.values())
        if len(parts) == 1 and parts[0].joints == self.joints:
            return parts[0]
        return merge(parts, self.joints)


def anchors(trajectory: Trajectory) -> IntArray:
    """Returns the knots whose position and velocity do not follow from the knot before; the first one always."""
    q, v = trajectory.position, trajectory.velocity
    step, gain, way = _steps(trajectory.time, trajectory.acceleration)
    with np.errstate(invalid="ignore", over="ignore"):
        ahead = v[:-1] + gain, q[:-1] + (step * v[:-1] + way)
    # Bit by bit: a zero has two signs, and what is not a number equals nothing.
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
    """Returns the motion that accelerations and anchors say.

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
    step, gain, way = _steps(time, acceleration)
    ends = np.append(anchor[1:], count)
    with np.errstate(invalid="ignore", over="ignore"):
        for first, end in zip(anchor.tolist(), ends.tolist(), strict=True):
            if end - first < 2:
                continue
            intervals = slice(first, end - 1)
            v[first + 1 : end] = gain[intervals]
            np.add.accumulate(v[first:end], axis=0, out=v[first:end])
            q[first + 1 : end] = step[intervals] * v[intervals] + way[intervals]
            np.add.accumulate(q[first:end], axis=0, out=q[first:end])
    return Trajectory(joints, time, frozen(q), frozen(v), acceleration)


def _steps(time: FloatArray, acceleration: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns what happens between knots.

    Returns:
        Length of each interval [s], shape (k-1, 1); by how much velocity rises in it, shape (k-1, n); by how much
        position rises on top of what the velocity at its begin brings, shape (k-1, n).
    """
    step = np.diff(time)[:, None]
    begin, end = acceleration[:-1], acceleration[1:]
    with np.errstate(invalid="ignore", over="ignore"):
        return step, step * ((begin + end) / 2.0), np.square(step) * ((begin + begin + end) / 6.0)


def lean(
    trajectory: Trajectory, groups: Mapping[str, Sequence[str]], keep: Mapping[str, FloatArray]
) -> JointMotion:
    """Returns the same motion, within 1e-10 rad, with no knots but those that its groups need, and with few anchors.

    Args:
        trajectory: of all joints.
        groups: names of the joints of each group; every joint belongs to one.
        keep: times at which a group's knots stay [s], in any order.
    """
    found = {}
    for name, joints in groups.items():
        own = trajectory.select(joints)
        part = _at_knots(own, own_knots(own, keep.get(name)))
        moves = np.hstack([part.velocity, part.acceleration]).any(axis=1)
        few = _few_anchors(np.logical_not(moves))
        stated = few, part.position[few], part.velocity[few]
        found[name] = followed(part.joints, part.time, part.acceleration, stated)
    return JointMotion(trajectory.joints, found)


def _few_anchors(at_rest: BoolArray) -> IntArray:
    """Returns the knot that begins each rest, and more where two of these are far apart."""
    begins = at_rest & ~np.append(False, at_rest[:-1])
    found = distinct(np.append(0, np.flatnonzero(begins)))
    ends = np.append(found[1:], len(at_rest))
    rows = [np.arange(*pair, ANCHORS_APART) for pair in zip(found, ends, strict=True)]
    return np.concatenate(rows)


def _at_knots(trajectory: Trajectory, kept: IntArray) -> Trajectory:
    return Trajectory(
        trajectory.joints,
        trajectory.time[kept],
        trajectory.position[kept],
        trajectory.velocity[kept],
        trajectory.acceleration[kept],
    )


def own_knots(trajectory: Trajectory, keep: FloatArray | None = None) -> IntArray:
    """Returns the knots at which a joint's jerk changes, and the first and last one.

    Args:
        trajectory: whose knots may be those of other joints as well.
        keep: times at which knots stay [s].
    """
    time, count = trajectory.time, trajectory.time.size
    if count <= 2:
        return np.arange(count)
    # Where another joint's acceleration jumps there are two knots, of which these joints need none.
    differs = (np.diff(time) != 0.0) | np.diff(trajectory.acceleration, axis=0).any(axis=1)
    if not differs.all():
        distinct = np.append(0, 1 + np.flatnonzero(differs))
        return distinct[own_knots(_at_knots(trajectory, distinct), keep)]
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
        found = np.flatnonzero(kept)
        off = _deviation(trajectory, found) > DEVIATION
        if not off.any():
            return found
        # The first knot of each stretch that is off stays; what follows it is measured from there.
        kept |= off & ~np.append(False, off[:-1])


def _deviation(trajectory: Trajectory, kept: IntArray) -> FloatArray:
    """Returns how far the motion from the kept knots is off at all knots, shape (k,)."""
    part = _at_knots(trajectory, kept)
    index = np.searchsorted(kept, np.arange(trajectory.time.size), "right") - 1
    dt = (trajectory.time - part.time[index])[:, None]
    jerk = np.vstack([part.jerk, np.zeros((1, len(part.joints)))])[index]
    q, v, a = part.position[index], part.velocity[index], part.acceleration[index]
    off = np.abs(q + dt * (v + dt * (a / 2 + dt * jerk / 6)) - trajectory.position)
    found: FloatArray = off.max(axis=1)
    return found


def merge(groups: Sequence[Trajectory], joints: tuple[str, ...]) -> Trajectory:
    """Returns trajectories of different joints, over the same time, as one over all of them.

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
        own, cluster = np.split(cluster, [group.time.size])
        jumps.append(_jumps(group, own, len(time)))
    # A jump of acceleration is two knots at one time: the left limit goes before the right one.
    jump = np.logical_or.reduce(jumps)
    index = np.repeat(np.arange(len(time)), 1 + jump)
    first_of_two = np.flatnonzero(index[:-1] == index[1:])
    rates = [np.empty((len(index), len(joints))) for _ in range(3)]
    column = {name: k for k, name in enumerate(joints)}
    for group, own_jump in zip(groups, jumps, strict=True):
        columns = [column[name] for name in group.joints]
        for k in range(0, len(index), BLOCK):
            block = _side(group, time[index[k : k + BLOCK]], "right")
            for rate, found in zip(rates, block, strict=True):
                rate[k : k + BLOCK, columns] = found
        # Only where this group's acceleration jumps do its two limits differ by more than rounding.
        rows = first_of_two[own_jump[index[first_of_two]]]
        for rate, found in zip(rates, _side(group, time[index[rows]], "left"), strict=True):
            rate[rows[:, None], columns] = found
    return Trajectory(joints, time[index], *map(frozen, rates))


def distinct_times(time: FloatArray) -> tuple[FloatArray, IntArray]:
    """Returns the knots left of many, and for each of the many the index of its knot.

    From the first on, all that follow a knot by SAME_TIME or less are that knot.
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
    kept = risen[starts]
    # The end is exact, whatever came shortly before it.
    kept[-1] = risen[-1]
    cluster = np.empty(len(time), dtype=np.int64)
    cluster[order] = np.cumsum(starts) - 1
    return kept, cluster


def _jumps(group: Trajectory, cluster: IntArray, knots: int) -> BoolArray:
    """Returns at which of the merged knots the group's acceleration jumps, shape (knots,)."""
    jump = np.zeros(knots, dtype=np.bool_)
    changes = (group.acceleration[1:] != group.acceleration[:-1]).any(axis=1)
    jump[cluster[1:][(np.diff(group.time) == 0.0) & changes]] = True
    return jump


def _side(trajectory: Trajectory, time: FloatArray, side: str) -> FloatArray:
    """Returns position, velocity, acceleration at knots as limits from one side, shape (3, k, n).

    A knot within SAME_TIME of one of the trajectory's own counts as that one.
    """
    shift = -SAME_TIME if side == "left" else SAME_TIME
    found = np.searchsorted(trajectory.time, time + shift, side="right") - 1
    # Before its first knot a trajectory is that knot, from its last one on that one.
    index = np.clip(found, 0, trajectory.time.size - 1)
    dt = np.clip(time, trajectory.time[0], trajectory.time[-1]) - trajectory.time[index]
    dt = dt[:, None]
    q, v, a = (
        getattr(trajectory, name)[index] for name in ("position", "velocity", "acceleration")
    )
    j = np.vstack([trajectory.jerk, np.zeros((1, q.shape[1]))])[index]
    # A knot that stands in for one of the trajectory's own a moment later has that one's velocity and acceleration: led
    # back along the interval behind it, they could exceed their limits.
    ahead = np.maximum(dt, 0.0)
    return np.stack(
        [q + dt * (v + dt * (a / 2 + dt * j / 6)), v + ahead * (a + ahead * j / 2), a + ahead * j]
    )


@dataclass(frozen=True)
class LoggedMotion:
    """Samples of some of a robot's joints; time 0 is the start of the plan."""

    joints: tuple[str, ...]
    """Names of the n joints, in column order."""
    time: FloatArray
    """Instants, rising [s], shape (k,) with k > 1."""
    position: FloatArray
    """[rad], shape (k, n); m for joints that slide, here and below."""
    velocity: FloatArray | None = None
    """[rad/s], shape (k, n); None where not every joint has it."""
    acceleration: FloatArray | None = None
    """[rad/s²], shape (k, n); None where not every joint has it."""
