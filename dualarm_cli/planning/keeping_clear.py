"""Whether a motion keeps clear at many instants, with a little to spare for what is between them."""

from __future__ import annotations

import numpy as np

from dualarm_cli.collision.quick_test import QuickTest
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.planning.motion import Motion

STEP = 0.004
"""Time between postures that are looked at [s]."""
SLACK = 0.003
"""What is asked for beyond the required clearance, for what is between the instants [m]."""


def sampled(motion: Motion) -> FloatArray:
    """Returns all joints of a motion at instants at most STEP apart [rad], shape (t, columns)."""
    time = motion.trajectory.time
    count = max(2, int(np.ceil((time[-1] - time[0]) / STEP)) + 1)
    position: FloatArray = motion.trajectory.at(np.linspace(time[0], time[-1], count))[0]
    return position


def keeps_clear(test: QuickTest, position: FloatArray) -> bool:
    """Returns whether everything keeps clear at all of some instants, for all joints (t, columns)."""
    groups = (test.cross, *test.own.values())
    return all(bool((test.margins(group, position) >= SLACK).all()) for group in groups)


def arms_alone_keep_clear(test: QuickTest, position: FloatArray) -> bool:
    """Returns whether each arm keeps clear of itself and of what stands still at all of some instants."""
    return all(bool((test.margins(g, position) >= SLACK).all()) for g in test.own.values())


def last_motion(position: FloatArray) -> int:
    """Returns the number of the instant after which nothing moves."""
    moves = np.flatnonzero(np.abs(np.diff(position, axis=0)).max(axis=1) > 0.0)
    return int(moves[-1]) + 1 if len(moves) else 0
