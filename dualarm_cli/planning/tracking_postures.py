"""Postures of one arm along tool poses that shift without turning: the branch held, the arm angle as it is told."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.kinematics.continuation import (
    LARGEST_STEP,
    LEAST_PIVOT,
    follow_lines,
    newton,
    spare_directions,
)
from dualarm_cli.kinematics.general_arm import GeneralArm
from dualarm_cli.redundancy import StopPosture, StopProblem

SKELETON = 16
"""Poses to either side of the target that are followed one after the other; those between them all at once."""
SAMPLES = 17
"""Poses on the way from where a posture was chosen to where it is taken."""
TURN = 2.0 * np.pi


def along_poses(
    problem: StopProblem,
    posture: StopPosture,
    R: FloatArray,
    points: FloatArray,
    psi: FloatArray,
    target: int,
) -> tuple[FloatArray, bool]:
    """Returns joints (m, n) [rad] along flange poses, and whether they are continuous and within limits all along.

    Args:
        problem: the stop, for its arm.
        posture: branch and joints to be near at the target; these may be for another place of it.
        R: flange rotation throughout, shape (3, 3).
        points: flange positions [m], shape (m, 3).
        psi: arm angles, or ways along the self-motion of arms without one, shape (m,) [rad].
        target: number of the pose that is the target.
    """
    if isinstance(problem.arm, GeneralArm):
        return _continued(problem.arm, posture.q_target, R, points, psi, target)
    arm = problem.arm
    rows = np.broadcast_to(R, (len(points), 3, 3))
    q, reachable = arm.solve_branch(rows, points, psi, np.array(posture.branch))
    steps = np.diff(q, axis=0)
    steps -= TURN * np.rint(steps / TURN)
    q = np.concatenate([q[:1], q[:1] + np.cumsum(steps, axis=0)])
    q = q + (arm.nearest_turns(_wrapped(q[target]), posture.q_target) - q[target])
    smooth = np.abs(steps).max(initial=0.0) <= LARGEST_STEP
    return q, bool(reachable.all() and smooth and arm.within_limits(q).all())


def _wrapped(q: FloatArray) -> FloatArray:
    return q - TURN * np.rint(q / TURN)


def _continued(
    arm: GeneralArm,
    near: FloatArray,
    R: FloatArray,
    points: FloatArray,
    drift: FloatArray,
    target: int,
) -> tuple[FloatArray, bool]:
    """Returns the same of an arm without closed forms, from the target to both ends."""
    R_near, p_near = arm.forward(near[None])
    shift = points[target] - p_near
    course = follow_lines(arm, near[None], R_near, p_near, shift, np.zeros(1), SAMPLES)
    q, ok = np.empty((len(points), arm.axes)), bool(course.ok[0])
    W = spare_directions(arm, course.q[-1])
    start, met, det = newton(
        arm,
        course.q[-1],
        R[None],
        points[target][None],
        W,
        np.einsum("bsn,bn->bs", W, course.q[-1]),
    )
    ok &= bool(met.all())
    sign = np.sign(det[0])
    for rows in (np.arange(target, len(points)), np.arange(target, -1, -1)):
        q[rows], good = _one_way(arm, start[0], R, points[rows], drift[rows], W[0], float(sign))
        ok &= good
    return q, ok


def _one_way(
    arm: GeneralArm,
    start: FloatArray,
    R: FloatArray,
    points: FloatArray,
    drift: FloatArray,
    W: FloatArray,
    sign: float,
) -> tuple[FloatArray, bool]:
    """Returns joints from a first pose on: a few poses one after the other, then all between them at once."""
    q = np.tile(start, (len(points), 1))

    def met(rows: IntArray, guess: FloatArray) -> tuple[FloatArray, bool]:
        ahead = np.zeros((len(rows), arm.spare))
        ahead[:, :1] = drift[rows, None]
        planes = np.broadcast_to(W, (len(rows), *W.shape))
        turned = np.broadcast_to(R, (len(rows), 3, 3))
        found, good, det = newton(arm, guess, turned, points[rows], planes, ahead + W @ start)
        same = (np.sign(det) == sign) & (np.abs(det) > LEAST_PIVOT)
        return found, bool((good & same & arm.within_limits(found)).all())

    last = len(points) - 1
    few = np.unique(np.linspace(0, last, min(last, SKELETON) + 1).round().astype(np.int64))
    ok = True
    for k in range(1, len(few)):
        back = q[few[k - 1]]
        ratio = (few[k] - few[k - 1]) / (few[k - 1] - few[k - 2]) if k > 1 else 0.0
        guess = back + ratio * (back - q[few[k - 2]]) if k > 1 else back
        found, good = met(few[k : k + 1], guess[None])
        ok &= good and bool(np.abs(found[0] - back).max() <= LARGEST_STEP)
        q[few[k]] = found[0]
    rest = np.setdiff1d(np.arange(last + 1), few)
    if ok and len(rest):
        guess = np.column_stack([np.interp(rest, few, column) for column in q[few].T])
        q[rest], good = met(rest, guess)
        ok &= good and bool(np.abs(np.diff(q, axis=0)).max() <= LARGEST_STEP)
    return q, ok
