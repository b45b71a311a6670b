"""Self-motion evened out over time, the tools where they were."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.path_following import PathMotion, PathProblem
from dualarm_cli.path_following.velocity import corrected


def evened_out(problem: PathProblem, found: PathMotion, window: float) -> PathMotion:
    """Returns the same motion of the tools with joints that are means over a short time.

    Where a method comes to a limit, or leaves one, velocities have kinks and accelerations jump. A mean over W spreads
    a jump evenly over W; what that does to the tools is undone by Newton steps of least norm, so that only self-motion
    is evened out. At both ends, where all is at rest, the joints stay as they are.

    Args:
        problem: what was asked.
        found: the joints.
        window: W [s]; 0 for none.
    """
    half = int(window / (2.0 * problem.step))
    count = problem.instants
    if half < 2 or count < 6 * half:
        return found
    position = _means(np.array(found.position), half)
    body, which = problem.body, np.flatnonzero(problem.follows)
    for k in range(1, count - 1):
        if np.array_equal(position[k], found.position[k]):
            continue
        R_there, p_there = body.tools(found.position[k])
        state = body.at(position[k])
        J = state.J[problem.rows] * problem.free
        try:
            plus = J.T @ np.linalg.inv(J @ J.T)
        except np.linalg.LinAlgError:
            return found
        position[k] = corrected(problem, position[k], plus, R_there[which], p_there[which])
    return PathMotion(position)


def _means(position: FloatArray, half: int) -> FloatArray:
    """Returns means over 2 half + 1 instants, the outermost counting half, fading to nothing at both ends, (k, n)."""
    count = len(position)
    padded = np.pad(position, ((half, half), (0, 0)), mode="edge")
    sums = np.vstack([np.zeros((1, position.shape[1])), np.cumsum(padded - position[0], axis=0)])
    whole = sums[2 * half + 1 :] - sums[: -2 * half - 1]
    ends = padded[2 * half :] + padded[: -2 * half] - 2.0 * position[0]
    mean = position[0] + (whole - ends / 2.0) / (2 * half)
    x = np.clip(np.minimum(np.arange(count), count - 1 - np.arange(count)) / (2.0 * half), 0.0, 1.0)
    fade = (x**3 * (10.0 - 15.0 * x + 6.0 * x**2))[:, None]
    return position + fade * (mean - position)
