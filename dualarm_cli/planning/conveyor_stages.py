"""Decided stages whose targets stand become stages whose targets move with conveyors: when each is met, and how."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.general_arm import GeneralArm
from dualarm_cli.model.conveyor import OnBelt
from dualarm_cli.model.job import Job
from dualarm_cli.planning.motion import Known, Motion, realise
from dualarm_cli.planning.stage_plan import ArmStop, StagePlan
from dualarm_cli.planning.tracking import Tracked, Tracking
from dualarm_cli.redundancy import StopPosture
from dualarm_cli.redundancy.problem import NoPosture
from dualarm_cli.redundancy.stop_batch import StopBatch
from dualarm_cli.redundancy.target_grid import target_postures
from dualarm_cli.timing import TimingSolver

SPARE = 1e-3
"""By how much an arm is to be earlier than its part at most where nothing else makes it wait [s]."""
ROUNDS = 12
"""So often the time at which a part is met is corrected by when the arm can be there."""
TRIES = 8
"""Parts of a window after which a later time is tried where a part cannot be followed."""

Times = Mapping[tuple[str, str], float]
"""When targets on conveyors are met [s], by task and action."""
Delays = Mapping[tuple[int, str], float]
"""By number of the stage and arm, how much later than it thinks it turned out to be there [s]."""


class MissedError(InfeasibleError):
    """A part is out of its window by the time at which an arm can be there, or cannot be followed from then on."""

    def __init__(self, message: str, times: Times) -> None:
        """Notes about when parts would be met as far as that is known, to guess better the next time.

        Args:
            message: what is told.
            times: when parts would be met [s], by task and action.
        """
        super().__init__(message)
        self.times = times


@dataclass(frozen=True)
class Meeting:
    """What decided stages are changed with."""

    model: CellModel
    """The job's cell."""
    job: Job
    """What is to be done; its targets on conveyors may be at any time of theirs."""
    timing: TimingSolver
    """How transfers and lines are timed."""
    delays: Delays = field(default_factory=dict)
    """What is known of how late arms turn out to be, as when they have to keep clear of each other."""
    known: Known = field(default_factory=Known)
    """What is timed already."""

    def met(self, plans: list[StagePlan]) -> list[StagePlan]:
        """Returns stages in which every part on a conveyor is met, and followed, as soon as the arm can be there.

        The method decided platform angles, branches, yaws and arm angles for parts that stand where they were guessed
        to be. These stay. Where a part is when it is met depends on when that is, and this on how far the arm has to
        go: the time is corrected until it is no earlier than the arm's arrival and later by SPARE at most, or the part
        comes just then. What begins and ends elsewhere for that, the stages before and after are led to.

        Args:
            plans: all stages of a plan, none of them mended.

        Raises:
            MissedError: a part that is not met in its window.
        """
        found: list[StagePlan] = []
        clock = 0.0
        position = plans[0].start
        for k, plan in enumerate(plans):
            begin = None if k == 0 and self.job.start == "free" else position
            goal = found[0].start if found and not plan.stops and self.job.returns else None
            try:
                stage, motion = self._stage(k, plan, begin, goal, clock)
            except MissedError as error:
                error.times = {**met_times(found), **error.times}
                raise
            found.append(stage)
            clock += motion.trajectory.duration
            position = stage.end
        return found

    def _stage(
        self,
        k: int,
        plan: StagePlan,
        begin: FloatArray | None,
        goal: FloatArray | None,
        clock: float,
    ) -> tuple[StagePlan, Motion]:
        """Returns a stage that meets its parts, and its motion with all that it waits for."""
        times = {
            name: max(clock, stop.stop.belt.passes)
            for name, stop in plan.stops.items()
            if stop.stop.belt is not None
        }
        least = {name: _belt(plan.stops[name]).passes for name in times}
        tracked: dict[str, Tracked] = {}
        for _ in range(ROUNDS):
            stops = dict(plan.stops)
            for name, time in times.items():
                try:
                    stops[name], times[name] = self._followed(
                        plan, plan.stops[name], time, least, tracked.get(name)
                    )
                except InfeasibleError as error:
                    words = _unfollowed(plan.stops[name], time, error)
                    raise MissedError(words, _named(plan, times)) from None
                made = stops[name].tracked
                assert made is not None  # what is followed has a motion
                tracked[name] = made
            stage = self._joined(plan, stops, begin, goal)
            motion = self._timed(stage, clock)
            there = {event.arm: clock + event.time for event in motion.events}
            # Without any wait for parts; what waits for windows of tasks is waited for.
            early = self._earliest(stage, clock) if times else {}
            due = {
                name: max(least[name], early[name] + self.delays.get((k, name), 0.0))
                for name in times
            }
            exact = all(abs(there[name] - time) <= 1e-9 for name, time in times.items())
            soon = all(time <= due[name] + SPARE for name, time in times.items())
            if exact and soon and all(time >= due[name] for name, time in times.items()):
                return stage, motion
            times = {
                name: due[name] if due[name] == least[name] else due[name] + 0.5 * SPARE
                for name in times
            }
            for name, time in times.items():
                if time > _belt(plan.stops[name]).last:
                    late = self.delays.get((k, name), 0.0)
                    words = _too_late(plan.stops[name], time, late)
                    raise MissedError(words, _named(plan, times))
        raise MissedError(
            f"{next(iter(plan.stops.values())).task.place}: no time was found at which the arms meet their parts on "
            "conveyors; what helps: a slower conveyor, or parts that do not come at the same time for both arms",
            _named(plan, times),
        )

    def _followed(
        self,
        plan: StagePlan,
        arm_stop: ArmStop,
        time: float,
        least: dict[str, float],
        near: Tracked | None,
    ) -> tuple[ArmStop, float]:
        """Returns a stop that follows its part from a time on, or a later one of its window, and that time."""
        belt = _belt(arm_stop)
        while True:
            try:
                return self._tracked(plan, arm_stop, time, near), time
            except InfeasibleError:
                later = max(time, belt.passes) + (belt.last - belt.passes) / TRIES
                if later > belt.last:
                    raise
                # No earlier time is tried any more.
                time = least[arm_stop.arm] = later

    def _tracked(
        self, plan: StagePlan, arm_stop: ArmStop, time: float, near: Tracked | None
    ) -> ArmStop:
        """Returns a stop with its target where it is at a time, and with the motion that follows it."""
        model, job, belt = self.model, self.job, _belt(arm_stop)
        R_world, _ = model.carried_frame(plan.arrival)
        velocity = R_world.T @ belt.conveyor.velocity
        shift = velocity * (time - belt.at)
        seen = arm_stop.problem
        problem = replace(seen, p_base_tool=seen.p_base_tool + shift)
        limits = job.cell.robot.limits.scaled(job.speed)
        asked = Tracking(
            problem,
            arm_stop.posture,
            velocity,
            arm_stop.stop.dwell.total,
            limits.select(model.arms[arm_stop.arm].arm.joints),
            job.tool_speed,
            1.0 / job.speed,
        )
        made, tracked = _solved(asked, near)
        posture = replace(
            made,
            q_approach=tracked.motion.position[0],
            q_target=tracked.q_target,
            q_retract=tracked.motion.position[-1],
        )
        return replace(
            arm_stop,
            stop=arm_stop.stop.met(time),
            problem=problem,
            posture=posture,
            tracked=tracked,
        )

    def _joined(
        self,
        plan: StagePlan,
        stops: Mapping[str, ArmStop],
        begin: FloatArray | None,
        goal: FloatArray | None,
    ) -> StagePlan:
        """Returns a stage that begins where the one before ended and goes to its stops, or back to where all began."""
        arrival, end = np.array(plan.arrival), np.array(plan.end)
        for name, arm in self.model.arms.items():
            if name in stops:
                arrival[arm.columns] = stops[name].posture.q_approach
                end[arm.columns] = stops[name].posture.q_retract
            elif plan.stops and begin is not None:
                arrival[arm.columns] = end[arm.columns] = begin[arm.columns]
        if goal is not None:
            arrival, end = goal, goal
        start = arrival if begin is None else begin
        return replace(plan, start=start, arrival=arrival, end=end, stops=stops)

    def _timed(self, stage: StagePlan, clock: float) -> Motion:
        return realise(self.model, self.job, [stage], self.timing, self.known, clock=clock)

    def _earliest(self, stage: StagePlan, clock: float) -> dict[str, float]:
        """Returns when the arms could be at their targets if no part had to be waited for [s]."""
        free = {
            name: replace(stop, stop=replace(stop.stop, belt=None))
            for name, stop in stage.stops.items()
        }
        motion = self._timed(replace(stage, stops=free), clock)
        return {event.arm: clock + event.time for event in motion.events}


