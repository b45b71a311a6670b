"""Planning of a job with given arms and order, up to its schedule."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli import __version__
from dualarm_cli.clearing.clear_plan import quickest_clear
from dualarm_cli.clearing.cleared_plan import clearance_notes
from dualarm_cli.clearing.torque_shapes import reshaped_within_torques
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinds.planning import with_needs
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import CHANGES, Job
from dualarm_cli.model.motion.joint_motion import lean
from dualarm_cli.model.schedule import Provenance, Schedule, ScheduleRobot
from dualarm_cli.motion.builder import Motion
from dualarm_cli.motion.torque_limits import within_torques
from dualarm_cli.notes import Note
from dualarm_cli.orders.watch import Watch
from dualarm_cli.planning.notes import dwell_note, platform_note
from dualarm_cli.planning.planned_job import PlannedJob
from dualarm_cli.postures.stage_plan import StagePlan
from dualarm_cli.refusals import Refusal
from dualarm_cli.stages.plans.problem import Decisions


def decided_plan(
    work: PlannedJob,
    job: Job,
    watch: Watch,
    start: Decisions | None = None,
    *,
    repair_touching_stops: bool = True,
) -> Schedule:
    """Plan a variant of a job that says which arm does what in which order.

    Args:
        work: the resolved job.
        job: its variant.
        watch: receives progress.
        start: plan to begin the search with, or None.
        repair_touching_stops: whether stages with colliding stops are re-planned.

    Raises:
        InfeasibleError: every plan collides, or a task finishes too late.
    """
    job = with_needs(job)
    problem = replace(work.problem, start=start, job=job, progress=watch.report)
    problem = replace(problem, repair_touching_stops=repair_touching_stops)
    quickest = next((kind.quickest for kind in work.kinds if kind.quickest), quickest_clear)
    solve, check = work.method.solve, work.check_collisions
    cleared = quickest(problem, solve, work.timing, check_collisions=check)
    stages = cleared.cleared.plans
    motion, reshaped = reshaped_within_torques(problem, cleared.cleared.motion, cleared.holding)
    notes = (
        *job.notes,
        *work.replaced,
        *job_notes(job),
        *platform_notes(work.model, stages),
        *clearance_notes([(cleared, 1)]),
        *reshaped,
    )
    schedule = schedule_of(work, job, motion, notes)
    schedule = replace(schedule, grid_gap=cleared.decided.grid_gap, clearance_cost=cleared.cost)
    return in_time(schedule, work.job)


def schedule_of(work: PlannedJob, job: Job, motion: Motion, notes: tuple[str, ...]) -> Schedule:
    """Build the schedule of a variant's motion, within joint torques."""
    robot, slowed, settings = ScheduleRobot.of_job(job), list[Note](), work.settings
    if work.limits_torques:
        motion, slowed = within_torques(job, motion)
    return Schedule(
        robot=robot,
        motion=lean(motion.trajectory, robot.groups, _named_times(motion)),
        stages=motion.stages,
        segments=motion.segments,
        events=motion.events,
        provenance=Provenance(__version__, job.inputs, settings.as_dict(), settings.seed),
        blend_gain=motion.gain,
        notes=(*notes, *slowed),
    )


def _named_times(motion: Motion) -> dict[str, FloatArray]:
    """Collect each arm's event and segment times [s], which become knots."""
    times: dict[str, list[float]] = {}
    for event in motion.events:
        times.setdefault(event.arm, []).append(event.time)
    for part in motion.segments:
        times.setdefault(part.arm, []).extend((part.start, part.end))
    return {arm: np.array(arm_times) for arm, arm_times in times.items()}


def in_time(schedule: Schedule, job: Job) -> Schedule:
    """Return the schedule unless a task finishes too late.

    Raises:
        InfeasibleError: a task finishes after its time window.
    """
    tasks = {task.id: task for task in job.tasks}
    # A task finishes with its last event.
    done = {e.task: e.time for e in sorted(schedule.events, key=lambda e: e.time)}
    late = [
        Refusal(
            "late",
            task.place,
            name,
            task.arm,
            done[name],
            task.not_after,
            data={"late": done[name] - task.not_after},
        )
        for name, task in tasks.items()
        if name in done and done[name] > task.not_after + 1e-9
    ]
    if late:
        raise InfeasibleError(*late)
    return schedule


def job_notes(job: Job) -> list[str]:
    """List a note on picks and places without a dwell, if any."""
    idle = [
        f"{task.id} ({stop.action})"
        for task in job.tasks
        for stop in task.stops
        if stop.action in CHANGES and stop.dwell.total == 0.0
    ]
    if not idle:
        return []
    shown = [*idle[:3], "…"] if len(idle) > 3 else idle
    return [dwell_note("none", stops=idle, shown=shown)]


def platform_notes(model: CellModel, stages: list[StagePlan]) -> list[str]:
    """List notes on a platform that deviates from its solver."""
    notes: list[str] = []
    if model.platform.joints and not model.platform.is_chosen:
        notes.append(platform_note("held"))
    reached = [k for k, stage in enumerate(stages, start=1) if stage.solver == "reach"]
    if reached:
        data = {"stages": reached, "rail": model.platform.is_rail}
        notes.append(platform_note("reach", **data))
    return notes
