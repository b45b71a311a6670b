"""What each arm holds, stage by stage: its part from pick to place, and the tool that is on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product

import numpy as np
import pinocchio as pin

from dualarm_cli.collision.clearance import CellClearance
from dualarm_cli.collision.lying import part_reaches
from dualarm_cli.collision.scenes import stage_scenes
from dualarm_cli.collision.solids import WORLD, shape_solid, tool_body
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.geometry.products import norm
from dualarm_cli.model.cell import Cell, Held
from dualarm_cli.model.job import LYING, TAKES, Job, PoseTarget, Stop, Task
from dualarm_cli.model.shape import Shape
from dualarm_cli.records import dataclass

YAW_STEPS = 24
"""Turns about the tool's z axis that are tried where any will do: 15 degrees apart."""


def stop_yaws(stop: Stop) -> FloatArray:
    """Returns the turns about the tool's z axis that are tried at a stop [rad], shape (y,)."""
    if not isinstance(stop.target, PoseTarget):
        return np.zeros(1)
    turns = YAW_STEPS if stop.target.free_yaw else stop.target.symmetry
    return np.arange(turns, dtype=np.float64) * (2.0 * np.pi / turns)


@dataclass(frozen=True)
class Holding:
    """A job's cell with its quick test, and what the arms hold in n stages, as numbers of that test."""

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
    misfits: Mapping[tuple[int, str], tuple[float, str]]
    """By stage and arm how far a part reaches into something at best [m], and into what, where it fits nowhere."""
    pace: float = 1.0
    """How much slower than at full speed everything moves; times chosen for full speed are multiplied by it."""

    @classmethod
    def of(cls, job: Job, *, crossing: bool = True, cell: CellClearance | None = None) -> Holding:
        """Prepares a job.

        Args:
            job: what is to be done.
            cell: its cell with all that it carries, where that is at hand.
            crossing: whether arms have to be clear of one another; else each is looked at by itself.
        """
        cell = cell or CellClearance.of_job(job)
        cell = replace(
            cell.in_scenes(stage_scenes(job, cell.rooms)),
            crossing=crossing,
            skew=job.skew if crossing else 0.0,
        )
        holds = {arm: job.held_at_start(arm) for arm in cell.arms}
        rows = []
        for work in job.stages():
            now = dict(holds)
            for arm, (task, stop) in work.items():
                # A tool that comes to its stand may touch it there: what is held has another name then.
                holds[arm] = task.held_before(stop.action)
                now[arm] = task.held_after(stop.action)
            rows.append([[cell.held(state[arm]) for arm in cell.arms] for state in (holds, now)])
            holds = now
        fitting, misfits = {}, {}
        for k, work in enumerate(job.stages()):
            for arm, (task, stop) in work.items():
                fitting[k, arm], misfit = _fitting(job, arm, task, stop)
                if misfit is not None:
                    misfits[k, arm] = misfit
        if not rows:
            # A transfer alone, on which no part is held.
            rows.append([[cell.held(holds[arm]) for arm in cell.arms]] * 2)
        numbers = np.array(rows, dtype=np.int64).reshape(-1, 2, len(cell.arms))
        if cell.rooms:
            # Of a transfer alone nothing lies but what lies all the time.
            numbers += cell.size * np.arange(1, len(numbers) + 1)[:, None, None] * bool(job.tasks)
        handing = np.zeros(len(numbers), dtype=np.bool_)
        for k, work in enumerate(job.stages()):
            handing[k] = any(stop.action == "give" for _, stop in work.values())
        before, after = numbers[:, 0], numbers[:, 1]
        return cls(cell, before, after, handing, fitting, misfits, 1.0 / job.speed)

    @property
    def at_targets(self) -> IntArray:
        """What each arm holds at each stage's targets, shape (n, arms)."""
        # Of what an arm may hold tools come first, then tools with parts: the larger number is what it holds more of.
        return self.cell.at_stops(np.maximum(self.before, self.after), self.handing)


def _fitting(
    job: Job, arm: str, task: Task, stop: Stop
) -> tuple[FloatArray, tuple[float, str] | None]:
    """Returns the yaws of a stop at which its part reaches into no obstacle, at the target and along its lines.

    Where it fits nowhere: all yaws, and how far it reaches into what at best [m].
    """
    yaws = stop_yaws(stop)
    of_tool, of_part = job.cell.held_shapes(arm, Held(task.tool, task.part))
    # At its stand a tool is to what stands there as a part is to what it lies on.
    shapes = of_tool if task.is_change else of_part
    body = tool_body(arm, task.tool) if task.is_change else task.part
    if not shapes or not isinstance(stop.target, PoseTarget) or not job.cell.obstacles:
        return yaws, None
    if stop.action not in LYING and not task.is_change:
        return yaws, None  # a part in the air is collision-free as all else does
    line = stop.retract if stop.action in TAKES else stop.approach
    reaches = [
        part_reaches(
            job.cell,
            body,
            shapes,
            stop.target.pose * pin.SE3(pin.utils.rotate("z", yaw), np.array([0.0, 0.0, 0.0])),
            line,
        )
        for yaw in yaws
    ]
    fits = [not into for _, into in reaches]
    return (yaws[fits], None) if any(fits) else (yaws, min(reaches))


def too_near_obstacle(
    cell: Cell, arm: str, task: Task, stop: Stop
) -> tuple[str, float, str] | None:
    """Return a tool or part that is too near to an obstacle at every turn of the tool that a stop allows.

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
    T_tcp_flange, lines = cell.tools[arm].tcp.inverse(), (stop.approach, stop.retract)
    own = tuple(replace(shape, pose=T_tcp_flange * shape.pose) for shape in cell.tools[arm].shapes)
    of_tool, of_part = cell.held_shapes(arm, Held(task.tool, task.part))
    line = lines[1] if stop.action in TAKES else lines[0]
    own_name, tool_name = tool_body(arm, "tool"), tool_body(arm, task.tool)
    bodies = [
        (own_name, own_name, own, max(lines)),
        (task.tool, tool_name, of_tool, line if task.is_change else max(lines)),
        (task.part, task.part, of_part if stop.action in LYING else (), line),
    ]
    yaws = stop_yaws(stop)
    for name, body, shapes, length in bodies:
        if not shapes:
            continue
        # Half way to the next turn that is tried, each point is moved by no more than this.
        turned = np.pi / len(yaws) * _radius(shapes) if stop.target.free_yaw else 0.0
        best: tuple[float, str] | None = None
        for yaw in yaws.tolist():
            T = stop.target.pose * pin.SE3(pin.utils.rotate("z", yaw), np.zeros(3))
            is_tool = name != task.part and not (task.is_change and name == task.tool)
            depth, into = part_reaches(cell, body, shapes, T, length, clear=is_tool)
            if not into or depth <= turned:
                best = None
                break
            best = (depth, into) if best is None else min(best, (depth, into))
        if best is not None:
            return name, *best
    return None


def _radius(shapes: Sequence[Shape]) -> float:
    """Return a distance from the z axis of their frame that no point of some shapes exceeds [m]."""
    solids = [shape_solid("", WORLD, pin.SE3.Identity(), shape) for shape in shapes]
    boxes = [(solid.pose, solid.geometry.aabb_local) for solid in solids]
    corners = [
        pose.act(np.array(corner))[:2]
        for pose, box in boxes
        for corner in product(*zip(np.ravel(box.min_), np.ravel(box.max_), strict=True))
    ]
    return float(norm(np.array(corners), axis=1).max())
