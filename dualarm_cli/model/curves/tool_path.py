"""Tool paths: lines, arcs, turns and splines of a tool centre point, by length."""

from __future__ import annotations

from dataclasses import field
from functools import cached_property
from itertools import pairwise
from math import comb
from typing import Protocol

import numpy as np
import pinocchio as pin

from dualarm_cli.geometry.arrays import FloatArray, readonly
from dualarm_cli.geometry.elementary import TURN, arctan2, cos, power
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.geometry.rotations import exp_rotation, log_rotation, right_jacobian
from dualarm_cli.geometry.splines import PoseSpline
from dualarm_cli.model.curves.arc_length import ArcLength
from dualarm_cli.records import dataclass

TURN_LENGTH = 0.1
"""Length that stands for a rotation by one radian [m]."""


@dataclass(frozen=True)
class ToolPathSettings:
    """Resolution and tolerances of tool paths."""

    same_direction: float = 1e-3
    """Change of direction above which two pieces meet in a corner, per length."""
    spline_nodes: int = 2048
    """Number of nodes at which the length of a spline is measured."""
    spacing: float = 0.3
    """Spacing of a rounded corner's outer control points, per reach.

    Of all quintics whose curvature begins and ends at zero, this one has nearly the widest bend for its distance from
    the corner.
    """
    shortest_rest: float = 1e-9
    """Relative length below which the rest of a straight piece is omitted."""
    rounded_nodes: int = 33
    """Initial number of nodes for the length of a rounded corner."""


TOOL_PATH = ToolPathSettings()


APEX = (16.0 - 25.0 * TOOL_PATH.spacing) / 32.0
"""Distance of a rounded corner's middle, per reach and difference of directions."""
SHARPEST = cos(np.deg2rad(135.0))
"""Cosine of the largest change of direction that is rounded.

At sharper corners a stop is as fast.
"""
QUINTIC = np.array([comb(5, k) for k in range(6)], dtype=np.float64)
"""Binomial coefficients of quintic Bernstein polynomials."""

Poses = tuple[FloatArray, FloatArray]
"""Rotations (k, 3, 3) and positions (k, 3) [m] in the world."""


class Piece(Protocol):
    """Smooth piece of a path."""

    @property
    def length(self) -> float:
        """Length [m]: the larger of distance and TURN_LENGTH times rotation."""

    def at(self, s: FloatArray) -> Poses:
        """Compute poses at lengths s (k,) [m], 0 to `length`."""


@dataclass(frozen=True)
class Line:
    """Straight line with rotation about one axis in proportion to the length."""

    start: pin.SE3
    """Pose at the start."""
    end: pin.SE3
    """Pose at the end."""

    @cached_property
    def _turn(self) -> FloatArray:
        return log_rotation(product(self.start.rotation.T, self.end.rotation))

    @cached_property
    def length(self) -> float:
        """Length [m]."""
        distance = float(norm(self.end.translation - self.start.translation))
        return max(distance, TURN_LENGTH * float(norm(self._turn)))

    def at(self, s: FloatArray) -> Poses:
        """Compute poses at lengths s (k,) [m]."""
        fraction = (s / self.length)[:, None] if self.length else np.zeros((len(s), 1))
        offset = self.end.translation - self.start.translation
        R = product(self.start.rotation, exp_rotation(fraction * self._turn))
        return R, self.start.translation + fraction * offset

    def part(self, first: float, last: float) -> Line:
        """Cut the line at two lengths [m]."""
        R, p = self.at(np.array([first, last]))
        return Line(pin.SE3(R[0], p[0]), pin.SE3(R[1], p[1]))

    @property
    def direction(self) -> FloatArray:
        """Translation in the world and rotation in the tool, per length, shape (6,)."""
        offset = self.end.translation - self.start.translation
        return np.concatenate([offset, self._turn]) / self.length


