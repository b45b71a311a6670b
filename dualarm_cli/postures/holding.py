"""Held parts and tools of each arm, stage by stage."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from dualarm_cli.collision.clearance import CellClearance
from dualarm_cli.collision.lying import YAW_STEPS, held_bodies, reaches, stop_yaws
from dualarm_cli.collision.scenes import stage_scenes
from dualarm_cli.collision.solids import Solid
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.geometry.products import norm
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.job import Job, PoseTarget, Stop, Task
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class Holding:
    """Cell of a job with its quick test, and the arms' loads by stage.

    There are n stages; a load is a number of `Loads`.
    """

    cell: CellClearance
    """Hulls and pairs."""
    before: IntArray
    """What each arm holds before each stage's targets, shape (n, arms)."""
    after: IntArray
    """What each arm holds after them, shape (n, arms)."""
    handing: BoolArray
    """Which stages are hand-overs, shape (n,)."""
    yaws: Mapping[tuple[int, str], FloatArray]
    """By stage and arm the turns about the tool's z axis at which a part fits where it is picked or placed [rad]; where
    there is no part, or it fits nowhere, all of them."""
    pace: float = 1.0
    """How much slower than at full speed everything moves; times chosen for full speed are multiplied by it."""

    @classmethod
    def of(
        cls, job: Job, *, alone: str | None = None, cell: CellClearance | None = None
    ) -> Holding:
        """Prepares a job.

        Args:
            job: what is to be done.
            cell: its cell with all that it carries, where that is at hand.
            alone: the only arm that is tested, and not against the other one; None for all arms.
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
            now = dict(holds)
            for arm, (task, stop) in work.items():
                # A tool that comes to its stand may touch it there: what is held has another name then.
                holds[arm] = task.held_before(stop.action)
                now[arm] = task.held_after(stop.action)
            rows.append([[cell.loads.number(s[arm]) for arm in cell.arms] for s in (holds, now)])
            holds = now
        fitting = {
            (k, arm): _fitting(job, arm, task, stop)
            for k, work in enumerate(job.stages())
            for arm, (task, stop) in work.items()
        }
        if not rows:
            # A transfer alone, on which no part is held.
            rows.append([[cell.loads.number(holds[arm]) for arm in cell.arms]] * 2)
        numbers = np.array(rows, dtype=np.int64).reshape(-1, 2, len(cell.arms))
        if cell.rooms:
            # Of a transfer alone nothing lies but what lies all the time.
            scenes = np.arange(1, len(numbers) + 1) * bool(job.tasks)
            numbers = cell.loads.in_scenes(numbers, scenes[:, None, None])
        handing = np.zeros(len(numbers), dtype=np.bool_)
        for k, work in enumerate(job.stages()):
            handing[k] = any(stop.action == "give" for _, stop in work.values())
        before, after = numbers[:, 0], numbers[:, 1]
        return cls(cell, before, after, handing, fitting, 1.0 / job.speed)

    @property
    def at_targets(self) -> IntArray:
        """What each arm holds at each stage's targets, shape (n, arms)."""
        loads = self.cell.loads
        return loads.at_stops(loads.fuller(self.before, self.after), self.handing)


def _fitting(job: Job, arm: str, task: Task, stop: Stop) -> FloatArray:
    """Returns the yaws of a stop at which its part reaches into no obstacle, at the target and along its lines.

    All yaws where it fits nowhere.
    """
    yaws, found = stop_yaws(stop), held_bodies(job.cell, arm, task, stop)
    # At its stand a tool is to what stands there as a part is to what it lies on.
    resting = [one for one in found if one.rests]
    if not resting or not isinstance(stop.target, PoseTarget) or not job.cell.obstacles:
        return yaws
    fits = [not into for _, into in reaches(job.cell, resting[0], stop)]
    return yaws[fits] if any(fits) else yaws


def too_near_obstacle(
    cell: Cell, arm: str, task: Task, stop: Stop
) -> tuple[str, float, str] | None:
    """Find a tool or part too near to an obstacle at every turn.

    Tools keep the clearance, but for those at their stands; parts may lie on things.

    Args:
        cell: with obstacles.
        arm: that makes the stop.
        task: of the stop.
        stop: where.

    Returns:
        Its name, what it lacks of clearance or is inside by at best [m], and the obstacle; None where it is not proven.
    """
    if not isinstance(stop.target, PoseTarget) or not cell.obstacles:
        return None
    for one in held_bodies(cell, arm, task, stop):
        # Half way to the next turn that is tried, each point is moved by no more than this.
        between = np.pi / YAW_STEPS * _radius(one.solids) if stop.target.free_yaw else 0.0
        lacking = []
        for lacks, into in reaches(cell, one, stop):
            if not into or lacks <= between:
                break
            lacking.append((lacks, into))
        else:
            return one.name, *min(lacking)
    return None


def _radius(solids: Sequence[Solid]) -> float:
    """Return an upper bound on solids' distance from their z axis [m]."""
    boxes = [(solid.pose, solid.geometry.aabb_local) for solid in solids]
    corners = [
        pose.act(np.array(corner))[:2]
        for pose, box in boxes
        for corner in product(*zip(np.ravel(box.min_), np.ravel(box.max_), strict=True))
    ]
    return float(norm(np.array(corners), axis=1).max())
