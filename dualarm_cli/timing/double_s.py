"""Trajectories of transfers in closed form; minimum times are in `model/motion/rest_to_rest.py`."""

from __future__ import annotations

import numpy as np

from dualarm_cli.compiled import trajectories
from dualarm_cli.geometry.arrays import FloatArray, readonly
from dualarm_cli.geometry.elementary import cbrt, cube
from dualarm_cli.model.motion.rest_to_rest import RestToRest
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.records import dataclass
from dualarm_cli.timing.composition import hold
from dualarm_cli.timing.problem import TransferProblem

PHASES = 7
"""Number of phases of a double S; unused ones have no length."""


@dataclass(frozen=True)
class Phases:
    """Phases of constant jerk of n joints, in order."""

    duration: FloatArray
    """Durations [s], shape (n, 7); all zero for a joint at rest."""
    acceleration: FloatArray
    """Accelerations at the starts of phases [rad/s²], shape (n, 7)."""
    jerk: FloatArray
    """Jerks of the phases [rad/s³], shape (n, 7)."""

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for name in ("duration", "acceleration", "jerk"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    def slowed(self, duration: float) -> Phases:
        """Slow each motion to a given duration [s].

        Slowing by k divides velocity by k, acceleration by k² and jerk by k³.
        """
        total = self.duration.sum(axis=1, keepdims=True)
        k = np.where(total > 0.0, duration / np.where(total > 0.0, total, 1.0), 1.0)
        return Phases(self.duration * k, self.acceleration / np.square(k), self.jerk / cube(k))


def transfer_trajectory(problem: TransferProblem, phases: Phases, duration: float) -> Trajectory:
    """Build the trajectory of a transfer from the phases of its joints.

    The last knot is exactly the goal: rounding errors are below 1e-12 of the distance. Knots nearer than 1e-9 s
    are merged. Only accelerations of joints without a jerk limit jump, at two knots at one time.

    Args:
        problem: the transfer.
        phases: phases of all its joints.
        duration: end of every motion [s].
    """
    leaving, arriving = problem.rates()
    knots = trajectories.transfer_knots(
        (problem.start, leaving, problem.goal, arriving),
        problem.limits.jerk,
        (phases.duration, phases.acceleration, phases.jerk),
        duration,
    )
    return Trajectory(problem.joints, *knots)


def solve_transfer(problem: TransferProblem) -> Trajectory:
    """Time a transfer in closed form, each joint slowed to the duration of the slowest.

    That time is the least time of the slowest joint, or the minimum duration. Slowing by k divides velocity by k,
    acceleration by k² and jerk by k³, so that fast joints move gently, and no phase is
    shorter than in the joint's fastest motion.
    """
    distance, limits = problem.goal - problem.start, problem.limits
    law = limits.law
    duration = max(float(law.duration(distance)), problem.minimum_duration)
    if not distance.any():
        return hold(problem.joints, problem.start, duration)
    return transfer_trajectory(problem, fastest_phases(distance, law).slowed(duration), duration)


def fastest_phases(distance: FloatArray, law: RestToRest) -> Phases:
    """Compute the phases of each joint's fastest motion from rest to rest.

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
    ramp[short], constant[short] = cbrt(d / (2.0 * j))[short], 0.0
    constant, cruise = np.maximum(constant, 0.0), np.maximum(cruise, 0.0)
    limited = np.isfinite(j)
    top = sign * np.where(limited, np.where(limited, j, 0.0) * ramp, a)
    rise, none = sign * np.where(limited, j, 0.0), np.zeros_like(d)
    return Phases(
        np.column_stack([ramp, constant, ramp, cruise, ramp, constant, ramp]),
        np.column_stack([none, top, top, none, none, -top, -top]),
        np.column_stack([rise, none, -rise, none, -rise, none, rise]),
    )
