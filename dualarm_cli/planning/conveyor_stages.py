"""Decided stages whose targets stand become stages whose targets move with conveyors: when each is met, and how."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.conveyor import OnBelt
from dualarm_cli.model.job import Job
from dualarm_cli.planning.conveyor_words import no_time, too_late, unfollowed
from dualarm_cli.planning.meeting_time import MeetingTime
from dualarm_cli.planning.motion import Motion, realise
from dualarm_cli.planning.stage_plan import ArmStop, StagePlan
from dualarm_cli.planning.stop_motion import Known
from dualarm_cli.planning.tracking import Tracked, Tracking
from dualarm_cli.planning.tracking_choice import followed_posture
from dualarm_cli.timing import TimingSolver

ROUNDS = 14
"""So often the time at which a part is met is corrected by when the arm can be there."""
EXACT = 1e-9
"""An arm that is there so much earlier or later than its part is there with it [s]."""
TRIES, NARROW = 8, 0.02
"""Parts of a window after which a later time is tried where a part cannot be followed, and how closely the first time
at which it can be is found [s]."""

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
        search = {
            name: MeetingTime(belt.passes, belt.last, max(clock, belt.passes))
            for name, stop in plan.stops.items()
            if (belt := stop.stop.belt) is not None
        }
        tracked: dict[str, Tracked] = {}
        best: tuple[StagePlan, Motion] | None = None
        for _ in range(ROUNDS):
            stops = dict(plan.stops)
            for name in search:
                stops[name] = self._followed(plan, plan.stops[name], search, tracked.get(name))
                made = stops[name].tracked
                assert made is not None  # what is followed has a motion
                tracked[name] = made
            stage = self._joined(plan, stops, begin, goal)
            motion = self._timed(stage, clock)
            there = {event.arm: clock + event.time for event in motion.events}
            # Without any wait for parts; what waits for windows of tasks is waited for.
            early = self._earliest(stage, clock) if search else {}
            soon = [
                one.note(early[name] + self.delays.get((k, name), 0.0))
                for name, one in search.items()
            ]
            if all(abs(there[name] - one.time) <= EXACT for name, one in search.items()):
                if best is None or motion.trajectory.duration < best[1].trajectory.duration:
                    best = stage, motion
                if all(soon):
                    return stage, motion
            for name, one in search.items():
                if not one.next():
                    arrival = one.last + (one.too_early[1] if one.too_early else 0.0)
                    words = too_late(plan.stops[name], arrival, self.delays.get((k, name), 0.0))
                    raise MissedError(words, _named(plan, search))
        if best is not None:
            return best
        raise MissedError(no_time(plan.stops.values()), _named(plan, search))

    def _followed(
        self,
        plan: StagePlan,
        arm_stop: ArmStop,
        search: Mapping[str, MeetingTime],
        near: Tracked | None,
    ) -> ArmStop:
        """Returns a stop that follows its part from the time that is tried on, or from a later one on of its window."""
        one = search[arm_stop.arm]
        before, time, asked = one.time, one.time, one.time
        found: ArmStop | None = None
        if time > one.last:
            words = too_late(arm_stop, time, 0.0)
            raise MissedError(words, _named(plan, search))
        while found is None:
            try:
                found = self._tracked(plan, arm_stop, time, near)
            except InfeasibleError as error:
                before, time = time, time + (one.last - one.least) / TRIES
                if time > one.last:
                    words = unfollowed(arm_stop, asked, error)
                    raise MissedError(words, _named(plan, search)) from None
        while time - before > NARROW:
            middle = 0.5 * (before + time)
            try:
                found, time = self._tracked(plan, arm_stop, middle, near), middle
            except InfeasibleError:
                before = middle
        one.time = time
        if before < time:
            # No earlier time is tried any more.
            one.least = time
        return found

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
        made, tracked = followed_posture(asked, near)
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


def _named(plan: StagePlan, search: Mapping[str, MeetingTime]) -> Times:
    """Returns the times that are tried by task and action."""
    return {
        (plan.stops[name].task.id, plan.stops[name].stop.action): one.time
        for name, one in search.items()
    }


def _belt(arm_stop: ArmStop) -> OnBelt:
    belt = arm_stop.stop.belt
    assert belt is not None  # callers have looked
    return belt
