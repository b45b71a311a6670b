"""Curves of one arm round what is in the way of its transfer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.planning.curves import curve, quick_curves
from dualarm_cli.planning.stage_context import StageContext, missing_clearance, tool_times
from dualarm_cli.planning.stage_plan import Detour, StagePlan
from dualarm_cli.planning.stage_samples import (
    StageSamples,
    combined,
)
from dualarm_cli.planning.stops_aside import quickest_stop

TIMED = 3
"""So many curves, quickest first, are timed."""
ROUNDS = (17, 49, 49)
"""Points at which curves are looked at, round by round: more, and with a better idea of what the others do then."""


def quickest_curve(
    context: StageContext, name: str, clear: Callable[[StageSamples], bool], with_other: bool
) -> StagePlan | None:
    """Returns the stage with the quickest of some curves of one arm that keep clear, None for none.

    Curves are looked for beside what the platform and the other arm do meanwhile, as far as that is known before a
    curve is timed; the best ones are timed, and looked at again. Where there is none, a posture to stop at is.

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
        missing = missing_clearance(context, name, way, points, with_other)
        tool = tool_times(context, name, way, points)
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
    return quickest_stop(context, name, clear, with_other)
