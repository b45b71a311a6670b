"""Problems of the redundancy solvers: the arms' stops of a stage at platform positions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from dualarm_cli.collision.lying import stop_yaws
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.products import product
from dualarm_cli.kinematics.cell_model import ArmModel, CellModel
from dualarm_cli.model.job import Job, JointTarget, PoseTarget, Stop, Task
from dualarm_cli.model.motion.rest_to_rest import RestToRest
from dualarm_cli.postures import StopProblem
from dualarm_cli.postures.clear_postures import StageCollisionTest
from dualarm_cli.records import dataclass
from dualarm_cli.timing.line_profile import estimate_line_durations


@dataclass(frozen=True)
class ArmClock:
    """Closed-form times of one arm under the job's limits."""

    law: RestToRest
    """Rest-to-rest times of its joints."""
    line_time: Callable[[FloatArray, FloatArray], FloatArray]
    """Estimated times of lines."""
    R_tool_flange: FloatArray
    """Rotation of the flange in the tool frame, shape (3, 3)."""
    p_tool_flange: FloatArray
    """Position of the flange in the tool frame [m], shape (3,)."""


@dataclass(frozen=True)
class Clock:
    """Closed-form times under a job's limits at its speed."""

    platform: RestToRest | None
    """Rest-to-rest times of the platform's joints; None without any."""
    arms: Mapping[str, ArmClock]
    """Closed-form times by arm."""

    @classmethod
    def of(cls, model: CellModel, job: Job) -> Clock:
        """Create the closed-form times of a job's robot."""
        robot = job.cell.robot
        limits = job.limits
        arms = {}
        for name, arm in model.arms.items():
            arm_limits = limits.select(arm.arm.joints)
            T = arm.T_flange_tcp.inverse()
            line_time = partial(estimate_line_durations, limits=arm_limits)
            arms[name] = ArmClock(arm_limits.law, line_time, T.rotation, T.translation)
        platform = limits.select(robot.platform).law if robot.platform else None
        return cls(platform, arms)

    def platform_times(self, moved: FloatArray) -> FloatArray:
        """Compute the platform's times [s], (...), for displacements of its joints (..., k)."""
        if self.platform is None:
            return np.zeros(moved.shape[:-1])
        return self.platform.duration(moved)


@dataclass(frozen=True)
class StageStops:
    """Stops of both arms in one stage, from any start."""

    model: CellModel
    """The job's cell."""
    clock: Clock
    """The job's times."""
    work: Mapping[str, tuple[Task, Stop]]
    """The stage's targets by arm."""
    refine: bool
    """Flag of postures that are refined."""
    keep: StageCollisionTest | None
    """Collision test of the stage, or None."""

    def from_position(
        self, position: FloatArray, angles: FloatArray
    ) -> list[dict[str, StopProblem]]:
        """Set up the arms' stops with the platform at each of many positions, coming from one.

        Args:
            position: all joints before the stage [rad], shape (n,).
            angles: platform positions, shape (m, k).
        """
        model, keep = self.model, self.keep
        waiting = self.clock.platform_times(angles - position[model.platform_columns])
        R_world, p_world = model.platform.pose(angles)
        R_carried = np.swapaxes(R_world, -1, -2)
        problems_of_angle: list[dict[str, StopProblem]] = [{} for _ in angles]
        for name, (_, stop) in self.work.items():
            arm, times = model.arms[name], self.clock.arms[name]
            R, p, configurations = _targets(arm, stop, R_carried, p_world)
            start = position[arm.columns]
            turning, fixed = stop.directions.vectors
            directions = [
                np.stack([turning, product(fixed, R_carried[k].T)]) for k in range(len(R))
            ]
            yaw = stop_yaws(stop) if keep is None else keep.yaws(name)
            for k, problems in enumerate(problems_of_angle):
                test = None if keep is None else keep.test(name, position, angles[k], self.work)
                problems[name] = StopProblem(
                    arm=arm.kinematics,
                    R_base_tool=R[k],
                    p_base_tool=p[k],
                    R_tool_flange=times.R_tool_flange,
                    p_tool_flange=times.p_tool_flange,
                    configurations=configurations,
                    yaw=yaw,
                    free_yaw=isinstance(stop.target, PoseTarget) and stop.target.free_yaw,
                    approach=stop.approach,
                    retract=stop.retract,
                    start=start,
                    waiting=float(waiting[k]),
                    joint_times=times.law.per_joint,
                    line_time=times.line_time,
                    refine=self.refine,
                    is_free=test,
                    directions=directions[k],
                )
        return problems_of_angle

    def at_start(self, position: FloatArray) -> dict[str, StopProblem]:
        """Set up the arms' stops with the platform where it is, from all joints (n,) [rad]."""
        return self.from_position(position, position[self.model.platform_columns][None])[0]


def stop_problems(
    model: CellModel, job: Job, position: FloatArray, work: Mapping[str, tuple[Task, Stop]]
) -> dict[str, StopProblem]:
    """Set up each arm's stop with the platform at its present position.

    Args:
        model: the job's cell.
        job: the job, for its limits.
        position: all joints before the stage [rad], shape (n,).
        work: the stage's targets by arm.
    """
    stops = StageStops(model, Clock.of(model, job), work, refine=True, keep=None)
    return stops.at_start(position)


def _targets(
    arm: ArmModel, stop: Stop, R_carried: FloatArray, p_world: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray | None]:
    """Compute tool poses in the carried frame at m places of it, and configurations.

    Args:
        arm: the arm.
        stop: its stop.
        R_carried: rotation of the world in the carried frame, shape (m, 3, 3).
        p_world: positions of the carried frame [m], shape (m, 3).

    Returns:
        Rotations (m, t, 3, 3), positions (m, t, 3) [m] of t alternatives, and their configurations (t, 7) or None.
    """
    if isinstance(stop.target, JointTarget):
        tcp, q, m = arm.T_flange_tcp, stop.target.configurations, len(p_world)
        R, p = arm.kinematics.forward(q)
        p = p + product(R, tcp.translation)
        R = product(R, tcp.rotation)
        return np.broadcast_to(R, (m, *R.shape)), np.broadcast_to(p, (m, *p.shape)), q
    assert isinstance(stop.target, PoseTarget)  # seams are planned in sections of their own
    pose = stop.target.pose
    p = product(R_carried, (pose.translation - p_world)[..., None])[..., 0]
    return product(R_carried, pose.rotation)[:, None], p[:, None], None
