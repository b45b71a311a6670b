"""Self-motions of arms with one redundant joint, and the branches that they connect."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.kinematics.continuation import JointPlanes, newton, spare_directions
from dualarm_cli.kinematics.serial_chain import SerialChain

CURVE_STEP = 0.25
"""Distance of samples along a self-motion [rad]."""
CURVE_SAMPLES = 40
"""Number of samples in each direction: a length of ten radians."""
SAME_CURVE = 0.02
"""Distance from sample chords up to which a posture is on the curve [rad].

At CURVE_STEP a curve that bends by 2 rad per rad leaves its chord by 0.016.
"""


def self_motions(arm: SerialChain, q: FloatArray, R: FloatArray, p: FloatArray) -> FloatArray:
    """Sample the self-motions of seven-axis postures in both directions, shape (s, b, n).

    Samples are CURVE_STEP apart, the given postures in the middle; beyond a limit or a singularity they are nan. A
    closed curve may be traversed more than once.

    Args:
        arm: an arm with one redundant joint.
        q: postures that reach the poses [rad], shape (b, n).
        R: flange rotations, shape (b, 3, 3).
        p: flange positions [m], shape (b, 3).
    """
    W = spare_directions(arm, q)
    directions = np.concatenate([W, -W])
    current = np.concatenate([q, q])
    R2, p2 = np.concatenate([R, R]), np.concatenate([p, p])
    samples = np.full((CURVE_SAMPLES + 1, *current.shape), np.nan)
    samples[0] = current
    active = np.arange(len(current))
    for k in range(1, CURVE_SAMPLES + 1):
        W, old = directions[active], current[active]
        guess = old + CURVE_STEP * W[:, 0]
        planes = JointPlanes.through(W, guess)
        new, met, _ = newton(arm, guess, R2[active], p2[active], planes)
        met &= arm.within_limits(new) & (np.abs(new - guess).max(axis=1) <= CURVE_STEP)
        active, new = active[met], new[met]
        if not len(active):
            break
        current[active], samples[k, active] = new, new
        directions[active] = _aligned_directions(arm, new, W[met])
    n = len(q)
    return np.concatenate([samples[:0:-1, n:], samples[:, :n]])


def branches(arm: SerialChain, pose: IntArray, q: FloatArray, curves: FloatArray) -> IntArray:
    """Number the branches of seven-axis postures, from 0 within each pose, shape (k,).

    Postures are of one branch if self-motion within limits leads from one to the other: if one lies on the traced
    curve of the other. That is sound if curves do not come nearer to each other than SAME_CURVE, as they
    do only near a singularity at which branches meet.

    Args:
        arm: the arm.
        pose: number of the pose that each posture reaches, ascending, shape (k,).
        q: the postures [rad], shape (k, n).
        curves: samples of their self-motions, shape (s, k, n), nan if missing.
    """
    branch = np.arange(len(pose))
    first = np.searchsorted(pose, pose)
    for d in range(1, len(pose)):
        first_row, second_row = np.arange(len(pose) - d), np.arange(d, len(pose))
        alike = pose[first_row] == pose[second_row]
        if not alike.any():
            break
        first_row, second_row = first_row[alike], second_row[alike]
        met = _on_curve(arm, q[second_row], curves[:, first_row]) | _on_curve(
            arm, q[first_row], curves[:, second_row]
        )
        for i, j in zip(first_row[met].tolist(), second_row[met].tolist(), strict=True):
            branch[branch == branch[j]] = branch[i]
    return branch - first


def _on_curve(arm: SerialChain, q: FloatArray, curves: FloatArray) -> BoolArray:
    """Flag postures (k, n) nearer than SAME_CURVE to chords of samples (s, k, n)."""
    a, chord = curves[:-1], np.diff(curves, axis=0)
    offset = arm.less_turns(q - a)
    squared = np.maximum((chord * chord).sum(axis=2), 1e-300)
    fraction = np.clip((offset * chord).sum(axis=2) / squared, 0.0, 1.0)
    distance = np.abs(offset - fraction[..., None] * chord).max(axis=2)
    return np.asarray((np.where(np.isnan(distance), np.inf, distance) < SAME_CURVE).any(axis=0))


def _aligned_directions(arm: SerialChain, q: FloatArray, W: FloatArray) -> FloatArray:
    """Compute self-motion directions (b, 1, n) at postures, aligned with previous ones."""
    new = spare_directions(arm, q)
    same = np.einsum("bsn,bsn->bs", new, W)
    return new * np.where(same < 0.0, -1.0, 1.0)[..., None]
