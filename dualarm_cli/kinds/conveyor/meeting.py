"""Decided stages whose targets stand become stages whose targets move with conveyors: when each is met, and how."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field, replace

import numpy as np

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.products import product
from dualarm_cli.kinds.conveyor.tracking import Tracking
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.srs.srs_limits import wrap
from dualarm_cli.model.cell import OnBelt
from dualarm_cli.model.job import Job
from dualarm_cli.motion.builder import Motion
from dualarm_cli.motion.motion import realise
from dualarm_cli.motion.transfers import MotionCache
from dualarm_cli.postures import StopPosture
from dualarm_cli.postures.problem import NoPosture
from dualarm_cli.postures.stage_plan import ArmStop, StagePlan
from dualarm_cli.postures.stop_batch import StopBatch
from dualarm_cli.postures.target_grid import target_postures
from dualarm_cli.postures.tracked import Tracked
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal
from dualarm_cli.timing import TimingSolver


def followed_posture(asked: Tracking, near: Tracked | None) -> tuple[StopPosture, Tracked]:
    """Returns the posture that follows a part, and its motion: the decided one, else that most like it which does.

    Raises:
        InfeasibleError: none does; the words are those about the decided one.
    """
    try:
        return asked.posture, asked.solve(None if near is None else near.phases)
    except InfeasibleError as error:
        failure = error
    if not asked.problem.arm.has_arm_angle:
        raise failure
    [others] = target_postures(StopBatch((asked.problem,)))
    if isinstance(others, NoPosture):
        raise failure
    made = asked.posture
    unlike = np.abs(wrap(others.psi - made.psi_target)) + np.abs(wrap(others.yaw - made.yaw))
    order = np.lexsort((unlike, others.branch != made.branch))
    columns = (others.target, others.yaw, others.branch, others.psi)
    for target, yaw, branch, psi in zip(*(column[order] for column in columns), strict=True):
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


@dataclass(frozen=True)
class MeetingSettings:
    """Numbers that steer the search for a meeting with a part."""

    spare: float = 1e-3
    """Maximum time by which an arm is early for its part [s].

    It does not hold for a part that is met as early as it can be.
    """
    side: float = 0.1
    """Least distance of a new time from both known times, relative to their difference."""
    farthest: float = 8.0
    """A time is tried no later than by so many times what the arm is late."""
    rounds: int = 14
    """Maximum number of corrections of the time at which a part is met."""
    exact: float = 1e-9
    """Difference in arrival up to which arm and part meet [s]."""
    tries: int = 8
    """Number of later times tried within a window if a part cannot be followed."""
    narrow: float = 0.02
    """Precision of the first time at which a part can be followed [s]."""


MEETING = MeetingSettings()


@dataclass
class MeetingTime:
    """The least time that is no earlier than when the arm can be there for a part met then, between two that are known.

    Later the part is elsewhere and the arm may be there sooner or later than for an earlier one: the time is looked for
    by the rule of the false position.
    """

    least: float
    """No part is met earlier than this [s]."""
    last: float
    """No part is met later than this [s]."""
    time: float
    """What is tried now [s]."""
    too_early: tuple[float, float] | None = None
    """The latest time known to be too early, and by how much the arm is late for it [s]."""
    rate: float = 1.0
    """By how much less late the arm was for a later time that is too early as well, per second."""
    boldness: float = 1.0
    """By how many times what the arm is early an earlier time is tried."""
    possible: tuple[float, float] | None = None
    """The earliest time known to be possible, and by how much the arm is early for it [s]."""

    def note(self, arrival: float) -> bool:
        """Notes when the arm can be there for a part that is met at `time`; returns whether that is soon enough.

        Args:
            arrival: the earliest time at which it can be there [s].
        """
        spare = self.time - arrival
        if spare < 0.0:
            if self.too_early is None or self.time > self.too_early[0]:
                if self.too_early is not None:
                    closed = (self.too_early[1] + spare) / (self.time - self.too_early[0])
                    self.rate = min(1.5, max(1.0 / MEETING.farthest, closed))
                self.too_early = self.time, -spare
            return False
        if self.possible is None or self.time < self.possible[0]:
            self.possible = self.time, spare
        return spare <= MEETING.spare or self.time <= self.least

    def next(self) -> bool:
        """Takes the next time to be tried; returns whether there is one: else even the last one is too early."""
        if self.possible is None:
            assert self.too_early is not None  # one of the two has been noted
            tried, late = self.too_early
            self.time = min(tried + late / self.rate + 0.5 * MEETING.spare, self.last)
            return tried < self.last
        high, spare = self.possible
        if self.too_early is None or self.too_early[0] >= high:
            self.time = max(self.least, high - self.boldness * spare + 0.5 * MEETING.spare)
            self.boldness = min(2.0 * self.boldness, MEETING.farthest)
            return True
        low, late = self.too_early
        # Where the arm would just be in time if that went straight from one to the other; a little later.
        share = late / (late + spare) if late + spare > 0.0 else 0.5
        goal = low + share * (high - low) + 0.25 * MEETING.spare
        room = MEETING.side * (high - low)
        self.time = max(self.least, min(max(goal, low + room), high - room))
        return True


def too_late(arm_stop: ArmStop, time: float, late: float) -> Refusal:
    """Returns that a part is beyond its window at a time at which the arm can be there at the earliest.

    Args:
        arm_stop: the stop.
        time: when the arm can be there [s].
        late: how much of that is to be clear of the other arm [s].
    """
    gone = _named_belt(arm_stop).gone(time) - _named_belt(arm_stop).within
    delay = [Refusal("delayed", measured=late)] if late > 0.0 else []
    return _at_belt("part_gone", arm_stop, gone, time=time, delay=delay)


def unfollowed(arm_stop: ArmStop, time: float, error: InfeasibleError) -> Refusal:
    """Returns that no posture was found that follows a part from a time [s] on, and why the decided one does not."""
    [cause] = error.refusals
    return _at_belt("part_not_followed", arm_stop, None, time=time, cause=cause)


def no_time(stops: Iterable[ArmStop]) -> Refusal:
    """Returns that no times were found at which the arms of a stage meet their parts."""
    moving = [stop for stop in stops if stop.stop.belt is not None]
    which = [
        Refusal("stop_of", None, stop.task.id, stop.arm, more={"action": stop.stop.action})
        for stop in moving
    ]
    windows = [_window(_named_belt(stop)) for stop in moving]
    more = {"stops": which, "windows": windows}
    return Refusal("parts_not_met", moving[0].stop.place, moving[0].task.id, more=more)


def _at_belt(what: str, arm_stop: ArmStop, measured: float | None, **more: object) -> Refusal:
    """Returns what is wrong with one arm's stop at a part that moves."""
    stop = arm_stop.stop
    more |= {"action": stop.action, "window": _window(_named_belt(arm_stop))}
    return Refusal(what, stop.place, arm_stop.task.id, arm_stop.arm, measured, more=more)


