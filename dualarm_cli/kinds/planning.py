"""Interface of kinds of work to the planner, and sections that are planned alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import field, replace
from typing import Any

import numpy as np

from dualarm_cli.clearing.clear_plan import quickest_clear
from dualarm_cli.clearing.cleared_plan import ClearedPlan
from dualarm_cli.clearing.torque_shapes import reshaped_within_torques
from dualarm_cli.errors import Diagnostic
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import arccos
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.kinds import of_kinds
from dualarm_cli.model.job import Job, PoseTarget, Task
from dualarm_cli.model.lying import lying_throughout
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.part_flow import TILT_SPARE
from dualarm_cli.model.place import Place
from dualarm_cli.model.schedule import DURATION
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.motion.builder import Motion, MotionBuilder
from dualarm_cli.notes import Note
from dualarm_cli.postures.stage_plan import StagePlan
from dualarm_cli.records import dataclass
from dualarm_cli.registry import Registry
from dualarm_cli.stages.method import Decided, MethodProblem
from dualarm_cli.timing import TimingSolver
from dualarm_cli.timing.composition import drawn_out

SECTION_START = "(where the section before ended)"
"""Name of the posture in which a section starts."""

Section = tuple[Task, ...]
"""Tasks planned together: a path, a seam, or all tasks between two of these."""
ToolPoses = Mapping[str, PoseTarget]
"""Poses of tools at rest, by arm; unknown poses are missing."""


def tilt_faults(
    job: Job, kind: str, along: Callable[[Job, Section, float], ToolPoses]
) -> Iterator[Diagnostic]:
    """Find tools that lean more than their task allows on paths or seams.

    Args:
        job: as read from its file.
        kind: path or seam.
        along: poses of tools at a fraction of one.
    """
    for section in job.sections():
        if (work := getattr(section[0], kind)) is not None:
            yield from _leaning(job, section, along, work.place)


def _leaning(
    job: Job, section: Section, along: Callable[[Job, Section, float], ToolPoses], place: Place
) -> Iterator[Diagnostic]:
    limits = {task.arm: task.care.tilt for task in section if task.care.tilt < np.inf}
    shares = np.linspace(0.0, 1.0, 257)  # a tool of a path turns smoothly between its points
    poses = [along(job, section, share) for share in shares.tolist() if limits]
    for arm, limit in limits.items():
        targets = [target for each in poses if (target := each.get(arm)) is not None]
        up = np.array([target.pose.rotation[2] for target in targets])
        about: dict[str, Any] = {"task": section[0].id}
        if not targets or (targets[0].free_yaw and norm(up[:, :2], axis=1).max() > 1e-6):
            message = (
                f"tilt: the attitude of the {arm} tool is left open here, so that nothing says how far it leans; fix "
                "its turns and the pose of the part, or remove tilt"
            )
        else:
            angle = float(arccos(np.clip(product(up, up[0]), -1.0, 1.0)).max())
            most = limit - TILT_SPARE
            if angle <= most:
                continue
            about |= {"value": angle, "allowed": most}
            message = (
                f"tilt: the {arm} tool leans {np.degrees(angle):.1f} deg from its attitude at the start, and "
                f"{np.degrees(most):.1f} deg are allowed; turn the poses, or raise tilt"
            )
        yield Diagnostic(*place.order, "E300", message, about=about)


@dataclass
class SectionBuilder(MotionBuilder):
    """Plan of the sections so far, with its notes."""

    notes: list[str] = field(default_factory=list)
    """Notes for the reader."""
    stage_plans: list[StagePlan] = field(default_factory=list)
    """Stages of stops."""
    cleared: list[tuple[ClearedPlan, int]] = field(default_factory=list)
    """Collision-free plans, each with the number of its first stage, from 1."""
    cost: float = 0.0
    """Total cost of avoiding collisions, without paths [s]."""

    def count(self, plan: ClearedPlan) -> None:
        """Record the collision-free plan of the motion that was appended last."""
        first = len(self.stages) - len(plan.cleared.plans) + 1
        self.cost += plan.cost or 0.0
        self.cleared.append((plan, first))


@dataclass(frozen=True)
class SectionTools:
    """Planner of one section."""

    problem: MethodProblem
    """Problem of the whole job."""
    settings: PlanSettings
    """Names of the requested solvers."""
    timing: TimingSolver
    """Timing solver of transfers and lines."""
    check_collisions: bool
    """Whether collisions are checked."""
    done: tuple[Task, ...]
    """Tasks of the sections before."""

    def transfer(self, start: FloatArray, goal: FloatArray) -> ClearedPlan:
        """Plan the collision-free motion of all joints between two configurations (n,) [rad or m]."""
        problem = self.part((), start)
        limits = problem.job.limits
        duration = float(limits.law.duration(goal - start))
        stage = StagePlan(start, goal, goal, {}, "transfer", duration)
        decided, check = Decided([stage]), self.check_collisions
        return quickest_clear(problem, lambda _: decided, self.timing, check_collisions=check)

    def shaped(self, transfer: ClearedPlan) -> tuple[Motion, list[Note]]:
        """Give a transfer beyond joint torques another shape, with notes."""
        problem = self.part((), None)
        return reshaped_within_torques(problem, transfer.cleared.motion, transfer.holding)

    def part(self, tasks: tuple[Task, ...], start: FloatArray | None) -> MethodProblem:
        """Restrict the problem to some tasks and a start, None for any start."""
        job = self.problem.job
        posture = "free" if start is None else SECTION_START
        lying = lying_throughout(job, self.done, tasks)
        job = replace(job, tasks=tasks, start=posture, begin=start, returns=False, lying=lying)
        return replace(self.problem, job=job)


@dataclass(frozen=True)
class KindPlanning:
    """Interface of one kind of work to the planner."""

    works: Callable[[Task], bool]
    """Test of tasks of this kind."""
    guessed: Callable[[Job], Job] = lambda job: job
    """Estimate of the job for the search of orders and stages."""
    decided: Callable[[Job], Job] = lambda job: job
    """Completion of a job whose order is decided, or InfeasibleError."""
    synchronous: Note | None = None
    """Note for `mode: free` if both arms still start each stage together."""
    quickest: Callable[..., ClearedPlan] | None = None
    """Planner of collision-free stages that replaces `quickest_clear`, with the same parameters."""
    solvers: Registry[Any] | None = None
    """Family of solvers for `--redundancy`, or None."""
    setting: str = ""
    """Name of the settings' field for that solver."""
    does: str = ""
    """Verb phrase for messages about these solvers: follows paths."""
    check: Callable[[Job], Sequence[Diagnostic]] = lambda job: ()
    """Check of a job for missing methods and limits."""
    notes: Callable[[Job, PlanSettings, Trajectory], list[str]] = lambda job, settings, motion: []
    """Notes on a plan with work of this kind."""
    unbounded: Note | None = None
    """Reason for the missing lower bound, or None."""
    add: (
        Callable[[SectionTools, SectionBuilder, Section, FloatArray | None, Section], None] | None
    ) = None
    """Planner of one section; None for tasks that are planned with others.

    It appends the section, given the current configuration and the next section.
    """
    opens: Callable[[Section], float] = lambda section: 0.0
    """Earliest begin of a section [s]."""
    along: Callable[[Job, Section, float], ToolPoses] = lambda job, section, share: {}
    """Known tool poses at a fraction of a section, 0 to 1.

    At its ends they are those of its lines' outer ends.
    """
    least_transfer: Callable[[Job, Section], float] = lambda job, section: 0.0
    """Lower bound on the transfer to a section, from the file alone [s]."""
    least: Callable[[Job, Section], float] = lambda job, section: 0.0
    """Lower bound on the duration of a section [s]."""

    def ends(self, job: Job, section: Section) -> tuple[ToolPoses, ToolPoses]:
        """Return the known tool poses at both ends of a section."""
        return self.along(job, section, 0.0), self.along(job, section, 1.0)


def kinds_of(job: Job) -> list[KindPlanning]:
    """Select the kinds of work that occur in a job."""
    kinds: list[KindPlanning] = of_kinds("planning")
    return [kind for kind in kinds if any(map(kind.works, job.tasks))]


def families() -> list[tuple[KindPlanning, Registry[Any]]]:
    """List the kinds of work that have a family of solvers, with it."""
    return [(kind, kind.solvers) for kind in of_kinds("planning") if kind.solvers is not None]


def kind_of(section: Section) -> KindPlanning | None:
    """Find the kind of work that plans a section; None for stops."""
    kinds: list[KindPlanning] = of_kinds("planning")
    return next((kind for kind in kinds if kind.add is not None and kind.works(section[0])), None)


def with_needs(job: Job) -> Job:
    """Complete a decided job with the stops and checks of every kind.

    Raises:
        InfeasibleError: its order violates a requirement of a kind.
    """
    for kind in of_kinds("planning"):
        job = kind.decided(job)
    return job


def drawn_out_transfer(motion: Motion, duration: float) -> Motion:
    """Stretch a transfer to a longer duration [s] on the same path."""
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
    """Append the transfer to a path; its stage becomes that of the path.

    Args:
        record: the plan so far.
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
