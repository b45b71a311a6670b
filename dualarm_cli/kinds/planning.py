"""Interface of kinds of work to the planner, and of sections that are planned alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from typing import Any

from dualarm_cli.clearing.clear_plan import quickest_clear
from dualarm_cli.clearing.cleared_plan import ClearedPlan
from dualarm_cli.errors import Diagnostic
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinds import of_kinds
from dualarm_cli.model.job import Job, PoseTarget, Task
from dualarm_cli.model.lying import lying_beside
from dualarm_cli.model.schedule import DURATION
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.motion.builder import Motion, MotionBuilder
from dualarm_cli.notes import Note
from dualarm_cli.postures.stage_plan import StagePlan
from dualarm_cli.records import dataclass
from dualarm_cli.registry import Registry
from dualarm_cli.stages.method import Decided, MethodProblem
from dualarm_cli.timing import TimingSolver
from dualarm_cli.timing.composition import drawn_out

HERE = "(where the section before ended)"
"""Name of the posture in which a section starts."""

Section = tuple[Task, ...]
"""Tasks that are planned together: a path or seam by itself, or all between two of them."""
ToolPoses = Mapping[str, PoseTarget]
"""Poses of tools at rest, by arm; an arm whose pose is not known is missing."""


@dataclass
class SectionBuilder(MotionBuilder):
    """What is planned so far, section by section, and what is to be said of it."""

    notes: list[str] = field(default_factory=list)
    """What a reader should know."""
    stage_plans: list[StagePlan] = field(default_factory=list)
    """The stages of stops."""
    cleared: list[tuple[ClearedPlan, int]] = field(default_factory=list)
    """What had to be collision-free, each with the number of its first stage, from 1."""
    cost: float = 0.0
    """How much longer it is than without clearance, paths not counted [s]."""

    def count(self, found: ClearedPlan) -> None:
        """Notes what keeping the motion that was added last clear costs."""
        first = len(self.stages) - len(found.cleared.plans) + 1
        self.cost += found.cost or 0.0
        self.cleared.append((found, first))


@dataclass(frozen=True)
class SectionTools:
    """What a section of a job that is done alone is planned with."""

    problem: MethodProblem
    """The whole job."""
    settings: PlanSettings
    """Names of solvers that were asked for."""
    timing: TimingSolver
    """How transfers and lines are timed."""
    progress: Callable[[str], None]
    """Receives what is being done."""
    clear: bool
    """Whether anything has to be collision-free."""
    done: tuple[Task, ...]
    """The tasks of the sections before."""

    def transfer(self, here: FloatArray, there: FloatArray) -> ClearedPlan:
        """Returns the motion of all joints from one configuration (n,) to another [rad or m] that is collision-free."""
        problem = self.part((), here)
        limits = problem.job.limits
        duration = float(limits.law.duration(there - here))
        stage = StagePlan(here, there, there, {}, "transfer", duration)
        return quickest_clear(
            problem, lambda _: Decided([stage]), self.timing, self.progress, clear=self.clear
        )

    def part(self, tasks: tuple[Task, ...], here: FloatArray | None) -> MethodProblem:
        """Returns the problem of some of the tasks, starting where the robot is, anywhere for None."""
        job = self.problem.job
        start = "free" if here is None else HERE
        beside = lying_beside(job, self.done, tasks)
        job = replace(job, tasks=tasks, start=start, begin=here, returns=False, beside=beside)
        return replace(self.problem, job=job)


@dataclass(frozen=True)
class KindPlanning:
    """What one kind of work adds to the planner."""

    works: Callable[[Task], bool]
    """Whether a task is of it."""
    guessed: Callable[[Job], Job] = lambda job: job
    """The job as orders are searched and stages decided for it."""
    decided: Callable[[Job], Job] = lambda job: job
    """A job that says who does what in which order, with what that takes besides.

    Raises InfeasibleError where it cannot be.
    """
    together: Note | None = None
    """Note of `mode: free` where both arms go from stage to stage together all the same."""
    quickest: Callable[..., ClearedPlan] | None = None
    """Decides stages and makes them clear, where `quickest_clear` does not; with the same parameters."""
    solvers: Registry[Any] | None = None
    """The family of solvers that `--redundancy` chooses from; None for none."""
    setting: str = ""
    """The field of the settings that names one of them."""
    does: str = ""
    """What they do, in words: follows paths."""
    check: Callable[[Job], Sequence[Diagnostic]] = lambda job: ()
    """What tasks ask for that there is not."""
    notes: Callable[[Job, PlanSettings, Trajectory], list[str]] = lambda job, settings, motion: []
    """What a reader should know of a plan with its work."""
    unbounded: Note | None = None
    """Reason why there is no lower bound with its work; None where there is one."""
    add: (
        Callable[[SectionTools, SectionBuilder, Section, FloatArray | None, Section], None] | None
    ) = None
    """Appends a section from where the robot is, with the next one known as well; None for tasks not done alone."""
    opens: Callable[[Section], float] = lambda section: 0.0
    """When such a section may begin at the earliest [s]."""
    along: Callable[[Job, Section, float], ToolPoses] = lambda job, section, share: {}
    """Known tool poses at a share of such a section, 0 to 1; at its ends those of its lines' outer ends."""
    least_transfer: Callable[[Job, Section], float] = lambda job, section: 0.0
    """How long the transfer to such a section, with what belongs to it, takes at least by the file [s]."""
    least: Callable[[Job, Section], float] = lambda job, section: 0.0
    """What no plan of such a section can beat [s]."""

    def ends(self, job: Job, section: Section) -> tuple[ToolPoses, ToolPoses]:
        """Return the known tool poses where such a section begins and ends."""
        return self.along(job, section, 0.0), self.along(job, section, 1.0)


