"""Meetings with parts on conveyors: stages for resting targets become stages for moving ones."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field, replace

import numpy as np

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.products import product
from dualarm_cli.kinds.conveyor.tracking import Tracking
from dualarm_cli.kinds.conveyor.tracking_torques import TrackingTorques
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.dynamics import Dynamics
from dualarm_cli.kinematics.srs.srs_limits import wrap
from dualarm_cli.model.job import Job
from dualarm_cli.model.motion_limits import MotionLimits
from dualarm_cli.model.part_flow import OnBelt
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


def followed_posture(tracking: Tracking, previous: Tracked | None) -> tuple[StopPosture, Tracked]:
    """Find the posture that follows a part, and its motion.

    It is the decided posture, or else the most similar one that can.

    Raises:
        InfeasibleError: none can; the reason is that of the decided one.
    """
    try:
        return tracking.posture, tracking.solve(None if previous is None else previous.phases)
    except InfeasibleError as error:
        failure = error
    if not tracking.problem.arm.has_arm_angle:
        raise failure
    [others] = target_postures(StopBatch((tracking.problem,)))
    if isinstance(others, NoPosture):
        raise failure
    decided = tracking.posture
    difference = np.abs(wrap(others.psi - decided.psi_target)) + np.abs(
        wrap(others.yaw - decided.yaw)
    )
    order = np.lexsort((difference, others.branch != decided.branch))
    columns = (others.target, others.yaw, others.branch, others.psi)
    for target, yaw, branch, psi in zip(*(column[order] for column in columns), strict=True):
        posture = replace(
            tracking.posture,
            target=int(target),
            yaw=float(yaw),
            branch=int(branch),
            psi_target=float(psi),
            psi_approach=float(psi),
            psi_retract=float(psi),
        )
        try:
            return posture, replace(tracking, posture=posture).solve()
        except InfeasibleError:
            continue
    raise failure


@dataclass(frozen=True)
class MeetingSettings:
    """Settings of the search for a meeting with a part."""

    spare: float = 1e-3
    """Maximum time by which an arm is early for its part [s].

    It does not hold for a part that is met as early as it can be.
    """
    side: float = 0.1
    """Least distance of a new time from both bracketing times, relative to their difference."""
    farthest: float = 8.0
    """Largest step to a later time, relative to the arm's delay."""
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
    """Search for the earliest time at which an arm meets a part.

    The part's place depends on that time, and so does the arm's arrival. The bracket shrinks by the method of false
    position.
    """

    least: float
    """Earliest allowed time [s]."""
    last: float
    """Latest allowed time [s]."""
    time: float
    """Time under test [s]."""
    too_early: tuple[float, float] | None = None
    """Latest time known to be too early, and the arm's delay for it [s]."""
    rate: float = 1.0
    """Decrease of the delay per second of later time."""
    boldness: float = 1.0
    """Step to an earlier time, relative to the arm's spare time."""
    possible: tuple[float, float] | None = None
    """Earliest time known to be possible, and the arm's spare time for it [s]."""

    def note(self, arrival: float) -> bool:
        """Record the arm's earliest arrival for a meeting at `time`.

        Returns whether the search is over.

        Args:
            arrival: earliest arrival of the arm [s].
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
        """Choose the next time to try.

        False if even the last one is too early.
        """
        if self.possible is None:
            assert self.too_early is not None  # either has been recorded
            too_soon, late = self.too_early
            self.time = min(too_soon + late / self.rate + 0.5 * MEETING.spare, self.last)
            return too_soon < self.last
        high, spare = self.possible
        if self.too_early is None or self.too_early[0] >= high:
            self.time = max(self.least, high - self.boldness * spare + 0.5 * MEETING.spare)
            self.boldness = min(2.0 * self.boldness, MEETING.farthest)
            return True
        low, late = self.too_early
        # Zero of the linear interpolation between both times, and a little later.
        fraction = late / (late + spare) if late + spare > 0.0 else 0.5
        goal = low + fraction * (high - low) + 0.25 * MEETING.spare
        room = MEETING.side * (high - low)
        self.time = max(self.least, min(max(goal, low + room), high - room))
        return True


def too_late(arm_stop: ArmStop, time: float, late: float) -> Refusal:
    """Describe a part that is beyond its window at the arm's earliest arrival.

    Args:
        arm_stop: the stop.
        time: earliest arrival of the arm [s].
        late: part of it that avoids collisions with the other arm [s].
    """
    excess = _named_belt(arm_stop).gone(time) - _named_belt(arm_stop).within
    delay = [Refusal("delayed", measured=late)] if late > 0.0 else []
    return _at_belt("part_gone", arm_stop, excess, time=time, delay=delay)


def unfollowed(arm_stop: ArmStop, time: float, error: InfeasibleError) -> Refusal:
    """Describe a part that no posture follows from a time [s] on."""
    [cause] = error.refusals
    return _at_belt("part_not_followed", arm_stop, None, time=time, cause=cause)


def no_time(stops: Iterable[ArmStop]) -> Refusal:
    """Describe the failure to find meeting times for a stage's arms and parts."""
    moving = [stop for stop in stops if stop.stop.belt is not None]
    which = [
        Refusal("stop_of", None, stop.task.id, stop.arm, data={"action": stop.stop.action})
        for stop in moving
    ]
    windows = [_window(_named_belt(stop)) for stop in moving]
    data = {"stops": which, "windows": windows}
    return Refusal("parts_not_met", moving[0].stop.place, moving[0].task.id, data=data)


