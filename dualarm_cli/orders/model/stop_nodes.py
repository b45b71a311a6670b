"""Postures of arms at their stops over platform angles, whatever the order in which the stops are made."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.general_arm import GeneralArm
from dualarm_cli.model.job import Job, Stop, Task
from dualarm_cli.postures.sampled_stops import SampledStage
from dualarm_cli.postures.stage_problems import Clock
from dualarm_cli.stages.search.nodes import Grid, grid_nodes
from dualarm_cli.stages.search.problem import ArmDecisions, SequenceProblem
from dualarm_cli.stages.search.stops import StopTable
from dualarm_cli.stages.sequence_problem import stops_problem

ARM_ANGLES = 12
"""Arm angles around the circle."""
MOST_NODES = 6000
"""Nodes of one stop over all platform angles at most."""
SAMPLED_NODES = 12
"""Sampled postures at one platform angle, of arms without closed forms."""
ANGLE_STEP = np.radians(15.0)
"""Spacing of the platform angles [rad]."""


@dataclass(frozen=True)
class StopNodes:
    """One arm's postures at one stop; N of them."""

    angle: IntArray
    """Number of the platform angle, shape (N,)."""
    entry: FloatArray
    """Joints where the approach begins [rad], shape (N, joints)."""
    target: FloatArray
    """Joints at the target [rad], shape (N, joints)."""
    leaving: FloatArray
    """Joints where the retract ends [rad], shape (N, joints)."""
    work: FloatArray
    """About how long approach, dwell and retract take [s], shape (N,)."""
    decisions: ArmDecisions | None = None
    """What the search over the whole sequence calls them, N rows; None for arms without closed forms."""


def platform_angles(model: CellModel, job: Job) -> FloatArray:
    """Returns the platform angles that orders are looked at with, where it starts first [rad], shape (f, k).

    One where it cannot be turned. A platform without limits is turned by half a turn each way at most.
    """
    robot = job.cell.robot
    start = job.start_joints
    here: FloatArray = np.array(start[model.platform_columns])[None]
    if not model.platform.is_turntable:
        return here
    limits = robot.limits.select(robot.platform)
    low = max(float(limits.lower[0]), here[0, 0] - np.pi)
    high = min(float(limits.upper[0]), here[0, 0] + np.pi)
    below, above = int((here[0, 0] - low) / ANGLE_STEP), int((high - here[0, 0]) / ANGLE_STEP)
    others = np.delete(np.arange(-below, above + 1), below)
    return np.concatenate([here, here + ANGLE_STEP * others[:, None]])


def stop_nodes(
    model: CellModel, job: Job, angles: FloatArray
) -> dict[tuple[str, int, int], StopNodes]:
    """Returns the postures of every arm at every stop that it may make, by arm, task and number of the stop.

    Args:
        model: the job's cell.
        job: what is to be done.
        angles: platform angles, shape (f, k).
    """
    if all(not isinstance(arm.kinematics, GeneralArm) for arm in model.arms.values()):
        return _closed(model, job, angles)
    return _sampled(model, job, angles)


def _closed(
    model: CellModel, job: Job, angles: FloatArray
) -> dict[tuple[str, int, int], StopNodes]:
    """Returns nodes of arms with closed forms over the arm angle."""
    every = [(t, s, stop) for t, task in enumerate(job.tasks) for s, stop in enumerate(task.stops)]
    problem: SequenceProblem = stops_problem(
        model,
        job,
        {
            name: [stop if job.tasks[t].allows(name) else None for t, _, stop in every]
            for name in model.arms
        },
    )
    grid = Grid(angles[:, 0] if problem.turns else np.zeros(1), ARM_ANGLES, MOST_NODES)
    found = {}
    for a, work in enumerate(problem.arms):
        table = StopTable.of(work)
        for k, (t, s, _) in enumerate(every):
            if work.stops[k] is None:
                continue
            nodes = grid_nodes(problem, a, table, k, grid)
            found[work.name, t, s] = StopNodes(
                nodes.angle_index,
                nodes.q_approach,
                nodes.decisions.near,
                nodes.q_retract,
                nodes.work,
                nodes.decisions,
            )
    return found


def _sampled(
    model: CellModel, job: Job, angles: FloatArray
) -> dict[tuple[str, int, int], StopNodes]:
    """Returns nodes of any arms."""
    clock = Clock.of(model, job)
    home = np.array(job.start_joints)
    found = {}
    for t, task in enumerate(job.tasks):
        for s, stop in enumerate(task.stops):
            for name in model.arms:
                if task.allows(name):
                    found[name, t, s] = _samples(model, clock, home, angles, name, task, stop)
    return found


def _samples(
    model: CellModel,
    clock: Clock,
    home: FloatArray,
    angles: FloatArray,
    arm: str,
    task: Task,
    stop: Stop,
) -> StopNodes:
    stage = SampledStage(model, clock, {arm: (task, stop)}, home, None)
    samples = stage.samples(angles, arm, SAMPLED_NODES)
    ways = samples.ways
    return StopNodes(ways.row, samples.first, ways.q, samples.last, samples.work)
