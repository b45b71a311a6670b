"""Self-motions of arms with one spare joint, and which postures they connect: branches."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.kinematics.continuation import JointPlanes, newton, spare_directions
from dualarm_cli.kinematics.serial_chain import SerialChain

CURVE_STEP = 0.25
"""Distance of samples along a self-motion [rad]."""
CURVE_SAMPLES = 40
"""Samples each way: a length of ten radians."""
SAME_CURVE = 0.02
"""A posture nearer than this to the chord of two samples of a self-motion lies on it [rad]: at CURVE_STEP a curve
that bends by 2 rad per rad leaves its chord by 0.016."""


def self_motions(arm: SerialChain, q: FloatArray, R: FloatArray, p: FloatArray) -> FloatArray:
    """Returns samples of the self-motions of seven-axis postures, CURVE_STEP apart, both ways, shape (s, b, n).

    In the order of the curves, the given postures in the middle; samples beyond a limit, or after a curve has come to a
    singularity, are nan. A curve that closes is run through more than once.

    Args:
        arm: an arm with one spare joint.
        q: postures that reach the poses [rad], shape (b, n).
        R: flange rotations, shape (b, 3, 3).
        p: flange positions [m], shape (b, 3).
    """
    W = spare_directions(arm, q)
    both = np.concatenate([W, -W])
    here = np.concatenate([q, q])
    R2, p2 = np.concatenate([R, R]), np.concatenate([p, p])
    found = np.full((CURVE_SAMPLES + 1, *here.shape), np.nan)
    found[0] = here
    going = np.arange(len(here))
    for k in range(1, CURVE_SAMPLES + 1):
        W, old = both[going], here[going]
        guess = old + CURVE_STEP * W[:, 0]
        planes = JointPlanes.through(W, guess)
        new, met, _ = newton(arm, guess, R2[going], p2[going], planes)
        met &= arm.within_limits(new) & (np.abs(new - guess).max(axis=1) <= CURVE_STEP)
        going, new = going[met], new[met]
        if not len(going):
            break
        here[going], found[k, going] = new, new
        both[going] = _carried(arm, new, W[met])
    n = len(q)
    return np.concatenate([found[:0:-1, n:], found[:, :n]])


def branches(arm: SerialChain, pose: IntArray, q: FloatArray, curves: FloatArray) -> IntArray:
    """Returns the branch of each of k seven-axis postures, shape (k,): numbers from 0 within each pose.

    Postures are of one branch if self-motion within limits leads from one to the other: if one lies on the traced
    curve of the other. That is sound where curves do not come nearer to each other than SAME_CURVE, which they do
    only close to a singularity where branches meet.

    Args:
        arm: the arm.
        pose: which pose each of them reaches, ascending, shape (k,).
        q: the postures [rad], shape (k, n).
        curves: samples of their self-motions, shape (s, k, n), nan where there is none.
    """
    branch = np.arange(len(pose))
    first = np.searchsorted(pose, pose)
    for d in range(1, len(pose)):
        one, other = np.arange(len(pose) - d), np.arange(d, len(pose))
        alike = pose[one] == pose[other]
        if not alike.any():
            break
        one, other = one[alike], other[alike]
        met = _on_curve(arm, q[other], curves[:, one]) | _on_curve(arm, q[one], curves[:, other])
        for i, j in zip(one[met].tolist(), other[met].tolist(), strict=True):
            branch[branch == branch[j]] = branch[i]
    return branch - first


def _on_curve(arm: SerialChain, q: FloatArray, curves: FloatArray) -> BoolArray:
    """Returns which postures (k, n) are nearer than SAME_CURVE to chords of samples (s, k, n)."""
    a, chord = curves[:-1], np.diff(curves, axis=0)
    away = arm.less_turns(q - a)
    squared = np.maximum((chord * chord).sum(axis=2), 1e-300)
    share = np.clip((away * chord).sum(axis=2) / squared, 0.0, 1.0)
    distance = np.abs(away - share[..., None] * chord).max(axis=2)
    return np.asarray((np.where(np.isnan(distance), np.inf, distance) < SAME_CURVE).any(axis=0))


def _carried(arm: SerialChain, q: FloatArray, W: FloatArray) -> FloatArray:
    """Returns the directions of self-motion (b, 1, n) at postures (b, n) on the side of those before."""
    new = spare_directions(arm, q)
    same = np.einsum("bsn,bsn->bs", new, W)
    return new * np.where(same < 0.0, -1.0, 1.0)[..., None]
