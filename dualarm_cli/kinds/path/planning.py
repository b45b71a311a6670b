"""Paths in the planner: each with the transfer to where it begins, from the start that makes it quickest."""

from __future__ import annotations

from functools import partial

import numpy as np

from dualarm_cli.clearing.cleared_plan import ClearedPlan
from dualarm_cli.effort import EFFORTS
from dualarm_cli.errors import Diagnostic, InfeasibleError, did_you_mean
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinds.path.context import PathContext
from dualarm_cli.kinds.path.following import PATH_SOLVERS
from dualarm_cli.kinds.path.messages import path_job_notes, path_notes, why_not
from dualarm_cli.kinds.path.motion import (
    FollowedPath,
    Refused,
    TrialBudget,
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
)
from dualarm_cli.kinematics.dynamics import Dynamics
from dualarm_cli.model.job import Job, PoseTarget, Task
from dualarm_cli.model.schedule import Event, Segment
from dualarm_cli.motion.builder import MotionBuilder
from dualarm_cli.postures.holding import Holding
from dualarm_cli.refusals import Refusal

LONGEST = 1800.0
"""Longest time of a path that is planned [s]."""
ALIKE, SAME_PLACE, FAR_TOO_FAST = 3, 0.02, 1.2
"""So many starts that are too fast at the same place, to this share of the path, by this factor, speak for all."""
CHEAP = 0.1
"""What keeping a transfer clear may cost for no other start to be looked at [s]."""
MOST_STARTS = 16
"""So many starts of a path are tried."""
MOST_STUCK = 3
"""So many of those from which less speed may help, but how much less is not known, are tried slower."""


def check_paths(job: Job) -> list[Diagnostic]:
    """Returns what paths ask for that there is not: a method, or torque limits; and those that take too long.

    Args:
        job: of a file.
    """
    found = {
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
        for place, name in found.items()
    ]
    asks = {task.path.place for task in job.tasks if task.path is not None and task.path.torque}
    if asks and (unknown := Dynamics(job.cell).unknown):
        findings += [
            Diagnostic(
                place.file,
                place.line,
                place.column,
                "E300",
                "torque: limited needs a torque limit (effort) and masses in the URDF; missing for "
                f"{', '.join(unknown)}",
            )
            for place in asks
        ]
    for task in job.tasks:
        if task.path is None:
            continue
        place, length = task.path.place, task.path.length
        least = length / (task.path.speed * job.speed)
        if least > LONGEST:
            message = (
                f"{length * 1e3:.4g} mm at {task.path.speed * job.speed * 1e3:.4g} mm/s take {least:.4g} s, but at "
                f"most {LONGEST:g} s are planned; raise the speed"
            )
            about = {"task": task.id, "value": least, "allowed": LONGEST}
            findings.append(Diagnostic(*place.order, "E300", message, about=about))
    return list(dict.fromkeys(findings))


def add_path(
    tools: SectionTools,
    record: SectionBuilder,
    section: Section,
    here: FloatArray | None,
    after: Section,
) -> None:
    """Appends a path with the transfer to its start.

    Args:
        tools: what it is planned with.
        record: what is planned so far.
        section: the path's tasks, one per arm that follows.
        here: where the robot is [rad or m], shape (n,); None for anywhere.
        after: the section after it.

    Raises:
        InfeasibleError: it cannot be followed.
    """
    work = section[0].path
    assert work is not None
    task = section[0].id
    context = PathContext.of(tools.problem.model, tools.problem.job)
    name = tools.settings.follower or work.redundancy or default_follower(context)
    follower = PATH_SOLVERS[name]
    tools.progress(f"following {task} ({name})")
    home = np.array(tools.problem.job.cell.robot.postures["home"])
    start = home if here is None else here
    holding = Holding.of(tools.part((), start).job) if tools.clear else None
    refusals: list[Refused] = []
    looked_at, budget = 0, TrialBudget()
    best: tuple[ClearedPlan | None, FollowedPath] | None = None
    clear = None if holding is None else partial(is_clear, holding)
    starts = path_starts(context, work, start, tools.problem.seed, clear)
    stuck: list[tuple[float, FloatArray]] = []
    # From all starts first at full speed or as much less as limits tell; then slower from those where only
    # trying tells how much slower it has to be.
    for halve in (False, True):
        ready = starts.configurations[:MOST_STARTS]
        if halve:
            ready = [q for _, q in sorted(stuck, key=lambda one: -one[0])[:MOST_STUCK]]
        for q in ready:
            found = quickest_path(context, work, follower, q, budget, halve)
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
                    transfer = tools.transfer(here, q)
                except InfeasibleError as error:
                    reason = Refusal("no_way_to_path", more={"cause": error})
                    refusals.append(Refused(reason, 0.0, "clear"))
                    continue
            if best is None or _time(transfer, found) < _time(*best):
                best = transfer, found
            looked_at += 1
            dear = transfer is not None and (transfer.cost or 0.0) > CHEAP
            effort = EFFORTS[tools.problem.effort]
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
    record.notes += path_notes(context, task, found, name)


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


def path_poses(job: Job, section: Section, share: float) -> ToolPoses:
    """Return the tools' poses at a share of a path, 0 to 1."""
    work = section[0].path
    assert work is not None
    return {arm: PoseTarget(path.pose(share * path.length)) for arm, path in work.paths.items()}


def least_time(job: Job, section: Section) -> float:
    """Returns what no plan of a path can beat [s]: its length at the speed that is asked for."""
    work = section[0].path
    assert work is not None
    return work.length / (work.speed * job.speed)


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
    found: FollowedPath,
    name: str,
    begin: float,
) -> None:
    """Append the stage, segments and events of a path.

    Args:
        record: what is planned so far.
        context: the job.
        section: the path's tasks, one per arm that follows.
        found: the path as it is followed.
        name: of the method.
        begin: when its stage begins, with the transfer where there is one [s].
    """
    clock, end = record.clock, record.clock + found.trajectory.duration
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
    record.add_whole(found.trajectory)
    angle = context.model.platform_angle(found.trajectory.position[-1])
    record.add_work(section[0].id, name, begin, angle, transfer)
