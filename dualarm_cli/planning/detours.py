"""Other ways for one arm's transfer: curves by a posture aside, and postures where it waits for the other arm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from dualarm_cli.collision.clearance import CellClearance
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.planning.curves import Missing, ToolTimes, curve, quick_curves
from dualarm_cli.planning.motion import detour_pieces
from dualarm_cli.planning.stage_plan import Detour, StagePlan
from dualarm_cli.planning.stage_samples import (
    KEPT,
    ArmWay,
    StageSamples,
    apart,
    combined,
)
from dualarm_cli.planning.transfers import PLATFORM
from dualarm_cli.timing import TimingSolver

SPREADS = (0.2, 0.4, 0.7, 1.1)
"""Standard deviations of random postures about the way [rad]."""
DRAWN = 120
"""Random postures of each spread."""
TIMED = 3
"""So many curves, quickest first, are timed."""
SPARE = 0.004
"""What curves keep beyond the required clearance, for what is between their points [m]."""
ROUNDS = (17, 49, 49)
"""Points at which curves are looked at, round by round: more, and with a better idea of what the others do then."""
LEG_SAMPLES = 13
"""Points of each way to and from a posture that is stopped at."""
STOPS = 24
"""So many postures that are stopped at, nearest first, are timed."""
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
    platform: Trajectory | None
    """What the platform does in it; None where there is none."""
    timing: TimingSolver
    """How transfers and curves are timed."""
    seed: int
    """Of what is tried at random."""

    def way_by(self, name: str, detour: Detour) -> ArmWay:
        """Returns an arm's way by a posture."""
        limits = self.job.cell.robot.limits.scaled(self.job.speed)
        columns = {arm: self.model.arms[arm].columns for arm in self.model.arms}
        if self.platform is not None:
            columns[PLATFORM] = self.model.platform_columns
        plan = replace(self.plan, detours={name: detour})
        pieces = detour_pieces(
            self.model,
            plan,
            name,
            columns,
            limits,
            self.timing,
            self.job.tool_speed,
            self.platform,
        )
        base = self.ways[name]
        rows = [piece.at(np.arange(0.0, piece.duration, self.samples.step))[0] for piece in pieces]
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

    Curves are looked for beside what the platform and the other arm do meanwhile, as far as that is known before a
    curve is timed; the best ones are timed, and looked at again.

    Args:
        context: the stage.
        name: the arm.
        clear: whether a stage with another way of the arm keeps clear.
        with_other: whether the other arm counts while curves are looked for.
    """
    arm, way = context.model.arms[name], context.ways[name]
    start, goal = context.plan.start[arm.columns], context.plan.arrival[arm.columns]
    limits = context.job.cell.robot.limits.scaled(context.job.speed).select(arm.arm.joints)
    pace = 1.0 / context.job.speed
    least = way.arrival * context.samples.step
    points = start + np.linspace(0.0, 1.0, ROUNDS[0])[:, None] * (goal - start)
    for samples, later in pairwise((*ROUNDS, ROUNDS[-1])):
        missing = _missing(context, name, way, points, with_other)
        tool = _tool_times(context, name, way, points)
        found = quick_curves(start, goal, limits, least, missing, samples, pace, context.seed, tool)
        timed = []
        for controls in found[:TIMED]:
            detour = Detour(controls, None)
            try:
                timed.append(context.way_by(name, detour))
            except InfeasibleError:
                # With the platform's motion the tool is too fast at any speed of the arm.
                continue
            stage = combined(context.model, context.samples, {**context.ways, name: timed[-1]}, {})
            if clear(stage):
                return replace(context.plan, detours={**context.plan.detours, name: detour})
        if not timed:
            break
        # What the others do while the arm is where is known better now.
        way, points = timed[0], curve(start, found[0], goal, later)
    if context.job.tool_speed is not None:
        return _quickest_stop(context, name, clear, with_other)
    return None


def _quickest_stop(
    context: StageContext, name: str, clear: Callable[[StageSamples], bool], with_other: bool
) -> StagePlan | None:
    """Returns the stage in which an arm goes by the quickest posture found at which it stops, None for none."""
    start, goal, posture = _drawn(context, name)
    limits = context.job.cell.robot.limits.select(context.model.arms[name].arm.joints)
    posture = posture[((posture >= limits.lower) & (posture <= limits.upper)).all(axis=1)]
    share = np.linspace(0.0, 1.0, LEG_SAMPLES)[:, None]
    out = start + share * (posture[:, None] - start)
    on = posture[:, None] + share * (goal - posture[:, None])
    legs = np.concatenate([out, on[:, 1:]], axis=1)
    way = context.ways[name]
    straight = start + np.linspace(0.0, 1.0, legs.shape[1])[:, None] * (goal - start)
    lack = _missing(context, name, way, straight, with_other)(legs)
    length = sum(
        (np.abs(leg[:, -1] - leg[:, 0]) / limits.velocity).max(axis=1) for leg in (out, on)
    )
    best, least = None, np.inf
    order = np.argsort(np.where(lack == 0.0, length, np.inf), kind="stable")
    for k in order[: min(STOPS, int((lack == 0.0).sum()))]:
        detour = Detour(posture[k : k + 1], 0.0)
        ways = {**context.ways, name: context.way_by(name, detour)}
        stage = combined(context.model, context.samples, ways, {})
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
        there = context.way_by(name, Detour(posture[None], 0.0))
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
                waits = {other: delay * context.samples.step} if delay else {}
                best = replace(
                    context.plan,
                    waits=waits,
                    detours={name: Detour(posture[None], high * context.samples.step)},
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


def _missing(
    context: StageContext, name: str, way: ArmWay, points: FloatArray, with_other: bool
) -> Missing:
    """Returns what curves of an arm lack of the clearance beside what all others do about then.

    Args:
        context: the stage.
        name: the arm.
        way: what is known of how it gets along a curve.
        points: of that curve [rad], shape (s, 7).
        with_other: whether the other arm counts.
    """
    stage, instants = _meanwhile(context, name, way, points)
    a = context.cell.arms.index(name)

    def missing(curves: FloatArray) -> FloatArray:
        rows = _beside(context, name, stage.position[instants], curves)
        held = np.tile(stage.held[instants], (len(curves), 1))
        margin = context.cell.own_margins(a, rows, held[:, a])
        if with_other:
            margin = np.minimum(margin, context.cell.cross_margins(rows, held))
        lack: FloatArray = np.maximum(SPARE - margin, 0.0).reshape(curves.shape[:2])
        # The ends are what they are.
        return lack[:, 1:-1].mean(axis=1)

    return missing


def _tool_times(
    context: StageContext, name: str, way: ArmWay, points: FloatArray
) -> ToolTimes | None:
    """Returns how long an arm's tool needs at least along curves under its cap; None without one.

    Arguments as of `_missing`.
    """
    cap = context.job.tool_speed
    if cap is None:
        return None
    stage, instants = _meanwhile(context, name, way, points)

    def times(curves: FloatArray) -> FloatArray:
        rows = _beside(context, name, stage.position[instants], curves)
        tip = context.model.tool_position(name, rows).reshape(*curves.shape[:2], 3)
        length: FloatArray = np.linalg.norm(np.diff(tip, axis=1), axis=2).sum(axis=1)
        return length / cap

    return times


def _meanwhile(
    context: StageContext, name: str, way: ArmWay, points: FloatArray
) -> tuple[StageSamples, IntArray]:
    """Returns a stage with another way of an arm, and about when in it the arm is at points (s, 7) of its curve."""
    stage = combined(context.model, context.samples, {**context.ways, name: way}, {})
    moving = way.q[: way.arrival + 1]
    far = np.abs(moving[None] - points[:, None]).max(axis=2)
    instants: IntArray = np.maximum.accumulate(np.argmin(far, axis=1))
    return stage, instants


def _beside(context: StageContext, name: str, others: FloatArray, curves: FloatArray) -> FloatArray:
    """Returns all joints with an arm on curves (c, s, 7) and all others at (s, columns), shape (c s, columns) [rad]."""
    rows = np.tile(others, (len(curves), 1))
    rows[:, context.model.arms[name].columns] = curves.reshape(-1, 7)
    return rows


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
