"""Planner: route, lower effort, file order and lower bound of a job."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import TypeVar

from dualarm_cli.background import BackgroundCall
from dualarm_cli.bound.bound import LowerBound, bound_note, no_bound
from dualarm_cli.bound.job_bound import JobBound
from dualarm_cli.effort import TrialEffort, less_effort
from dualarm_cli.errors import BlockedError, InfeasibleError
from dualarm_cli.model.job import Job
from dualarm_cli.model.motion.trajectory import SAME_TIME
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.notes import is_about
from dualarm_cli.orders.decided_jobs import by_one_arm, file_order, stage_by_stage
from dualarm_cli.orders.watch import SeenEnoughError, Watch
from dualarm_cli.planning.decided_plan import decided_plan
from dualarm_cli.planning.notes import effort_note, grasp_note, order_note
from dualarm_cli.planning.planned_job import PlannedJob, Route, resolve

T = TypeVar("T")


def plan(job: Job, settings: PlanSettings, watch: Watch | None = None) -> Schedule:
    """Plan a job and bound its cycle time from below; see `plan_without_bound`.

    Args:
        job: cell and tasks.
        settings: names of method and solvers, and tunables.
        watch: receives what is being done, and may end a search for orders early.
    """
    watch = watch or Watch(limit=settings.time_limit)
    if not job.chooses_grasps:
        return _with_bound(job, settings, watch)
    from dualarm_cli.planning.grasps import quickest_by_grasps

    def unbounded(decided: Job) -> Schedule:
        return _with_bound(decided, settings, watch, is_bounded=False)

    schedule, decided = quickest_by_grasps(job, settings, watch, unbounded)
    watch.report("computing the lower bound")
    work = resolve(decided, settings)
    bound = JobBound(decided, work.closed_forms, work.kinds, settings.effort, work.blending)
    least = _until_seen_enough(watch, bound.value) or no_bound(bound_note("interrupted"))
    notes = (*schedule.notes, grasp_note("chosen"), *least.assumptions)
    return replace(schedule, lower_bound=least.value, notes=notes)


def _with_bound(
    job: Job, settings: PlanSettings, watch: Watch, *, is_bounded: bool = True
) -> Schedule:
    """Plan a job with decided grasps, also with less effort, and bound it from below."""
    watch.report("reading the robot")
    work = resolve(job, settings)
    bound = JobBound(job, work.closed_forms, work.kinds, settings.effort, work.blending)
    notes: list[str] = []
    with (
        BackgroundCall(
            bound.value if is_bounded else lambda: LowerBound(None, ()),
            is_long=is_bounded,
            nice=10,
        ) as bounding,
        BackgroundCall(
            lambda: _of_less_effort(work), is_long=bool(_less_efforts(work))
        ) as background,
    ):
        try:
            schedule = _planned(work, watch)
            is_found = True
        except InfeasibleError:
            watch.end()
            watch.report("planning with less effort")
            easier = None if watch.enough() else background.result()
            if easier is None:
                raise
            schedule = _as_asked(easier, settings)
            watch.keep(schedule)
            is_found = False
        watch.report("computing the lower bound")
        least = _until_seen_enough(watch, bounding.result) or no_bound(bound_note("interrupted"))
        if is_found and _less_efforts(work):
            watch.report("planning with less effort")
            easier = None if watch.enough() else _until_seen_enough(watch, background.result)
            if easier is None and watch.enough():
                notes.append(effort_note("interrupted"))
            elif easier is not None and easier.duration < schedule.duration - SAME_TIME:
                schedule = _as_asked(easier, settings, schedule.duration)
    if job.is_decided and settings.time_limit is not None:
        notes.append(order_note("fixed"))
    notes = [*schedule.notes, *notes, *least.assumptions]
    return replace(schedule, lower_bound=least.value, notes=tuple(notes))


def plan_without_bound(
    job: Job, settings: PlanSettings, watch: Watch | None = None, *, check_collisions: bool = True
) -> Schedule:
    """Plan a job without a lower bound: order, platform angles, postures and motion.

    Args:
        job: cell and tasks.
        settings: names of method and solvers, and tunables.
        watch: receives what is being done, and may end a search for orders early.
        check_collisions: whether collisions are checked; without, methods are compared for their speed alone.

    Raises:
        UnknownSolverError: a solver that its family does not have.
        UnsupportedError: a robot or a limit that a chosen solver does not serve.
        InfeasibleError: no posture reaches a target, or nothing that was found is collision-free.
    """
    watch = watch or Watch(limit=settings.time_limit)
    if job.chooses_grasps:
        from dualarm_cli.planning.grasps import quickest_by_grasps

        return quickest_by_grasps(
            job,
            settings,
            watch,
            lambda decided: plan_without_bound(
                decided, settings, watch, check_collisions=check_collisions
            ),
        )[0]
    watch.report("reading the robot")
    return _planned(resolve(job, settings, check_collisions=check_collisions), watch)


def _planned(work: PlannedJob, watch: Watch) -> Schedule:
    """Plan a resolved job; if interrupted, return the best plan so far."""
    watch.best_plan = None
    schedule = _until_seen_enough(watch, lambda: _by_route(work, watch))
    watch.end()
    schedule = schedule or watch.best_plan
    assert schedule is not None  # nothing else is dropped
    notes: list[str] = []
    for kind in work.kinds:
        if kind.add is None:
            notes += kind.notes(work.job, work.settings, schedule.trajectory)
        if work.job.mode == "free" and kind.synchronous and not work.job.in_sections:
            notes.append(kind.synchronous)
    if watch.stopped:
        notes.append(order_note("ended_early", why=watch.stopped))
    schedule = replace(schedule, notes=(*schedule.notes, *notes))
    watch.keep(schedule)
    return schedule


def _by_route(work: PlannedJob, watch: Watch) -> Schedule:
    """Plan a job by its route; prefer the file's order unless it is slower.

    The file's order is not planned if the times of the search show that it is far slower.
    """
    best: Schedule | None = None
    failure: InfeasibleError | None = None
    try:
        best = ROUTES[work.route](work, watch)
    except InfeasibleError as error:
        failure = error
    filed = file_order(work.job)
    if filed is not None and not filed.is_decided and isinstance(failure, BlockedError):
        # The search for its arms would meet the same again, but for weight that no arm carries.
        filed = None if failure.stages or failure.unheld else filed
    if best is not None and _is_slower_as_filed(best, watch, work.effort.trials):
        filed = None
    if filed is not None and (best is None or not watch.stop()):
        watch.report("planning the file's order")
        with suppress(InfeasibleError):
            given = ROUTES[work.route](work.with_job(filed), watch)
            if best is None or given.duration < best.duration:
                # What is proven of arms in a given order is not proven of all orders.
                kept = [note for note in given.notes if not is_about(note, "order")]
                notes = (*kept, order_note("of_file"))
                best = replace(given, order_grid_gap=None, notes=notes)
    best = best or _by_one_arm(work, watch)
    if best is None:
        assert failure is not None  # nothing else leaves none
        raise failure
    return best


def _by_one_arm(work: PlannedJob, watch: Watch) -> Schedule | None:
    """Plan a short job whose open tasks one arm does; return the faster plan, or None.

    The grid of a search for orders has few postures, and may leave one arm for each task.

    Raises:
        BlockedError: it fails by the weight of a part alone.
    """
    plans, heavy = [], list[BlockedError]()
    for job in by_one_arm(work.job) if _is_short(work) else ():
        if not watch.stop():
            watch.report("planning the tasks of either arm by one arm")
            try:
                plans.append(ROUTES[work.route](work.with_job(job), watch))
            except InfeasibleError as error:
                heavy += [error] if isinstance(error, BlockedError) and error.unheld else []
    if heavy and not plans:
        from dualarm_cli.planning.ordered_plan import naming_other_arms

        raise naming_other_arms(heavy[0], [pair for error in heavy for pair in error.unheld])
    if not plans:
        return None
    best = min(plans, key=lambda schedule: schedule.duration)
    return replace(best, notes=(*best.notes, order_note("one_arm")))


def _is_slower_as_filed(schedule: Schedule, watch: Watch, trials: TrialEffort) -> bool:
    """Return whether the file's order is expected to be slower than the plan.

    It cannot where the search for stages found it to be slower by far, and the plan is as quick as the search promised.
    """
    if watch.best is None or watch.file_order_best is None:
        return False
    stopping = schedule.duration + (schedule.blend_gain or 0.0)
    return stopping <= watch.best and watch.file_order_best > (1.0 + trials.far_slower) * watch.best


def _by_sections(work: PlannedJob, watch: Watch) -> Schedule:
    """Plan a job with paths or seams."""
    from dualarm_cli.planning.section_plans import quickest_of_sections

    return quickest_of_sections(work, watch)


def _in_stages(work: PlannedJob, watch: Watch) -> Schedule:
    """Plan a job whose arms start each stage together."""
    job = work.guessed if work.job.mode == "paired" else stage_by_stage(work.guessed)
    if job.is_decided:
        return decided_plan(work, job, watch)
    # The searches for orders are many modules, which jobs in the order of their file do without.
    from dualarm_cli.planning.ordered_plan import plan_in_best_order

    return plan_in_best_order(work, job, watch, watch.keep)


def _by_own_clocks(work: PlannedJob, watch: Watch) -> Schedule:
    """Plan a job whose arms are asynchronous."""
    from dualarm_cli.planning.free_ordered_plan import plan_by_own_clocks

    return plan_by_own_clocks(work, watch)


ROUTES: Mapping[Route, Callable[[PlannedJob, Watch], Schedule]] = {
    "sections": _by_sections,
    "paired": _in_stages,
    "own clocks": _by_own_clocks,
}


def _is_short(work: PlannedJob) -> bool:
    """Check whether an open job has few stops."""
    return sum(len(task.stops) for task in work.job.tasks) <= work.effort.short_stops


def _less_efforts(work: PlannedJob) -> list[str]:
    """List the lower efforts to try: for decided jobs, and short ones without limit."""
    if not work.job.is_decided and (not _is_short(work) or work.settings.time_limit is not None):
        return []
    efforts = []
    less = less_effort(work.settings.effort)
    while less is not None:
        efforts.append(less)
        less = less_effort(less)
    return efforts


def _of_less_effort(work: PlannedJob) -> Schedule | None:
    """Plan a job with each lower effort; return the fastest plan or None."""
    plans = []
    for effort in _less_efforts(work):
        with suppress(InfeasibleError):
            watch = Watch(limit=work.settings.time_limit)
            plans.append(_planned(work.with_effort(effort), watch))
    return min(plans, key=lambda schedule: schedule.duration, default=None)


def _as_asked(easier: Schedule, settings: PlanSettings, duration: float | None = None) -> Schedule:
    """Relabel a plan of lower effort with the requested effort, with a note.

    Args:
        easier: the plan.
        settings: as they were asked for.
        duration: of the plan with the effort asked for [s]; None where it has none.
    """
    settings_then = easier.provenance.settings
    data = {"made": settings_then["effort"], "effort": settings.effort}
    if duration is None:
        note = effort_note("only", **data)
    else:
        note = effort_note("shorter", **data, gain=duration - easier.duration)
    provenance = replace(easier.provenance, settings={**settings_then, "effort": settings.effort})
    return replace(easier, provenance=provenance, notes=(*easier.notes, note))


def _until_seen_enough(watch: Watch, made: Callable[[], T]) -> T | None:
    """Run a planning step until the user interrupts it.

    Returns:
        Its result, or None after an interrupt with a plan to go on with.
    """
    try:
        watch.catching = True
        result = made()
        watch.catching = False
        return result
    except SeenEnoughError:
        watch.catching = False
        if not watch.enough():
            raise  # this is the plan of less effort, and who watches the other one has seen enough
        watch.stop()
        return None
    except InfeasibleError:
        watch.catching = False
        raise
