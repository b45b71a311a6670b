"""Times and motion of one stage's transfers, from the joint limits."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from dataclasses import field, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray, distinct
from dualarm_cli.geometry.products import norm
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job, Stop
from dualarm_cli.model.motion.rest_to_rest import rest_to_rest_duration
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.motion_limits import MotionLimits
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.schedule import TOOL_SPEED
from dualarm_cli.motion.builder import Motion
from dualarm_cli.postures.stage_plan import ArmStop, StagePlan
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal
from dualarm_cli.timing import TimingSolver
from dualarm_cli.timing.launch import Launch
from dualarm_cli.timing.problem import TransferProblem
from dualarm_cli.timing.ruckig_ import solve_moving_transfer

PLATFORM = "platform"
"""Name of the platform's joint group; arms' groups have the arms' names."""


@dataclass(frozen=True)
class SpeedSettings:
    """Settings of measuring the tool speed, and of the search for slower joints."""

    speed_sample: float = 1e-3
    """Spacing of the instants at which tool speeds are measured [s]."""
    speed_step: float = 1e-5
    """Half-width of the central difference that measures them [s]."""
    coarse: int = 4
    """Stride of the instants at which tool speeds are measured first."""
    fast: float = 0.9
    """Fraction of the largest speed above which neighbouring instants are measured."""
    speed_tries: int = 36
    """Maximum number of velocity factors that are tried."""
    sure: int = 5
    """Number of attempts after which every other factor halves the remaining range."""


SPEED = SpeedSettings()

SPEED_MARGIN = 1e-3
"""Fraction of the speed limit that is kept free for motion between the instants."""
SPEED_TOLERANCE = 5e-4
"""Relative distance from the speed limit at which the search ends."""
MAX_SLOWDOWN = 4096
"""Largest factor by which joints are slowed."""


@dataclass(frozen=True)
class Transfers:
    """Timed transfers of one stage: trajectories, minimum times and slowest joints."""

    motion: Mapping[str, Trajectory]
    """Motion by joint group; groups without motion are missing."""
    times: Mapping[str, float]
    """Minimum time of each group alone [s]."""
    joint_times: Mapping[str, float]
    """Minimum time of each joint alone [s]."""
    slowest: Mapping[str, str]
    """Slowest joint of each group; empty if nothing moves."""
    capped: frozenset[str] = frozenset()
    """Groups that were slowed to keep limits of tool speed."""

    def bottleneck(self, arm: str) -> str:
        """Name the joint that delays an arm's line, TOOL_SPEED if capped.

        An empty `arm` stands for all groups.
        """
        groups = [g for g in self.times if g in (arm, PLATFORM) or not arm]
        slowest = max(groups, key=lambda g: self.times[g])
        if not self.times[slowest] > 0:
            return ""
        return TOOL_SPEED if slowest in self.capped else self.slowest[slowest]


Key = tuple[Hashable, ...]
"""Key of a cached value: everything that it depends on."""


@dataclass(frozen=True)
class MotionCache:
    """Cache of timed motions, reused when other stages are repaired."""

    lines: dict[Key, tuple[Stop, Trajectory]] = field(default_factory=dict)
    """Timed lines, with their stop, which keeps its identity from being reused."""
    paths: dict[Key, tuple[Stop, FloatArray, FloatArray]] = field(default_factory=dict)
    """Joints along lines and lengths travelled, with their stop."""
    transfers: dict[Key, Transfers] = field(default_factory=dict)
    """Straight transfers of stages."""
    moving: dict[Key, Trajectory | None] = field(default_factory=dict)
    """Transfers of one group that begin or end in motion; None if infeasible."""
    launches: dict[Key, tuple[Launch | None, Launch | None] | None] = field(default_factory=dict)
    """Launches around transfers, at the retract before and the approach after; None at rest."""


