"""Motion while tools stand at their targets: platform and arms move on, and inverse kinematics keeps the tools there.

The platform goes straight to where it leaves the stage, and so does the arm angle of each arm. That is a path of all
these joints, which is timed as a line is. Where the platform moves, all arms at targets move with it, from when the
last one is there; where it does not, each arm moves by itself. No arm leaves its target before that is over. Our own.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.continuation import spare_directions
from dualarm_cli.kinematics.general_arm import GeneralArm
from dualarm_cli.kinematics.srs.srs_arm import SrsArm
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.motion.line_motion import KNOTS, PATH_SAMPLES
from dualarm_cli.motion.transfers import PLATFORM, Drive, Key
from dualarm_cli.motion.world_poses import (
    followed,
    in_carried_frame,
    largest_angle,
    measured_tools,
)
from dualarm_cli.postures import StopPosture
from dualarm_cli.postures.stage_plan import StagePlan
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal
from dualarm_cli.timing.problem import LineProblem

HELD_DISTANCE, HELD_ANGLE = 1e-5, 5e-5
"""How far the tool may be from its target [m] and turned away [rad]: half of what is verified."""
SAME_JOINTS = 1e-6
"""How near to the configuration in which an arm leaves its way there must end [rad]."""


@dataclass(frozen=True)
class DwellMotion:
    """What moves while tools stand."""

    groups: tuple[str, ...]
    """The arms, after the platform where it moves too."""
    motion: Mapping[str, Trajectory]
    """By group, all of one length."""
    duration: float
    """How long it takes [s]."""


def dwell_motions(drive: Drive, plan: StagePlan) -> tuple[DwellMotion, ...]:
    """Returns what moves in the dwells of a stage: platform and arms together, or each arm by itself.

    Args:
        drive: of the job.
        plan: the stage.

    Raises:
        InfeasibleError: a tool cannot be kept at its target.
    """
    if np.array_equal(*_platform(drive.model, plan)):
        return tuple(_timed(drive, plan, (name,)) for name in plan.leaving)
    return (_timed(drive, plan, (PLATFORM, *plan.leaving)),)


def _timed(drive: Drive, plan: StagePlan, groups: tuple[str, ...]) -> DwellMotion:
    ends = list(_platform(drive.model, plan))
    for name, left in plan.leaving.items():
        ends += [plan.stops[name].posture.q_target, left.posture.q_target]
    key: Key = (*groups, *(end.tobytes() for end in ends))
    if key not in drive.known.together:
        drive.known.together[key] = _solved(drive, plan, groups)
    parts = drive.known.together[key]
    motion = dict(zip(groups, parts, strict=True))
    return DwellMotion(groups, motion, parts[0].duration)


def _solved(drive: Drive, plan: StagePlan, groups: tuple[str, ...]) -> tuple[Trajectory, ...]:
    """Returns the motion of some groups in the dwells of a stage, timed."""
    path = dwell_path(drive.model, plan, groups, PATH_SAMPLES)
    names = tuple(joint for group in groups for joint in drive.joints(group))
    limits, share = drive.limits.select(names), np.linspace(0.0, 1.0, PATH_SAMPLES)
    for knots in KNOTS:
        motion = drive.timing.line(LineProblem(names, path, share, limits, None, knots))
        distance, angle = _tool_deviation(drive, plan, groups, motion)
        if distance <= HELD_DISTANCE and angle <= HELD_ANGLE:
            return tuple(motion.select(drive.joints(group)) for group in groups)
    raise InfeasibleError(Refusal("no_plan_on_grid"))


def dwell_path(
    model: CellModel, plan: StagePlan, groups: tuple[str, ...], samples: int
) -> FloatArray:
    """Returns the joints of some groups along their way while tools stand [rad or m], shape (samples, n).

    Args:
        model: the job's cell.
        plan: the stage.
        groups: of which.
        samples: how many of them, at equal shares of the way.

    Raises:
        InfeasibleError: an arm cannot keep its tool at its target on the way.
    """
    share = np.linspace(0.0, 1.0, samples)[:, None]
    first, last = _platform(model, plan)
    platform = first + share * (last - first)
    found = [platform] if PLATFORM in groups else []
    R_carried, p_carried = model.platform.pose(platform[0])
    for name in groups:
        if name == PLATFORM:
            continue
        arm, come, left = (
            model.arms[name].kinematics,
            plan.stops[name].posture,
            plan.leaving[name].posture,
        )
        R, p = arm.forward(come.q_target)
        # The flange stays where it is in the world.
        flange = in_carried_frame(
            model, platform, product(R_carried, R), p_carried + product(R_carried, p)
        )
        q = followed(arm, come, _swing(arm, come, left), flange)
        if np.abs(q[-1] - left.q_target).max() > SAME_JOINTS:
            raise InfeasibleError(Refusal("no_plan_on_grid"))
        # To the last digit, so that pieces of motion can be joined.
        q[-1] = left.q_target
        found.append(q)
    return np.hstack(found)


def _platform(model: CellModel, plan: StagePlan) -> tuple[FloatArray, FloatArray]:
    """Returns the platform's joints as tools come to their targets and as they leave them [rad or m]."""
    columns = model.platform_columns
    return plan.platform_at("approach", columns), plan.platform_at("retract", columns)


def _swing(arm: SrsArm | GeneralArm, come: StopPosture, left: StopPosture) -> float:
    """Returns by how much an arm's angle changes [rad], or its way along the self-motion."""
    if not isinstance(arm, GeneralArm):
        return left.psi_target - come.psi_target
    ways = product(spare_directions(arm, come.q_target[None])[0], left.q_target - come.q_target)
    return float(ways[0]) if len(ways) else 0.0


def _tool_deviation(
    drive: Drive, plan: StagePlan, groups: tuple[str, ...], motion: Trajectory
) -> tuple[float, float]:
    """Returns how far tools are from where they stand at most: distance [m] and angle [rad]."""
    distance, angle = 0.0, 0.0
    platform = _platform(drive.model, plan)[0]
    for R, tip in measured_tools(drive, groups, motion, platform).values():
        distance = max(distance, float(norm(tip - tip[0], axis=1).max()))
        angle = max(angle, largest_angle(R, R[0]))
    return distance, angle
