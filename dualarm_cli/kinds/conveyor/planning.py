"""Plans with targets on conveyors: guessed where they are met, planned as if they stood there, corrected, again.

Parts that move with a belt, and bodies that come too near to them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from dualarm_cli.clearing.clear_plan import quickest_clear
from dualarm_cli.clearing.cleared_plan import ClearedPlan
from dualarm_cli.clearing.stage_samples import KEPT, StageSamples, stage_samples
from dualarm_cli.collision.clearance import CellClearance
from dualarm_cli.collision.quick_test import OVERLAP
from dualarm_cli.collision.rooms import RoomKey, rooms_of
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.kinds.conveyor.meeting import ConveyorMeeting, MissedError, Times, met_times
from dualarm_cli.kinds.planning import KindPlanning
from dualarm_cli.model.job import Job, Stop, Task
from dualarm_cli.model.joint_motion import SAME_TIME
from dualarm_cli.notes import Note
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
    """Numbers that steer the planning of targets on belts."""

    rounds: int = 4
    """So often a plan is made at most."""
    guesses: int = 2
    """Number of plans of a simple method that correct the meeting places.

    They precede the method itself.
    """
    shares: tuple[float, ...] = (0.5, 0.2, 0.8)
    """Shares of all windows at which parts are guessed to be met at first; the next one where one cannot be reached."""
    same_place: float = 0.08
    """A guess that is off by less than this leads to about the same postures [m]."""
    late: float = 1e-9
    """An arm that is later than its part by no more is there in time [s]."""


BELT = BeltSettings()

NO_SENSITIVITY = Note(
    "sensitivity: none for tasks with conveyors: faster arms would meet parts elsewhere",
    "sensitivity",
)
"""Note on assumed limits."""
NO_CONVEYOR_BOUND = Note("lower bound: none for tasks with conveyors", "lower bound")
"""Note where parts move: a bound is of parts that stand, and those may be nearer when they are met."""
FREE = Note(
    "mode: free: with conveyors, both arms start each stage together in this version", "mode"
)
"""Note on asynchronous arms."""
PERIOD = "conveyors: the cycle repeats every {seconds:.3f} s, so each part must arrive with the same period"
"""Sentence of cycles."""


def conveyor_notes(job: Job, duration: float) -> list[str]:
    """List notes on a plan with conveyors that takes a duration [s]."""
    period = Note.of({"period": PERIOD}, "conveyors", "period", seconds=duration)
    return [NO_SENSITIVITY, period] if job.returns else [NO_SENSITIVITY]


def guessed(job: Job, share: float = 0.5) -> Job:
    """Returns a job in which every target on a conveyor is where it is at a share of its window, the middle."""
    middles: dict[tuple[str, str], float] = {
        (task.id, stop.action): stop.belt.passes + share * (stop.belt.last - stop.belt.passes)
        for task in job.tasks
        for stop in task.stops
        if stop.belt is not None
    }
    return met_at(job, middles)


def met_at(job: Job, times: Times) -> Job:
    """Returns a job in which targets on conveyors are where they are at some times, within their windows."""

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
    progress: Callable[[str], None],
    *,
    clear: bool,
) -> ClearedPlan:
    """Returns the quickest plan found of a method in which every part on a conveyor is met in its window.

    A simple method plans as if parts stood in the middle of their windows. Then it is known about when the arms can be
    there, and the method itself plans with the parts where they are then. Each plan is corrected so that it meets its
    parts exactly (`ConveyorMeeting`); only where one is met far from where it was guessed it is planned
    anew. Where a repair makes an arm late for its part, that much is added to when it can be there.

    Args:
        problem: what the method is asked; its job says who does what in which order.
        solve: the method.
        timing: how motions are timed.
        progress: receives what is being done.
        clear: whether anything has to be collision-free.

    Raises:
        InfeasibleError: a part that no plan found meets in its window, or what else makes a plan impossible.
    """
    progress("estimating where parts on conveyors are met")
    asked = replace(problem, job=_better_guessed(problem, timing))
    delays: dict[tuple[int, str], float] = {}
    best: ClearedPlan | None = None
    failure: InfeasibleError | None = None
    for _ in range(BELT.rounds):
        meeting = ConveyorMeeting(asked.model, asked.job, timing, dict(delays))
        try:
            found = quickest_clear(asked, _meeting(solve, meeting), timing, progress, clear=clear)
        except MissedError as error:
            # About when parts would be met is known better now.
            failure = failure or error
            better = met_at(asked.job, error.times)
            if _off(asked.job, error.times) <= BELT.same_place:
                break
            asked = replace(asked, job=better)
            continue
        except InfeasibleError as error:
            failure = failure or error
            break
        late = _late(found)
        touched = (
            None
            if late
            else touched_on_belt(met_at(asked.job, met_times(found.cleared.plans)), found)
        )
        if touched is not None:
            failure = failure or InfeasibleError(touched)
        elif not late and (best is None or _length(found) < _length(best)):
            best = found
        times = met_times(found.cleared.plans)
        if not late and _off(asked.job, times) <= BELT.same_place:
            break
        delays = {key: delays.get(key, 0.0) + late.get(key, 0.0) for key in {*delays, *late}}
        progress("planning again with parts where they are met")
        asked = replace(asked, job=met_at(asked.job, times))
    if best is None:
        raise failure or InfeasibleError(Refusal("parts_missed"))
    # How near the method came to the bound of its grid is about parts that stand.
    return replace(best, decided=replace(best.decided, grid_gap=None))


def _better_guessed(problem: MethodProblem, timing: TimingSolver) -> Job:
    """Returns a job in which targets on conveyors are about where a simple plan meets them."""
    method = MINIMUM_TIME if problem.turns_for_both and problem.redundancy != NUMERIC else FIXED
    for share in BELT.shares:
        job, known = guessed(problem.job, share), False
        try:
            for _ in range(BELT.guesses):
                plans = choose_stages(replace(problem, job=job, holding=None), method, refine=False)
                try:
                    times = met_times(ConveyorMeeting(problem.model, job, timing).met(plans))
                except MissedError as error:
                    times = error.times
                job, known = met_at(job, times), True
        except InfeasibleError:
            if not known:
                continue
        return job
    return guessed(problem.job)


def _meeting(
    solve: Callable[[MethodProblem], Decided], meeting: ConveyorMeeting
) -> Callable[[MethodProblem], Decided]:
    """Returns a method whose plans meet their parts, as far as they can."""

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
            assert simpler is not None  # asked only where there are some
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


def _length(found: ClearedPlan) -> float:
    return found.cleared.duration


def _late(found: ClearedPlan) -> dict[tuple[int, str], float]:
    """Returns by how much arms come too late for their parts, what earlier ones make later left out [s].

    By number of the stage and arm.
    """
    events = {(e.arm, e.task, e.action): e.time for e in found.cleared.motion.events}
    late: dict[tuple[int, str], float] = {}
    before = 0.0
    for k, plan in enumerate(found.cleared.plans):
        here = []
        for name, stop in plan.stops.items():
            if stop.stop.belt is None:
                continue
            behind = events[name, stop.task.id, stop.stop.action] - stop.stop.belt.at
            if behind > before + BELT.late:
                late[k, name] = behind - before
            here.append(max(0.0, behind))
        # Where a part was waited for in between, what was late before is made up for.
        before = max(here, default=before)
    return late


def _off(job: Job, times: Times) -> float:
    """Returns how far targets on conveyors are at some times at most from where a job has them [m]."""
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
    together=FREE,
    quickest=quickest_meeting,
    notes=lambda job, settings, motion: conveyor_notes(job, motion.duration),
    unbounded=NO_CONVEYOR_BOUND,
)


def touched_on_belt(job: Job, found: ClearedPlan) -> Refusal | None:
    """Find the first stage without clearance from a part on a belt, or None.

    On its lines, the tool that picks or places the part may touch it; up to its neighbouring stops no more than that.

    Args:
        job: decided, with its targets where they are met.
        found: its plan.
    """
    rooms = rooms_of(job, moving=True)
    motion, holding = found.cleared.motion, found.holding
    if not rooms or holding is None:
        return None
    cell = CellClearance.of(job.cell, job.carried(), rooms=rooms)
    events = {(e.task, e.action): e for e in motion.events}
    stage_of: dict[RoomKey, int] = {
        (stop.task.id, stop.stop.action): k
        for k, plan in enumerate(found.cleared.plans)
        for stop in plan.stops.values()
    }
    for k, stage in enumerate(motion.stages):
        samples = stage_samples(motion, k, k, holding)
        time = np.minimum(stage.start + samples.step * np.arange(len(samples.position)), stage.end)
        for r, room in enumerate(rooms):
            event = events[room.key]
            there = time < event.time - SAME_TIME
            if room.stop.action == "place":
                there = time >= event.changes_held
            assert room.stop.belt is not None  # it moves
            gone = (time - room.stop.belt.at)[:, None] * room.stop.belt.conveyor.velocity
            shift = np.einsum("ij,nj->ni", job.cell.base.rotation.T, gone)
            since = k - stage_of[room.key]
            touching = {event.arm: since == 0} if since in (0, 1) else {}
            if worst := _worst(cell, r, samples, there, shift, touching):
                one, other, lack, row = worst
                more = {"one": one, "other": other, "when": float(time[row] - stage.start)}
                more |= {"stage": k + 1, "partner": [], "standing": [], "tried": []}
                return Refusal(
                    "stage_touches", room.stop.place, room.task.id, event.arm, lack, more=more
                )
    return None


def _worst(
    cell: CellClearance,
    r: int,
    samples: StageSamples,
    there: BoolArray,
    shift: FloatArray,
    touching: Mapping[str, bool],
) -> tuple[str, str, float, int] | None:
    """Find the bodies that lack most clearance, the lack [m] and the row.

    None where all is clear. Arms in `touching` may touch the part, at will on their lines where it says so.
    """
    for a, arm in enumerate(cell.arms):
        held = cell.loads.in_first_scene(samples.held[:, a])
        for number in np.unique(held[there]).tolist():
            rows, load = np.flatnonzero(there & (held == number)), cell.loads.load(number)
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
