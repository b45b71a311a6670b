"""Numeric inverse kinematics of any serial arm: damped least squares from many starts."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.geometry.linear_systems import solve
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.kinematics.posture_source import ReachedPostures
from dualarm_cli.kinematics.serial_chain import SerialChain, pose_error
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class InverseSettings:
    """Starts, rounds, steps and tolerances of numeric inverse kinematics."""

    starts: int = 32
    """Number of starts of a round for each pose."""
    few_starts: int = 12
    """Number of starts per round and pose in a search that is not thorough."""
    max_rounds: int = 16
    """Maximum number of rounds; redundant arms end with the first solution."""
    quiet_rounds: int = 4
    """Consecutive rounds without a new solution that end the search."""
    few_rounds: int = 2
    """Consecutive rounds without a new solution that end a search that is not thorough."""
    far: float = 1e-3
    """Error above which a pose is dropped after `quiet_rounds` [m and rad]."""
    drop_residual: float = 0.05
    """Error above which a pose is dropped after two rounds [m and rad]."""
    iterations: int = 40
    """Maximum number of damped steps from one start."""
    stalled: float = 0.7
    """Ratio of errors `check_steps` apart from which a start is dropped."""
    check_steps: int = 6
    """Number of steps between two comparisons of a start's error."""
    largest_step: float = 1.0
    """Longest step of a joint in an iteration [rad or m]."""
    close: float = 1e-12
    """Weighted error at which a start has converged, before polishing."""
    same: float = 1e-5
    """Largest difference of joints of the same solution [rad]."""
    no_progress: float = 0.9999
    """Ratio of errors `check_steps` apart that ends a least-distance descent."""
    turned: float = 1e-2
    """Largest error of the rotation at which a least distance is valid [rad]."""
    primes: tuple[int, ...] = (2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37)
    """Bases of the Halton sequence of starts, one for each joint."""
    residual: float = 1e-10
    """Largest error of a solution [m and rad]."""


INVERSE = InverseSettings()


def solve_poses(
    arm: SerialChain,
    R: FloatArray,
    p: FloatArray,
    *,
    first_only: bool = False,
    thorough: bool = True,
) -> ReachedPostures:
    """Solve for postures within limits that reach flange poses, many for each.

    Levenberg's damped least squares with the damping of [Sugihara2011] (half the squared error), from starts that
    fill the limits evenly ([Halton1960], so that the same poses have the same solutions); a joint at a limit that
    would leave it is held in that step. Converged starts are polished by undamped steps to `residual`.

    With six joints solutions are isolated: rounds of starts go on until `quiet_rounds` bring nothing new. No
    completeness is claimed; thousands of random starts find the same sets (tested). With more joints every start has
    a solution of its own on the curves of self-motion; rounds go on until there is one. Branches are numbers from 0
    within each pose.

    Args:
        arm: kinematics and limits.
        R: flange rotations in the carried frame, shape (m, 3, 3).
        p: flange positions [m], shape (m, 3).
        first_only: whether the search of a pose ends with its first solution.
        thorough: whether all solutions (six joints) or many are searched, or few.
    """
    m = len(p)
    found_pose, found_q = np.empty(0, dtype=np.int64), np.empty((0, arm.axes))
    miss = np.full((m, 2), np.inf)
    # No posture reaches farther than all links together.
    is_far = norm(p - arm.p_parent_joint[0], axis=1) > arm.farthest
    open_poses, quiet = np.flatnonzero(~is_far), np.zeros(m, dtype=np.int64)
    count, calm = (
        (INVERSE.starts, INVERSE.quiet_rounds)
        if thorough
        else (INVERSE.few_starts, INVERSE.few_rounds)
    )
    for k in range(INVERSE.max_rounds):
        if not len(open_poses):
            break
        # With isolated solutions every second round may pass limits: its basins of attraction differ.
        descent = arm.without_limits if arm.spare == 0 and k % 2 == 1 else arm
        starts = _halton(descent, k * count, count)
        pose = np.repeat(open_poses, len(starts))
        q, error = descend(descent, R[pose], p[pose], np.tile(starts, (len(open_poses), 1)))
        q = arm.nearest_turns(q, arm.middle)
        inside = arm.within_limits(q)
        miss = _least_miss(miss, pose[inside], error[inside])
        is_solution = (error <= INVERSE.residual).all(axis=1) & inside
        q = q[is_solution]
        before = np.bincount(found_pose, minlength=m)
        found_pose, found_q = _distinct(
            arm, np.concatenate([found_pose, pose[is_solution]]), np.concatenate([found_q, q])
        )
        now = np.bincount(found_pose, minlength=m)
        quiet = np.where(now > before, 0, quiet + 1)
        enough = arm.spare > 0 or first_only
        finished = (now > 0) if enough else (quiet >= calm) & (now > 0)
        finished |= (quiet >= INVERSE.quiet_rounds) & (miss.max(axis=1) > INVERSE.far)
        finished |= (k > 0) & (miss.max(axis=1) > INVERSE.drop_residual)
        open_poses = open_poses[~finished[open_poses]]
    miss[np.bincount(found_pose, minlength=m) > 0] = 0.0
    branch = np.arange(len(found_pose)) - np.searchsorted(found_pose, found_pose)
    return ReachedPostures(found_pose, found_q, branch, miss)


