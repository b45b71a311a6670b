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
    """Stop of one arm in a stage."""

    arm: str
    """Name of the arm."""
    task: Task
    """The task it works on."""
    stop: Stop
    """The target."""
    problem: StopProblem
    """Problem of the redundancy solver, for the lines."""
    posture: StopPosture
    """Posture of the stop."""
    tracked: Tracked | None = None
    """Motion at a target on a conveyor; None for other targets, or if not planned yet."""


@dataclass(frozen=True)
class Detour:
    """Detour of an arm's transfer by a via point or a curve."""

    points: FloatArray
    """Via point, shape (1, 7), or control points of a curve, (c, 7) [rad]."""
    stops: bool
    """Flag of a via point at which the arm stops; False for a curve."""
    rates: FloatArray | None = None
    """Velocities and accelerations at start, via point and goal, shape (3, 2, 7).

    None: the transfer begins and ends at rest.
    """


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
    """Stops by arm; idle arms are missing. Empty for a return."""
    solver: str
    """Name of the method that chose the platform angle."""
    duration: float
    """Length of the stage [s]: transfers and dwells in closed form, lines as estimated."""
    waits: Mapping[str, float] = field(default_factory=dict)
    """Delays of transfers that avoid a collision with the other arm [s], by arm."""
    detours: Mapping[str, Detour] = field(default_factory=dict)
    """Detours of transfers that avoid a collision, by arm."""
    passes: Mapping[tuple[str, str], Launch] = field(default_factory=dict)
    """Launches at outer ends of lines, by arm and line (`approach` or `retract`).

    An arm stops at ends without a launch.
    """
    through: Mapping[str, FloatArray] = field(default_factory=dict)
    """Velocities and accelerations at passed targets, shape (2, n), by arm.

    An arm that is missing stops at its target.
    """


def giver_and_taker(stops: Mapping[str, ArmStop]) -> tuple[ArmStop, ArmStop] | None:
    """Return the giving and the taking arm's stop of a hand-over, or None."""
    by_action = {arm_stop.stop.action: arm_stop for arm_stop in stops.values()}
    if "give" not in by_action or "take" not in by_action:
        return None
    return by_action["give"], by_action["take"]


def same_postures(plan_a: Sequence[StagePlan], plan_b: Sequence[StagePlan]) -> bool:
    """Return whether two plans have the same postures in every stage."""
    return len(plan_a) == len(plan_b) and all(
        np.array_equal(a.arrival, b.arrival)
        and np.array_equal(a.end, b.end)
        and all(
            np.array_equal(stop.posture.q_target, b.stops[arm].posture.q_target)
            for arm, stop in a.stops.items()
        )
        for a, b in zip(plan_a, plan_b, strict=True)
    )
