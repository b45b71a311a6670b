"""Transfers of one stage: platform and arms leave together and arrive when needed."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import field, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray, distinct
from dualarm_cli.geometry.products import norm
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job, Stop
from dualarm_cli.model.rest_to_rest import rest_to_rest_duration
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.schedule import TOOL_SPEED
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.postures.stage_plan import StagePlan
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal
from dualarm_cli.timing import TimingSolver
from dualarm_cli.timing.problem import TransferProblem
from dualarm_cli.timing.ruckig_ import solve_moving_transfer

PLATFORM = "platform"
"""Name of the joint group of the platform; arms' groups bear the arms' names."""


@dataclass(frozen=True)
class SpeedSettings:
    """Numbers that keep tools below a speed cap."""

    speed_sample: float = 1e-3
    """Spacing of the instants at which tool speeds are measured [s]."""
    speed_step: float = 1e-5
    """Half-width of the central difference that measures them [s]."""
    coarse: int = 4
    """Stride of the instants at which tool speeds are measured first."""
    fast: float = 0.9
    """Share of the largest speed above which the instants around are measured as well."""
    speed_tries: int = 36
    """Maximum number of velocity factors tried for a tool-speed cap."""
    sure: int = 5
    """Number of tries after which every other factor halves the remaining range."""


SPEED = SpeedSettings()

SPEED_MARGIN = 1e-3
"""Share of the tool-speed cap kept free for what lies between the instants."""
CLOSE = 5e-4
"""A motion whose fastest tool is slower than the cap by no more than this share is as good as any."""
SLOWEST = 4096
"""No joint is slowed to less than this part of its speed."""


@dataclass(frozen=True)
class Transfers:
    """One stage's transfers."""

    motion: Mapping[str, Trajectory]
    """By joint group; groups with nothing to do are missing."""
    times: Mapping[str, float]
    """Closed-form time of each group on its own [s]."""
    joint_times: Mapping[str, float]
    """Closed-form time of each joint on its own [s]."""
    slowest: Mapping[str, str]
    """Each group's slowest joint; empty where nothing moves."""
    capped: bool = False
    """Whether all were slowed for a cap on the tools' speed."""

    def bottleneck(self, arm: str) -> str:
        """Returns the joint for which an arm's line waits, TOOL_SPEED if capped; of all groups if `arm` is empty."""
        groups = [g for g in self.times if g in (arm, PLATFORM) or not arm]
        slowest = max(groups, key=lambda g: self.times[g])
        if not self.times[slowest] > 0:
            return ""
        return TOOL_SPEED if self.capped else self.slowest[slowest]


Key = tuple[Hashable, ...]
"""All that something depends on."""


@dataclass(frozen=True)
class MotionCache:
    """What has been timed already in one job, so that it is not timed again where other stages are repaired."""

    lines: dict[Key, tuple[Stop, Trajectory]] = field(default_factory=dict)
    """Lines, with their stop, lest another one takes its identity."""
    paths: dict[Key, tuple[Stop, FloatArray, FloatArray]] = field(default_factory=dict)
    """Joints along lines and lengths travelled, with their stop."""
    transfers: dict[Key, Transfers] = field(default_factory=dict)
    """Straight transfers of stages."""
    moving: dict[Key, Trajectory | None] = field(default_factory=dict)
    """Transfers of one group that begin or end in motion; None where there is none."""


@dataclass(frozen=True)
class Drive:
    """What the joints of a job may do and how their motion is timed."""

    model: CellModel
    """The job's cell."""
    columns: Mapping[str, list[int]]
    """Columns of each joint group within the limits' joints."""
    limits: JointLimits
    """Of all joints, at the job's pace."""
    timing: TimingSolver
    """How transfers, lines and curves are timed."""
    cap: float | None
    """Largest speed of any tool centre point in the world [m/s], or None."""
    cache: MotionCache = field(default_factory=MotionCache)
    """What is timed already."""

    @staticmethod
    def of(
        model: CellModel, job: Job, timing: TimingSolver, cache: MotionCache | None = None
    ) -> Drive:
        """Returns the drive of a job: the platform's group, if there is one, then the arms'."""
        robot = job.cell.robot
        columns = {PLATFORM: model.platform_columns} if robot.platform else {}
        columns |= {name: arm.columns for name, arm in model.arms.items()}
        cache = MotionCache() if cache is None else cache
        return Drive(model, columns, job.limits, timing, job.tool_speed, cache)

    @cached_property
    def own_limits(self) -> Mapping[str, JointLimits]:
        """Limits of each group's joints."""
        return {group: self.limits.select(self.joints(group)) for group in self.columns}

    def joints(self, group: str) -> tuple[str, ...]:
        """Returns the names of a group's joints."""
        return tuple(self.limits.joints[i] for i in self.columns[group])