def _at_belt(key: str, arm_stop: ArmStop, measured: float | None, **details: object) -> Refusal:
    """Create the refusal of a stop at a moving part."""
    stop = arm_stop.stop
    details |= {"action": stop.action, "window": _window(_named_belt(arm_stop))}
    return Refusal(key, stop.place, arm_stop.task.id, arm_stop.arm, measured, data=details)


def _window(belt: OnBelt) -> Refusal:
    named = {"conveyor": belt.conveyor.name, "speed": belt.conveyor.speed}
    times = {"passes": belt.passes, "within": belt.within, "last": belt.last}
    return Refusal("window", data={**named, **times})


def _named_belt(arm_stop: ArmStop) -> OnBelt:
    belt = arm_stop.stop.belt
    assert belt is not None  # callers have checked
    return belt


Times = Mapping[tuple[str, str], float]
"""Meeting times of targets on conveyors [s], by task and action."""
Delays = Mapping[tuple[int, str], float]
"""Delays beyond the estimated arrivals [s], by stage number and arm."""


class MissedError(InfeasibleError):
    """Part that is not met in its window, or cannot be followed."""

    def __init__(self, refusal: Refusal, times: Times) -> None:
        """Store the meeting times known so far, for a better guess.

        Args:
            refusal: reason.
            times: estimated meeting times [s], by task and action.
        """
        super().__init__(refusal)
        self.times = times


