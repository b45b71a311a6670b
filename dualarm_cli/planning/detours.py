"""Other ways for one arm's transfer: curves by a posture aside, and postures where it waits for the other arm."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from dualarm_cli.collision.clearance import CellClearance
from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.planning.motion import detour_pieces, passing_curve
from dualarm_cli.planning.stage_plan import Detour, StagePlan
from dualarm_cli.planning.stage_samples import (
    KEPT,
    STEP,
    ArmWay,
    StageSamples,
    apart,
    combined,
)
from dualarm_cli.timing import TimingSolver

SPREADS = (0.2, 0.4, 0.7, 1.1)
"""Standard deviations of random postures about the way [rad]."""
DRAWN = 120
"""Random postures of each spread."""
LOOKED_AT = 21
"""Points of each curve that are looked at first."""
TIMED = 10
"""So many curves, shortest first, are timed."""
WAITED = 12
"""So many postures to wait at, nearest first, are timed."""
SHARES = (0.0, 0.5, 1.0)
"""Shares of the way to the posture after which the other arm leaves."""
PAUSE = 25
"""Pauses are found to so many instants."""


@dataclass(frozen=True)
class StageContext:
    """One stage and all that its ways are measured by."""

    model: CellModel
    """The job's cell."""
    job: Job
    """What is to be done."""
    cell: CellClearance
    """Hulls and pairs."""
    plan: StagePlan
    """The stage."""
    samples: StageSamples
    """Its motion."""
    ways: dict[str, ArmWay]
    """What each arm does in it."""
    timing: TimingSolver
    """How transfers and curves are timed."""
    seed: int
    """Of what is tried at random."""

    def way_by(self, name: str, detour: Detour) -> ArmWay:
        """Returns an arm's way by a posture."""
        limits = self.job.cell.robot.limits.scaled(self.job.speed)
        columns = {arm: self.model.arms[arm].columns for arm in self.model.arms}
        plan = replace(self.plan, detours={name: detour})
        pieces = detour_pieces(
            self.model, plan, name, columns, limits, self.timing, self.job.tool_speed
        )
        base = self.ways[name]
        rows = [piece.at(np.arange(0.0, piece.duration, STEP))[0] for piece in pieces]
        out = np.concatenate([base.q[:1], *rows])
        # A line begins when the platform is there as well.
        wait = max(0, self._platform_arrival() - len(out))
        rest = base.q[base.arrival :]
        q = np.concatenate([out, np.repeat(rest[:1], wait, axis=0), rest])
        held = np.concatenate([np.full(len(out) + wait, base.held[0]), base.held[base.arrival :]])
        return ArmWay(q, held, len(out) + wait)

    def _platform_arrival(self) -> int:
        turned = self.samples.position[:, self.model.platform_columns]
        moves = np.flatnonzero((turned[1:] != turned[:-1]).any(axis=1))
        return int(moves[-1]) + 1 if len(moves) else 0


def quickest_curve(
    context: StageContext, name: str, clear: Callable[[StageSamples], bool], with_other: bool
) -> StagePlan | None:
    """Returns the stage with the quickest of some curves of one arm that keep clear, None for none.

    Curves pass by postures drawn at random about the straight way; those whose points look clear beside what the
    platform and the other arm do meanwhile are timed, shortest first.

    Args:
        context: the stage.
        name: the arm.
        clear: whether a stage with another way of the arm keeps clear.
        with_other: whether the other arm counts when curves are looked at first.
    """
    if context.job.tool_speed is not None:
        return None
    start, goal, posture = _drawn(context, name)
    limits = context.job.cell.robot.limits.select(context.model.arms[name].arm.joints)
    curves = passing_curve(start, posture, goal, LOOKED_AT)
    inside = ((curves >= limits.lower) & (curves <= limits.upper)).all(axis=(1, 2))
    curves, posture = curves[inside], posture[inside]
    length = (np.abs(np.diff(curves, axis=1)) / limits.velocity).sum(axis=1).max(axis=1)
    order = np.argsort(length, kind="stable")
    best, least = None, np.inf
    promising = _looking_clear(context, name, curves, order, with_other)
    for k in islice(promising, TIMED):
        detour = Detour(posture[k], None)
        way = context.way_by(name, detour)
        stage = combined(context.model, context.samples, {**context.ways, name: way}, {})
        if len(stage.position) < least and clear(stage):
            least = len(stage.position)
            best = replace(context.plan, detours={**context.plan.detours, name: detour})
    return best