Rates = Mapping[str, tuple[FloatArray | None, FloatArray | None]]
"""Velocities and accelerations, shape (2, n), with which groups leave and arrive; None: at rest."""


def time_transfers(
    drive: Drive,
    plan: StagePlan,
    rates: Rates | None = None,
    longer: Mapping[str, float] | None = None,
    *,
    resting: bool = True,
) -> Transfers:
    """Returns the transfers of one stage.

    An arm's transfer lasts as long as its slowest joint, or the platform's where that is slower, because its line
    starts when both are there. The platform arrives with the first arm that waits for it. In a return all arrive
    together, but for arms that leave in motion.

    Args:
        drive: of the job.
        plan: the stage.
        rates: of arms that leave or arrive in motion.
        longer: how long transfers of such arms take at least [s].
        resting: whether those of the others are wanted, which there are in any case.

    Raises:
        InfeasibleError: no transfer leaves and arrives in such motion.
    """
    columns, limits = drive.columns, drive.limits
    moved = np.abs(plan.arrival - plan.start)
    alone = rest_to_rest_duration(moved, limits.velocity, limits.acceleration, limits.jerk)
    times = {g: float(alone[index].max()) for g, index in columns.items()}
    slowest = {
        g: limits.joints[index[int(np.argmax(alone[index]))]] if times[g] > 0 else ""
        for g, index in columns.items()
    }
    platform = times.get(PLATFORM, 0.0)
    motion = {}

    def problem(group: str, length: float) -> TransferProblem:
        index, own = columns[group], drive.own_limits[group]
        leaving, arriving = (rates or {}).get(group, (None, None))
        return TransferProblem(
            own.joints, plan.start[index], plan.arrival[index], own, length, leaving, arriving
        )

    if rates and not plan.stops and PLATFORM in rates:
        # Platform and arms are back together.
        motion = _all_together(drive, plan, rates, times)
        return Transfers(
            motion, times, dict(zip(limits.joints, alone.tolist(), strict=True)), slowest
        )
    lengths = {g: max(platform, times[g]) for g in times if g != PLATFORM}
    # The platform first: arms may wait for it.
    for group in sorted(rates or {}, key=lambda group: group != PLATFORM):
        least = platform if plan.stops else max(times.values())
        least = max(0.0 if group == PLATFORM else least, (longer or {}).get(group, 0.0))
        found = _moving(drive, group, problem(group, least))
        if found is None:
            raise InfeasibleError(Refusal("no_plan_on_grid"))
        motion[group], lengths[group] = found, found.duration
        if group == PLATFORM:
            platform = found.duration
            lengths |= {g: max(platform, times[g]) for g in times if g != PLATFORM}
    if not plan.stops:
        lengths = dict.fromkeys(times, max(times.values()))
    elif PLATFORM in times and PLATFORM not in motion:
        lengths[PLATFORM] = min(lengths[name] for name in plan.stops)
    for group in columns if resting else ():
        if group not in motion and (times[group] > 0 or group in plan.stops):
            motion[group] = drive.timing.transfer(problem(group, lengths[group]))
    joint_times = dict(zip(limits.joints, alone.tolist(), strict=True))
    return Transfers(motion, times, joint_times, slowest)


def _moving(drive: Drive, group: str, asked: TransferProblem) -> Trajectory | None:
    """Returns a group's transfer that begins or ends in motion, under the job's limits; None where there is none."""
    ends = (asked.start, asked.goal, *asked.rates())
    key: Key = (group, asked.minimum_duration, *(end.tobytes() for end in ends))
    if key not in drive.cache.moving:
        drive.cache.moving[key] = solve_moving_transfer(asked)
    return drive.cache.moving[key]


