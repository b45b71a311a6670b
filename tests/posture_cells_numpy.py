"""The cells of the bound in numpy, as `bound/cells.py` describes them: what the compiled ones are compared with."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from dualarm_cli.bound.cells import Cells, LineToTarget, finer_edges, free_cells
from dualarm_cli.effort import Resolution
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.kinematics.platform_chain import rotation_z
from dualarm_cli.kinematics.srs.arm_angle_curves import flips
from dualarm_cli.kinematics.srs_arm import SrsArm
from dualarm_cli.model.motion.rest_to_rest import RestToRest
from dualarm_cli.postures.platform_reach import AngleCells, reachable_cells
from tests.ranges_numpy import Jet, Range, half, middle, seen

TURN = 2.0 * np.pi
ROUNDING = 1e-6
"""What enclosures are widened by, since they are computed in floating point [rad]."""
WELL = 0.03
"""A joint's values count beside its corners where derivatives leave more than this open [rad]."""
TINY = 1e-5
"""Distance of wrist and shoulder below which no direction between them is known [m]."""
APART = 2.0
"""Ranges of one joint whose middles are this far apart are not put into one cell [rad]."""
SPLITS, MARGINAL = 2, 8
"""Cells of an interval with at most one in MARGINAL possible parts are split, SPLITS times in each direction."""
SHARES = 64
"""Into so many shares the differences of the arm angle within a part are cut."""
SHOULDER, WRIST = (0, 1, 2), (6, 5, 4)
"""Outer joint, middle joint and joint along the link of both triples: the wrist is a shoulder seen from the tool."""


def one_cell(low: float, high: float) -> AngleCells:
    """One cell of the platform's angle [rad]."""
    return AngleCells(np.zeros(1, dtype=np.int64), np.array([low]), np.array([high]))


def smallest_rotation(a: FloatArray, b: FloatArray) -> FloatArray:
    """Returns the rotation about a × b that takes the unit vector a to b, shape (3, 3)."""
    axis = np.cross(a, b)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-15:
        return np.eye(3)
    return pin.exp3(axis / sine * np.arctan2(sine, float(a @ b)))


@dataclass(frozen=True)
class Shape:
    """A pose over c intervals of the platform angle; every jet of shape (c,)."""

    waves: dict[str, tuple[Jet, Jet, Jet]]
    """Components of directions, as A sin psi + B cos psi + C of the arm angle: (A, B, C)."""
    bend: Jet
    """Cosine of joint 4."""
    links: tuple[tuple[Range, Range], tuple[Range, Range]]
    """Cosine and sine of the angles of upper arm and forearm to the shoulder-wrist line."""


def shape_of(arm: SrsArm, R: FloatArray, p: FloatArray, intervals: AngleCells) -> Shape:
    """Returns the shape of a pose that stands in the world.

    Names of waves: v and f are directions of upper arm and forearm, e and g those at right angles to them in the arm
    plane, n its normal; x, y, z the arm's first axes, 0, 1, 2 those of the tool.
    """
    a, b, S = arm.geometry.upper, arm.geometry.fore, arm.geometry.shoulder
    W = arm.wrist_center(R, p)
    forward = rotation_z(middle(intervals))
    plane = [(forward @ v[..., None])[..., 0] for v in _directions(arm, R, p, middle(intervals))]
    axes, tool = arm.canonical.B.T, (R @ arm.canonical.C.T).T
    distance = seen(intervals, -2.0 * W, S, W @ W + S @ S).root()
    near = distance.value.middle - distance.value.radius <= TINY
    reciprocal = Jet(
        *(
            Range(np.where(near, 0.0, x.middle), np.where(near, np.inf, x.radius))
            for x in vars(distance.inverse()).values()
        )
    )

    def line_along(standing: FloatArray) -> Jet:
        """The component of the line from the shoulder, which turns, to the wrist along vectors (3,) or (c, 3)."""
        return seen(intervals, -standing, S, standing @ W) * reciprocal

    along = [line_along(v) for v in plane]
    opening = (Jet.of(1.0) + along[0]).inverse()
    tilt = [along[1] * opening, along[2] * opening]

    def link(own: float, other: float) -> tuple[Jet, Jet]:
        cosine = distance.scaled(0.5 / own) + reciprocal.scaled(0.5 * (own**2 - other**2) / own)
        square = (cosine * cosine).scaled(-1.0)
        return cosine, replace(square, value=cosine.value.square().complement()).root()

    (ca, sa), (cf, sf) = link(a, b), link(b, a)
    square = (distance * distance).scaled(0.5 / (a * b))
    own = distance.value.square().scaled(0.5 / (a * b)) + Range.of(-0.5 * (a * a + b * b) / (a * b))
    waves: dict[str, tuple[Jet, Jet, Jet]] = {}
    zero = Jet.of(0.0)
    for name, vector in zip("xyz", axes, strict=True):
        line = seen(intervals, W, vector, -S @ vector) * reciprocal
        turned = [seen(intervals, v, vector, 0.0) for v in plane]
        u, r, t = _plane_along(turned, line, tilt)
        waves["v" + name] = sa * t, sa * r, ca * u
        waves["-n" + name] = r, t.scaled(-1.0), zero
        waves["e" + name] = ca * t, ca * r, (sa * u).scaled(-1.0)
    back = sf.scaled(-1.0)
    for name, vector in zip("012", tool, strict=True):
        u, r, t = _plane_along([Jet.of(v @ vector) for v in plane], line_along(vector), tilt)
        waves["f" + name] = back * t, back * r, cf * u
        waves["-f" + name] = sf * t, sf * r, cf.scaled(-1.0) * u
        waves["-n" + name] = r, t.scaled(-1.0), zero
        waves["-g" + name] = (cf * t).scaled(-1.0), (cf * r).scaled(-1.0), back * u
    return Shape(waves, replace(square, value=own), ((ca.value, sa.value), (cf.value, sf.value)))


