"""First three axes of an arm and their carried point: reach and postures."""

from __future__ import annotations

from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dualarm_cli.geometry import elementary
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray, readonly
from dualarm_cli.geometry.elementary import TURN
from dualarm_cli.geometry.products import product
from dualarm_cli.geometry.roots import (
    derivative,
    first_order_square,
    polynomial_value,
    real_zeros,
)
from dualarm_cli.kinematics.srs.srs_limits import wrap
from dualarm_cli.records import dataclass

Family = Literal["elbow", "two_steps", "quartic"]


@dataclass(frozen=True)
class ThreeAxesSettings:
    """Tolerances, grid and Newton limits of the postures of three axes."""

    parallel: float = 1e-7
    """Sine of the angle of two axes below which they count as parallel."""
    meeting: float = 1e-9
    """Distance of two axes below which they meet, and least first harmonics [m, m²]."""
    least_link: float = 1e-6
    """Shortest link of an elbow [m]."""
    least_product: float = 1e-3
    """Smallest distance of axes 1 and 2 times their angle's sine [m].

    Below it the quartic does not keep its digits.
    """
    reach_slack: float = 1e-11
    """Rounding tolerance of the reach of a point [m]."""
    tiny: float = 1e-12
    """Distance from an axis below which a point has no angle about it [m]."""
    coarse: int = 32
    """Samples of joints 2 and 3 on the grid of places."""
    valleys: int = 4
    """Number of local minima of the grid that Newton's method refines."""
    steps: int = 60
    """Maximum number of Newton steps."""
    largest_step: float = 0.3
    """Longest Newton step of a joint [rad]."""
    still: float = 1e-10
    """Length of a Newton step at convergence [rad]."""
    block: int = 500
    """Number of places that are solved together."""


AXES = ThreeAxesSettings()


