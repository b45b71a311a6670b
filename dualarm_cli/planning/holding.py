"""What each arm holds, stage by stage: its part from pick to place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualarm_cli.collision.clearance import CellClearance
from dualarm_cli.geometry.arrays import IntArray
from dualarm_cli.model.job import Job


@dataclass(frozen=True)
class Holding:
    """A job's cell with its quick test, and what the arms hold in n stages, as numbers of that test."""

    cell: CellClearance
    """Hulls and pairs."""
    before: IntArray
    """What each arm holds before each stage's targets, shape (n, arms)."""
    after: IntArray
    """What each arm holds after them, shape (n, arms)."""

    @classmethod
    def of(cls, job: Job) -> Holding:
        """Prepares a job.

        Raises:
            InputError: a mesh of the cell that cannot be used.
        """
        carried = dict.fromkeys((task.arm, task.part) for task in job.tasks if task.part)
        cell = CellClearance.of(job.cell, list(carried))
        holds = dict.fromkeys(cell.arms, "")
        rows = []
        for work in job.stages():
            now = dict(holds)
            for arm, (task, stop) in work.items():
                if stop.action == "pick":
                    now[arm] = task.part
                elif stop.action == "place":
                    now[arm] = ""
            rows.append([[cell.held(state[arm]) for arm in cell.arms] for state in (holds, now)])
            holds = now
        numbers = np.array(rows, dtype=np.int64).reshape(-1, 2, len(cell.arms))
        return cls(cell, numbers[:, 0], numbers[:, 1])
