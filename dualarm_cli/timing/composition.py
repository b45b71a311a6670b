"""Putting trajectories together: one after the other, and side by side."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.model.trajectory import Trajectory

SAME_TIME = 1e-9
"""Knots nearer than this are one knot [s]."""
SAME_ACCELERATION = 1e-5
"""Accelerations nearer than this are no jump [rad/s²]: a jerk of 10,000 rad/s³ over SAME_TIME."""


def hold(joints: tuple[str, ...], position: FloatArray, duration: float) -> Trajectory:
    """Returns joints standing still [rad], shape (n,), for a duration [s]."""
    rest = np.zeros((2, len(joints)))
    return Trajectory(joints, np.array([0.0, duration]), np.vstack([position] * 2), rest, rest)


def concatenate(trajectories: Sequence[Trajectory]) -> Trajectory:
    """Returns trajectories of the same joints one after the other, from time 0.

    Each must start where the one before ends. Where both stand with the same acceleration the joint knot is one.

    Raises:
        ValueError: there is none, or the joints differ.
    """
    first = trajectories[0]
    if any(t.joints != first.joints for t in trajectories):
        raise ValueError("trajectories of different joints cannot follow one another")
    parts: list[tuple[FloatArray, ...]] = []
    clock, last = 0.0, None
    for t in trajectories:
        joined = last is not None and np.array_equal(last, t.acceleration[0])
        cut = slice(1 if joined else 0, None)
        time = clock + (t.time - t.time[0])
        parts.append((time[cut], t.position[cut], t.velocity[cut], t.acceleration[cut]))
        clock, last = float(time[-1]), t.acceleration[-1]
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
    time = _distinct(np.sort(np.concatenate([group.time for group in groups])))
    before = [_side(group, time, "left") for group in groups]
    after = [_side(group, time, "right") for group in groups]
    order = [names.index(name) for name in joints]
    left, right = (
        tuple(np.concatenate([side[i] for side in sides], axis=1)[:, order] for i in range(3))
        for sides in (before, after)
    )
    jump: BoolArray = (np.abs(left[2] - right[2]) > SAME_ACCELERATION).any(axis=1)
    # A jump of acceleration is two knots at one time: the left limit goes before the right one.
    index = np.repeat(np.arange(len(time)), 1 + jump)
    first_of_two = np.zeros(len(index), dtype=np.bool_)
    first_of_two[:-1] = index[:-1] == index[1:]
    values = (
        np.where(first_of_two[:, None], one[index], other[index])
        for one, other in zip(left, right, strict=True)
    )
    return Trajectory(joints, time[index], *values)


def _distinct(time: FloatArray) -> FloatArray:
    """Returns sorted times without those that follow their predecessor by SAME_TIME or less."""
    keep = np.ones(len(time), dtype=np.bool_)
    keep[1:] = np.diff(time) > SAME_TIME
    kept = time[keep]
    # The end is exact, whatever came shortly before it.
    kept[-1] = time[-1]
    return kept


def _side(
    trajectory: Trajectory, time: FloatArray, side: str
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns position, velocity, acceleration at knots, as limits from the left or right.

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
    return q + dt * (v + dt * (a / 2 + dt * j / 6)), v + dt * (a + dt * j / 2), a + dt * j
