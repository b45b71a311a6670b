"""Least times of lines from the geometry of shoulder, wrist and elbow, for all arm angles.

The bound of `pose_cells` is better in most cells, but says nothing where the arm may be stretched; this one does.
"""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import arccos, arcsin, arctan2, sin
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.postures.platform_reach import AngleCells, turned, wrist_distances
from dualarm_cli.stages.plans.problem import ArmWork

Distances = tuple[FloatArray, FloatArray]
"""As of `wrist_distances`."""
STRETCHED = 0.95
"""Share of the farthest reach beyond which arms count as nearly stretched: elsewhere lines take 0 s."""
WIDEST = 0.004
"""Intervals of the platform angle are cut into parts of this width at most, looked at one by one [rad]."""


def line_bounds(
    work: ArmWork, R: FloatArray, wrist: FloatArray, end: FloatArray, cells: AngleCells
) -> FloatArray:
    """Returns the least time of a line of the wrist centre [s], shape (c,), over each interval of the platform angle.

    With the tool's orientation constant the wrist centre goes straight from one end to the other. In time T from rest
    to rest joint j turns D_j(T) at most, forth and back added up: a motion that turns back is nowhere faster than some
    motion that does not (between the greatest speeds v_i and v_k to either side of a turn, put v_k + (v + v_k)
    (v_i - v_k) / (v_i + v_k) for v, v_i >= v_k: never less than |v|, and its rates are scaled down).

    (a) The distance from the shoulder is joint 4's alone: D_4(T) is at least its difference between the ends. (b) The
    shoulder-wrist line turns by an angle beta about an axis m that stays, perpendicular to it. Joint 4 turns it
    against the upper arm by no more than alpha varies in all, and alpha follows from the distance. The rest is up to
    the joints before: axis 1 has a share |z1·m| of it, axis 2 (at right angles to it) at most the rest of a unit
    vector, axis 3 (the upper arm) at most sin alpha: beta - var(alpha) <= sum of the shares times D_j(T). Only the
    instants count at which the wrist is farther than ever before; so it may turn back on the line. (c) The same as the
    tool sees it, with the axes 7, 6, 5 and the forearm's angle gamma. Everything at its worst over the interval. Our
    own derivation.

    Args:
        work: the arm.
        R: flange rotation in the carried frame at platform angle zero, shape (3, 3).
        wrist: wrist centre at one end there [m], shape (3,).
        end: wrist centre at the other end [m], shape (3,).
        cells: intervals of the platform angle.
    """
    c = len(cells.index)
    found = np.zeros(c)
    if not c or norm(end - wrist) == 0.0:
        return found
    arm = work.closed_form
    shoulder = arm.geometry.shoulder
    away = [norm(turned(x, cells.middle) - shoulder, axis=1) for x in (wrist, end)]
    far = np.maximum(*away) + np.hypot(*shoulder[:2]) * cells.half
    some = np.flatnonzero(far > STRETCHED * arm.reach[1])
    if not len(some):
        return found
    begin, width = cells.low[some], (cells.high - cells.low)[some]
    count = max(1, int(np.ceil(width.max() / WIDEST)))
    low = (begin[:, None] + width[:, None] * np.arange(count) / count).ravel()
    parts = AngleCells(
        np.repeat(cells.index[some], count), low, low + np.repeat(width / count, count)
    )
    found[some] = _line_bounds(work, R, wrist, end, parts).reshape(-1, count).min(axis=1)
    return found


