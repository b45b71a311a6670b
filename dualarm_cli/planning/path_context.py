"""A job's cell as path followers need it: kinematics, clocks, targets, critical points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.dynamics import Dynamics
from dualarm_cli.kinematics.srs_arm import SrsArm
from dualarm_cli.kinematics.whole_body import WholeBody
from dualarm_cli.model.job import Job
from dualarm_cli.model.path_work import PathWork
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.path_following import PathProblem
from dualarm_cli.path_following.problem import Spring
from dualarm_cli.planning.path_clock import PathClock
from dualarm_cli.planning.path_joining import instants
from dualarm_cli.planning.path_targets import tool_targets

STEP, LONGEST_STEP = 1e-3, 1e-2
"""Time between the instants at which joints are found [s]; on long paths more, up to the second."""
MOST = 5_000
"""Instants beyond which the time between them grows."""
PER_KNOT = (4, 8)
"""Instants per knot of the trajectory."""


@dataclass(frozen=True)
class PathContext:
    """A job's cell as path followers need it."""

    model: CellModel
    """In closed form, where its arms have one."""
    body: WholeBody
    """Kinematics of all joints."""
    job: Job
    """What is to be done."""
    limits: JointLimits
    """Limits at the job's speed."""
    dynamics: Dynamics | None
    """For paths that keep torques within limits; None where nothing asks for them."""

    @classmethod
    def of(cls, model: CellModel, job: Job) -> PathContext:
        """Prepares a job."""
        torque = any(task.path is not None and task.path.torque for task in job.tasks)
        return cls(
            model,
            WholeBody(job.cell),
            job,
            job.cell.robot.limits.scaled(job.speed),
            Dynamics(job.cell) if torque else None,
        )

    @property
    def closed_form(self) -> bool:
        """Whether all arms are spherical-revolute-spherical."""
        return all(isinstance(arm.kinematics, SrsArm) for arm in self.model.arms.values())

    def clock(
        self,
        work: PathWork,
        slower: float = 1.0,
        gentle: float = 1.0,
        peak: float | None = None,
    ) -> PathClock:
        """Returns the clock of a path at the job's speed and under its cap on the tools.

        Args:
            work: the path.
            slower: share of that speed at which it is followed.
            gentle: how many times as long as usual ramps take that the file leaves open.
            peak: speed that is not exceeded, with ramps as long as usual [m/s]; None for the file's.
        """
        caps = [cap * slower for cap in (self.job.tool_speed, peak) if cap is not None]
        cap = min(caps, default=None)
        return PathClock.of(work, self.job.speed * slower, gentle, cap)

    def problem(
        self, work: PathWork, start: FloatArray, clock: PathClock, finer: int = 1
    ) -> PathProblem:
        """Returns what a follower is asked.

        Args:
            work: the path.
            start: joints where it begins [rad], shape (n,).
            clock: where the tools are when.
            finer: how many times as many instants as usual.
        """
        widest = PER_KNOT[-1]
        step = min(max(STEP, clock.duration / MOST), LONGEST_STEP) / finer
        count = widest * max(5, int(np.ceil(clock.duration / (step * widest))))
        step = clock.duration / count
        share, pace = clock.at(instants(count + 1, step))
        arms = [arm for arm in self.body.arms if arm in work.paths]
        poses = [tool_targets(work.paths[arm], share, step, work.tolerance) for arm in arms]
        return PathProblem(
            body=self.body,
            limits=self.limits,
            start=start,
            step=step,
            follows=np.array([arm in work.paths for arm in self.body.arms]),
            R=np.stack([R for R, _ in poses], axis=1),
            p=np.stack([p for _, p in poses], axis=1),
            share=share,
            pace=pace,
            spring=Spring(self.critical_points(work.critical_points), 2.0 * work.stiffness**2),
            model=self.model if self.closed_form else None,
            tool_speed=self.job.tool_speed,
            torque=self.dynamics.limit if work.torque and self.dynamics else None,
            dynamics=self.dynamics.at if work.torque and self.dynamics else None,
        )

    def critical_points(self, given: Mapping[str, FloatArray]) -> FloatArray:
        """Returns the critical points of all arms in the carried frame [m], shape (a, 3).

        Where none is given: below the shoulder by the length of the upper arm, where an elbow hangs that nothing holds.

        Args:
            given: by arm.
        """
        shoulders, upper = self.body.shoulders()
        points = shoulders - upper[:, None] * np.array([0.0, 0.0, 1.0])
        for a, arm in enumerate(self.body.arms):
            points[a] = given.get(arm, points[a])
        return points
