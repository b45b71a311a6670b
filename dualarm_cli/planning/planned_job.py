"""Resolved jobs: solvers, kinematics, kinds of work and order rules before the search."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Literal

from dualarm_cli.effort import EFFORTS, EffortSettings
from dualarm_cli.errors import InfeasibleError, InputError, UnsupportedError
from dualarm_cli.kinds.planning import KindPlanning, kinds_of
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.dynamics import limits_torques
from dualarm_cli.model.blending import BLENDINGS, Blending
from dualarm_cli.model.job import Job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.job_faults import job_faults
from dualarm_cli.planning.redundancy_choice import check_follower
from dualarm_cli.planning.room_rules import RoomRules
from dualarm_cli.postures import REDUNDANCY_SOLVERS
from dualarm_cli.records import dataclass
from dualarm_cli.registry import Solver
from dualarm_cli.stages.method import Decided, MethodProblem
from dualarm_cli.stages.methods import METHODS
from dualarm_cli.stages.refinement import refined_sequence
from dualarm_cli.stages.serving import (
    NUMERIC,
    SEQUENCE,
    cell_model,
    served_settings,
    why_redundancy_unserved,
)
from dualarm_cli.timing import TIMING_SOLVERS, TimingSolver

Route = Literal["sections", "paired", "own clocks"]


@dataclass(frozen=True)
class PlannedJob:
    """Job with everything that depends on its robot and settings alone."""

    job: Job
    """Variant to plan: straight parts of lines where they are blended, rules of order added."""
    settings: PlanSettings
    """Settings that serve the robot."""
    replaced: tuple[str, ...]
    """Notes on solvers taken in place of the defaults."""
    model: CellModel
    """Cell, measured for the redundancy solver."""
    closed_forms: CellModel
    """Cell with the closed forms of all arms that have one, for what is proven."""
    method: Solver[MethodProblem, Decided]
    """Method that decides the stages."""
    timing: TimingSolver
    """Timing of transfers and lines."""
    kinds: tuple[KindPlanning, ...]
    """Kinds of work among the tasks."""
    check_collisions: bool
    """Flag of plans that have to be collision-free."""
    limits_torques: bool
    """Flag of plans that have to stay within the joints' torques."""

    @property
    def effort(self) -> EffortSettings:
        """Settings of the effort."""
        return EFFORTS[self.settings.effort]

    @property
    def blending(self) -> Blending:
        """Rule for passing stops in motion."""
        return BLENDINGS[self.settings.blend]

    @property
    def route(self) -> Route:
        """Planning route: by sections, in synchronous stages, or asynchronously."""
        if self.job.in_sections:
            return "sections"
        is_paired = self.job.mode == "paired" or any(kind.synchronous for kind in self.kinds)
        return "paired" if is_paired else "own clocks"

    @cached_property
    def problem(self) -> MethodProblem:
        """Problem of the method without collision checking."""
        settings = self.settings
        return MethodProblem(
            self.model,
            self.job,
            settings.redundancy,
            settings.effort,
            settings.seed,
            blending=self.blending,
            limits_torques=self.limits_torques,
            refine=refined_sequence if settings.platform == SEQUENCE else None,
            compares_care=settings.platform == SEQUENCE,
        )

    @property
    def guessed(self) -> Job:
        """Job with moving targets at their expected positions, for the search for orders."""
        job = self.job
        for kind in self.kinds:
            job = kind.guessed(job)
        return job

    def with_job(self, job: Job) -> PlannedJob:
        """Return the same for another order or assignment of the tasks."""
        return replace(self, job=job)

    def with_effort(self, effort: str) -> PlannedJob:
        """Return the same at another effort."""
        return replace(self, settings=replace(self.settings, effort=effort))


def resolve(job: Job, settings: PlanSettings, *, check_collisions: bool = True) -> PlannedJob:
    """Resolve a job, or refuse one that no search can plan.

    Args:
        job: cell and tasks.
        settings: names of method and solvers, and tunables.
        check_collisions: whether plans have to be collision-free.

    Raises:
        UnknownSolverError: a solver that its family does not have.
        UnsupportedError: a robot or a limit that a chosen solver does not serve.
        InputError: tasks that refer to missing items.
        InfeasibleError: a target, start or part that makes every plan impossible.
    """
    robot = job.cell.robot
    settings, replaced = served_settings(settings, robot)
    timing = TIMING_SOLVERS[settings.timing]
    REDUNDANCY_SOLVERS[settings.redundancy]  # an unknown name is refused before any work
    method = METHODS[settings.platform]
    if reason := timing.why_unsupported(robot.limits):
        raise UnsupportedError(f"timing {timing.name} cannot plan {robot.name}: {reason}")
    reason = why_redundancy_unserved(settings.redundancy, robot)
    if reason and "redundancy" in settings.named:
        raise UnsupportedError(
            f"redundancy {settings.redundancy} cannot plan {robot.name}: {reason}"
        )
    model = closed = cell_model(job.cell, settings.redundancy)
    if settings.redundancy == NUMERIC:
        closed = CellModel.from_cell(job.cell)
    job = BLENDINGS[settings.blend].straight(job)
    kinds = tuple(kinds_of(job))
    of_settings = tuple(replaced), model, closed, method, timing, kinds, check_collisions
    work = PlannedJob(job, settings, *of_settings, limits_torques(job.cell))
    if reason := method.why_unsupported(work.problem):
        raise UnsupportedError(f"platform {method.name} cannot plan {robot.name}: {reason}")
    if job.in_sections:
        check_follower(job, settings.follower)
        if wrong := [fault for kind in kinds for fault in kind.check(job)]:
            raise InputError(wrong)
    rules = RoomRules.of(job) if check_collisions else None
    if faults := job_faults(job, closed, check_collisions=check_collisions, rules=rules):
        raise InfeasibleError(*faults)
    return work if rules is None else work.with_job(rules.ruled())
