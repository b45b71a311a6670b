"""Least times of lines of nearly stretched arms, from shoulder-wrist geometry.

The bound of `pose_cells` is better in most cells, but is zero where the arm may be stretched.
"""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import arccos, arcsin, arctan2, sin
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.postures.platform_reach import AngleCells, turned, wrist_distances
from dualarm_cli.stages.plans.problem import ArmWork

Distances = tuple[FloatArray, FloatArray]
"""Least and greatest shoulder-wrist distances [m], as of `wrist_distances`."""
STRETCHED = 0.95
"""Fraction of the maximum reach beyond which arms count as nearly stretched."""
WIDEST = 0.004
"""Maximum width of the parts of a platform interval that are bounded separately [rad]."""


def line_bounds(
    work: ArmWork, R: FloatArray, wrist: FloatArray, end: FloatArray, cells: AngleCells
) -> FloatArray:
    """Compute the least time of a wrist line over platform intervals [s], shape (c,).

    Zero for arms that are not nearly stretched. With constant tool orientation the wrist centre moves straight from one
    end to the other. In time T from rest to rest joint j travels D_j(T) or less, back and forth added up: a motion with
    reversals is nowhere faster than some motion without (between the greatest speeds v_i and v_k to either side of a
    reversal, put v_k + (v + v_k) (v_i - v_k) / (v_i + v_k) for v, v_i >= v_k: never less than |v|, and its rates are
    scaled down).

    (a) Joint 4 alone decides the distance from the shoulder: D_4(T) is at least its difference between the ends. (b)
    The shoulder-wrist line turns by an angle beta about a constant axis m, perpendicular to it. Joint 4 turns it
    against the upper arm by the total variation of alpha or less, and alpha follows from the distance. The remainder
    comes from the joints before: axis 1 contributes a fraction |z1·m|, axis 2 (at right angles to it) no more than the
    remainder of a unit vector, axis 3 (the upper arm) no more than sin alpha: beta - var(alpha) <= sum of the fractions
    times D_j(T). Only instants count at which the wrist is farther along the line than before, so that it may reverse.
    (c) The same seen from the tool, with axes 7, 6, 5 and the forearm's angle gamma. Every term takes its worst value
    over the interval. Our own derivation.

    Args:
        work: the arm.
        R: flange rotation in the carried frame at platform angle zero, shape (3, 3).
        wrist: wrist centre at one end there [m], shape (3,).
        end: wrist centre at the other end [m], shape (3,).
        cells: intervals of the platform angle.
    """
    c = len(cells.index)
    times = np.zeros(c)
    if not c or norm(end - wrist) == 0.0:
        return times
    arm = work.closed_form
    shoulder = arm.geometry.shoulder
    distances = [norm(turned(x, cells.middle) - shoulder, axis=1) for x in (wrist, end)]
    far = np.maximum(*distances) + np.hypot(*shoulder[:2]) * cells.half
    stretched = np.flatnonzero(far > STRETCHED * arm.reach[1])
    if not len(stretched):
        return times
    begin, width = cells.low[stretched], (cells.high - cells.low)[stretched]
    count = max(1, int(np.ceil(width.max() / WIDEST)))
    low = (begin[:, None] + width[:, None] * np.arange(count) / count).ravel()
    parts = AngleCells(
        np.repeat(cells.index[stretched], count), low, low + np.repeat(width / count, count)
    )
    times[stretched] = _line_bounds(work, R, wrist, end, parts).reshape(-1, count).min(axis=1)
    return times


def _line_bounds(
    work: ArmWork, R: FloatArray, wrist: FloatArray, end: FloatArray, cells: AngleCells
) -> FloatArray:
    arm = work.closed_form
    geometry = arm.geometry
    ends = [wrist_distances(arm, x, cells) for x in (wrist, end)]
    v, w = (turned(x, cells.middle) - geometry.shoulder for x in (wrist, end))
    length = float(norm(end - wrist))
    # The platform moves the shoulder: its distance from the position at the interval's middle.
    shoulder_shift = float(np.hypot(*geometry.shoulder[:2])) * cells.half
    cross = np.cross(v, w)
    size = np.maximum(norm(cross, axis=1), 1e-12)
    axis = cross / size[:, None]
    beta = arctan2(size, (v * w).sum(axis=1))
    for nearest, _ in ends:
        beta -= _turn(shoulder_shift / np.maximum(nearest, 1e-12))
    # m = v × w changes by no more than |v - w| times the shoulder's displacement.
    tilt = 2.0 * sin(0.5 * _turn(length * shoulder_shift / size))
    near, far, passes = _distances(v, w, length, size, shoulder_shift, ends)
    near = np.maximum(near, arm.reach[0])
    upper, fore = geometry.upper, geometry.fore
    alpha, sin_alpha = _variation(upper, fore, near, far, passes)
    gamma, sin_gamma = _variation(fore, upper, near, far, passes)
    # Axis 1 turns with the platform, axis 7 is fixed in the world.
    first = np.abs(product(axis, geometry.axes[0]))
    seventh = turned(product(R, product(geometry.R_flange.T, geometry.axes[6])), cells.middle)
    last = np.abs((axis * seventh).sum(axis=1))
    shoulder_turn = np.stack([*_fractions(first, tilt + cells.half), sin_alpha])
    wrist_turn = np.stack([*_fractions(last, tilt), sin_gamma])
    bend = _turns_of_joint_4(upper, fore, *ends)
    return _least_time(work, bend, (beta - alpha, shoulder_turn), (beta - gamma, wrist_turn))


