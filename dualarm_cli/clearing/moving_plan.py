"""Plans in which joints move on while tools stand, and the platform while they are on lines, taken where shorter.

One search over the sequence decides both (`stages/leaving`); how far the platform turns on lines is then decided anew
for every transfer as it is really timed (`line_plan`). What counts is the plan as it is timed, blended and
collision-free.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import field, replace

import numpy as np

from dualarm_cli.clearing.blended_plan import blended_plan, has_blends
from dualarm_cli.clearing.cleared_plan import ClearedPlan
from dualarm_cli.clearing.line_plan import TransferMemory, turned_lines_plan
from dualarm_cli.clearing.permissions import permitted, why_not
from dualarm_cli.clearing.repairs import Cleared, Clearing
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.model.job import Job
from dualarm_cli.motion.builder import Motion
from dualarm_cli.motion.dwell_motion import dwell_motions
from dualarm_cli.motion.motion import realise
from dualarm_cli.motion.transfers import Drive
from dualarm_cli.motion.turned_transfers import can_take_over, may_turn
from dualarm_cli.postures.stage_plan import StagePlan
from dualarm_cli.records import dataclass
from dualarm_cli.stages.leaving import Leaving, LeavingSearch, MotionRoom, leaving_of, leaving_plans
from dualarm_cli.stages.method import MethodProblem
from dualarm_cli.stages.plans.problem import SequenceProblem
from dualarm_cli.stages.plans.source import has_closed_form
from dualarm_cli.stages.sequence_problem import sequence_problem
from dualarm_cli.timing import TimingSolver

SHOWN = 5e-4
"""What is gained that is shown [s]."""
OTHER_PLAN = (
    "{keys}: the search also changed postures or platform angles, which saves {other:.3f} s even without this motion; "
    "the gain above leaves that out"
)
"""Message of what is gained besides."""
WORTH = 1e-6
"""What is gained that is worth it [s]."""
SHARES = (1.0, 0.85, 0.7, 0.5)
"""Shares of what changes at a stop that are tried until it fits into the time that is there."""
TRIES = 12
"""So often stages are taken back that collide or become longer."""


def moving_plan(
    problem: MethodProblem,
    found: ClearedPlan,
    timing: TimingSolver,
    progress: Callable[[str], None],
) -> ClearedPlan:
    """Returns a plan in which joints move in dwells and the platform on lines, where tasks allow it and it is shorter.

    Where none is found it is the same plan, which then gains nothing.

    Args:
        problem: what was asked.
        found: the plan in which they stand, blended where the problem allows it.
        timing: how motions are timed.
        progress: receives what is being done.
    """
    if not permitted(problem.job):
        return found
    numbers = sequence_problem(problem.model, problem.job)
    trial = _Trial.of(problem, numbers, found, timing)
    room = trial.room()
    progress("moving platform and arms while tools dwell or are on lines")
    # What the search finds without such motion is not gained by it.
    standing = trial if room is None else trial.improved(room.none, lines=False)
    plans = [standing, standing.turned()]
    if room is not None:
        plans.append(plans[-1].improved(room, lines=True))
    best = min(plans, key=lambda one: _length(one.found))
    best = best if _length(best.found) < _length(standing.found) - WORTH else standing
    return _gaining(problem.job, best.found, standing.found, found)


def _length(found: ClearedPlan) -> float:
    return found.cleared.motion.trajectory.duration


def _gaining(
    job: Job, best: ClearedPlan, standing: ClearedPlan, before: ClearedPlan
) -> ClearedPlan:
    """Returns a plan with what such motion gains, and with the plan that it came from."""
    gain = _length(standing) - _length(best)
    motion = replace(best.cleared.motion, motion_gain=gain)
    other = _length(before) - _length(standing)
    notes = best.decided.notes
    if other > SHOWN:
        keys = " and ".join(permitted(job))
        notes = (*notes, OTHER_PLAN.format(keys=keys, other=other))
    return replace(
        best,
        cleared=replace(best.cleared, motion=motion),
        standing=before.cleared,
        decided=replace(best.decided, notes=notes),
    )


@dataclass(frozen=True)
class _Trial:
    """A plan and what others are compared with it by."""

    problem: MethodProblem
    numbers: SequenceProblem
    found: ClearedPlan
    stopping: Cleared
    start: Leaving
    timing: TimingSolver
    drive: Drive
    clearing: Clearing | None
    transfers: TransferMemory = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        problem: MethodProblem,
        numbers: SequenceProblem,
        found: ClearedPlan,
        timing: TimingSolver,
    ) -> _Trial:
        model, job, known = problem.model, problem.job, found.known
        stopping = found.stopping or found.cleared
        return cls(
            problem,
            numbers,
            found,
            stopping,
            leaving_of(numbers, model, stopping.plans),
            timing,
            Drive.of(model, job, timing, known),
            found.clearing(problem, timing),
        )

    def room(self) -> MotionRoom | None:
        """Returns how long platform and arms may move in each stage and on its lines; None: never for the search."""
        numbers, motion, job = self.numbers, self.found.cleared.motion, self.problem.job
        platform = np.zeros(numbers.stages)
        arms = tuple(np.zeros(numbers.stages) for _ in numbers.arms)
        retracts = {(s.arm, s.task, s.action): s for s in motion.segments if s.kind == "retract"}
        names = [work.name for work in numbers.arms]
        for k, plan in enumerate(self.stopping.plans[: numbers.stages]):
            spans = {}
            for name, one in plan.stops.items():
                event = motion.event_of.get((k, name))
                if event is None or not one.stop.dwell_motion or why_not("dwell_motion", one.stop):
                    continue
                left = retracts.get((name, event.task, event.action))
                away = 0.0 if left is None else left.end - left.start
                spans[name] = event.time, max(event.time, motion.stages[k].end - away)
                arms[names.index(name)][k] = spans[name][1] - event.time
            everyone = len(spans) == len(plan.stops) > 0
            if everyone and (job.tool_speed is None or len(spans) == len(names)):
                first = max(begin for begin, _ in spans.values())
                platform[k] = max(0.0, min(end for _, end in spans.values()) - first)
        lines = self._line_room()
        if not numbers.turns:
            platform[:] = 0.0
        if not (platform.any() or lines.any()) and not any(
            own.any() for own, work in zip(arms, numbers.arms, strict=True) if work.spare
        ):
            return None
        return MotionRoom(platform, arms, lines)

    def _line_room(self) -> FloatArray:
        """Returns how long the platform may move on approach and retract of each stage [s], shape (n, 2)."""
        numbers, motion = self.numbers, self.found.cleared.motion
        room, plans = np.zeros((numbers.stages, 2)), self.stopping.plans
        if not (numbers.turns and all(has_closed_form(work) for work in numbers.arms)):
            return room
        length: dict[tuple[str, str, str, str], float] = {}
        for s in motion.segments:
            length[s.arm, s.task, s.action, s.kind] = s.end - s.start
        for k, plan in enumerate(plans):
            before = plans[k - 1] if k else None
            if not can_take_over(before, plan):
                continue
            for n, side, one, line in ((k - 1, 1, before, "retract"), (k, 0, plan, "approach")):
                if one is not None and may_turn(self.drive, one, line):
                    keys = [
                        (stop.arm, stop.task.id, stop.stop.action, line)
                        for stop in one.stops.values()
                    ]
                    room[n, side] = max(length.get(key, 0.0) for key in keys)
        return room

    def turned(self) -> _Trial:
        """Returns the plan with a platform that turns on lines wherever that makes it shorter."""
        first = np.zeros((self.numbers.stages, 2))
        return replace(self, found=self._with_lines(self.found, first))

    def _with_lines(self, found: ClearedPlan, first: FloatArray) -> ClearedPlan:
        if "line_motion" not in permitted(self.problem.job) or not self.numbers.turns:
            return found
        return turned_lines_plan(
            self.problem, found, self.drive, self.clearing, first, self.transfers
        )

    def improved(self, room: MotionRoom, *, lines: bool) -> _Trial:
        """Returns the shortest plan with as many of the search's decisions as make it shorter and collision-free.

        Args:
            room: how long platform and arms may move where tools stand or are on lines.
            lines: whether the platform turns on lines wherever tasks allow it.
        """
        decided = LeavingSearch(self.numbers, room).improved(self.start)
        plan, best = self._fitted(decided, room), self
        for _ in range(TRIES):
            if not self._differs(plan):
                break
            made, worse = self._made(plan, lines=lines)
            shorter = made is not None and _length(made) < _length(best.found) - WORTH
            if made is not None and shorter and self._in_time(made):
                best = replace(self, found=made, start=plan)
            if not len(worse):
                break
            plan = plan.put(worse, self.start)
        return best

    def _differs(self, plan: Leaving) -> bool:
        return len(self._changed(plan)) > 0

    def _changed(self, plan: Leaving) -> IntArray:
        """Returns the stages in which a plan is another one than that which it came from."""
        changed = plan.changes | (plan.arriving.angle != self.start.arriving.angle)
        changed |= (plan.outer != self.start.outer).any(axis=1)
        for one, other in zip(plan.arriving.arms, self.start.arriving.arms, strict=True):
            for name in ("psi_target", "psi_approach", "psi_retract", "yaw", "near"):
                own = getattr(one, name) != getattr(other, name)
                changed = changed | own.reshape(len(changed), -1).any(axis=1)
        return np.flatnonzero(changed)

    def _fitted(self, decided: Leaving, room: MotionRoom) -> Leaving:
        """Returns decisions of which what changes at stops fits into the time that is there."""
        plan = decided
        for share in (*SHARES, 0.0):
            plans = self._plans(plan)
            late = [
                k
                for k in np.flatnonzero(plan.changes).tolist()
                if not self._fits(plans[k], k, room)
            ]
            if not late:
                break
            plan = plan.put(np.array(late), decided.nearer(share))
        return plan

    def _fits(self, plan: StagePlan, k: int, room: MotionRoom) -> bool:
        """Returns whether what moves while tools stand can be timed, and is over when they have to leave."""
        try:
            moves = dwell_motions(self.drive, plan)
        except InfeasibleError:
            return False
        own = {
            work.name: times[k] for work, times in zip(self.numbers.arms, room.arms, strict=True)
        }
        return all(
            move.duration <= (own[move.groups[0]] if move.groups[0] in own else room.platform[k])
            for move in moves
        )

    def _plans(self, plan: Leaving) -> list[StagePlan]:
        return leaving_plans(
            self.problem.model, self.problem.job, self.numbers, plan, self.stopping.plans
        )

    def _made(self, plan: Leaving, *, lines: bool) -> tuple[ClearedPlan | None, IntArray]:
        """Returns a plan timed, blended and collision-free, or None, and the stages that should stay as they were."""
        problem = self.problem
        plans = self._plans(plan)
        try:
            motion = realise(problem.model, problem.job, plans, self.timing, self.found.known)
            touching = [] if self.clearing is None else self.clearing.touching(plans, motion)
            if touching:
                return None, self._beside(plan, touching)
            made = replace(self.found, cleared=Cleared(plans, motion, ()), stopping=None)
            if has_blends(problem):
                made = blended_plan(problem, made, self.timing)
            if lines:
                made = self._with_lines(made, plan.outer)
        except InfeasibleError:
            return None, self._changed(plan)
        longer = self._longer(made.cleared.motion)
        return made, np.intersect1d(longer, self._changed(plan))

    def _beside(self, plan: Leaving, touching: Iterable[int]) -> IntArray:
        """Returns the stages that stages that collide depend on: themselves, or else those beside them."""
        changed = set(self._changed(plan).tolist())
        own = changed.intersection(touching)
        beside = {k + d for k in touching for d in (-1, 1)} & changed
        return np.array(sorted(own or beside or changed), dtype=np.int64)

    def _longer(self, motion: Motion) -> IntArray:
        """Returns the stages that are longer together with the next one than they were."""
        before = self.found.cleared.motion
        more = _lengths(motion) - _lengths(before)
        return np.flatnonzero(more + np.append(more[1:], 0.0) > WORTH)

    def _in_time(self, made: ClearedPlan) -> bool:
        """Returns whether every task with a window is done within it."""
        late = {task.id: task.not_after for task in self.problem.job.tasks}
        return all(event.time <= late[event.task] for event in made.cleared.motion.events)


def _lengths(motion: Motion) -> FloatArray:
    return np.array([stage.end - stage.start for stage in motion.stages])
