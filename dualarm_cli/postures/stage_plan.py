"""Stage plan: decided start, arrival and end of one stage, with waits and detours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.job import Stop, Task
from dualarm_cli.postures import StopPosture, StopProblem
from dualarm_cli.postures.tracked import Tracked
from dualarm_cli.records import dataclass
from dualarm_cli.timing.launch import Launch


@dataclass(frozen=True)
class ArmStop:
    """What one arm does in a stage."""

    arm: str
    """Name of the arm."""
    task: Task
    """The task it works on."""
    stop: Stop
    """The target."""
    problem: StopProblem
    """The stop as the redundancy solver saw it, for the lines."""
    posture: StopPosture
    """How the stop is made."""
    tracked: Tracked | None = None
    """Its whole motion where the target moves with a conveyor; None where it stands, or is not met yet."""


@dataclass(frozen=True)
class Detour:
    """What bends an arm's transfer: a via point that it stops at, or control points of one curve."""

    points: FloatArray
    """The arm's joints there [rad], shape (1, 7) for a via point, (c, 7) for control points."""
    stops: bool
    """Whether the arm stops at the via point; on a curve it does not."""
    rates: FloatArray | None = None
    """Velocities and accelerations at the transfer's start, the via point and the goal, shape (3, 2, 7); None: the
    transfer begins and ends at rest."""


@dataclass(frozen=True)
class StagePlan:
    """Everything decided about one stage; times follow from it."""

    start: FloatArray
    """All joints before [rad], shape (n,)."""
    arrival: FloatArray
    """All joints after the transfer [rad], shape (n,)."""
    end: FloatArray
    """All joints after the retracts [rad], shape (n,)."""
    stops: Mapping[str, ArmStop]
    """By arm; an arm without a partner's work in this stage is missing. Empty for a return."""
    solver: str
    """The method that gave the platform angle."""
    duration: float
    """Length of the stage [s]: transfers and dwells in closed form, lines as estimated."""
    waits: Mapping[str, float] = field(default_factory=dict)
    """How long an arm waits before it leaves [s], for the other one to get out of its way; by arm."""
    detours: Mapping[str, Detour] = field(default_factory=dict)
    """What an arm passes by on its transfer, to be clear of the cell or the other arm; by arm."""
    passes: Mapping[tuple[str, str], Launch] = field(default_factory=dict)
    """How an arm passes the outer end of a line in motion, by arm and line (`approach` or `retract`); at rest where
    there is nothing."""
    through: Mapping[str, FloatArray] = field(default_factory=dict)
    """Velocities and accelerations with which an arm passes its target, shape (2, n), by arm; it stops where there is
    nothing."""


def giver_and_taker(stops: Mapping[str, ArmStop]) -> tuple[ArmStop, ArmStop] | None:
    """Returns the giving and the taking arm's stop of a hand-over, None where a stage's stops are none."""
    by_action = {one.stop.action: one for one in stops.values()}
    if "give" not in by_action or "take" not in by_action:
        return None
    return by_action["give"], by_action["take"]


def same_postures(one: Sequence[StagePlan], other: Sequence[StagePlan]) -> bool:
    """Returns whether two plans take the same postures in all stages."""
    return len(one) == len(other) and all(
        np.array_equal(a.arrival, b.arrival)
        and np.array_equal(a.end, b.end)
        and all(
            np.array_equal(stop.posture.q_target, b.stops[arm].posture.q_target)
            for arm, stop in a.stops.items()
        )
        for a, b in zip(one, other, strict=True)
    )
