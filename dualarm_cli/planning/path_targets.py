"""Where tools are at the instants of a path, rounded within its tolerance where its curvature jumps."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.rotations import exp_rotation, log_rotation
from dualarm_cli.model.tool_path import TURN_LENGTH, Poses, ToolPath

SHARE = 0.7
"""Share of the tolerance by which rounding may leave the path."""
LONGEST = 0.15
"""Time over which a jump of acceleration is spread, at most [s]."""
SMALLEST = 0.01
"""Jumps of acceleration that need no rounding [m/s²]."""
FADE = 4.0
"""Windows from a junction after which the path is followed to the letter again."""


def tool_targets(path: ToolPath, share: FloatArray, step: float, tolerance: float) -> Poses:
    """Returns a tool's poses at instants, rotations (k, 3, 3) and positions (k, 3) [m].

    Where pieces meet without a corner but with different curvature (a line and an arc, say) the tool's acceleration
    would jump, and the joints' jerk be infinite. There the pose is replaced by its mean over a short time W, which
    spreads the jump evenly over it. On a circle of acceleration a the mean leaves the path by a W² / 24, which
    chooses W.

    Args:
        path: the tool's way.
        share: how much of it is done at each instant, shape (k,).
        step: time between instants [s].
        tolerance: how far the tool may leave its path [m].
    """
    R, p = path.at(share * path.length)
    corners = set(path.corners)
    for edge in path.junctions:
        if edge not in corners:
            k = int(np.searchsorted(share, edge / path.length))
            _round(R, p, k, step, tolerance)
    return R, p


def _round(R: FloatArray, p: FloatArray, k: int, step: float, tolerance: float) -> None:
    """Rounds poses about the k-th in place."""
    count = len(p)
    if k < 4 or k > count - 5:
        return
    before, after = (_acceleration(R, p, i, step) for i in (k - 3, k + 3))
    if np.linalg.norm(after - before) < SMALLEST:
        return
    largest = max(float(np.linalg.norm(before)), float(np.linalg.norm(after)))
    window = min(LONGEST, float(np.sqrt(24.0 * SHARE * tolerance / largest)))
    half = int(window / (2.0 * step))
    # What is rounded must not reach the rest at the ends of the path.
    room = min(k, count - 1 - k)
    half = min(half, int(room / (FADE * 2.0 + 1.0)))
    if half < 2:
        return
    far = int(FADE * 2.0 * half)
    index = np.arange(k - far, k + far + 1)
    around = index[:, None] + np.arange(-half, half + 1)
    # A mean over an even number of intervals: the outermost instants count half.
    weight = np.full(2 * half + 1, 1.0 / (2 * half))
    weight[[0, -1]] /= 2.0
    distance = np.abs(index - k) / half
    x = np.clip((distance - 1.0) / (2.0 * FADE - 1.0), 0.0, 1.0)
    fade = 1.0 - x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    mean_p = (weight[:, None] * (p[around] - p[index][:, None])).sum(axis=1)
    turns = log_rotation(np.swapaxes(R[index], -1, -2)[:, None] @ R[around])
    mean_R = (weight[:, None] * turns).sum(axis=1)
    p[index] = p[index] + fade[:, None] * mean_p
    R[index] = R[index] @ exp_rotation(fade[:, None] * mean_R)


def _acceleration(R: FloatArray, p: FloatArray, k: int, step: float) -> FloatArray:
    """Returns the tool's acceleration at an instant, turns counted by TURN_LENGTH, shape (6,) [m/s²]."""
    ahead, behind = log_rotation(R[k].T @ R[k + 1]), log_rotation(R[k].T @ R[k - 1])
    found: FloatArray = np.concatenate(
        [p[k + 1] - 2.0 * p[k] + p[k - 1], TURN_LENGTH * (R[k] @ (ahead + behind))]
    )
    return found / step**2
