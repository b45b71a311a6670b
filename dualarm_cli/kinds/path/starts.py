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
from dualarm_cli.model.process_work import PathWork
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class StartSettings:
    """Settings of the search for a path's start."""

    platforms: int = 24
    """Number of platform angles at which starts are sought."""
    stations: int = 31
    """Number of places along the path at which posture paths are compared."""
    branches: int = 3
    """Branches of each arm at a platform angle, those of least motion."""
    seeds: int = 24
    """Number of random configurations from which starts are sought."""
    most: int = 120
    """Maximum number of posture paths that are tested for collisions, the cheapest first."""
    alike: float = 1e-3
    """Largest joint difference at which two starts count as the same [rad]."""
    ease: float = 0.2
    """Weight of a posture path's cost against the time to its start [s/s²]."""


STARTS = StartSettings()


@dataclass(frozen=True)
class PathStarts:
    """Start candidates of a path."""

    configurations: list[FloatArray]
    """Start configurations [rad], each of shape (n,), best first."""
    nearest: Reached
    """Posture with the tools nearest to the path's start, of the numerical search."""


@dataclass(frozen=True)
class _PosturePath:
    """Joints along the path, or at its start alone."""

    cost: float
    """Time of the transfer to its start plus the penalty on joint motion [s]."""
    joints: FloatArray
    """Joints at stations, from the start [rad], shape (k, n)."""


def path_starts(
    context: PathContext,
    work: PathWork,
    current: FloatArray,
    seed: int,
    is_free: Callable[[FloatArray], BoolArray] | None = None,
) -> PathStarts:
    """Find configurations from which a path may be followed [rad], (n,), best first.

    If the file names a posture, only the start near it is tried. Otherwise starts near the current joints and near home
    are. Closed-form arms add the starts of posture paths of least motion at many platform angles, others random seeds.

    Args:
        context: the job.
        work: the path.
        current: joints before the path [rad], shape (n,).
        seed: of the random configurations.
        is_free: test of configurations (k, n) [rad] for clearance, shape (k,); None without collision checking.
    """
    robot = context.job.cell.robot
    if work.posture is not None:
        seeds = [np.array(robot.postures[work.posture])]
    else:
        seeds = [current, np.array(robot.postures["home"])]
    easiest = (
        _least_motion_paths(context, work, current)
        if work.posture is None and context.model.has_arm_angles
        else []
    )
    reached = [_nearest_start(context, work, q, current) for q in seeds]
    if work.posture is None and not easiest:
        random, limits = np.random.default_rng(seed), context.limits
        drawn = (random.uniform(limits.lower, limits.upper) for _ in range(STARTS.seeds))
        reached += [_nearest_start(context, work, q, current) for q in drawn]
    nearest = min(reached, key=lambda candidate: candidate.distance + candidate.angle)
    posture_paths = [
        _PosturePath(_transfer_time(context, current, candidate.q), candidate.q[None])
        for candidate in reached
        if candidate.exact
    ]
    posture_paths = sorted([*posture_paths, *easiest], key=lambda candidate: candidate.cost)
    if is_free is not None and posture_paths:
        posture_paths = _clear_first(posture_paths[: STARTS.most], is_free)
    starts: list[FloatArray] = []
    for q in (posture_path.joints[0] for posture_path in posture_paths):
        if all(np.abs(q - start).max() > STARTS.alike for start in starts):
            starts.append(q)
    return PathStarts(starts, nearest)


def _clear_first(
    posture_paths: list[_PosturePath], is_free: Callable[[FloatArray], BoolArray]
) -> list[_PosturePath]:
    """Sort posture paths: clear ones, then those with a clear start.

    All of them if no start is clear.
    """
    free = is_free(np.concatenate([posture_path.joints for posture_path in posture_paths]))
    parts = np.split(
        free, np.cumsum([len(posture_path.joints) for posture_path in posture_paths])[:-1]
    )
    rank = [0 if part.all() else 1 if part[0] else 2 for part in parts]
    selected = [k for k in range(len(posture_paths)) if rank[k] < 2] or list(
        range(len(posture_paths))
    )
    return [posture_paths[k] for k in sorted(selected, key=lambda k: rank[k])]


def _nearest_start(
    context: PathContext, work: PathWork, q: FloatArray, current: FloatArray
) -> Reached:
    """Find the start nearest to a configuration.

    Arms without a path stay where they are.
    """
    body = context.body
    follows = np.array([arm in work.paths for arm in body.arms])
    free = body.moves[follows].any(axis=0)
    poses = [work.paths[arm].at(np.zeros(1)) for arm in body.arms if arm in work.paths]
    R, p = np.concatenate([R for R, _ in poses]), np.concatenate([p for _, p in poses])
    return reach(body, context.limits, np.where(free, q, current), follows, R, p)


def _transfer_time(context: PathContext, current: FloatArray, q: FloatArray) -> float:
    limits = context.limits
    return float(limits.law.duration(q - current))


def _least_motion_paths(
    context: PathContext, work: PathWork, current: FloatArray
) -> list[_PosturePath]:
    """Compute the posture paths of least motion at platform positions."""
    model, limits = context.model, context.limits
    share = np.linspace(0.0, 1.0, STARTS.stations)
    poses = {arm: path.at(share * path.length) for arm, path in work.paths.items()}
    posture_paths = []
    for angles in _platform_positions(context, current):
        q = current.copy()
        q[model.platform_columns] = angles
        options = []
        for name, (R, p) in poses.items():
            arm = model.arms[name]
            options.append(
                _arm_posture_paths(arm, flange_poses(model, arm, q, R, p), limits, current)
            )
        for combination in product(*options):
            joints, cost = np.tile(q, (STARTS.stations, 1)), 0.0
            for name, (arm_joints, arm_cost) in zip(poses, combination, strict=True):
                joints[:, model.arms[name].columns] = arm_joints
                cost += arm_cost
            posture_paths.append(
                _PosturePath(
                    _transfer_time(context, current, joints[0]) + STARTS.ease * cost, joints
                )
            )
    return posture_paths


def _arm_posture_paths(
    arm: ArmModel,
    flanges: tuple[FloatArray, FloatArray],
    limits: JointLimits,
    current: FloatArray,
) -> list[tuple[FloatArray, float]]:
    """Select an arm's posture paths of least motion along a path, one per branch.

    Each has joints (`stations`, 7) [rad] and a cost.
    """
    kinematics = arm.closed_form
    tracks = coarse_tracks(kinematics, *flanges, limits.velocity[arm.columns])
    posture_paths = []
    for track in tracks[: STARTS.branches]:
        joints, _ = kinematics.solve_branch(*flanges, track.psi, np.array(track.branch))
        posture_paths.append((kinematics.nearest_turns(joints, current[arm.columns]), track.cost))
    return posture_paths


def _platform_positions(context: PathContext, joints: FloatArray) -> FloatArray:
    """Sample platform positions around the current one, which is the first, shape (m, k)."""
    model = context.model
    current = joints[model.platform_columns]
    if not model.platform.is_chosen:
        return current[None]
    _, low, high = model.platform_around(joints)
    return np.concatenate([current, np.linspace(low, high, STARTS.platforms)])[:, None]