@dataclass(frozen=True)
class ConveyorMeeting:
    """Conversion of decided stages to stages that meet moving parts."""

    model: CellModel
    """Cell model."""
    job: Job
    """Job; its targets on conveyors may be at any time."""
    timing: TimingSolver
    """Timing solver of transfers and lines."""
    delays: Delays = field(default_factory=dict)
    """Known delays of arms, such as those of repairs."""
    cache: MotionCache = field(default_factory=MotionCache)
    """Cache of timed motions."""
    dynamics: dict[object, Dynamics] | None = None
    """Models whose torques limit motions on belts, completed on demand; None for no limit."""

    def met(self, plans: list[StagePlan]) -> list[StagePlan]:
        """Convert stages so that every part is met and followed as early as possible.

        Platform angles, branches, yaws and arm angles stay as decided for the guessed places of the parts. The place of
        a meeting depends on its time, and the time on the arm's travel: the time is corrected until it is no earlier
        than the arm's arrival, and later by `spare` at most unless the part arrives just then. Neighbouring stages are
        joined to the changed ends.

        Args:
            plans: all stages of a plan, none of them repaired.

        Raises:
            MissedError: a part is not met in its window.
        """
        stages: list[StagePlan] = []
        clock = 0.0
        position = plans[0].start
        for k, plan in enumerate(plans):
            begin = None if k == 0 and self.job.start == "free" else position
            goal = stages[0].start if stages and not plan.stops and self.job.returns else None
            try:
                stage, motion = self._stage(k, plan, begin, goal, clock)
            except MissedError as error:
                error.times = {**met_times(stages), **error.times}
                raise
            stages.append(stage)
            clock += motion.trajectory.duration
            position = stage.end
        return stages

    def _stage(
        self,
        k: int,
        plan: StagePlan,
        begin: FloatArray | None,
        goal: FloatArray | None,
        clock: float,
    ) -> tuple[StagePlan, Motion]:
        """Convert a stage to meet its parts.

        Returns it and its motion with all waits.
        """
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
                motion_on_belt = stops[name].tracked
                assert motion_on_belt is not None  # a followed part has a motion
                tracked[name] = motion_on_belt
            stage = self._joined(plan, stops, begin, goal)
            motion = self._timed(stage, clock)
            arrivals = {event.arm: clock + event.time for event in motion.events}
            # Without waits for parts, but with those for windows of tasks.
            early = self._earliest(stage, clock) if search else {}
            settled = [
                meeting.note(early[name] + self.delays.get((k, name), 0.0))
                for name, meeting in search.items()
            ]
            if all(
                abs(arrivals[name] - meeting.time) <= MEETING.exact
                for name, meeting in search.items()
            ):
                if best is None or motion.trajectory.duration < best[1].trajectory.duration:
                    best = stage, motion
                if all(settled):
                    return stage, motion
            for name, meeting in search.items():
                if not meeting.next():
                    arrival = meeting.last + (meeting.too_early[1] if meeting.too_early else 0.0)
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
        previous_motion: Tracked | None,
    ) -> ArmStop:
        """Compute a stop that follows its part from the tried time or later."""
        meeting = search[arm_stop.arm]
        before, time, first = meeting.time, meeting.time, meeting.time
        tracked_stop: ArmStop | None = None
        if time > meeting.last:
            raise MissedError(too_late(arm_stop, time, 0.0), _named(plan, search))
        while tracked_stop is None:
            try:
                tracked_stop = self._tracked(plan, arm_stop, time, previous_motion)
            except InfeasibleError as error:
                before, time = time, time + (meeting.last - meeting.least) / MEETING.tries
                if time > meeting.last:
                    refusal = unfollowed(arm_stop, first, error)
                    raise MissedError(refusal, _named(plan, search)) from None
        while time - before > MEETING.narrow:
            middle = 0.5 * (before + time)
            try:
                tracked_stop, time = self._tracked(plan, arm_stop, middle, previous_motion), middle
            except InfeasibleError:
                before = middle
        meeting.time = time
        if before < time:
            # No earlier time is tried any more.
            meeting.least = time
        return tracked_stop

    def _tracked(
        self, plan: StagePlan, arm_stop: ArmStop, time: float, previous: Tracked | None
    ) -> ArmStop:
        """Compute a stop that tracks its target from a time on."""
        model, job, belt = self.model, self.job, _belt(arm_stop)
        R_world, _ = model.carried_frame(plan.arrival)
        velocity = product(R_world.T, belt.conveyor.velocity)
        shift = velocity * (time - belt.at)
        stop_problem = arm_stop.problem
        problem = replace(stop_problem, p_base_tool=stop_problem.p_base_tool + shift)
        task, action, models = arm_stop.task, arm_stop.stop.action, self.dynamics
        care = task.care_before(action).stricter(task.care_after(action))
        limits = MotionLimits.of(job, {arm_stop.arm: care} if care.slows else {})
        tracking = Tracking(
            problem,
            arm_stop.posture,
            velocity,
            arm_stop.stop.dwell.total,
            limits.joints.select(model.arms[arm_stop.arm].arm.joints),
            limits.caps.get(arm_stop.arm),
            1.0 / (job.speed * care.speed),
            None
            if models is None
            else TrackingTorques.of(job.cell, arm_stop, plan.arrival, models),
        )
        decided, tracked = followed_posture(tracking, previous)
        posture = replace(
            decided,
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
        """Join a stage to the one before, and to its stops or the begin."""
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
        """Compute the arms' earliest arrivals without waits for parts [s]."""
        free = {
            name: replace(stop, stop=replace(stop.stop, belt=None))
            for name, stop in stage.stops.items()
        }
        motion = self._timed(replace(stage, stops=free), clock)
        return {event.arm: clock + event.time for event in motion.events}


def met_times(plans: Sequence[StagePlan]) -> Times:
    """Return the meeting times of stages [s]."""
    return {
        (stop.task.id, stop.stop.action): stop.stop.belt.at
        for plan in plans
        for stop in plan.stops.values()
        if stop.stop.belt is not None
    }


def _named(plan: StagePlan, search: Mapping[str, MeetingTime]) -> Times:
    """Return the times under test by task and action."""
    return {
        (plan.stops[name].task.id, plan.stops[name].stop.action): meeting.time
        for name, meeting in search.items()
    }


def _belt(arm_stop: ArmStop) -> OnBelt:
    belt = arm_stop.stop.belt
    assert belt is not None  # callers have checked
    return belt
