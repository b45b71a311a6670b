"""Platform angles from which a pose can be reached, in intervals, and how fast the arm's shape changes there."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.kinematics.srs.srs_arm import SrsArm
from dualarm_cli.records import dataclass

FULL = 2.0 * np.pi
ROUNDING = 1e-9
"""What distances are widened by, since they are computed in floating point [m]."""
TINY = 1e-5
"""Where the wrist may be this close to the shoulder, nothing is known of the directions between them [m]."""
HAIR = 1e-7
"""What arcs are widened by for the same reason [rad]: a square root of what is lost at the end of the reach."""


@dataclass(frozen=True)
class AngleCells:
    """Intervals of the platform angle, each within one cell of the common grid; c of them."""

    index: IntArray
    """Which cell of the grid, shape (c,), ascending."""
    low: FloatArray
    """Where it begins [rad], shape (c,)."""
    high: FloatArray
    """Where it ends [rad], shape (c,)."""

    @property
    def middle(self) -> FloatArray:
        """Their middles [rad], shape (c,)."""
        return 0.5 * (self.low + self.high)

    @property
    def half(self) -> FloatArray:
        """Half their widths [rad], shape (c,)."""
        return 0.5 * (self.high - self.low)


def reachable_cells(arm: SrsArm, wrist: FloatArray, edges: FloatArray) -> AngleCells:
    """Returns the parts of a grid's cells from which a wrist centre is within reach.

    The squared distance from shoulder to wrist is A - B cos(phi - phi_B): the reachable angles are two arcs
    around phi_B, one to either side; a hair is added to their ends.

    Args:
        arm: kinematics in the carried frame, whose z axis is the platform's.
        wrist: wrist centre in the carried frame at platform angle zero [m], shape (3,).
        edges: borders of the grid's cells, ascending [rad], shape (g + 1,); one (twice) where nothing turns.
    """
    shoulder = arm.geometry.shoulder
    rho, radius = np.hypot(*wrist[:2]), np.hypot(*shoulder[:2])
    height = wrist[2] - shoulder[2]
    A, B = rho**2 + radius**2 + height**2, 2.0 * rho * radius
    least, most = arm.reach
    if edges[-1] == edges[0] or B < 1e-12:
        gap = np.linalg.norm(turned(wrist, edges[:1])[0] - shoulder)
        if not least - ROUNDING <= gap <= most + ROUNDING:
            return AngleCells(np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0))
        return AngleCells(np.arange(len(edges) - 1), edges[:-1], edges[1:])
    if np.sqrt(max(A - B, 0.0)) > most + ROUNDING or np.sqrt(A + B) < least - ROUNDING:
        return AngleCells(np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0))
    # In the carried frame the wrist turns backwards: its azimuth is theta - phi.
    nearest = np.arctan2(wrist[1], wrist[0]) - np.arctan2(shoulder[1], shoulder[0])
    nearest += FULL * np.round((0.5 * (edges[0] + edges[-1]) - nearest) / FULL)
    inner = np.arccos(np.clip((A - least**2) / B, -1.0, 1.0))
    outer = np.arccos(np.clip((A - most**2) / B, -1.0, 1.0))
    index, low, high = [], [], []
    for turn in range(-2, 3):
        for begin, end in ((inner, outer), (-outer, -inner)):
            first = np.maximum(edges[:-1], nearest + turn * FULL + begin - HAIR)
            last = np.minimum(edges[1:], nearest + turn * FULL + end + HAIR)
            some = np.flatnonzero(first < last)
            index.append(some)
            low.append(first[some])
            high.append(last[some])
    every = np.concatenate(index)
    order = np.lexsort((np.concatenate(low), every))
    return AngleCells(every[order], np.concatenate(low)[order], np.concatenate(high)[order])


def reachable_spans(arm: SrsArm, wrist: FloatArray) -> list[tuple[float, float]]:
    """Returns the positions of a rail from which a wrist centre is within reach, lowest and highest [m], ascending.

    The distance from shoulder to wrist is that of two points on parallel lines: within the farthest reach in one span,
    less the span within the nearest one.

    Args:
        arm: kinematics in the carried frame, which slides along its z axis.
        wrist: wrist centre in the carried frame with the rail at zero [m], shape (3,).
    """
    x, y, nearest = wrist - arm.geometry.shoulder
    away = float(np.hypot(x, y))
    least, most = arm.reach
    if away > most + ROUNDING:
        return []
    outer = float(np.sqrt(max(most**2 - away**2, 0.0))) + ROUNDING
    if away >= least - ROUNDING:
        return [(nearest - outer, nearest + outer)]
    inner = float(np.sqrt(least**2 - away**2)) - ROUNDING
    return [(nearest - outer, nearest - inner), (nearest + inner, nearest + outer)]


def turned(wrist: FloatArray, angle: FloatArray) -> FloatArray:
    """Returns a world point in the carried frame [m], shape (c, 3), for platform angles (c,) [rad].

    Args:
        wrist: the point in the carried frame at platform angle zero [m], shape (3,).
        angle: platform angles [rad], shape (c,).
    """
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = wrist
    return np.stack([c * x + s * y, c * y - s * x, np.full(len(angle), z)], axis=1)


@dataclass(frozen=True)
class ShapeRates:
    """Bounds over each interval of the platform angle on how the arm's triangle moves; all of shape (c,)."""

    distance_low: FloatArray
    """Least distance from shoulder to wrist [m]."""
    distance_high: FloatArray
    """Greatest distance [m]."""
    sin_upper: FloatArray
    """Greatest sine of the angle between upper arm and shoulder-wrist line."""
    sin_fore: FloatArray
    """Greatest sine of the angle between forearm and shoulder-wrist line."""
    shoulder_first: FloatArray
    """Greatest turning rate of the upper arm's frame in the carried frame [rad/rad]."""
    shoulder_second: FloatArray
    """Bound on second derivatives of directions seen from it."""
    wrist_first: FloatArray
    """Greatest turning rate of the forearm's frame in the world [rad/rad]."""
    wrist_second: FloatArray
    """Bound on second derivatives of directions seen from it."""