def least_distances(arm: SerialChain, R: FloatArray, p: FloatArray) -> FloatArray:
    """Search the flange's least distances from poses [m], shape (m,), with rotations met.

    Descents from many starts in which rotation counts so much more than position that it is met.

    Args:
        arm: kinematics and limits.
        R: flange rotations, shape (m, 3, 3).
        p: flange positions [m], shape (m, 3).
    """
    starts = _halton(arm, 0, 2 * INVERSE.starts)
    pose = np.repeat(np.arange(len(p)), len(starts))
    _, error = descend(arm, R[pose], p[pose], np.tile(starts, (len(p), 1)), turned=True)
    distance = np.where(error[:, 1] < INVERSE.turned, error[:, 0], np.inf)
    least: FloatArray = distance.reshape(len(p), -1).min(axis=1)
    return least


def descend(
    arm: SerialChain, R: FloatArray, p: FloatArray, starts: FloatArray, *, turned: bool = False
) -> tuple[FloatArray, FloatArray]:
    """Descend by damped least squares to joints (b, n), errors (b, 2).

    Errors are distances [m] and angles [rad].

    Args:
        arm: kinematics and limits.
        R: wanted rotations, shape (b, 3, 3).
        p: wanted positions [m], shape (b, 3).
        starts: joints within limits [rad], shape (b, n).
        turned: whether rotation has to be met, and distance is minimised.
    """
    q = np.array(starts)
    weight = np.concatenate([np.full(3, 2.0 / arm.length), np.full(3, 50.0 if turned else 1.0)])
    active = np.arange(len(q))
    last = np.full(len(q), np.inf)
    for k in range(5 * INVERSE.iterations if turned else INVERSE.iterations):
        R_now, p_now, J = arm.linearised(q[active])
        e = pose_error(R_now, p_now, R[active], p[active]) * weight
        size = norm(e, axis=1)
        going = size > INVERSE.close
        if k and k % INVERSE.check_steps == 0:
            going &= size < (INVERSE.no_progress if turned else INVERSE.stalled) * last[active]
            last[active] = size
        elif k == 0:
            last[active] = size
        if not going.any():
            break
        active, e, J, size = active[going], e[going], J[going] * weight[:, None], size[going]
        # With an error that remains, a stretched arm oscillates about its best posture unless it is damped more.
        damping = 0.5 * (np.maximum(size, size * size) if turned else size * size)
        q[active] = _damped_step(arm, q[active], J, e, damping)
    return polished(arm, R, p, q)


