"""Closed-form inverse kinematics of six-axis arms with parallel axes 2, 3 and 4.

Arms of Universal Robots are of this family.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray, readonly
from dualarm_cli.geometry.elementary import (
    angle_between,
    angle_of,
    arccos,
    arctan2,
    complex_product,
    cos,
    modulus,
    sin,
    unit_complex,
)
from dualarm_cli.geometry.joint_axes import SRS_TOLERANCE
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.geometry.roots import (
    derivative,
    first_order_square,
    polynomial_value,
    real_zeros,
)
from dualarm_cli.kinematics.closed_arm import CLOSED, ClosedArm, PoseSolutions
from dualarm_cli.kinematics.platform_chain import rotation_z
from dualarm_cli.kinematics.srs.srs_limits import wrap
from dualarm_cli.kinematics.wrist_arm import Turns, three_turns
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class ParallelArmTolerances:
    """Tolerances of arms with parallel axes."""

    least_angle: float = 1e-6
    """Least sine of the angle of axes 1 and 2, 4 and 5, 5 and 6."""
    least_link: float = 1e-6
    """Shortest distance of axes 2 and 3, 3 and 4 [m]."""
    meeting: float = 1e-6
    """Distance of axes 5 and 6 below which they meet [m]."""
    least_normal: float = 1e-3
    """Least distance of axes 5 and 6 that do not meet [m].

    Below it the polynomial for joint 1 loses digits.
    """
    reach_slack: float = 1e-11
    """Rounding tolerance of the reachability test [m]."""
    tiny: float = 1e-12
    """Distance from an axis below which a point has no angle about it [m]."""


PARALLEL = ParallelArmTolerances()


ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class _FirstTurns:
    """Four values of joint 1 per pose, b poses, with joint 5 solutions."""

    q1: FloatArray
    """Joint 1 [rad], finite everywhere, shape (b, 4)."""
    solution: IntArray
    """Number of the solution of `three_turns`, shape (b, 4)."""
    reachable: BoolArray
    """Flags of values that exist, shape (b, 4)."""
    free: BoolArray
    """Flags of a free joint 1 at its reference, shape (b, 4)."""


@dataclass(frozen=True)
class ParallelArm(ClosedArm):
    """Six-axis arm whose axes 2, 3 and 4 are parallel.

    The direction n of these axes turns with joint 1 alone, seen from the base, and with joints 5 and 6 alone, seen from
    the tool; and joints 2, 3, 4 do not move anything along it. So with a point P of axis 6 and that axis' direction w,
    both given by the pose, n·w and n·P are linear in cos and sin of joint 1 on one side and of joint 5 on the other.
    Where axes 5 and 6 meet, P is that point and n·P does not depend on joint 5: joint 1 has two values and joint 5 two
    for each, as in [Hawkins2013]. Elsewhere P is the foot of the axes' common normal; then n·w gives the cosine of
    joint 5 and n·P its sine, and the sum of their squares is a polynomial of second order in joint 1. The rest is three
    turns about n and axes 5 and 6, and two links in a plane. Axes 1, 5 and 6 may otherwise lie anyhow. Our own
    derivation.

    Branch = 2 * slot + elbow. Elbow is 1 where the second link is turned clockwise about axis 2 against the first one.
    Where axes 5 and 6 meet, slot is 2 * (joint 1 beyond its middle) + (joint 5 on the negative side of where axes 4 and
    6 are nearest to each other); otherwise joint 1 decides, as joint 3 does in `point_postures`.

    A joint is free, and takes its reference, where P is on axis 1 (joint 1) and, with equal links, where axes 2 and 4
    coincide (joint 2). Where axes 4 and 6 are aligned the sum of joints 2 to 4, with signs, is that of the reference,
    or the nearest one at which the links reach.
    """

    def _problem(self) -> str:
        """Explain why the axes have no closed forms of this family, or return ''."""
        if self.parallel_deviation > SRS_TOLERANCE:
            return (
                f"its axes 2, 3 and 4 are not parallel by {self.parallel_deviation:.3g} rad "
                f"({SRS_TOLERANCE:g} rad are allowed)"
            )
        for k in (1, 4, 5):
            if np.hypot(*self.R_parent_joint[k][:2, 2]) < PARALLEL.least_angle:
                return f"axes {k} and {k + 1} are parallel"
        if min(np.abs(self._links)) < PARALLEL.least_link:
            return "two of its axes 2, 3 and 4 are the same"
        if PARALLEL.meeting < self._normal_length < PARALLEL.least_normal:
            return (
                f"its axes 5 and 6 nearly meet ({self._normal_length * 1000:.3g} mm; "
                f"{PARALLEL.least_normal * 1000:g} mm or more, or none, are needed)"
            )
        return ""

    @cached_property
    def signs(self) -> tuple[float, float]:
        """Signs of axes 3 and 4 along axis 2."""
        third = 1.0 if self.R_parent_joint[2][2, 2] > 0.0 else -1.0
        return third, third * (1.0 if self.R_parent_joint[3][2, 2] > 0.0 else -1.0)

    @cached_property
    def _feet(self) -> tuple[float, FloatArray]:
        """Common normal of axes 5 and 6: offset and foot [m].

        The offset is along axis 6, the foot in frame 5.
        """
        across, p = self.R_parent_joint[5][:, 2], self.p_parent_joint[5]
        shift = -float(product(p[:2], across[:2])) / float(product(across[:2], across[:2]))
        # After a shift along axis 6 the remainder across axis 5 is the normal.
        foot = p + shift * across
        return shift, readonly(foot)

    @cached_property
    def _normal(self) -> FloatArray:
        """Common normal from axis 5 to axis 6 in frame 5 [m], shape (3,)."""
        foot = self._feet[1]
        return readonly(np.array([foot[0], foot[1], 0.0]))

    @property
    def _normal_length(self) -> float:
        return float(norm(self._normal))

    @cached_property
    def _chain_of_links(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Steps between axes 2, 3, 4 and axis 5's foot, in frame 2 [m].

        Three vectors (3,). All joints are at zero.
        """
        R23, R34, R45 = self.R_parent_joint[2:5]
        foot = self.p_parent_joint[4] + R45[:, 2] * self._feet[1][2]
        return self.p_parent_joint[2], product(R23, self.p_parent_joint[3]), product(R23, R34, foot)

    @cached_property
    def _links(self) -> tuple[complex, complex, complex]:
        """Steps between the axes across axis 2, as complex numbers [m]."""
        a, b, c = (complex(step[0], step[1]) for step in self._chain_of_links)
        return a, b, c

    @cached_property
    def _height(self) -> float:
        """Sum of the steps between the axes along axis 2 [m]."""
        return float(sum(step[2] for step in self._chain_of_links))

    @cached_property
    def _R25(self) -> FloatArray:
        """Frame 5 in frame 2, all joints at zero, shape (3, 3)."""
        return readonly(
            product(self.R_parent_joint[2], self.R_parent_joint[3], self.R_parent_joint[4])
        )

    @cached_property
    def _tool(self) -> tuple[FloatArray, FloatArray]:
        """Axis 6 in the flange frame: foot [m] and direction, each (3,)."""
        R = self.R_last_flange.T
        foot = product(R, np.array([0.0, 0.0, self._feet[0]]) - self.p_last_flange)
        return readonly(foot), readonly(R[:, 2])

    @cached_property
    def exact(self) -> bool:
        """Flag of closed forms that need no polish."""
        return max(self.parallel_deviation, self._normal_length) < CLOSED.exact

    def _postures(self, R: FloatArray, p: FloatArray, reference: FloatArray) -> PoseSolutions:
        """Compute all branches before polishing; out of reach, those that come near."""
        foot, axis = self._tool
        place = product(p + product(R, foot) - self.p_parent_joint[0], self.R_parent_joint[0])
        first = self._first_turns(place, product(R, axis, self.R_parent_joint[0]), reference[:, :1])
        R12, p12 = self.R_parent_joint[1], self.p_parent_joint[1]
        back = product(R12.T, rotation_z(-first.q1))
        third, fourth = self.signs
        total = reference[:, 1:2] + third * reference[:, 2:3] + fourth * reference[:, 3:4]
        M = product(back, product(self.R_parent_joint[0].T, R, self.R_last_flange.T)[:, None])
        u = product(back, place[:, None, :, None])[..., 0] - product(R12.T, p12)
        w = u[..., 0] + 1j * u[..., 1]
        turns, last = self._last_turns(M, np.broadcast_to(total, w.shape), first.solution)
        if turns.aligned.any():
            total = self._reachable_sums(total, w, last)
            turns, last = self._last_turns(M, total, first.solution)
        theta, q5, q6 = last
        # Required place of axis 4, in frame 2 across axis 2.
        v = w - complex_product(unit_complex(theta), self._last_link(q5))
        l2, l3, _ = self._links
        bend, reachable = _bends(v, l2, l3)
        q3 = bend + angle_of(l2) - angle_of(l3)
        arm = l2 + complex_product(unit_complex(q3), l3)
        free2 = (modulus(v) < PARALLEL.tiny)[..., None]
        q2 = np.where(free2, reference[:, 1, None, None], angle_between(v[..., None], arm))
        q4 = theta[..., None] - q2 - q3
        single = (np.broadcast_to(x[..., None], q2.shape) for x in (first.q1, q5, q6))
        q1, q5, q6 = single
        q = wrap(np.stack([q1, q2, third * q3, fourth * q4, q5, q6], axis=-1))
        reachable &= (first.reachable & turns.possible)[..., None]
        singular = (first.free | turns.aligned)[..., None] | free2
        shape = (-1, CLOSED.branches)
        return PoseSolutions(
            q.reshape(-1, CLOSED.branches, 6),
            reachable.reshape(shape),
            np.broadcast_to(singular, q2.shape).reshape(shape),
        )

    def _last_turns(
        self, M: FloatArray, total: FloatArray, solution: IntArray
    ) -> tuple[Turns, FloatArray]:
        """Solve for angles about n, axis 5 and axis 6.

        Selects solutions (3, b, 4).
        """
        turns = three_turns(self._R25, self.R_parent_joint[5], M, total)
        last = np.take_along_axis(turns.q, solution[..., None, None], axis=2)[:, :, 0]
        return turns, np.moveaxis(last, -1, 0)

    def _last_link(self, q5: FloatArray) -> ComplexArray:
        """Compute steps across axis 2 from axis 4 to axis 6's foot [m].

        Joints 2 to 4 are at zero.
        """
        normal = product(rotation_z(q5), self._normal, self._R25.T)
        step: ComplexArray = self._links[2] + normal[..., 0] + 1j * normal[..., 1]
        return step

    def _reachable_sums(self, total: FloatArray, w: ComplexArray, last: FloatArray) -> FloatArray:
        """Adapt sums of joints 2 to 4 [rad], (b, 4), to the links' reach.

        The two links reach then.

        Args:
            total: given sums [rad], broadcast against (b, 4).
            w: the foot on axis 6 in frame 2, across axis 2 [m], shape (b, 4).
            last: turns about n and axes 5 and 6 [rad], shape (3, b, 4).
        """
        l2, l3, _ = self._links
        link = self._last_link(last[1])
        size = np.maximum(2.0 * modulus(w) * modulus(link), np.square(PARALLEL.tiny))
        # The squared distance that the links span falls with the cosine of the angle between.
        both = np.square(modulus(w)) + np.square(modulus(link))
        ends = (np.square(abs(l2) - abs(l3)), np.square(abs(l2) + abs(l3)))
        least, most = (arccos(np.clip((both - end) / size, -1.0, 1.0)) for end in ends)
        middle = angle_of(w) - angle_of(link)
        between = wrap(total - middle)
        sums: FloatArray = middle + np.copysign(np.clip(np.abs(between), least, most), between)
        return sums

    def _first_turns(
        self, place: FloatArray, axis: FloatArray, reference: FloatArray
    ) -> _FirstTurns:
        """Solve for joint 1.

        Args:
            place: the foot on axis 6 in frame 1 [m], shape (b, 3).
            axis: direction of axis 6 in frame 1, shape (b, 3).
            reference: value of a free joint 1 [rad], shape (b, 1).
        """
        n = self.R_parent_joint[1][:, 2]
        across = complex(n[0], n[1])
        w = place[:, 0] + 1j * place[:, 1]
        # n·P without the parts of axis 2's origin and of the links: n_z P_z + |n||w| cos(arg w - arg n - q1) - height.
        offset = float(product(n, self.p_parent_joint[1])) + self._height - n[2] * place[:, 2]
        if self._normal_length > PARALLEL.meeting:
            return self._first_turns_apart(w, offset, axis)
        size = modulus(w) * abs(across)
        over, under = size + offset, size - offset
        half = 2.0 * arctan2(np.sqrt(np.maximum(under, 0.0)), np.sqrt(np.maximum(over, 0.0)))
        side = np.array([1.0, 1.0, -1.0, -1.0])
        free = np.broadcast_to((modulus(w) < PARALLEL.tiny)[:, None], (len(w), 4))
        q1 = np.where(
            free, reference, (angle_of(w) - angle_of(across))[:, None] + half[:, None] * side
        )
        reachable = (np.minimum(over, under) >= -PARALLEL.reach_slack)[:, None]
        solution = np.broadcast_to(np.array([0, 1, 0, 1]), free.shape)
        return _FirstTurns(q1, solution, np.broadcast_to(reachable, free.shape), free)

    def _first_turns_apart(
        self, w: ComplexArray, offset: FloatArray, axis: FloatArray
    ) -> _FirstTurns:
        """Solve for joint 1 if axes 5 and 6 do not meet.

        The squares of cosine and sine of joint 5 add up to 1.
        """
        n, R25, R56 = self.R_parent_joint[1][:, 2], self._R25, self.R_parent_joint[5]
        # n·w over joint 5 is level + wide cos(phi), n·normal is deep sin(phi), phi from where axes 4 and 6 are nearest.
        level = R25[2, 2] * R56[2, 2]
        rho, tip = complex(R25[2, 0], R25[2, 1]), complex(R56[0, 2], R56[1, 2])
        wide = abs(rho) * abs(tip)
        normal = complex(self._normal[0], self._normal[1])
        deep = -abs(rho) * (normal * tip.conjugate()).imag / abs(tip)
        spin = axis[:, 0] + 1j * axis[:, 1]

        def linear(constant: FloatArray, z: ComplexArray, scale: float) -> FloatArray:
            # Re(conj(n) e^{-i q1} z) over (1, cos, sin) of joint 1.
            turning = complex_product(z, complex(n[0], -n[1]))
            return np.stack([constant, turning.real, turning.imag], axis=1) / scale

        cosine = linear(n[2] * axis[:, 2] - level, spin, wide)
        sine = linear(-offset, w, deep)
        polynomial = first_order_square(cosine) + first_order_square(sine)
        polynomial[:, 0] -= 1.0
        zeros = real_zeros(polynomial)
        rises = polynomial_value(derivative(polynomial), zeros.angle) >= 0.0
        q1, exists = np.zeros((len(w), 4)), np.zeros((len(w), 4), dtype=np.bool_)
        for selected, first, step in ((rises & zeros.exists, 0, 1), (~rises & zeros.exists, 3, -1)):
            row, column = np.nonzero(selected)
            slot = first + step * (np.cumsum(selected, axis=1)[row, column] - 1)
            q1[row, slot], exists[row, slot] = zeros.angle[row, column], True
        c, s = cos(q1), sin(q1)
        clockwise = sine[:, :1] + sine[:, 1:2] * c + sine[:, 2:] * s < 0.0
        return _FirstTurns(q1, clockwise.astype(np.int64), exists, np.zeros_like(exists))

    def _miss(self, R: FloatArray, p: FloatArray) -> FloatArray:
        """Compute the miss of poses by the nearest branches within limits, shape (b, 2)."""
        solutions = self._postures(R, p, np.broadcast_to(self.middle, (len(p), 6)))
        q = self.nearest_turns(solutions.q, self.middle)
        return self._clipped_miss(q, np.ones_like(solutions.reachable), R, p)


def _bends(v: ComplexArray, l2: complex, l3: complex) -> tuple[FloatArray, BoolArray]:
    """Solve for the angles between two links that reach points (...), with flags.

    Both have shape (..., 2); both factors vanish exactly if the arm is stretched or folded.
    """
    d, a, b = modulus(v), abs(l2), abs(l3)
    out, in_ = a + b - d, d - abs(a - b)
    half = arctan2(
        np.sqrt(np.maximum(out * (a + b + d), 0.0)),
        np.sqrt(np.maximum(in_ * (d + abs(a - b)), 0.0)),
    )
    reachable = (out >= -PARALLEL.reach_slack) & (in_ >= -PARALLEL.reach_slack)
    return np.stack([2.0 * half, -2.0 * half], axis=-1), np.stack([reachable] * 2, axis=-1)
