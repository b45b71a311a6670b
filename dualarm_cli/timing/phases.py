"""From the phases of single joints to the knots of a trajectory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray, readonly
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.timing.composition import SAME_TIME, distinct_times
from dualarm_cli.timing.problem import TransferProblem

PHASES = 7
"""Phases of a double S; those that a motion does not need have no length."""


@dataclass(frozen=True)
class Phases:
    """Stretches of constant jerk of n joints, one after the other, from rest to rest."""

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

    The last knot is exactly the goal, at rest: what rounding left over is below 1e-12 of the way. Knots nearer than
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
    # Before its first knot every joint stands.
    before[:, 0] = 0.0
    before[0, 0] = problem.start
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
    """Returns starts of all phases, (n, 8), with q, v, a, j there, (4, n, 8); the eighth is rest."""
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
    for k in range(PHASES):
        d = phases.duration[:, k]
        q[:, k + 1] = q[:, k] + d * (v[:, k] + d * (a[:, k] / 2.0 + d * j[:, k] / 6.0))
        v[:, k + 1] = v[:, k] + d * (a[:, k] + d * j[:, k] / 2.0)
    q[:, -1], v[:, -1] = problem.goal, 0.0
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
