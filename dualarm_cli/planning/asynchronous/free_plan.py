"""Asynchronous plans: the platform stands while each arm moves by its own clock.

Parts that lie while arms move by their own clocks.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from dualarm_cli.clearing.blended_plan import blended_plan
from dualarm_cli.clearing.clear_plan import quickest_clear
from dualarm_cli.clearing.cleared_plan import ClearedPlan
from dualarm_cli.clearing.stage_samples import STEP, StageSamples, which_are_clear
from dualarm_cli.clearing.torque_shapes import reshaped_within_torques
from dualarm_cli.collision.clearance import CellClearance
from dualarm_cli.collision.crowding import crowded_stops, is_same_spot
from dualarm_cli.collision.rooms import rooms_of
from dualarm_cli.collision.scenes import timed_scenes
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.blending import STOPPING
from dualarm_cli.model.job import Job, StopKey
from dualarm_cli.model.lying import Visit, lying_parts, lying_throughout
from dualarm_cli.model.motion.trajectory import SAME_TIME, Trajectory
from dualarm_cli.model.motion_limits import MotionLimits
from dualarm_cli.model.schedule import Segment
from dualarm_cli.motion.builder import Motion, MotionBuilder
from dualarm_cli.motion.transfers import (
    PLATFORM,
    Drive,
    largest_tool_speed,
    transfers_within_tool_speed,
)
from dualarm_cli.orders.model.tool_changes import cell_after
from dualarm_cli.planning.asynchronous.meeting_arms import ArmCoordination
from dualarm_cli.planning.asynchronous.own_clock import OwnClock, Wait
from dualarm_cli.postures.stage_plan import StagePlan
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal
from dualarm_cli.stages.method import Decided, MethodProblem
from dualarm_cli.timing import TimingSolver
from dualarm_cli.timing.composition import concatenate, hold

SPREADS = (1, 2, 4)
"""Growth of the blocked region [steps], tried in turn until the motion is clear."""
CHUNK = 4000
"""Instants whose clearance is looked at together."""


@dataclass(frozen=True)
class ArmPlan:
    """Motion of one arm alone, with its plan."""

    clock: OwnClock
    """With stops at both ends of all lines."""
    problem: MethodProblem
    """Problem of the method."""
    plan: ClearedPlan | None
    """Collision-free plan of the method; None for an idle arm."""


@dataclass(frozen=True)
class FreePlanner:
    """Planner of asynchronous arms."""

    problem: MethodProblem
    """The job, decided, and how hard to try."""
    solve: Callable[[MethodProblem], Decided]
    """Method that chooses one arm's postures."""
    timing: TimingSolver
    """Solver that times motions."""
    check_collisions: bool
    """Whether collisions are checked."""
    end: FloatArray | None = None
    """Prescribed end joints [rad], shape (n,), for jobs without a return.

    None to end after the last tasks.
    """

    def plan(self, angle: FloatArray) -> Motion:
        """Plan the motion with the platform at an angle (k,) during tool work.

        Raises:
            InfeasibleError: an arm has no motion of its own, or no collision-free motion of both together was found.
        """
        job = self.problem.job
        start = np.array(job.start_joints)
        work = start.copy()
        work[self.problem.model.platform_columns] = angle
        model = replace(
            self.problem.model, platform=replace(self.problem.model.platform, fixed=True)
        )
        arm_plans = []
        for name in model.arms:
            arm_plans.append(self._arm_plan(model, name, work))
        begin = work if job.start == "free" else start
        turn = self._turn(begin, work)
        back = None
        if self.end is not None:
            back = self._turn(work, self.end)
        elif job.returns and turn.duration > 0.0:
            back = _reversed(turn)
        cell = None
        if self.check_collisions:
            cell = CellClearance.of_job(job)
        if len(arm_plans) > 1:
            self.problem.progress("inserting waits between the arms")
        result = self._together(model, work, [plan.clock for plan in arm_plans], (turn, back), cell)
        if result is not None:
            motion, waits = result
            if not any(arm_plan.problem.blends for arm_plan in arm_plans):
                return motion
            self.problem.progress("blending lines and transfers")
            ready = turn.duration > 0.0
            clocks = [
                self._blended(arm_plan, [wait.at for wait in arm_waits], ready=ready)
                for arm_plan, arm_waits in zip(arm_plans, waits, strict=True)
            ]
            quicker = self._together(model, work, clocks, (turn, back), cell)
            gain = motion.trajectory.duration
            if quicker is None or quicker[0].trajectory.duration >= gain:
                return replace(motion, gain=0.0)
            return replace(quicker[0], gain=gain - quicker[0].trajectory.duration)
        slides = self.problem.model.platform.is_rail
        places = (1e3 * angle if slides else np.degrees(angle)).round(1).tolist()
        data = {"places": places, "unit": "mm" if slides else "deg"}
        raise InfeasibleError(Refusal("asynchronous_not_clear", data=data))

    def _together(
        self,
        model: CellModel,
        work: FloatArray,
        clocks: Sequence[OwnClock],
        turns: tuple[Trajectory, Trajectory | None],
        cell: CellClearance | None,
    ) -> tuple[Motion, tuple[list[Wait], ...]] | None:
        """Coordinate all arms; return their motion and waits, or None."""
        job, ready = self.problem.job, turns[0].duration
        for apart in (False, True) if ready > 0.0 else (False,):
            leave = ready if apart else 0.0
            meeting = ArmCoordination(model, job, work, cell, tuple(clocks), ready, leave)
            for spread in SPREADS:
                waits = meeting.waits(spread)
                if waits is None:
                    break
                motion = self._joined(model, work, tuple(clocks), turns, waits, apart=apart)
                if not apart and not self._turns_slowly(motion, ready):
                    break
                if cell is None or _is_clear(job, cell, motion):
                    return motion, waits
        return None

    def _turns_slowly(self, motion: Motion, ready: float) -> bool:
        """Check the tool speeds of arms that move to their first tasks while the platform turns."""
        job = self.problem.job
        caps = MotionLimits.of(job, {task.arm: task.care for task in reversed(job.tasks)}).caps
        if not caps or ready <= 0.0:
            return True
        model, whole = self.problem.model, motion.trajectory
        fastest = largest_tool_speed(model, caps, lambda time: whole.clamped(time)[0], ready)
        return fastest <= min(caps.values())

    def _arm_plan(self, model: CellModel, name: str, work: FloatArray) -> ArmPlan:
        """Plan one arm alone through its stops."""
        job, arm = self.problem.job, model.arms[name]
        tasks = tuple(task for task in job.tasks if task.arm == name)
        if not tasks and self.end is None:
            still = hold(arm.arm.joints, work[arm.columns], 0.0)
            clock = OwnClock(name, still, (), (), ())
            return ArmPlan(clock, replace(self.problem, blending=STOPPING), None)
        free = tuple(replace(task, not_before=0.0, after=()) for task in tasks)
        lying = (*job.lying, *others_parts(job, name)) if self.check_collisions else ()
        alone = replace(job, begin=work, tasks=free, pairing=None, mode="paired", lying=lying)
        tell, doing = self.problem.progress, f"planning the {name} arm alone"
        tell(doing)
        problem = replace(
            self.problem, model=model, job=alone, progress=lambda said: tell(f"{doing}: {said}")
        )
        motion, plan = self._still(model, work), None
        if tasks:
            # Plans that are blended as both arms' waits allow come from one search.
            compares = problem.compares_care and not problem.blends
            plan = quickest_clear(
                replace(
                    problem,
                    blending=STOPPING,
                    keeps_room=problem.blends,
                    compares_care=compares,
                ),
                self.solve,
                self.timing,
                check_collisions=self.check_collisions,
                alone=name,
            )
            motion, _ = reshaped_within_torques(problem, plan.cleared.motion, plan.holding)
        return ArmPlan(self._clock(problem, name, motion), problem, plan)

    def _clock(self, problem: MethodProblem, name: str, motion: Motion) -> OwnClock:
        """Append an arm's transfer to its final position."""
        if self.end is not None:
            motion = self._ended(problem, name, motion)
        return OwnClock.of(motion, name, problem.model.arms[name].arm.joints)

    def _blended(self, arm_plan: ArmPlan, waits: Sequence[float], *, ready: bool) -> OwnClock:
        """Blend an arm's line ends, except at its waits.

        Args:
            arm_plan: plan with stops at every line end.
            waits: instants at which it waits, by its own clock [s].
            ready: whether its first line waits for the platform.
        """
        if arm_plan.plan is None or not arm_plan.problem.blends:
            return arm_plan.clock
        name, bound = arm_plan.clock.arm, arm_plan.clock.line_begins()
        waiting = {task.id for task in self.problem.job.tasks if task.after or task.not_before}
        waited = [*waits, *(bound[task] for task in waiting if task in bound)]
        stopping = {(0, name)} if ready else set()
        for k, stage in enumerate(arm_plan.clock.stages):
            # An instant at its end belongs to the next stage.
            last = max(stage.start + SAME_TIME, stage.end - SAME_TIME)
            if any(stage.start - SAME_TIME <= at <= last for at in waited):
                stopping.add((k, name))
        blended = blended_plan(arm_plan.problem, arm_plan.plan, self.timing, stopping)
        given = arm_plan.problem, blended.cleared.motion, arm_plan.plan.holding
        return self._clock(arm_plan.problem, name, reshaped_within_torques(*given)[0])

    def _still(self, model: CellModel, work: FloatArray) -> Motion:
        """Return a motion without movement."""
        return Motion(hold(model.cell.robot.joints, work, 0.0), (), (), ())

    def _ended(self, problem: MethodProblem, name: str, motion: Motion) -> Motion:
        """Append an arm's transfer to its final position to its motion."""
        assert self.end is not None  # callers have looked
        columns = self.problem.model.arms[name].columns
        here = np.asarray(motion.trajectory.position[-1])
        there = here.copy()
        there[columns] = self.end[columns]
        if np.array_equal(here, there):
            return motion
        cell = cell_after(problem.job.cell, problem.job.tasks)
        placed = lying_throughout(problem.job, problem.job.tasks, ())
        lying = (*problem.job.lying, *placed)
        alone = replace(problem.job, cell=cell, begin=here, tasks=(), returns=False, lying=lying)
        law = alone.limits.law
        back = StagePlan(here, there, there, {}, "return", float(law.duration(there - here)))
        transfer = quickest_clear(
            replace(problem, model=replace(problem.model, cell=cell), job=alone),
            lambda _: Decided([back]),
            self.timing,
            check_collisions=self.check_collisions,
            alone=name,
        )
        both = MotionBuilder()
        both.append(motion)
        both.append(transfer.cleared.motion)
        return both.build(cell.robot)

    def _turn(self, start: FloatArray, work: FloatArray) -> Trajectory:
        """Plan the platform's move from the start to its working position."""
        model, job = self.problem.model, self.problem.job
        robot = job.cell.robot
        if not robot.platform:
            return hold((), np.zeros(0), 0.0)
        index = model.platform_columns
        if np.array_equal(start[index], work[index]):
            return hold(robot.platform, start[index], 0.0)
        plan = StagePlan(start, work, work, {}, "turn", 0.0)
        drive = Drive.of(model, job, self.timing)
        return transfers_within_tool_speed(drive, plan).motion[PLATFORM]

    def _joined(
        self,
        model: CellModel,
        work: FloatArray,
        clocks: tuple[OwnClock, ...],
        turns: tuple[Trajectory, Trajectory | None],
        waits: tuple[list[Wait] | tuple[()], ...],
        *,
        apart: bool,
    ) -> Motion:
        """Join the arms' motions with waits and the platform's move."""
        robot, (turn, back) = self.problem.job.cell.robot, turns
        clocks = tuple(c.with_waits(list(w)) for c, w in zip(clocks, waits, strict=True))
        over = max(clock.last_line() for clock in clocks)
        home = max(clock.duration for clock in clocks)
        groups = {clock.arm: clock.trajectory for clock in clocks}
        length = home
        if turn.joints:
            pieces = [turn]
            if back is not None and back.duration > 0.0:
                leaves = home if apart else max(over, turn.duration)
                pieces += [hold(turn.joints, turn.position[-1], leaves - turn.duration), back]
                length = max(length, leaves + back.duration)
            whole = concatenate([p for p in pieces if p.duration > 0.0] or [turn])
            groups = {PLATFORM: whole, **groups}
        longest = max(group.duration for group in groups.values())
        if longest < length:
            name, first = next(iter(groups.items()))
            rest = hold(first.joints, first.position[-1], length - first.duration)
            groups[name] = concatenate([first, rest])
        stages = sorted(
            (stage for clock in clocks for stage in clock.stages),
            key=lambda stage: (stage.start, stage.arm),
        )
        platform = model.platform_angle(work)
        return MotionBuilder(
            {name: [group] for name, group in groups.items()},
            [replace(stage, platform_angle=platform) for stage in stages],
            [part for clock in clocks for part in _to_end(clock, length)],
            [event for clock in clocks for event in clock.events],
        ).build(robot)


