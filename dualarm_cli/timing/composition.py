"""Putting trajectories together, one after the other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.trajectory import Trajectory

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
