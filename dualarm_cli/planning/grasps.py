"""Plans of jobs with open grasps: ranked choices and single grasps compete."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import field, replace

import numpy as np

from dualarm_cli.clearing.blocked import grip_faults
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.kinds.planning import with_needs
from dualarm_cli.model.job import Job, Task
from dualarm_cli.model.motion.trajectory import SAME_TIME
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.orders.decided_jobs import stage_by_stage
from dualarm_cli.orders.watch import Watch
from dualarm_cli.planning.planned_job import resolve
from dualarm_cli.postures.holding import Holding
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal
from dualarm_cli.stages.search.alternatives import ranked_choices
from dualarm_cli.stages.sequence_problem import sequence_problem
from dualarm_cli.verification.as_done import job_as_done

Choice = Mapping[str, str]
"""Name of the grasp by task id, of both tools' grasps for a hand-over."""


@dataclass(frozen=True)
class GraspSettings:
    """Number of choices of grasps that are planned."""

    mixes: int = 2
    """Number of choices of different grasps that are planned."""
    promising: float = 0.1
    """Relative excess of the estimate up to which a single grasp is planned."""


GRASPS = GraspSettings()


def possible_grasps(
    job: Job, find: Callable[[Job], Sequence[Refusal]]
) -> tuple[Job, list[Refusal]]:
    """Remove the grasps that are proven to be impossible; list the faults of what remains.

    A task without a possible grasp keeps the faults of its first one.

    Args:
        job: with open grasps.
        find: lists the faults of a job with decided grasps, at least one if there are any.
    """
    reduced, remaining = _without_faults(job, find)
    # The fault of one task may have hidden those of others.
    while not remaining and _open_count(reduced) < _open_count(job):
        job = reduced
        reduced, remaining = _without_faults(job, find)
    return reduced, remaining


def _open_count(job: Job) -> int:
    return sum(len(task.grasps) for task in job.tasks)


def _without_faults(
    job: Job, find: Callable[[Job], Sequence[Refusal]]
) -> tuple[Job, list[Refusal]]:
    faults: dict[tuple[str, int], list[Refusal]] = {}
    remaining: list[Refusal] = []
    open_ids = {task.id for task in job.tasks if task.grasps}
    for k, single in enumerate(_singles(job)):
        for fault in find(job.with_grasps(single)):
            if fault.task in open_ids:
                faults.setdefault((fault.task, k), []).append(fault)
            elif k == 0:
                remaining.append(fault)

    def reduced(task: Task) -> Task:
        good = tuple(t for k, t in enumerate(task.grasps) if (task.id, k) not in faults)
        if not good:
            # Both shares of a hand-over have the same faults.
            remaining.extend(f for f in faults[task.id, 0] if f not in remaining)
            return task
        decided = task.by_grasp(good[0])
        return replace(decided, arm=task.arm, grasps=good) if len(good) > 1 else decided

    tasks = tuple(reduced(task) if task.grasps else task for task in job.tasks)
    return replace(job, tasks=tasks), remaining


def _singles(job: Job) -> list[Choice]:
    """List the choices of every task's k-th grasp, for all k; at least an empty one."""
    longest = max([1, *(len(task.grasps) for task in job.tasks)])
    return [
        {t.id: _name(t.grasps[k if k < len(t.grasps) else 0]) for t in job.tasks if t.grasps}
        for k in range(longest)
    ]


def _name(task: Task) -> str:
    return "" if task.grasp is None else task.grasp.choice


def _key(task: Task) -> tuple[str, str]:
    """Return the key of a task, different for both shares of a hand-over."""
    return task.id, task.stops[0].action


def quickest_by_grasps(
    job: Job, settings: PlanSettings, watch: Watch, planned: Callable[[Job], Schedule]
) -> tuple[Schedule, Job]:
    """Plan a job by several choices of grasps; return the fastest plan and its job.

    Args:
        job: with open grasps.
        settings: settings of the plan.
        watch: receives progress, and may end the search.
        planned: plans a job with decided grasps.

    Raises:
        InfeasibleError: a task has no possible grasp, or no choice has a plan.
    """

    def faults(decided: Job) -> Sequence[Refusal]:
        try:
            resolve(decided, settings)
        except InfeasibleError as error:
            return error.refusals
        return grip_faults(decided)

    watch.report("choosing grasps")
    job, impossible = possible_grasps(job, faults)
    if impossible:
        raise InfeasibleError(*impossible)
    return _GraspSearch(job, settings, watch, planned).quickest()