def kinds_of(job: Job) -> list[KindPlanning]:
    """Returns the kinds of work that any task of a job is of."""
    kinds: list[KindPlanning] = of_kinds("planning")
    return [kind for kind in kinds if any(map(kind.works, job.tasks))]


def families() -> list[tuple[KindPlanning, Registry[Any]]]:
    """Returns the kinds of work that have a family of solvers, with it."""
    return [(one, one.solvers) for one in of_kinds("planning") if one.solvers is not None]


def kind_of(section: Section) -> KindPlanning | None:
    """Returns the kind of work that a section is done alone for; None for stops."""
    kinds: list[KindPlanning] = of_kinds("planning")
    return next((one for one in kinds if one.add is not None and one.works(section[0])), None)


def with_needs(job: Job) -> Job:
    """Returns a decided job with what its order takes besides.

    Raises:
        InfeasibleError: it cannot be.
    """
    for kind in of_kinds("planning"):
        job = kind.decided(job)
    return job


def drawn_out_transfer(motion: Motion, duration: float) -> Motion:
    """Returns a transfer that takes a longer time [s], on the same way."""
    factor = duration / motion.trajectory.duration
    return replace(
        motion,
        trajectory=drawn_out(motion.trajectory, factor),
        stages=tuple(
            replace(s, start=s.start * factor, end=s.end * factor, bottleneck=DURATION)
            for s in motion.stages
        ),
        segments=tuple(
            replace(s, start=s.start * factor, end=s.end * factor) for s in motion.segments
        ),
    )


def add_transfer(record: SectionBuilder, motion: Motion, section: tuple[Task, ...]) -> None:
    """Appends the transfer to where a path begins; its stage becomes that of the path.

    Args:
        record: what is planned so far.
        motion: the transfer, one stage.
        section: the path's tasks, one per arm that follows.
    """
    names = {task.arm: task.id for task in section}
    segments = tuple(
        replace(
            s,
            kind="transfer" if s.kind == "return" else s.kind,
            task=names.get(s.arm, ""),
            action=section[0].stops[0].action if s.arm in names else "",
        )
        for s in motion.segments
    )
    record.append(replace(motion, segments=segments))