@dataclass(frozen=True)
class Drive:
    """Joint groups of a job, with limits and timing."""

    model: CellModel
    """Cell of the job."""
    columns: Mapping[str, list[int]]
    """Columns of each joint group within the limits' joints."""
    job: Job
    """Job with its limits, tasks and parts."""
    limits: JointLimits
    """Limits of all joints: of the job, or of one stage or line."""
    timing: TimingSolver
    """Solver for transfers, lines and curves."""
    caps: Mapping[str, float]
    """Speed limits of tool centre points [m/s], by arm; arms without one are missing."""
    cache: MotionCache = field(default_factory=MotionCache)
    """Motions that were timed so far."""
    care: Key = ()
    """Care that `limits` and `caps` include, see `MotionLimits`."""

    @staticmethod
    def of(
        model: CellModel, job: Job, timing: TimingSolver, cache: MotionCache | None = None
    ) -> Drive:
        """Build the drive of a job: the platform's group, if any, then the arms'."""
        robot = job.cell.robot
        columns = {PLATFORM: model.platform_columns} if robot.platform else {}
        columns |= {name: arm.columns for name, arm in model.arms.items()}
        cache = MotionCache() if cache is None else cache
        limits = MotionLimits.of(job)
        return Drive(model, columns, job, limits.joints, timing, limits.caps, cache)

    def to(self, plan: StagePlan) -> Drive:
        """Return the drive under the limits of a stage's transfers."""
        if not plan.stops or not self.job.slows:
            return self
        keys = ((arm, s.task.id, s.stop.action) for arm, s in plan.stops.items())
        return self._under(MotionLimits.of_stage(self.job, frozenset(keys)))

    def along(self, arm_stop: ArmStop, line: str) -> Drive:
        """Return the drive under the limits of a stop's `approach` or `retract`."""
        task, action = arm_stop.task, arm_stop.stop.action
        care = task.care_before(action) if line == "approach" else task.care_after(action)
        return self._under(MotionLimits.of(self.job, {arm_stop.arm: care} if care.slows else {}))

    def _under(self, limits: MotionLimits) -> Drive:
        if limits.care == self.care:
            return self
        return replace(self, limits=limits.joints, caps=limits.caps, care=limits.care)

    @cached_property
    def group_limits(self) -> Mapping[str, JointLimits]:
        """Limits of each group's joints."""
        return {group: self.limits.select(self.joints(group)) for group in self.columns}

    def joints(self, group: str) -> tuple[str, ...]:
        """Return the names of a group's joints."""
        return tuple(self.limits.joints[i] for i in self.columns[group])


Rates = Mapping[str, tuple[FloatArray | None, FloatArray | None]]
"""Velocities and accelerations of departure and arrival by group; None at rest.

Each has shape (2, n).
"""


def time_transfers(
    drive: Drive,
    plan: StagePlan,
    rates: Rates | None = None,
    minimum: Mapping[str, float] | None = None,
    *,
    resting: bool = True,
) -> Transfers:
    """Time the transfers of one stage.

    An arm's transfer lasts as long as its slowest joint, or the platform's where that is slower, because its line
    starts when both are there. The platform arrives with the first arm that waits for it. In a return all arrive
    together, except for arms that depart in motion.

    Args:
        drive: of the job.
        plan: the stage.
        rates: rates of arms that depart or arrive in motion.
        minimum: minimum durations of their transfers [s].
        resting: whether to include transfers from rest to rest, which always exist.

    Raises:
        InfeasibleError: no transfer has these rates.
    """
    columns, limits = drive.columns, drive.limits
    moved = np.abs(plan.arrival - plan.start)
    joint_times = rest_to_rest_duration(moved, limits.velocity, limits.acceleration, limits.jerk)
    times = {g: float(joint_times[index].max()) for g, index in columns.items()}
    slowest = {
        g: limits.joints[index[int(np.argmax(joint_times[index]))]] if times[g] > 0 else ""
        for g, index in columns.items()
    }
    platform = times.get(PLATFORM, 0.0)
    motion = {}

    def problem(group: str, length: float) -> TransferProblem:
        index, group_limits = columns[group], drive.group_limits[group]
        leaving, arriving = (rates or {}).get(group, (None, None))
        return TransferProblem(
            group_limits.joints,
            plan.start[index],
            plan.arrival[index],
            group_limits,
            length,
            leaving,
            arriving,
        )

    if rates and not plan.stops and PLATFORM in rates:
        # Platform and arms return together.
        motion = _all_together(drive, plan, rates, times)
        return Transfers(
            motion, times, dict(zip(limits.joints, joint_times.tolist(), strict=True)), slowest
        )
    lengths = {g: max(platform, times[g]) for g in times if g != PLATFORM}
    # The platform first: arms may wait for it.
    for group in sorted(rates or {}, key=lambda group: group != PLATFORM):
        least = platform if plan.stops else max(times.values())
        least = max(0.0 if group == PLATFORM else least, (minimum or {}).get(group, 0.0))
        moving = _moving(drive, group, problem(group, least))
        if moving is None:
            raise InfeasibleError(Refusal("no_plan_on_grid"))
        motion[group], lengths[group] = moving, moving.duration
        if group == PLATFORM:
            platform = moving.duration
            lengths |= {g: max(platform, times[g]) for g in times if g != PLATFORM}
    if not plan.stops:
        lengths = dict.fromkeys(times, max(times.values()))
    elif PLATFORM in times and PLATFORM not in motion:
        lengths[PLATFORM] = min(lengths[name] for name in plan.stops)
    for group in columns if resting else ():
        if group not in motion and (times[group] > 0 or group in plan.stops):
            motion[group] = drive.timing.transfer(problem(group, lengths[group]))
    by_joint = dict(zip(limits.joints, joint_times.tolist(), strict=True))
    return Transfers(motion, times, by_joint, slowest)


