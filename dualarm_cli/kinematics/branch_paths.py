"""The joint paths of all branches of an arm with a spherical wrist along poses, and where and why they end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.kinematics.srs.srs_limits import LIMIT_SLACK, wrap
from dualarm_cli.kinematics.wrist_arm import WristArm, WristSolutions

LARGEST_STEP = 0.7
"""A joint that turns more between two poses has jumped: a singularity is between them [rad]."""
TURN = 2.0 * np.pi
SHIFTS = TURN * np.arange(-2, 3)
"""Whole turns with which a path may begin [rad]."""

Ending = Literal["", "reach", "singularity", "limit"]


@dataclass(frozen=True)
class BranchPaths:
    """Paths of the eight branches along m poses."""

    q: FloatArray
    """Joints [rad], continuous; from `end` on as they were before it, shape (8, m, 6)."""
    end: IntArray
    """How many poses are followed: the first one that is not, m where all are, shape (8,)."""
    ending: tuple[Ending, ...]
    """Why it ends there: out of reach, a joint jumps at a singularity, or a joint's limit; nothing where all are."""
    joint: IntArray
    """Which joint, from 0, meets its limit or jumps most; -1 where none does, shape (8,)."""

    @property
    def whole(self) -> BoolArray:
        """Which branches can be followed along all poses, shape (8,)."""
        return self.end == self.q.shape[1]


def follow(
    arm: WristArm,
    R: FloatArray,
    p: FloatArray,
    start: FloatArray | None = None,
    *,
    largest_step: float = LARGEST_STEP,
) -> BranchPaths:
    """Returns the joint paths of all branches along poses.

    A path begins with the whole turns that keep it within limits longest, and among these with those nearest to the
    start. A joint that is free at some pose (`WristSolutions.singular`) stays as it was at the pose before.
    Branches are those of the first pose: where numbers are not kept along paths (`point_postures`), the nearest
    posture goes on.

    Args:
        arm: kinematics and limits.
        R: flange rotations along the path, shape (m, 3, 3).
        p: flange positions [m], shape (m, 3); m at least 1.
        start: joints to begin near to, and free joints at the first pose [rad], shape (6,); the middle of the limits
            without.
        largest_step: a joint that turns more between two poses has jumped [rad].
    """
    m = len(p)
    begin = arm.middle if start is None else np.asarray(start, dtype=np.float64)
    found = _carried(arm, R, p, begin, start is not None)
    q, reached = np.swapaxes(found.q, 0, 1), found.reachable.T
    if arm.shoulder.family == "quartic":
        order = _tracked(q, reached)
        q = np.take_along_axis(q, order[..., None], 0)
        reached = np.take_along_axis(reached, order, 0)
    step = np.zeros_like(q)
    step[:, 1:] = wrap(np.diff(q, axis=1))
    path = q[:, :1] + np.cumsum(step, axis=1)
    jumped = np.abs(step).max(axis=2)
    out, jump = _first(~reached), _first(np.asarray(jumped > largest_step))
    path, limit, joint = _turned(arm, path, begin, np.minimum(out, jump))
    end = np.minimum(np.minimum(out, jump), limit)
    last = np.abs(step[np.arange(8), np.minimum(jump, m - 1)]).argmax(axis=1)
    reasons = [end == m, end == out, end == jump]
    joint = np.select(reasons, [-1, -1, last], joint)
    names: tuple[Ending, ...] = ("", "reach", "singularity", "limit")
    ending = tuple(names[k] for k in np.select(reasons, [0, 1, 2], 3).tolist())
    held = np.minimum(np.arange(m), np.maximum(end - 1, 0)[:, None])
    return BranchPaths(np.take_along_axis(path, held[..., None], 1), end, ending, joint)


def _carried(
    arm: WristArm, R: FloatArray, p: FloatArray, begin: FloatArray, given: bool
) -> WristSolutions:
    """Returns solutions (m, 8) in which free joints stay as they were at the pose before."""
    found = arm.solve(R, p, begin)
    if not found.singular.any():
        return found
    q = found.q.copy()
    for branch in np.flatnonzero(found.singular.any(axis=0)).tolist():
        free = found.singular[:, branch]
        known = found.reachable[:, branch] & ~free
        before = np.maximum.accumulate(np.where(known, np.arange(len(p)), -1))
        if not given and known.any():
            before = np.where(before < 0, int(known.argmax()), before)
        reference = np.where((before < 0)[:, None], begin, found.q[before, branch])
        again = arm.solve(R[free], p[free], reference[free])
        q[free, branch] = again.q[:, branch]
    return WristSolutions(q, found.reachable, found.singular)


def _tracked(q: FloatArray, reached: BoolArray) -> IntArray:
    """Returns which solution of each pose goes on with each of the first pose, shape (8, m)."""
    m = q.shape[1]
    away = np.abs(wrap(q[None, :, 1:] - q[:, None, :-1])).max(axis=3)
    follower = np.where(reached[None, :, 1:], away, np.inf).argmin(axis=1)
    order = np.empty((8, m), dtype=np.int64)
    order[:, 0] = np.arange(8)
    for k in range(1, m):
        order[:, k] = follower[order[:, k - 1], k - 1]
    return order


def _first(marked: BoolArray) -> IntArray:
    """Returns the first marked column of each row, the number of columns where none is."""
    some = np.concatenate([marked, np.ones((len(marked), 1), dtype=np.bool_)], axis=1)
    return np.asarray(some.argmax(axis=1), dtype=np.int64)


def _turned(
    arm: WristArm, path: FloatArray, begin: FloatArray, followed: IntArray
) -> tuple[FloatArray, IntArray, IntArray]:
    """Returns paths with the best whole turns, where they first pass a limit (m for nowhere), and of which joint."""
    m = path.shape[1]
    tried = path[..., None] + SHIFTS
    low, high = arm.lower[:, None] - LIMIT_SLACK, arm.upper[:, None] + LIMIT_SLACK
    beyond = (tried < low) | (tried > high)
    beyond &= (np.arange(m) < followed[:, None])[..., None, None]
    meets = np.where(beyond.any(axis=1), beyond.argmax(axis=1), m)
    near = np.abs(tried[:, 0] - begin[:, None])
    # Farthest first; of equals the nearest to where the path begins.
    best = np.where(meets == meets.max(axis=2, keepdims=True), near, np.inf).argmin(axis=2)
    meets = np.take_along_axis(meets, best[..., None], 2)[..., 0]
    joint = meets.argmin(axis=1)
    return path + SHIFTS[best][:, None], meets.min(axis=1), joint
