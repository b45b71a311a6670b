"""Planner of paths, each with its transfer, from the start that makes both quickest."""

from __future__ import annotations

from dataclasses import field
from functools import partial

import numpy as np

from dualarm_cli.clearing.cleared_plan import ClearedPlan
from dualarm_cli.errors import Diagnostic, InfeasibleError, did_you_mean
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinds.path.context import PathContext
from dualarm_cli.kinds.path.following import PATH_SOLVERS
from dualarm_cli.kinds.path.messages import path_job_notes, path_notes, why_not
from dualarm_cli.kinds.path.motion import (
    FollowedPath,
    Follower,
    InstantBudget,
    Refused,
    is_clear,
    quickest_path,
    touching_path,
)
from dualarm_cli.kinds.path.starts import path_starts
from dualarm_cli.kinds.planning import (
    KindPlanning,
    Section,
    SectionBuilder,
    SectionTools,
    ToolPoses,
    add_transfer,
    tilt_faults,
)
from dualarm_cli.kinematics.dynamics import Dynamics
from dualarm_cli.kinematics.whole_body import Reached
from dualarm_cli.model.job import Job, PoseTarget, Task
from dualarm_cli.model.process_work import PathWork
from dualarm_cli.model.schedule import Event, Segment
from dualarm_cli.motion.builder import MotionBuilder
from dualarm_cli.postures.holding import Holding
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal


@dataclass(frozen=True)
class PathTrials:
    """Limits on starts and refusals of one path."""

    longest: float = 1800.0
    """Longest duration of a path that is planned [s]."""
    alike: int = 3
    """Number of consecutive starts, too fast at one place, that end the search."""
    same_place: float = 0.02
    """Spread of failures below which they are at one place [fraction of the path]."""
    far_too_fast: float = 1.2
    """Factor too fast above which failures at one place end the search."""
    cheap: float = 0.1
    """Cost of a collision-free transfer up to which no other start is tried [s].

    It applies to efforts with
    `spares`."""
    most_starts: int = 16
    """Maximum number of starts that are tried for a path."""
    most_stuck: int = 3
    """Maximum number of stuck starts that are tried slower.

    Less speed may help there, but the method does not report how much less.
    """


TRIALS = PathTrials()


def check_paths(job: Job) -> list[Diagnostic]:
    """Check a job's paths for unknown methods, missing torque limits and long durations.

    Args:
        job: as read from its file.
    """
    names_by_place = {
        task.path.place: task.path.redundancy
        for task in job.tasks
        if task.path is not None and task.path.redundancy not in (None, *PATH_SOLVERS.names)
    }
    findings = [
        Diagnostic(
            place.file,
            place.line,
            place.column,
            "E300",
            f"redundancy: no method '{name}' follows paths{did_you_mean(str(name), PATH_SOLVERS.names)}; known: "
            f"{', '.join(PATH_SOLVERS.names)}",
        )
        for place, name in names_by_place.items()
    ]
    torque_places = {
        task.path.place for task in job.tasks if task.path is not None and task.path.torque
    }
    if torque_places and (unknown := Dynamics(job.cell).unknown):
        findings += [
            Diagnostic(
                place.file,
                place.line,
                place.column,
                "E300",
                "torque: limited needs a torque limit (effort) and masses in the URDF; missing for "
                f"{', '.join(unknown)}",
            )
            for place in torque_places
        ]
    for task in job.tasks:
        if task.path is None:
            continue
        place, length = task.path.place, task.path.length
        speed = task.path.speed * job.under(task.care).speed
        least = length / speed
        if least > TRIALS.longest:
            message = (
                f"{length * 1e3:.4g} mm at {speed * 1e3:.4g} mm/s take {least:.4g} s, but at "
                f"most {TRIALS.longest:g} s are planned; raise the speed"
            )
            about = {"task": task.id, "value": least, "allowed": TRIALS.longest}
            findings.append(Diagnostic(*place.order, "E300", message, about=about))
    findings += tilt_faults(job, "path", path_poses)
    return list(dict.fromkeys(findings))


def add_path(
    tools: SectionTools,
    record: SectionBuilder,
    section: Section,
    current: FloatArray | None,
    after: Section,
) -> None:
    """Append a path with the transfer to its start.

    Args:
        tools: the planner.
        record: the plan so far.
        section: the path's tasks, one per following arm.
        current: joints before the path [rad or m], shape (n,); None for any.
        after: the section after it.

    Raises:
        InfeasibleError: it cannot be followed.
    """
    work = section[0].path
    assert work is not None
    problem = tools.problem
    limited = problem.limits_torques
    context = PathContext.of(problem.model, problem.job, limits_torques=limited)
    name = tools.settings.follower or work.redundancy or default_follower(context)
    tools.problem.progress(f"following {section[0].id} ({name})")
    search = PathSearch(tools, context, work, PATH_SOLVERS[name], current)
    nearest = search.run()
    if search.best is None:
        raise InfeasibleError(
            why_not(section, work, name, search.refusals, nearest, context.limits)
        )
    transfer, path = search.best
    begin = record.clock
    if transfer is not None:
        motion, notes = tools.shaped(transfer)
        add_transfer(record, motion, section)
        record.notes += notes
        record.count(transfer)
    add_followed(record, context, section, path, name, begin)
    record.notes += path_notes(context, section[0].id, path, name)


