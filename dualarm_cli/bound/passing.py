"""The law of joints whose tools pass the outer ends of lines in motion: what the bound on such plans rests on.

Stages are as they are: both arms begin one together, with transfers, then approach, dwell and retract. Only at its
target a tool is at rest, its joints' accelerations zero as well. So

- a transfer takes at least the way of each joint at its full speed, in whatever motion it begins and ends; the
  platform, which is at rest at both ends, takes its rest-to-rest time as before;
- on a line joint j turns D_j(T) at most in time T after it left the target or before it comes there, forth and back
  added up: its acceleration is at most min(a, j t) after a time t, and so its speed at most the integral of that, and
  v.

Our own derivation.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import cube
from dualarm_cli.model.rest_to_rest import RestToRest
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.problem import SequenceProblem

AT_ONCE = 1e12
"""Acceleration limit that costs no time worth a digit, per speed limit [1/s]."""


@dataclass(frozen=True)
class PassingLaw(RestToRest):
    """Least times between any states of motion, and how far joints get from rest to any state."""

    own: RestToRest
    """The joints' limits."""

    @classmethod
    def of(cls, law: RestToRest) -> PassingLaw:
        """Returns the law of joints with given limits."""
        velocity = np.asarray(law.velocity)
        return cls(velocity, AT_ONCE * velocity, np.full_like(velocity, np.inf), law)

    def reachable_distance(self, duration: FloatArray) -> FloatArray:
        """Returns how far each joint turns at most in the given times from rest [rad].

        Args:
            duration: times T [s], 0 or more, shape (..., n) or (..., 1).
        """
        v, a = self.own.velocity, self.own.acceleration
        limited = np.isfinite(self.own.jerk)
        j = np.where(limited, self.own.jerk, 1.0)
        rise = np.where(limited, np.minimum(a / j, np.sqrt(2.0 * v / j)), 0.0)
        gained = np.where(limited, j * np.square(rise) / 2.0, 0.0)
        ramp = np.maximum(v - gained, 0.0) / a
        first = np.minimum(duration, rise)
        second = np.clip(duration - rise, 0.0, ramp)
        third = np.maximum(duration - rise - ramp, 0.0)
        way: FloatArray = (
            np.where(limited, j * cube(first) / 6.0, 0.0)
            + second * (gained + a * second / 2.0)
            + v * third
        )
        return way


def passing(problem: SequenceProblem) -> SequenceProblem:
    """Returns a sequence for `lower_bound` whose arms are at rest at their targets only."""
    arms = tuple(replace(arm, law=PassingLaw.of(arm.law)) for arm in problem.arms)
    return replace(problem, arms=arms)


def at_rest(law: RestToRest) -> RestToRest:
    """Returns the law from rest to rest of joints with the same limits."""
    return law.own if isinstance(law, PassingLaw) else law
