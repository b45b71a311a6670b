"""Times of moves from rest to rest under limits of speed and acceleration, independent of the tool's own."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def rest_to_rest_times(
    ways: FloatArray, velocity: FloatArray, acceleration: FloatArray | float
) -> FloatArray:
    """Returns the times of moves [s], shape (...): the slowest joint decides.

    Over a way s: s / v + v / a where speed v is reached, else 2 sqrt(s / a).

    Args:
        ways: by how much each joint moves, of either sign [rad], shape (..., n).
        velocity: largest speeds [rad/s], shape (n,).
        acceleration: largest accelerations [rad/s²], shape (n,) or one for all; inf for full speed throughout.
    """
    s = np.abs(ways)
    cruising = s / velocity + velocity / acceleration
    reached = s >= velocity * velocity / acceleration
    times = np.where(reached, cruising, 2.0 * np.sqrt(s / acceleration))
    slowest: FloatArray = times.max(axis=-1)
    return slowest
