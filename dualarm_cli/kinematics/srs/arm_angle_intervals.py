"""Feasible arm angles of a target in closed form, from the joint limits, without sampling."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.kinematics.srs.arm_angle_curves import BENDING, TURNING, ArmAngleCurves, flips
from dualarm_cli.kinematics.srs.srs_arm import SrsArm
from dualarm_cli.kinematics.srs.srs_limits import LIMIT_SLACK, TURN, some_turn_within, wrap

SAME = 1e-12
"""Arm angles closer than this are one [rad]."""
CROSSING = 1e-7
"""A joint this close to the end of a range of exactly one turn is there [rad]."""
SINGULAR_BORDER = 1e-9
"""Sine of a middle joint below which its outer joints jump by half a turn."""
CONSTANT = 1e-20
"""Amplitude below which a joint does not depend on the arm angle."""


@dataclass(frozen=True)
class ArmAngleIntervals:
    """Arm angles at which all joints are within limits, for each target and branch.

    Along one interval the joints move continuously (whole turns apart, where a joint's range is
    more than one turn). Every end touches a limit of a joint, or is an arm angle at which a triple
    passes exactly through its singularity, where the outer joints of the branch jump by half a
    turn. Two intervals share an end where a joint whose range is exactly one turn would have to
    pass from one limit to the other. Single feasible arm angles between infeasible ones are left
    out.
    """

    start: FloatArray
    """First arm angle of each interval in [-pi, pi], ascending [rad], shape (..., 8, k); NaN where
    there are fewer."""
    end: FloatArray
    """Last arm angle, greater than `start` by at most a full turn [rad], shape (..., 8, k)."""
    count: IntArray
    """Number of intervals, shape (..., 8)."""

    def contains(self, psi: FloatArray) -> BoolArray:
        """Returns whether each branch holds arm angles, shape (..., 8).

        Args:
            psi: arm angles [rad], broadcast against (...).
        """
        turned = np.mod(np.asarray(psi)[..., None, None] - self.start, TURN)
        return np.asarray((turned <= self.end - self.start).any(axis=-1))


def feasible_arm_angles(arm: SrsArm, R: FloatArray, p: FloatArray) -> ArmAngleIntervals:
    """Returns the arm angles at which all joints of a branch are within limits.

    Where joint i meets a limit L, one equation A sin psi + B cos psi + C = 0 holds: for joints 1,
    3, 5, 7 num(psi) cos L - den(psi) sin L = 0, for joints 2 and 6 cos theta(psi) = cos(L +
    offset); all eight branches share them. Their roots cut the circle into arcs on each of which
    every joint is either within or beyond its limits: the midpoint decides exactly. [Shimizu2008]
    has the idea; arcs instead of case distinctions, whole turns and exact singularities are our
    own.

    Args:
        arm: the arm and its limits.
        R: flange rotations in the base frame, shape (..., 3, 3).
        p: flange positions in the base frame [m], shape (..., 3), broadcast against R.
    """
    curves = arm.curves(R, p)
    cuts, number = _cuts(arm, curves)
    index = np.arange(len(cuts)).reshape(-1, *(1,) * number.ndim)
    used = index < number
    following = np.where(index + 1 < number, np.roll(cuts, -1, axis=0), cuts[:1] + TURN)
    following = np.where(used, following, 0.0)
    begin = np.where(used, cuts, 0.0)
    ok = _feasible(arm, curves, 0.5 * (begin + following)) & used
    broken = _broken(arm, curves, begin) & used
    # The arc before the first is the last one in use, not the last of the array.
    last = np.broadcast_to(number - 1, (8, 1, *number.shape))
    before = np.roll(ok, 1, axis=1)
    before[:, :1] = np.take_along_axis(ok, last, axis=1)
    starts = ok & (~before | broken)
    # The last arc counts as an end; `_intervals` knows when it goes on over the first cut.
    ends = ok & (~np.roll(ok, -1, axis=1) | np.roll(broken, -1, axis=1))
    whole = np.asarray(ok.any(axis=1) & ~starts.any(axis=1))
    return _intervals(begin, following, starts, ends, whole)


def _cuts(arm: SrsArm, curves: ArmAngleCurves) -> tuple[FloatArray, IntArray]:
    """Returns all arm angles at which something may change, ascending, and how many there are.

    Shapes (m, ...) and (...); infinite beyond the number, which is at least one.
    """
    rows, offset = [], arm.canonical.offset
    for i, joint in enumerate(TURNING):
        num, den = curves.turning[i]
        rows += [num * np.cos(x) - den * np.sin(x) for x in _crossable(arm, joint)]
    for j, joint in enumerate(BENDING):
        for x in _crossable(arm, joint):
            row = curves.bending[j].copy()
            row[2] -= np.cos(x + offset[joint])
            rows.append(row)
    found = [root for row in rows for root in _roots(row)]
    for a, b, _ in curves.bending:
        # A triple can only be singular where the cosine of its middle joint is extreme.
        found += [np.arctan2(a, b), np.arctan2(-a, -b)]
    cuts = np.stack(found)
    cuts = np.sort(np.where(np.isnan(cuts), np.inf, wrap(cuts)), axis=0)
    with np.errstate(invalid="ignore"):
        repeated = np.diff(cuts, axis=0) < SAME
    cuts[1:][repeated] = np.inf
    cuts.sort(axis=0)
    # Both ends of the circle are one arm angle.
    number = np.isfinite(cuts).sum(axis=0)
    final = np.take_along_axis(cuts, (number - 1)[None], axis=0)[0]
    closing = (number > 1) & (cuts[0] + TURN - final < SAME)
    np.put_along_axis(cuts, (number - 1)[None], np.where(closing, np.inf, final)[None], axis=0)
    return cuts, number - closing


def _crossable(arm: SrsArm, joint: int) -> list[float]:
    """Returns the limits that can bound a joint: none beyond one turn, one at exactly a turn."""
    low, high = float(arm.lower[joint]), float(arm.upper[joint])
    if high - low > TURN + LIMIT_SLACK:
        return []
    return [low] if high - low >= TURN - LIMIT_SLACK else [low, high]


def _roots(row: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Returns the roots of A sin x + B cos x + C = 0 for (A, B, C) (3, ...); NaN where none."""
    a, b, c = row
    size = np.hypot(a, b)
    # acos(-C / size) by its tangent, which keeps its digits near double roots.
    square = (size - c) * (size + c)
    with np.errstate(invalid="ignore"):
        half = np.arctan2(np.where(square >= 0.0, np.sqrt(square), np.nan), -c)
    middle = np.arctan2(a, b)
    return middle - half, middle + half