def _plane_along(middle: list[Jet], line: Jet, tilt: list[Jet]) -> tuple[Jet, Jet, Jet]:
    """u, r and t along a vector: the middle's r and t after the smallest rotation that takes its u to the line."""
    both = middle[0] + line
    return line, *(middle[1 + i] + (tilt[i] * both).scaled(-1.0) for i in range(2))


@dataclass(frozen=True)
class Bends:
    """What the seven joints do over c intervals and k parts of the circle; ranges of shape (7, c, k)."""

    second: tuple[Range, Range]
    """Second derivatives by platform angle and arm angle."""
    smooth: BoolArray
    """Whether neighbouring corners are less than half a turn apart."""
    value: Range
    """All values at once, where derivatives tell too little."""


def bends_of(arm: SrsArm, shape: Shape, h_phi: FloatArray, parts: int) -> Bends:
    """Returns second derivatives, and values, of all joints."""
    psi = -np.pi + TURN * (np.arange(parts) + 0.5) / parts
    h = h_phi[:, None], np.pi / parts
    sampled = {name: _sampled(wave, psi, np.pi / parts) for name, wave in shape.waves.items()}
    found: list[tuple[list[Range], list[Range], Range]] = [None] * 7  # type: ignore[list-item]
    for joints, names, sign, (cosine, sine) in (
        (SHOULDER, ("vz", "vy", "vx", "-nz", "ez"), 1.0, shape.links[0]),
        (WRIST, ("f2", "f1", "-f0", "-n2", "-g2"), -1.0, shape.links[1]),
    ):
        c, *pairs = (sampled[name] for name in names)
        k, s = (x.column() for x in (cosine, sine))
        sizes = [
            Range(np.hypot(x[0].middle, y[0].middle), np.hypot(x[0].radius, y[0].radius))
            for x, y in (pairs[2:], pairs[:2])
        ]
        size = sizes[0].narrower(sizes[1]).narrower(c[0].square().complement().root())
        weight = size.square().inverse()
        e, e_1, c_1 = pairs[3][0], pairs[3][3], c[3]
        se = (s * weight).scaled(sign)
        near, turn = c[0] * c[0] * weight, e * c_1
        outer = se * e_1 + (se * weight * (c[0] * turn)).scaled(2.0)
        inner = se * (e_1 * c[0] + turn * (Range.of(1.0) + near.scaled(2.0)))
        by_psi = (
            ((se * e).scaled(-1.0), outer.scaled(-1.0)),
            (k.scaled(sign) + se * (c[0] * e), inner),
        )
        for joint, (n, d), (first, second) in zip(
            (joints[0], joints[2]), (pairs[:2], pairs[2:]), by_psi, strict=True
        ):
            own = arm.canonical.sign[joint]
            one = weight * (d[0] * n[1] + (n[0] * d[1]).scaled(-1.0))
            nearing = weight * (c[0] * c[1])
            two = weight * (d[0] * n[2] + (n[0] * d[2]).scaled(-1.0)) + (nearing * one).scaled(2.0)
            length = np.hypot(n[0].middle, d[0].middle)
            with np.errstate(divide="ignore", invalid="ignore"):
                away = np.hypot(n[0].radius, d[0].radius) / length
                value = Range(
                    own * (np.arctan2(n[0].middle, d[0].middle) - arm.canonical.offset[joint]),
                    np.where(away < 1.0, np.arcsin(np.minimum(away, 1.0)), np.inf),
                )
            found[joint] = [one, first], [two.scaled(own), second.scaled(own)], value
        found[joints[1]] = _arc_cosine(c, size)
    bend = [x.column() for x in (shape.bend.value, shape.bend.first, shape.bend.second)]
    still = Range.of(0.0)
    found[3] = _arc_cosine([*bend, still, still], bend[0].square().complement().root())
    shape_of_all = len(h_phi), parts
    first, second = (
        [Range.stacked([f[what][d] for f in found], shape_of_all) for d in range(2)]
        for what in (0, 1)
    )
    value = Range.stacked([f[2] for f in found], shape_of_all)
    smooth = np.ones((7, *shape_of_all), dtype=np.bool_)
    slack = np.zeros((7, *shape_of_all))
    for d in range(2):
        smooth &= (first[d].most() * h[d] < 0.5 * np.pi) & (second[d].most() < np.inf)
        slack = slack + 0.5 * second[d].most() * h[d] ** 2
    radius = np.where(slack < WELL, np.inf, value.radius)
    return Bends((second[0], second[1]), smooth, Range(value.middle, radius))