@dataclass(frozen=True)
class ThreeAxes:
    """Three revolute axes and a point beyond the third, in frames along the axes.

    The z axes of the frames are the joints' axes, as in GeneralArm.

    The origins of frames 1 and 2 are moved along their axes to the feet of the common normal of axes 1 and 2, so that
    R12^T p12 is the normal itself: across both axes, of the length of their distance.
    """

    R1: FloatArray
    """Frame 1 in the frame that carries the arm, joint 1 at zero, shape (3, 3)."""
    p1: FloatArray
    """Origin of frame 1 [m], shape (3,)."""
    R12: FloatArray
    """Frame 2, joint 2 at zero, in frame 1, shape (3, 3)."""
    p12: FloatArray
    """Origin of frame 2 in frame 1 [m], across axis 1, shape (3,)."""
    R23: FloatArray
    """Frame 3, joint 3 at zero, in frame 2, shape (3, 3)."""
    p23: FloatArray
    """Origin of frame 3 in frame 2 [m], shape (3,)."""
    point: FloatArray
    """Carried point in frame 3 [m], shape (3,)."""

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for name in self.__dataclass_fields__:
            object.__setattr__(self, name, readonly(getattr(self, name)))

    @classmethod
    def of(cls, R: FloatArray, p: FloatArray, point: FloatArray) -> ThreeAxes:
        """Build from joint frames, moved to the common normal of the first two axes.

        Args:
            R: constant rotation before each joint's motion, shape (3, 3, 3).
            p: constant translation before each joint's motion [m], shape (3, 3).
            point: carried point in frame 3 [m], shape (3,).
        """
        across = R[1][:2, 2]
        sine2 = float(product(across, across))
        # Parallel axes have normals everywhere.
        shift = (
            -float(product(p[1][:2], across)) / sine2 if sine2 > np.square(AXES.parallel) else 0.0
        )
        p12 = p[1] + shift * R[1][:, 2]
        p23 = p[2] - np.array([0.0, 0.0, shift])
        p1 = p[0] + R[0][:, 2] * p12[2]
        return cls(R[0], p1, R[1], p12 * [1.0, 1.0, 0.0], R[2], p23, point)

    @cached_property
    def axis1(self) -> complex:
        """Part of axis 1 across axis 2 in frame 2, as a complex number.

        Its modulus is the sine of the axes' angle.
        """
        return complex(self.R12[2, 0], self.R12[2, 1])

    @cached_property
    def normal(self) -> complex:
        """Common normal of axes 1 and 2 in frame 2, complex [m]."""
        u = product(self.R12.T, self.p12)
        return complex(u[0], u[1])

    @cached_property
    def circle(self) -> FloatArray:
        """Point in frame 2: rows times (1, cos, sin) of q3 [m], (3, 3)."""
        x, y, z = self.point
        R = self.R23
        return readonly(
            np.array([self.p23 + R[:, 2] * z, R[:, 0] * x + R[:, 1] * y, R[:, 1] * x - R[:, 0] * y])
        )

    @cached_property
    def squared(self) -> FloatArray:
        """Squared distance from frame 2's origin, times (1, cos, sin) [m²], shape (3,).

        The cosine and sine are those of joint 3.
        """
        c, a, b = self.circle
        return readonly([product(c, c) + product(a, a), product(2.0 * c, a), product(2.0 * c, b)])

    @cached_property
    def family(self) -> Family | None:
        """Family of the closed form, or None if the point spans no volume.

        elbow: axes 2 and 3 parallel. two_steps: axes 1 and 2 meet or are parallel, so that joint 3 follows by itself.
        quartic: any other three ([Pieper1968]) whose axes 1 and 2 do not nearly meet or are nearly parallel: None too.
        """
        crossed = abs(self.axis1) > AXES.parallel
        if float(np.hypot(*self.R23[:2, 2])) <= AXES.parallel:
            links = min(abs(complex(*self.p23[:2])), abs(complex(*self.point[:2])))
            return "elbow" if crossed and links > AXES.least_link else None
        if not crossed:
            lifts = min(float(np.hypot(*self.circle[1:, 2])), abs(self.normal)) > AXES.meeting
            return "two_steps" if lifts else None
        if abs(self.normal) <= AXES.meeting:
            return "two_steps" if float(np.hypot(*self.squared[1:])) > AXES.meeting else None
        moves = np.abs(self.circle[1:, 2]).max() + np.abs(self.squared[1:]).max()
        is_accurate = abs(self.normal) * abs(self.axis1) >= AXES.least_product
        return "quartic" if is_accurate and float(moves) > AXES.meeting else None

    @cached_property
    def neglected(self) -> float:
        """Deviation from the family [m or rad].

        Infinite if zeros are not exact to rounding.
        """
        if self.family == "elbow":
            return float(np.hypot(*self.R23[:2, 2]))
        if self.family == "two_steps":
            return min(abs(self.axis1), abs(self.normal))
        return np.inf

    def place(self, q: FloatArray) -> FloatArray:
        """Compute the point in frame 1 at joint 1 zero [m], shape (..., 3).

        Args:
            q: joints 2 and 3 [rad], shape (..., 2).
        """
        c, s = elementary.cos(q), elementary.sin(q)
        f = self.circle[0] + c[..., 1:] * self.circle[1] + s[..., 1:] * self.circle[2]
        x = c[..., 0] * f[..., 0] - s[..., 0] * f[..., 1]
        y = s[..., 0] * f[..., 0] + c[..., 0] * f[..., 1]
        places: FloatArray = product(np.stack([x, y, f[..., 2]], axis=-1), self.R12.T) + self.p12
        return places

    def section(self, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Compute the point's distance from axis 1 and position along it, with derivatives.

        Args:
            q: joints 2 and 3 [rad], shape (b, 2).

        Returns:
            Values [m], shape (b, 2), first derivatives (b, 2, 2) and second derivatives (b, 2, 2, 2).
        """
        c, s = elementary.cos(q), elementary.sin(q)
        constant, a, b = self.circle
        f = constant + c[:, 1:] * a + s[:, 1:] * b
        df, ddf = c[:, 1:] * b - s[:, 1:] * a, -(c[:, 1:] * a + s[:, 1:] * b)
        # Rows of Rz(q2) and its derivatives on f and its derivatives: place, then by (2), (3), (2, 2), (2, 3), (3, 3).
        x, y, z = np.stack([f, f, df, f, df, ddf]).transpose(2, 0, 1)
        cos = np.stack([c[:, 0], -s[:, 0], c[:, 0], -c[:, 0], -s[:, 0], c[:, 0]])
        sin = np.stack([s[:, 0], c[:, 0], s[:, 0], -s[:, 0], c[:, 0], s[:, 0]])
        z = z * np.array([1.0, 0.0, 1.0, 0.0, 0.0, 1.0])[:, None]
        h = product(np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=-1), self.R12.T)
        h[0] += self.p12
        r = np.maximum(np.hypot(h[0, :, 0], h[0, :, 1]), 1e-12)
        toward = h[0, :, :2] / r[:, None]
        radial = (h[1:, :, :2] * toward).sum(axis=-1)
        # Motion across the radius bends it as well.
        aside = h[1:3, :, 1] * toward[:, 0] - h[1:3, :, 0] * toward[:, 1]
        bent = (
            radial[2:]
            + np.stack([np.square(aside[0]), aside[0] * aside[1], np.square(aside[1])]) / r
        )
        at = np.stack([r, h[0, :, 2]], axis=1)
        slope = np.stack([radial[:2].T, h[1:3, :, 2].T], axis=1)
        both = np.stack([bent.T, h[3:, :, 2].T], axis=1)
        return at, slope, both[..., [0, 1, 1, 2]].reshape(len(q), 2, 2, 2)


ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class PointPostures:
    """Four postures of three joints for each of b places."""

    q: FloatArray
    """Joints in (-pi, pi] [rad], finite everywhere, shape (b, 4, 3)."""
    reachable: BoolArray
    """Flags of postures that reach their place, shape (b, 4)."""
    singular: BoolArray
    """Flags of a free joint 1 or 2 at its reference, shape (b, 4)."""


Turns = tuple[ComplexArray, FloatArray, BoolArray]
"""Point across axis 2, joint 3, and flags of existing solutions, (b, 4) each."""


def point_postures(axes: ThreeAxes, p: FloatArray, reference: FloatArray) -> PointPostures:
    """Solve for the postures that carry the point to places.

    Slots of the family elbow: 2 * shoulder + elbow. Shoulder is 0 where the point is on the side of axis 1 to which the
    common normal of axes 1 and 2 points (where they meet: to which axis 2 x axis 1 does), elbow is 1 where the
    second link is turned clockwise about axis 2 against the first one. Of two_steps: 2 * (joint 3 beyond its middle) +
    (point clockwise of the given direction). Of quartic: 0 and 1 where its polynomial rises, 3 and 2 where it falls,
    by ascending joint 3; the sign is that of the Jacobian's determinant and so is kept between singularities; the
    order is not where such an arm is cuspidal, or joint 3 passes half a turn.

    Args:
        axes: with a family.
        p: places in the frame that carries the arm [m], shape (b, 3).
        reference: values of free joints 1 to 3 [rad], shape (b, 3).
    """
    place = product(p - axes.p1, axes.R1)
    w, z = place[:, 0] + 1j * place[:, 1], place[:, 2]
    solve = {"elbow": _elbow, "two_steps": _two_steps, "quartic": _quartic}[axes.family or "elbow"]
    v, q3, reachable = solve(axes, elementary.modulus(w), z)
    f = _over(axes.circle, q3)
    free2, free1 = elementary.modulus(v) < AXES.tiny, (elementary.modulus(w) < AXES.tiny)[:, None]
    q2 = np.where(free2, reference[:, 1:2], elementary.angle_between(v, f[0] + 1j * f[1]))
    h = axes.R12[:2, :1, None] * v.real + axes.R12[:2, 1:2, None] * v.imag
    h = h + axes.R12[:2, 2:, None] * f[2] + axes.p12[:2, None, None]
    q1 = np.where(free1, reference[:, :1], elementary.angle_between(w[:, None], h[0] + 1j * h[1]))
    q = wrap(np.stack([q1, q2, q3], axis=-1))
    return PointPostures(
        np.where(reachable[..., None], q, 0.0), reachable, (free1 | free2) & reachable
    )


def _elbow(axes: ThreeAxes, r: FloatArray, z: FloatArray) -> Turns:
    """Solve for postures of parallel axes 2 and 3.

    First circle and plane are intersected, then the two links.
    """
    P, omega = complex(*axes.p23[:2]), complex(*axes.point[:2])
    sign = 1.0 if axes.R23[2, 2] > 0.0 else -1.0
    height = float(axes.p23[2] + sign * axes.point[2])
    E = axes.axis1 / abs(axes.axis1)
    # Across axes 1 and 2: in frame 2, and in frame 1.
    n = 1j * E
    N = complex(*(axes.R12[:2, 0] * n.real + axes.R12[:2, 1] * n.imag))
    if (complex(*axes.p12[:2]) * N.conjugate()).real < -AXES.meeting:
        n, N = -n, -N
    # The plane of the links cuts height z of frame 1 in the line foot + t n.
    foot = (z - axes.R12[2, 2] * height) / abs(axes.axis1)
    along = product(axes.R12[:2, :2], np.array([E.real, E.imag]))
    h = foot * complex(*along) + complex(*(axes.R12[:2, 2] * height + axes.p12[:2]))
    local = elementary.complex_product(h, N.conjugate())
    aside = np.abs(local.imag)
    t = np.sqrt(np.maximum((r - aside) * (r + aside), 0.0))
    v = foot[:, None] * E + n * (np.stack([t, -t], axis=1) - local.real[:, None])
    d, L2, L3 = elementary.modulus(v), abs(P), abs(omega)
    # Half the angle between the links: both factors vanish exactly where the arm is stretched or folded.
    out, in_ = L2 + L3 - d, d - abs(L2 - L3)
    half = elementary.arctan2(np.sqrt(np.maximum(out * (L2 + L3 + d), 0.0)), _inner(in_, d, L2, L3))
    ok = (
        ((r - aside) >= -AXES.reach_slack)[:, None]
        & (out >= -AXES.reach_slack)
        & (in_ >= -AXES.reach_slack)
    )
    zero = elementary.arctan2(axes.R23[1, 0], axes.R23[0, 0]) - elementary.angle_of(P)
    bend = np.stack([2.0 * half, -2.0 * half], axis=-1)
    # The second link's direction against the first one's is zero + sign (q3 + angle(omega)).
    q3 = sign * (bend - zero) - elementary.angle_of(omega)
    return np.repeat(v, 2, axis=1), q3.reshape(-1, 4), np.repeat(ok, 2, axis=1)


def _inner(in_: FloatArray, d: FloatArray, L2: float, L3: float) -> FloatArray:
    return np.sqrt(np.maximum(in_ * (d + abs(L2 - L3)), 0.0))


def _two_steps(axes: ThreeAxes, r: FloatArray, z: FloatArray) -> Turns:
    """Solve for postures of meeting or parallel axes 1, 2, joint 3 first."""
    meets = abs(axes.axis1) > AXES.parallel
    if meets:
        # |f(q3)| is the distance from where axes 1 and 2 meet.
        g, size = axes.squared, np.sqrt(r * r + z * z)
        constant = g[0] - size * size
    else:
        # Axis 2 is parallel to axis 1: f_z(q3) is the height.
        g, size = axes.circle[:, 2], np.ones_like(z)
        constant = g[0] - axes.R12[2, 2] * z
    amplitude = np.hypot(g[1], g[2])
    half = elementary.arccos(np.clip(-constant / amplitude, -1.0, 1.0))
    q3 = elementary.arctan2(g[2], g[1]) + np.stack([half, half, -half, -half], axis=1)
    ok = np.abs(constant) - amplitude <= AXES.reach_slack * np.maximum(size, AXES.reach_slack)
    f = _over(axes.circle, q3)
    length = np.hypot(f[0], f[1])
    if meets:
        line, direction = z[:, None] - axes.R12[2, 2] * f[2], axes.axis1
    else:
        line, direction = (
            0.5 * (np.square(r[:, None]) - np.square(abs(axes.normal)) - np.square(length)),
            axes.normal,
        )
    line = line / abs(direction)
    rest = (length - np.abs(line)) * (length + np.abs(line))
    side = np.sqrt(np.maximum(rest, 0.0)) * [1.0, -1.0, 1.0, -1.0]
    ok = ok[:, None] & (length - np.abs(line) >= -AXES.reach_slack)
    along = np.clip(line, -length, length) + 1j * side
    v = elementary.complex_product(direction / abs(direction), along)
    return v, q3, ok


def _quartic(axes: ThreeAxes, r: FloatArray, z: FloatArray) -> Turns:
    """Solve for postures of any three axes, second order in joint 3.

    The equation is |v|² = |f_xy|².
    """
    u, e = axes.normal, axes.axis1
    f, b = axes.circle.T, len(r)
    # Both right sides over (1, cos, sin) of joint 3.
    first = np.broadcast_to(-0.5 * axes.squared, (b, 3)).copy()
    first[:, 0] += 0.5 * (r * r + z * z - np.square(abs(u)))
    second = np.broadcast_to(-axes.R12[2, 2] * f[2], (b, 3)).copy()
    second[:, 0] += z
    # The normal is across axis 1: v follows from its parts along either.
    along, across = first / abs(u), second / abs(e)
    polynomial = first_order_square(along) + first_order_square(across)
    polynomial -= first_order_square(f[:1]) + first_order_square(f[1:2])
    zeros = real_zeros(polynomial)
    rises = polynomial_value(derivative(polynomial), zeros.angle) >= 0.0
    q3, ok = np.zeros((b, 4)), np.zeros((b, 4), dtype=np.bool_)
    for selected, first_slot, direction in (
        (rises & zeros.exists, 0, 1),
        (~rises & zeros.exists, 3, -1),
    ):
        row, column = np.nonzero(selected)
        slot = first_slot + direction * (np.cumsum(selected, axis=1)[row, column] - 1)
        q3[row, slot], ok[row, slot] = zeros.angle[row, column], True
    x = _first_order(along, q3)
    y = _first_order(across, q3)
    return x * (u / abs(u)) + y * (e / abs(e)), q3, ok


def _over(rows: FloatArray, q3: FloatArray) -> FloatArray:
    """Compute coordinates (1, cos, sin) q3 times rows (3, k), shape (k, ...)."""
    c, s = elementary.cos(q3), elementary.sin(q3)
    return np.stack([k + a * c + b * s for k, a, b in rows.T])


def _first_order(rows: FloatArray, q3: FloatArray) -> FloatArray:
    """Evaluate first-order trigonometric polynomials (b, 3) at angles (b, 4)."""
    values: FloatArray = (
        rows[:, :1] + rows[:, 1:2] * elementary.cos(q3) + rows[:, 2:] * elementary.sin(q3)
    )
    return values


def point_miss(axes: ThreeAxes, p: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Compute the distance of places from the nearest point in reach [m], shape (b,).

    Joint 1 turns a place about axis 1 and is taken as free, so that distances from axis 1 and along it are compared,
    over joints 2 and 3: on a grid, then by Newton's method from its valleys. Our own derivation.

    Args:
        axes: axes that carry the point.
        p: places in the frame that carries the arm [m], shape (b, 3).
        lower: lowest positions of joints 2 and 3 [rad], shape (2,), -inf allowed.
        upper: highest positions [rad], shape (2,), inf allowed.
    """
    free = ~(upper - lower < TURN)
    low, high = np.where(free, -np.pi, lower), np.where(free, np.pi, upper)
    grid = np.stack(
        np.meshgrid(*(np.linspace(low[k], high[k], AXES.coarse) for k in (0, 1)), indexing="ij"),
        axis=-1,
    ).reshape(-1, 2)
    reached = axes.section(grid)[0]
    local = product(p - axes.p1, axes.R1)
    wanted = np.stack([np.hypot(local[:, 0], local[:, 1]), local[:, 2]], axis=1)
    # Free joints may move beyond the ends of one turn.
    low, high = np.where(free, -np.inf, low), np.where(free, np.inf, high)
    distances = np.empty(len(p))
    for first in range(0, len(p), AXES.block):
        block = wanted[first : first + AXES.block]
        away = np.hypot(*np.moveaxis(reached - block[:, None], -1, 0))
        q = grid[_valleys(away.reshape(-1, AXES.coarse, AXES.coarse))].reshape(-1, 2)
        least = _descend(axes, q, np.repeat(block, AXES.valleys, axis=0), low, high)
        distances[first : first + AXES.block] = least.reshape(-1, AXES.valleys).min(axis=1)
    return distances


def _valleys(distance: FloatArray) -> IntArray:
    """Select the lowest local minima of grids of distances.

    Args:
        distance: values on the grids, shape (b, n, n).

    Returns:
        Flat indices, shape (b, `valleys`).
    """
    b, n, _ = distance.shape
    walled = np.pad(distance, ((0, 0), (1, 1), (1, 1)), constant_values=np.inf)
    lowest = np.ones(distance.shape, dtype=np.bool_)
    for i in range(3):
        for j in range(3):
            lowest &= distance <= walled[:, i : i + n, j : j + n]
    height = np.where(lowest, distance, np.inf).reshape(b, -1)
    return np.argsort(height, axis=1, kind="stable")[:, : AXES.valleys]


def _descend(
    axes: ThreeAxes, q: FloatArray, wanted: FloatArray, low: FloatArray, high: FloatArray
) -> FloatArray:
    """Minimise distances from joints (b, 2) by Newton's method with a trust region, (b,)."""
    active = np.arange(len(q))
    least = np.hypot(*(axes.section(q)[0] - wanted).T)
    trust = np.full(len(q), AXES.largest_step)
    for _ in range(AXES.steps):
        current = q[active]
        step = _newton_step(axes, current, wanted[active], low, high)
        longest = np.abs(step).max(axis=1)
        step *= np.minimum(1.0, trust[active] / np.maximum(longest, 1e-300))[:, None]
        candidate = np.clip(current + step, low, high)
        distance = np.hypot(*(axes.section(candidate)[0] - wanted[active]).T)
        better = distance < least[active]
        q[active[better]], least[active[better]] = candidate[better], distance[better]
        size = np.abs(candidate - current).max(axis=1)
        trust[active] = np.where(
            better, np.minimum(2.0 * trust[active], AXES.largest_step), 0.25 * size
        )
        active = active[size > AXES.still]
        if not len(active):
            break
    return least


def _newton_step(
    axes: ThreeAxes, q: FloatArray, wanted: FloatArray, low: FloatArray, high: FloatArray
) -> FloatArray:
    """Compute Newton steps (b, 2) on half the squared distance.

    Joints at limits are fixed.
    """
    at, slope, bend = axes.section(q)
    e = at - wanted
    gradient = (slope * e[:, :, None]).sum(axis=1)
    H = product(np.swapaxes(slope, 1, 2), slope) + (bend * e[:, :, None, None]).sum(axis=1)
    is_fixed = ((q <= low) & (gradient > 0.0)) | ((q >= high) & (gradient < 0.0))
    gradient = np.where(is_fixed, 0.0, gradient)
    H[is_fixed[:, 0] | is_fixed[:, 1], 0, 1] = H[is_fixed[:, 0] | is_fixed[:, 1], 1, 0] = 0.0
    # Axes of curvature: the first is turned by half the angle of (difference, 2 x mixed) of the second derivatives.
    mean, half_difference = 0.5 * (H[:, 0, 0] + H[:, 1, 1]), 0.5 * (H[:, 0, 0] - H[:, 1, 1])
    turn, radius = (
        0.5 * elementary.arctan2(H[:, 0, 1], half_difference),
        np.hypot(H[:, 0, 1], half_difference),
    )
    c, s = elementary.cos(turn), elementary.sin(turn)
    vectors = np.stack([np.stack([c, -s], axis=1), np.stack([s, c], axis=1)], axis=1)
    # The absolute curvature gives a descent direction even if the curvature is negative.
    values = np.maximum(np.abs(np.stack([mean + radius, mean - radius], axis=1)), 1e-9)
    along = product(gradient[:, None], vectors)[:, 0] / values
    return -product(vectors, along[..., None])[..., 0]