def _feasible(arm: SrsArm, curves: ArmAngleCurves, psi: FloatArray) -> BoolArray:
    """Returns whether branches (8, ...) are within reach and limits at arm angles (...)."""
    pairs = curves.pairs(np.sin(psi), np.cos(psi))
    inside = [
        [some_turn_within(q, arm.lower[joint], arm.upper[joint]) for q in pair]
        for joint, pair in enumerate(pairs)
    ]
    return _per_branch(inside) & curves.plane.reachable


def _broken(arm: SrsArm, curves: ArmAngleCurves, psi: FloatArray) -> BoolArray:
    """Returns whether branches (8, ...) cannot be followed through arm angles (...)."""
    sin, cos = np.sin(psi), np.cos(psi)
    clear = []
    for joint, pair in enumerate(curves.pairs(sin, cos)):
        low, span = arm.lower[joint], arm.upper[joint] - arm.lower[joint]
        # A joint that stands at both its limits for all arm angles does not have to pass them.
        if abs(span - TURN) <= LIMIT_SLACK:
            steady = ~_varies(curves, joint)
            clear.append([steady | (np.abs(wrap(q - low)) >= CROSSING) for q in pair])
        else:
            clear.append([np.ones(q.shape, dtype=np.bool_) for q in pair])
    through = np.zeros(psi.shape, dtype=np.bool_)
    for j, joint in enumerate(BENDING):
        num, den = (a * sin + b * cos + c for a, b, c in curves.turning[2 * j])
        # Where it is singular at every arm angle nothing jumps: the first joint stays at 0.
        through |= _varies(curves, joint) & (np.hypot(num, den) < SINGULAR_BORDER)
    return ~_per_branch(clear) | through


def _varies(curves: ArmAngleCurves, joint: int) -> BoolArray:
    """Returns whether a joint depends on the arm angle at all, shape (...)."""
    if joint in BENDING:
        amplitude = np.abs(curves.bending[BENDING.index(joint), :2]).max(axis=0)
    elif joint in TURNING:
        amplitude = np.abs(curves.turning[TURNING.index(joint), :, :2]).max(axis=(0, 1))
    else:
        amplitude = np.zeros(curves.bending.shape[2:])
    return np.asarray(amplitude > CONSTANT)


def _per_branch(holds: list[list[BoolArray]]) -> BoolArray:
    """Returns for each branch (8, ...) whether both-valued conditions on all joints hold."""
    return np.stack(
        [
            np.logical_and.reduce(
                [pair[int(flips(joint, np.asarray(branch)))] for joint, pair in enumerate(holds)]
            )
            for branch in range(8)
        ]
    )


def _intervals(
    begin: FloatArray, following: FloatArray, starts: BoolArray, ends: BoolArray, whole: BoolArray
) -> ArmAngleIntervals:
    """Returns starts and ends of arcs, (m, ...) and (8, m, ...), paired and packed."""
    count = starts.sum(axis=1)
    width = max(1, int(count.max(initial=0)))
    start = np.sort(np.where(starts, begin, np.inf), axis=1)[:, :width]
    end = np.sort(np.where(ends, following, np.inf), axis=1)[:, :width]
    # The interval that runs over +-pi is listed last by its start and first by its end.
    over = (count > 0) & (end[:, 0] <= start[:, 0])
    rolled = np.concatenate([end[:, 1:], np.full_like(end[:, :1], np.inf)], axis=1)
    final = np.maximum(count - 1, 0)[:, None]
    np.put_along_axis(rolled, final, end[:, :1] + TURN, axis=1)
    end = np.where(over[:, None], rolled, end)
    start[:, 0] = np.where(whole, -np.pi, start[:, 0])
    end[:, 0] = np.where(whole, np.pi, end[:, 0])
    count = np.where(whole, 1, count)
    spare = np.arange(width).reshape(-1, *(1,) * (count.ndim - 1)) >= count[:, None]
    start[spare], end[spare] = np.nan, np.nan
    return ArmAngleIntervals(
        np.moveaxis(start, (0, 1), (-2, -1)),
        np.moveaxis(end, (0, 1), (-2, -1)),
        np.moveaxis(count, 0, -1),
    )
