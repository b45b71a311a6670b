"""Enclosures of all joints over cells of (platform angle, arm angle, branch)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.kinematics.platform_chain import rotation_z
from dualarm_cli.kinematics.srs_arm import SrsArm
from dualarm_cli.minimum_time.bound_reach import (
    ROUNDING,
    AngleCells,
    ShapeRates,
    reachable_cells,
    shape_rates,
)

SINGULAR = 0.02
"""Sine of joint 2 (6) below which its neighbours count as free."""
LARGEST_CHANGE = 3.0
"""A joint that might turn farther within a cell counts as free [rad]."""
TURN = 2.0 * np.pi


@dataclass(frozen=True)
class Resolution:
    """How finely postures are cut into cells."""

    step: float
    """Width of the platform's cells [rad]."""
    arm_angles: int
    """Parts of the circle of elbows."""
    finer: int
    """How many times finer, in both directions, the cells are on which joints are enclosed."""


@dataclass(frozen=True)
class Cells:
    """Joint enclosures; n of them, in order of their platform cell."""

    index: IntArray
    """Which cell of the platform's grid, shape (n,)."""
    low: FloatArray
    """Lowest joints and, last, platform angle in the cell [rad], shape (n, 8)."""
    high: FloatArray
    """Highest ones [rad], shape (n, 8)."""
    line: FloatArray
    """Least time of the line that begins or ends there [s], shape (n,)."""


