"""A seam as it is planned: the tool's way to it, its work, and the way from it."""

from __future__ import annotations

from dataclasses import dataclass

from dualarm_cli.closed_chain.chain import Chain
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.planning.seam_motion import TimedSeam


@dataclass(frozen=True)
class PlannedSeam:
    """A seam with the tool's way to it and from it."""

    approach: Trajectory | None
    """To where it begins; None for no length."""
    dwell_start: Trajectory
    """Standing where it begins."""
    seam: TimedSeam
    """The seam."""
    dwell_end: Trajectory
    """Standing where it ends."""
    retract: Trajectory | None
    """Away from it; None for no length."""
    solver: str
    """Name of the seam solver."""
    chain: Chain
    """Part and tool."""

    @property
    def coming(self) -> float:
        """How long the tool's approach and its dwell before the seam take [s]."""
        return self.dwell_start.duration + (self.approach.duration if self.approach else 0.0)

    @property
    def first(self) -> FloatArray:
        """All joints where the tool's approach begins [rad], shape (n,)."""
        start: FloatArray = (self.approach or self.seam.trajectory).position[0]
        return start


def quicker(one: PlannedSeam | str, other: PlannedSeam | str) -> PlannedSeam | str:
    """Returns the quicker of two answers; a plan before any reason, the later reason before the earlier one."""
    if isinstance(other, str):
        return other if isinstance(one, str) else one
    if isinstance(one, str):
        return other
    return min(one, other, key=lambda plan: plan.seam.trajectory.duration)
