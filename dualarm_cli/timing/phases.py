"""From the phases of single joints to the knots of a trajectory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.timing.composition import SAME_ACCELERATION, merge


@dataclass(frozen=True)
class Phase:
    """A stretch of one joint's motion with constant jerk."""

    duration: float
    """Length [s]."""
    acceleration: float
    """Acceleration at its start [rad/s²]."""
    jerk: float
    """Jerk throughout [rad/s³]."""


def joint_trajectory(joint: str, start: float, goal: float, phases: list[Phase]) -> Trajectory:
    """Returns one joint's motion from rest to rest through its phases.

    The last knot is exactly the goal, at rest: what rounding left over is below 1e-12.

    Args:
        joint: name of the joint.
        start: position at the start [rad].
        goal: position at the end [rad].
        phases: in order; those of no length are passed over.
    """
    rows = [(0.0, start, 0.0, 0.0)]
    for phase in phases:
        if phase.duration <= 0.0:
            continue
        t, q, v, a = rows[-1]
        if phase.acceleration != a:
            # Rounding of ruckig's own sums is no jump; anything else is two knots at one time.
            if abs(phase.acceleration - a) > SAME_ACCELERATION:
                rows.append((t, q, v, phase.acceleration))
            a = phase.acceleration
        d, j = phase.duration, phase.jerk
        rows.append(
            (
                t + d,
                q + d * (v + d * (a / 2 + d * j / 6)),
                v + d * (a + d * j / 2),
                a + d * j,
            )
        )
    table = np.array(rows)
    table[-1, 1:3] = goal, 0.0
    if abs(table[-1, 3]) > SAME_ACCELERATION:
        # Without a jerk limit the brake ends at full strength: the jump to rest is a knot of its own.
        table = np.vstack([table, [[table[-1, 0], goal, 0.0, 0.0]]])
    table[-1, 3] = 0.0
    return Trajectory((joint,), table[:, 0], table[:, 1:2], table[:, 2:3], table[:, 3:4])


def join_joints(joints: tuple[str, ...], parts: list[Trajectory], duration: float) -> Trajectory:
    """Returns single joints' motions as one; all end at `duration` [s]."""
    aligned = [
        Trajectory(
            part.joints,
            _ending_at(part.time, duration),
            part.position,
            part.velocity,
            part.acceleration,
        )
        for part in parts
    ]
    return merge(aligned, joints)


def _ending_at(time: FloatArray, duration: float) -> FloatArray:
    """Returns times whose last (and any equal to it) is exactly the duration, if it is near."""
    moved = np.array(time)
    near = np.abs(moved - moved[-1]) <= 1e-12
    if abs(moved[-1] - duration) <= 1e-9:
        moved[near] = duration
    return moved
