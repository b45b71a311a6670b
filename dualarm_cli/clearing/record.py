"""Motions of a job that is planned section by section, one after the other, with stages, segments and events."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from dualarm_cli.clearing.clear_plan import ClearedPlan, clearance_notes
from dualarm_cli.model.schedule import Event, Segment, Stage
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.motion.motion import Motion
from dualarm_cli.postures.stage_plan import StagePlan


@dataclass
class Record:
    """What is planned so far."""

    pieces: list[Trajectory] = field(default_factory=list)
    """Motions, one after the other."""
    stages: list[Stage] = field(default_factory=list)
    """In time order."""
    segments: list[Segment] = field(default_factory=list)
    """In time order for each arm."""
    events: list[Event] = field(default_factory=list)
    """In time order."""
    notes: list[str] = field(default_factory=list)
    """What a reader should know."""
    stage_plans: list[StagePlan] = field(default_factory=list)
    """The stages of stops."""
    clock: float = 0.0
    """Length of all motions [s]."""
    cost: float = 0.0
    """How much longer they are than without clearance, paths not counted [s]."""

    def add(self, motion: Motion) -> None:
        """Appends a motion as it is."""
        t = self.clock
        self.pieces.append(motion.trajectory)
        self.stages += [replace(s, start=s.start + t, end=s.end + t) for s in motion.stages]
        self.segments += [replace(s, start=s.start + t, end=s.end + t) for s in motion.segments]
        self.events += [replace(e, time=e.time + t) for e in motion.events]
        self.clock += motion.trajectory.duration

    def count(self, found: ClearedPlan) -> None:
        """Notes what keeping the motion that was added last clear costs, and what a reader should know of it."""
        first = len(self.stages) - len(found.cleared.plans) + 1
        self.cost += found.cost or 0.0
        self.notes += [*found.decided.notes, *clearance_notes(found, first)]
