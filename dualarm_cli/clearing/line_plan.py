"""Plans in which the platform turns while tools are on their lines, taken only where the real plan becomes shorter."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from dualarm_cli.beside import halves
from dualarm_cli.clearing.clear_plan import ClearedPlan, has_blends
from dualarm_cli.clearing.dwell_plan import moving_dwells_plan
from dualarm_cli.clearing.permissions import permitted
from dualarm_cli.clearing.repairs import Cleared, Clearing
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.model.job import Job
from dualarm_cli.motion.builder import Motion
from dualarm_cli.motion.motion import realise
from dualarm_cli.motion.transfers import Drive
from dualarm_cli.motion.turned_transfers import TurnedTransfer, turned_transfer
from dualarm_cli.postures.holding import Holding
from dualarm_cli.postures.stage_plan import StagePlan
from dualarm_cli.stages.method import MethodProblem
from dualarm_cli.timing import TimingSolver

WORTH = 1e-6
"""What is gained that is worth it [s]."""


def moving_plan(
    problem: MethodProblem,
    found: ClearedPlan,
    timing: TimingSolver,
    progress: Callable[[str], None],
    *,
    clear: bool = True,
) -> ClearedPlan:
    """Returns a plan in which joints move in dwells and the platform on lines, where tasks allow it and it is shorter.

    Arguments as of `turned_lines_plan`.
    """
    found = moving_dwells_plan(problem, found, timing, progress, clear=clear)
    return turned_lines_plan(problem, found, timing, progress, clear=clear)


def turned_lines_plan(
    problem: MethodProblem,
    found: ClearedPlan,
    timing: TimingSolver,
    progress: Callable[[str], None],
    *,
    clear: bool = True,
) -> ClearedPlan:
    """Returns a plan in which the platform turns while tools are on lines, where tasks allow it and it is shorter.

    Where none is found it is the same plan, which then gains nothing.

    Args:
        problem: what was asked.
        found: the plan in which it stands then, blended where the problem allows it.
        timing: how motions are timed.
        progress: receives what is being done.
        clear: whether anything has to be collision-free.
    """
    if "line_motion" not in permitted(problem.job):
        return found
    before, made = found.cleared, None
    if problem.model.platform.is_chosen:
        progress("turning the platform while tools are on lines")
        made = _improved(problem, found, timing, clear=clear)
    best = before if made is None else made
    gain = before.motion.trajectory.duration - best.motion.trajectory.duration
    motion = replace(
        best.motion, motion_gain=(before.motion.motion_gain or 0.0) + gain, gain=before.motion.gain
    )
    standing = found.standing or before
    return replace(found, cleared=replace(best, motion=motion), standing=standing)


def _improved(
    problem: MethodProblem, found: ClearedPlan, timing: TimingSolver, *, clear: bool
) -> Cleared | None:
    """Returns a shorter plan, collision-free and within all windows, None where there is none."""
    model, job, known = problem.model, problem.job, found.known
    plans, before = found.cleared.plans, found.cleared.motion
    drive = Drive.of(model, job, timing, known)
    clearing = None
    if clear:
        clearing = Clearing(model, job, Holding.of(job), timing, problem.seed, known)
    tries = _shorter(drive, plans, before, blend=has_blends(problem))
    while tries:
        turned = _with_transfers(drive, plans, tries)
        try:
            motion = realise(model, job, turned, timing, known)
        except InfeasibleError:
            return None
        touching = set() if clearing is None else set(clearing.touching(turned, motion))
        # A transfer has the retract of the stage before, and its own stage up to the targets.
        worse = (
            {k for k in tries if {k - 1, k} & touching}
            if touching
            else _longer(tries, motion, before)
        )
        if not worse:
            shorter = motion.trajectory.duration < before.trajectory.duration - WORTH
            if touching or not shorter or not _in_time(job, motion):
                return None
            return Cleared(turned, _with_saved(motion, before), ())
        tries = {k: one for k, one in tries.items() if k not in worse}
    return None


def _shorter(
    drive: Drive, plans: Sequence[StagePlan], motion: Motion, *, blend: bool
) -> dict[int, TurnedTransfer]:
    """Returns the transfers that are quicker with a platform that turns on their lines, by the stage they lead to."""

    def of(stages: Sequence[int]) -> list[TurnedTransfer | None]:
        return [
            turned_transfer(drive, plans[k - 1] if k else None, plans[k], blend=blend)
            for k in stages
        ]

    found = halves(of, range(len(plans)))
    return {
        k: one
        for k, one in enumerate(found)
        if one is not None and one.time < _time_between(plans, motion, k) - WORTH
    }


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
