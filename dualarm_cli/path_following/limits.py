"""Whether joints that follow a path keep their limits, and where they first do not."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.path_following.problem import NoPath, PathMotion, PathProblem

SLACK = 1e-6
"""How far beyond a limit rounding may take a joint [rad]."""
SINGULAR = 0.02
"""Smallest singular value of the tools' Jacobian below which a posture is called singular."""


def within_limits(problem: PathProblem, position: FloatArray) -> PathMotion | NoPath:
    """Returns the motion, or the first instant at which a joint is beyond its position limit.

    How fast joints move is for those to judge who join the instants by a curve.

    Args:
        problem: what was asked.
        position: joints at the instants [rad], shape (k, n); fewer where a method gave up.
    """
    limits = problem.limits
    beyond = np.maximum(limits.lower - position, position - limits.upper)
    if not (beyond > SLACK).any():
        return PathMotion(position)
    k = int(np.argmax((beyond > SLACK).any(axis=1)))
    joint = int(np.argmax(beyond[k]))
    return NoPath(
        f"joint {limits.joints[joint]} reaches its limit: {np.rad2deg(position[k, joint]):.2f} deg, allowed "
        f"{np.rad2deg(limits.lower[joint]):.2f} to {np.rad2deg(limits.upper[joint]):.2f} deg",
        k,
    )


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
