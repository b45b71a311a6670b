"""Durations of careful motions in the search: slowed joints, and tools with a speed limit.

Transfers are straight in joint space. The tool's path is taken as the cubic between both ends that has their tool
velocities; its largest speed gives the factor by which the motion will lower the velocity limits of all joints
(`motion/transfers`). A line is timed by its length, as if its tool had a trapezoidal profile. Both are our own.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray, readonly
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.kinematics.platform_chain import PlatformChain
from dualarm_cli.kinematics.posture_source import PostureSource
from dualarm_cli.kinematics.serial_chain import SerialChain
from dualarm_cli.model.motion.rest_to_rest import RestToRest
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.records import dataclass

CUBIC = ((1.5, -0.25, -0.25), (1.125, 0.1875, -0.3125), (1.125, -0.3125, 0.1875))
"""Weights of chord and end velocities in a cubic's velocity.

At 1/2, 1/4 and 3/4 of its progress.
"""
LEAST_FACTOR = 1e-3
"""Least factor on velocity limits."""
UNLIMITED = 1e9
"""Speed limit that stands for none [m/s]."""


@dataclass(frozen=True)
class Pace:
    """Limits of an arm's transfer to a stop and of its lines there."""

    limits: JointLimits
    """Limits of the arm's joints, then of the platform's joint where it is chosen."""
    cap: float
    """Speed limit of the tool on the transfer [m/s], UNLIMITED for none."""
    line_times: tuple[float, float]
    """Factors on the times of approach and retract that joints need."""
    line_caps: tuple[float, float]
    """Speed limits of the tool on approach and retract [m/s], UNLIMITED for none."""


@dataclass(frozen=True)
class Places:
    """Postures of an arm and its platform, with the tool's place and its derivatives."""

    q: FloatArray
    """Joints of the arm, then of a chosen platform [rad], shape (..., c)."""
    p: FloatArray
    """Tool centre points in the world [m], shape (..., 3)."""
    J: FloatArray
    """Derivatives of these by the joints [m/rad], shape (..., 3, c)."""


