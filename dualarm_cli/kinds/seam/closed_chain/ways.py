"""Costs of joint paths along a seam: time, and distance from limits and singular postures."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import TURN, power
from dualarm_cli.geometry.linear_systems import singular_values
from dualarm_cli.kinds.seam.closed_chain.problem import SeamProblem
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.records import dataclass


def steady_times(position: FloatArray, limits: JointLimits) -> FloatArray:
    """Returns the least times for whole seams at a steady speed, from velocity, acceleration and jerk, (..., 3) [s].

    A seam of time T has the rates q' / T, q'' / T², q''' / T³, primes by the share.

    Args:
        position: joints at equidistant nodes [rad], shape (..., k, n), k at least 4.
        limits: of the n joints.
    """
    step = 1.0 / (position.shape[-2] - 1)
    found = []
    for order, limit in enumerate((limits.velocity, limits.acceleration, limits.jerk), start=1):
        rates = np.abs(np.diff(position, order, axis=-2)) / power(step, order) / limit
        found.append(power(rates.max(axis=(-2, -1)), 1.0 / order))
    return np.stack(found, axis=-1)


def steady_time(position: FloatArray, limits: JointLimits) -> float:
    """Returns the largest of them for one seam [s]."""
    return float(steady_times(position, limits).max())


@dataclass(frozen=True)
class WaySettings:
    """Numbers that choose between branches of a seam."""

    crowded: float = 0.15
    """Penalty of a joint at its limit, as a share of the time."""
    long: float = 10.0
    """Time beyond which limits and singular postures count no more [s]: the way to where the seam begins counts too."""
    arm: float = 0.5
    """Length by which singular values count metres [m]: about an arm's."""
    room: float = 0.25
    """Distance from limits, as a share of a joint's range, beyond which more is no better."""
    regular: float = 0.15
    """Least singular value above which more is no better."""
    singular: float = 0.5
    """Cost of a singular posture, as a share of the time."""
    ample: float = 0.93
    """Share of the required time at which a seam is fast enough; motion between nodes takes a little more."""


WAYS = WaySettings()


def turned_back(problem: SeamProblem, ways: FloatArray) -> FloatArray:
    """Returns the ways, joints of several turns as near to the middle of their ranges as whole turns bring them."""
    limits = problem.limits
    several = problem.chain.closes & (limits.upper - limits.lower > TURN)
    middle = np.where(several, (limits.upper + limits.lower) / 2.0, 0.0)
    center = (ways.max(axis=1) + ways.min(axis=1)) / 2.0
    turns = np.where(several, np.round((center - middle) / TURN), 0.0)
    return ways - TURN * turns[:, None]


def way_cost(problem: SeamProblem, way: FloatArray) -> float:
    """Returns by what ways along a seam (nodes, n) are compared [s]: their time, and that to get to where they begin.

    Of ways that are as fast as asked the one is better whose joints stay farther from limits and singular postures.
    """
    limits = problem.limits
    room = np.minimum(way - limits.lower, limits.upper - way) / (limits.upper - limits.lower)
    crowded = 1.0 - min(max(float(room[:, problem.chain.closes].min()) / WAYS.room, 0.0), 1.0)
    time = max(steady_time(way, limits), WAYS.ample * problem.time)
    singular = 1.0 - min(least_singular_value(problem, way) / WAYS.regular, 1.0)
    coming = 0.0 if problem.coming is None else float(problem.coming(way[:1])[0])
    near = (WAYS.crowded * crowded + WAYS.singular * singular) * min(time, WAYS.long)
    return time + near + coming


def least_singular_value(problem: SeamProblem, way: FloatArray) -> float:
    """Compute the least singular value of the working arms' Jacobians along a seam.

    Lengths count in units of `WAYS.arm`.
    """
    chain = problem.chain
    bodies = chain.bodies(way)
    scale = np.array([1.0 / WAYS.arm] * 3 + [1.0] * 3)[:, None]
    values = []
    for J, joints in ((bodies.J_tool, chain.slave_joints), (bodies.J_part, chain.master_joints)):
        if joints.any():
            values.append(singular_values(scale * J[:, :, joints]).min())
    return float(min(values))
