"""The cells of the bound in numpy, as `bound/cells.py` describes them: what the compiled ones are compared with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from dualarm_cli.bound.cells import Cells, finer_edges, free_cells
from dualarm_cli.effort import Resolution
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.kinematics.platform_chain import rotation_z
from dualarm_cli.kinematics.srs.arm_angle_curves import flips
from dualarm_cli.kinematics.srs.srs_arm import SrsArm
from dualarm_cli.postures.platform_reach import (
    AngleCells,
    ShapeRates,
    reachable_cells,
    shape_rates,
)

SINGULAR = 1e-3
"""Sine of joint 2 (6) below which no bound divides by it."""
TURN = 2.0 * np.pi
SHOULDER, WRIST = (0, 1, 2), (6, 5, 4)
"""Outer joint, middle joint and joint along the link of both triples: the wrist is a shoulder seen from the tool."""


@dataclass(frozen=True)
class Enclosures:
    """Ranges of all joints over c intervals of the platform angle and k of the arm angle, of any turn.

    A branch takes of every joint one of two values (see `arm_angle_curves.flips`).
    """

    low: FloatArray
    """Lowest position [rad], shape (7, 2, c, k); -inf where nothing is known."""
    high: FloatArray
    """Highest position [rad], shape (7, 2, c, k); inf where nothing is known."""


def enclosures(
    arm: SrsArm,
    R: FloatArray,
    p: FloatArray,
    intervals: AngleCells,
    rates: ShapeRates,
    parts: int,
) -> Enclosures:
    """Returns ranges that hold for every posture of a flange pose that stands in the world.

    Over each interval of the platform angle the arm plane is carried along from the middle by the smallest rotation of
    the shoulder-wrist line, and the circle of elbows is cut into equal parts: a box in (phi, psi). Joints 1 and 2 are
    azimuth and polar angle of the upper arm seen from the carried frame, joint 3 is the azimuth of axis 1 seen from the
    upper arm, at the same polar angle; joints 7, 6, 5 likewise with the forearm, seen from the tool. Each is the
    direction of a unit vector that moves at bounded rates (`ShapeRates`), so with s the least sine of the polar angle
    and d the farthest that the vector is from where it is at the nearest corner:

    - the polar angle is within d of a corner's;
    - the azimuth is within d / s, and within asin(sin d / sin theta) with a corner's theta, of a corner's;
    - a smooth function on a box lies between its corners, give or take (M_phi h_phi² + M_psi h_psi²) / 2, with
      half-widths h and bounds M of its second derivatives (bilinear interpolation): for an azimuth
      |q''| <= a2/s + 2 a1²/s², for a polar angle |q''| <= (a2 + a1²)/s.

    The least of these counts. Joint 4 depends on the distance alone. Our own derivation.

    Args:
        arm: kinematics in the carried frame.
        R: flange rotation in the carried frame at platform angle zero, shape (3, 3).
        p: flange position there [m], shape (3,).
        intervals: of the platform angle; c of them.
        rates: of the arm's shape in them.
        parts: k, into how many the circle of elbows is cut.
    """
    corners = _corners(arm, R, p, intervals, parts)
    h_phi, h_psi = intervals.half[:, None], np.pi / parts
    low, high = (np.empty((7, 2, len(intervals.index), parts)) for _ in range(2))
    groups = (
        (SHOULDER, rates.shoulder_first, rates.shoulder_second, rates.sin_upper),
        (WRIST, rates.wrist_first, rates.wrist_second, rates.sin_fore),
    )
    offset = arm.canonical.offset
    for (outer, middle, along), first, second, sine in groups:
        a_1, a_2, b = first[:, None], second[:, None], sine[:, None]
        theta = corners[:, middle]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            away = a_1 * h_phi + b * h_psi
            s = _least_sine(theta, away)
            bent = 0.5 * ((a_2 + a_1**2) * h_phi**2 + (b + b**2) * h_psi**2) / s
            slack = _least(away, bent)
            least = np.maximum(theta.min(axis=0) - slack, 0.0)
            most = np.minimum(theta.max(axis=0) + slack, np.pi)
            low[middle] = np.stack([least, -most]) - offset[middle]
            high[middle] = np.stack([most, -least]) - offset[middle]
            # The elbow's circle carries the link round at rate b, its frame at rate 1.
            for joint, speed in ((outer, b), (along, np.ones(1))):
                away = a_1 * h_phi + speed * h_psi
                straight = _least(away / s, _cap(theta, away))
                bent = (a_2 / s + 2.0 * a_1**2 / s**2) * h_phi**2
                bent = 0.5 * (bent + (speed / s + 2.0 * speed**2 / s**2) * h_psi**2)
                low[joint], high[joint] = _around(corners[:, joint], straight, bent)
    low[3], high[3] = _bends(arm, rates)
    return Enclosures(low, high)


def _corners(
    arm: SrsArm, R: FloatArray, p: FloatArray, intervals: AngleCells, parts: int
) -> FloatArray:
    """Returns joints, of the middle ones the polar angles, at each box's corners, shape (4, 7, c, k), going round."""
    middle = _directions(arm, R, p, intervals.middle)
    psi = np.linspace(-np.pi, np.pi, parts, endpoint=False)
    sides = []
    for angle in (intervals.low, intervals.high):
        turn = rotation_z(-angle)
        curves = arm.curves((turn @ R)[:, None], (turn @ p)[:, None])
        here = _directions(arm, R, p, angle)
        shift = _carried_along(middle, here, angle - intervals.middle)
        there = psi[None, :] + shift[:, None]
        sides.append(np.stack(np.broadcast_arrays(*curves.angles(np.sin(there), np.cos(there)))))
    low, high = sides
    corners = np.stack([low, np.roll(low, -1, axis=2), np.roll(high, -1, axis=2), high])
    # Where the first joint of a triple is chosen at will, the middle one may be an ulp below zero.
    corners[:, [1, 5]] = np.abs(corners[:, [1, 5]])
    return corners


