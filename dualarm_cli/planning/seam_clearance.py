"""What keeps clear while a tool works on a part."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from dualarm_cli.collision.clearance import SLACK
from dualarm_cli.collision.quick_test import OVERLAP
from dualarm_cli.errors import millimetres
from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.model.job import Job
from dualarm_cli.model.seam import SeamWork
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.planning.holding import Holding

LOOKED_AT = 0.01
"""Time between the postures of a seam that are looked at [s]."""
KEPT_AT_NODES, KEPT_BETWEEN = SLACK / 2.0, SLACK / 4.0
"""What is kept beyond the required clearance at a seam's nodes, and at the postures that are looked at [m]."""


def seam_holding(job: Job, work: SeamWork) -> Holding:
    """Returns what has to keep clear while the tool works: it may touch the part, not reach into it."""
    cell, tool = job.cell, f"{work.slave}_tool"
    contacts = tuple((tool, body, -OVERLAP) for body in work.touches)
    cell = replace(cell, clearances=(*cell.clearances, *contacts))
    return Holding.of(replace(job, cell=cell, tasks=()))


def clearance_test(holding: Holding) -> Callable[[FloatArray], BoolArray]:
    """Returns a test of which configurations (k, n) [rad] keep clear, (k,)."""

    def clear(position: FloatArray) -> BoolArray:
        return np.asarray(_margins(holding, position) >= KEPT_AT_NODES)

    return clear


def nearest_words(holding: Holding) -> Callable[[FloatArray], str]:
    """Returns what says which bodies come nearest at a configuration (n,) [rad]."""

    def words(position: FloatArray) -> str:
        held = np.zeros(len(holding.cell.arms), dtype=np.int64)
        one, other, missing = holding.cell.nearest(position, held)
        return f"{one} and {other} lack {millimetres(min(0.0, missing))} of clearance"

    return words


def where_it_touches(
    holding: Holding, motions: Sequence[tuple[str, Trajectory | None]]
) -> str | None:
    """Returns where motions do not keep clear, in words, or None.

    Args:
        holding: what has to.
        motions: each with words for where it is; None for none.
    """
    for words, motion in motions:
        if motion is None:
            continue
        count = max(2, int(np.ceil(motion.duration / LOOKED_AT)) + 1)
        time = np.linspace(0.0, motion.duration, count)
        position = motion.at(time)[0]
        margin = _margins(holding, position)
        k = int(np.argmin(margin))
        if margin[k] < KEPT_BETWEEN:
            return f"{words}, after {time[k]:.3f} s, {nearest_words(holding)(position[k])}"
    return None


def _margins(holding: Holding, position: FloatArray) -> FloatArray:
    held = np.zeros((len(position), len(holding.cell.arms)), dtype=np.int64)
    return holding.cell.margins(position, held)
