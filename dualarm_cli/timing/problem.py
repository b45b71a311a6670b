"""Problems for timing solvers: transfers between states, and lines along a path."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, readonly
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class TransferProblem:
    """Transfer between two states, with all joints arriving together.

    States are at rest unless rates are given.
    """

    joints: tuple[str, ...]
    """Names of the n joints."""
    start: FloatArray
    """Joint values at the start [rad], shape (n,)."""
    goal: FloatArray
    """Joint values at the end [rad], shape (n,)."""
    limits: JointLimits
    """Limits of the joints."""
    minimum_duration: float = 0.0
    """Minimum duration of the transfer [s]."""
    leaving: FloatArray | None = None
    """Rates at the start [rad/s, rad/s²], shape (2, n); None at rest."""
    arriving: FloatArray | None = None
    """Rates at the end [rad/s, rad/s²], shape (2, n); None at rest."""

    @property
    def moving(self) -> bool:
        """Whether it begins or ends in motion."""
        return self.leaving is not None or self.arriving is not None

    def rates(self) -> tuple[FloatArray, FloatArray]:
        """Return velocities and accelerations at the start and at the end, shape (2, n) each."""
        rest = np.zeros((2, len(self.joints)))
        return (
            rest if self.leaving is None else self.leaving,
            rest if self.arriving is None else self.arriving,
        )

    def __post_init__(self) -> None:
        """Freeze the arrays.

        Raises:
            ValueError: no joints, wrong shapes, or numbers that are not finite.
        """
        n = len(self.joints)
        for name in ("leaving", "arriving"):
            if (rates := getattr(self, name)) is not None:
                object.__setattr__(self, name, readonly(rates))
                if rates.shape != (2, n) or not np.isfinite(rates).all():
                    raise ValueError(f"{name} must be finite and of shape (2, {n}), not {rates}")
        for name in ("start", "goal"):
            values = readonly(getattr(self, name))
            object.__setattr__(self, name, values)
            if n == 0 or values.shape != (n,) or not np.isfinite(values).all():
                raise ValueError(f"{name} must be {n} finite numbers (at least one), not {values}")
        if self.limits.joints != self.joints:
            raise ValueError(f"limits are for {self.limits.joints}, not {self.joints}")
        if not (np.isfinite(self.minimum_duration) and self.minimum_duration >= 0):
            raise ValueError(f"minimum_duration must be 0 or more, not {self.minimum_duration}")


@dataclass(frozen=True)
class LineProblem:
    """Line along a given joint path, from rest to rest."""

    joints: tuple[str, ...]
    """Names of the n joints."""
    position: FloatArray
    """Joint values at equidistant gridpoints [rad], shape (m, n), m at least 8."""
    length: FloatArray
    """Path length at the gridpoints [m], rising from 0, shape (m,)."""
    limits: JointLimits
    """Limits of the joints."""
    tool_speed: float | None = None
    """Limit of the speed along the path [m/s], or None."""
    knots: int = 24
    """Minimum number of knots; more follow the path more closely."""

    def __post_init__(self) -> None:
        """Freeze the arrays.

        Raises:
            ValueError: wrong shapes, too few gridpoints, gridpoints that are not equidistant, or
                numbers that are not finite.
        """
        for name in ("position", "length"):
            object.__setattr__(self, name, readonly(getattr(self, name)))
        m = self.length.size
        if self.position.shape != (m, len(self.joints)) or m < 8:
            raise ValueError(
                f"position has shape {self.position.shape}; needs 8 gridpoints or more"
            )
        if not (np.isfinite(self.position).all() and np.isfinite(self.length).all()):
            raise ValueError("a gridpoint is not finite")
        step = np.diff(self.length)
        if step.min() <= 0 or np.ptp(step) > 1e-9 * self.length[-1]:
            raise ValueError("length must rise from 0 in equal steps")
        if self.limits.joints != self.joints:
            raise ValueError(f"limits are for {self.limits.joints}, not {self.joints}")


def why_jerk_limits_unsupported(limits: JointLimits) -> str | None:
    """Explain why joints with jerk limits need jerk-limited timing; None without them."""
    limited = [
        joint for joint, jerk in zip(limits.joints, limits.jerk, strict=True) if np.isfinite(jerk)
    ]
    if not limited:
        return None
    named = ", ".join(limited[:3]) + ("..." if len(limited) > 3 else "")
    return (
        f"{len(limited)} joints have jerk limits ({named}), which this solver ignores; "
        "use timing ruckig"
    )