def shape_rates(arm: SrsArm, wrist: FloatArray, cells: AngleCells) -> ShapeRates:
    """Returns bounds for the arm plane that follows the platform by smallest rotations.

    In the world the shoulder goes round a circle of radius R0 and the wrist stands. With r its distance, u its
    direction: |u'| <= R0/r and |u''| <= 2 R0/r + 3 R0²/r². The arm plane is carried along from the interval's
    middle by the smallest rotation of u, whose angular velocity is (u_c + u) × u' / (1 + u_c·u); the upper arm turns in
    it by alpha(r), the forearm by gamma(r), by the law of cosines. All norms, no directions: second derivatives
    count only with the square of an interval's width. Our own derivation.
    """
    geometry = arm.geometry
    R0 = float(np.hypot(*geometry.shoulder[:2])) if (cells.half > 0).any() else 0.0
    half = cells.half
    ends = np.stack(
        [
            np.linalg.norm(turned(wrist, angle) - geometry.shoulder, axis=1)
            for angle in (cells.low, cells.middle, cells.high)
        ]
    )
    least, most = arm.reach
    near = np.maximum(ends.min(axis=0) - R0 * half, TINY)
    # Between three samples half a width apart: the way to the nearest one, or the error of a parabola's chord.
    bulge = np.where(near > TINY, (R0 + R0**2 / near) * half**2 / 8.0, np.inf)
    bulge = np.minimum(bulge, 0.5 * R0 * half)
    # Cells end at the reach, but for a hair.
    least, most = least - R0 * HAIR, most + R0 * HAIR
    low = np.clip(ends.min(axis=0) - bulge - ROUNDING, least, most)
    high = np.clip(ends.max(axis=0) + bulge + ROUNDING, least, most)
    nearest, low = np.maximum(low, 0.0), np.maximum(low, TINY)
    rate = R0 / low
    rate_2 = 2.0 * R0 / low + 3.0 * (R0 / low) ** 2
    angle = np.minimum(rate * half, 1.5)
    kappa = np.sqrt(2.0 / (1.0 + np.cos(angle)))
    spin = rate * kappa
    spin_2 = rate_2 * kappa + spin * rate * np.sin(angle) / (1.0 + np.cos(angle))
    r_1, r_2 = R0, R0 + R0**2 / low
    upper_1, upper_2, sin_upper = _bend_rates(geometry.upper, geometry.fore, low, high, r_1, r_2)
    fore_1, fore_2, sin_fore = _bend_rates(geometry.fore, geometry.upper, low, high, r_1, r_2)
    turning = 1.0 if (half > 0).any() else 0.0
    carried, carried_2 = spin + turning, spin_2 + spin * turning
    first, wrist_first = carried + upper_1, spin + fore_1
    rates = [
        first,
        carried_2 + upper_2 + upper_1 * carried + first**2,
        wrist_first,
        spin_2 + fore_2 + fore_1 * spin + wrist_first**2,
    ]
    rates = [np.where(low > TINY, r, np.inf) for r in rates]
    return ShapeRates(nearest, high, sin_upper, sin_fore, *rates)


def _bend_rates(
    own: float, other: float, low: FloatArray, high: FloatArray, r_1: float, r_2: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns bounds on the first and second derivative of a link's angle to u, and on its sine.

    cos alpha = (r² + own² - other²) / (2 own r); infinite where the arm may be stretched or folded.
    """
    difference = own**2 - other**2
    stationary = np.clip(np.sqrt(max(difference, 0.0)), low, high)
    cosines = np.stack([(r * r + difference) / (2.0 * own * r) for r in (low, high, stationary)])
    cosines = np.clip(cosines, -1.0, 1.0)
    largest = np.abs(cosines).max(axis=0)
    sine = np.sqrt(np.maximum(1.0 - largest**2, 0.0))
    straddles = (cosines.min(axis=0) <= 0.0) & (cosines.max(axis=0) >= 0.0)
    sin_most = np.where(straddles, 1.0, np.sqrt(1.0 - np.abs(cosines).min(axis=0) ** 2))
    slope = (1.0 + abs(difference) / low**2) / (2.0 * own)
    slope_2 = abs(difference) / (own * low**3)
    with np.errstate(divide="ignore", over="ignore"):
        rate = slope / sine
        rate_2 = (slope_2 + largest * rate**2) / sine
    if r_1 == 0.0:
        return np.zeros(len(low)), np.zeros(len(low)), sin_most
    return rate * r_1, rate_2 * r_1**2 + rate * r_2, sin_most
