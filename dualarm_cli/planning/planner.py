"""The main job: a job and settings in, an unverified schedule out."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import TypeVar

import numpy as np

from dualarm_cli import __version__
from dualarm_cli.beside import Beside
from dualarm_cli.bound.bound import LowerBound
from dualarm_cli.clearing.clear_plan import quickest_clear
from dualarm_cli.clearing.cleared_plan import clearance_notes
from dualarm_cli.effort import less_effort
from dualarm_cli.errors import BlockedError, InfeasibleError, InputError, UnsupportedError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinds import of_kinds
from dualarm_cli.kinds.planning import kinds_of, with_needs
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import CHANGES, Job
from dualarm_cli.model.joint_motion import lean
from dualarm_cli.model.schedule import Provenance, Schedule, ScheduleRobot
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.motion.builder import Motion
from dualarm_cli.motion.waiting import SAME_TIME
from dualarm_cli.orders.decided_jobs import file_order, stage_by_stage
from dualarm_cli.orders.watch import SeenEnoughError, Watch
from dualarm_cli.planning.job_bound import job_bound
from dualarm_cli.planning.job_faults import job_faults
from dualarm_cli.planning.redundancy_choice import check_follower
from dualarm_cli.planning.room_rules import RoomRules, planned_around
from dualarm_cli.planning.section_plans import quickest_of_sections
from dualarm_cli.postures import REDUNDANCY_SOLVERS
from dualarm_cli.refusals import Refusal
from dualarm_cli.stages.method import MethodProblem
from dualarm_cli.stages.methods import METHODS
from dualarm_cli.stages.plans.problem import Decisions
from dualarm_cli.stages.serving import (
    cell_model,
    served_settings,
    why_redundancy_unserved,
)
from dualarm_cli.stages.stage_by_stage import StagePlan
from dualarm_cli.timing import TIMING_SOLVERS

NOT_BOUNDED = "lower bound: none, as its computation was interrupted"
"""Message where the user had seen enough once there was a plan."""
NOT_EASIER = "effort: less effort might give a shorter plan; its search was interrupted"
"""Message where the user had seen enough before the plan of less effort was there."""
SHORT_STOPS = 24
"""Greatest number of stops of a job that is planned with less effort as well, in another process."""
FAR_SLOWER = 0.08
"""By more than this share the file's order is slower by far, as the search times it."""
OF_THE_FILE = "order: that of the file, whose plan is faster than those of the orders found"
"""Message where a search does no better than the file."""
T = TypeVar("T")
UNLIMITED = "order: --time-limit has no effect, as the task file fixes the order"
"""Message of a time limit where nothing was searched."""


def plan(job: Job, settings: PlanSettings, watch: Watch | None = None) -> Schedule:
    """Returns the schedule of a job with its lower bound; see `plan_without_bound`.

    Args:
        job: cell and tasks.
        settings: names of method and solvers, and tunables.
        watch: receives what is being done, and may end a search for orders early.
    """
    watch = watch or Watch(limit=settings.time_limit)
    blended = settings.blend != "none"
    # Both processes need them: loaded by each, they would take the time of two.
    of_kinds("planning")
    notes: list[str] = []
    with (
        Beside(lambda: job_bound(job, settings.effort, blended=blended)) as bounding,
        Beside(lambda: _of_less_effort(job, settings)) as beside,
    ):
        try:
            schedule = plan_without_bound(job, settings, watch)
            is_found = True
        except InfeasibleError:
            watch.end()
            watch.tell("planning with less effort")
            easier = None if watch.enough() else beside.result()
            if easier is None:
                raise
            schedule = _as_asked(easier, settings)
            watch.keep(schedule)
            is_found = False
        watch.tell("computing the lower bound")
        bound = _until_seen_enough(watch, bounding.result) or LowerBound(None, (NOT_BOUNDED,))
        if is_found and _less_efforts(job, settings):
            watch.tell("planning with less effort")
            easier = None if watch.enough() else _until_seen_enough(watch, beside.result)
            if easier is None and watch.enough():
                notes.append(NOT_EASIER)
            elif easier is not None and easier.duration < schedule.duration - SAME_TIME:
                schedule = _as_asked(easier, settings, schedule.duration)
    if job.is_decided and settings.time_limit is not None:
        notes.append(UNLIMITED)
    notes = [*schedule.notes, *notes, *bound.assumptions]
    return replace(schedule, lower_bound=bound.value, notes=tuple(notes))


def _less_efforts(job: Job, settings: PlanSettings) -> list[str]:
    """List the words of `--effort` with which a short job is planned as well; none where a time limit ends searches."""
    if sum(len(task.stops) for task in job.tasks) > SHORT_STOPS:
        return []
    if settings.time_limit is not None and not job.is_decided:
        return []
    efforts = []
    less = less_effort(settings.effort)
    while less is not None:
        efforts.append(less)
        less = less_effort(less)
    return efforts


