"""Planner of targets on conveyors: guess meeting places, plan with resting parts, correct, repeat.

It also checks clearance from parts that move with a belt.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from dualarm_cli.clearing.clear_plan import quickest_clear
from dualarm_cli.clearing.cleared_plan import ClearedPlan
from dualarm_cli.clearing.stage_samples import KEPT, StageSamples, stage_samples
from dualarm_cli.clearing.torque_shapes import reshaped_within_torques
from dualarm_cli.collision.clearance import CellClearance
from dualarm_cli.collision.quick_test import OVERLAP
from dualarm_cli.collision.rooms import RoomKey, rooms_of
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.kinds.conveyor.meeting import ConveyorMeeting, MissedError, Times, met_times
from dualarm_cli.kinds.planning import KindPlanning
from dualarm_cli.model.job import Job, Stop, Task
from dualarm_cli.model.motion.trajectory import SAME_TIME
from dualarm_cli.motion.builder import Motion
from dualarm_cli.motion.torque_limits import within_torques
from dualarm_cli.notes import Note, NoteTable
from dualarm_cli.postures.stage_plan import StagePlan
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal
from dualarm_cli.stages.method import Decided, MethodProblem
from dualarm_cli.stages.minimum_time_move import MINIMUM_TIME
from dualarm_cli.stages.serving import FIXED, NUMERIC
from dualarm_cli.stages.stage_by_stage import choose_stages
from dualarm_cli.timing import TimingSolver


@dataclass(frozen=True)
class BeltSettings:
    """Settings of the planning of targets on belts."""

    rounds: int = 4
    """Maximum number of plans."""
    guesses: int = 2
    """Number of plans of a simple method that correct the meeting places.

    They precede the method itself.
    """
    shares: tuple[float, ...] = (0.5, 0.2, 0.8)
    """Fractions of all windows that are tried as first guesses of meetings.

    The next one is used where a part cannot be reached.
    """
    same_place: float = 0.08
    """Error of a guess that hardly changes postures [m]."""
    late: float = 1e-9
    """Delay up to which an arm counts as in time [s]."""


BELT = BeltSettings()

NO_SENSITIVITY = Note(
    "sensitivity: none for tasks with conveyors: faster arms would meet parts elsewhere",
    "sensitivity",
)
"""Note on jobs without a sensitivity."""
NO_CONVEYOR_BOUND = Note("lower bound: none for tasks with conveyors", "lower bound")
"""Note on jobs without a lower bound.

