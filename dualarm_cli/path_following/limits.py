"""Whether joints that follow a path keep their limits, and where they first do not."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.path_following.problem import NoPath, PathMotion, PathProblem

SLACK = 1e-6
"""Share of a limit that differences over a step may exceed it by."""
SINGULAR = 0.02
"""Smallest singular value of the tools' Jacobian below which a posture is called singular."""


def within_limits(problem: PathProblem, position: FloatArray) -> PathMotion | NoPath:
    """Returns the motion, or the first instant at which a joint is beyond a limit of position or velocity.

    Args:
        problem: what was asked.
        position: joints at the instants [rad], shape (k, n); fewer where a method gave up.
    """
    limits, step = problem.limits, problem.step
    beyond = np.maximum(limits.lower - position, position - limits.upper)
    speed = np.abs(np.diff(position, axis=0, append=position[-1:])) / step
    share = speed / limits.velocity
    bad = (beyond > SLACK) | (share > 1.0 + SLACK)
    if not bad.any():
        return PathMotion(position)
    k = int(np.argmax(bad.any(axis=1)))
    joint = int(np.argmax(np.where(bad[k], np.maximum(share[k], 1e9 * (beyond[k] > SLACK)), 0.0)))
    name = limits.joints[joint]
    if beyond[k, joint] > SLACK:
        reason = (
            f"joint {name} reaches its limit: {np.rad2deg(position[k, joint]):.2f} deg, allowed "
            f"{np.rad2deg(limits.lower[joint]):.2f} to {np.rad2deg(limits.upper[joint]):.2f} deg"
        )
        return NoPath(reason, k)
    reason = (
        f"joint {name} would move at {np.rad2deg(speed[k, joint]):.1f} deg/s, allowed "
        f"{np.rad2deg(limits.velocity[joint]):.1f} deg/s{singular_words(problem, position[k])}"
    )
    return NoPath(reason, k, float(share.max()))


def singular_words(problem: PathProblem, q: FloatArray) -> str:
    """Returns that a posture is nearly singular, or nothing.

    Args:
        problem: what was asked.
        q: all joints [rad], shape (n,).
    """
    if not np.isfinite(q).all():
        return ""
    J = problem.body.at(q).J[problem.rows][:, problem.free]
    smallest = float(np.linalg.svd(J, compute_uv=False)[-1])
    if smallest > SINGULAR:
        return ""
    return f"; the posture is nearly singular there (smallest singular value {smallest:.2g})"