def _to_end(clock: OwnClock, length: float) -> list[Segment]:
    """Return an arm's segments, with a final wait for the other arm."""
    parts = list(clock.segments)
    end = max((part.end for part in parts), default=0.0)
    if length - end > 1e-9:
        parts.append(Segment(clock.arm, "wait", "", "", end, length, reason="partner"))
    return parts


def _reversed(motion: Trajectory) -> Trajectory:
    """Reverse a motion in time."""
    return Trajectory(
        motion.joints,
        (motion.time[-1] - motion.time)[::-1],
        motion.position[::-1],
        -motion.velocity[::-1],
        motion.acceleration[::-1],
    )


def _is_clear(job: Job, cell: CellClearance, motion: Motion) -> bool:
    """Return whether a whole motion is collision-free."""
    duration, step = motion.trajectory.duration, STEP / job.speed
    count = max(2, int(np.ceil(duration / step)) + 1)
    time = np.minimum(step * np.arange(count), duration)
    held = np.empty((count, len(cell.arms)), dtype=np.int64)
    for a, name in enumerate(cell.arms):
        clock = OwnClock(
            name,
            motion.trajectory,
            (),
            tuple(part for part in motion.segments if part.arm == name),
            tuple(event for event in motion.events if event.arm == name),
        )
        held[:, a] = clock.held(time, cell, job)
    if cell.rooms:
        cell, scene = with_motion_scenes(job, cell, motion, time)
        held = cell.loads.in_scenes(held, scene[:, None])
    position = motion.trajectory.clamped(time)[0]
    stretches: list[StageSamples] = []
    for k in range(0, max(1, count - 1), CHUNK):
        span, before = slice(k, k + CHUNK + 1), stretches[-1] if k else None
        if before is not None:
            before = StageSamples(before.position[:-1], before.held[:-1], step)
        stretches.append(StageSamples(position[span], held[span], step, before))
    return bool(which_are_clear(cell, stretches).all())