@dataclass
class _GraspSearch:
    """Search for the choice of grasps with the fastest plan."""

    job: Job
    """Job with open grasps, all of them possible."""
    settings: PlanSettings
    """Settings of the plan."""
    watch: Watch
    """Receives progress, and may end the search."""
    planned: Callable[[Job], Schedule]
    """Planner of a job with decided grasps."""
    best: tuple[Schedule, Job] | None = None
    """Fastest plan so far with its job."""
    failures: list[InfeasibleError] = field(default_factory=list)
    """Reasons of choices without a plan."""
    tried: list[Choice] = field(default_factory=list)
    """Choices that were planned."""

    def quickest(self) -> tuple[Schedule, Job]:
        """Plan the fastest choices by their estimates; others only until the first plan."""
        singles = _singles(self.job)
        if self.job.is_decided:
            self._try(self._fastest(self.job, singles))
        else:
            # Which choice is fast depends on the order, which a first plan decides.
            self._try(singles)
            if self.best is not None:
                self._try(self._fastest(self._in_order(*self.best), ()))
        for choice in singles:
            if self.best is None:
                self._try([choice])
        if self.best is None:
            raise self.failures[0]
        return self.best

    def _try(self, choices: Sequence[Choice]) -> None:
        """Plan further choices unless the user has seen enough."""
        for choice in choices:
            if choice in self.tried or (self.best is not None and self.watch.stop()):
                continue
            self.tried.append(choice)
            job = self.job.with_grasps(choice)
            try:
                schedule = self.planned(job)
            except InfeasibleError as error:
                self.failures.append(error)
                continue
            if self.best is None or schedule.duration < self.best[0].duration - SAME_TIME:
                self.best = schedule, job

    def _fastest(self, decided: Job, singles: Sequence[Choice]) -> list[Choice]:
        """Select the choices to plan by their estimates, single grasps without one last."""
        ranked = list(self._ranked(decided))
        if not ranked:
            return list(singles)
        estimates = [(total, choice) for total, choice in ranked if choice in singles]
        mixes = [(total, choice) for total, choice in ranked if choice not in singles]
        limit = (1.0 + GRASPS.promising) * ranked[0][0]
        few = mixes[: GRASPS.mixes] + [pair for pair in estimates if pair[0] <= limit]
        return [choice for _, choice in sorted(few, key=lambda pair: pair[0])]

    def _ranked(self, decided: Job) -> Iterator[tuple[float, Choice]]:
        """Estimate the cycle time of choices in a decided order [s], fastest first."""
        if decided.in_sections:
            return
        choices, jobs, problems = [], [], []
        for choice in _singles(decided):
            # Each stop is possible by itself, but perhaps not in this order.
            with suppress(InfeasibleError):
                resolved = resolve(decided.with_grasps(choice), self.settings)
                guess = resolved.guessed
                job = with_needs(guess if decided.mode == "paired" else stage_by_stage(guess))
                given = resolved.model, job, Holding.of(job)
                problems.append(sequence_problem(*given, is_careful=True))
                choices.append(choice)
                jobs.append(job)
        if not jobs:
            return
        stages, names = jobs[0].stages(), [arm.name for arm in decided.cell.robot.arms]
        open_ids = {task.id for task in decided.tasks if task.grasps}
        shape = len(choices), len(names), len(stages)
        offered, linked = np.zeros(shape, dtype=np.bool_), np.zeros(shape[1:], dtype=np.bool_)
        offered[0] = True
        for k, work in enumerate(stages):
            for arm, (task, stop) in work.items():
                if task.id in open_ids:
                    grasps = [choice[task.id] for choice in choices]
                    firsts = [grasps.index(name) for name in dict.fromkeys(grasps)]
                    offered[firsts, names.index(arm), k] = True
                    linked[names.index(arm), k] = stop is not task.stops[0]
        for ranked in ranked_choices(problems, offered, linked, self.settings.effort):
            choice = {}
            for k, work in enumerate(stages):
                for arm, (task, _) in work.items():
                    if task.id in open_ids:
                        number = int(ranked.chosen[names.index(arm), k])
                        choice[task.id] = choices[number][task.id]
            yield ranked.total, choice

    def _in_order(self, schedule: Schedule, job: Job) -> Job:
        """Decide arms and order of the open job as in a plan; grasps stay open."""
        options = {_key(task): task.grasps for task in self.job.tasks}
        done = job_as_done(schedule, job)
        # Stands are visited again by the choice's own plan.
        tasks = [t for t in done.tasks if not t.is_change]
        keys = {(t.arm, t.id, s.action) for t in tasks for s in t.stops}
        stages = [tuple(key for key in stage if key in keys) for stage in done.pairing or ()]
        return replace(
            done,
            tasks=tuple(
                replace(t, grasps=tuple(g for g in options[_key(t)] if g.allows(t.arm)))
                for t in tasks
            ),
            pairing=tuple(filter(None, stages)) or None,
        )
