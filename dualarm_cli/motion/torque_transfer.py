"""Transfer of an arm within joint torques, between given states.

The jerk is constant in equal intervals, so that velocities, accelerations and positions are linear in the jerks.
Torques are linearised about the last solution: a quadratic program of least jerk is solved again until the torques fit
on a dense grid. Durations are tried in rising order. Time-optimal transfers accelerate all joints fully; most joints
are in no hurry, and a transfer in which they are gentle needs less torque.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import cube
from dualarm_cli.geometry.interpolation import interpolated
from dualarm_cli.geometry.linear_systems import solve
from dualarm_cli.geometry.products import product
from dualarm_cli.geometry.programs import plain_piqp
from dualarm_cli.kinematics.dynamics import Dynamics
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class ShapeSettings:
    """Search for transfers within torques."""

    intervals: int = 16
    """Number of intervals of constant jerk."""
    longer: tuple[float, ...] = (1.005, 1.012, 1.025, 1.045, 1.07, 1.1, 1.15, 1.22, 1.3, 1.4)
    """Durations that are tried, as multiples of the present one."""
    rounds: int = 4
    """Maximum number of linearisations for each duration."""
    reserve: float = 5e-3
    """Fraction of efforts that is kept."""
    rate_reserve: float = 2e-3
    """Fraction of velocity limits that is kept, for peaks between knots."""
    position_reserve: float = 2e-3
    """Distance from position limits that is kept at knots, for peaks between them [rad or m]."""
    room: float = 0.05
    """Room about the range of the present motion [rad or m]."""
    near: float = 0.8
    """Fraction of its effort from which on a joint's torques are constrained; all are checked."""
    dense: int = 8
    """Number of instants of each interval at which torques are checked."""


SHAPE = ShapeSettings()
ROUNDING = 1e-12
"""Excess over a position limit by rounding [rad or m]."""


State = tuple[FloatArray, FloatArray, FloatArray]
"""Positions [rad or m], velocities and accelerations of joints, each (n,) or (k, n)."""


@dataclass(frozen=True)
class TransferEnds:
    """States of all joints at both ends of a transfer, and its range."""

    start: State
    """Positions, velocities and accelerations at the start, each (n,)."""
    end: State
    """Those at the end."""
    duration: float
    """Present duration [s]."""
    least: FloatArray
    """Lowest positions of the present motion [rad or m], shape (n,)."""
    most: FloatArray
    """Highest positions of the present motion [rad or m], shape (n,)."""
    beside: Callable[[FloatArray], State] | None = None
    """Motion of all joints at times (k,) from the start [s], or None at rest."""


class _Grid:
    """Linear maps from the jerks of one joint to its motion at instants."""

    def __init__(self, duration: float, instants: FloatArray) -> None:
        """Compute the maps.

        Args:
            duration: of the transfer [s].
            instants: fractions of the duration, shape (g,).
        """
        h = duration / SHAPE.intervals
        self.time = instants * duration
        begun = self.time[:, None] - h * np.arange(SHAPE.intervals)
        # An interval acts for its length at most, then keeps its change of acceleration.
        during, after = np.clip(begun, 0.0, h), np.clip(begun - h, 0.0, None)
        self.a = during
        self.v = during * during / 2.0 + h * after
        self.q = cube(during) / 6.0 + (h * h / 2.0) * after + h * after * after / 2.0

    def motion(self, start: State, jerk: FloatArray) -> State:
        """Compute positions, velocities and accelerations (g, n) from jerks (intervals, n)."""
        q, v, a = start
        t = self.time[:, None]
        return (
            q + t * (v + t * a / 2.0) + product(self.q, jerk),
            v + t * a + product(self.v, jerk),
            a + product(self.a, jerk),
        )


def transfer_within_torques(
    dynamics: Dynamics, columns: list[int], ends: TransferEnds, limits: JointLimits
) -> Trajectory | None:
    """Find the first transfer that keeps limits and torques; None without one.

    Args:
        dynamics: of the robot with its loads.
        columns: of the arm's joints.
        ends: states of all joints at both ends.
        limits: of all joints.

    Returns:
        Motion of the arm's joints from 0 to its duration.
    """
    least, of = None, 1.0
    for factor in SHAPE.longer:
        program = _Program(dynamics, columns, ends, limits, factor * ends.duration)
        if least is None:
            least, of = program.least_jerk(None), factor
            about = least
        else:
            # A linearisation needs no more than the jerks of a shorter transfer, drawn out.
            about = program.least_jerk(least * cube(np.array(of / factor)))
        jerk = None if about is None else program.solved(about)
        if jerk is not None:
            return program.trajectory(jerk, tuple(limits.joints[column] for column in columns))
    return None