def _directions(
    arm: SrsArm, R: FloatArray, p: FloatArray, angle: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns u, r and t of the arm plane (see `ArmPlane`) in the carried frame, (c, 3) each."""
    turn = rotation_z(-angle)
    plane = arm.curves(turn @ R, turn @ p).plane
    return tuple((arm.canonical.B @ v).T for v in (plane.u, plane.r, plane.t))  # type: ignore[return-value]


def _carried_along(
    middle: tuple[FloatArray, FloatArray, FloatArray],
    here: tuple[FloatArray, FloatArray, FloatArray],
    turn: FloatArray,
) -> FloatArray:
    """Returns the arm angle, (c,), of the middle's reference direction after the smallest rotation in the world."""
    back = rotation_z(turn)
    # Everything as the carried frame of the middle sees it, which stands in the world.
    u, r, t = ((back @ v[..., None])[..., 0] for v in here)
    u_c, r_c, _ = middle
    cosine = (u_c * u).sum(axis=1)
    # Smallest rotation of r_c from u_c to u: r_c - (r_c·u) (u_c + u) / (1 + u_c·u).
    along = (r_c * u).sum(axis=1) / np.maximum(1.0 + cosine, 1e-12)
    carried = r_c - along[:, None] * (u_c + u)
    return np.arctan2((carried * t).sum(axis=1), (carried * r).sum(axis=1))


def _least(one: FloatArray, other: FloatArray) -> FloatArray:
    """Returns the smaller of two bounds; what is not a number tells nothing."""
    return np.fmin(np.where(np.isnan(one), np.inf, one), other)


def _least_sine(theta: FloatArray, away: FloatArray) -> FloatArray:
    """Returns the least sine of a polar angle within each box, shape (c, k); 0 if a pole may be in or near it."""
    low, high = theta.min(axis=0) - away, theta.max(axis=0) + away
    sine = np.minimum(np.sin(np.maximum(low, 0.0)), np.sin(np.minimum(high, np.pi)))
    return np.where(sine > SINGULAR, sine, 0.0)


def _cap(theta: FloatArray, away: FloatArray) -> FloatArray:
    """Returns how far the azimuth gets within a cap around the nearest corner [rad], shape (c, k); inf over a pole."""
    to_pole = np.minimum(theta, np.pi - theta).min(axis=0)
    inside = (away < to_pole) & (to_pole > SINGULAR)
    ratio = np.sin(np.where(inside, away, 0.0)) / np.where(inside, np.sin(to_pole), 1.0)
    return np.where(inside, np.arcsin(np.minimum(ratio, 1.0)), np.inf)


def _around(
    corners: FloatArray, straight: FloatArray, bent: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Returns the range of an azimuth and of the same half a turn on, shape (2, c, k) each.

    Along an edge of the box two corners are at most twice `straight` apart; as long as that is less than half a turn,
    the corners' difference is the one modulo a turn.

    Args:
        corners: at the corners, going round [rad], shape (4, c, k).
        straight: how far it may be from the nearest corner's [rad], shape (c, k).
        bent: how far it may be beyond all corners [rad], shape (c, k).
    """
    step = np.diff(corners, axis=0)
    step -= TURN * np.round(step / TURN)
    change = np.concatenate([np.zeros((1, *step.shape[1:])), np.cumsum(step, axis=0)])
    slack = _least(straight, bent)
    free = ~(straight < 0.5 * np.pi)
    low = np.where(free, -np.inf, corners[0] + change.min(axis=0) - slack)
    high = np.where(free, np.inf, corners[0] + change.max(axis=0) + slack)
    return np.stack([low, low + np.pi]), np.stack([high, high + np.pi])


def _bends(arm: SrsArm, rates: ShapeRates) -> tuple[FloatArray, FloatArray]:
    """Returns lowest and highest joint 4, shape (2, c, 1) each."""
    upper, fore = arm.geometry.upper, arm.geometry.fore

    def bend(r: FloatArray) -> FloatArray:
        return np.arccos(np.clip((r * r - upper**2 - fore**2) / (2.0 * upper * fore), -1.0, 1.0))

    least, most = bend(rates.distance_high), bend(rates.distance_low)
    both = np.stack([least, -most]), np.stack([most, -least])
    low, high = (x[..., None] - arm.canonical.offset[3] for x in both)
    return low, high


ROUNDING = 1e-6
"""What enclosures are widened by, since they are computed in floating point [rad]."""
APART = 2.0
"""Ranges of one joint whose middles are this far apart are not put into one cell [rad]."""


def pose_cells(
    arm: SrsArm,
    R: FloatArray,
    p: FloatArray,
    edges: FloatArray,
    resolution: Resolution,
    free_last: bool,
    lines: Callable[[AngleCells], FloatArray],
) -> Cells:
    """Returns cells that cover every posture of one flange pose, as `bound/cells.py` has it."""
    finer = resolution.finer
    wrist = arm.wrist_center(R, p)
    intervals = reachable_cells(arm, wrist, finer_edges(edges, finer))
    if not len(intervals.index):
        return free_cells(arm, edges[:1])
    rates = shape_rates(arm, wrist, intervals)
    found = enclosures(arm, R, p, intervals, rates, resolution.arm_angles * finer)
    if free_last:
        found.low[6], found.high[6] = -np.inf, np.inf
    first, second = _within_limits(found, arm.lower, arm.upper)
    cells, part, psi = _every_branch(first, second, intervals, finer)
    return _merged(replace(cells, line=lines(intervals)[part]), psi // finer)


@dataclass(frozen=True)
class _Ranges:
    """Enclosures on one turn, cut at the joint limits; shapes (7, 2, c, k)."""

    low: FloatArray
    """Lowest position [rad]."""
    high: FloatArray
    """Highest position [rad]."""
    meets: BoolArray
    """Whether there is any."""


def _within_limits(
    found: Enclosures, lower: FloatArray, upper: FloatArray
) -> tuple[_Ranges, _Ranges]:
    """Returns enclosures on the turn that meets the limits, and on a second one where two turns do.

    A joint is free within its limits where nothing is known of it, and where several turns meet limits that are more
    than a turn apart.
    """
    shape = (7, 1, 1, 1)
    bottom, top = lower.reshape(shape), upper.reshape(shape)
    bounded = np.isfinite(bottom) & np.isfinite(top)
    middle = 0.5 * (np.where(bounded, bottom, 0.0) + np.where(bounded, top, 0.0))
    low, high = found.low - ROUNDING, found.high + ROUNDING
    known = (high - low < TURN) & bounded
    low, high = np.where(known, low, bottom), np.where(known, high, top)
    # The nearest turn to the limits' middle: if any turn meets them, it does, or one next to it.
    shift = TURN * np.round((middle - np.where(known, 0.5 * (low + high), middle)) / TURN)
    low, high = low + shift, high + shift
    turns = np.stack([(low + k * TURN <= top) & (high + k * TURN >= bottom) for k in (-1, 0, 1)])
    most = np.where(top - bottom <= TURN + ROUNDING, 2, 1)
    known &= turns.sum(axis=0) <= most
    one = np.where(turns[1], 0.0, np.where(turns[0], -TURN, TURN))
    other = np.where(turns[0] & turns[1], -TURN, TURN)

    def on(turn: FloatArray, meets: BoolArray) -> _Ranges:
        return _Ranges(
            np.where(known, np.maximum(low + turn, bottom), bottom),
            np.where(known, np.minimum(high + turn, top), top),
            meets,
        )

    return on(one, turns.any(axis=0) | ~known), on(other, (turns.sum(axis=0) == 2) & known)


def _every_branch(
    first: _Ranges, second: _Ranges, intervals: AngleCells, finer: int
) -> tuple[Cells, IntArray, IntArray]:
    """Returns the fine cells of all branches and turns, their intervals and their parts of the circle."""
    branches = np.arange(8)
    possible = np.ones((*first.low.shape[2:], 8), dtype=np.bool_)
    flip = np.stack([flips(joint, branches).astype(np.int64) for joint in range(7)])
    for joint in range(7):
        possible &= np.moveaxis(first.meets[joint][flip[joint]], 0, -1)
    part, psi, branch = np.nonzero(possible)
    joints = np.arange(7)[:, None]
    places = (joints, flip[:, branch], part, psi)
    low, high, rows = first.low[places], first.high[places], np.arange(len(part))
    twice = second.meets[places]
    for joint in map(int, np.flatnonzero(twice.any(axis=1))):
        again = np.flatnonzero(twice[joint][rows])
        other = rows[again]
        place = joint, flip[joint, branch[other]], part[other], psi[other]
        low, high = np.hstack([low, low[:, again]]), np.hstack([high, high[:, again]])
        low[joint, len(rows) :], high[joint, len(rows) :] = second.low[place], second.high[place]
        rows = np.concatenate([rows, other])
    part, psi = part[rows], psi[rows]
    cells = Cells(
        intervals.index[part] // finer,
        branch[rows],
        np.vstack([low, intervals.low[part]]).T,
        np.vstack([high, intervals.high[part]]).T,
        np.zeros(len(rows)),
    )
    return cells, part, psi


def _merged(cells: Cells, psi: IntArray) -> Cells:
    """Returns one cell around all of a platform cell that have branch, turns and part of the circle in common."""
    if not len(psi):
        return cells
    parts = int(psi.max()) + 1
    key = (cells.index * 8 + cells.kind) * parts + psi
    order = np.argsort(key, kind="stable")
    _, first, group = np.unique(key[order], return_index=True, return_inverse=True)
    middle = (0.5 * (cells.low + cells.high)[order, :7]).copy()
    # Turns follow from where a joint is next to the first cell of the same part of the circle.
    apart = np.abs(middle - middle[first][group]) > APART
    turn = apart @ (1 << np.arange(7))
    key = key[order] * (1 << 7) + turn
    again = np.argsort(key, kind="stable")
    order, key = order[again], key[again]
    first = np.flatnonzero(np.concatenate([[True], np.diff(key) > 0]))
    return Cells(
        cells.index[order][first],
        cells.kind[order][first],
        np.minimum.reduceat(cells.low[order], first),
        np.maximum.reduceat(cells.high[order], first),
        np.minimum.reduceat(cells.line[order], first),
    )