@dataclass(frozen=True)
class Turn:
    """Rotation about a fixed axis: the tool centre point moves on a circle.

    The tool rotates along, keeps its rotation, or (as in arcs) has a rotation of its own.
    """

    start: pin.SE3
    """Pose at the start."""
    about: FloatArray
    """Point on the axis in the world [m], shape (3,)."""
    axis: FloatArray
    """Unit vector along the axis in the world, shape (3,)."""
    angle: float
    """Angle of rotation [rad], positive by the right-hand rule."""
    rotation: FloatArray
    """Rotation vector of the tool from start to end, in the world [rad], shape (3,)."""

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for name in ("about", "axis", "rotation"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    @cached_property
    def length(self) -> float:
        """Length [m]."""
        arm = self.start.translation - self.about
        radius = float(norm(arm - self.axis * product(self.axis, arm)))
        turned = TURN_LENGTH * float(norm(self.rotation))
        return max(radius * abs(self.angle), turned)

    def at(self, s: FloatArray) -> Poses:
        """Compute poses at lengths s (k,) [m]."""
        fraction = (s / self.length)[:, None] if self.length else np.zeros((len(s), 1))
        circle = exp_rotation(fraction * self.angle * self.axis)
        R = product(exp_rotation(fraction * self.rotation), self.start.rotation)
        return R, self.about + product(circle, self.start.translation - self.about)

    @classmethod
    def through(cls, start: pin.SE3, via: FloatArray, end: pin.SE3) -> Turn | None:
        """Build the arc from a pose through a point to a pose; None for collinear points.

        Args:
            start: pose at the start.
            via: point on the arc [m], shape (3,).
            end: pose at the end; the tool rotates about one axis from start to end.
        """
        a, b = via - start.translation, end.translation - start.translation
        normal = np.cross(a, b)
        size = float(product(normal, normal))
        if size < 1e-12 * (float(product(a, a)) * float(product(b, b))) or size == 0.0:
            return None
        # The circumcentre of the three points.
        to_centre = np.cross(normal, a) * product(b, b) + np.cross(b, normal) * product(a, a)
        about = start.translation + to_centre / (2.0 * size)
        axis = normal / np.sqrt(size)
        first, last = start.translation - about, end.translation - about
        angle = float(arctan2(product(axis, np.cross(first, last)), product(first, last)) % TURN)
        rotation = log_rotation(product(end.rotation, start.rotation.T))
        return cls(start, about, axis, angle, rotation)


@dataclass(frozen=True)
class Spline:
    """Smooth curve through poses, C2 in position and rotation, by chord length.

    Position is a natural cubic spline.
    """

    poses: tuple[pin.SE3, ...]
    """Two or more poses; neighbours differ."""

    @cached_property
    def _knots(self) -> FloatArray:
        steps = [Line(a, b).length for a, b in zip(self.poses, self.poses[1:], strict=False)]
        return np.concatenate([[0.0], np.cumsum(steps)])

    @cached_property
    def _curve(self) -> PoseSpline:
        p = np.array([pose.translation for pose in self.poses])
        R = np.array([pose.rotation for pose in self.poses])
        return PoseSpline.through(self._knots, R, p)

    @cached_property
    def _lengths(self) -> ArcLength:
        """Length over the parameter, with nodes at the knots and between them."""
        count = max(TOOL_PATH.spline_nodes, 32 * len(self.poses))
        index = np.linspace(0.0, len(self.poses) - 1.0, count)
        between = np.interp(index, np.arange(len(self.poses)), self._knots)
        return ArcLength.measure(self._speed, np.unique([*between.tolist(), *self._knots.tolist()]))

    @cached_property
    def turns_back(self) -> int | None:
        """Index of a pose at which translation and rotation reverse; else None.

        There the tool would have to stop.
        """
        u = self._lengths.parameter
        turned, moved = self._curve.rates(u)
        rate = np.hstack([moved, TURN_LENGTH * turned])
        back = np.flatnonzero((rate[1:] * rate[:-1]).sum(axis=1) <= 0.0)
        return int(np.argmin(np.abs(self._knots - u[back[0]]))) if back.size else None

    def _speed(self, u: FloatArray) -> FloatArray:
        """Compute the length per unit of the parameter."""
        turned, moved = self._curve.rates(u)
        return np.asarray(np.maximum(norm(moved, axis=-1), TURN_LENGTH * norm(turned, axis=-1)))

    @cached_property
    def length(self) -> float:
        """Length [m]."""
        return self._lengths.whole

    def at(self, s: FloatArray) -> Poses:
        """Compute poses at lengths s (k,) [m]."""
        return self._curve.at(self._lengths.at(s))


@dataclass(frozen=True)
class RoundedCorner:
    """Curve with continuous curvature that replaces the corner of two straight pieces.

    A quintic Bézier curve of position and rotation vector. On straight pieces both are proportional to length, so that
    the corner of a rotating tool is rounded likewise. The method is ours.
    """

    corner: pin.SE3
    """Pose at the corner."""
    before: FloatArray
    """Translation in the world and rotation in the tool, per length before, shape (6,)."""
    after: FloatArray
    """Translation in the world and rotation in the tool, per length after, shape (6,)."""
    reach: float
    """Length of each straight piece that the curve replaces [m]."""

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for name in ("before", "after"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    @cached_property
    def _points(self) -> FloatArray:
        offsets = (
            np.array([1.0, 1.0 - TOOL_PATH.spacing, 1.0 - 2.0 * TOOL_PATH.spacing])[:, None]
            * self.reach
        )
        return np.concatenate([-offsets * self.before, offsets[::-1] * self.after])

    def _bezier(self, u: FloatArray) -> FloatArray:
        """Compute translation and rotation vector from the corner at parameters (k,), shape (k, 6)."""
        powers = np.arange(6)
        weights = QUINTIC * power(u[:, None], powers) * power(1.0 - u[:, None], powers[::-1])
        return product(weights, self._points)

    @property
    def left_by(self) -> float:
        """Distance of the curve's middle from the corner, its largest [m]."""
        return float(norm(self._bezier(np.array([0.5]))[0, :3]))

    def _speed(self, u: FloatArray) -> FloatArray:
        """Compute the length per unit of the parameter."""
        powers = np.arange(5)
        weights = QUINTIC[:5] * (1.0 - powers / 5.0) * power(u[:, None], powers)
        rate = product(
            5.0 * (weights * power(1.0 - u[:, None], powers[::-1])), np.diff(self._points, axis=0)
        )
        turning = np.einsum("kij,kj->ki", right_jacobian(self._bezier(u)[:, 3:]), rate[:, 3:])
        speed: FloatArray = np.maximum(
            norm(rate[:, :3], axis=1), TURN_LENGTH * norm(turning, axis=1)
        )
        return speed

    @cached_property
    def _lengths(self) -> ArcLength:
        return ArcLength.refine(self._speed, np.linspace(0.0, 1.0, TOOL_PATH.rounded_nodes))

    @cached_property
    def length(self) -> float:
        """Length [m]."""
        return self._lengths.whole

    def at(self, s: FloatArray) -> Poses:
        """Compute poses at lengths s (k,) [m]."""
        offset = self._bezier(self._lengths.at(s))
        R = product(self.corner.rotation, exp_rotation(offset[:, 3:]))
        return R, self.corner.translation + offset[:, :3]


@dataclass(frozen=True)
class ToolPath:
    """Path of one tool centre point: pieces one after the other."""

    pieces: tuple[Piece, ...]
    """Pieces, at least one; each starts at the end of the one before."""
    _edges: FloatArray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Measure the pieces."""
        edges = np.concatenate([[0.0], np.cumsum([piece.length for piece in self.pieces])])
        object.__setattr__(self, "_edges", readonly(edges))

    @property
    def length(self) -> float:
        """Length of all pieces [m]."""
        return float(self._edges[-1])

    def at(self, s: FloatArray) -> Poses:
        """Compute poses at lengths s (k,) [m], clipped to the path."""
        s = np.clip(np.asarray(s, dtype=np.float64), 0.0, self.length)
        k = np.clip(np.searchsorted(self._edges, s, side="right") - 1, 0, len(self.pieces) - 1)
        R, p = np.empty((len(s), 3, 3)), np.empty((len(s), 3))
        for number, piece in enumerate(self.pieces):
            rows = k == number
            if rows.any():
                inner = np.clip(s[rows] - self._edges[number], 0.0, piece.length)
                R[rows], p[rows] = piece.at(inner)
        return R, p

    def rounded(self, blend: float) -> ToolPath:
        """Round the corners between straight pieces.

        A curve replaces at most half of each piece and is then closer to its corner. Corners at other pieces, and
        those that turn by more than 135 degrees, stay.

        Args:
            blend: largest distance from a corner [m], with TURN_LENGTH per radian of rotation.
        """
        curves = [_rounded(before, after, blend) for before, after in pairwise(self.pieces)]
        pieces: list[Piece] = []
        for piece, begins, ends in zip(self.pieces, [None, *curves], [*curves, None], strict=True):
            if isinstance(piece, Line):
                first = begins.reach if begins is not None else 0.0
                last = piece.length - (ends.reach if ends is not None else 0.0)
                # The curves at both ends may replace half of it each.
                if last - first > TOOL_PATH.shortest_rest * piece.length:
                    pieces.append(piece.part(first, last) if begins or ends else piece)
            else:
                pieces.append(piece)
            if ends is not None:
                pieces.append(ends)
        return ToolPath(tuple(pieces))

    @property
    def junctions(self) -> tuple[float, ...]:
        """Lengths at which pieces meet [m]."""
        return tuple(float(edge) for edge in self._edges[1:-1])

    def pose(self, s: float) -> pin.SE3:
        """Compute the pose at one length [m]."""
        R, p = self.at(np.array([s]))
        return pin.SE3(R[0], p[0])

    @cached_property
    def corners(self) -> tuple[float, ...]:
        """Lengths at which the tool must stop because its direction changes [m]."""
        corners = []
        for edge, piece, following in zip(
            self._edges[1:], self.pieces, self.pieces[1:], strict=False
        ):
            direction, next_direction = _direction(piece, piece.length), _direction(following, 0.0)
            if np.abs(direction - next_direction).max() > TOOL_PATH.same_direction:
                corners.append(float(edge))
        return tuple(corners)


def _rounded(piece: Piece, following: Piece, blend: float) -> RoundedCorner | None:
    """Round the corner of two pieces; None if it is smooth or cannot be rounded."""
    if not (isinstance(piece, Line) and isinstance(following, Line)):
        return None
    scale = np.repeat([1.0, TURN_LENGTH], 3)
    before, after = piece.direction, following.direction
    away = norm((scale * (after - before)).reshape(2, 3), axis=1).max()
    if away <= TOOL_PATH.same_direction or product(
        scale * before, scale * after
    ) < SHARPEST * float(norm(scale * before) * norm(scale * after)):
        return None
    reach = min(blend / (APEX * float(away)), 0.5 * piece.length, 0.5 * following.length)
    return RoundedCorner(piece.end, before, after, reach)


def _direction(piece: Piece, s: float) -> FloatArray:
    """Estimate translation and rotation per length at one end, shape (6,).

    One-sided difference.
    """
    step = 1e-3 * piece.length
    if step == 0.0:
        return np.zeros(6)
    inward = 1.0 if s == 0.0 else -1.0
    # Second order: from the values at the end, one step and two steps inward.
    R, p = piece.at(s + inward * step * np.arange(3.0))
    turn = log_rotation(product(R, R[0].T))
    stacked = np.concatenate([p - p[0], TURN_LENGTH * turn], axis=1)
    slope: FloatArray = inward * (4.0 * stacked[1] - stacked[2]) / (2.0 * step)
    return slope