def quickest_stopover(context: StageContext, name: str) -> StagePlan | None:
    """Returns the stage in which an arm waits aside while the other one passes, None where nothing tried keeps clear.

    The arm goes to a posture that is free while the other one does what it does; the other one leaves meanwhile; then
    the arm goes on. Of postures, shares and pauses the shortest stage is taken.

    Args:
        context: the stage.
        name: the arm that makes way.
    """
    [other] = [key for key in context.model.arms if key != name]
    cell, passing = context.cell, context.ways[other].end
    best, least = None, np.iinfo(np.int64).max
    for posture in _asides(context, name):
        there = context.way_by(name, Detour(posture, 0.0))
        turn = int(np.argmin(np.abs(there.q - posture).max(axis=1)))

        def stage(pause: int, delay: int, there: ArmWay = there, turn: int = turn) -> StageSamples:
            q = np.concatenate(
                [there.q[:turn], np.repeat(there.q[turn : turn + 1], pause, 0), there.q[turn:]]
            )
            held = np.concatenate(
                [
                    there.held[:turn],
                    np.repeat(there.held[turn : turn + 1], pause),
                    there.held[turn:],
                ]
            )
            ways = {**context.ways, name: ArmWay(q, held, there.arrival + pause)}
            return combined(context.model, context.samples, ways, {other: delay})

        for share in SHARES:
            delay = round(share * turn)
            longest = PAUSE * (1 + (passing + delay) // PAUSE)
            if len(stage(0, delay).position) >= least or not apart(cell, stage(longest, delay)):
                continue
            low, high = 0, longest
            while high - low > PAUSE:
                middle = (low + high) // 2
                if apart(cell, stage(middle, delay)):
                    high = middle
                else:
                    low = middle
            length = len(stage(high, delay).position)
            if length < least:
                least = length
                waits = {other: delay * STEP} if delay else {}
                best = replace(
                    context.plan, waits=waits, detours={name: Detour(posture, high * STEP)}
                )
    return best


def _drawn(context: StageContext, name: str) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns where an arm's transfer begins and ends, and random postures (n, 7) about the way between."""
    arm = context.model.arms[name]
    start, goal = context.plan.start[arm.columns], context.plan.arrival[arm.columns]
    random = np.random.default_rng(context.seed)
    share = random.uniform(0.25, 0.75, (len(SPREADS) * DRAWN, 1))
    spread = np.repeat(SPREADS, DRAWN)[:, None]
    posture = start + share * (goal - start) + random.normal(size=(len(share), 7)) * spread
    return start, goal, posture


def _looking_clear(
    context: StageContext, name: str, curves: FloatArray, order: np.ndarray, with_other: bool
) -> Iterator[int]:
    """Yields numbers of curves (c, points, 7) in an order whose points keep clear of what they meet about then."""
    way = context.ways[name]
    times = np.linspace(0, way.arrival, curves.shape[1]).round().astype(int)
    a = context.cell.arms.index(name)
    for first in range(0, len(order), TIMED * 4):
        some = order[first : first + TIMED * 4]
        rows = np.tile(context.samples.position[times], (len(some), 1))
        rows[:, context.model.arms[name].columns] = curves[some].reshape(-1, 7)
        held = np.tile(context.samples.held[times], (len(some), 1))
        free: BoolArray = context.cell.own_margins(a, rows, held[:, a]) >= KEPT
        if with_other:
            left = np.flatnonzero(free)
            free[left] = context.cell.cross_margins(rows[left], held[left]) >= KEPT
        yield from some[free.reshape(len(some), -1).all(axis=1)].tolist()


def _asides(context: StageContext, name: str) -> list[FloatArray]:
    """Returns postures of one arm that are free while the other one does what it does, the nearest ones first."""
    arm = context.model.arms[name]
    limits = context.job.cell.robot.limits.select(arm.arm.joints)
    start, goal, drawn = _drawn(context, name)
    home = context.job.cell.robot.postures["home"][arm.columns]
    every = np.clip(np.vstack([start, home, drawn]), limits.lower, limits.upper)
    way = np.maximum(np.abs(every - start), np.abs(goal - every)) / limits.velocity
    every = every[np.argsort(way.max(axis=1), kind="stable")]
    times = np.linspace(0, len(context.samples.position) - 1, 12).astype(int)
    rows = np.tile(context.samples.position[times], (len(every), 1))
    rows[:, arm.columns] = np.repeat(every, len(times), axis=0)
    held = np.tile(context.samples.held[times], (len(every), 1))
    held[:, context.cell.arms.index(name)] = context.ways[name].held[0]
    free = (context.cell.margins(rows, held) >= KEPT).reshape(len(every), -1).all(axis=1)
    return list(every[np.flatnonzero(free)[:WAITED]])