def met_times(plans: Sequence[StagePlan]) -> Times:
    """Returns when parts are met in some stages [s]."""
    return {
        (one.task.id, one.stop.action): one.stop.belt.at
        for plan in plans
        for one in plan.stops.values()
        if one.stop.belt is not None
    }


def _named(plan: StagePlan, times: Mapping[str, float]) -> Times:
    """Returns times by task and action, of times by arm of a stage."""
    return {
        (plan.stops[name].task.id, plan.stops[name].stop.action): time
        for name, time in times.items()
    }


def _too_late(arm_stop: ArmStop, time: float, late: float) -> str:
    """Returns that a part is beyond its window at a time at which the arm can be there at the earliest."""
    belt, stop = _belt(arm_stop), arm_stop.stop
    gone = belt.gone(time) - belt.within
    why = f" ({late:.3f} s of it to keep clear)" if late > 0.0 else ""
    return (
        f"{stop.place}: task '{arm_stop.task.id}': the {arm_stop.arm} arm cannot be at the {stop.action} before "
        f"{time:.3f} s{why}, when it is {gone * 1e3:.0f} mm beyond what 'within' allows: {_window(belt)}; what helps: a "
        "later 'passes', a longer 'within', a slower conveyor, another arm or order (arm: any, order: optimise), or "
        "less before it"
    )


