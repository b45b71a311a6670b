"""Random tasks of the SDA10F whose arms and order are open, from fixed seeds: what the study of orders works on."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from benchmarks.jobs.random_jobs import DWELL, LINE, PACKING
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.geometry.arrays import BoolArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import ANY, Action, Job, Mode, Place, PoseTarget, Stop, Task
from dualarm_cli.orders.model.order_model import OrderModel

FAMILIES = ("spots", "parts", "scattered")
"""One target for each task; a pick and a place for each; one target anywhere, not on the side of the file's arm."""
RADIUS = (0.45, 0.80)
"""Least and largest distance of a target from the platform's axis [m]."""
AZIMUTH = np.radians(75.0)
"""Largest angle of a target from the robot's front [rad]."""
SIDES = (1.0, -1.0)
"""Sign of the azimuth on the side of each arm."""
HEIGHT = (0.78, 0.96)
"""Lowest and highest target [m]; the table's top is at 0.72."""


@dataclass(frozen=True)
class Instance:
    """One job, and what a file that leaves nothing open says."""

    job: Job
    """Arms and order are open."""
    arms: tuple[str, ...]
    """The arm of every task in the file: left and right in turn."""

    @property
    def given(self) -> Job:
        """The job in the order of the file."""
        tasks = (replace(t, arm=arm) for t, arm in zip(self.job.tasks, self.arms, strict=True))
        return replace(self.job, tasks=tuple(tasks), order="given")


def random_instance(seed: int, tasks: int, family: str, mode: Mode) -> Instance:
    """Returns random tasks in the cell of task 04 (its robot, tools and table; 10 mm clearance), there and back home.

    Tasks are drawn one after the other, for the left and the right arm in turn: of every target radius, height and yaw
    uniformly from their ranges, and the azimuth from those on that arm's side of the robot's front; tools down.
    Approach, retract and dwell are those of task 04. Spots are single targets with a given yaw; parts are picked at one
    target with any yaw and placed at another, where half a turn is as good. So the file's order is one that a person
    might write, and either arm may do any task that it reaches. Scattered spots are on either side, so that
    the file's order is one that nobody has thought about.

    A task is left out, and the next one drawn, where the arm whose turn it is cannot make all of its stops: from some
    platform angle of the search's grid (15 degrees), with lines that are clear of the cell at both ends, and in the
    file's stages from an angle that serves both arms. Where arms have clocks of their own the angle is that of home.
    Whether arms touch each other is not looked at.

    Args:
        seed: of the generator.
        tasks: how many.
        family: one of FAMILIES.
        mode: whether arms are paired.
    """
    base = replace(load_job(PACKING), tasks=(), mode=mode, order="optimise")
    names = [arm.name for arm in base.cell.robot.arms]
    random = np.random.default_rng((seed, FAMILIES.index(family)))
    found: list[Task] = []
    angles: list[BoolArray] = []
    while len(found) < tasks:
        # Enough for both arms in any case: which of them serve is seen at once.
        some = [_task(random, family, SIDES[a]) for _ in range(tasks - len(found)) for a in (0, 1)]
        for (a, task), own in zip(
            [(k % 2, task) for k, task in enumerate(some)],
            _angles(base, some, mode),
            strict=True,
        ):
            k = len(found)
            if a != k % 2 or k == tasks:
                continue
            both = own & angles[-1] if a == 1 else own
            if both.any(axis=1).all():
                found.append(replace(task, id=f"task-{k + 1:03d}"))
                angles.append(own)
    arms = tuple(names[k % 2] for k in range(tasks))
    return Instance(replace(base, tasks=tuple(found)), arms)


def _task(random: np.random.Generator, family: str, side: float) -> Task:
    if family == "scattered":
        side = SIDES[int(random.integers(2))]
    if family != "parts":
        stops = [_stop(random, "move", side, free_yaw=False, symmetry=1)]
    else:
        stops = [
            _stop(random, "pick", side, free_yaw=True, symmetry=1),
            _stop(random, "place", side, free_yaw=False, symmetry=2),
        ]
    return Task("drawn", ANY, tuple(stops))


def _stop(
    random: np.random.Generator, action: Action, side: float, *, free_yaw: bool, symmetry: int
) -> Stop:
    radius, azimuth = random.uniform(*RADIUS), side * random.uniform(0.0, AZIMUTH)
    height, yaw = random.uniform(*HEIGHT), random.uniform(-np.pi, np.pi)
    place = np.array([radius * np.cos(azimuth), radius * np.sin(azimuth), height])
    pose = pin.SE3(pin.rpy.rpyToMatrix(np.pi, 0.0, yaw), place)
    target = PoseTarget(pose, free_yaw, symmetry)
    return Stop(action, target, LINE, LINE, DWELL, Place("random", 1, 1))


def _angles(base: Job, tasks: list[Task], mode: Mode) -> list[BoolArray]:
    """Returns at which angles the arm whose turn it is can make the stops of every task, shape (stops, angles)."""
    names = [arm.name for arm in base.cell.robot.arms]
    own = [replace(t, id=f"drawn-{k}", arm=names[k % 2]) for k, t in enumerate(tasks)]
    job = replace(base, tasks=tuple(own))
    order = OrderModel.of(CellModel.from_cell(job.cell), job)
    angles = range(1 if mode == "free" else len(order.angles))
    return [
        np.array(
            [
                [len(order.rows(task.arm, t, s, f)) > 0 for f in angles]
                for s in range(len(task.stops))
            ]
        )
        for t, task in enumerate(own)
    ]
