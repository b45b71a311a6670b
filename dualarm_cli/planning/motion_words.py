"""What is said of a motion: its stages and events."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import JointTarget, PoseTarget, Stop
from dualarm_cli.model.schedule import Event, Stage
from dualarm_cli.planning.stage_plan import ArmStop, StagePlan
from dualarm_cli.planning.transfers import PLATFORM, Transfers


def stage_of(
    model: CellModel,
    plan: StagePlan,
    transfers: Transfers,
    start: float,
    end: float,
    critical: str,
) -> Stage:
    """Returns a stage with the times of its transfers and the joint that decides them.

    Args:
        model: the job's cell.
        plan: the stage.
        transfers: its straight transfers.
        start: when it begins [s].
        end: when it is over [s].
        critical: the arm that is done last; empty for a return.
    """
    platform = plan.arrival[model.platform_columns]
    return Stage(
        start=start,
        end=end,
        tasks=tuple(dict.fromkeys(stop.task.id for stop in plan.stops.values())),
        platform_solver=plan.solver,
        platform_angle=float(platform[0]) if len(platform) == 1 else None,
        platform_time=transfers.times.get(PLATFORM, 0.0),
        arm_times={name: t for name, t in transfers.times.items() if name != PLATFORM},
        joint_times=transfers.joint_times,
        bottleneck=transfers.bottleneck(critical),
    )


def event_of(model: CellModel, plan: StagePlan, arm_stop: ArmStop, time: float) -> Event:
    """Returns the event of one stop: the pose that was asked for, turned by the chosen yaw."""
    target, name = arm_stop.stop.target, arm_stop.arm
    if isinstance(target, PoseTarget):
        turn = pin.SE3(pin.utils.rotate("z", arm_stop.posture.yaw), np.zeros(3))
        pose = target.pose * turn
    else:
        assert isinstance(target, JointTarget)  # seams are planned in sections of their own
        position = np.array(plan.arrival)
        position[model.arms[name].columns] = target.configurations[arm_stop.posture.target]
        pose = model.tool_pose(name, position)
    return Event(
        time=time,
        arm=name,
        task=arm_stop.task.id,
        action=arm_stop.stop.action,
        frame=f"{name}_tcp",
        pose=pose,
        dwell=arm_stop.stop.dwell.total,
        velocity=_velocity(arm_stop.stop),
    )


def _velocity(stop: Stop) -> tuple[float, float, float]:
    """Returns the velocity with which a target moves [m/s]."""
    if stop.belt is None:
        return 0.0, 0.0, 0.0
    x, y, z = stop.belt.conveyor.velocity.tolist()
    return x, y, z


def at_knot(event: Event, time: FloatArray) -> Event:
    """Returns the event at the nearest knot: knots nearer than a nanosecond have become one."""
    after = int(np.clip(np.searchsorted(time, event.time), 1, len(time) - 1))
    nearest = min(time[after - 1], time[after], key=lambda knot: abs(knot - event.time))
    return replace(event, time=float(nearest))