@dataclass
class PathSearch:
    """Search for the start that makes a path and the transfer to it quickest."""

    tools: SectionTools
    """Planner of transfers."""
    context: PathContext
    """The job."""
    work: PathWork
    """The path."""
    follower: Follower
    """Method that follows it."""
    current: FloatArray | None
    """Joints before the path [rad or m], shape (n,); None for any."""
    best: tuple[ClearedPlan | None, FollowedPath] | None = None
    """Quickest path with the transfer to its start."""
    accepted: int = 0
    """Number of starts with a collision-free path and transfer."""
    budget: InstantBudget = field(default_factory=InstantBudget)
    """Remaining budget of trials."""
    refusals: list[Refused] = field(default_factory=list)
    """Failed trials."""
    stuck: list[tuple[float, FloatArray]] = field(default_factory=list)
    """Pairs of followed fraction and start for which an unknown lower speed may help."""

    def run(self) -> Reached:
        """Try starts at reported speeds, then stuck ones slower; return the nearest posture."""
        problem = self.tools.problem
        start = (
            np.array(problem.job.cell.robot.postures["home"])
            if self.current is None
            else self.current
        )
        check = self.tools.check_collisions
        holding = Holding.of(self.tools.part((), start).job) if check else None
        is_free = None if holding is None else partial(is_clear, holding)
        starts = path_starts(self.context, self.work, start, problem.seed, is_free)
        for q in starts.configurations[: TRIALS.most_starts]:
            if self._try(q, holding, halve=False):
                break
        if self.best is None and not self.budget.spent and self.work.slower:
            for _, q in sorted(self.stuck, key=lambda trial: -trial[0])[: TRIALS.most_stuck]:
                if self._try(q, holding, halve=True):
                    break
        return starts.nearest

    def _try(self, q: FloatArray, holding: Holding | None, *, halve: bool) -> bool:
        """Follow the path from a start; return whether the search is over."""
        path = quickest_path(self.context, self.work, self.follower, q, self.budget, halve)
        if isinstance(path, Refused):
            self.refusals.append(path)
            if path.remedy == "slower" and np.isinf(path.excess):
                self.stuck.append((path.share, q))
            return _fail_at_one_place(self.refusals) or self.budget.spent
        touching = None if holding is None else touching_path(holding, path)
        if touching is not None:
            self.refusals.append(touching)
            return False
        transfer = None
        if self.current is not None and np.abs(q - self.current).max() > 0.0:
            try:
                transfer = self.tools.transfer(self.current, q)
            except InfeasibleError as error:
                reason = Refusal("no_way_to_path", data={"cause": error})
                self.refusals.append(Refused(reason, 0.0, "clear"))
                return False
        if self.best is None or _time(transfer, path) < _time(*self.best):
            self.best = transfer, path
        self.accepted += 1
        effort = self.tools.problem.settings
        cheap = transfer is None or (transfer.cost or 0.0) <= TRIALS.cheap
        return self.accepted >= effort.section_starts or (effort.spares and cheap)


def _fail_at_one_place(refusals: list[Refused]) -> bool:
    """Test whether the last starts failed at one place, far too fast."""
    last = refusals[-TRIALS.alike :]
    places = [refusal.share for refusal in last]
    same = max(places) - min(places) < TRIALS.same_place
    much = all(
        refusal.remedy == "slower" and refusal.excess > TRIALS.far_too_fast for refusal in last
    )
    return len(last) == TRIALS.alike and same and much


def _time(transfer: ClearedPlan | None, followed: FollowedPath) -> float:
    """Compute the duration of a path with its transfer [s]."""
    transfer_time = 0.0 if transfer is None else transfer.cleared.motion.trajectory.duration
    return transfer_time + followed.trajectory.duration


def default_follower(context: PathContext) -> str:
    """Select the follower of paths that name none.

    It is exact and within limits by construction.
    """
    return "arm_angle" if context.model.has_arm_angles else "manipulability"


def path_poses(job: Job, section: Section, share: float) -> ToolPoses:
    """Return the tools' poses at a fraction of a path, 0 to 1."""
    work = section[0].path
    assert work is not None
    return {arm: PoseTarget(path.pose(share * path.length)) for arm, path in work.paths.items()}


def least_time(job: Job, section: Section) -> float:
    """Compute a path's least duration [s]: its length at the requested speed."""
    work = section[0].path
    assert work is not None
    return work.length / (work.speed * job.under(section[0].care).speed)


PLANNING = KindPlanning(
    works=lambda task: task.path is not None,
    solvers=PATH_SOLVERS,
    setting="follower",
    does="follows paths",
    check=check_paths,
    notes=lambda job, settings, motion: path_job_notes(job, settings.platform, motion),
    add=add_path,
    along=path_poses,
    least=least_time,
)


def add_followed(
    record: MotionBuilder,
    context: PathContext,
    section: tuple[Task, ...],
    followed: FollowedPath,
    name: str,
    begin: float,
) -> None:
    """Append the stage, segments and events of a path.

    Args:
        record: the plan so far.
        context: the job.
        section: the path's tasks, one per following arm.
        followed: the followed path.
        name: of the method.
        begin: start of its stage, including the transfer [s].
    """
    clock, end = record.clock, record.clock + followed.trajectory.duration
    followers = {task.arm: task for task in section}
    for arm in context.job.cell.robot.arms:
        task = followers.get(arm.name)
        if task is None:
            record.segments.append(Segment(arm.name, "wait", "", "", clock, end, None, "partner"))
            continue
        record.segments.append(Segment(arm.name, "path", task.id, "path", clock, end))
        path = task.path.paths[arm.name] if task.path is not None else None
        assert path is not None
        pose = path.pose(path.length)
        record.events.append(Event(end, arm.name, task.id, "path", f"{arm.name}_tcp", pose, 0.0))
    transfer = record.take_transfer(begin)
    record.add_whole(followed.trajectory)
    angle = context.model.platform_angle(followed.trajectory.position[-1])
    record.add_work(section[0].id, name, begin, angle, transfer)
