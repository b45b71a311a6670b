"""Why an arm cannot make a stop without touching anything: what it comes nearest to in its best posture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualarm_cli.collision.clearance import SLACK
from dualarm_cli.errors import millimetres
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.general_arm import GeneralArm
from dualarm_cli.kinematics.numeric_inverse import solve_poses
from dualarm_cli.planning.keep_clear import PLACES, KeepClear
from dualarm_cli.redundancy import StopProblem
from dualarm_cli.redundancy.problem import Place
from dualarm_cli.redundancy.stop_batch import StopBatch

ANGLE_STEP = np.radians(10.0)
"""Spacing of the platform angles that are looked at [rad]."""
ARM_ANGLES = 36
"""Arm angles around the circle."""
YAWS = 8
"""Yaws that are looked at where any will do."""
NAMES = {
    "approach": "where its approach starts",
    "target": "at the target",
    "retract": "where its retract ends",
}


@dataclass(frozen=True)
class _Best:
    """The posture at one place that keeps farthest from everything."""

    margin: float
    position: FloatArray
    angle: float


def angles_looked_at(model: CellModel, position: FloatArray) -> FloatArray:
    """Returns platform positions to look at, the present one first, shape (m, k)."""
    here = position[model.platform_columns]
    if not model.platform.is_turntable:
        return here[None]
    limits = model.cell.robot.limits.select(model.platform.joints)
    low, high = max(limits.lower[0], here[0] - np.pi), min(limits.upper[0], here[0] + np.pi)
    return np.concatenate([here, np.arange(low, high + 1e-9, ANGLE_STEP)])[:, None]


def explain_touching(
    keep: KeepClear,
    arm: str,
    position: FloatArray,
    angles: FloatArray,
    problems: list[StopProblem],
) -> str | None:
    """Returns what one arm, whatever the other does, is too near to at a place of its stop; None for nothing.

    Args:
        keep: what has to keep clear in the stage.
        arm: its name.
        position: all joints before the stage [rad], shape (n,).
        angles: platform positions that are looked at, shape (m, k).
        problems: the arm's stop at each of them.
    """
    for place in PLACES:
        best: _Best | None = None
        for angle, problem in zip(angles, problems, strict=True):
            q = _postures(problem, place)
            if not len(q):
                continue
            rows, margin = keep.margins(arm, position, angle, q, place)
            k = int(np.argmax(margin))
            if best is None or margin[k] > best.margin:
                best = _Best(float(margin[k]), rows[k], float(angle[0]) if len(angle) else 0.0)
        if best is None or best.margin >= SLACK:
            continue
        one, other, margin_there = keep.nearest(arm, best.position, place)
        where = ""
        if keep.model.platform.is_turntable:
            where = f", with the platform at {np.degrees(best.angle) + 0.0:.0f} deg"
        return (
            f"{NAMES[place]} every posture is too near to something: at best {one} and {other} lack "
            f"{millimetres(min(0.0, margin_there))} of clearance{where}"
        )
    return None


def _postures(problem: StopProblem, place: Place) -> FloatArray:
    """Returns joints within limits at a place, over branches, arm angles and yaws, shape (k, n)."""
    batch = StopBatch((problem,))
    if problem.configurations is not None:
        return problem.configurations if place == "target" else np.empty((0, len(problem.start)))
    yaw = problem.yaw[:: max(1, len(problem.yaw) // YAWS)]
    depth = {"approach": problem.approach, "target": 0.0, "retract": problem.retract}[place]
    zero = np.zeros(len(yaw), dtype=np.int64)
    poses = batch.poses(zero, zero, yaw)
    if isinstance(problem.arm, GeneralArm):
        reached_q = solve_poses(problem.arm, poses.R, poses.p - poses.z * depth).q
        return problem.arm.nearest_turns(reached_q, problem.start)
    psi = np.linspace(-np.pi, np.pi, ARM_ANGLES, endpoint=False)
    p = (poses.p - poses.z * depth)[:, None, None]
    q, reached = problem.arm.solve_branch(
        poses.R[:, None, None], p, psi[:, None], np.arange(8, dtype=np.int64)
    )
    q = problem.arm.nearest_turns(q, problem.start)
    found: FloatArray = q[reached & problem.arm.within_limits(q)]
    return found