def _unfollowed(arm_stop: ArmStop, time: float, error: InfeasibleError) -> str:
    """Returns that no posture was found that follows a part from a time on."""
    belt, stop = _belt(arm_stop), arm_stop.stop
    return (
        f"{stop.place}: task '{arm_stop.task.id}': no way was found for the {arm_stop.arm} arm to follow the "
        f"{stop.action} from {time:.3f} s on: {error}; {_window(belt)}; what helps: a 'passes' pose and 'within' "
        "that leave room before and behind it, a slower conveyor, a shorter approach, retract or dwell, another arm"
    )


def _window(belt: OnBelt) -> str:
    return (
        f"conveyor '{belt.conveyor.name}' ({belt.conveyor.speed:g} m/s) passes at {belt.passes:g} s and is "
        f"{belt.within:g} m on at {belt.last:.3f} s"
    )


def _solved(asked: Tracking, near: Tracked | None) -> tuple[StopPosture, Tracked]:
    """Returns the posture that follows a part, and its motion: the decided one, else the quickest to get to that does.

    Raises:
        InfeasibleError: none does; the words are those about the decided one.
    """
    try:
        return asked.posture, asked.solve(None if near is None else near.phases)
    except InfeasibleError as error:
        failure = error
    if isinstance(asked.problem.arm, GeneralArm):
        raise failure
    [others] = target_postures(StopBatch((asked.problem,)))
    if isinstance(others, NoPosture):
        raise failure
    rows = zip(others.target, others.yaw, others.branch, others.psi, strict=True)
    for target, yaw, branch, psi in rows:
        posture = replace(
            asked.posture,
            target=int(target),
            yaw=float(yaw),
            branch=int(branch),
            psi_target=float(psi),
            psi_approach=float(psi),
            psi_retract=float(psi),
        )
        try:
            return posture, replace(asked, posture=posture).solve()
        except InfeasibleError:
            continue
    raise failure


def _belt(arm_stop: ArmStop) -> OnBelt:
    belt = arm_stop.stop.belt
    assert belt is not None  # callers have looked
    return belt
