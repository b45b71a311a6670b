"""Turns about the tool's z axis that are tried at a stop."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.job import PoseTarget, Stop

YAW_STEPS = 24
"""Turns about the tool's z axis that are tried where any will do: 15 degrees apart."""


def stop_yaws(stop: Stop) -> FloatArray:
    """Returns the turns about the tool's z axis that are tried at a stop [rad], shape (y,)."""
    if not isinstance(stop.target, PoseTarget):
        return np.zeros(1)
    turns = YAW_STEPS if stop.target.free_yaw else stop.target.symmetry
    return np.arange(turns, dtype=np.float64) * (2.0 * np.pi / turns)
