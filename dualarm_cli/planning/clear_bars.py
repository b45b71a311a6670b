"""What a plan that does not keep clear teaches: stages that have to be different, and what others really cost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.minimum_time.clearance import Barred
from dualarm_cli.planning.clearing import Cleared, Clearing
from dualarm_cli.planning.stage_samples import StageSamples, alone_clear, stage_samples
from dualarm_cli.planning.waiting import transfer_ends

COSTLY = 1.5
"""What mending a stage costs that is worth looking for another one, at full speed [s]."""


def bars_of(clearing: Clearing, tried: Cleared) -> list[Barred]:
    """Returns what a plan's blocked stages have to be different in, and what its mended ones really cost."""
    found = []
    everything = tuple(range(len(clearing.job.cell.robot.joints)))
    # With a cap on the tools' speed all takes longer than the search thinks.
    thought = sum(plan.duration for plan in tried.plans) / clearing.holding.pace
    slow = clearing.holding.pace
    if thought > 0.0:
        slow = max(slow, tried.motion.trajectory.duration / thought)
    for k, (plan, stage) in enumerate(zip(tried.plans, tried.motion.stages, strict=True)):
        if not plan.detours and not plan.waits and plan.path is None:
            continue
        straight = clearing.alone(replace(plan, detours={}, waits={}, path=None))
        cost = stage.end - stage.start - straight.trajectory.duration
        if cost > COSTLY * slow:
            found.append(Barred(k, everything, plan.start, plan.arrival, cost))
    for k in tried.blocked:
        plan, stage = tried.plans[k], tried.motion.stages[k]
        samples = stage_samples(tried.motion, k, k, clearing.holding)
        margins = clearing.holding.cell.margins(samples.position, samples.held)
        ends = transfer_ends(tried.motion.segments, stage.start, stage.end)
        length = stage.end - stage.start
        arrived = (min(ends, default=stage.end) - stage.start) / length if length > 0 else 0.0
        worst = int(np.argmin(margins)) / (len(margins) - 1)
        start = None if plan.stops and worst >= arrived else plan.start
        found.append(Barred(k, _joints_at_fault(clearing, samples), start, plan.arrival))
    return found


def _joints_at_fault(clearing: Clearing, samples: StageSamples) -> tuple[int, ...]:
    """Returns the columns of the arm that does not keep clear by itself, or else of all joints."""
    model, cell = clearing.model, clearing.holding.cell
    for a, name in enumerate(cell.arms):
        if not alone_clear(cell, samples, a):
            return (*model.platform_columns, *model.arms[name].columns)
    return tuple(range(samples.position.shape[1]))
