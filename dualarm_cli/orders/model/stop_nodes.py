"""Postures of arms at their stops over platform angles, whatever the order in which the stops are made."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.stages.plans.candidates import Grid, Nodes
from dualarm_cli.stages.plans.problem import SequenceProblem
from dualarm_cli.stages.plans.source import grid_nodes, has_closed_form
from dualarm_cli.stages.plans.stops import StopTable
from dualarm_cli.stages.sequence_problem import stops_problem

ARM_ANGLES = 12
"""Arm angles around the circle."""
MOST_NODES = 6000
"""Nodes of one stop over all platform angles at most."""
FEW_NODES = 24
"""Of arms without closed forms, for each platform angle."""
ANGLE_STEP = np.radians(15.0)
"""Spacing of the platform angles [rad]; of a rail as `PlatformChain.spacing` has it."""


def platform_angles(model: CellModel, job: Job) -> FloatArray:
    """Returns the platform angles that orders are looked at with, where it starts first [rad], shape (f, k).

    One where it cannot be moved. A platform without limits is turned by half a turn each way at most; a rail is looked
    at in all of its range [m].
    """
    robot = job.cell.robot
    start = job.start_joints
    here: FloatArray = np.array(start[model.platform_columns])[None]
    if not model.platform.is_chosen:
        return here
    limits = robot.limits.select(robot.platform)
    low, high = model.platform.around(
        float(here[0, 0]), float(limits.lower[0]), float(limits.upper[0])
    )
    step = model.platform.spacing(ANGLE_STEP, low, high)
    below, above = int((here[0, 0] - low) / step), int((high - here[0, 0]) / step)
    others = np.delete(np.arange(-below, above + 1), below)
    return np.concatenate([here, here + step * others[:, None]])


def stop_nodes(model: CellModel, job: Job, angles: FloatArray) -> dict[tuple[str, int, int], Nodes]:
    """Returns the postures of every arm at every stop that it may make, by arm, task and number of the stop.

    Args:
        model: the job's cell.
        job: what is to be done.
        angles: platform angles, shape (f, k).
    """
    every = [(t, s, stop) for t, task in enumerate(job.tasks) for s, stop in enumerate(task.stops)]
    problem: SequenceProblem = stops_problem(
        model,
        job,
        {
            name: [stop if job.tasks[t].allows(name) else None for t, _, stop in every]
            for name in model.arms
        },
    )
    turned = angles[:, 0] if problem.turns else np.zeros(1)
    found = {}
    for a, work in enumerate(problem.arms):
        table = StopTable.of(work)
        most = MOST_NODES if has_closed_form(work) else FEW_NODES * len(turned)
        for k, (t, s, _) in enumerate(every):
            if work.stops[k] is None:
                continue
            found[work.name, t, s] = grid_nodes(
                problem, a, table, k, Grid(turned, ARM_ANGLES, most)
            )
    return found