def _moving(drive: Drive, group: str, problem: TransferProblem) -> Trajectory | None:
    """Time a group's transfer that begins or ends in motion; None if infeasible."""
    ends = (problem.start, problem.goal, *problem.rates())
    key: Key = (group, drive.care, problem.minimum_duration, *(end.tobytes() for end in ends))
    if key not in drive.cache.moving:
        drive.cache.moving[key] = solve_moving_transfer(problem)
    return drive.cache.moving[key]


def _all_together(
    drive: Drive, plan: StagePlan, rates: Rates, times: Mapping[str, float]
) -> dict[str, Trajectory]:
    """Time transfers of platform and arms that arrive at the same time, by group.

    Args:
        drive: of the job.
        plan: the return.
        rates: rates of groups that depart or arrive in motion.
        times: minimum times of the groups [s].

    Raises:
        InfeasibleError: no transfer has these rates.
    """
    groups = [g for g in drive.columns if times[g] > 0 or g in rates]
    names = tuple(joint for g in groups for joint in drive.joints(g))
    index = [column for g in groups for column in drive.columns[g]]
    ends = [np.zeros((2, len(index))) for _ in range(2)]
    for end, rows in enumerate(ends):
        first = 0
        for g in groups:
            rate, count = rates.get(g, (None, None))[end], len(drive.columns[g])
            rows[:, first : first + count] = 0.0 if rate is None else rate
            first += count
    problem = TransferProblem(
        names, plan.start[index], plan.arrival[index], drive.limits.select(names), 0.0, *ends
    )
    motion = solve_moving_transfer(problem)
    if motion is None:
        raise InfeasibleError(Refusal("no_plan_on_grid"))
    return {g: motion.select(drive.joints(g)) for g in groups}


def transfers_within_tool_speed(
    drive: Drive,
    plan: StagePlan,
    rates: Rates | None = None,
    minimum: Mapping[str, float] | None = None,
) -> Transfers:
    """Time the transfers, slowed until no tool exceeds its speed limit.

    The velocity limits of the platform and of arms with such a limit are reduced by one factor. Acceleration and jerk
    limits stay, so that tools reach the limit as fast as before. A transfer that begins or ends in motion cannot be
    slowed: its caller checks the speed (`within_tool_speed`).

    Args:
        drive: of the job.
        plan: the stage.
        rates: rates of arms that depart or arrive in motion.
        minimum: minimum durations of their transfers [s].
    """
    transfers = time_transfers(drive, plan, rates, minimum)
    limits, capped = drive.limits, frozenset({*drive.caps, PLATFORM})
    if not drive.caps or not transfers.motion or rates:
        return transfers
    columns = [i for g in capped for i in drive.columns.get(g, [])]

    def slower(factor: float) -> Transfers:
        if factor == 1.0:
            return transfers
        velocity = limits.velocity.copy()
        velocity[columns] *= factor
        slow = replace(limits, velocity=velocity)
        return time_transfers(replace(drive, limits=slow, cache=MotionCache()), plan)

    best = slowed(slower, lambda candidate: tool_speed_of(drive, plan, candidate), drive.caps)
    if best is None:
        details, cap = {"slowest": MAX_SLOWDOWN}, min(drive.caps.values())
        raise InfeasibleError(Refusal("tool_speed_too_low", allowed=cap, data=details))
    return best if best is transfers else replace(best, capped=capped)


def tool_speed_of(drive: Drive, plan: StagePlan, transfers: Transfers) -> float:
    """Compute the largest speed of a tool with a limit in a stage's transfers, see `largest_tool_speed`."""
    return largest_tool_speed(
        drive.model,
        drive.caps,
        lambda time: _positions(plan, drive.columns, transfers, time),
        max(t.duration for t in transfers.motion.values()),
    )


