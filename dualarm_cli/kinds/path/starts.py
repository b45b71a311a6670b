"""Start configurations of a path, quickest to reach first."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.kinds.path.context import PathContext
from dualarm_cli.kinds.path.following.arm_angle import coarse_tracks, flange_poses
from dualarm_cli.kinematics.cell_model import ArmModel
from dualarm_cli.kinematics.whole_body import Reached, reach
from dualarm_cli.model.path_work import PathWork
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class StartSettings:
    """Numbers of starts that a path is tried from."""

    platforms: int = 24
    """Platform angles at which starts are looked for."""
    stations: int = 31
    """Places along the path at which ways along it are compared."""
    branches: int = 3
    """Branches of each arm that are taken at a platform angle, those of least motion."""
    seeds: int = 24
    """Configurations drawn at random from which starts are looked for."""
    most: int = 120
    """Maximum number of posture paths that are tested for collisions, the cheapest first."""
    alike: float = 1e-3
    """Largest joint difference at which two starts count as the same [rad]."""
    ease: float = 0.2
    """Weight of a posture path's cost against the time to its start [s/s²]."""


STARTS = StartSettings()


@dataclass(frozen=True)
class PathStarts:
    """Where a path may begin."""

    configurations: list[FloatArray]
    """Best first [rad], each of shape (n,)."""
    nearest: Reached
    """The configuration whose tools come nearest to the path's start, of those that were looked for numerically."""


@dataclass(frozen=True)
class _Way:
    """A way along the path, or where one may begin."""

    cost: float
    """Time to get to its start and what its joints' motion counts [s]."""
    joints: FloatArray
    """All joints at places along it, the start first [rad], shape (k, n)."""


def path_starts(
    context: PathContext,
    work: PathWork,
    here: FloatArray,
    seed: int,
    clear: Callable[[FloatArray], BoolArray] | None = None,
) -> PathStarts:
    """Returns configurations from which a path may be followed [rad], (n,), best first.

    With a posture in the file only the one near it. Otherwise those near where the robot is and near home; with arms in
    closed form those where the easiest way along the path begins, at many platform angles; else from random seeds.

    Args:
        context: the job.
        work: the path.
        here: where the robot is [rad], shape (n,).
        seed: of what is drawn.
        clear: whether configurations (k, n) [rad] are collision-free, shape (k,); None where nothing has to be.
    """
    robot = context.job.cell.robot
    if work.posture is not None:
        seeds = [np.array(robot.postures[work.posture])]
    else:
        seeds = [here, np.array(robot.postures["home"])]
    easiest = (
        _easiest(context, work, here)
        if work.posture is None and context.model.has_arm_angles
        else []
    )
    near = [_near(context, work, q, here) for q in seeds]
    if work.posture is None and not easiest:
        random, limits = np.random.default_rng(seed), context.limits
        drawn = (random.uniform(limits.lower, limits.upper) for _ in range(STARTS.seeds))
        near += [_near(context, work, q, here) for q in drawn]
    nearest = min(near, key=lambda one: one.distance + one.angle)
    found = [_Way(_time_to(context, here, one.q), one.q[None]) for one in near if one.exact]
    found = sorted([*found, *easiest], key=lambda one: one.cost)
    if clear is not None and found:
        found = _clear_first(found[: STARTS.most], clear)
    kept: list[FloatArray] = []
    for q in (way.joints[0] for way in found):
        if all(np.abs(q - other).max() > STARTS.alike for other in kept):
            kept.append(q)
    return PathStarts(kept, nearest)


def _clear_first(ways: list[_Way], clear: Callable[[FloatArray], BoolArray]) -> list[_Way]:
    """Returns ways that touch nothing, then those that touch only after their start; all where every start touches."""
    free = clear(np.concatenate([way.joints for way in ways]))
    parts = np.split(free, np.cumsum([len(way.joints) for way in ways])[:-1])
    rank = [0 if part.all() else 1 if part[0] else 2 for part in parts]
    kept = [k for k in range(len(ways)) if rank[k] < 2] or list(range(len(ways)))
    return [ways[k] for k in sorted(kept, key=lambda k: rank[k])]


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
    return float(limits.law.duration(q - here))


def _easiest(context: PathContext, work: PathWork, here: FloatArray) -> list[_Way]:
    """Returns the ways of least motion along the path at platform angles around."""
    model, limits = context.model, context.limits
    share = np.linspace(0.0, 1.0, STARTS.stations)
    poses = {arm: path.at(share * path.length) for arm, path in work.paths.items()}
    found = []
    for angles in _platforms(context, here):
        q = here.copy()
        q[model.platform_columns] = angles
        ways = []
        for name, (R, p) in poses.items():
            arm = model.arms[name]
            ways.append(_ways(arm, flange_poses(model, arm, q, R, p), limits, here))
        for some in product(*ways):
            joints, cost = np.tile(q, (STARTS.stations, 1)), 0.0
            for name, (own_joints, own) in zip(poses, some, strict=True):
                joints[:, model.arms[name].columns] = own_joints
                cost += own
            found.append(_Way(_time_to(context, here, joints[0]) + STARTS.ease * cost, joints))
    return found


def _ways(
    arm: ArmModel,
    flanges: tuple[FloatArray, FloatArray],
    limits: JointLimits,
    here: FloatArray,
) -> list[tuple[FloatArray, float]]:
    """Select an arm's posture paths of least motion along a path, one per branch.

    Each is the joints (`stations`, 7) [rad] and their cost.
    """
    kinematics = arm.closed_form
    tracks = coarse_tracks(kinematics, *flanges, limits.velocity[arm.columns])
    found = []
    for track in tracks[: STARTS.branches]:
        joints, _ = kinematics.solve_branch(*flanges, track.psi, np.array(track.branch))
        found.append((kinematics.nearest_turns(joints, here[arm.columns]), track.cost))
    return found


def _platforms(context: PathContext, here: FloatArray) -> FloatArray:
    """Returns platform positions around the present one, which is the first, shape (m, k)."""
    model = context.model
    now = here[model.platform_columns]
    if not model.platform.is_chosen:
        return now[None]
    _, low, high = model.platform_around(here)
    return np.concatenate([now, np.linspace(low, high, STARTS.platforms)])[:, None]