def _window(belt: OnBelt) -> Refusal:
    named = {"conveyor": belt.conveyor.name, "speed": belt.conveyor.speed}
    times = {"passes": belt.passes, "within": belt.within, "last": belt.last}
    return Refusal("window", more={**named, **times})


def _named_belt(arm_stop: ArmStop) -> OnBelt:
    belt = arm_stop.stop.belt
    assert belt is not None  # callers have looked
    return belt


Times = Mapping[tuple[str, str], float]
"""When targets on conveyors are met [s], by task and action."""
Delays = Mapping[tuple[int, str], float]
"""By number of the stage and arm, how much later than it thinks it turned out to be there [s]."""


class MissedError(InfeasibleError):
    """A part is out of its window by the time at which an arm can be there, or cannot be followed from then on."""

    def __init__(self, refusal: Refusal, times: Times) -> None:
        """Notes about when parts would be met as far as that is known, to guess better the next time.

        Args:
            refusal: what is wrong.
            times: when parts would be met [s], by task and action.
        """
        super().__init__(refusal)
        self.times = times


@dataclass(frozen=True)
class ConveyorMeeting:
    """What decided stages are changed with."""

    model: CellModel
    """The job's cell."""
    job: Job
    """What is to be done; its targets on conveyors may be at any time of theirs."""
    timing: TimingSolver
    """How transfers and lines are timed."""
    delays: Delays = field(default_factory=dict)
    """What is known of how late arms turn out to be, as when they have to be clear of each other."""
    cache: MotionCache = field(default_factory=MotionCache)
    """What is timed already."""

    def met(self, plans: list[StagePlan]) -> list[StagePlan]:
        """Returns stages in which every part on a conveyor is met, and followed, as soon as the arm can be there.

        The method decided platform angles, branches, yaws and arm angles for parts that stand where they were guessed
        to be. These stay. Where a part is when it is met depends on when that is, and this on how far the arm has to
        go: the time is corrected until it is no earlier than the arm's arrival and later by `spare` at most,
        or the part
        comes just then. What begins and ends elsewhere for that, the stages before and after are led to.

        Args:
            plans: all stages of a plan, none of them repaired.

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
        for _ in range(MEETING.rounds):
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
            if all(abs(there[name] - one.time) <= MEETING.exact for name, one in search.items()):
                if best is None or motion.trajectory.duration < best[1].trajectory.duration:
                    best = stage, motion
                if all(soon):
                    return stage, motion
            for name, one in search.items():
                if not one.next():
                    arrival = one.last + (one.too_early[1] if one.too_early else 0.0)
                    gone = too_late(plan.stops[name], arrival, self.delays.get((k, name), 0.0))
                    raise MissedError(gone, _named(plan, search))
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
            raise MissedError(too_late(arm_stop, time, 0.0), _named(plan, search))
        while found is None:
            try:
                found = self._tracked(plan, arm_stop, time, near)
            except InfeasibleError as error:
                before, time = time, time + (one.last - one.least) / MEETING.tries
                if time > one.last:
                    left = unfollowed(arm_stop, asked, error)
                    raise MissedError(left, _named(plan, search)) from None
        while time - before > MEETING.narrow:
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
        velocity = product(R_world.T, belt.conveyor.velocity)
        shift = velocity * (time - belt.at)
        seen = arm_stop.problem
        problem = replace(seen, p_base_tool=seen.p_base_tool + shift)
        limits = job.limits
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
        return realise(self.model, self.job, [stage], self.timing, self.cache, clock=clock)

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