def _line_bounds(
    work: ArmWork, R: FloatArray, wrist: FloatArray, end: FloatArray, cells: AngleCells
) -> FloatArray:
    arm = work.closed_form
    geometry = arm.geometry
    ends = [wrist_distances(arm, x, cells) for x in (wrist, end)]
    v, w = (turned(x, cells.middle) - geometry.shoulder for x in (wrist, end))
    length = float(norm(end - wrist))
    # The shoulder goes round under the line: how far it gets from the interval's middle.
    away = float(np.hypot(*geometry.shoulder[:2])) * cells.half
    cross = np.cross(v, w)
    size = np.maximum(norm(cross, axis=1), 1e-12)
    axis = cross / size[:, None]
    beta = arctan2(size, (v * w).sum(axis=1))
    for nearest, _ in ends:
        beta -= _turn(away / np.maximum(nearest, 1e-12))
    # m = v × w changes by no more than |v - w| times the shoulder's way.
    tilt = 2.0 * sin(0.5 * _turn(length * away / size))
    near, far, passes = _distances(v, w, length, size, away, ends)
    near = np.maximum(near, arm.reach[0])
    upper, fore = geometry.upper, geometry.fore
    alpha, sin_alpha = _variation(upper, fore, near, far, passes)
    gamma, sin_gamma = _variation(fore, upper, near, far, passes)
    # Axis 1 turns with the platform, axis 7 stands in the world.
    first = np.abs(product(axis, geometry.axes[0]))
    seventh = turned(product(R, product(geometry.R_flange.T, geometry.axes[6])), cells.middle)
    last = np.abs((axis * seventh).sum(axis=1))
    shoulder_way = np.stack([*_shares(first, tilt + cells.half), sin_alpha])
    wrist_way = np.stack([*_shares(last, tilt), sin_gamma])
    bend = _turns_of_joint_4(upper, fore, *ends)
    return _least_time(work, bend, (beta - alpha, shoulder_way), (beta - gamma, wrist_way))


def _turn(ratio: FloatArray) -> FloatArray:
    """Returns by what angle a vector turns at most when its end moves by a share of its length [rad]."""
    return np.where(ratio < 1.0, arcsin(np.minimum(ratio, 1.0)), np.pi)


def _distances(
    v: FloatArray,
    w: FloatArray,
    length: float,
    size: FloatArray,
    away: FloatArray,
    ends: list[Distances],
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns least and greatest distance of shoulder and wrist [m], and whether the least is between the ends."""
    (near_1, far_1), (near_2, far_2) = ends
    far, nearer = np.maximum(far_1, far_2), np.minimum(near_1, near_2)
    # Where the foot of the shoulder's height lies along the line.
    place = -(v * (w - v)).sum(axis=1) / length
    passes = (place > -away) & (place < length + away)
    near = np.where(passes, np.minimum(size / length - away, nearer), nearer)
    return np.maximum(near, 1e-6), far, passes


def _variation(
    own: float, other: float, near: FloatArray, far: FloatArray, passes: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Returns how much a link's angle to the shoulder-wrist line varies at most in all [rad], and its greatest sine."""
    difference = np.square(own) - np.square(other)
    stationary = np.sqrt(max(difference, 0.0))
    turns = (stationary > near) & (stationary < far)
    cosines = np.stack(
        [
            np.clip((r * r + difference) / (2.0 * own * r), -1.0, 1.0)
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


def _shares(along: FloatArray, tilt: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Returns how much of a unit turn about m two axes at right angles can give, the first of them known."""
    least = np.clip(along - tilt, 0.0, 1.0)
    return np.minimum(along + tilt, 1.0), np.sqrt(1.0 - np.square(least))


def _turns_of_joint_4(
    upper: float,
    fore: float,
    one: Distances,
    other: Distances,
) -> FloatArray:
    """Returns by how much joint 4 turns at least between the ends of the line [rad], (c,)."""

    def bend(r: FloatArray) -> FloatArray:
        return arccos(
            np.clip((r * r - np.square(upper) - np.square(fore)) / (2.0 * upper * fore), -1.0, 1.0)
        )

    (high_1, low_1), (high_2, low_2) = map(bend, one), map(bend, other)
    return np.maximum(np.maximum(low_1 - high_2, low_2 - high_1), 0.0)


def _least_time(
    work: ArmWork,
    bend: FloatArray,
    shoulder: tuple[FloatArray, FloatArray],
    wrist: tuple[FloatArray, FloatArray],
) -> FloatArray:
    """Returns the least T at which joints 1 to 4, and 7 to 5, can turn far enough; less than a step of a table less."""
    step, way = work.law.reach_table
    low, high = np.zeros((2, len(bend)), dtype=np.int64)
    high += way.shape[1] - 1
    while (high - low > 1).any():
        middle = (low + high) // 2
        own = way[:, middle]
        fits = (
            (own[3] >= bend)
            & ((shoulder[1] * own[:3]).sum(axis=0) >= shoulder[0])
            & ((wrist[1] * own[:3:-1]).sum(axis=0) >= wrist[0])
        )
        high = np.where(fits, middle, high)
        low = np.where(fits, low, middle)
    return step * low.astype(np.float64)
