"""Jobs with paths or seams, planned section by section."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

import numpy as np

from dualarm_cli.clearing.clear_plan import quickest_clear, quickest_for_stops
from dualarm_cli.clearing.cleared_plan import clearance_notes
from dualarm_cli.clearing.torque_shapes import reshaped_within_torques
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinds.planning import SectionBuilder, SectionTools, kind_of, with_needs
from dualarm_cli.model.job import Task
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.motion.builder import Motion
from dualarm_cli.orders.decided_jobs import own_rules
from dualarm_cli.orders.model.buffer_numbers import with_levels_after
from dualarm_cli.orders.orders import PairedSearch
from dualarm_cli.orders.watch import Watch
from dualarm_cli.planning.decided_plan import in_time, job_notes, platform_notes, schedule_of
from dualarm_cli.planning.planned_job import PlannedJob
from dualarm_cli.postures.stage_plan import StagePlan
from dualarm_cli.records import dataclass
from dualarm_cli.stages.method import Decided, MethodProblem


@dataclass(frozen=True)
class PlannedSections:
    """Plan of a job with paths or seams."""

    motion: Motion
    """Motion of the whole job."""
    notes: tuple[str, ...]
    """Notes for the reader."""
    clearance_cost: float | None
    """Extra duration due to clearance, without paths [s]."""
    stage_plans: list[StagePlan]
    """Stages without paths."""


@dataclass(frozen=True)
class SectionPlanner(SectionTools):
    """Planner of a job's sections."""

    method: Callable[[MethodProblem], Decided]
    """Decides the stages between paths and seams."""
    for_stops: bool = False
    """Flag of decisions made as if tools stopped at lines' ends."""

    @property
    def may_end_better(self) -> bool:
        """Whether blended sections affect following sections or the return."""
        job = self.problem.job
        parts = job.sections() if job.returns else job.sections()[:-1]
        stops = (replace(job, tasks=part) for part in parts if not part[0].alone)
        return any(replace(self.problem, job=part_job).blends for part_job in stops)

    def plan(self) -> PlannedSections:
        """Plan the whole job, section after section.

        Raises:
            InfeasibleError: a section has no plan; with the reason.
        """
        job, record = self.problem.job, SectionBuilder()
        robot = job.cell.robot
        if job.is_decided:
            job = with_needs(job)
        position = None if job.start == "free" else np.array(job.start_joints)
        sections = job.sections()
        planner = self
        for section, after in zip(sections, [*sections[1:], ()], strict=True):
            kind = kind_of(section)
            if kind is None or kind.add is None:
                planner._add_stops(record, section, position)
            else:
                # The limits of a path or seam hold for the motion to it as well.
                slowed = replace(planner.problem, job=planner.problem.job.under(section[0].care))
                tools = replace(planner, problem=slowed)
                kind.add(tools, record, section, position, after)
            planner = replace(planner, done=(*planner.done, *section))
            position = record.end
        first = record.begin
        assert position is not None  # a job has at least one task
        if job.returns and np.abs(first - position).max() > 0.0:
            cleared = planner.transfer(position, first)
            motion, reshaped = self.shaped(cleared)
            record.append(motion)
            record.notes += reshaped
            record.count(cleared)
        cost = record.cost if self.check_collisions else None
        whole = record.build(robot)
        notes = (*record.notes, *clearance_notes(record.cleared))
        return PlannedSections(whole, notes, cost, record.stage_plans)

    def _add_stops(
        self,
        record: SectionBuilder,
        section: tuple[Task, ...],
        here: FloatArray | None,
    ) -> None:
        """Append a section of stops, with the buffer contents of finished tasks."""
        problem = self.part(section, here)
        problem = self._ordered(replace(problem, job=with_levels_after(problem.job, self.done)))
        quickest = quickest_for_stops if self.for_stops else quickest_clear
        method, timing, check = self.method, self.timing, self.check_collisions
        cleared = quickest(problem, method, timing, check_collisions=check)
        given = problem, cleared.cleared.motion, cleared.holding
        motion, reshaped = reshaped_within_torques(*given)
        record.append(motion)
        record.notes += reshaped
        record.count(cleared)
        record.stage_plans += cleared.cleared.plans

    def _ordered(self, problem: MethodProblem) -> MethodProblem:
        """Choose arms and order of a section if the file leaves them open."""
        if problem.job.is_decided:
            return problem
        job = own_rules(problem.job)
        watch = Watch(report=problem.progress)
        model, effort, check = problem.model, problem.effort, self.check_collisions
        search = PairedSearch.of(model, job, effort, problem.seed, watch, check_collisions=check)
        return replace(problem, job=search.orders(watch).ranked[0].job)


def sections_plan(work: PlannedJob, watch: Watch) -> Schedule:
    """Plan a job with paths or seams, section after section in the order of its tasks."""
    solve, check = work.method.solve, work.check_collisions
    problem = replace(work.problem, progress=watch.report)
    planner = SectionPlanner(problem, work.settings, work.timing, check, (), solve)
    planned = planner.plan()
    # Sections start where the previous ones end: a faster section may slow down the next.
    if planner.may_end_better:
        with suppress(InfeasibleError):
            rival = replace(planner, for_stops=True).plan()
            if rival.motion.trajectory.duration < planned.motion.trajectory.duration:
                planned = rival
    job, motion = work.job, planned.motion
    kinds = [kind for kind in work.kinds if kind.add is not None]
    notes = (
        *job.notes,
        *(work.replaced if planned.stage_plans else ()),
        *(note for kind in kinds for note in kind.notes(job, work.settings, motion.trajectory)),
        *job_notes(job),
        *dict.fromkeys(planned.notes),
        *(platform_notes(work.model, planned.stage_plans) if planned.stage_plans else ()),
    )
    schedule = schedule_of(work, job, motion, notes)
    return in_time(replace(schedule, clearance_cost=planned.clearance_cost), job)