T = TypeVar("T")


def within_tool_speed(drive: Drive, plan: StagePlan, transfers: Transfers) -> bool:
    """Check whether the tools keep their speed limits in a stage's transfers."""
    caps = drive.caps
    return not caps or tool_speed_of(drive, plan, transfers) <= min(caps.values())


def slowed(
    make: Callable[[float], T], speed: Callable[[T], float], caps: Mapping[str, float]
) -> T | None:
    """Find the fastest motion whose tools keep a speed limit, or None.

    Where velocity limits decide, speed is proportional to them, so that the next factor follows from the last speed.
    Otherwise every other factor halves the remaining range.

    Args:
        make: motion with all velocity limits times a factor; 1 is tried first.
        speed: largest speed of a tool in a motion, see `largest_tool_speed` [m/s].
        caps: speed limit by arm [m/s]; SPEED_MARGIN of the least one is kept free.
    """
    allowed = min(caps.values()) * (1.0 - SPEED_MARGIN)
    best, low, high, factor = None, 0.0, 1.0, 1.0
    for k in range(SPEED.speed_tries):
        motion = make(factor)
        fastest = speed(motion)
        if fastest <= allowed:
            best, low = motion, factor
            if factor == 1.0 or fastest >= (1.0 - SPEED_TOLERANCE) * allowed:
                return best
        else:
            high = factor
        factor *= (1.0 - 0.5 * SPEED_TOLERANCE) * allowed / fastest if fastest > 0.0 else 1.0
        if not low < factor < high or (k >= SPEED.sure and k % 2):
            factor = 0.5 * (low + high)
        if factor < 1.0 / MAX_SLOWDOWN or high - low < 0.1 * SPEED_TOLERANCE * high:
            break
    return best


def largest_tool_speed(
    model: CellModel,
    caps: Mapping[str, float],
    position_at: Callable[[FloatArray], FloatArray],
    duration: float,
) -> float:
    """Measure the largest speed of the arms' tool centre points [m/s].

    Speeds of arms with a higher limit than the least one are reduced in proportion. Instants are `speed_sample` apart:
    first every `coarse`-th one, then those next to fast ones.

    Args:
        model: the cell.
        caps: speed limit by arm [m/s].
        position_at: all joints (m, n) [rad] at instants (m,) [s].
        duration: duration of the motion [s].
    """
    arms, limits = list(caps), np.array(list(caps.values()))
    scale = (limits.min() / limits)[:, None]

    def speeds(time: FloatArray) -> FloatArray:
        both = position_at(np.concatenate([time - SPEED.speed_step, time + SPEED.speed_step]))
        tip = model.tool_positions(arms, both)
        displacement = tip[:, len(time) :] - tip[:, : len(time)]
        largest: FloatArray = (scale * norm(displacement, axis=-1)).max(axis=0)
        return largest / (2.0 * SPEED.speed_step)

    coarse = np.arange(0.0, duration + SPEED.speed_sample, SPEED.coarse * SPEED.speed_sample)
    measured = speeds(coarse)
    fast = coarse[measured >= SPEED.fast * measured.max()]
    steps = SPEED.speed_sample * np.delete(
        np.arange(-SPEED.coarse + 1, SPEED.coarse), SPEED.coarse - 1
    )
    between = distinct((fast[:, None] + steps).round(9))
    return max(float(measured.max()), float(speeds(between).max(initial=0.0)))


def keeps_tool_speed(
    model: CellModel, caps: Mapping[str, float], motion: Motion, stage: int = 0
) -> bool:
    """Check the speed limits of tools until they reach their targets of a stage.

    Args:
        model: the cell.
        caps: speed limit by arm [m/s].
        motion: the motion.
        stage: index of the stage in it.
    """
    span, whole = motion.stages[stage], motion.trajectory
    for arm, cap in caps.items():
        event = motion.event_of.get((stage, arm))
        length = (span.end if event is None else event.time) - span.start
        fastest = largest_tool_speed(
            model, {arm: cap}, lambda time: whole.clamped(span.start + time)[0], length
        )
        if fastest > cap:
            return False
    return True


def _positions(
    plan: StagePlan,
    columns: Mapping[str, list[int]],
    transfers: Transfers,
    time: FloatArray,
) -> FloatArray:
    """Compute all joints at given times of the stage, shape (m, n)."""
    q = np.tile(plan.start, (len(time), 1))
    for group, trajectory in transfers.motion.items():
        q[:, columns[group]] = trajectory.clamped(time)[0]
    return q