A bound is for parts at rest, and moving parts may be nearer when they are met.
"""
FREE = Note(
    "mode: free: with conveyors, both arms start each stage together in this version", "mode"
)
"""Note on asynchronous arms."""
_note = NoteTable(
    "conveyors",
    period="conveyors: the cycle repeats every {seconds:.3f} s, so each part must arrive with the same period",
)


def conveyor_notes(job: Job, duration: float) -> list[str]:
    """List notes on a plan with conveyors that takes a duration [s]."""
    period = _note("period", seconds=duration)
    return [NO_SENSITIVITY, period] if job.returns else [NO_SENSITIVITY]


def guessed(job: Job, share: float = 0.5) -> Job:
    """Place every target on a conveyor at a fraction of its window."""
    middles: dict[tuple[str, str], float] = {
        (task.id, stop.action): stop.belt.passes + share * (stop.belt.last - stop.belt.passes)
        for task in job.tasks
        for stop in task.stops
        if stop.belt is not None
    }
    return met_at(job, middles)


def met_at(job: Job, times: Times) -> Job:
    """Place targets on conveyors where they are at given times, within their windows."""

    def moved_stop(task: Task, stop: Stop) -> Stop:
        time = times.get((task.id, stop.action))
        if time is None or stop.belt is None:
            return stop
        return stop.met(min(max(time, stop.belt.passes), stop.belt.last))

    def moved(task: Task) -> Task:
        return replace(task, stops=tuple(moved_stop(task, stop) for stop in task.stops))

    return replace(job, tasks=tuple(moved(task) for task in job.tasks))


def quickest_meeting(
    problem: MethodProblem,
    solve: Callable[[MethodProblem], Decided],
    timing: TimingSolver,
    *,
    check_collisions: bool,
) -> ClearedPlan:
    """Plan the quickest motion that meets every part on a conveyor in its window.

    A simple method plans with parts in the middle of their windows and so estimates the arms' arrivals. The method
    itself then plans with the parts at their places at those times. Each plan is corrected so that it meets its parts
    exactly (`ConveyorMeeting`), and re-planned only if a part is met far from its guessed place. A delay by a repair or
    by slowing for torques is added to the arm's arrival.

    Args:
        problem: the method's problem, whose job has arms and order decided.
        solve: the method.
        timing: solver of motions.
        check_collisions: whether collisions are checked.

    Raises:
        InfeasibleError: no plan that was found meets some part in its window, or there is no plan.
    """
    problem.progress("estimating where parts on conveyors are met")
    # Every round plans again; a second search in each would take twice the time.
    variant = replace(problem, job=_better_guessed(problem, timing), compares_care=False)
    delays: dict[tuple[int, str], float] = {}
    best: ClearedPlan | None = None
    failure: InfeasibleError | None = None
    for _ in range(BELT.rounds):
        meeting = ConveyorMeeting(
            variant.model,
            variant.job,
            timing,
            dict(delays),
            dynamics={} if variant.limits_torques else None,
        )
        try:
            method = _meeting(solve, meeting)
            plan = quickest_clear(variant, method, timing, check_collisions=check_collisions)
            delayed = _delays(plan, _slowed_motion(variant, plan))
        except MissedError as error:
            # The error has better estimates of the meeting times.
            failure = failure or error
            better = met_at(variant.job, error.times)
            if _largest_shift(variant.job, error.times) <= BELT.same_place:
                break
            variant = replace(variant, job=better)
            continue
        except InfeasibleError as error:
            failure = failure or error
            break
        touched = (
            None
            if delayed
            else belt_collision(met_at(variant.job, met_times(plan.cleared.plans)), plan)
        )
        if touched is not None:
            failure = failure or InfeasibleError(touched)
        elif not delayed and (best is None or _duration(plan) < _duration(best)):
            best = plan
        times = met_times(plan.cleared.plans)
        if not delayed and _largest_shift(variant.job, times) <= BELT.same_place:
            break
        delays = {key: delays.get(key, 0.0) + delayed.get(key, 0.0) for key in {*delays, *delayed}}
        problem.progress("planning again with parts where they are met")
        variant = replace(variant, job=met_at(variant.job, times))
    if best is None:
        raise failure or InfeasibleError(Refusal("parts_missed"))
    # The gap to the grid's bound holds for parts at rest only.
    return replace(best, decided=replace(best.decided, grid_gap=None))


def _better_guessed(problem: MethodProblem, timing: TimingSolver) -> Job:
    """Place targets on conveyors where a simple plan meets them."""
    method = MINIMUM_TIME if problem.turns_for_both and problem.redundancy != NUMERIC else FIXED
    for share in BELT.shares:
        job, has_times = guessed(problem.job, share), False
        try:
            for _ in range(BELT.guesses):
                plans = choose_stages(replace(problem, job=job, holding=None), method, refine=False)
                try:
                    times = met_times(ConveyorMeeting(problem.model, job, timing).met(plans))
                except MissedError as error:
                    times = error.times
                job, has_times = met_at(job, times), True
        except InfeasibleError:
            if not has_times:
                continue
        return job
    return guessed(problem.job)


def _meeting(
    solve: Callable[[MethodProblem], Decided], meeting: ConveyorMeeting
) -> Callable[[MethodProblem], Decided]:
    """Wrap a method so that its plans meet their parts."""

    def met(plans: list[list[StagePlan]]) -> list[list[StagePlan]]:
        good: list[list[StagePlan]] = []
        failure: InfeasibleError | None = None
        for plan in plans:
            try:
                good.append(meeting.met(plan))
            except InfeasibleError as error:
                failure = failure or error
        if not good and failure is not None:
            raise failure
        return good

    def solved(problem: MethodProblem) -> Decided:
        decided = solve(problem)
        first, *others = met([plan for plan in (decided.stages, *decided.alternatives) if plan])
        simpler = decided.simpler

        def met_simpler() -> list[list[StagePlan]]:
            assert simpler is not None  # called only if there are some
            try:
                return met(simpler())
            except InfeasibleError:
                return []

        return replace(
            decided,
            stages=first,
            alternatives=tuple(others),
            simpler=None if simpler is None else met_simpler,
        )

    return solved


def _duration(plan: ClearedPlan) -> float:
    return plan.cleared.duration


def _slowed_motion(problem: MethodProblem, plan: ClearedPlan) -> Motion:
    """Keep the torques of a plan's motion, which may then meet its parts late."""
    motion = plan.cleared.motion
    if problem.limits_torques:
        motion, _ = reshaped_within_torques(problem, motion, plan.holding, late=True)
        motion, _ = within_torques(problem.job, motion, late=True)
    return motion


