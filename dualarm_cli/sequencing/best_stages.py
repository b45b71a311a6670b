"""Which stops of two arms are made side by side where each arm's own order is given: exact, at all platform angles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dualarm_cli.geometry.arrays import IntArray
from dualarm_cli.sequencing.stage_alignment import Alignments
from dualarm_cli.sequencing.stage_problem import IDLE, StageProblem

EARLY = 1e-5
"""What it counts that an arm with stops left is idle for a stage [s]: of equal orders the early one is taken."""


def best_stages(problem: StageProblem, rows: Sequence[Sequence[int]]) -> IntArray:
    """Returns the quickest stages of arms whose orders are given, shape (n, arms).

    Where no stages are possible, those of one arm after those of the other.

    Args:
        problem: what is asked, without hand-overs; of its rules of order those between arms, which rows do not say.
        rows: by arm, its stops one after the other.
    """
    queues = [np.array(row, dtype=np.int64)[None] for row in rows]
    every = Alignments(problem, queues, EARLY)
    if np.isfinite(every.totals()[0]):
        return every.best()
    whole = np.full((sum(map(len, rows)), len(rows)), IDLE, dtype=np.int64)
    at = 0
    for a, row in enumerate(rows):
        whole[at : at + len(row), a] = row
        at += len(row)
    return whole