def pose_cells(
    arm: SrsArm,
    R: FloatArray,
    p: FloatArray,
    edges: FloatArray,
    resolution: Resolution,
    free_last: bool,
    lines: Callable[[AngleCells], FloatArray],
) -> Cells:
    """Returns cells that cover every posture of one flange pose that stands in the world.

    For every reachable interval of the platform angle the arm plane is carried along from the interval's middle by the
    smallest rotation of the shoulder-wrist line, and the circle of elbows is cut into equal parts. A smooth function on
    a box lies between its corners, give or take (M_phi h_phi² + M_psi h_psi²) / 2 with bounds M of its second
    derivatives and half-widths h (bilinear interpolation). Joints 1 and 3 are azimuths of directions seen from frames
    that turn at bounded rates: |q''| <= a2/s + 2 a1²/s² with s the sine of joint 2; joint 2 is a polar angle:
    |q''| <= (a2 + a1²)/s; the wrist likewise; joint 4 depends on the distance alone. Next to a singularity joints are
    free. Cells in which a joint cannot be within its limits are left out. All this on finer cells, many of which are
    then enclosed together: the give and take shrinks with the square. Our own derivation.

    Args:
        arm: kinematics in the carried frame.
        R: flange rotation in the carried frame at platform angle zero, shape (3, 3).
        p: flange position there [m], shape (3,).
        edges: borders of the platform's cells [rad], shape (g + 1,).
        resolution: how finely.
        free_last: whether joint 7 is free.
        lines: returns the least time of the line at this pose for intervals of the platform angle [s].
    """
    finer = resolution.finer
    wrist = arm.wrist_center(R, p)
    intervals = reachable_cells(arm, wrist, finer_edges(edges, finer))
    rates = shape_rates(arm, wrist, intervals)
    parts = resolution.arm_angles * finer
    corners, theta_2, theta_6 = _corners(arm, R, p, intervals, parts)
    low, high = _hulls(arm, intervals, rates, corners, theta_2, theta_6, np.pi / parts)
    bend_low, bend_high = _bends(arm, rates)
    low[..., 3], high[..., 3] = bend_low[:, None, :], bend_high[:, None, :]
    if free_last:
        low[..., 6], high[..., 6] = -np.inf, np.inf
    low, high, possible = _within_limits(arm, low, high)
    part, psi, branch = np.nonzero(possible)
    cells = Cells(
        intervals.index[part] // finer,
        np.column_stack([low[part, psi, branch], intervals.low[part]]),
        np.column_stack([high[part, psi, branch], intervals.high[part]]),
        lines(intervals)[part],
    )
    return _merged(cells, psi // finer * 8 + branch)


def finer_edges(edges: FloatArray, finer: int) -> FloatArray:
    """Returns the borders of the cells' equal parts [rad], shape (finer g + 1,)."""
    count = len(edges) - 1
    return np.interp(np.arange(finer * count + 1) / finer, np.arange(count + 1), edges)


def _merged(cells: Cells, kind: IntArray) -> Cells:
    """Returns one cell around all of a platform cell that are of one kind: any grouping of a cover is a cover."""
    if not len(kind):
        return cells
    order = np.lexsort((kind, cells.index))
    key = cells.index[order] * (int(kind.max()) + 1) + kind[order]
    first = np.flatnonzero(np.concatenate([[True], np.diff(key) > 0]))
    return Cells(
        cells.index[order][first],
        np.minimum.reduceat(cells.low[order], first),
        np.maximum.reduceat(cells.high[order], first),
        np.minimum.reduceat(cells.line[order], first),
    )


def _corners(
    arm: SrsArm, R: FloatArray, p: FloatArray, intervals: AngleCells, arm_angles: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns joints at all corners, (c, 2, k, 8, 7), and polar angles of joints 2 and 6, (c, 2, k, 8)."""
    middle = _directions(arm, R, p, intervals.middle)
    psi = np.linspace(-np.pi, np.pi, arm_angles, endpoint=False)
    solutions = []
    for angle in (intervals.low, intervals.high):
        # A hair inside, where the reach ends.
        inside = angle + 1e-12 * (intervals.middle - angle)
        turn = rotation_z(-inside)
        shift = _carried_along(middle, _directions(arm, R, p, inside), inside - intervals.middle)
        q = arm.solve((turn @ R)[:, None], (turn @ p)[:, None], psi[None, :] + shift[:, None]).q
        solutions.append(q)
    corners = np.stack(solutions, axis=1)
    offset = arm.canonical.offset
    polar = [np.abs(_wrapped(corners[..., k] + offset[k])) for k in (1, 5)]
    return corners, polar[0], polar[1]


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
    along = (r_c * u).sum(axis=1) / (1.0 + cosine)
    carried = r_c - along[:, None] * (u_c + u)
    return np.arctan2((carried * t).sum(axis=1), (carried * r).sum(axis=1))


def _hulls(
    arm: SrsArm,
    intervals: AngleCells,
    rates: ShapeRates,
    corners: FloatArray,
    theta_2: FloatArray,
    theta_6: FloatArray,
    h_psi: float,
) -> tuple[FloatArray, FloatArray]:
    """Returns lowest and highest joints of every cell, (c, k, 8, 7), of any turn; joint 4 is left to others."""
    four = np.stack([corners, np.roll(corners, -1, axis=2)], axis=2)
    four = four.reshape(corners.shape[0], 4, *corners.shape[2:])
    change = four - four[:, :1]
    change -= TURN * np.round(change / TURN)
    base = four[:, 0]
    low, high = base + change.min(axis=1), base + change.max(axis=1)
    h_phi = intervals.half[:, None, None]
    groups = (
        ((0, 2), 1, theta_2, rates.shoulder_first, rates.shoulder_second, rates.sin_upper),
        ((4, 6), 5, theta_6, rates.wrist_first, rates.wrist_second, rates.sin_fore),
    )
    for azimuths, polar, theta, first, second, sine in groups:
        a_1, a_2, b = (x[:, None, None] for x in (first, second, sine))
        s = _least_sine(theta, np.minimum(a_1 * h_phi + b * h_psi, np.pi))
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            curved = (a_2 / s + 2.0 * a_1**2 / s**2) * h_phi**2
            for joint in azimuths:
                # What joint 1 (7) follows goes round with the elbow; what joint 3 (5) follows turns at rate 1.
                speed = b if joint in (0, 6) else np.ones_like(b)
                slack = 0.5 * (curved + (speed / s + 2.0 * speed**2 / s**2) * h_psi**2)
                most = 2.0 * (a_1 * h_phi + speed * h_psi) / s
                free = ~((s > SINGULAR) & (most < LARGEST_CHANGE) & np.isfinite(slack))
                low[..., joint] = np.where(free, -np.inf, low[..., joint] - slack)
                high[..., joint] = np.where(free, np.inf, high[..., joint] + slack)
            slack = 0.5 * ((a_2 + a_1**2) * h_phi**2 + (b + b**2) * h_psi**2) / s
            free = ~((s > SINGULAR) & np.isfinite(slack))
        low[..., polar] = np.where(free, -np.inf, low[..., polar] - slack)
        high[..., polar] = np.where(free, np.inf, high[..., polar] + slack)
    return low, high


def _least_sine(theta: FloatArray, reach: FloatArray) -> FloatArray:
    """Returns the least sine of a polar angle within each cell, (c, k, 8); 0 if a pole may be in it."""
    four = np.stack([theta, np.roll(theta, -1, axis=2)], axis=2)
    four = four.reshape(theta.shape[0], 4, *theta.shape[2:])
    low, high = four.min(axis=1) - reach, four.max(axis=1) + reach
    return np.where(
        (low > 0.0) & (high < np.pi), np.maximum(np.minimum(np.sin(low), np.sin(high)), 0.0), 0.0
    )


def _bends(arm: SrsArm, rates: ShapeRates) -> tuple[FloatArray, FloatArray]:
    """Returns lowest and highest joint 4 by interval and branch, (c, 8)."""
    upper, fore = arm.geometry.upper, arm.geometry.fore

    def bend(r: FloatArray) -> FloatArray:
        return np.arccos(np.clip((r * r - upper**2 - fore**2) / (2.0 * upper * fore), -1.0, 1.0))

    least, most = bend(rates.distance_high), bend(rates.distance_low)
    flipped = np.arange(8) >= 4
    low = np.where(flipped, -most[:, None], least[:, None]) - arm.canonical.offset[3]
    high = np.where(flipped, -least[:, None], most[:, None]) - arm.canonical.offset[3]
    return low, high


def _within_limits(
    arm: SrsArm, low: FloatArray, high: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Returns enclosures on the turn that meets the limits, cut at them, and whether there is one.

    Where several turns meet the limits the joint is free within them.
    """
    possible = np.ones(low.shape[:-1], dtype=np.bool_)
    for joint in range(7):
        lower, upper = float(arm.lower[joint]), float(arm.upper[joint])
        bottom, top = low[..., joint] - ROUNDING, high[..., joint] + ROUNDING
        bounded = np.isfinite(lower) and np.isfinite(upper)
        if not bounded:
            # Any number of turns: a joint without limits tells nothing.
            low[..., joint], high[..., joint] = lower, upper
            continue
        inner = np.where(np.isfinite(bottom), bottom, 0.0) + np.where(np.isfinite(top), top, 0.0)
        middle = 0.5 * inner
        to_middle = TURN * np.round((0.5 * (lower + upper) - middle) / TURN)
        bottom, top = bottom + to_middle, top + to_middle
        meets = [
            (bottom + TURN * k <= upper) & (top + TURN * k >= lower) for k in (-2, -1, 0, 1, 2)
        ]
        count = np.sum(meets, axis=0)
        shift = TURN * (np.argmax(meets, axis=0) - 2.0)
        free = count > 1
        low[..., joint] = np.where(free, lower, np.maximum(bottom + shift, lower))
        high[..., joint] = np.where(free, upper, np.minimum(top + shift, upper))
        possible &= count > 0
    return low, high, possible


def _wrapped(angle: FloatArray) -> FloatArray:
    return angle - TURN * np.round(angle / TURN)


def free_cells(arm: SrsArm, edges: FloatArray) -> Cells:
    """Returns one cell per platform cell in which every joint is free."""
    n = len(edges) - 1
    return Cells(
        np.arange(n),
        np.column_stack([np.tile(arm.lower, (n, 1)), edges[:-1]]),
        np.column_stack([np.tile(arm.upper, (n, 1)), edges[1:]]),
        np.zeros(n),
    )


def point_cells(configurations: FloatArray, edges: FloatArray) -> Cells:
    """Returns given configurations (m, 7) in every platform cell: they turn with the platform."""
    n, m = len(edges) - 1, len(configurations)
    q = np.tile(configurations, (n, 1))
    return Cells(
        np.repeat(np.arange(n), m),
        np.column_stack([q, np.repeat(edges[:-1], m)]),
        np.column_stack([q, np.repeat(edges[1:], m)]),
        np.zeros(n * m),
    )
