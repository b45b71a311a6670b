"""Transfers in closed form: double S or trapezoid, all joints in the same time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray, readonly
from dualarm_cli.model.joint_motion import SAME_TIME, distinct_times
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.timing.composition import hold
from dualarm_cli.timing.problem import TransferProblem
from dualarm_cli.timing.rest_to_rest import RestToRest

PHASES = 7
"""Phases of a double S; those that a motion does not need have no length."""


@dataclass(frozen=True)
class Phases:
    """Stretches of constant jerk of n joints, one after the other."""

    duration: FloatArray
    """Lengths [s], shape (n, 7); all zero for a joint that stands."""
    acceleration: FloatArray
    """Accelerations at their starts [rad/s²], shape (n, 7)."""
    jerk: FloatArray
    """Jerks throughout [rad/s³], shape (n, 7)."""

    def __post_init__(self) -> None:
        """Freezes the arrays."""
        for name in ("duration", "acceleration", "jerk"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    def slowed(self, duration: float) -> Phases:
        """Returns the same motions, each slowed to take the duration [s].

        Slowing by k divides velocity by k, acceleration by k² and jerk by k³.
        """
        total = self.duration.sum(axis=1, keepdims=True)
        k = np.where(total > 0.0, duration / np.where(total > 0.0, total, 1.0), 1.0)
        return Phases(self.duration * k, self.acceleration / k**2, self.jerk / k**3)


def transfer_trajectory(problem: TransferProblem, phases: Phases, duration: float) -> Trajectory:
    """Returns the transfer that its joints' phases make.

    The last knot is exactly the goal: what rounding left over is below 1e-12 of the way. Knots nearer than
    SAME_TIME become one. Only accelerations of joints without a jerk limit jump, at two knots at one time.

    Args:
        problem: the transfer.
        phases: of all its joints.
        duration: when every motion ends [s].
    """
    edges, states = _states(problem, phases, duration)
    time = distinct_times(np.append(edges.ravel(), [0.0, duration]))[0]
    right = _evaluate(edges, states, time, SAME_TIME)
    before = _evaluate(edges, states, time, -SAME_TIME)
    # Before its first knot every joint is as the problem says.
    before[0, 0] = problem.start
    before[1:, 0] = problem.rates()[0]
    jumps: BoolArray = np.isinf(problem.limits.jerk) & (before[2] != right[2])
    left = np.where(jumps, before, right)
    index = np.repeat(np.arange(len(time)), 1 + jumps.any(axis=1))
    first_of_two = np.zeros((len(index), 1), dtype=np.bool_)
    first_of_two[:-1, 0] = index[:-1] == index[1:]
    return Trajectory(
        problem.joints,
        time[index],
        *np.where(first_of_two, left[:, index], right[:, index]),
    )


def _states(
    problem: TransferProblem, phases: Phases, duration: float
) -> tuple[FloatArray, FloatArray]:
    """Returns starts of all phases, (n, 8), with q, v, a, j there, (4, n, 8); the eighth is the goal."""
    n = len(problem.joints)
    edges, states = np.zeros((n, PHASES + 1)), np.zeros((4, n, PHASES + 1))
    np.cumsum(phases.duration, axis=1, out=edges[:, 1:])
    moving = edges[:, -1] > 0.0
    # Every motion ends at one instant exactly; phases of no length end there with it.
    ends = (edges >= edges[:, -1:]) & moving[:, None]
    edges[ends] = duration
    q, v, a, j = states
    a[:, :-1], j[:, :-1] = phases.acceleration, phases.jerk
    q[:, 0] = problem.start
    leaving, arriving = problem.rates()
    v[:, 0] = leaving[0]
    for k in range(PHASES):
        d = phases.duration[:, k]
        q[:, k + 1] = q[:, k] + d * (v[:, k] + d * (a[:, k] / 2.0 + d * j[:, k] / 6.0))
        v[:, k + 1] = v[:, k] + d * (a[:, k] + d * j[:, k] / 2.0)
    q[:, -1], v[:, -1], a[:, -1] = problem.goal, *arriving
    return edges, states


def _evaluate(edges: FloatArray, states: FloatArray, time: FloatArray, shift: float) -> FloatArray:
    """Returns q, v, a at times, (3, k, n), in the phases of the times moved by `shift` [s]."""
    begun = (edges <= (time + shift)[:, None, None]).sum(axis=2)
    phase: IntArray = np.maximum(begun - 1, 0)
    joint = np.arange(len(edges))
    dt = time[:, None] - edges[joint, phase]
    q, v, a, j = states[:, joint, phase]
    # A knot that stands in for the beginning of a phase a moment later has that phase's velocity and acceleration: led
    # back along the phase, they could exceed their limits.
    ahead = np.maximum(dt, 0.0)
    return np.stack(
        [
            q + dt * (v + dt * (a / 2.0 + dt * j / 6.0)),
            v + ahead * (a + ahead * j / 2.0),
            a + ahead * j,
        ]
    )


def solve_transfer(problem: TransferProblem) -> Trajectory:
    """Returns the transfer: every joint's fastest motion, slowed until all take the same time.

    That time is the least time of the slowest joint, or the minimum duration. Slowing by k divides velocity by k,
    acceleration by k² and jerk by k³, so that joints in no hurry move gently, and no phase is ever
    shorter than in the joint's fastest motion.
    """
    distance, limits = problem.goal - problem.start, problem.limits
    law = RestToRest(limits.velocity, limits.acceleration, limits.jerk)
    duration = max(float(law.duration(distance)), problem.minimum_duration)
    if not distance.any():
        return hold(problem.joints, problem.start, duration)
    return transfer_trajectory(problem, fastest_phases(distance, law).slowed(duration), duration)


def fastest_phases(distance: FloatArray, law: RestToRest) -> Phases:
    """Returns the phases of each joint's fastest motion from rest to rest.

    The cases are those of `RestToRest`, which gives the duration; see there for the source.

    Args:
        distance: displacements [rad], shape (n,); their signs are the directions.
        law: the limits of the n joints.
    """
    d, sign = np.abs(distance), np.sign(distance)
    v, a, j = law.velocity, law.acceleration, law.jerk
    reaches_a, full = v * j >= a * a, a / j
    # Jerk phases, and phases of constant acceleration, of a ramp to the speed limit.
    ramp = np.where(reaches_a, full, np.sqrt(v / j))
    constant = np.where(reaches_a, v / a - full, 0.0)
    cruise = d / v - 2.0 * ramp - constant
    slower = cruise < 0.0
    medium = slower & reaches_a & (d > 2.0 * a * full * full)
    short = slower & ~medium
    # Peak speed w from w²/a + w a/j = d, and w/a - a/j of constant acceleration.
    half = 0.5 * a * full
    constant[medium] = ((np.sqrt(half * half + a * d) - half) / a - full)[medium]
    ramp[short], constant[short] = np.cbrt(d / (2.0 * j))[short], 0.0
    constant, cruise = np.maximum(constant, 0.0), np.maximum(cruise, 0.0)
    limited = np.isfinite(j)
    top = sign * np.where(limited, np.where(limited, j, 0.0) * ramp, a)
    rise, none = sign * np.where(limited, j, 0.0), np.zeros_like(d)
    return Phases(
        np.column_stack([ramp, constant, ramp, cruise, ramp, constant, ramp]),
        np.column_stack([none, top, top, none, none, -top, -top]),
        np.column_stack([rise, none, -rise, none, -rise, none, rise]),
    )
