"""Length of a stage from the times of transfers, lines and dwells of both arms."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from dualarm_cli.geometry.arrays import FloatArray

Times = Sequence[ArrayLike] | FloatArray
"""Times of several arms [s], each broadcasts to a common shape."""


def stage_length(
    arrivals: Times, lines: Times, dwells: Times | None = None, together: ArrayLike = False
) -> FloatArray:
    """Returns how long stages take [s], shape (...): as long as the slower arm.

    In a hand-over both arms wait for each other, and then for what the other one does: the giving arm stands still
    while the taking one approaches and grips, and lets go and retracts afterwards.

    The law is written out again only where it is something else: as linear rows (`linear_steps`), in the unknowns of a
    nonlinear program (`peers/program`), as terms of one arm each whose maximum is taken over many pairs (`potentials`,
    `beam`, orders of stages: there the work of both arms is in the work of each stop of a hand-over), and as a lower
    bound (`bound`).

    Args:
        arrivals: by arm, when its lines may begin, as its own transfer and the platform's are over, counted from the
            stage's start [s]; each broadcasts to (...).
        lines: by arm, what its approach and retract take [s].
        dwells: by arm, how long its tool stands at the target [s]; minus infinity for an arm without work. None where
            that is in `lines`.
        together: whether a stage is a hand-over, broadcasts to (...).
    """
    if dwells is None:
        dwells = [0.0] * len(lines)
    spent = zip(arrivals, lines, dwells, strict=True)
    ends = _largest([np.add(arrived, line) + dwell for arrived, line, dwell in spent])
    if not np.any(together):
        return ends
    met = _largest(arrivals) + _sum(lines) + _sum(dwells)
    return np.where(together, met, ends)


def _largest(times: Times) -> FloatArray:
    """Returns the largest of arrays that broadcast together, 0 of none."""
    largest = np.asarray(times[0] if len(times) else 0.0, dtype=np.float64)
    for one in times[1:]:
        largest = np.maximum(largest, one)
    return largest


def _sum(times: Times) -> FloatArray:
    """Returns the sum of arrays that broadcast together."""
    return np.asarray(sum(np.asarray(one, dtype=np.float64) for one in times))