def _damped_step(
    arm: SerialChain, q: FloatArray, J: FloatArray, e: FloatArray, damping: FloatArray
) -> FloatArray:
    """Take one damped step (Levenberg in the dual form) with joints at limits fixed."""
    gradient = product(np.swapaxes(J, 1, 2), e[:, :, None])[..., 0]
    is_fixed = ((q <= arm.lower) & (gradient < 0.0)) | ((q >= arm.upper) & (gradient > 0.0))
    J = np.where(is_fixed[:, None], 0.0, J)
    A = product(J, np.swapaxes(J, 1, 2))
    A[:, range(6), range(6)] += (damping + 1e-14)[:, None]
    step = product(np.swapaxes(J, 1, 2), solve(A, e[:, :, None]))[..., 0]
    longest = np.abs(step).max(axis=1, keepdims=True)
    step *= np.minimum(1.0, INVERSE.largest_step / np.maximum(longest, 1e-300))
    return np.clip(q + step, arm.lower, arm.upper)


def polished(
    arm: SerialChain, R: FloatArray, p: FloatArray, q: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Polish joints by undamped steps that help, and return their errors."""
    q, best = np.array(q), np.full((len(q), 2), np.inf)
    trial = q
    for _ in range(3):
        R_now, p_now, J = arm.linearised(trial)
        e = pose_error(R_now, p_now, R, p)
        error = np.stack([norm(e[:, :3], axis=1), norm(e[:, 3:], axis=1)], axis=1)
        better = error.sum(axis=1) < best.sum(axis=1)
        q[better], best[better] = trial[better], error[better]
        is_near = best.sum(axis=1) < 1e-4
        if not is_near.any():
            break
        A = product(J, np.swapaxes(J, 1, 2))
        A[:, range(6), range(6)] += 1e-15
        step = product(np.swapaxes(J, 1, 2), solve(A, e[:, :, None]))[..., 0]
        trial = np.clip(np.where(is_near[:, None], q + step, q), arm.lower, arm.upper)
    return q, best


def _halton(arm: SerialChain, first: int, count: int) -> FloatArray:
    """Create starts (count, n) that fill the limits evenly, in at most a turn."""
    index = np.arange(first + 20, first + 20 + count)
    fraction = np.zeros((count, arm.axes))
    for k in range(arm.axes):
        base, remaining, digit = INVERSE.primes[k % len(INVERSE.primes)], index.copy(), 1.0
        while remaining.any():
            digit /= base
            fraction[:, k] += digit * (remaining % base)
            remaining //= base
    half = np.full(arm.axes, np.pi)
    for k in arm.slides:
        if np.isfinite(arm.upper[k] - arm.lower[k]):
            half[k] = 0.5 * (arm.upper[k] - arm.lower[k])
    low = np.maximum(arm.lower, arm.middle - half)
    high = np.minimum(arm.upper, arm.middle + half)
    return low + fraction * (high - low)


def _least_miss(miss: FloatArray, pose: IntArray, error: FloatArray) -> FloatArray:
    """Update the least error of each pose, by the sum of metres and rad."""
    order = np.lexsort((error.sum(axis=1), pose))
    first = order[np.diff(pose[order], prepend=-1) > 0]
    least = miss.copy()
    better = error[first].sum(axis=1) < miss[pose[first]].sum(axis=1)
    least[pose[first][better]] = error[first][better]
    return least


def _distinct(arm: SerialChain, pose: IntArray, q: FloatArray) -> tuple[IntArray, FloatArray]:
    """Remove repeated solutions of each pose, in stable order."""
    order = np.argsort(pose, kind="stable")
    pose, q = pose[order], q[order]
    is_new: BoolArray = np.ones(len(pose), dtype=np.bool_)
    # Entry k against the one d places before it, as long as any two of those belong to one pose.
    for d in range(1, len(pose)):
        alike = pose[d:] == pose[:-d]
        if not alike.any():
            break
        turned = arm.less_turns(q[d:] - q[:-d])
        is_new[d:] &= ~(alike & (np.abs(turned).max(axis=1) < INVERSE.same))
    return pose[is_new], q[is_new]
