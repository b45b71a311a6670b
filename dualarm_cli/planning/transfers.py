"""Transfers of one stage: platform and arms leave together, each as fast as what it waits for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.schedule import TOOL_SPEED
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.planning.stage_plan import StagePlan
from dualarm_cli.timing import TimingSolver
from dualarm_cli.timing.problem import TransferProblem
from dualarm_cli.timing.rest_to_rest import rest_to_rest_duration

PLATFORM = "platform"
"""Name of the joint group of the platform; arms' groups bear the arms' names."""
SPEED_SAMPLE = 1e-3
"""Spacing of the instants at which tool speeds are measured [s]."""
SPEED_STEP = 1e-5
"""Half-width of the central difference that measures them [s]."""
SPEED_MARGIN = 1e-3
"""Share of the tool-speed cap kept free for what lies between the instants."""
SPEED_BISECTIONS = 12
"""Halvings of the range of velocity factors: the factor is known to 1/4096."""


@dataclass(frozen=True)
class Transfers:
    """One stage's transfers."""

    motion: Mapping[str, Trajectory]
    """By joint group; groups with nothing to do are missing."""
    times: Mapping[str, float]
    """Closed-form time of each group on its own [s]."""
    joint_times: Mapping[str, float]
    """Closed-form time of each joint on its own [s]."""
    slowest: Mapping[str, str]
    """Each group's slowest joint; empty where nothing moves."""
    capped: bool = False
    """Whether all were slowed for a cap on the tools' speed."""

    def bottleneck(self, arm: str) -> str:
        """Returns the joint for which an arm's line waits, TOOL_SPEED if capped; of all groups if `arm` is empty."""
        groups = [g for g in self.times if g in (arm, PLATFORM) or not arm]
        slowest = max(groups, key=lambda g: self.times[g])
        if not self.times[slowest] > 0:
            return ""
        return TOOL_SPEED if self.capped else self.slowest[slowest]


def time_transfers(
    plan: StagePlan,
    columns: Mapping[str, list[int]],
    limits: JointLimits,
    timing: TimingSolver,
) -> Transfers:
    """Returns the transfers of one stage.

    An arm's transfer lasts as long as its slowest joint, or the platform's where that is slower, because its line
    starts when both are there. The platform arrives with the first arm that waits for it. In a return all arrive
    together.

    Args:
        plan: the stage.
        columns: columns of each joint group within the limits' joints.
        limits: what the joints may do.
        timing: how a transfer is timed.
    """
    moved = np.abs(plan.arrival - plan.start)
    alone = rest_to_rest_duration(moved, limits.velocity, limits.acceleration, limits.jerk)
    times = {g: float(alone[index].max()) for g, index in columns.items()}
    slowest = {
        g: limits.joints[index[int(np.argmax(alone[index]))]] if times[g] > 0 else ""
        for g, index in columns.items()
    }
    platform = times.get(PLATFORM, 0.0)
    lengths = {g: max(platform, times[g]) for g in times if g != PLATFORM}
    if not plan.stops:
        lengths = dict.fromkeys(times, max(times.values()))
    elif PLATFORM in times:
        lengths[PLATFORM] = min(lengths[name] for name in plan.stops)
    motion = {}
    for group, index in columns.items():
        if times[group] > 0 or group in plan.stops:
            names = tuple(limits.joints[i] for i in index)
            own = limits.select(names)
            motion[group] = timing.transfer(
                TransferProblem(names, plan.start[index], plan.arrival[index], own, lengths[group])
            )
    joint_times = dict(zip(limits.joints, alone.tolist(), strict=True))
    return Transfers(motion, times, joint_times, slowest)


def transfers_within_tool_speed(
    model: CellModel,
    plan: StagePlan,
    columns: Mapping[str, list[int]],
    limits: JointLimits,
    timing: TimingSolver,
    cap: float | None,
) -> Transfers:
    """Returns the transfers, slowed until no tool exceeds the cap on its speed.

    All joint velocity limits are lowered by one factor, found by bisection; accelerations and jerks stay,
    so that the tools reach the cap as fast as before.

    Args:
        model: the cell.
        plan: the stage.
        columns: columns of each joint group within the limits' joints.
        limits: what the joints may do.
        timing: how a transfer is timed.
        cap: largest speed of any tool centre point in the world [m/s], or None.
    """
    transfers = time_transfers(plan, columns, limits, timing)
    if cap is None or not transfers.motion:
        return transfers
    allowed = cap * (1.0 - SPEED_MARGIN)
    if _largest_tool_speed(model, plan, columns, transfers) <= allowed:
        return transfers
    low, high = 0.0, 1.0
    best = None
    for _ in range(SPEED_BISECTIONS):
        # Until something fits, the lower end is unknown: go down by factors rather than halves.
        factor = (low + high) / 2 if best is not None else high / 2
        slower = time_transfers(
            plan, columns, replace(limits, velocity=limits.velocity * factor), timing
        )
        if _largest_tool_speed(model, plan, columns, slower) <= allowed:
            best, low = slower, factor
        else:
            high = factor
    if best is None:
        raise InfeasibleError(
            f"limits: tool_speed: {cap:g} m/s is slower than 1/{2**SPEED_BISECTIONS} of the joints' "
            "speed; allow more"
        )
    return replace(best, capped=True)


def _largest_tool_speed(
    model: CellModel,
    plan: StagePlan,
    columns: Mapping[str, list[int]],
    transfers: Transfers,
) -> float:
    """Returns the largest speed of any tool centre point during the transfers [m/s]."""
    length = max(t.duration for t in transfers.motion.values())
    time = np.arange(0.0, length + SPEED_SAMPLE, SPEED_SAMPLE)
    before, after = time - SPEED_STEP, time + SPEED_STEP
    fastest = 0.0
    for name in model.arms:
        ends = [
            model.tool_position(name, _positions(plan, columns, transfers, t))
            for t in (before, after)
        ]
        speed = np.linalg.norm(ends[1] - ends[0], axis=-1) / (2 * SPEED_STEP)
        fastest = max(fastest, float(speed.max()))
    return fastest


def _positions(
    plan: StagePlan,
    columns: Mapping[str, list[int]],
    transfers: Transfers,
    time: FloatArray,
) -> FloatArray:
    """Returns all joints at the given times of the stage, shape (m, n)."""
    q = np.tile(plan.start, (len(time), 1))
    for group, trajectory in transfers.motion.items():
        q[:, columns[group]] = trajectory.at(time)[0]
    return q