def _sampled(wave: tuple[Jet, Jet, Jet], psi: FloatArray, h: float) -> list[Range]:
    """A wave's value, first and second derivative by the platform angle, then by the arm angle, (c, k) each."""
    A, B, C = wave
    still = Range.of(0.0)
    rows = [
        (A.value, B.value, C.value),
        (A.first, B.first, C.first),
        (A.second, B.second, C.second),
    ]
    rows += [(B.value.scaled(-1.0), A.value, still)]
    rows += [(A.value.scaled(-1.0), B.value.scaled(-1.0), still)]
    found = []
    for a, b, c in (tuple(x.column() for x in row) for row in rows):
        sine, cosine = np.sin(psi), np.cos(psi)
        slope = np.abs(a.middle * cosine - b.middle * sine)
        size = np.hypot(a.middle, b.middle)
        moved = np.minimum(slope * h + 0.5 * size * h**2, 2.0 * size)
        middle = a.middle * sine + b.middle * cosine + c.middle
        found.append(Range(middle, a.radius + b.radius + c.radius + moved))
    return found


def _arc_cosine(c: list[Range], sine: Range) -> tuple[list[Range], list[Range], Range]:
    """First and second derivatives, and values, of the arc cosine of a wave."""
    weight = sine.inverse()
    first = [(weight * c[1 + 2 * k]).scaled(-1.0) for k in range(2)]
    second = [(weight * (c[2 + 2 * k] + c[0] * first[k].square())).scaled(-1.0) for k in range(2)]
    reach = np.fmin(c[0].radius, 2.0)
    low, high = (np.arccos(np.clip(c[0].middle + s * reach, -1.0, 1.0)) for s in (1.0, -1.0))
    return first, second, Range.between(low, high)


def _corners(
    arm: SrsArm, R: FloatArray, p: FloatArray, intervals: AngleCells, parts: int
) -> FloatArray:
    """Returns joints, of 2, 4 and 6 the positive angles, at each box's corners, shape (4, 7, c, k), going round."""
    here_middle = _directions(arm, R, p, middle(intervals))
    psi = np.linspace(-np.pi, np.pi, parts, endpoint=False)
    sides = []
    for angle in (intervals.low, intervals.high):
        turn = rotation_z(-angle)
        curves = arm.curves((turn @ R)[:, None], (turn @ p)[:, None])
        here = _directions(arm, R, p, angle)
        shift = _carried_along(here_middle, here, angle - middle(intervals))
        there = psi[None, :] + shift[:, None]
        sides.append(np.stack(np.broadcast_arrays(*curves.angles(np.sin(there), np.cos(there)))))
    low, high = sides
    for side, angle in zip(sides, (intervals.low, intervals.high), strict=True):
        turn = rotation_z(-angle)
        side[3] = arm.curves(turn @ R, turn @ p).plane.bend[:, None]
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


