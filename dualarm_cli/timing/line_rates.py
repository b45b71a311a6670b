"""Times of many lines joint by joint: what each joint of a line asks for under the line's best shape."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.timing.line_profile import ESTIMATE_BLOCK, ESTIMATE_SHAPES, estimate_operators


def joint_line_durations(position: FloatArray, limits: JointLimits) -> FloatArray:
    """Returns how long each joint alone would make each line last [s], shape (n, d).

    The largest of a line's row is its estimate as `estimate_line_durations` gives it; the others say how far from
    critical their joints are.

    Args:
        position: joints at equidistant samples [rad], shape (n, m, d).
        limits: of the d joints.
    """
    blocks = range(0, len(position), ESTIMATE_BLOCK)
    return np.concatenate([_block(position[k : k + ESTIMATE_BLOCK], limits) for k in blocks])


def _block(position: FloatArray, limits: JointLimits) -> FloatArray:
    n, samples, joints = position.shape
    flat = np.moveaxis(position, 1, 0).reshape(samples, -1)
    shapes = len(ESTIMATE_SHAPES.start)
    rates = [
        np.abs(operator @ flat).reshape(shapes, -1, n, joints).max(axis=1)
        for operator in estimate_operators(samples)
    ]
    time = np.maximum(
        rates[0] / limits.velocity,
        np.maximum(np.sqrt(rates[1] / limits.acceleration), np.cbrt(rates[2] / limits.jerk)),
    )
    best = time.max(axis=2).argmin(axis=0)
    return time[best, np.arange(n)]