def _turn(ratio: FloatArray) -> FloatArray:
    """Compute the largest turn of a vector from its end's relative displacement [rad]."""
    return np.where(ratio < 1.0, arcsin(np.minimum(ratio, 1.0)), np.pi)


def _distances(
    v: FloatArray,
    w: FloatArray,
    length: float,
    size: FloatArray,
    shoulder_shift: FloatArray,
    ends: list[Distances],
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute least and greatest shoulder-wrist distance [m], and whether the least is inside."""
    (near_1, far_1), (near_2, far_2) = ends
    far, nearer = np.maximum(far_1, far_2), np.minimum(near_1, near_2)
    # Position along the line of the point nearest to the shoulder [m].
    foot = -(v * (w - v)).sum(axis=1) / length
    passes = (foot > -shoulder_shift) & (foot < length + shoulder_shift)
    near = np.where(passes, np.minimum(size / length - shoulder_shift, nearer), nearer)
    return np.maximum(near, 1e-6), far, passes


def _variation(
    link: float, other_link: float, near: FloatArray, far: FloatArray, passes: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Bound the total variation and sine of a link's angle to the shoulder-wrist line.

    Returns the variation [rad] and the greatest sine, both (c,).
    """
    difference = np.square(link) - np.square(other_link)
    stationary = np.sqrt(max(difference, 0.0))
    turns = (stationary > near) & (stationary < far)
    cosines = np.stack(
        [
            np.clip((r * r + difference) / (2.0 * link * r), -1.0, 1.0)
            for r in (near, far, np.clip(stationary, near, far))
        ]
    )
    least, most = cosines.min(axis=0), cosines.max(axis=0)
    swept = arccos(least) - arccos(most)
    straddles = (least <= 0.0) & (most >= 0.0)
    sine = np.where(
        straddles, 1.0, np.sqrt(1.0 - np.square(np.minimum(np.abs(least), np.abs(most))))
    )
    return swept * np.where(passes, 2.0, 1.0) * np.where(turns, 2.0, 1.0), sine


def _fractions(along: FloatArray, tilt: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Bound the fractions of a unit turn about m from two orthogonal axes."""
    least = np.clip(along - tilt, 0.0, 1.0)
    return np.minimum(along + tilt, 1.0), np.sqrt(1.0 - np.square(least))


def _turns_of_joint_4(
    upper: float,
    fore: float,
    start: Distances,
    end: Distances,
) -> FloatArray:
    """Compute the least travel of joint 4 along a line [rad], shape (c,)."""

    def bend(r: FloatArray) -> FloatArray:
        return arccos(
            np.clip((r * r - np.square(upper) - np.square(fore)) / (2.0 * upper * fore), -1.0, 1.0)
        )

    (high_1, low_1), (high_2, low_2) = map(bend, start), map(bend, end)
    return np.maximum(np.maximum(low_1 - high_2, low_2 - high_1), 0.0)


def _least_time(
    work: ArmWork,
    bend: FloatArray,
    shoulder: tuple[FloatArray, FloatArray],
    wrist: tuple[FloatArray, FloatArray],
) -> FloatArray:
    """Compute the least time in which the joints can travel far enough [s].

    Joints 1 to 4, and 7 to 5. Rounded down to a step of the table.
    """
    step, travel = work.law.reach_table
    low, high = np.zeros((2, len(bend)), dtype=np.int64)
    high += travel.shape[1] - 1
    while (high - low > 1).any():
        middle = (low + high) // 2
        row = travel[:, middle]
        fits = (
            (row[3] >= bend)
            & ((shoulder[1] * row[:3]).sum(axis=0) >= shoulder[0])
            & ((wrist[1] * row[:3:-1]).sum(axis=0) >= wrist[0])
        )
        high = np.where(fits, middle, high)
        low = np.where(fits, low, middle)
    return step * low.astype(np.float64)
