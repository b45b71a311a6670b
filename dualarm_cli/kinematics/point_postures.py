"""The four postures of three joints that carry a point to a place: in closed form, for many places at once.

Frame 1 turns about axis 1, so that a place tells only its distance r from the axis and its height z. With the point at
f(q3) in frame 2 before joint 2 turns and v = e^(i q2) (f_x + i f_y) across axis 2 after it, two equations hold: one for
the height, one for the squared distance from the foot of the common normal. Both are linear in v and of first order in
q3, which is what [Pieper1968] builds on; the families differ by what follows first. Written in complex numbers and with
square roots of products instead of differences: our own derivation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.geometry.real_zeros import derivative, polynomial_value, real_zeros
from dualarm_cli.kinematics.srs_limits import wrap
from dualarm_cli.kinematics.three_axes import MEETING, PARALLEL, ThreeAxes

ComplexArray = NDArray[np.complex128]

REACH_SLACK = 1e-11
"""How far a point may be out of reach by rounding [m]."""
TINY = 1e-12
"""A point nearer to an axis than this does not tell the angle about it [m]."""


@dataclass(frozen=True)
class PointPostures:
    """The four postures of three joints for each of b places."""

    q: FloatArray
    """Joints in (-pi, pi] [rad], finite everywhere, shape (b, 4, 3)."""
    reachable: BoolArray
    """Which of them carry the point to its place, shape (b, 4)."""
    singular: BoolArray
    """Where joint 1 or 2 is free and took its reference, shape (b, 4)."""


Turns = tuple[ComplexArray, FloatArray, BoolArray]
"""The point across axis 2 (b, 4), joint 3 (b, 4), and which exist (b, 4)."""


def point_postures(axes: ThreeAxes, p: FloatArray, reference: FloatArray) -> PointPostures:
    """Returns the postures that carry the point to places.

    Slots of the family elbow: 2 * shoulder + elbow. Shoulder is 0 where the point is on the side of axis 1 to which the
    common normal of axes 1 and 2 points (where they meet: to which axis 2 x axis 1 does), elbow is 1 where the
    second link is turned clockwise about axis 2 against the first one. Of two_steps: 2 * (joint 3 beyond its middle) +
    (point clockwise of the given direction). Of quartic: 0 and 1 where its polynomial rises, 3 and 2 where it falls,
    by ascending joint 3; the sign is that of the Jacobian's determinant and so is kept between singularities; the
    order is not where such an arm is cuspidal, or joint 3 passes half a turn.

    Args:
        axes: with a family.
        p: places in the frame that carries the arm [m], shape (b, 3).
        reference: joints 1 to 3 where they are free [rad], shape (b, 3).
    """
    place = (p - axes.p1) @ axes.R1
    w, z = place[:, 0] + 1j * place[:, 1], place[:, 2]
    solve = {"elbow": _elbow, "two_steps": _two_steps, "quartic": _quartic}[axes.family or "elbow"]
    v, q3, reachable = solve(axes, np.abs(w), z)
    f = _over(axes.circle, q3)
    free2, free1 = np.abs(v) < TINY, (np.abs(w) < TINY)[:, None]
    q2 = np.where(free2, reference[:, 1:2], np.angle(v * np.conj(f[0] + 1j * f[1])))
    h = axes.R12[:2, :1, None] * v.real + axes.R12[:2, 1:2, None] * v.imag
    h = h + axes.R12[:2, 2:, None] * f[2] + axes.p12[:2, None, None]
    q1 = np.where(free1, reference[:, :1], np.angle(w[:, None] * np.conj(h[0] + 1j * h[1])))
    q = wrap(np.stack([q1, q2, q3], axis=-1))
    return PointPostures(
        np.where(reachable[..., None], q, 0.0), reachable, (free1 | free2) & reachable
    )


def _elbow(axes: ThreeAxes, r: FloatArray, z: FloatArray) -> Turns:
    """Returns postures of axes 2 and 3 parallel: a circle meets a plane twice, and two links reach each point twice."""
    P, omega = complex(*axes.p23[:2]), complex(*axes.point[:2])
    sign = 1.0 if axes.R23[2, 2] > 0.0 else -1.0
    height = float(axes.p23[2] + sign * axes.point[2])
    E = axes.axis1 / abs(axes.axis1)
    # Across axes 1 and 2: in frame 2, and in frame 1.
    n = 1j * E
    N = complex(*(axes.R12[:2, 0] * n.real + axes.R12[:2, 1] * n.imag))
    if (complex(*axes.p12[:2]) * N.conjugate()).real < -MEETING:
        n, N = -n, -N
    # The plane of the links cuts height z of frame 1 in the line foot + t n.
    foot = (z - axes.R12[2, 2] * height) / abs(axes.axis1)
    along = axes.R12[:2, :2] @ np.array([E.real, E.imag])
    h = foot * complex(*along) + complex(*(axes.R12[:2, 2] * height + axes.p12[:2]))
    local = h * N.conjugate()
    aside = np.abs(local.imag)
    t = np.sqrt(np.maximum((r - aside) * (r + aside), 0.0))
    v = foot[:, None] * E + n * (np.stack([t, -t], axis=1) - local.real[:, None])
    d, L2, L3 = np.abs(v), abs(P), abs(omega)
    # Half the angle between the links: both factors vanish exactly where the arm is stretched or folded.
    out, in_ = L2 + L3 - d, d - abs(L2 - L3)
    half = np.arctan2(np.sqrt(np.maximum(out * (L2 + L3 + d), 0.0)), _inner(in_, d, L2, L3))
    ok = ((r - aside) >= -REACH_SLACK)[:, None] & (out >= -REACH_SLACK) & (in_ >= -REACH_SLACK)
    zero = np.arctan2(axes.R23[1, 0], axes.R23[0, 0]) - np.angle(P)
    bend = np.stack([2.0 * half, -2.0 * half], axis=-1)
    # The second link's direction against the first one's is zero + sign (q3 + angle(omega)).
    q3 = sign * (bend - zero) - np.angle(omega)
    return np.repeat(v, 2, axis=1), q3.reshape(-1, 4), np.repeat(ok, 2, axis=1)


def _inner(in_: FloatArray, d: FloatArray, L2: float, L3: float) -> FloatArray:
    return np.sqrt(np.maximum(in_ * (d + abs(L2 - L3)), 0.0))


def _two_steps(axes: ThreeAxes, r: FloatArray, z: FloatArray) -> Turns:
    """Returns postures of axes 1 and 2 that meet or are parallel: joint 3 first, then a line meets a circle."""
    meets = abs(axes.axis1) > PARALLEL
    if meets:
        # |f(q3)| is the distance from where axes 1 and 2 meet.
        g, size = axes.squared, np.sqrt(r * r + z * z)
        constant = g[0] - size * size
    else:
        # Axis 2 is parallel to axis 1: f_z(q3) is the height.
        g, size = axes.circle[:, 2], np.ones_like(z)
        constant = g[0] - axes.R12[2, 2] * z
    amplitude = np.hypot(g[1], g[2])
    half = np.arccos(np.clip(-constant / amplitude, -1.0, 1.0))
    q3 = np.arctan2(g[2], g[1]) + np.stack([half, half, -half, -half], axis=1)
    ok = np.abs(constant) - amplitude <= REACH_SLACK * np.maximum(size, REACH_SLACK)
    f = _over(axes.circle, q3)
    length = np.hypot(f[0], f[1])
    if meets:
        line, direction = z[:, None] - axes.R12[2, 2] * f[2], axes.axis1
    else:
        line, direction = (
            0.5 * (r[:, None] ** 2 - abs(axes.normal) ** 2 - length**2),
            axes.normal,
        )
    line = line / abs(direction)
    rest = (length - np.abs(line)) * (length + np.abs(line))
    side = np.sqrt(np.maximum(rest, 0.0)) * [1.0, -1.0, 1.0, -1.0]
    ok = ok[:, None] & (length - np.abs(line) >= -REACH_SLACK)
    v = direction / abs(direction) * (np.clip(line, -length, length) + 1j * side)
    return v, q3, ok


def _quartic(axes: ThreeAxes, r: FloatArray, z: FloatArray) -> Turns:
    """Returns postures of any three axes: |v|² = |f_xy|², of second order in joint 3."""
    u, e = axes.normal, axes.axis1
    f, b = axes.circle.T, len(r)
    # Both right sides over (1, cos, sin) of joint 3.
    first = np.broadcast_to(-0.5 * axes.squared, (b, 3)).copy()
    first[:, 0] += 0.5 * (r * r + z * z - abs(u) ** 2)
    second = np.broadcast_to(-axes.R12[2, 2] * f[2], (b, 3)).copy()
    second[:, 0] += z
    # The normal is across axis 1: v is known by its parts along either.
    along, across = first / abs(u), second / abs(e)
    polynomial = _square(along) + _square(across)
    polynomial -= _square(f[:1]) + _square(f[1:2])
    zeros = real_zeros(polynomial)
    rises = polynomial_value(derivative(polynomial), zeros.angle) >= 0.0
    q3, ok = np.zeros((b, 4)), np.zeros((b, 4), dtype=np.bool_)
    for some, first_slot, way in ((rises & zeros.exists, 0, 1), (~rises & zeros.exists, 3, -1)):
        row, column = np.nonzero(some)
        slot = first_slot + way * (np.cumsum(some, axis=1)[row, column] - 1)
        q3[row, slot], ok[row, slot] = zeros.angle[row, column], True
    x = _first_order(along, q3)
    y = _first_order(across, q3)
    return x * (u / abs(u)) + y * (e / abs(e)), q3, ok


def _over(rows: FloatArray, q3: FloatArray) -> FloatArray:
    """Returns coordinates that are (1, cos, sin) q3 times rows (3, k), shape (k, ...)."""
    c, s = np.cos(q3), np.sin(q3)
    return np.stack([k + a * c + b * s for k, a, b in rows.T])


def _first_order(rows: FloatArray, q3: FloatArray) -> FloatArray:
    """Returns first-order polynomials (b, 3) at angles (b, 4)."""
    found: FloatArray = rows[:, :1] + rows[:, 1:2] * np.cos(q3) + rows[:, 2:] * np.sin(q3)
    return found


def _square(rows: FloatArray) -> FloatArray:
    """Returns the squares of first-order polynomials (b, 3): of second order, shape (b, 5)."""
    k, a, b = rows.T
    return np.stack(
        [k * k + 0.5 * (a * a + b * b), 2 * k * a, 2 * k * b, 0.5 * (a * a - b * b), a * b], axis=1
    )
