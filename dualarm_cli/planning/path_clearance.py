"""Whether configurations keep clear, and paths that were followed."""

from __future__ import annotations

import numpy as np

from dualarm_cli.collision.clearance import SLACK
from dualarm_cli.errors import millimetres
from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.planning.holding import Holding
from dualarm_cli.planning.path_motion import Followed, Refused

LOOKED_AT = 0.02
"""Time between the postures of a path that are looked at [s]."""


def keeps_clear(holding: Holding, position: FloatArray) -> BoolArray:
    """Returns which configurations (k, n) [rad] keep clear, shape (k,)."""
    held = np.zeros((len(position), len(holding.cell.arms)), dtype=np.int64)
    return np.asarray(holding.cell.margins(position, held) >= SLACK)


def touching_path(holding: Holding, found: Followed) -> Refused | None:
    """Returns where a followed path does not keep clear, or None."""
    trajectory = found.trajectory
    count = max(2, int(np.ceil(trajectory.duration / LOOKED_AT)) + 1)
    time = np.linspace(0.0, trajectory.duration, count)
    position = trajectory.at(time)[0]
    held = np.zeros((count, len(holding.cell.arms)), dtype=np.int64)
    margin = holding.cell.margins(position, held)
    k = int(np.argmin(margin))
    if margin[k] >= SLACK / 2.0:
        return None
    one, other, missing = holding.cell.nearest(position[k], held[k])
    share = float(found.clock.at(time[k : k + 1])[0][0])
    return Refused(
        f"after {time[k]:.3f} s {one} and {other} lack {millimetres(min(0.0, missing))} of clearance",
        share,
        "clear",
    )
