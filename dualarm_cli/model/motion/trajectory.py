"""Trajectory: knots between which every joint's jerk is constant."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from dualarm_cli.errors import UsageError
from dualarm_cli.geometry.arrays import FloatArray, frozen, readonly
from dualarm_cli.records import dataclass

SAME_TIME = 1e-9
"""Largest difference of equal times [s], for plans, reports and checks."""


@dataclass(frozen=True)
class Trajectory:
    """Joint motion q(t) with constant jerk between knots.

    Two knots at one time are a jump of acceleration (a joint without a jerk limit). The constructor only checks shapes:
    a trajectory from a user's file may violate limits, which the verifier reports.
    """

    joints: tuple[str, ...]
    """Names of the n joints, in column order."""
    time: FloatArray
    """Knot times [s], shape (k,)."""
    position: FloatArray
    """Joint positions at the knots [rad], shape (k, n)."""
    velocity: FloatArray
    """Joint velocities at the knots [rad/s], shape (k, n)."""
    acceleration: FloatArray
    """Joint accelerations at the knots [rad/s²], shape (k, n)."""

    def __post_init__(self) -> None:
        """Freeze the arrays.

        Raises:
            ValueError: there is no knot, or the shapes do not fit together.
        """
        for name in ("time", "position", "velocity", "acceleration"):
            object.__setattr__(self, name, readonly(getattr(self, name)))
        shape = (self.time.size, len(self.joints))
        if self.time.ndim != 1 or self.time.size == 0:
            raise ValueError(f"time must be a list of at least one knot, not {self.time.shape}")
        for name in ("position", "velocity", "acceleration"):
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name} has shape {getattr(self, name).shape}, not {shape}")

    @property
    def duration(self) -> float:
        """Time from the first knot to the last [s]."""
        return float(self.time[-1] - self.time[0])

    @cached_property
    def jerk(self) -> FloatArray:
        """Jerk of each interval [rad/s³], shape (k-1, n); zero for intervals without length."""
        step = np.diff(self.time)[:, None]
        change = np.diff(self.acceleration, axis=0)
        jerk = np.divide(change, step, out=change, where=step > 0)
        jerk[~(step[:, 0] > 0)] = 0.0
        return frozen(jerk)

    def at(self, time: FloatArray | float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Evaluate position, velocity, acceleration, each (m, n), or (n,) at a single time.

        At a double knot the later one is used.

        Args:
            time: instants from the first knot to the last [s], shape (m,), or one.

        Raises:
            UsageError: instants outside the motion by more than rounding, or no numbers.
        """
        instants = np.asarray(time)
        first, last = self.time[[0, -1]]
        if instants.dtype.kind not in "iuf":
            raise UsageError(f"time of type {instants.dtype}: must be numbers [s]")
        inside = (instants >= first - SAME_TIME) & (instants <= last + SAME_TIME)
        if not inside.all():
            wrong = instants[~inside].flat[0]
            raise UsageError(f"time {wrong:g} s: must be from {first:.10g} to {last:.10g} s")
        return self.clamped(instants)

    def clamped(self, time: FloatArray | float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Evaluate the motion like `at`; it stands before its first knot and after its last.

        Velocities and accelerations outside are those at the ends.
        """
        time = np.clip(np.asarray(time, dtype=np.float64), self.time[0], self.time[-1])
        index = np.searchsorted(self.time, time, side="right") - 1
        dt = np.asarray(time - self.time[index])[..., None]
        q, v, a = self.position[index], self.velocity[index], self.acceleration[index]
        # At the last knot no time passes, so that the jerk before it may stand for the one after it.
        jerk = (
            self.jerk[np.minimum(index, max(self.time.size - 2, 0))] if self.time.size > 1 else 0.0
        )
        return (
            q + dt * (v + dt * (a / 2 + dt * jerk / 6)),
            v + dt * (a + dt * jerk / 2),
            a + dt * jerk,
        )

    def select(self, joints: Sequence[str]) -> Trajectory:
        """Select the motion of some joints, in the order given."""
        index = [self.joints.index(joint) for joint in joints]
        return Trajectory(
            tuple(joints),
            self.time,
            self.position[:, index],
            self.velocity[:, index],
            self.acceleration[:, index],
        )
