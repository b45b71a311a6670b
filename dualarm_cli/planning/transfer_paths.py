"""One path of all joints for a stage's transfer: one arm after the other, then both at once if that fails."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dualarm_cli.collision.clearance import SLACK, CellClearance
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.planning.joint_paths import GRIDPOINTS, free_points, rounded_path
from dualarm_cli.planning.stage_plan import StagePlan

KEPT = SLACK / 2.0
"""What paths keep beyond the required clearance, for what their timing leaves them by [m]."""

SPARE = 0.008
"""What they keep more before their corners are rounded, if their ends do [m]."""

Way = Callable[[FloatArray], FloatArray]
"""All joints (n, columns) [rad] at shares (n,) of a path."""


def transfer_path(
    model: CellModel,
    job: Job,
    cell: CellClearance,
    plan: StagePlan,
    held: IntArray,
    seed: int,
) -> FloatArray | None:
    """Returns all joints along a path that keeps clear, shape (GRIDPOINTS, columns) [rad]; None where none was found.

    Of each arm that touches anything a path of its own is found in its joints and the progress of all others along
    theirs ([Erdmann1987]: one after the other); if there is none, one in all joints.

    Args:
        model: the job's cell.
        job: what is to be done.
        cell: hulls and pairs.
        plan: the stage, for where its transfer begins and ends.
        held: what each arm holds, shape (arms,).
        seed: of all randomness.
    """
    limits = job.cell.robot.limits
    start, goal, speed = plan.start, plan.arrival, limits.velocity

    def margins(rows: FloatArray) -> FloatArray:
        return cell.margins(rows, np.tile(held, (len(rows), 1)))

    def free(x: FloatArray) -> BoolArray:
        return np.asarray(margins(x * speed) >= KEPT)

    def well_free(x: FloatArray) -> BoolArray:
        return np.asarray(margins(x * speed) >= kept)

    at_ends = float(margins(np.stack([start, goal])).min())
    if at_ends < KEPT:
        return None
    kept = min(KEPT + SPARE, at_ends)
    points = _one_by_one(model, cell, plan, held, speed, (limits.lower, limits.upper), kept, seed)
    path = None if points is None else rounded_path(free, points / speed)
    if path is None:
        ends = [joints / speed for joints in (start, goal, limits.lower, limits.upper)]
        both = free_points(well_free, ends[0], ends[1], ends[2], ends[3], seed)
        path = None if both is None else rounded_path(free, both)
    if path is None:
        return None
    path = path * speed
    # What is scaled there and back is off by rounding.
    path[0], path[-1] = start, goal
    return path


def _one_by_one(
    model: CellModel,
    cell: CellClearance,
    plan: StagePlan,
    held: IntArray,
    speed: FloatArray,
    span: tuple[FloatArray, FloatArray],
    kept: float,
    seed: int,
) -> FloatArray | None:
    """Returns all joints at points of a path, shape (GRIDPOINTS, columns) [rad], None where an arm has none."""
    share = np.linspace(0.0, 1.0, GRIDPOINTS)
    rows = plan.start + share[:, None] * (plan.arrival - plan.start)
    for a, name in enumerate(cell.arms):
        if (cell.own_margins(a, rows, np.full(len(rows), held[a])) >= KEPT).all():
            continue
        columns = model.arms[name].columns
        top = np.append(1.0 / _length(rows, speed), speed[columns])
        others = _along(share, rows)

        def expanded(
            x: FloatArray, top: FloatArray = top, columns: list[int] = columns
        ) -> FloatArray:
            there: FloatArray = others(x[:, 0] * top[0])  # noqa: B023 - called within the round
            there[:, columns] = x[:, 1:] * top[1:]
            return there

        def free(x: FloatArray, a: int = a, expanded: Way = expanded) -> BoolArray:
            there = expanded(x)
            margin = cell.own_margins(a, there, np.full(len(there), held[a]))
            cross = cell.cross_margins(there, np.tile(held, (len(there), 1)))
            return np.asarray(np.minimum(margin, cross) >= kept)

        ends = [
            np.append(u, joints[columns]) / top
            for u, joints in (
                (0.0, plan.start),
                (1.0, plan.arrival),
                (0.0, span[0]),
                (1.0, span[1]),
            )
        ]
        points = free_points(free, ends[0], ends[1], ends[2], ends[3], seed)
        if points is None:
            return None
        rows = expanded(points)
        share = np.linspace(0.0, 1.0, len(rows))
    return rows


def _length(rows: FloatArray, speed: FloatArray) -> float:
    """Returns about how long a path takes at top speed [s], not zero."""
    return max(float((np.abs(np.diff(rows, axis=0)) / speed).max(axis=1).sum()), 1e-3)


def _along(share: FloatArray, rows: FloatArray) -> Way:
    """Returns the joints at any share of a path, straight between its points."""

    def way(at: FloatArray) -> FloatArray:
        return np.stack([np.interp(at, share, column) for column in rows.T], axis=1)

    return way
