"""The main job: a job and settings in, an unverified schedule out."""

from __future__ import annotations

from collections.abc import Callable

from dualarm_cli import __version__
from dualarm_cli.errors import InfeasibleError, UnsupportedError
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Provenance, Schedule, ScheduleRobot
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.motion import realise
from dualarm_cli.planning.stages import StagePlan, choose_stages
from dualarm_cli.platform_angle import PLATFORM_SOLVERS
from dualarm_cli.redundancy import REDUNDANCY_SOLVERS
from dualarm_cli.timing import TIMING_SOLVERS


def plan(
    job: Job, settings: PlanSettings, progress: Callable[[str], None] = lambda _: None
) -> Schedule:
    """Returns the schedule of a job: decisions by closed forms, then exact motion.

    With no platform solver named, the job is decided with each before postures are refined, and planned with
    the fastest; after refinement another one may be a few percent ahead.

    Args:
        job: cell and tasks.
        settings: solver names and tunables.
        progress: is told what is being done.

    Raises:
        UnknownSolverError: a solver that its family does not have.
        UnsupportedError: a robot or a limit that a chosen solver does not serve.
        InfeasibleError: no posture reaches a target.
    """
    timing = TIMING_SOLVERS[settings.timing]
    REDUNDANCY_SOLVERS[settings.redundancy]  # an unknown name is refused before any work
    if settings.platform is not None:
        PLATFORM_SOLVERS[settings.platform]
    if reason := timing.why_unsupported(job.cell.robot.limits):
        raise UnsupportedError(
            f"--timing {timing.name} does not serve {job.cell.robot.name}: {reason}"
        )
    progress("reading the robot")
    model = CellModel.from_cell(job.cell)
    names = [settings.platform] if settings.platform else _fitting(model)
    if settings.platform not in (None, "fixed") and not _turns_for_both(model):
        raise UnsupportedError(
            f"--platform {settings.platform} does not serve {job.cell.robot.name}: it is not two arms on "
            "one turning platform; leave the option out"
        )
    stages, notes = _fastest(model, job, names, settings.redundancy, progress)
    progress("timing the motion")
    motion = realise(model, job, stages, timing)
    return Schedule(
        robot=ScheduleRobot.of_job(job),
        trajectory=motion.trajectory,
        stages=motion.stages,
        segments=motion.segments,
        events=motion.events,
        provenance=Provenance(__version__, job.inputs, settings.as_dict(), settings.seed),
        notes=(*job.notes, *_job_notes(job), *notes, *_platform_notes(model, stages)),
    )


def _job_notes(job: Job) -> list[str]:
    """Returns what makes a cycle time look better than the cell's: picks and places that take no time."""
    idle = [
        f"{task.id} ({stop.action})"
        for task in job.tasks
        for stop in task.stops
        if stop.action != "move" and stop.dwell.total == 0.0
    ]
    if not idle:
        return []
    some = ", ".join(idle[:3]) + (", …" if len(idle) > 3 else "")
    return [f"dwell: {len(idle)} picks and places take no time at all ({some}); is that meant?"]


def _turns_for_both(model: CellModel) -> bool:
    """Returns whether there is a platform angle to choose for two arms."""
    return model.platform.is_turntable and len(model.arms) == 2


def _fitting(model: CellModel) -> list[str]:
    """Returns the platform solvers that differ on this robot: one where nothing can be chosen."""
    return PLATFORM_SOLVERS.names if _turns_for_both(model) else ["fixed"]


def _platform_notes(model: CellModel, stages: list[StagePlan]) -> list[str]:
    """Returns what a reader must know of a platform that did not do what its solver says."""
    notes = []
    if model.platform.joints and not model.platform.is_turntable:
        notes.append(
            "platform: held where it starts; this version turns a platform of one revolute joint only"
        )
    reached = [str(k) for k, stage in enumerate(stages, start=1) if stage.solver == "reach"]
    if reached:
        notes.append(
            f"platform: in stages {', '.join(reached)} no angle of the solver lets every arm reach; "
            "the platform turns to the nearest one that does (platform solver: reach)"
        )
    return notes


def _fastest(
    model: CellModel,
    job: Job,
    names: list[str],
    redundancy: str,
    progress: Callable[[str], None],
) -> tuple[list[StagePlan], list[str]]:
    """Returns the stages of the fastest platform solver, and what the others would have needed.

    With several, they are compared by unrefined postures; only the fastest one's are refined.

    Raises:
        InfeasibleError: no solver finds a plan; the last one's reason.
    """
    times: dict[str, float] = {}
    failure: InfeasibleError | None = None
    for name in names if len(names) > 1 else ():
        progress(f"comparing platform solvers: {name}")
        try:
            stages = choose_stages(model, job, name, redundancy, refine=False)
        except InfeasibleError as error:
            failure = error
        else:
            times[name] = sum(stage.duration for stage in stages)
    if failure is not None and not times:
        raise failure
    # Equal to a microsecond is equal: then the first of the family, which turns the platform least.
    best = min(times, key=lambda name: round(times[name], 6)) if times else names[0]
    progress(f"choosing postures (platform: {best})")
    stages = choose_stages(model, job, best, redundancy)
    if len(names) == 1:
        return stages, []
    tried = ", ".join(f"{name} {time:.3f} s" for name, time in times.items())
    return stages, [
        f"platform: {best} is the fastest by estimate (before postures are refined: {tried})"
    ]