def _of_less_effort(job: Job, settings: PlanSettings) -> Schedule | None:
    """Plan a short job with each lesser effort, whose searches take other ways; return the quickest plan or None."""
    plans = []
    for effort in _less_efforts(job, settings):
        with suppress(InfeasibleError):
            plans.append(plan_without_bound(job, replace(settings, effort=effort)))
    return min(plans, key=lambda schedule: schedule.duration, default=None)


def _as_asked(easier: Schedule, settings: PlanSettings, duration: float | None = None) -> Schedule:
    """Return a plan of less effort as that of the effort asked for, with a note.

    Args:
        easier: the plan.
        settings: as they were asked for.
        duration: of the plan with the effort asked for [s]; None where it has none.
    """
    made = easier.provenance.settings
    why = f"{settings.effort} found none"
    if duration is not None:
        why = f"it is {duration - easier.duration:.2g} s shorter than that of {settings.effort}"
    note = f"effort: the plan of {made['effort']} effort was taken, as {why}"
    provenance = replace(easier.provenance, settings={**made, "effort": settings.effort})
    return replace(easier, provenance=provenance, notes=(*easier.notes, note))


def _until_seen_enough(watch: Watch, made: Callable[[], T]) -> T | None:
    """Returns what is made; None where the user has seen enough before, and there is a plan to go on with."""
    try:
        watch.catching = True
        found = made()
        watch.catching = False
        return found
    except SeenEnoughError:
        watch.catching = False
        if not watch.enough():
            raise  # this is the plan of less effort, and who watches the other one has seen enough
        watch.stop()
        return None
    except InfeasibleError:
        watch.catching = False
        raise


def _in_time(schedule: Schedule, job: Job) -> Schedule:
    """Returns a schedule after checking that nothing is done too late.

    Raises:
        InfeasibleError: a task whose window closes before it is done.
    """
    tasks = {task.id: task for task in job.tasks}
    # Of a task's events the last one counts.
    done = {e.task: e.time for e in sorted(schedule.events, key=lambda e: e.time)}
    late = [
        Refusal(
            "late",
            task.place,
            name,
            task.arm,
            done[name],
            task.not_after,
            more={"late": done[name] - task.not_after},
        )
        for name, task in tasks.items()
        if name in done and done[name] > task.not_after + 1e-9
    ]
    if late:
        raise InfeasibleError(*late)
    return schedule


def plan_without_bound(
    job: Job,
    settings: PlanSettings,
    watch: Watch | None = None,
    *,
    clear: bool = True,
) -> Schedule:
    """Returns the schedule of a job: who does what in which order, decisions by closed forms, exact motion.

    Args:
        job: cell and tasks.
        settings: names of method and solvers, and tunables.
        watch: receives what is being done, and may end a search for orders early.
        clear: whether anything has to be collision-free; without, methods are compared for their speed alone.

    Raises:
        UnknownSolverError: a solver that its family does not have.
        UnsupportedError: a robot or a limit that a chosen solver does not serve.
        InfeasibleError: no posture reaches a target, or nothing that was found is collision-free.
    """
    watch = watch or Watch(limit=settings.time_limit)
    settings, replaced = served_settings(settings, job.cell.robot)
    timing = TIMING_SOLVERS[settings.timing]
    REDUNDANCY_SOLVERS[settings.redundancy]  # an unknown name is refused before any work
    method = METHODS[settings.platform]
    robot = job.cell.robot
    if reason := timing.why_unsupported(robot.limits):
        raise UnsupportedError(f"--timing {timing.name} cannot plan {robot.name}: {reason}")
    reason = why_redundancy_unserved(settings.redundancy, robot)
    if reason and "redundancy" in settings.named:
        raise UnsupportedError(
            f"--redundancy {settings.redundancy} cannot plan {robot.name}: {reason}"
        )
    watch.kept = None
    watch.tell("reading the robot")
    model = cell_model(job.cell, settings.redundancy)
    blend = settings.blend != "none"
    if blend:
        job = job.blended()
    problem = MethodProblem(
        model, job, settings.redundancy, settings.effort, settings.seed, blend=blend
    )
    if reason := method.why_unsupported(problem):
        raise UnsupportedError(f"--platform {method.name} cannot plan {robot.name}: {reason}")
    if job.in_sections:
        check_follower(job, settings.follower)
        if wrong := [fault for kind in kinds_of(job) for fault in kind.check(job)]:
            raise InputError(wrong)
    rules = RoomRules.of(job) if clear else None
    if faults := job_faults(job, clear=clear, rules=rules):
        raise InfeasibleError(*faults)
    if rules is not None:
        job = rules.ruled()
        problem = replace(problem, job=job)
    found = _until_seen_enough(
        watch, lambda: _not_slower_than_filed(job, settings, problem, replaced, watch, clear=clear)
    )
    watch.end()
    found = found or watch.kept
    assert found is not None  # nothing else is dropped
    found = _finished(found, job, settings, watch)
    watch.keep(found)
    return found


