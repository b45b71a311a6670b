"""Plans of asynchronous arms in the best orders; the fastest plan wins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.effort import EffortSettings
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.motion.builder import Motion
from dualarm_cli.orders.decided_jobs import stage_by_stage
from dualarm_cli.orders.free_orders import FreeOrder, FreeOrders, free_orders
from dualarm_cli.orders.messages import check_reach, grid_gap
from dualarm_cli.orders.model.order_model import OrderModel
from dualarm_cli.orders.model.tool_changes import with_changes
from dualarm_cli.orders.watch import Watch
from dualarm_cli.planning.asynchronous.free_epochs import (
    FreeEpochs,
    epoch_orders,
    plan_epochs,
)
from dualarm_cli.planning.asynchronous.free_plan import FreePlanner
from dualarm_cli.planning.decided_plan import in_time, job_notes, schedule_of
from dualarm_cli.planning.notes import mode_note, order_bound_note, order_note
from dualarm_cli.planning.ordered_plan import plan_in_best_order
from dualarm_cli.planning.planned_job import PlannedJob


def plan_by_own_clocks(work: PlannedJob, watch: Watch) -> Schedule:
    """Plan asynchronous arms in the best orders; return the fastest plan.

    The platform stands at one angle while both arms work, or at several ones after another; where neither is quicker,
    both arms start each stage together, as synchronous arms do.

    Args:
        work: the resolved job.
        watch: receives progress, and may end the search.

    Raises:
        InfeasibleError: neither is possible.
    """
    problem = replace(work.problem, progress=watch.report)
    settings, effort, check = work.settings, work.effort, work.check_collisions
    planner = FreePlanner(problem, work.method.solve, work.timing, check)
    watch.begin()
    watch.report("timing each task at every platform angle")
    order = OrderModel.of(problem.model, problem.job, check_collisions=check)
    check_reach(order)
    orders = free_orders(order, settings.effort, settings.seed, watch)
    turns, total = bool(problem.model.platform_columns), np.inf
    best: Schedule | None = None
    for number, candidate in enumerate(_worth_planning(orders, effort)):
        most = 1 if len(candidate.job.tasks) > effort.trials.long else effort.clocks.planned
        if best is not None and (watch.stop() or number >= most):
            break
        try:
            decided = with_changes(candidate.job)
            order_planner = replace(planner, problem=replace(problem, job=decided))
            schedule = _schedule(work, order_planner.plan(candidate.angle), decided)
        except InfeasibleError:
            continue
        if best is None or schedule.duration < best.duration:
            best = replace(schedule, order_grid_gap=grid_gap(orders.bound, candidate.total))
            total = candidate.total
            watch.keep(_noted(best, free_notes(orders, total, None, turns=turns)))
    epochs, rail = None, problem.model.platform.is_rail
    if (best is None or not watch.stop()) and _turns(problem.model):
        most, excess = effort.clocks.planned_epochs, effort.trials.promising
        longest = np.inf if best is None else (1.0 + excess) * orders.ranked[0].total
        for several in epoch_orders(order, settings.effort, settings.seed, watch, most):
            if best is not None and watch.stop():
                break
            if several.total > longest:
                continue
            try:
                watch.report(f"planning with {len(several.epochs)} platform angles")
                schedule = _schedule(work, plan_epochs(planner, several), several.job)
            except InfeasibleError:
                continue
            if best is None or schedule.duration < best.duration:
                best, epochs = schedule, several
                watch.keep(_noted(best, epoch_notes(several, None, rail=rail)))
    synchronous = None
    why = [_why_synchronous(best, turns=turns)]
    if best is None or (not watch.enough() and _may_be_quicker(work, best)):
        watch.report("planning both arms in synchronous stages")
        try:
            job = stage_by_stage(with_changes(problem.job))
            synchronous = plan_in_best_order(
                work, job, watch, lambda schedule: watch.keep(_noted(schedule, why))
            )
        except InfeasibleError:
            if best is None:
                raise
    if best is None or (synchronous is not None and synchronous.duration < best.duration):
        assert synchronous is not None
        return _noted(synchronous, why)
    if epochs is None:
        return _noted(best, free_notes(orders, total, synchronous, turns=turns))
    return _noted(best, epoch_notes(epochs, synchronous, rail=rail))


def _schedule(work: PlannedJob, motion: Motion, job: Job) -> Schedule:
    """Build the schedule of a decided variant and check its time windows."""
    notes = (*work.job.notes, *work.replaced, *job_notes(job))
    return in_time(schedule_of(work, job, motion, notes), work.job)


def _noted(schedule: Schedule, notes: list[str]) -> Schedule:
    """Append notes to a schedule."""
    return replace(schedule, notes=(*schedule.notes, *notes))


def _turns(model: CellModel) -> bool:
    """Return whether several platform positions suit two asynchronous arms."""
    return model.platform.is_chosen and len(model.arms) > 1


def _why_synchronous(asynchronous: Schedule | None, *, turns: bool) -> str:
    """Return the reason for stage-by-stage arms, as text."""
    if asynchronous is None:
        return mode_note("no_own_clocks", turns=turns)
    return mode_note("synchronous_faster", turns=turns, duration=asynchronous.duration)


def _may_be_quicker(work: PlannedJob, schedule: Schedule) -> bool:
    """Return whether synchronous arms may be faster, thanks to platform turns or less waiting."""
    if _turns(work.model):
        return True
    waits = [
        sum(
            part.end - part.start
            for part in schedule.segments
            if part.arm == arm and part.kind == "wait"
        )
        for arm in work.model.arms
    ]
    return min(waits) > work.effort.clocks.waited * schedule.duration


def _worth_planning(orders: FreeOrders, effort: EffortSettings) -> list[FreeOrder]:
    """Select the orders at the best platform angles."""
    if not orders.ranked:
        return []
    most, limit = effort.clocks.tried, (1.0 + effort.trials.promising) * orders.ranked[0].total
    if len(orders.ranked[0].job.tasks) > effort.trials.long:
        return list(orders.ranked[:most])
    # Found orders come the quickest first.
    return [
        *(order for order in orders.ranked if order.total <= limit),
        *(order for order in orders.ranked if order.total > limit),
    ][:most]


def epoch_notes(plan: FreeEpochs, synchronous: Schedule | None, *, rail: bool) -> list[str]:
    """List notes on a plan whose platform stands at several positions."""
    epochs = [
        mode_note(
            "at",
            place=1e3 * place[0] if rail else np.degrees(place[0]),
            unit="mm" if rail else "deg",
            tasks=sum(not task.is_change for task in tasks),
        )
        for place, tasks in plan.epochs
    ]
    stands = mode_note("stands", epochs=epochs, total=plan.total)
    return [stands, *_synchronous_notes(synchronous)]


def _synchronous_notes(synchronous: Schedule | None) -> list[str]:
    if synchronous is None:
        return []
    return [mode_note("synchronous", duration=synchronous.duration)]


def free_notes(
    orders: FreeOrders, total: float, synchronous: Schedule | None, *, turns: bool
) -> list[str]:
    """List notes on a plan with a standing platform.

    Args:
        orders: what the search found.
        total: of the order that was planned, by the search's own times [s].
        synchronous: the plan in synchronous stages, or None.
        turns: whether there is a platform.
    """
    note = mode_note("own_clocks", turns=turns, total=total)
    notes = [note, *_synchronous_notes(synchronous)]
    if orders.exact and total <= orders.ranked[0].total:
        notes.append(order_note("best"))
    elif orders.bound is not None:
        notes.append(order_bound_note("clocks", total=total, bound=orders.bound))
    return notes
