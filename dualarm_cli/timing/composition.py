"""Composition of trajectories in sequence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.motion.trajectory import SAME_TIME, Trajectory

SAME_POSITION = 1e-9
"""Largest distance of equal positions [rad]."""
ROUNDED = 64
"""Tolerance of start times in long motions, in floating-point steps of the time."""


def hold(joints: tuple[str, ...], position: FloatArray, duration: float) -> Trajectory:
    """Build a trajectory at rest at a position [rad], shape (n,), for a duration [s]."""
    rest = np.zeros((2, len(joints)))
    return Trajectory(joints, np.array([0.0, duration]), np.vstack([position] * 2), rest, rest)


def drawn_out(trajectory: Trajectory, factor: float) -> Trajectory:
    """Stretch a trajectory in time by a factor."""
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
    """Join trajectories of the same joints in sequence, from time 0.

    Adjacent knots with equal acceleration are merged.

    Args:
        trajectories: at least one trajectory.
        begins: start times of some of them [s], by index, against accumulated rounding in long sequences.

    Raises:
        ValueError: no trajectory, different joints, or a gap in time or position.
    """
    if not trajectories:
        raise ValueError("no trajectories to join")
    joints, given_begins = trajectories[0].joints, begins or {}
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
        begin = given_begins.get(number, clock)
        if abs(begin - clock) > max(SAME_TIME, ROUNDED * np.spacing(clock)):
            raise ValueError(f"a trajectory starts {begin} s after the first, not {clock} s")
        clocks.append(clock)
        starts.append(begin)
        # A given begin may be earlier by rounding; then the next piece absorbs the difference.
        clock = max(clock, begin + (end - zero)) if end != zero else clock
    has_gap = np.abs(q[first[1:]] - q[last[:-1]]).max(axis=1, initial=0.0) > SAME_POSITION
    if has_gap.any():
        k = int(np.argmax(has_gap))
        raise ValueError(
            f"a trajectory starts at {q[first[k + 1]].tolist()}, {clocks[k + 1]} s after the first, "
            f"where the one before ended at {q[last[k]].tolist()}"
        )
    since, clock_of = time - np.repeat(time[first], counts), np.repeat(clocks, counts)
    time = np.repeat(starts, counts) + since
    # A jump of acceleration between two pieces is two knots at one time. Defective times are kept for the verifier to
    # report.
    time = np.where(since == 0.0, clock_of, np.where(since > 0.0, np.maximum(time, clock_of), time))
    kept = np.ones(len(time), dtype=np.bool_)
    kept[first[1:]] = (a[first[1:]] != a[last[:-1]]).any(axis=1)
    return Trajectory(joints, time[kept], q[kept], v[kept], a[kept])
