"""Costs of posture paths along a seam: time, distance from limits and singularities."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import TURN, power
from dualarm_cli.geometry.linear_systems import singular_values
from dualarm_cli.kinds.seam.closed_chain.problem import SeamProblem
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.records import dataclass


def steady_times(position: FloatArray, limits: JointLimits) -> FloatArray:
    """Compute the least steady-speed durations of seams by limit [s], shape (..., 3).

    The limits are those of velocity, acceleration and jerk.

    A seam of time T has the rates q' / T, q'' / T², q''' / T³, with derivatives by the fraction of the seam.

    Args:
        position: joints at equidistant nodes [rad], shape (..., k, n), k at least 4.
        limits: of the n joints.
    """
    step = 1.0 / (position.shape[-2] - 1)
    times = []
    for order, limit in enumerate((limits.velocity, limits.acceleration, limits.jerk), start=1):
        rates = np.abs(np.diff(position, order, axis=-2)) / power(step, order) / limit
        times.append(power(rates.max(axis=(-2, -1)), 1.0 / order))
    return np.stack(times, axis=-1)


def steady_time(position: FloatArray, limits: JointLimits) -> float:
    """Compute the least duration of one seam at a steady speed [s]."""
    return float(steady_times(position, limits).max())


@dataclass(frozen=True)
class PosturePathSettings:
    """Settings of the costs of posture paths."""

    crowded: float = 0.15
    """Penalty of a joint at its limit [fraction of the time]."""
    long: float = 10.0
    """Time beyond which limits and singular postures add no cost [s].

    The transfer to the seam counts too.
    """
    arm: float = 0.5
    """Unit of length of singular values [m]: about an arm's."""
    room: float = 0.25
    """Margin to limits beyond which more is no better [fraction of a joint's range]."""
    regular: float = 0.15
    """Least singular value above which more is no better."""
    singular: float = 0.5
    """Penalty of a singular posture [fraction of the time]."""
    ample: float = 0.93
    """Fraction of the required time at which a seam is fast enough.

    Motion between nodes takes a little more.
    """


POSTURE_PATHS = PosturePathSettings()


def nearest_turns(problem: SeamProblem, paths: FloatArray) -> FloatArray:
    """Shift joints of several turns by whole turns to the middle of their ranges."""
    limits = problem.limits
    several = problem.chain.closes & (limits.upper - limits.lower > TURN)
    middle = np.where(several, (limits.upper + limits.lower) / 2.0, 0.0)
    center = (paths.max(axis=1) + paths.min(axis=1)) / 2.0
    turns = np.where(several, np.round((center - middle) / TURN), 0.0)
    return paths - TURN * turns[:, None]


def path_cost(problem: SeamProblem, path: FloatArray) -> float:
    """Compute the cost of a posture path (nodes, n) [s].

    It is the time of the path and of the transfer to it.

    Among paths that are fast enough, larger distances from limits and singular postures are cheaper.
    """
    limits = problem.limits
    room = np.minimum(path - limits.lower, limits.upper - path) / (limits.upper - limits.lower)
    crowded = 1.0 - min(
        max(float(room[:, problem.chain.closes].min()) / POSTURE_PATHS.room, 0.0), 1.0
    )
    time = max(steady_time(path, limits), POSTURE_PATHS.ample * problem.time)
    singular = 1.0 - min(least_singular_value(problem, path) / POSTURE_PATHS.regular, 1.0)
    transfer = 0.0 if problem.transfer_times is None else float(problem.transfer_times(path[:1])[0])
    penalty = (POSTURE_PATHS.crowded * crowded + POSTURE_PATHS.singular * singular) * min(
        time, POSTURE_PATHS.long
    )
    return time + penalty + transfer


def least_singular_value(problem: SeamProblem, path: FloatArray) -> float:
    """Compute the least singular value of the working arms' Jacobians along a seam.

    The unit of length is `POSTURE_PATHS.arm`.
    """
    chain = problem.chain
    bodies = chain.bodies(path)
    scale = np.array([1.0 / POSTURE_PATHS.arm] * 3 + [1.0] * 3)[:, None]
    values = []
    for J, joints in ((bodies.J_tool, chain.slave_joints), (bodies.J_part, chain.master_joints)):
        if joints.any():
            values.append(singular_values(scale * J[:, :, joints]).min())
    return float(min(values))
