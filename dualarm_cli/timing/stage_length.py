"""Duration of stages from transfer, line and dwell times of both arms."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from dualarm_cli.geometry.arrays import FloatArray

Times = Sequence[ArrayLike] | FloatArray
"""Times of several arms [s], broadcast to a common shape."""


def stage_length(
    arrivals: Times, lines: Times, dwells: Times | None = None, is_handover: ArrayLike = False
) -> FloatArray:
    """Compute the durations of stages [s], shape (...): those of the slower arm.

    In a hand-over both arms wait for each other. Then the giving arm stands still while the taking arm approaches and
    grips, and the taking arm stands still while the giving arm releases and retracts.

    The law is repeated only in other forms: as linear rows (`linear_steps`), in the unknowns of a
    nonlinear program (`peers/program`), as terms of one arm each whose maximum is taken over many pairs (`potentials`,
    `beam`, orders of stages: there the work of both arms is in the work of each stop of a hand-over), and as a lower
    bound (`bound`).

    Args:
        arrivals: by arm, earliest start of its lines, after its own transfer and the platform's, from the
            stage's start [s]; each broadcasts to (...).
        lines: by arm, time of its approach and retract [s].
        dwells: by arm, time of its tool at the target [s]; minus infinity for an arm without work. None if
            `lines` includes it.
        is_handover: whether a stage is a hand-over, broadcasts to (...).
    """
    if dwells is None:
        dwells = [0.0] * len(lines)
    times = zip(arrivals, lines, dwells, strict=True)
    ends = _largest([np.add(arrived, line) + dwell for arrived, line, dwell in times])
    if not np.any(is_handover):
        return ends
    met = _largest(arrivals) + _sum(lines) + _sum(dwells)
    return np.where(is_handover, met, ends)


def _largest(times: Times) -> FloatArray:
    """Compute the maximum of arrays that broadcast together, 0 without arrays."""
    largest = np.asarray(times[0] if len(times) else 0.0, dtype=np.float64)
    for time in times[1:]:
        largest = np.maximum(largest, time)
    return largest


def _sum(times: Times) -> FloatArray:
    """Compute the sum of arrays that broadcast together."""
    return np.asarray(sum(np.asarray(time, dtype=np.float64) for time in times))
