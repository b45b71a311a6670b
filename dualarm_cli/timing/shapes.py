"""Normalised double-S shapes of the path length: from 0 to 1 in unit time, at rest at both ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, readonly


@dataclass(frozen=True)
class Shapes:
    """g shapes; each has a start ramp and an end ramp of its own.

    A ramp takes a share of the time, and its two jerk phases take a share of the ramp each (0.5: no phase of
    constant acceleration). Between the ramps the speed is constant.
    """

    start: FloatArray
    """Share of the time in which the speed rises, shape (g,)."""
    start_jerk: FloatArray
    """Share of the start ramp that each of its jerk phases takes, at most 0.5, shape (g,)."""
    end: FloatArray
    """Share of the time in which the speed falls; start + end <= 1, shape (g,)."""
    end_jerk: FloatArray
    """Share of the end ramp that each of its jerk phases takes, at most 0.5, shape (g,)."""

    def __post_init__(self) -> None:
        """Freezes the arrays."""
        for name in ("start", "start_jerk", "end", "end_jerk"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    @property
    def peak(self) -> FloatArray:
        """Speed between the ramps, shape (g,)."""
        return 1.0 / (1.0 - (self.start + self.end) / 2.0)

    def breakpoints(self) -> FloatArray:
        """Returns the eight ends of the seven phases, shape (g, 8)."""
        j1, j2 = self.start * self.start_jerk, self.end * self.end_jerk
        zero, one = np.zeros_like(j1), np.ones_like(j1)
        return np.column_stack(
            [
                zero,
                j1,
                self.start - j1,
                self.start,
                one - self.end,
                one - self.end + j2,
                one - j2,
                one,
            ]
        )

    def jerks(self) -> FloatArray:
        """Returns the jerk of the seven phases, shape (g, 7)."""
        zero = np.zeros_like(self.start)
        j1 = self.peak / (self.start**2 * self.start_jerk * (1.0 - self.start_jerk))
        j2 = self.peak / (self.end**2 * self.end_jerk * (1.0 - self.end_jerk))
        return np.column_stack([j1, zero, -j1, zero, -j2, zero, j2])

    def at(self, time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Returns length, speed, acceleration and jerk, each of shape (g, k).

        Args:
            time: instants of each shape in [0, 1], shape (g, k).
        """
        edges, jerk = self.breakpoints(), self.jerks()
        g = len(edges)
        state = np.zeros((g, 8, 3))
        for k in range(7):
            d, j = edges[:, k + 1] - edges[:, k], jerk[:, k]
            s, v, a = state[:, k].T
            state[:, k + 1, 0] = s + d * (v + d * (a / 2 + d * j / 6))
            state[:, k + 1, 1] = v + d * (a + d * j / 2)
            state[:, k + 1, 2] = a + d * j
        phase = np.clip((time[:, :, None] >= edges[:, None, 1:7]).sum(axis=2), 0, 6)
        row = np.arange(g)[:, None]
        d, j = time - edges[row, phase], jerk[row, phase]
        s, v, a = (state[row, phase, i] for i in range(3))
        return (
            s + d * (v + d * (a / 2 + d * j / 6)),
            v + d * (a + d * j / 2),
            a + d * j,
            np.broadcast_to(j, s.shape),
        )

    def take(self, index: int) -> Shapes:
        """Returns one of the shapes, as a family of one."""
        one = slice(index, index + 1)
        return Shapes(self.start[one], self.start_jerk[one], self.end[one], self.end_jerk[one])


def symmetric_grid(ramps: FloatArray, jerks: FloatArray) -> Shapes:
    """Returns all symmetric shapes of the given ramp shares (at most 0.5) and jerk shares."""
    ramp, jerk = (grid.ravel() for grid in np.meshgrid(ramps, jerks, indexing="ij"))
    return Shapes(ramp, jerk, ramp, jerk)


def samples_within(shapes: Shapes, per_phase: int) -> FloatArray:
    """Returns instants inside every phase of every shape, ends included, shape (g, 7 per_phase).

    The two ends of a phase lie a hair inside it, so that both limits of a jump are seen.
    """
    edges = shapes.breakpoints()
    share = np.linspace(1e-9, 1.0 - 1e-9, per_phase)
    inside = edges[:, :-1, None] + np.diff(edges, axis=1)[:, :, None] * share
    return inside.reshape(len(edges), -1)