def _delays(plan: ClearedPlan, motion: Motion) -> dict[tuple[int, str], float]:
    """Compute the delays of arms for their parts without those of earlier stages [s].

    Keys are the number of the stage and the arm.

    Args:
        plan: the plan.
        motion: its motion, perhaps late.
    """
    events = {(e.arm, e.task, e.action): e.time for e in motion.events}
    late: dict[tuple[int, str], float] = {}
    before = 0.0
    for k, stage in enumerate(plan.cleared.plans):
        delays = []
        for name, stop in stage.stops.items():
            if stop.stop.belt is None:
                continue
            behind = events[name, stop.task.id, stop.stop.action] - stop.stop.belt.at
            if behind > before + BELT.late:
                late[k, name] = behind - before
            delays.append(max(0.0, behind))
        # A wait for a part in between absorbs earlier delays.
        before = max(delays, default=before)
    return late


def _largest_shift(job: Job, times: Times) -> float:
    """Compute the largest distance of targets from their places in a job [m]."""
    gaps = (
        stop.belt.conveyor.speed * abs(times[task.id, stop.action] - stop.belt.at)
        for task in job.tasks
        for stop in task.stops
        if stop.belt is not None and (task.id, stop.action) in times
    )
    return max(gaps, default=0.0)


PLANNING = KindPlanning(
    works=lambda task: any(stop.moves for stop in task.stops),
    guessed=guessed,
    synchronous=FREE,
    quickest=quickest_meeting,
    notes=lambda job, settings, motion: conveyor_notes(job, motion.duration),
    unbounded=NO_CONVEYOR_BOUND,
)


def belt_collision(job: Job, plan: ClearedPlan) -> Refusal | None:
    """Find the first stage without clearance from a part on a belt, or None.

    The tool that picks or places the part may touch it on its lines. In the next stage it may be as near as at the
    stop.

    Args:
        job: decided job with its targets at their meeting places.
        plan: its plan.
    """
    rooms = rooms_of(job, moving=True)
    motion, holding = plan.cleared.motion, plan.holding
    if not rooms or holding is None:
        return None
    cell = CellClearance.of(job.cell, job.carried(), rooms=rooms)
    events = {(e.task, e.action): e for e in motion.events}
    stage_of: dict[RoomKey, int] = {
        (stop.task.id, stop.stop.action): k
        for k, stage in enumerate(plan.cleared.plans)
        for stop in stage.stops.values()
    }
    for k, stage in enumerate(motion.stages):
        samples = stage_samples(motion, k, k, holding)
        time = np.minimum(stage.start + samples.step * np.arange(len(samples.position)), stage.end)
        for r, room in enumerate(rooms):
            event = events[room.key]
            is_on_belt = time < event.time - SAME_TIME
            if room.stop.action == "place":
                is_on_belt = time >= event.changes_held
            assert room.stop.belt is not None  # it moves
            travel = (time - room.stop.belt.at)[:, None] * room.stop.belt.conveyor.velocity
            shift = np.einsum("ij,nj->ni", job.cell.base.rotation.T, travel)
            since = k - stage_of[room.key]
            touching = {event.arm: since == 0} if since in (0, 1) else {}
            if worst := _worst(cell, r, samples, is_on_belt, shift, touching):
                body_a, body_b, lack, row = worst
                details = {
                    "body_a": body_a,
                    "body_b": body_b,
                    "when": float(time[row] - stage.start),
                }
                details |= {"stage": k + 1, "partner": [], "standing": [], "tried": []}
                return Refusal(
                    "stage_touches", room.stop.place, room.task.id, event.arm, lack, data=details
                )
    return None


def _worst(
    cell: CellClearance,
    r: int,
    samples: StageSamples,
    is_on_belt: BoolArray,
    shift: FloatArray,
    touching: Mapping[str, bool],
) -> tuple[str, str, float, int] | None:
    """Find the pair of bodies that lacks most clearance.

    Returns the pair, the lack [m] and the row.

    None if all are clear. Arms in `touching` may touch the part, without limit on their lines where the flag is set.
    """
    for a, arm in enumerate(cell.arms):
        held_parts = cell.loads.in_first_scene(samples.held[:, a])
        for number in np.unique(held_parts[is_on_belt]).tolist():
            rows, load = (
                np.flatnonzero(is_on_belt & (held_parts == number)),
                cell.loads.load(number),
            )
            margins, pairs = cell.test.drifting(
                r, arm, load.name, samples.position[rows], shift[rows]
            )
            for margin, pair in zip(margins, pairs, strict=True):
                least = KEPT
                if arm in touching and cell.test.is_on_flange(pair, arm):
                    room = cell.rooms[r]
                    needed = min(-OVERLAP, cell.test.needed(pair, arm, (room.task, room.stop)))
                    least = -np.inf if touching[arm] and load.on_line else needed - pair.required
                k = int(np.argmin(margin))
                if margin[k] < least:
                    return *cell.test.labels(pair), max(0.0, -float(margin[k])), int(rows[k])
    return None
