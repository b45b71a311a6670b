"""Where tools are at the instants of a path, rounded within its tolerance where its curvature jumps."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
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
ROUNDS = 12
"""How often a shorter window is tried."""
BESIDE = 3
"""Instants before and after a junction at which its accelerations are looked at."""


def tool_targets(path: ToolPath, share: FloatArray, step: float, tolerance: float) -> Poses:
    """Returns a tool's poses at instants, rotations (k, 3, 3) and positions (k, 3) [m].

    Where pieces meet without a corner but with different curvature (a line and an arc, say) the tool's acceleration
    would jump, and the joints' jerk be infinite. There the pose is replaced by its mean over a short time W, which
    spreads the jump evenly over it and leaves the path by a W² / 24 at most, a being the largest acceleration near by.
    W is the longest that keeps within the tolerance's share. Near corners and the ends nothing is rounded.

    Args:
        path: the tool's way.
        share: how much of it is done at each instant, shape (k,).
        step: time between instants [s].
        tolerance: how far the tool may leave its path [m].
    """
    R, p = path.at(share * path.length)
    corners = set(path.corners)
    places = np.array([edge for edge in path.junctions if edge not in corners]) / path.length
    turned = np.concatenate(
        [np.zeros((1, 3)), np.cumsum(log_rotation(np.swapaxes(R[:-1], -1, -2) @ R[1:]), axis=0)]
    )
    # Turns as vectors in the tool's own frame, one after the other: over a short while they add up.
    way = np.hstack([p, TURN_LENGTH * turned])
    joints = np.array(
        [k for k in np.searchsorted(share, places).tolist() if _jumps(way, k, step)], dtype=np.int64
    )
    if not len(joints):
        return R, p
    stops = np.array([0, *np.searchsorted(share, np.array(path.corners) / path.length), len(p) - 1])
    window = LONGEST
    for _ in range(ROUNDS):
        half = int(window / (2.0 * step))
        if half < 2:
            break
        change = _fade(len(p), joints, stops, half)[:, None] * (_means(way, half) - way)
        off = max(
            np.linalg.norm(change[:, :3], axis=1).max(), np.linalg.norm(change[:, 3:], axis=1).max()
        )
        if off <= SHARE * tolerance:
            return R @ exp_rotation(change[:, 3:] / TURN_LENGTH), p + change[:, :3]
        window *= min(0.9, float(np.sqrt(SHARE * tolerance / off)))
    return R, p


def _jumps(way: FloatArray, k: int, step: float) -> bool:
    """Returns whether the acceleration jumps about an instant, turns counted by TURN_LENGTH."""
    if k < BESIDE + 1 or k > len(way) - BESIDE - 2:
        return False
    before, after = (
        (way[i + 1] - 2.0 * way[i] + way[i - 1]) / step**2 for i in (k - BESIDE, k + BESIDE)
    )
    return bool(np.linalg.norm(after - before) >= SMALLEST)


def _means(way: FloatArray, half: int) -> FloatArray:
    """Returns means over 2 half intervals about every instant, the outermost instants counting half, shape (k, 6)."""
    padded = np.pad(way - way[0], ((half, half), (0, 0)), mode="edge")
    sums = np.vstack([np.zeros((1, way.shape[1])), np.cumsum(padded, axis=0)])
    whole = sums[2 * half + 1 :] - sums[: -2 * half - 1]
    found: FloatArray = way[0] + (whole - (padded[2 * half :] + padded[: -2 * half]) / 2.0) / (
        2 * half
    )
    return found


def _fade(count: int, joints: IntArray, stops: IntArray, half: int) -> FloatArray:
    """Returns how much of the rounding counts at each instant, shape (k,): 1 near junctions, 0 near stops."""
    instants = np.arange(count)
    near = np.abs(instants[:, None] - joints).min(axis=1) / half
    far = np.abs(instants[:, None] - stops).min(axis=1) / half
    return _smooth((2.0 * FADE - near) / (2.0 * FADE - 1.0)) * _smooth(far - 1.0)


def _smooth(x: FloatArray) -> FloatArray:
    """Returns 0 below 0, 1 above 1, and a step with two continuous derivatives in between."""
    x = np.clip(x, 0.0, 1.0)
    found: FloatArray = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    return found
