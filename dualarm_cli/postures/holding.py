"""Held parts and tools of each arm, stage by stage."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from dualarm_cli.collision.clearance import CellClearance
from dualarm_cli.collision.lying import (
    YAW_STEPS,
    held_bodies,
    misses_at_ends,
    reaches,
    required,
    stop_yaws,
)
from dualarm_cli.collision.scenes import stage_scenes
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.job import Job, PoseTarget, Stop, Task
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class Holding:
    """Cell of a job with its quick test, and the arms' loads by stage.

    There are n stages; a load is a number of `Loads`.
    """

    cell: CellClearance
    """Hulls and pairs of the cell's bodies."""
    before: IntArray
    """Loads of the arms before each stage's targets, shape (n, arms)."""
    after: IntArray
    """Loads of the arms after each stage's targets, shape (n, arms)."""
    is_handover: BoolArray
    """Flags of stages that are hand-overs, shape (n,)."""
    yaws: Mapping[tuple[int, str], FloatArray]
    """Yaws at which a part fits at its pick or place [rad], by stage and arm.

    All yaws if there is no part, or it fits at none.
    """
    pace: float = 1.0
    """Factor on times for full speed, due to the job's speed."""

    @classmethod
    def of(
        cls, job: Job, *, alone: str | None = None, cell: CellClearance | None = None
    ) -> Holding:
        """Compute the loads of a job by stage.

        Args:
            job: the job.
            cell: clearance of its cell with all carried parts; None computes it.
            alone: the only tested arm, without the other one; None tests all arms.
        """
        cell = cell or CellClearance.of_job(job)
        cell = replace(
            cell.in_scenes(stage_scenes(job, cell.rooms)),
            alone=alone,
            skew=0.0 if alone else job.skew,
        )
        holds = {arm: job.held_at_start(arm) for arm in cell.arms}
        rows = []
        for work in job.stages():
            current = dict(holds)
            for arm, (task, stop) in work.items():
                # A tool may touch its stand, so that it is another load there.
                holds[arm] = task.held_before(stop.action)
                current[arm] = task.held_after(stop.action)
            rows.append(
                [[cell.loads.number(s[arm]) for arm in cell.arms] for s in (holds, current)]
            )
            holds = current
        fitting = {
            (k, arm): _fitting_yaws(job, arm, task, stop)
            for k, work in enumerate(job.stages())
            for arm, (task, stop) in work.items()
        }
        if not rows:
            # A transfer alone, on which no part is held.
            rows.append([[cell.loads.number(holds[arm]) for arm in cell.arms]] * 2)
        numbers = np.array(rows, dtype=np.int64).reshape(-1, 2, len(cell.arms))
        if cell.rooms:
            # During a transfer alone only parts lie that always do.
            scenes = np.arange(1, len(numbers) + 1) * bool(job.tasks)
            numbers = cell.loads.in_scenes(numbers, scenes[:, None, None])
        is_handover = np.zeros(len(numbers), dtype=np.bool_)
        for k, work in enumerate(job.stages()):
            is_handover[k] = any(stop.action == "give" for _, stop in work.values())
        before, after = numbers[:, 0], numbers[:, 1]
        return cls(cell, before, after, is_handover, fitting, 1.0 / job.speed)

    @property
    def at_targets(self) -> IntArray:
        """Loads of the arms at each stage's targets, shape (n, arms)."""
        loads = self.cell.loads
        return loads.at_stops(loads.fuller(self.before, self.after), self.is_handover)


def _fitting_yaws(job: Job, arm: str, task: Task, stop: Stop) -> FloatArray:
    """Select the yaws of a stop at which its part penetrates no obstacle.

    Target and lines are tested; at the end of its line it has clearance, too. All yaws are returned if it fits at none.
    """
    yaws, bodies = stop_yaws(stop), held_bodies(job.cell, arm, task, stop)
    # A tool may touch its stand as a part may touch its support.
    resting = [body for body in bodies if body.rests]
    if not resting or not isinstance(stop.target, PoseTarget) or not job.cell.obstacles:
        return yaws
    both = zip(
        reaches(job.cell, resting[0], stop),
        misses_at_ends(job.cell, resting[0], stop),
        strict=True,
    )
    fits = [not into and not near for (_, into), (_, near) in both]
    return yaws[fits] if any(fits) else yaws


@dataclass(frozen=True)
class TooNearObstacle:
    """Tool or part that is too near to an obstacle at every turn."""

    held: str
    """Name of the tool or part."""
    into: str
    """Name of the obstacle."""
    lacks: float
    """Least lack of clearance, or penetration [m]."""
    needed: float | None = None
    """Required distance where its line ends [m]; None if the fault is elsewhere."""


def too_near_obstacle(cell: Cell, arm: str, task: Task, stop: Stop) -> TooNearObstacle | None:
    """Find a tool or part too near to an obstacle at every turn; None if unproven.

    Tools keep the clearance, but for those at their stands; parts may lie on things as far as their lines go.

    Args:
        cell: with obstacles.
        arm: name of the arm.
        task: task of the stop.
        stop: the stop.
    """
    if not isinstance(stop.target, PoseTarget) or not cell.obstacles:
        return None
    for body in held_bodies(cell, arm, task, stop):
        # Between two tested yaws, each point has moved by no more than this.
        between = np.pi / YAW_STEPS * body.radius if stop.target.free_yaw else 0.0
        if fault := _least_lack(reaches(cell, body, stop), between):
            return TooNearObstacle(body.name, fault[1], fault[0])
        if body.rests and (fault := _least_lack(misses_at_ends(cell, body, stop), between)):
            needed = required(cell, body.body, fault[1])
            return TooNearObstacle(body.name, fault[1], fault[0], needed)
    return None


def _least_lack(by_yaw: Iterable[tuple[float, str]], between: float) -> tuple[float, str] | None:
    """Select the least lack of clearance over all yaws [m] with its obstacle.

    None if some yaw lacks none.

    Args:
        by_yaw: lack of clearance and obstacle at each tested yaw.
        between: largest lack that a yaw between two tested ones may remove [m].
    """
    lacking = []
    for lacks, into in by_yaw:
        if not into or lacks <= between:
            return None
        lacking.append((lacks, into))
    return min(lacking)
