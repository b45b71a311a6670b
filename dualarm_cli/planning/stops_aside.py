"""Postures that one arm's transfer stops at: aside of what is in the way, or while the other arm passes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.planning.stage_context import StageContext, missing_clearance
from dualarm_cli.planning.stage_plan import Detour, StagePlan
from dualarm_cli.planning.stage_samples import (
    KEPT,
    ArmWay,
    StageSamples,
    apart,
    combined,
)

SPREADS = (0.2, 0.4, 0.7, 1.1)
"""Standard deviations of random postures about the way [rad]."""
DRAWN = 120
"""Random postures of each spread."""
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


def quickest_stop(
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
    lack = missing_clearance(context, name, way, straight, with_other)(legs)
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
            meets = None if there.meets is None else there.meets + pause
            ways = {**context.ways, name: ArmWay(q, held, there.arrival + pause, meets)}
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
    """Returns where an arm's transfer begins and ends, and random postures (k, n) about the way between."""
    arm = context.model.arms[name]
    start, goal = context.plan.start[arm.columns], context.plan.arrival[arm.columns]
    random = np.random.default_rng(context.seed)
    share = random.uniform(0.25, 0.75, (len(SPREADS) * DRAWN, 1))
    spread = np.repeat(SPREADS, DRAWN)[:, None]
    posture = start + share * (goal - start) + random.normal(size=(len(share), len(start))) * spread
    return start, goal, posture


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