def _finished(schedule: Schedule, job: Job, settings: PlanSettings, watch: Watch) -> Schedule:
    """Returns the plan of a job with the notes that do not depend on how it was made."""
    notes: list[str] = []
    for kind in kinds_of(job):
        if kind.add is None:
            notes += kind.notes(job, settings, schedule.trajectory)
        if job.mode == "free" and kind.together and not job.in_sections:
            notes.append(kind.together)
    if watch.stopped:
        notes.append(
            f"order: the search ended early, as {watch.stopped}; a longer search may find a faster plan"
        )
    return replace(schedule, notes=(*schedule.notes, *notes))


def _not_slower_than_filed(
    job: Job,
    settings: PlanSettings,
    problem: MethodProblem,
    replaced: list[str],
    watch: Watch,
    *,
    clear: bool,
) -> Schedule:
    """Returns the schedule of a job, in the order of its file where no quicker plan was found of an open one.

    It is not planned where it is far slower by the times of the search.
    """
    found: Schedule | None = None
    failure: InfeasibleError | None = None
    try:
        found = _planned(job, settings, problem, replaced, watch, clear=clear)
    except InfeasibleError as error:
        failure = error
    filed = file_order(job)
    if filed is not None and not filed.is_decided and isinstance(failure, BlockedError):
        filed = None  # the search for its arms would meet the same again
    if found is not None and _is_slower_as_filed(found, watch):
        filed = None
    if filed is not None and (found is None or not watch.stop()):
        watch.tell("planning the file's order")
        own = replace(problem, job=filed)
        with suppress(InfeasibleError):
            given = _planned(filed, settings, own, replaced, watch, clear=clear)
            if found is None or given.duration < found.duration:
                # What is proven of arms in a given order is not proven of all orders.
                notes = [note for note in given.notes if not note.startswith("order: ")]
                found = replace(given, order_grid_gap=None, notes=(*notes, OF_THE_FILE))
    if found is None:
        assert failure is not None  # nothing else leaves none
        raise failure
    return found


def _is_slower_as_filed(found: Schedule, watch: Watch) -> bool:
    """Returns whether the file's order cannot be expected to be quicker than a plan that was found of an open one.

    It cannot where the search for stages found it to be slower by far, and the plan is as quick as the search promised.
    """
    if watch.best is None or watch.filed is None:
        return False
    stopping = found.duration + (found.blend_gain or 0.0)
    return stopping <= watch.best and watch.filed > (1.0 + FAR_SLOWER) * watch.best


def _planned(
    job: Job,
    settings: PlanSettings,
    problem: MethodProblem,
    replaced: list[str],
    watch: Watch,
    *,
    clear: bool,
) -> Schedule:
    """Returns the schedule of a job by the way that serves it."""
    model, method, timing = (
        problem.model,
        METHODS[settings.platform],
        TIMING_SOLVERS[settings.timing],
    )
    if job.in_sections:
        return quickest_of_sections(
            problem.model,
            job,
            settings.effort,
            watch,
            lambda one: _in_time(
                _with_paths(one, settings, problem, replaced, watch.tell, clear=clear), job
            ),
        )

    def decided(one: Job, start: Decisions | None = None, patient: bool = True) -> Schedule:
        own = replace(problem, start=start, patient=patient, job=with_needs(one))
        return _in_time(_decided_plan(own, settings, replaced, watch, clear=clear), job)

    def paired(one: Job, keep: Callable[[Schedule], None] = watch.keep) -> Schedule:
        if one.is_decided:
            return decided(one)
        # The searches for orders are many modules, which jobs in the order of their file do without.
        from dualarm_cli.planning.ordered_plan import plan_in_best_order

        return planned_around(
            one,
            lambda job: plan_in_best_order(job, settings, model, watch, decided, keep, clear=clear),
        )

    own = job
    for kind in kinds_of(job):
        own = kind.guessed(own)
    if job.mode == "paired":
        return paired(own)
    if any(kind.together for kind in kinds_of(job)):
        return paired(stage_by_stage(own))
    from dualarm_cli.planning.asynchronous.free_plan import FreePlanner
    from dualarm_cli.planning.free_ordered_plan import plan_by_own_clocks

    planner = FreePlanner(problem, method.solve, timing, watch.tell, clear)

    def schedule(motion: Motion, one: Job) -> Schedule:
        found = _schedule(one, settings, motion, (*job.notes, *replaced, *_job_notes(one)))
        return _in_time(found, job)

    return plan_by_own_clocks(planner, settings, watch, paired, schedule)