def spans_of(corners: FloatArray, bends: Bends, h: tuple[FloatArray, float]) -> FloatArray:
    """Returns lowest and highest positions of the joints, of any turn, shape (2, 7, c, k).

    Args:
        corners: as of `_corners`.
        bends: over the same cells.
        h: half-widths of the intervals, shape (c,), and of the parts.
    """
    step = np.diff(corners, axis=0)
    step -= TURN * np.round(step / TURN)
    change = np.concatenate([np.zeros((1, *step.shape[1:])), np.cumsum(step, axis=0)])
    below, above = _slacks(bends.second, (h[0][:, None], h[1]))
    with np.errstate(invalid="ignore"):
        around = np.stack(
            [
                corners[0] + change.min(axis=0) - below - ROUNDING,
                corners[0] + change.max(axis=0) + above + ROUNDING,
            ]
        )
        value = bends.value.middle + np.array([-1.0, 1.0]).reshape(2, 1, 1, 1) * (
            bends.value.radius + ROUNDING
        )
        narrow = bends.smooth & (around[1] - around[0] < value[1] - value[0])
    return np.where(narrow, around, value)


def _slacks(
    second: tuple[Range, ...], h: tuple[FloatArray | float, ...]
) -> tuple[FloatArray, FloatArray]:
    """Returns how far functions are below and above their chords, given second derivatives and half-widths."""
    below, above = np.zeros((2, 1))
    with np.errstate(invalid="ignore"):
        for own, half in zip(second, h, strict=True):
            below = below + 0.5 * half**2 * np.fmax(own.middle + own.radius, 0.0)
            above = above + 0.5 * half**2 * np.fmax(own.radius - own.middle, 0.0)
    return below, above


@dataclass(frozen=True)
class _Circle:
    """One end of a line, over one interval."""

    corners: FloatArray
    """Joints at both ends of the interval and the begin of each part, shape (2, 7, k)."""
    bends: Bends
    """Over the parts."""
    spans: FloatArray
    """Shape (2, 7, k)."""


def line_times(
    law: RestToRest, free_last: bool, ends: tuple[_Circle, _Circle], h: tuple[float, float]
) -> FloatArray:
    """Returns the least times of lines from every part of the circle to any posture at the target [s], shape (k,).

    All pairs, and all shares of the differences of the arm angle, one by one.

    Args:
        law: of the joints.
        free_last: whether joint 7 is free.
        ends: where the line begins, and at the target.
        h: half-widths of the interval and of the parts.
    """
    start, target = ends
    k = start.corners.shape[2]
    joints = [j for j in range(7) if not free_last or j != 6]
    groups = [[j for j in own if j in joints] for own in (SHOULDER, WRIST)]
    spans = start.spans
    best = np.full(k, np.inf)
    low = high = np.zeros(7)
    for m in range(k):
        p, after = (np.arange(k) + m) % k, (np.arange(k) + m + 1) % k
        last = (after + 1) % k
        # A part at the target and the next one, on the turn next to the first.
        own, next_one = target.spans[:, :, p], target.spans[:, :, after]
        with np.errstate(invalid="ignore"):
            shift = TURN * np.round((own[0] - next_one[0]) / TURN)
            low = np.minimum(own[0], next_one[0] + shift)
            high = np.maximum(own[1], next_one[1] + shift)
        plain = _times(law, low - spans[1], high - spans[0])
        odd = np.arange(7)[:, None] % 2 == 1
        flipped = _times(
            law,
            np.where(odd, low + spans[0], low - spans[1] + np.pi),
            np.where(odd, high + spans[1], high - spans[0] + np.pi),
        )
        one = _unwrapped(start.corners, [np.arange(k), (np.arange(k) + 1) % k])
        other = _unwrapped(target.corners, [p, after, last])
        smooth = start.bends.smooth[:, 0] & target.bends.smooth[:, 0, p]
        smooth &= target.bends.smooth[:, 0, after]
        here = [Range(x.middle[:, 0], x.radius[:, 0]) for x in start.bends.second]
        there = [
            Range(x.middle[:, 0, p], x.radius[:, 0, p]).hull(
                Range(x.middle[:, 0, after], x.radius[:, 0, after])
            )
            for x in target.bends.second
        ]
        both = [
            Range(b.middle - a.middle, b.radius + a.radius)
            for a, b in zip(here, there, strict=True)
        ]
        below, above = _slacks((*both, there[1]), (*h, h[1]))
        for share in range(SHARES):
            ways = np.concatenate(
                [
                    other[:, i] + x * (other[:, i + 1] - other[:, i]) - one[:, i]
                    for i in range(2)
                    for x in (share / SHARES, (share + 1) / SHARES)
                ]
            )
            with np.errstate(invalid="ignore"):
                times = _times(
                    law,
                    ways.min(axis=0) - below - 2.0 * ROUNDING,
                    ways.max(axis=0) + above + 2.0 * ROUNDING,
                )
            times = np.maximum(np.where(smooth, times, 0.0), plain)
            total = times[3]
            for group in groups:
                total = np.maximum(
                    total, np.minimum(times[group].max(axis=0), flipped[group].max(axis=0))
                )
            best = np.minimum(best, total)
    # The other value of joint 4 at the target, over the whole circle.
    low, high = target.spans[0, 3].min(), target.spans[1, 3].max()
    cap = _times(law, np.tile(spans[0] + low, (1, 1)), spans[1] + high)[3]
    return np.minimum(best, cap)


