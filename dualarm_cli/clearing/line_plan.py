"""Plans in which the platform turns while tools are on their lines, taken only where the real plan becomes shorter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from dualarm_cli.beside import halves
from dualarm_cli.clearing.blended_plan import has_blends
from dualarm_cli.clearing.cleared_plan import ClearedPlan
from dualarm_cli.clearing.repairs import Cleared, Clearing
from dualarm_cli.effort import EFFORTS
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.job import Job
from dualarm_cli.motion.builder import Motion
from dualarm_cli.motion.motion import realise
from dualarm_cli.motion.transfers import Drive, Key
from dualarm_cli.motion.turned_transfers import TurnedTransfer, can_take_over, turned_transfer
from dualarm_cli.postures.stage_plan import StagePlan
from dualarm_cli.stages.method import MethodProblem

WORTH = 1e-6
"""What is gained that is worth it [s]."""
TransferMemory = dict[Key, TurnedTransfer | None]
"""Transfers that have been looked for, by all that they depend on."""


def turned_lines_plan(
    problem: MethodProblem,
    found: ClearedPlan,
    drive: Drive,
    clearing: Clearing | None,
    first: FloatArray,
    known: TransferMemory,
) -> ClearedPlan:
    """Returns a plan in which the platform turns while tools are on lines, where tasks allow it and it is shorter.

    Where none is found it is the same plan.

    Args:
        problem: what was asked.
        found: the plan in which it stands then, blended where the problem allows it.
        drive: of the job.
        clearing: what has to be collision-free; None: nothing.
        first: how far the platform may move on each stage's lines to begin with [rad or m], shape (n, 2).
        known: transfers that have been looked for; what is new is added.
    """
    plans, before, job = found.cleared.plans, found.cleared.motion, problem.job
    widths = EFFORTS[problem.effort].widths
    _look_for(drive, plans, first, known, blend=has_blends(problem), widths=widths)
    tries = {
        k: one
        for k in range(len(plans))
        if (one := known[_key(drive, plans, first, k)]) is not None
        and one.time < _time_between(plans, before, k) - WORTH
    }
    while tries:
        turned = _with_transfers(drive, plans, tries)
        try:
            motion = realise(problem.model, job, turned, drive.timing, drive.known)
        except InfeasibleError:
            return found
        touching = set() if clearing is None else set(clearing.touching(turned, motion))
        # A transfer has the retract of the stage before, and its own stage up to the targets.
        worse = _longer(tries, motion, before)
        if touching:
            worse = {k for k in tries if {k - 1, k} & touching}
        if not worse:
            shorter = motion.trajectory.duration < before.trajectory.duration - WORTH
            if touching or not shorter or not _in_time(job, motion):
                return found
            motion = replace(_with_saved(motion, before), gain=before.gain)
            return replace(found, cleared=Cleared(turned, motion, ()))
        tries = {k: one for k, one in tries.items() if k not in worse}
    return found


def _look_for(
    drive: Drive,
    plans: Sequence[StagePlan],
    first: FloatArray,
    known: TransferMemory,
    *,
    blend: bool,
    widths: int,
) -> None:
    """Looks for the transfers on whose lines the platform turns that are not known yet."""

    def of(stages: Sequence[int]) -> list[TurnedTransfer | None]:
        own = partial(turned_transfer, drive, blend=blend, widths=widths)
        return [own(plans[k - 1] if k else None, plans[k], _first(first, k)) for k in stages]

    keys = [_key(drive, plans, first, k) for k in range(len(plans))]
    new = [k for k, key in enumerate(keys) if key not in known]
    for k, one in zip(new, halves(of, new), strict=True):
        known[keys[k]] = one


def _first(first: FloatArray, k: int) -> tuple[float, float]:
    """Returns how far the platform moves to begin with on the lines beside the transfer to a stage [rad or m]."""
    away = float(first[k - 1, 1]) if k else 0.0
    return away, float(first[k, 0]) if k < len(first) else 0.0


def _key(drive: Drive, plans: Sequence[StagePlan], first: FloatArray, k: int) -> Key:
    """Returns all that the search for the transfer to a stage depends on."""
    numbers = [plans[k].start, plans[k].arrival, np.array(_first(first, k))]
    for at, line in ((k - 1, "retract"), (k, "approach")):
        if at < 0:
            continue
        numbers.append(plans[at].platform_at(line, drive.model.platform_columns))
        for one in plans[at].stops.values():
            made = plans[at].stop_at(line, one).posture
            numbers += [made.q_target, np.array([made.psi_approach, made.psi_retract])]
    possible = can_take_over(plans[k - 1] if k else None, plans[k])
    return (k, possible, np.concatenate(numbers).tobytes())


def _time_between(plans: Sequence[StagePlan], motion: Motion, k: int) -> float:
    """Returns how long a motion takes from the end of the last dwell of a stage to the last target of the next [s]."""
    begin, end = motion.stages[k].start, motion.stages[k].end
    if k:
        events = [motion.event_of[k - 1, name] for name in plans[k - 1].stops]
        begin = max(event.time + event.dwell for event in events)
    if plans[k].stops:
        end = max(motion.event_of[k, name].time for name in plans[k].stops)
    return end - begin


def _with_transfers(
    drive: Drive, plans: Sequence[StagePlan], tries: Mapping[int, TurnedTransfer]
) -> list[StagePlan]:
    found = list(plans)
    for k, one in tries.items():
        before, found[k] = one.put(drive, found[k - 1] if k else None, found[k])
        if before is not None:
            found[k - 1] = before
    return found


def _longer(tries: Mapping[int, TurnedTransfer], motion: Motion, before: Motion) -> set[int]:
    """Returns the transfers with whose lines both stages are longer together than they were."""
    more = [
        (new.end - new.start) - (old.end - old.start)
        for new, old in zip(motion.stages, before.stages, strict=True)
    ]
    return {k for k in tries if more[k] + (more[k - 1] if k else 0.0) > WORTH}


def _in_time(job: Job, motion: Motion) -> bool:
    """Returns whether every task with a window is done within it."""
    late = {task.id: task.not_after for task in job.tasks}
    return all(event.time <= late[event.task] for event in motion.events)


def _with_saved(motion: Motion, before: Motion) -> Motion:
    """Returns a motion whose stages say what blending saved in the plan that it came from."""
    stages = tuple(
        replace(stage, saved=old.saved)
        for stage, old in zip(motion.stages, before.stages, strict=True)
    )
    return replace(motion, stages=stages)
