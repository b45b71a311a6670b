"""Putting trajectories together, one after the other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.joint_motion import SAME_TIME
from dualarm_cli.model.trajectory import Trajectory

SAME_POSITION = 1e-9
"""Positions nearer than this are one position [rad]."""
ROUNDED = 64
"""In longer motions instants are one that differ by so many of the steps between numbers of their size."""


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
        trajectory.acceleration / np.square(factor),
    )


def concatenate(
    trajectories: Sequence[Trajectory], begins: Mapping[int, float] | None = None
) -> Trajectory:
    """Returns trajectories of the same joints one after the other, from time 0.

    Where one ends and the next starts with the same acceleration their common knot is one.

    Args:
        trajectories: at least one.
        begins: when some of them begin [s], by their numbers, as others know it: in thousands of them rounding adds up.

    Raises:
        ValueError: there is none, the joints differ, or one does not start where or when the one before ends.
    """
    if not trajectories:
        raise ValueError("no trajectories to join")
    joints, known = trajectories[0].joints, begins or {}
    if any(t.joints != joints for t in trajectories):
        raise ValueError("trajectories of different joints cannot be joined")
    time, q, v, a = (
        np.concatenate([getattr(t, name) for t in trajectories])
        for name in ("time", "position", "velocity", "acceleration")
    )
    counts = np.array([len(t.time) for t in trajectories])
    first = np.cumsum(counts) - counts
    last = first + counts - 1
    clock, clocks, starts = 0.0, [], []
    for number, (zero, end) in enumerate(
        zip(time[first].tolist(), time[last].tolist(), strict=True)
    ):
        begin = known.get(number, clock)
        if abs(begin - clock) > max(SAME_TIME, ROUNDED * np.spacing(clock)):
            raise ValueError(f"a trajectory starts {begin} s after the first, not {clock} s")
        clocks.append(clock)
        starts.append(begin)
        # A known begin may be earlier by rounding; the next one takes up what a piece of no length leaves.
        clock = max(clock, begin + (end - zero)) if end != zero else clock
    apart = np.abs(q[first[1:]] - q[last[:-1]]).max(axis=1, initial=0.0) > SAME_POSITION
    if apart.any():
        k = int(np.argmax(apart))
        raise ValueError(
            f"a trajectory starts at {q[first[k + 1]].tolist()}, {clocks[k + 1]} s after the first, "
            f"where the one before ended at {q[last[k]].tolist()}"
        )
    since, clock_of = time - np.repeat(time[first], counts), np.repeat(clocks, counts)
    time = np.repeat(starts, counts) + since
    # A jump of acceleration where one begins is two knots at one time. Defective times stay for the verifier to find.
    time = np.where(since == 0.0, clock_of, np.where(since > 0.0, np.maximum(time, clock_of), time))
    kept = np.ones(len(time), dtype=np.bool_)
    kept[first[1:]] = (a[first[1:]] != a[last[:-1]]).any(axis=1)
    return Trajectory(joints, time[kept], q[kept], v[kept], a[kept])
