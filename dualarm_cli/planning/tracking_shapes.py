"""The parts of a stop on a conveyor, and how speed rises and lines are passed in them: by constant jerks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray

LINE_SHAPES = ((2, 0), (1, 2), (1, 1), (1, 0))
"""Double-S shapes of lines: length of their jerks, and of constant acceleration between two of them, in eighths of the
line's time; what is left in the middle is passed at one speed."""

CHECKS_PER_KNOT = 4
"""Instants per interval at which the tool is looked at."""


@dataclass(frozen=True)
class Phases:
    """How long each part of the stop takes [s]; a line of no length takes none."""

    rise: float
    """From rest to the belt's velocity."""
    approach: float
    """Down to the part, in the belt's frame."""
    dwell: float
    """At the part."""
    retract: float
    """Up again."""
    fall: float
    """From the belt's velocity to rest."""
    shape: int = 0
    """Which of LINE_SHAPES the lines have."""

    @property
    def edges(self) -> FloatArray:
        """Where the phases begin and end, from 0 [s], shape (6,)."""
        lengths = [self.rise, self.approach, self.dwell, self.retract, self.fall]
        return np.concatenate([[0.0], np.cumsum(lengths)])

    def longer(self, factor: FloatArray) -> Phases:
        """Returns the phases with each made longer by its factor (5,); the dwell stays as it is."""
        rise, approach, _, retract, fall = factor
        return Phases(
            self.rise * rise,
            self.approach * approach,
            self.dwell,
            self.retract * retract,
            self.fall * fall,
            self.shape,
        )


def ramp_way(share: FloatArray) -> FloatArray:
    """Returns the way of a velocity that rises to 1 by two opposite jerks over shares of time from 0 to 1: 1/2 at 1."""
    back = 1.0 - share
    return np.where(share < 0.5, 2.0 / 3.0 * share**3, share - 0.5 + 2.0 / 3.0 * back**3)


def line_way(share: FloatArray, shape: int) -> FloatArray:
    """Returns the share of the way by shares of the time of a line, from rest to rest.

    Args:
        share: of the time, from 0 to 1.
        shape: number of one of LINE_SHAPES.
    """
    time, jerk = _pieces(shape)
    state = np.zeros((3, len(time)))
    for k, (dt, j) in enumerate(zip(np.diff(time), jerk, strict=True)):
        q, v, a = state[:, k]
        state[:, k + 1] = (
            q + dt * (v + dt * (a / 2.0 + dt * j / 6.0)),
            v + dt * (a + dt * j / 2.0),
            a + dt * j,
        )
    piece = np.clip(np.searchsorted(time, share, side="right") - 1, 0, len(jerk) - 1)
    q, v, a = state[:, piece]
    dt, j = share - time[piece], jerk[piece]
    way: FloatArray = (q + dt * (v + dt * (a / 2.0 + dt * j / 6.0))) / state[0, -1]
    return way


def _pieces(shape: int) -> tuple[FloatArray, FloatArray]:
    """Returns the ends of a shape's pieces, from 0 to 1, and their jerks."""
    jerk, constant = LINE_SHAPES[shape]
    ramp = np.array([jerk, constant, jerk]) if constant else np.array([jerk, jerk])
    signs = [1.0, 0.0, -1.0] if constant else [1.0, -1.0]
    cruise = 8 - 2 * int(ramp.sum())
    lengths = np.concatenate([ramp, [cruise] if cruise else [], ramp])
    jerks = [*signs, *([0.0] if cruise else []), *(-sign for sign in signs)]
    return np.concatenate([[0.0], np.cumsum(lengths) / 8.0]), np.array(jerks)


def dense(time: FloatArray) -> FloatArray:
    """Returns instants between knots, and the knots."""
    share = np.arange(CHECKS_PER_KNOT) / CHECKS_PER_KNOT
    inside = (time[:-1, None] + np.diff(time)[:, None] * share).ravel()
    return np.append(inside, time[-1])
