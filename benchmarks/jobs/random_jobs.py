"""Random pick sequences of the SDA10F from fixed seeds: what the studies of whole sequences work on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.job import Dwell, Job, Place, PoseTarget, Stop, Task

PACKING = Path(__file__).parents[2] / "tasks" / "04_packing" / "tasks.yaml"
LINE = 0.08
"""Length of approach and retract [m]."""
DWELL = Dwell(0.12, 0.03, 0.02)


def random_job(
    seed: int, stages: int = 24, *, free_yaw: bool, lines: bool, jerk: bool = True
) -> Job:
    """Returns a random job.

    Tools point down; targets are 0.45 to 0.80 m from the platform's axis, each arm's on its own side of the robot's
    front (up to 75 degrees), 0.70 to 1.00 m high, with random yaw.

    Args:
        seed: of the generator.
        stages: stops of each arm.
        free_yaw: whether any yaw will do.
        lines: whether stops have approach, dwell and retract; else transfers are all there is.
        jerk: whether the preset's jerk limits hold; else there are none.
    """
    base = load_job(PACKING)
    random = np.random.default_rng(seed)
    length, dwell = (LINE, DWELL) if lines else (0.0, Dwell())
    tasks = []
    for arm, side in (("left", 1.0), ("right", -1.0)):
        for k in range(stages):
            radius = random.uniform(0.45, 0.80)
            azimuth = side * random.uniform(0.0, np.radians(75.0))
            height, yaw = random.uniform(0.70, 1.00), random.uniform(-np.pi, np.pi)
            place = np.array([radius * np.cos(azimuth), radius * np.sin(azimuth), height])
            pose = pin.SE3(pin.rpy.rpyToMatrix(np.pi, 0.0, yaw), place)
            stop = Stop(
                "move", PoseTarget(pose, free_yaw), length, length, dwell, Place("random", 1, 1)
            )
            tasks.append(Task(f"{arm}-{k}", arm, (stop,)))
    cell = base.cell
    if not jerk:
        limits = cell.robot.limits
        unlimited = replace(limits, jerk=np.full_like(limits.jerk, np.inf))
        cell = replace(cell, robot=replace(cell.robot, limits=unlimited))
    return replace(base, cell=cell, tasks=tuple(tasks), start="home", returns=False)
