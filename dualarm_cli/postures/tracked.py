"""The motion of an arm at a target that moves: what a stage plan holds of it."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class TrackingPhases:
    """How long each part of the stop takes [s]; a line of no length takes none."""

    rise: float
    """From rest to the belt's velocity."""
    approach: float
    """Down to the part, in the belt's frame."""
    dwell: float
    """At the part."""
    retract: float
    """Up again."""
    fall: float
    """From the belt's velocity to rest."""
    shape: int = 0
    """Which of LINE_SHAPES the lines have."""

    @property
    def edges(self) -> FloatArray:
        """Where the phases begin and end, from 0 [s], shape (6,)."""
        lengths = [self.rise, self.approach, self.dwell, self.retract, self.fall]
        return np.concatenate([[0.0], np.cumsum(lengths)])

    def longer(self, factor: FloatArray) -> TrackingPhases:
        """Returns the phases with each made longer by its factor (5,); the dwell stays as it is."""
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
    """The motion of one arm at a target on a conveyor, from rest to rest."""

    motion: Trajectory
    """The arm's joints."""
    phases: TrackingPhases
    """Its parts; the tool is at the part where the dwell begins."""

    @property
    def reached(self) -> float:
        """When the tool is at the part, from the motion's start [s]."""
        return self.phases.rise + self.phases.approach

    @property
    def left(self) -> float:
        """When the dwell is over, from the motion's start [s]."""
        return self.reached + self.phases.dwell

    @property
    def q_target(self) -> FloatArray:
        """Joints where the tool reaches the part [rad], shape (n,)."""
        return self.motion.at(np.array([self.reached]))[0][0]
