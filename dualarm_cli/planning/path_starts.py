"""Where a path may begin: configurations whose tools are at its start, the quickest to get to first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.srs_arm import SrsArm
from dualarm_cli.kinematics.whole_body_reach import Reached, reach
from dualarm_cli.model.job import PathWork
from dualarm_cli.path_following.arm_angle import STATIONS, best_track, flange_poses
from dualarm_cli.planning.path_motion import PathContext
from dualarm_cli.timing.rest_to_rest import RestToRest

PLATFORMS = 24
"""Platform angles at which starts are looked for."""
SEEDS = 24
"""Configurations drawn at random from which starts are looked for."""
ALIKE = 1e-3
"""Starts that differ by less are one [rad]."""
EASE = 0.2
"""What the cost of a way along the path counts among the times to get to its start [s/s²]."""


@dataclass(frozen=True)
class Starts:
    """Where a path may begin."""

    configurations: list[FloatArray]
    """Best first [rad], each of shape (n,)."""
    nearest: Reached
    """The configuration whose tools come nearest to the path's start, of those that were looked for numerically."""


def path_starts(context: PathContext, work: PathWork, here: FloatArray, seed: int) -> Starts:
    """Returns configurations from which a path may be followed [rad], (n,), best first.

    With a posture in the file only the one near it. Otherwise those near where the robot is and near home; with arms in
    closed form those where the easiest way along the path begins, at many platform angles; else from random seeds.

    Args:
        context: the job.
        work: the path.
        here: where the robot is [rad], shape (n,).
        seed: of what is drawn.
    """
    robot = context.job.cell.robot
    if work.posture is not None:
        seeds = [np.array(robot.postures[work.posture])]
    else:
        seeds = [here, np.array(robot.postures["home"])]
    if work.posture is None and not context.closed_form:
        random, limits = np.random.default_rng(seed), context.limits
        seeds += [random.uniform(limits.lower, limits.upper) for _ in range(SEEDS)]
    near = [_near(context, work, q, here) for q in seeds]
    nearest = min(near, key=lambda one: one.distance + one.angle)
    found = [(_time_to(context, here, one.q), one.q) for one in near if one.exact]
    if work.posture is None and context.closed_form:
        found += _easiest(context, work, here)
    kept: list[FloatArray] = []
    for _, q in sorted(found, key=lambda one: one[0]):
        if all(np.abs(q - other).max() > ALIKE for other in kept):
            kept.append(q)
    return Starts(kept, nearest)


def _near(context: PathContext, work: PathWork, q: FloatArray, here: FloatArray) -> Reached:
    """Returns the start near a configuration; an arm that does not follow stays where it is."""
    body = context.body
    follows = np.array([arm in work.paths for arm in body.arms])
    free = body.moves[follows].any(axis=0)
    poses = [work.paths[arm].at(np.zeros(1)) for arm in body.arms if arm in work.paths]
    R, p = np.concatenate([R for R, _ in poses]), np.concatenate([p for _, p in poses])
    return reach(body, context.limits, np.where(free, q, here), follows, R, p)


def _time_to(context: PathContext, here: FloatArray, q: FloatArray) -> float:
    limits = context.limits
    law = RestToRest(limits.velocity, limits.acceleration, limits.jerk)
    return float(law.duration(q - here))


def _easiest(
    context: PathContext, work: PathWork, here: FloatArray
) -> list[tuple[float, FloatArray]]:
    """Returns where the ways of least motion along the path begin, at platform angles around, with what they count."""
    model, limits = context.model, context.limits
    share = np.linspace(0.0, 1.0, STATIONS)
    poses = {arm: path.at(share * path.length) for arm, path in work.paths.items()}
    found = []
    for angles in _platforms(context, here):
        q, cost = here.copy(), 0.0
        q[model.platform_columns] = angles
        for name, (R, p) in poses.items():
            arm = model.arms[name]
            assert isinstance(arm.kinematics, SrsArm)
            flanges = flange_poses(model, arm, q, R, p)
            track = best_track(arm.kinematics, *flanges, limits.velocity[arm.columns])
            if track is None:
                break
            start, _ = arm.kinematics.solve_branch(
                flanges[0][0], flanges[1][0], track.psi[0], np.array(track.branch)
            )
            q[arm.columns] = arm.kinematics.nearest_turns(start, here[arm.columns])
            cost += track.cost
        else:
            found.append((_time_to(context, here, q) + EASE * cost, q))
    return found


def _platforms(context: PathContext, here: FloatArray) -> FloatArray:
    """Returns platform positions around the present one, which is the first, shape (m, k)."""
    model = context.model
    now = here[model.platform_columns]
    if not model.platform.is_turntable:
        return now[None]
    limits = context.limits.select(model.platform.joints)
    low, high = max(limits.lower[0], now[0] - np.pi), min(limits.upper[0], now[0] + np.pi)
    return np.concatenate([now, np.linspace(low, high, PLATFORMS)])[:, None]
