"""Jobs with paths: section by section, each path with the transfer to where it begins."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from dualarm_cli.clearing.clear_plan import (
    ClearedPlan,
    check_start,
    clearance_notes,
    quickest_clear,
)
from dualarm_cli.effort import EFFORTS
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinds.path.context import PathContext
from dualarm_cli.kinds.path.following import PATH_SOLVERS
from dualarm_cli.kinds.path.motion import (
    FollowedPath,
    Refused,
    TrialBudget,
    follow_path,
    keeps_clear,
    touching_path,
)
from dualarm_cli.kinds.path.record import add_followed, add_transfer, drawn_out_transfer
from dualarm_cli.kinds.path.starts import path_starts
from dualarm_cli.kinds.path.words import path_notes, why_not
from dualarm_cli.kinds.seam.plan import SeamPlanner
from dualarm_cli.kinds.seam.record import PlannedSeam, add_seam, seam_notes
from dualarm_cli.model.job import Task
from dualarm_cli.model.seam import SeamWork
from dualarm_cli.motion.builder import Motion, MotionBuilder
from dualarm_cli.orders.decided_jobs import own_rules
from dualarm_cli.orders.model.buffer_numbers import begun, check_stage_levels
from dualarm_cli.orders.orders import PairedSearch
from dualarm_cli.orders.watch import Watch
from dualarm_cli.postures.holding import Holding
from dualarm_cli.postures.stage_plan import StagePlan
from dualarm_cli.refusals import Refusal
from dualarm_cli.stages.method import Decided, MethodProblem
from dualarm_cli.timing import TimingSolver
from dualarm_cli.timing.composition import SAME_TIME
from dualarm_cli.timing.rest_to_rest import RestToRest

SAME = 1e-9
"""Difference of two configurations that count as one [rad]."""
HERE = "(where the section before ended)"
"""Name of the posture in which a section starts."""
ALIKE, SAME_PLACE, FAR_TOO_FAST = 3, 0.02, 1.2
"""So many starts that are too fast at the same place, to this share of the path, by this factor, speak for all."""
CHEAP = 0.1
"""What keeping a transfer clear may cost for no other start to be looked at [s]."""
MOST_STARTS = 16
"""So many starts of a path are tried."""
MOST_STUCK = 3
"""So many of those from which less speed may help, but how much less is not known, are tried slower."""


@dataclass(frozen=True)
class PlannedSections:
    """A job with paths, planned."""

    motion: Motion
    """All of it."""
    notes: tuple[str, ...]
    """What a reader should know."""
    clearance_cost: float | None
    """How much longer it is than without clearance, its paths not counted [s]."""
    stage_plans: list[StagePlan]
    """The stages that are not paths."""


@dataclass
class SectionBuilder(MotionBuilder):
    """What is planned so far, section by section, and what is to be said of it."""

    notes: list[str] = field(default_factory=list)
    """What a reader should know."""
    stage_plans: list[StagePlan] = field(default_factory=list)
    """The stages of stops."""
    cost: float = 0.0
    """How much longer it is than without clearance, paths not counted [s]."""

    def count(self, found: ClearedPlan) -> None:
        """Notes what keeping the motion that was added last clear costs, and what a reader should know of it."""
        first = len(self.stages) - len(found.cleared.plans) + 1
        self.cost += found.cost or 0.0
        self.notes += [*found.decided.notes, *clearance_notes(found, first)]


@dataclass(frozen=True)
class SectionPlanner:
    """What sections are planned with."""

    problem: MethodProblem
    """The whole job."""
    method: Callable[[MethodProblem], Decided]
    """Decides the stages between paths."""
    timing: TimingSolver
    """How transfers and lines are timed."""
    follower: str | None
    """Name of the path follower that was asked for; None for the file's choice."""
    seam_solver: str | None
    """Name of the seam solver that was asked for; None for the file's choice."""
    progress: Callable[[str], None]
    """Is told what is being done."""
    clear: bool
    """Whether anything has to keep clear."""

    def plan(self) -> PlannedSections:
        """Returns the whole job, section after section.

        Raises:
            InfeasibleError: a section that cannot be planned, with the reason.
        """
        job, record = self.problem.job, SectionBuilder()
        robot = job.cell.robot
        if job.is_decided:
            check_stage_levels(job)
        here = None if job.start == "free" else np.array(job.start_joints)
        if self.clear and here is not None:
            # What no plan can mend is told before one is looked for.
            check_start(self.problem, Holding.of(self._problem((), here).job))
        sections = job.sections()
        done: list[Task] = []
        for section, after in zip(sections, [*sections[1:], ()], strict=True):
            if section[0].seam is not None:
                self._add_seam(record, section, here, after[0].seam if after else None)
            elif section[0].path is None:
                self._add_stops(record, section, here, done)
            else:
                self._add_path(record, section, here)
            done += section
            here = record.end
        first = record.begin
        assert here is not None  # a job has at least one task
        if job.returns and np.abs(first - here).max() > 0.0:
            found = self._transfer(here, first)
            record.append(found.cleared.motion)
            record.count(found)
        cost = record.cost if self.clear else None
        motion = record.build(robot)
        return PlannedSections(motion, tuple(record.notes), cost, record.stage_plans)

    def _add_stops(
        self,
        record: SectionBuilder,
        section: tuple[Task, ...],
        here: FloatArray | None,
        done: Sequence[Task],
    ) -> None:
        """Appends a section of stops by the job's method; buffers hold what they do after the tasks that are done."""
        problem = self._problem(section, here)
        problem = self._ordered(replace(problem, job=begun(problem.job, done)))
        self.progress("deciding platform angles and postures")
        found = quickest_clear(problem, self.method, self.timing, self.progress, clear=self.clear)
        record.append(found.cleared.motion)
        record.count(found)
        record.stage_plans += found.cleared.plans

    def _ordered(self, problem: MethodProblem) -> MethodProblem:
        """Returns the same section with arms and order, the best ones found, where the file leaves them open."""
        if problem.job.is_decided:
            return problem
        job = own_rules(problem.job)
        watch = Watch(tell=self.progress)
        search = PairedSearch.of(
            problem.model, job, problem.effort, problem.seed, watch, clear=self.clear
        )
        return replace(problem, job=search.orders(watch).found[0].job)

    def _add_path(
        self, record: SectionBuilder, section: tuple[Task, ...], here: FloatArray | None
    ) -> None:
        """Appends a path with the transfer to its start."""
        work = section[0].path
        assert work is not None
        task = section[0].id
        context = PathContext.of(self.problem.model, self.problem.job)
        name = self.follower or work.redundancy or default_follower(context)
        follower = PATH_SOLVERS[name]
        self.progress(f"following {task} ({name})")
        home = np.array(self.problem.job.cell.robot.postures["home"])
        start = home if here is None else here
        holding = Holding.of(self._problem((), start).job) if self.clear else None
        refusals: list[Refused] = []
        looked_at, budget = 0, TrialBudget()
        best: tuple[ClearedPlan | None, FollowedPath] | None = None
        clear = None if holding is None else partial(keeps_clear, holding)
        starts = path_starts(context, work, start, self.problem.seed, clear)
        stuck: list[tuple[float, FloatArray]] = []
        # From all starts first at full speed or as much less as limits tell; then slower from those where only
        # trying tells how much slower it has to be.
        for halve in (False, True):
            ready = starts.configurations[:MOST_STARTS]
            if halve:
                ready = [q for _, q in sorted(stuck, key=lambda one: -one[0])[:MOST_STUCK]]
            for q in ready:
                found = follow_path(context, work, follower, q, budget, halve)
                if isinstance(found, Refused):
                    refusals.append(found)
                    if found.remedy == "slower" and np.isinf(found.excess):
                        stuck.append((found.share, q))
                    if _always_there(refusals) or budget.spent:
                        break
                    continue
                touching = None if holding is None else touching_path(holding, found)
                if touching is not None:
                    refusals.append(touching)
                    continue
                transfer = None
                if here is not None and np.abs(q - here).max() > 0.0:
                    try:
                        transfer = self._transfer(here, q)
                    except InfeasibleError as error:
                        reason = Refusal("no_way_to_path", more={"cause": error})
                        refusals.append(Refused(reason, 0.0, "clear"))
                        continue
                if best is None or _time(transfer, found) < _time(*best):
                    best = transfer, found
                looked_at += 1
                dear = transfer is not None and (transfer.cost or 0.0) > CHEAP
                effort = EFFORTS[self.problem.effort]
                if looked_at >= effort.section_starts or (effort.spares and not dear):
                    break
            if best is not None or budget.spent or not work.slower:
                break
        if best is None:
            raise InfeasibleError(
                why_not(section, work, name, refusals, starts.nearest, context.limits)
            )
        transfer, found = best
        begin = record.clock
        if transfer is not None:
            add_transfer(record, transfer.cleared.motion, section)
            record.count(transfer)
        add_followed(record, context, section, found, name, begin)
        record.notes += path_notes(context, task, work, found, name)

    def _add_seam(
        self,
        record: SectionBuilder,
        section: tuple[Task, ...],
        here: FloatArray | None,
        after: SeamWork | None,
    ) -> None:
        """Appends a seam with the transfer to where its tool's approach begins."""
        work = section[0].seam
        assert work is not None
        job = self.problem.job
        self.progress(f"working {section[0].id}")
        home = np.array(job.cell.robot.postures["home"])
        planner = SeamPlanner(
            job,
            self.timing,
            self.problem.effort,
            self.problem.seed,
            self.clear,
            here is None,
            self.seam_solver,
        )
        found = planner.plan(section[0].id, work, home if here is None else here, after)
        begin, transfer = record.clock, None
        if here is not None and np.abs(found.first - here).max() > SAME:
            try:
                transfer = self._transfer(here, found.first)
            except InfeasibleError as error:
                more = {"cause": error}
                raise InfeasibleError(
                    Refusal("no_way_to_seam", work.place, section[0].id, work.slave, more=more)
                ) from None
            add_transfer(record, self._timed_entry(work, transfer, found, section[0].id), section)
            record.count(transfer)
        add_seam(record, self.problem.model, section, found, begin, job.speed)
        record.notes += seam_notes(job, section[0].id, work, found)

    def _timed_entry(
        self, work: SeamWork, transfer: ClearedPlan, found: PlannedSeam, task: str
    ) -> Motion:
        """Returns the transfer to a seam, drawn out to the time that the file gives the way there."""
        motion = transfer.cleared.motion
        if work.entry_duration is None:
            return motion
        asked = work.entry_duration / self.problem.job.speed
        if motion.trajectory.duration > asked - found.coming + SAME_TIME:
            least = motion.trajectory.duration + found.coming
            raise InfeasibleError(
                Refusal("entry_too_short", work.place, task, work.slave, least, asked)
            )
        return drawn_out_transfer(motion, asked - found.coming)

    def _transfer(self, here: FloatArray, there: FloatArray) -> ClearedPlan:
        """Returns the motion of all joints from one configuration to another that keeps clear."""
        problem = self._problem((), here)
        limits = problem.job.cell.robot.limits.scaled(problem.job.speed)
        law = RestToRest(limits.velocity, limits.acceleration, limits.jerk)
        duration = float(law.duration(there - here))
        stage = StagePlan(here, there, there, {}, "transfer", duration)
        return quickest_clear(
            problem, lambda _: Decided([stage]), self.timing, self.progress, clear=self.clear
        )

    def _problem(self, tasks: tuple[Task, ...], here: FloatArray | None) -> MethodProblem:
        """Returns the problem of some of the tasks, starting where the robot is."""
        job = self.problem.job
        start = "free" if here is None else HERE
        job = replace(job, tasks=tasks, start=start, begin=here, returns=False)
        return replace(self.problem, job=job)


def _always_there(refusals: list[Refused]) -> bool:
    """Returns whether the last few starts came to the same place, and there too fast: others will as well."""
    last = refusals[-ALIKE:]
    places = [one.share for one in last]
    same = max(places) - min(places) < SAME_PLACE
    much = all(one.remedy == "slower" and one.excess > FAR_TOO_FAST for one in last)
    return len(last) == ALIKE and same and much


def _time(transfer: ClearedPlan | None, followed: FollowedPath) -> float:
    """Returns how long a path takes with the transfer to it [s]."""
    there = 0.0 if transfer is None else transfer.cleared.motion.trajectory.duration
    return there + followed.trajectory.duration


def default_follower(context: PathContext) -> str:
    """Returns the follower that is taken where none is named: exact and within limits by construction."""
    return "arm_angle" if context.closed_form else "manipulability"
