"""How fast a path is followed: a double S between the places where the tools have to stop."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, readonly
from dualarm_cli.model.path_work import PathWork
from dualarm_cli.timing.double_s import fastest_phases
from dualarm_cli.timing.rest_to_rest import RestToRest

RAMP = 0.2
"""Time in which the speed is reached at constant acceleration, where the file gives no acceleration [s]."""
GRID = 0.002
"""Spacing of the times at which a clock that eases off is kept [s]."""
SLOWEST = 0.02
"""Least factor on the speed."""
EASING = 0.15
"""Time before and after a place that asks for less speed in which a clock eases off [s]."""
CAP_MARGIN = 5e-4
"""Share of a cap on the tools' speed that is kept free: knots are joined by curves."""
RISE = 0.1
"""Time in which the acceleration is reached, where the file gives no jerk [s]."""


@dataclass(frozen=True)
class PathClock:
    """The share of the path at every instant, from rest to rest, with a stop at every corner."""

    starts: FloatArray
    """When phases of constant jerk begin [s], shape (m,)."""
    states: FloatArray
    """Length, speed, acceleration and jerk along the longest path at their begin, shape (m, 4)."""
    full: float
    """When the path would be done if it never eased off [s]."""
    duration: float
    """When the path is done [s]."""
    length: float
    """Length of the longest path [m]."""
    speed: float
    """Largest speed [m/s]."""
    ease: FloatArray
    """Factors on the speed at equal parts of the full time, shape (g,); all 1 where it never eases off."""

    def __post_init__(self) -> None:
        """Freezes the arrays."""
        for name in ("starts", "states", "ease"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    @classmethod
    def of(
        cls, work: PathWork, pace: float = 1.0, gentle: float = 1.0, cap: float | None = None
    ) -> PathClock:
        """Returns the clock of a path.

        Args:
            work: the path, with its speed and perhaps acceleration and jerk.
            pace: share of its speed at which it is followed; everything then takes as much longer.
            gentle: how many times as long as usual ramps take whose acceleration or jerk the file does not give.
            cap: largest speed of any tool [m/s], or None.
        """
        speed = work.speed * pace
        if cap is not None:
            speed = min(speed, cap * (1.0 - CAP_MARGIN))
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
        ease = np.ones(max(2, int(np.ceil(clock / GRID)) + 1))
        return cls(np.array(starts), np.array(states), clock, clock, work.length, speed, ease)

    def at(self, time: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Returns share of the path, 0 to 1, and speed as a share of the largest, at instants (k,) [s]."""
        own, factor = self._own_time(time)
        share, pace = self._at_full(own)
        return share, pace * factor

    def eased(self, time: FloatArray, excess: FloatArray, gently: float = 1.0) -> PathClock:
        """Returns a clock that eases off where it went too fast by some factors, and a while before and after.

        Args:
            time: instants [s], rising, shape (k,).
            excess: by what factor the speed was too high there, below 1 where it was not, shape (k,).
            gently: how many times as long as usual it takes to ease off.
        """
        grid = np.linspace(0.0, self.full, len(self.ease))
        own, _ = self._own_time(time)
        wanted = np.interp(grid, own, 1.0 / np.maximum(excess, 1.0))
        # The more it eases off, the longer this takes in real time: a shorter while of its own time will do.
        window = EASING * gently * float(np.sqrt(np.clip((wanted * self.ease).min(), 0.04, 1.0)))
        half = max(2, int(window / (grid[1] - grid[0])))
        # The least within the window about each instant, then a mean over it: never above what is wanted there.
        padded = np.pad(wanted, 2 * half, mode="edge")
        least = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1).min(axis=1)
        weight = np.hanning(2 * half + 3)[1:-1]
        mean = np.convolve(least, weight / weight.sum(), mode="valid")
        ease = np.maximum(self.ease * mean, SLOWEST)
        slowness = 1.0 / ease
        duration = float((slowness[1:] + slowness[:-1]).sum() * 0.5 * (grid[1] - grid[0]))
        return replace(self, ease=ease, duration=duration)

    def _own_time(self, time: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Returns the times of the clock that never eases off at instants (k,) [s], and the factors on the speed."""
        grid = np.linspace(0.0, self.full, len(self.ease))
        if (self.ease == 1.0).all():
            return time, np.ones_like(time)
        h = grid[1] - grid[0]
        slowness = 1.0 / self.ease
        real = np.concatenate([[0.0], np.cumsum((slowness[1:] + slowness[:-1]) * 0.5 * h)])
        k = np.clip(np.searchsorted(real, time, side="right") - 1, 0, len(grid) - 2)
        gap = real[k + 1] - real[k]
        x = np.clip((time - real[k]) / gap, 0.0, 1.0)
        # Cubic Hermite: the clock's own time passes at the factor's rate.
        m0, m1 = gap * self.ease[k], gap * self.ease[k + 1]
        own = grid[k] + h * x**2 * (3.0 - 2.0 * x) + m0 * x * (1.0 - x) ** 2 - m1 * x**2 * (1.0 - x)
        rate = (
            h * 6.0 * x * (1.0 - x) + m0 * (1.0 - x) * (1.0 - 3.0 * x) - m1 * x * (2.0 - 3.0 * x)
        ) / gap
        return own, rate

    def _at_full(self, time: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Returns share of the path and speed as a share of the largest where the clock never eases off."""
        k = np.clip(np.searchsorted(self.starts, time, side="right") - 1, 0, len(self.starts) - 1)
        h = np.clip(time, 0.0, self.full) - self.starts[k]
        s, v, a, j = self.states[k].T
        length = s + h * (v + h * (a / 2.0 + h * j / 6.0))
        speed = v + h * (a + h * j / 2.0)
        return np.clip(length / self.length, 0.0, 1.0), np.clip(speed / self.speed, 0.0, 1.0)
