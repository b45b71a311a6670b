"""Motion of an arm at a moving target, as part of a stage plan."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class TrackingPhases:
    """Durations of a stop's phases [s], 0 for a line without length."""

    rise: float
    """Ramp from rest to the belt's velocity [s]."""
    approach: float
    """Approach in the belt's frame [s]."""
    dwell: float
    """Dwell at the part [s]."""
    retract: float
    """Retract in the belt's frame [s]."""
    fall: float
    """Ramp from the belt's velocity to rest [s]."""
    shape: int = 0
    """Number of the lines' shape in LINE_SHAPES."""

    @property
    def edges(self) -> FloatArray:
        """Start and end times of the phases, from 0 [s], shape (6,)."""
        lengths = [self.rise, self.approach, self.dwell, self.retract, self.fall]
        return np.concatenate([[0.0], np.cumsum(lengths)])

    def longer(self, factor: FloatArray) -> TrackingPhases:
        """Stretch the phases by factors (5,), but not the dwell."""
        rise, approach, _, retract, fall = factor
        return TrackingPhases(
            self.rise * rise,
            self.approach * approach,
            self.dwell,
            self.retract * retract,
            self.fall * fall,
            self.shape,
        )


@dataclass(frozen=True)
class Tracked:
    """Motion of one arm at a target on a conveyor, from rest to rest."""

    motion: Trajectory
    """Motion of the arm's joints."""
    phases: TrackingPhases
    """Phases of the motion."""

    @property
    def reached(self) -> float:
        """Time at which the dwell begins, from the motion's start [s]."""
        return self.phases.rise + self.phases.approach

    @property
    def left(self) -> float:
        """Time at which the dwell ends, from the motion's start [s]."""
        return self.reached + self.phases.dwell

    @property
    def q_target(self) -> FloatArray:
        """Joints at the start of the dwell [rad], shape (n,)."""
        return self.motion.clamped(np.array([self.reached]))[0][0]
