"""What each arm holds, stage by stage: its part from pick to place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from dualarm_cli.collision.clearance import CellClearance
from dualarm_cli.collision.lying import part_fits
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.model.job import Job, JointTarget, Stop
from dualarm_cli.planning.yaws import stop_yaws


@dataclass(frozen=True)
class Holding:
    """A job's cell with its quick test, and what the arms hold in n stages, as numbers of that test."""

    cell: CellClearance
    """Hulls and pairs."""
    before: IntArray
    """What each arm holds before each stage's targets, shape (n, arms)."""
    after: IntArray
    """What each arm holds after them, shape (n, arms)."""
    yaws: Mapping[tuple[int, str], FloatArray]
    """By stage and arm the turns about the tool's z axis at which a part fits where it is picked or placed [rad]; where
    there is no part, or it fits nowhere, all of them."""
    pace: float = 1.0
    """How much slower than at full speed everything moves; times chosen for full speed are multiplied by it."""

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
        fitting = {
            (k, arm): _fitting(job, stop, task.part)
            for k, work in enumerate(job.stages())
            for arm, (task, stop) in work.items()
        }
        numbers = np.array(rows, dtype=np.int64).reshape(-1, 2, len(cell.arms))
        return cls(cell, numbers[:, 0], numbers[:, 1], fitting, 1.0 / job.speed)


def _fitting(job: Job, stop: Stop, part: str) -> FloatArray:
    """Returns the yaws of a stop at which its part reaches into no obstacle, at the target and along its lines."""
    yaws = stop_yaws(stop)
    if not part or isinstance(stop.target, JointTarget) or not job.cell.obstacles:
        return yaws
    line = stop.retract if stop.action == "pick" else stop.approach
    fits = [
        part_fits(
            job.cell,
            part,
            stop.target.pose * pin.SE3(pin.utils.rotate("z", yaw), np.array([0.0, 0.0, 0.0])),
            line,
        )
        for yaw in yaws
    ]
    return yaws[fits] if any(fits) else yaws