def _all_together(
    drive: Drive, plan: StagePlan, rates: Rates, times: Mapping[str, float]
) -> dict[str, Trajectory]:
    """Returns transfers of platform and arms that are back at the same instant, by group.

    Args:
        drive: of the job.
        plan: the return.
        rates: of groups that leave or arrive in motion.
        times: closed-form times of the groups [s].

    Raises:
        InfeasibleError: no transfer leaves and arrives in such motion.
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
    asked = TransferProblem(
        names, plan.start[index], plan.arrival[index], drive.limits.select(names), 0.0, *ends
    )
    found = solve_moving_transfer(asked)
    if found is None:
        raise InfeasibleError(Refusal("no_plan_on_grid"))
    return {g: found.select(drive.joints(g)) for g in groups}


def transfers_within_tool_speed(
    drive: Drive,
    plan: StagePlan,
    rates: Rates | None = None,
    longer: Mapping[str, float] | None = None,
) -> Transfers:
    """Returns the transfers, slowed until no tool exceeds the cap on its speed.

    All joint velocity limits are lowered by one factor; accelerations and jerks stay, so that the tools reach the cap
    as fast as before. A transfer that leaves or arrives in motion cannot be slowed: who asks for it looks at its
    speed (`tool_speed_of`).

    Args:
        drive: of the job.
        plan: the stage.
        rates: of arms that leave or arrive in motion.
        longer: how long transfers of such arms take at least [s].
    """
    transfers = time_transfers(drive, plan, rates, longer)
    cap, limits = drive.cap, drive.limits
    if cap is None or not transfers.motion or rates:
        return transfers

    def slower(factor: float) -> Transfers:
        if factor == 1.0:
            return transfers
        slow = replace(limits, velocity=limits.velocity * factor)
        return time_transfers(replace(drive, limits=slow, cache=MotionCache()), plan)

    best = slowed(slower, lambda tried: tool_speed_of(drive, plan, tried), cap)
    if best is None:
        more = {"slowest": SLOWEST}
        raise InfeasibleError(Refusal("tool_speed_too_low", allowed=cap, more=more))
    return best if best is transfers else replace(best, capped=True)


def tool_speed_of(drive: Drive, plan: StagePlan, transfers: Transfers) -> float:
    """Returns the largest speed of a tool in a stage's transfers [m/s]."""
    return largest_tool_speed(
        drive.model,
        list(drive.model.arms),
        lambda time: _positions(plan, drive.columns, transfers, time),
        max(t.duration for t in transfers.motion.values()),
    )


T = TypeVar("T")


def slowed(make: Callable[[float], T], speed: Callable[[T], float], cap: float) -> T | None:
    """Returns the fastest motion found in which no tool exceeds a cap on its speed; None for none.

    Where velocity limits decide, speed is proportional to them: so the next factor follows from the speed of the last
    one. Where they do not decide, and that leads nowhere soon, every other one halves what is left.

    Args:
        make: the motion with all velocity limits times a factor; that with 1 is tried first.
        speed: the largest speed of a tool in a motion [m/s].
        cap: what is allowed [m/s]; SPEED_MARGIN of it is kept free.
    """
    allowed = cap * (1.0 - SPEED_MARGIN)
    best, low, high, factor = None, 0.0, 1.0, 1.0
    for k in range(SPEED.speed_tries):
        tried = make(factor)
        fastest = speed(tried)
        if fastest <= allowed:
            best, low = tried, factor
            if factor == 1.0 or fastest >= (1.0 - CLOSE) * allowed:
                return best
        else:
            high = factor
        factor *= (1.0 - 0.5 * CLOSE) * allowed / fastest if fastest > 0.0 else 1.0
        if not low < factor < high or (k >= SPEED.sure and k % 2):
            factor = 0.5 * (low + high)
        if factor < 1.0 / SLOWEST or high - low < 0.1 * CLOSE * high:
            break
    return best


def largest_tool_speed(
    model: CellModel,
    arms: Sequence[str],
    position_at: Callable[[FloatArray], FloatArray],
    length: float,
) -> float:
    """Measure the largest speed of the arms' tool centre points [m/s].

    Instants are `speed_sample` apart: first every `coarse`-th one, then all those about fast ones.

    Args:
        model: the cell.
        arms: their names.
        position_at: all joints (m, n) [rad] at instants (m,) [s].
        length: of the motion [s].
    """

    def speeds(time: FloatArray) -> FloatArray:
        both = position_at(np.concatenate([time - SPEED.speed_step, time + SPEED.speed_step]))
        tip = model.tool_positions(arms, both)
        way = tip[:, len(time) :] - tip[:, : len(time)]
        largest: FloatArray = norm(way, axis=-1).max(axis=0)
        return largest / (2.0 * SPEED.speed_step)

    coarse = np.arange(0.0, length + SPEED.speed_sample, SPEED.coarse * SPEED.speed_sample)
    found = speeds(coarse)
    near = coarse[found >= SPEED.fast * found.max()]
    steps = SPEED.speed_sample * np.delete(
        np.arange(-SPEED.coarse + 1, SPEED.coarse), SPEED.coarse - 1
    )
    between = distinct((near[:, None] + steps).round(9))
    return max(float(found.max()), float(speeds(between).max(initial=0.0)))


def _positions(
    plan: StagePlan,
    columns: Mapping[str, list[int]],
    transfers: Transfers,
    time: FloatArray,
) -> FloatArray:
    """Returns all joints at the given times of the stage, shape (m, n)."""
    q = np.tile(plan.start, (len(time), 1))
    for group, trajectory in transfers.motion.items():
        q[:, columns[group]] = trajectory.at(time)[0]
    return q