@dataclass(frozen=True)
class Slowing:
    """Care of one arm's transfers and lines, by stage.

    The last row of transfers is the return.
    """

    law: RestToRest
    """Timing laws of the transfers: the arm's joints, then the platform's, shape (n + 1, c)."""
    cap: FloatArray
    """Speed limits of the tool on transfers [m/s], shape (n + 1,)."""
    line_times: FloatArray
    """Factors on the times of lines that joints need, shape (n, 2)."""
    line_caps: FloatArray
    """Speed limits of the tool on lines [m/s], shape (n, 2)."""
    length: FloatArray
    """Lengths of lines [m], shape (n, 2)."""
    chain: SerialChain
    """Forward kinematics of the arm."""
    tip: FloatArray
    """Tool centre point in the flange frame [m], shape (3,)."""

    @classmethod
    def of(
        cls, paces: list[Pace], length: FloatArray, arm: PostureSource, tip: FloatArray
    ) -> Slowing:
        """Collect the paces of all stages, and of the return.

        Args:
            paces: by stage, the return's last.
            length: lengths of lines [m], shape (n, 2).
            arm: kinematics of the arm.
            tip: tool centre point in the flange frame [m], shape (3,).
        """
        rates = ("velocity", "acceleration", "jerk")
        laws = (np.array([getattr(pace.limits, rate) for pace in paces]) for rate in rates)
        steps, slides = arm.chain
        chain = SerialChain(
            steps[:-1, :, :3],
            steps[:-1, :, 3],
            steps[-1, :, :3],
            steps[-1, :, 3],
            arm.lower,
            arm.upper,
            tuple(np.flatnonzero(slides).tolist()),
        )
        return cls(
            RestToRest(*laws),
            np.array([pace.cap for pace in paces]),
            np.array([pace.line_times for pace in paces[:-1]]),
            np.array([pace.line_caps for pace in paces[:-1]]),
            length,
            chain,
            readonly(tip),
        )

    def places(self, platform: PlatformChain, q: FloatArray, position: FloatArray) -> Places:
        """Compute tool centre points and their derivatives.

        Args:
            platform: the chain that carries the arm.
            q: joints of the arm [rad], shape (..., joints).
            position: platform joints [rad or m], shape (..., k).
        """
        shape = np.broadcast_shapes(q.shape[:-1], position.shape[:-1])
        position = np.broadcast_to(position, (*shape, position.shape[-1]))
        R, p, J = self.chain.linearised(q.reshape(-1, q.shape[-1]))
        lever = product(R, self.tip)
        turning = np.cross(J[:, 3:], lever[:, :, None], axis=1)
        point = (p + lever).reshape(*q.shape[:-1], 3)
        moved = (J[:, :3] + turning).reshape(*q.shape[:-1], 3, q.shape[-1])
        R_world, p_world = platform.pose(position)
        q = np.broadcast_to(q, (*shape, q.shape[-1]))
        point, moved = (
            np.broadcast_to(x, (*shape, *x.shape[q.ndim - 1 :])) for x in (point, moved)
        )
        J_world = product(R_world, moved)
        if platform.is_chosen:
            up = np.broadcast_to([0.0, 0.0, 1.0], point.shape)
            turned = np.cross(up, point) if platform.is_turntable else up
            J_world = np.concatenate([J_world, product(R_world, turned[..., None])], axis=-1)
            q = np.concatenate([q, position], axis=-1)
        return Places(q, p_world + product(R_world, point[..., None])[..., 0], J_world)

    def joint_law(self, stage: IntArray, joints: int) -> RestToRest:
        """Select the laws of the first joints on the transfers to stages (r,), (r, joints)."""
        rates = (self.law.velocity, self.law.acceleration, self.law.jerk)
        return RestToRest(*(rate[stage, :joints] for rate in rates))

    def transfer_times(
        self, stage: IntArray, places: list[Places]
    ) -> tuple[FloatArray, FloatArray]:
        """Time transfers from rest to rest whose tools keep their speed limits [s], shape (r, ...).

        Args:
            stage: stage of each row, shape (r,); the number of stages for the return.
            places: on the transfers at equal distances, shapes (r, ...) broadcast together.

        Returns:
            Times [s] and factors on velocity limits, 1 where no tool slows.
        """
        moved = places[-1].q - places[0].q
        rows = (len(stage), *(1,) * (moved.ndim - 2), moved.shape[-1])
        rates = (self.law.velocity, self.law.acceleration, self.law.jerk)
        velocity, acceleration, jerk = (rate[stage].reshape(rows) for rate in rates)
        if (self.cap[stage] == UNLIMITED).all():
            plain = RestToRest(velocity, acceleration, jerk).duration(moved)
            return plain, np.ones(plain.shape)
        # The slowest joint's share of its limit is the same at every speed.
        slowest = (np.abs(moved) / velocity).max(axis=-1)
        cap = self.cap[stage].reshape(rows[:-1])
        factor = cap * slowest / np.maximum(fastest(places), 1e-9)
        factor = np.clip(factor, LEAST_FACTOR, 1.0)
        return RestToRest(velocity * factor[..., None], acceleration, jerk).duration(moved), factor

    def slopes(self, stage: IntArray, places: list[Places]) -> FloatArray:
        """Compute slopes of the times of tools at their limits by displacements [s/rad], (r, c)."""
        first, middle, last = places
        velocity = product(middle.J, (last.q - first.q)[..., None])[..., 0]
        along = velocity / np.maximum(norm(velocity, axis=-1, keepdims=True), 1e-9)
        slopes: FloatArray = product(along[:, None], middle.J)[:, 0] / self.cap[stage, None]
        return slopes

    def stretch(self, stage: int, plain: RestToRest) -> float:
        """Compute the ratio of the transfer times of a stage to those of another law."""
        moved = np.full(len(plain.velocity), 0.5)  # a common displacement of joints [rad]
        slow = self.joint_law(np.array([stage]), len(moved))
        return float(slow.duration(moved[None])[0] / plain.duration(moved))

    def lines(self, stage: IntArray, rest: FloatArray) -> FloatArray:
        """Compute the times of approaches and retracts [s], shape (r, 2).

        Args:
            stage: stage of each row, shape (r,).
            rest: times that joints need without care [s], shape (r, 2).
        """
        time = rest * self.line_times[stage]
        length, cap = self.length[stage], self.line_caps[stage]
        is_capped = cap * time < 2.0 * length
        cap, length = np.where(is_capped, cap, 1.0), np.where(is_capped, length, 1.0)
        return np.where(is_capped, length / cap + 0.25 * cap * np.square(time) / length, time)


def fastest(places: Sequence[Places]) -> FloatArray:
    """Compute the largest speed of tools by progress on straight transfers [m], shape (...).

    Args:
        places: on the transfers at equal distances, shapes (...) broadcast together.
    """
    speeds = []
    for start, goal in pairwise(places):
        moved, chord = (goal.q - start.q)[..., None], goal.p - start.p
        leaving, arriving = (product(place.J, moved)[..., 0] for place in (start, goal))
        speeds += [norm(c * chord + a * leaving + b * arriving, axis=-1) for c, a, b in CUBIC]
    return np.asarray((len(places) - 1.0) * np.maximum.reduce(speeds))