class _Program:
    """Quadratic programs of one transfer with a given duration."""

    def __init__(
        self,
        dynamics: Dynamics,
        columns: list[int],
        ends: TransferEnds,
        limits: JointLimits,
        duration: float,
    ) -> None:
        self._dynamics, self._columns, self._ends = dynamics, columns, ends
        self._start = _of_arm(ends.start, columns)
        self._end = _of_arm(ends.end, columns)
        self._limits = limits.select([limits.joints[column] for column in columns])
        count = SHAPE.intervals
        self._knots = _Grid(duration, np.arange(count + 1) / count)
        self._halves = _Grid(duration, np.arange(1, 2 * count) / (2 * count))
        self._dense = _Grid(duration, np.arange(count * SHAPE.dense + 1) / (count * SHAPE.dense))
        self._effort = (1.0 - SHAPE.reserve) * dynamics.limit[columns]

    def solved(self, about: FloatArray) -> FloatArray | None:
        """Solve for jerks (intervals, n) that keep limits and torques, from first ones; None without."""
        jerk: FloatArray | None = about
        for _ in range(SHAPE.rounds):
            if jerk is None:
                return None
            jerk = self._with_exact_end(jerk)
            if self._fits(jerk):
                return jerk
            jerk = self.least_jerk(jerk)
        return None

    def trajectory(self, jerk: FloatArray, joints: tuple[str, ...]) -> Trajectory:
        """Build the motion of jerks, which ends in the state of the present one."""
        q, v, a = self._knots.motion(self._start, jerk)
        q[-1], v[-1], a[-1] = self._end
        return Trajectory(joints, self._knots.time, q, v, a)

    def _whole(self, grid: _Grid, jerk: FloatArray) -> State:
        """Complete the motion of the arm by that of the other joints."""
        arm, start = grid.motion(self._start, jerk), self._ends.start[0]
        if self._ends.beside is None:
            whole = [np.tile(start, (len(arm[0]), 1)), *np.zeros((2, len(arm[0]), len(start)))]
        else:
            whole = list(self._ends.beside(grid.time))
        for rate, values in zip(whole, arm, strict=True):
            rate[:, self._columns] = values
        return whole[0], whole[1], whole[2]

    def _fits(self, jerk: FloatArray) -> bool:
        """Check limits between knots, too, and torques on a dense grid."""
        at_rest, moving, viscous = self._dynamics.torques(*self._whole(self._dense, jerk))
        torque = np.abs(at_rest + moving + viscous)[:, self._columns]
        # Cubics between knots have the extrema of a motion of constant jerk; accelerations have theirs at knots.
        q, v, a = self._knots.motion(self._start, jerk)
        motion, limits = interpolated("cubic", self._knots.time, q, v), self._limits
        (low, high), speed = motion.extrema(), motion.peak(1)
        return bool(
            (torque <= self._effort).all()
            and speed is not None
            and (speed <= limits.velocity).all()
            and (np.abs(a) <= limits.acceleration).all()
            and (np.abs(jerk) <= limits.jerk).all()
            and (low >= limits.lower - ROUNDING).all()
            and (high <= limits.upper + ROUNDING).all()
        )

    def _with_exact_end(self, jerk: FloatArray) -> FloatArray:
        """Correct jerks by the shortest change that reaches the end's state."""
        A = np.vstack([self._knots.q[-1], self._knots.v[-1], self._knots.a[-1]])
        reached = self._knots.motion(self._start, jerk)
        missing = np.vstack([end - rate[-1] for end, rate in zip(self._end, reached, strict=True)])
        return jerk + product(A.T, solve(product(A, A.T), missing))

    def least_jerk(self, about: FloatArray | None) -> FloatArray | None:
        """Solve the program of least jerk with torques linearised about jerks, or without.

        Unknowns are jerks in multiples of their limits, joint by joint.
        """
        n, count, limits, ends = len(self._columns), SHAPE.intervals, self._limits, self._ends
        scale = limits.jerk
        blocks: list[FloatArray] = []
        lower, upper = [], []
        keep = 1.0 - SHAPE.rate_reserve
        q, v, a = self._knots.motion(self._start, np.zeros((count, n)))
        # Between knots a joint may go a little further; ends may be nearer to a limit than that.
        first, last = self._start[0], self._end[0]
        inner_low = np.minimum(limits.lower + SHAPE.position_reserve, np.minimum(first, last))
        inner_high = np.maximum(limits.upper - SHAPE.position_reserve, np.maximum(first, last))
        room_low = np.maximum(ends.least[self._columns] - SHAPE.room, inner_low)
        room_high = np.minimum(ends.most[self._columns] + SHAPE.room, inner_high)
        bounds = (
            (self._knots.q, q, room_low, room_high),
            (self._knots.v, v, -keep * limits.velocity, keep * limits.velocity),
            (self._knots.a, a, -keep * limits.acceleration, keep * limits.acceleration),
        )
        for grid, offset, least, most in bounds:
            for joint in range(n):
                block = np.zeros((count - 1, n * count))
                block[:, joint * count : (joint + 1) * count] = grid[1:-1] * scale[joint]
                blocks.append(block)
                lower.append(least[joint] - offset[1:-1, joint])
                upper.append(most[joint] - offset[1:-1, joint])
        if about is not None:
            rows, low, high = self._torque_rows(about)
            blocks.append(rows * np.repeat(scale, count))
            lower.append(low)
            upper.append(high)
        A = np.zeros((3 * n, n * count))
        b = np.empty(3 * n)
        for k, (grid, rate, offset) in enumerate(
            zip((self._knots.q, self._knots.v, self._knots.a), self._end, (q, v, a), strict=True)
        ):
            for joint in range(n):
                A[k * n + joint, joint * count : (joint + 1) * count] = grid[-1] * scale[joint]
                b[k * n + joint] = rate[joint] - offset[-1, joint]
        # Rows of length 1 make the program independent of units.
        size = np.sqrt(np.sum(A * A, axis=1))
        x = _solved(
            A / size[:, None],
            b / size,
            np.vstack(blocks),
            np.concatenate(lower),
            np.concatenate(upper),
        )
        return None if x is None else x.reshape(n, count).T * scale

    def _torque_rows(self, about: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Linearise the torques at knots and middles: rows, lower and upper bounds."""
        grid, columns, n, count = self._halves, self._columns, len(self._columns), SHAPE.intervals
        q, v, a = self._whole(grid, about)
        rows = np.zeros((len(q), n, n, count))
        torque = np.empty((len(q), n))
        for k in range(len(q)):
            value, by_q, by_v, by_a = self._dynamics.linearised(q[k], v[k], a[k])
            torque[k] = value[columns]
            for part, derivative in ((grid.q, by_q), (grid.v, by_v), (grid.a, by_a)):
                rows[k] += derivative[np.ix_(columns, columns)][:, :, None] * part[k]
        # A joint that is far from its effort is left out: the program's time is that of its rows.
        near = (np.abs(torque) > SHAPE.near * self._effort).any(axis=0)
        matrix = rows[:, near].reshape(-1, n * count)
        present = product(matrix, about.T.reshape(-1))
        effort = np.tile(self._effort[near], len(q)) * (1.0 - SHAPE.reserve)
        offset = torque[:, near].reshape(-1) - present
        return matrix, -effort - offset, effort - offset


def _of_arm(state: State, columns: list[int]) -> State:
    """Select the state of an arm's joints."""
    position, velocity, acceleration = state
    return position[columns], velocity[columns], acceleration[columns]


def _solved(
    A: FloatArray, b: FloatArray, G: FloatArray, low: FloatArray, high: FloatArray
) -> FloatArray | None:
    """Solve for x of least norm: A x = b, low <= G x <= high."""
    if (low > high).any():
        return None
    size = np.maximum(np.sqrt(np.sum(G * G, axis=1)), 1e-12)
    piqp = plain_piqp()
    solver: Any = piqp.DenseSolver()
    unit = np.ones(A.shape[1])
    solver.settings.eps_abs, solver.settings.eps_rel, solver.settings.max_iter = 1e-8, 1e-9, 60
    solver.setup(
        np.eye(len(unit)), 0.0 * unit, A, b, G / size[:, None], low / size, high / size, -unit, unit
    )
    if solver.solve() != piqp.PIQP_SOLVED:
        return None
    return np.array(solver.result.x)