def _unwrapped(corners: FloatArray, columns: list[IntArray]) -> FloatArray:
    """Corners of parts on the turns next to the first one, shape (2, len(columns), 7, k)."""
    rows = np.stack([corners[:, :, column] for column in columns], axis=1)
    rows[1, 0] += TURN * np.round((rows[0, 0] - rows[1, 0]) / TURN)
    for i in range(1, len(columns)):
        rows[:, i] += TURN * np.round((rows[:, i - 1] - rows[:, i]) / TURN)
    return rows


def _times(law: RestToRest, low: FloatArray, high: FloatArray) -> FloatArray:
    """Times of the least distance of ranges (7, k) from whole turns [s], by the table."""
    with np.errstate(invalid="ignore"):
        known = high - low < TURN  # not where either is no number
        shift = TURN * np.round(0.5 * (low + high) / TURN)
        way = np.where(known, np.maximum(np.maximum(low - shift, shift - high), 0.0), 0.0)
    per_step, table = law.time_table
    step = np.minimum((way * per_step).astype(np.int64), table.shape[1] - 1)
    return np.take_along_axis(table.astype(np.float64), step, axis=1)


def within_reach(
    arm: SrsArm, R: FloatArray, p: FloatArray, edges: FloatArray, resolution: Resolution
) -> AngleCells:
    """Returns the parts of the platform's cells from which a flange pose is within reach."""
    return reachable_cells(arm, arm.wrist_center(R, p), finer_edges(edges, resolution.finer))


