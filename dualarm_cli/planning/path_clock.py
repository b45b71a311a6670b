"""How fast a path is followed: a double S between the places where the tools have to stop."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.job import PathWork
from dualarm_cli.timing.double_s import fastest_phases
from dualarm_cli.timing.rest_to_rest import RestToRest

RAMP = 0.2
"""Time in which the speed is reached at constant acceleration, where the file gives no acceleration [s]."""
RISE = 0.1
"""Time in which the acceleration is reached, where the file gives no jerk [s]."""


@dataclass(frozen=True)
class PathClock:
    """The share of the path at every instant, from rest to rest, with a stop at every corner."""

    starts: FloatArray
    """When phases of constant jerk begin [s], shape (m,)."""
    states: FloatArray
    """Length, speed, acceleration and jerk along the longest path at their begin, shape (m, 4)."""
    duration: float
    """When the path is done [s]."""
    length: float
    """Length of the longest path [m]."""
    speed: float
    """Largest speed [m/s]."""

    @classmethod
    def of(cls, work: PathWork, pace: float = 1.0, gentle: float = 1.0) -> PathClock:
        """Returns the clock of a path.

        Args:
            work: the path, with its speed and perhaps acceleration and jerk.
            pace: share of its speed at which it is followed.
            gentle: how many times as long as usual ramps take whose acceleration or jerk the file does not give.
        """
        speed = work.speed * pace
        # Followed slower, everything takes longer in the same way.
        acceleration = (
            work.acceleration * pace**2 if work.acceleration else speed / (RAMP * gentle / pace)
        )
        jerk = work.jerk * pace**3 if work.jerk else acceleration / (RISE * gentle / pace)
        law = RestToRest(np.array([speed]), np.array([acceleration]), np.array([jerk]))
        edges = np.array([0.0, *work.corners(), 1.0]) * work.length
        starts, states, clock = [], [], 0.0
        for begin, end in pairwise(edges.tolist()):
            phases = fastest_phases(np.array([end - begin]), law)
            s, v = float(begin), 0.0
            for h, a, j in zip(
                phases.duration[0], phases.acceleration[0], phases.jerk[0], strict=True
            ):
                starts.append(clock)
                states.append((s, v, float(a), float(j)))
                s += h * (v + h * (a / 2.0 + h * j / 6.0))
                v += h * (a + h * j / 2.0)
                clock += float(h)
        return cls(np.array(starts), np.array(states), clock, work.length, speed)

    def at(self, time: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Returns share of the path, 0 to 1, and speed as a share of the largest, at instants (k,) [s]."""
        k = np.clip(np.searchsorted(self.starts, time, side="right") - 1, 0, len(self.starts) - 1)
        h = np.clip(time, 0.0, self.duration) - self.starts[k]
        s, v, a, j = self.states[k].T
        length = s + h * (v + h * (a / 2.0 + h * j / 6.0))
        speed = v + h * (a + h * j / 2.0)
        return np.clip(length / self.length, 0.0, 1.0), np.clip(speed / self.speed, 0.0, 1.0)