def _decided_plan(
    problem: MethodProblem,
    settings: PlanSettings,
    replaced: list[str],
    watch: Watch,
    *,
    clear: bool,
) -> Schedule:
    """Returns the schedule of a job whose arms and order are given."""
    job, method, timing = problem.job, METHODS[settings.platform], TIMING_SOLVERS[settings.timing]
    progress = watch.tell
    progress(f"deciding platform angles and postures ({method.name})")
    quickest = next((one.quickest for one in kinds_of(job) if one.quickest), quickest_clear)
    found = quickest(problem, method.solve, timing, progress, clear=clear)
    stages, motion = found.cleared.plans, found.cleared.motion
    notes = (
        *job.notes,
        *replaced,
        *_job_notes(job),
        *_platform_notes(problem.model, stages),
        *clearance_notes([(found, 1)]),
    )
    schedule = _schedule(job, settings, motion, notes)
    return replace(
        schedule,
        grid_gap=found.decided.grid_gap,
        clearance_cost=found.cost,
    )


def _schedule(job: Job, settings: PlanSettings, motion: Motion, notes: tuple[str, ...]) -> Schedule:
    """Returns the schedule of a motion."""
    robot = ScheduleRobot.of_job(job)
    return Schedule(
        robot=robot,
        motion=lean(motion.trajectory, robot.groups, _named_times(motion)),
        stages=motion.stages,
        segments=motion.segments,
        events=motion.events,
        provenance=Provenance(__version__, job.inputs, settings.as_dict(), settings.seed),
        blend_gain=motion.gain,
        notes=notes,
    )


def _named_times(motion: Motion) -> dict[str, FloatArray]:
    """Returns the times at which something is said of each arm [s], which are to be knots of its group."""
    times: dict[str, list[float]] = {}
    for event in motion.events:
        times.setdefault(event.arm, []).append(event.time)
    for part in motion.segments:
        times.setdefault(part.arm, []).extend((part.start, part.end))
    return {arm: np.array(some) for arm, some in times.items()}


def _with_paths(
    job: Job,
    settings: PlanSettings,
    problem: MethodProblem,
    replaced: list[str],
    progress: Callable[[str], None],
    *,
    clear: bool,
) -> Schedule:
    """Returns the schedule of a job with paths, planned section after section."""
    method, timing = METHODS[settings.platform], TIMING_SOLVERS[settings.timing]
    from dualarm_cli.planning.sections import SectionPlanner

    planner = SectionPlanner(
        replace(problem, job=job),
        settings,
        timing,
        progress,
        clear,
        (),
        method.solve,
    )
    planned = planner.plan()
    # Sections begin where the ones before end: what is quicker by itself may cost more afterwards.
    if planner.may_end_better:
        with suppress(InfeasibleError):
            other = replace(planner, for_stops=True).plan()
            if other.motion.trajectory.duration < planned.motion.trajectory.duration:
                planned = other
    motion = planned.motion
    kinds = [kind for kind in kinds_of(job) if kind.add is not None]
    notes = (
        *job.notes,
        *(replaced if planned.stage_plans else ()),
        *(note for kind in kinds for note in kind.notes(job, settings, motion.trajectory)),
        *_job_notes(job),
        *dict.fromkeys(planned.notes),
        *(_platform_notes(problem.model, planned.stage_plans) if planned.stage_plans else ()),
    )
    return replace(_schedule(job, settings, motion, notes), clearance_cost=planned.clearance_cost)


def _job_notes(job: Job) -> list[str]:
    """Returns what makes a cycle time look better than the cell's: picks and places that take no time."""
    idle = [
        f"{task.id} ({stop.action})"
        for task in job.tasks
        for stop in task.stops
        if stop.action in CHANGES and stop.dwell.total == 0.0
    ]
    if not idle:
        return []
    some = ", ".join(idle[:3]) + (", …" if len(idle) > 3 else "")
    verb = "pick or place takes" if len(idle) == 1 else "picks and places take"
    return [f"dwell: {len(idle)} {verb} no time ({some}); check `dwell` in the task file"]


def _platform_notes(model: CellModel, stages: list[StagePlan]) -> list[str]:
    """Returns what a reader must know of a platform that did not do what its solver says."""
    notes = []
    if model.platform.joints and not model.platform.is_chosen:
        notes.append(
            "platform: held where it starts; a platform of one joint is moved between stages: freeze the others"
        )
    reached = [str(k) for k, stage in enumerate(stages, start=1) if stage.solver == "reach"]
    if reached:
        angles, turns, angle = "angles", "turns", "angle"
        if model.platform.is_rail:
            angles, turns, angle = "positions", "moves", "position"
        notes.append(
            f"platform: in stages {', '.join(reached)} the solver's {angles} do not let every arm reach; "
            f"the platform {turns} to the nearest {angle} that does (platform solver: reach)"
        )
    return notes
