"""How long a straight line takes at least, whatever the arm angle does on it."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.minimum_time.bound_reach import AngleCells, ShapeRates, shape_rates, turned
from dualarm_cli.minimum_time.problem import ArmWork

BISECTIONS = 30
"""Halvings of the time: known to a billionth of its first guess, and the lower end is taken."""


def line_bounds(
    work: ArmWork, wrist: FloatArray, end: FloatArray, cells: AngleCells
) -> FloatArray:
    """Returns the least time of a line of the wrist centre [s], shape (c,), over each interval of the platform angle.

    With the tool's orientation constant the wrist centre moves straight from one end to the other. In time T from rest to
    rest joint j turns D_j(T) at most in all. (a) The distance from the shoulder is joint 4's alone: D_4(T) is at least
    its difference between the ends. (b) The shoulder-wrist line turns by an angle beta about an axis m that stays: the
    axes 1, 2, 3 have at most |z1·m|, the rest of a unit vector, and the sine of the upper arm's angle to the line along
    m; joint 4 turns the line by at most fore / r: beta <= sum of those times D_j(T). (c) The same as the tool
    sees it, with axes 7, 6, 5 and the links exchanged. Everything at its worst over the interval. Our own derivation.

    Args:
        work: the arm.
        wrist: wrist centre at one end, in the carried frame at platform angle zero [m], shape (3,).
        end: wrist centre at the other end, likewise.
        cells: intervals of the platform angle.
    """
    arm = work.kinematics
    geometry = arm.geometry
    shoulder = geometry.shoulder
    c = len(cells.index)
    if not c or np.linalg.norm(end - wrist) == 0.0:
        return np.zeros(c)
    one, other = (shape_rates(arm, w, cells) for w in (wrist, end))
    v, w = (turned(x, cells.middle) - shoulder for x in (wrist, end))
    radius = float(np.hypot(*shoulder[:2]))
    # The shoulder goes round under the wrist: how far it gets from the interval's middle.
    away = radius * cells.half
    cross = np.cross(v, w)
    size = np.linalg.norm(cross, axis=1)
    length = float(np.linalg.norm(end - wrist))
    # Between the ends of the line the distance is least at one of them or at the foot of the shoulder's height.
    far = np.maximum(one.distance_high, other.distance_high)
    foot = np.maximum(size / length - away, 1e-6)
    near = np.maximum(np.minimum(foot, np.minimum(one.distance_low, other.distance_low)), 1e-6)
    near = np.maximum(near, arm.reach[0])
    # sin(beta) = |v × w| / (|v| |w|), less what the interval changes in it at most.
    lengths = np.linalg.norm(v, axis=1) * np.linalg.norm(w, axis=1)
    beta = np.arctan2(size, (v * w).sum(axis=1))
    turn = away / np.maximum(one.distance_low, 1e-6) + away / np.maximum(other.distance_low, 1e-6)
    beta = np.where(lengths > 0, np.maximum(beta - turn, 0.0), 0.0)
    axis = cross / np.maximum(size, 1e-12)[:, None]
    # m = v × w moves by no more than |v - w| times the shoulder's way; as a direction by that over its size.
    # Seen from the carried frame it turns with the platform besides.
    tilt = np.minimum(length * away / np.maximum(size, 1e-12) + cells.half, 2.0)
    uppers = _shares(np.abs(axis @ geometry.axes[0]), tilt)
    bends = np.maximum(one.sin_upper, other.sin_upper), np.maximum(one.sin_fore, other.sin_fore)
    bend_4 = _turns_of_joint_4(geometry.upper, geometry.fore, one, other)
    shoulder_way = np.stack(
        [*uppers, _reach_sine(geometry.upper, geometry.fore, near, far, bends[0]), geometry.fore / near]
    )
    tools = (np.ones(c), np.ones(c))
    wrist_way = np.stack(
        [*tools, _reach_sine(geometry.fore, geometry.upper, near, far, bends[1]), geometry.upper / near]
    )
    return _least_time(work, beta, bend_4, shoulder_way, wrist_way)


def _shares(along: FloatArray, tilt: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Returns how much of a unit turn about m the axes 1 and 2 (at right angles) can give."""
    first = np.minimum(along + tilt, 1.0)
    least = np.maximum(along - tilt, 0.0)
    return first, np.sqrt(1.0 - least**2)


def _reach_sine(
    own: float, other: float, near: FloatArray, far: FloatArray, ends: FloatArray
) -> FloatArray:
    """Returns the greatest sine of a link's angle to the shoulder-wrist line for distances from near to far."""
    difference = own**2 - other**2
    cosines = np.stack(
        [
            np.clip((r * r + difference) / (2.0 * own * r), -1.0, 1.0)
            for r in (near, far, np.clip(np.sqrt(max(difference, 0.0)), near, far))
        ]
    )
    straddles = (cosines.min(axis=0) <= 0.0) & (cosines.max(axis=0) >= 0.0)
    sine = np.where(straddles, 1.0, np.sqrt(1.0 - np.abs(cosines).min(axis=0) ** 2))
    return np.maximum(sine, ends)


def _turns_of_joint_4(upper: float, fore: float, one: ShapeRates, other: ShapeRates) -> FloatArray:
    """Returns by how much joint 4 turns at least between the ends of the line [rad], (c,)."""

    def bend(r: FloatArray) -> FloatArray:
        return np.arccos(np.clip((r * r - upper**2 - fore**2) / (2.0 * upper * fore), -1.0, 1.0))

    low_1, high_1 = bend(one.distance_high), bend(one.distance_low)
    low_2, high_2 = bend(other.distance_high), bend(other.distance_low)
    return np.maximum(np.maximum(low_1 - high_2, low_2 - high_1), 0.0)


def _least_time(
    work: ArmWork,
    beta: FloatArray,
    bend_4: FloatArray,
    shoulder_way: FloatArray,
    wrist_way: FloatArray,
) -> FloatArray:
    """Returns the least T at which joints 1 to 4, and 7 to 4, can turn far enough."""
    enough = np.full(len(beta), float(work.law.duration(np.full(7, np.pi))))
    low, high = np.zeros(len(beta)), enough
    for _ in range(BISECTIONS):
        time = 0.5 * (low + high)
        way = work.law.reachable_distance(time[:, None])
        fits = (
            (way[:, 3] >= bend_4)
            & ((shoulder_way * way[:, [0, 1, 2, 3]].T).sum(axis=0) >= beta)
            & ((wrist_way * way[:, [6, 5, 4, 3]].T).sum(axis=0) >= beta)
        )
        high = np.where(fits, time, high)
        low = np.where(fits, low, time)
    return low