def others_parts(job: Job, arm: str) -> tuple[Visit, ...]:
    """List the other arm's parts that lie away from an arm's own stops.

    They may lie at any time.

    Args:
        job: decided.
        arm: the one whose motion is planned alone.
    """
    visits = [(task, stop) for task in job.tasks for stop in task.stops]
    keys = {lying.key[1:] for lying in lying_parts(job, visits) if lying.task.arm != arm}
    keys -= {crowded.room.key for crowded in crowded_stops(job) if crowded.task.arm == arm}
    arm_visits = [visit for visit in visits if visit[0].arm == arm]
    return tuple(
        (room.task, room.stop)
        for room in rooms_of(job)
        if room.key in keys and not any(is_same_spot(visit, room) for visit in arm_visits)
    )


def with_motion_scenes(
    job: Job, cell: CellClearance, motion: Motion, time: FloatArray
) -> tuple[CellClearance, IntArray]:
    """Add scenes of lying parts to a test; return their numbers (t,) by instant.

    Args:
        job: decided.
        cell: its test.
        motion: of all arms.
        time: instants [s], shape (t,).
    """
    stops: dict[StopKey, Visit] = {
        (t.arm, t.id, s.action): (t, s) for t in job.tasks for s in t.stops
    }
    events = {
        (e.arm, e.task, e.action): e.changes_held
        for e in sorted(motion.events, key=lambda e: e.changes_held)
        if (e.arm, e.task, e.action) in stops and e.action in ("pick", "place")
    }
    changes = np.array(list(events.values()))
    begins, leaves = dict(events), dict(events)
    for part in motion.segments:
        key = part.arm, part.task, part.action
        if part.kind == "approach" and key in begins:
            begins[key] = min(begins[key], part.start)
        if part.kind == "retract" and part.action == "place" and key in leaves:
            leaves[key] = part.end
    first = np.searchsorted(changes, np.array(list(begins.values())) - SAME_TIME, side="right")
    coming = dict(zip(begins, first.tolist(), strict=True))
    # A scene also ends where a retract does: the tool may touch there what it has placed.
    bounds = np.unique(np.concatenate([[-np.inf], changes, np.array(list(leaves.values()))]))
    spans = []
    for begin, done in zip(bounds, np.searchsorted(changes, bounds, side="right"), strict=True):
        leaving = {key[0] for key in events if events[key] <= begin < leaves[key]}
        spans.append((int(done), leaving))
    scenes = timed_scenes(job, cell.rooms, [stops[key] for key in events], coming, spans)
    return cell.in_scenes(scenes), np.searchsorted(bounds, time + SAME_TIME, side="right") - 1
