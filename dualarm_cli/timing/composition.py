"""Putting trajectories together: one after the other, and side by side."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.model.trajectory import Trajectory

SAME_TIME = 1e-9
"""Knots nearer than this are one knot [s]."""
SAME_POSITION = 1e-9
"""Positions nearer than this are one position [rad]."""


def hold(joints: tuple[str, ...], position: FloatArray, duration: float) -> Trajectory:
    """Returns joints standing still [rad], shape (n,), for a duration [s]."""
    rest = np.zeros((2, len(joints)))
    return Trajectory(joints, np.array([0.0, duration]), np.vstack([position] * 2), rest, rest)


def drawn_out(trajectory: Trajectory, factor: float) -> Trajectory:
    """Returns the same way in factor times the time."""
    return Trajectory(
        trajectory.joints,
        trajectory.time * factor,
        trajectory.position,
        trajectory.velocity / factor,
        trajectory.acceleration / factor**2,
    )


def concatenate(trajectories: Sequence[Trajectory]) -> Trajectory:
    """Returns trajectories of the same joints one after the other, from time 0.

    Where one ends and the next starts with the same acceleration their common knot is one.

    Raises:
        ValueError: there is none, the joints differ, or one does not start where the one before ends.
    """
    if not trajectories:
        raise ValueError("no trajectories to join")
    first = trajectories[0]
    if any(t.joints != first.joints for t in trajectories):
        raise ValueError("trajectories of different joints cannot be joined")
    parts: list[tuple[FloatArray, ...]] = []
    clock, before = 0.0, None
    for t in trajectories:
        cut = slice(0, None)
        if before is not None:
            if np.abs(t.position[0] - before.position[-1]).max() > SAME_POSITION:
                raise ValueError(
                    f"a trajectory starts at {t.position[0].tolist()}, {clock} s after the first, "
                    f"where the one before ended at {before.position[-1].tolist()}"
                )
            joined = np.array_equal(before.acceleration[-1], t.acceleration[0])
            cut = slice(int(joined), None)
        time = clock + (t.time - t.time[0])
        parts.append((time[cut], t.position[cut], t.velocity[cut], t.acceleration[cut]))
        clock, before = float(time[-1]), t
    arrays = (np.concatenate([part[i] for part in parts]) for i in range(4))
    return Trajectory(first.joints, *arrays)


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
    jump = np.zeros(len(time), dtype=np.bool_)
    left, right = [], []
    for group in groups:
        own, cluster = np.split(cluster, [group.time.size])
        jumps = _jumps(group, own, len(time))
        after = _side(group, time, "right")
        before = _side(group, time, "left")
        # Only where this group's acceleration jumps do its two limits differ by more than rounding.
        left.append(np.where(jumps[:, None], before, after))
        right.append(after)
        jump |= jumps
    order = [names.index(name) for name in joints]
    one, other = (np.concatenate(side, axis=2)[:, :, order] for side in (left, right))
    # A jump of acceleration is two knots at one time: the left limit goes before the right one.
    index = np.repeat(np.arange(len(time)), 1 + jump)
    first_of_two = np.zeros((len(index), 1), dtype=np.bool_)
    first_of_two[:-1, 0] = index[:-1] == index[1:]
    return Trajectory(joints, time[index], *np.where(first_of_two, one[:, index], other[:, index]))


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