def pose_cells(
    arm: SrsArm,
    flange: tuple[FloatArray, FloatArray],
    intervals: AngleCells,
    resolution: Resolution,
    free_last: bool,
    line: LineToTarget | None,
) -> Cells:
    """Returns cells that cover every posture of one flange pose, as `bound/cells.py` has it."""
    R, p = flange
    finer, parts = resolution.finer, resolution.arm_angles * resolution.finer
    if not len(intervals.index):
        return free_cells(arm, np.zeros(1))
    h = half(intervals), np.pi / parts
    made = []
    for point in (p, *(() if line is None else (line.target,))):
        corners = _corners(arm, R, point, intervals, parts)
        bends = bends_of(arm, shape_of(arm, R, point, intervals), half(intervals), parts)
        made.append((corners, bends, spans_of(corners, bends, h)))
    first, second = _limited(arm, made[0][2], free_last)
    possible = _possible(first)
    for c in range(len(possible)):
        if MARGINAL * possible[c].any(axis=1).sum() <= parts:
            ends = np.linspace(intervals.low[c], intervals.high[c], SPLITS + 1)
            split = AngleCells(np.zeros(SPLITS, dtype=np.int64), ends[:-1], ends[1:])
            corners = _corners(arm, R, p, split, SPLITS * parts)
            bends = bends_of(arm, shape_of(arm, R, p, split), half(split), SPLITS * parts)
            spans = spans_of(corners, bends, (half(split), np.pi / (SPLITS * parts)))
            possible[c] &= _possible(_limited(arm, spans, free_last)[0]).any(axis=(0, 1))
    cells, part, psi = _every_branch(possible, first, second, intervals, finer)
    times = np.zeros((len(intervals.index), parts))
    if line is not None:
        for c in range(len(times)):
            ends = [
                _Circle(
                    np.stack([corners[0, :, c], corners[3, :, c]]),
                    Bends(
                        tuple(Range(x.middle[:, [c]], x.radius[:, [c]]) for x in bends.second),
                        bends.smooth[:, [c]],
                        bends.value,
                    ),
                    spans[:, :, c],
                )
                for corners, bends, spans in made
            ]
            times[c] = line_times(line.law, free_last, tuple(ends), (h[0][c], h[1]))
        times = np.maximum(times, line.floor(intervals)[:, None])
    merged = _merged(cells, psi // finer)
    # A cell's line is the shortest from any of its fine ones that some branch can be in.
    needed = np.full((int(intervals.index.max()) // finer + 1, resolution.arm_angles), np.inf)
    np.minimum.at(needed, (intervals.index[part] // finer, psi // finer), times[part, psi])
    return replace(merged.cells, line=needed[merged.cells.index, merged.part])


def _limited(
    arm: SrsArm, spans: tuple[FloatArray, FloatArray], free_last: bool
) -> tuple[_Ranges, _Ranges]:
    """Returns the joints' spans of both branches within limits, on up to two turns."""
    low, high = spans
    odd = np.arange(7).reshape(7, 1, 1) % 2 == 1
    offset = np.where(odd, arm.canonical.offset.reshape(7, 1, 1), 0.0)
    low, high = (
        np.where(odd, np.maximum(low, 0.0), low),
        np.where(odd, np.minimum(high, np.pi), high),
    )
    found = Enclosures(
        np.stack([low - offset, np.where(odd, -high - offset, low + np.pi)], axis=1),
        np.stack([high - offset, np.where(odd, -low - offset, high + np.pi)], axis=1),
    )
    if free_last:
        found.low[6], found.high[6] = -np.inf, np.inf
    return _within_limits(found, arm.lower, arm.upper)


def _possible(first: _Ranges) -> BoolArray:
    """Returns whether all joints of a branch can be within limits, shape (c, k, 8)."""
    branches = np.arange(8)
    possible = np.ones((*first.low.shape[2:], 8), dtype=np.bool_)
    for joint in range(7):
        flip = flips(joint, branches).astype(np.int64)
        possible &= np.moveaxis(first.meets[joint][flip], 0, -1)
    return possible


@dataclass(frozen=True)
class Enclosures:
    """Ranges of all joints over c intervals of the platform angle and k of the arm angle, of any turn.

    A branch takes of every joint one of two values (see `arm_angle_curves.flips`).
    """

    low: FloatArray
    """Lowest position [rad], shape (7, 2, c, k); -inf where nothing is known."""
    high: FloatArray
    """Highest position [rad], shape (7, 2, c, k); inf where nothing is known."""


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
    low, high = found.low, found.high
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
    possible: BoolArray, first: _Ranges, second: _Ranges, intervals: AngleCells, finer: int
) -> tuple[Cells, IntArray, IntArray]:
    """Returns the fine cells of all branches and turns, their intervals and their parts of the circle."""
    branches = np.arange(8)
    flip = np.stack([flips(joint, branches).astype(np.int64) for joint in range(7)])
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


@dataclass(frozen=True)
class _Merged:
    cells: Cells
    part: IntArray
    """Part of the circle of each, shape (n,)."""


def _merged(cells: Cells, psi: IntArray) -> _Merged:
    """Returns one cell around all of a platform cell that have branch, turns and part of the circle in common."""
    if not len(psi):
        return _Merged(cells, psi)
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
    found = Cells(
        cells.index[order][first],
        cells.kind[order][first],
        np.minimum.reduceat(cells.low[order], first),
        np.maximum.reduceat(cells.high[order], first),
        np.zeros(len(first)),
    )
    return _Merged(found, psi[order][first])
