"""Sensitivity of the cycle time to assumed limits, with the plan's postures kept."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.geometry.elementary import cbrt, cos, power
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.model.motion.rest_to_rest import RestToRest
from dualarm_cli.model.motion.trajectory import SAME_TIME, Trajectory
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.schedule import DURATION, Schedule
from dualarm_cli.records import dataclass
from dualarm_cli.report.stage_parts import PLATFORM, StageParts, is_handover, overlap, stage_parts
from dualarm_cli.timing.shapes import symmetric_grid
from dualarm_cli.timing.spline import largest_rates
from dualarm_cli.timing.stage_length import stage_length


@dataclass(frozen=True)
class SensitivitySettings:
    """Resolution of sensitivities to limits."""

    samples: int = 9
    """Samples of each path."""
    instants: int = 96
    """Instants per line from which its path is read off the trajectory."""
    per_phase: int = 2
    """Instants per phase of a shape at which joint rates are evaluated."""
    speed_bisections: int = 40
    """Bisections for the slowing of transfers under a tool-speed cap."""
    at_rest: float = 1e-6
    """Speed below which a joint is at rest, apart from rounding [rad/s or m/s]."""
    slowed: float = 1e-6
    """Least relative excess over the closed form that indicates a tool-speed cap."""
    share: float = 0.1
    """Relative change of the limits."""


SENSITIVITY = SensitivitySettings()

SHAPES = symmetric_grid(
    np.array([0.5, 0.42, 0.34, 0.25, 0.17]), np.array([0.5, 0.4, 0.3, 0.22, 0.15, 0.1, 0.06]), 1.2
)
"""Double-S shapes; each line takes the fastest."""


def line_factors(
    trajectory: Trajectory,
    spans: FloatArray,
    limits: JointLimits,
    acceleration: FloatArray,
    jerk: FloatArray,
) -> FloatArray:
    """Compute durations of lines under changed limits relative to the current limits, (v, k).

    A line's time is that of the fastest double-S shape along the path, whose coordinate is the length in joint space
    with every joint measured by its speed limit. Only the ratio of two such times is used, so that the effect of the
    coordinate cancels out. The ratio is kept to what is possible: a line never takes longer than its current profile
    slowed to the changed limits, and limits c times as high change a time by the factor
    c^-1/2 (acceleration) or c^-1/3 (jerk) at most. Our own derivation.

    Args:
        trajectory: the motion with the lines.
        spans: when each line begins and ends [s], shape (k, 2).
        limits: limits of the joints that move along the lines.
        acceleration: v sets of factors on the acceleration limits, shape (v, n).
        jerk: factors on the jerk limits, shape (v, n).
    """
    columns = [trajectory.joints.index(joint) for joint in limits.joints]
    slower = np.concatenate(
        [np.ones_like(jerk), power(acceleration, -0.5), cbrt(1.0 / jerk)], axis=1
    )
    least = _shape_times(_paths(trajectory, spans, columns, limits.velocity), limits)
    profile_times = _own_times(trajectory, spans, columns, limits)
    before = least.max(axis=2).min(axis=0)
    # The current profile of the line can always be slowed or sped up by this factor.
    bound = _slowest(profile_times[None], slower)
    factors = np.minimum(_slowest(least, slower) / np.where(before > 0.0, before, np.inf), bound)
    extreme = np.concatenate([slower, np.ones((len(slower), 1))], axis=1)
    return np.clip(factors, extreme.min(axis=1)[:, None], extreme.max(axis=1)[:, None])


def _slowest(times: FloatArray, slower: FloatArray) -> FloatArray:
    """Compute each line's time with its fastest shape under slowed demands, (v, k).

    Args:
        times: time required by each demand with each shape [s], shape (g, k, d).
        slower: factors on the demands, shape (v, d).
    """
    first = times.argmax(axis=2)
    two = np.partition(times, -2, axis=2)[:, :, -2:]
    fastest = np.empty((len(slower), times.shape[1]))
    for row, factor in enumerate(slower):
        changed = np.flatnonzero(factor != 1.0)
        if len(changed) == 1:
            # The largest of the unchanged demands is the maximum or, if that one changes, the second largest.
            others = np.where(first == changed[0], two[:, :, 0], two[:, :, 1])
            slowest = np.maximum(others, times[:, :, changed[0]] * factor[changed[0]])
        else:
            slowest = (times * factor).max(axis=2)
        fastest[row] = slowest.min(axis=0)
    return fastest


def _own_times(
    trajectory: Trajectory, spans: FloatArray, columns: list[int], limits: JointLimits
) -> FloatArray:
    """Compute the relative time demands of a line's current profile, (k, 3 n)."""
    demands = np.empty((len(spans), 3 * len(columns)))
    for k, (start, end) in enumerate(spans):
        low, high = np.searchsorted(trajectory.time, (start - SAME_TIME, end + SAME_TIME))
        inside = slice(int(low), max(int(high), int(low) + 2))
        time, v, a = (
            trajectory.time[inside],
            trajectory.velocity[inside, columns],
            trajectory.acceleration[inside, columns],
        )
        speed, acceleration, jerk = largest_rates(time, v, a)
        demands[k] = np.concatenate(
            [
                speed / limits.velocity,
                np.sqrt(acceleration / limits.acceleration),
                cbrt(jerk / limits.jerk),
            ]
        )
    return demands


def _paths(
    trajectory: Trajectory, spans: FloatArray, columns: list[int], scale: FloatArray
) -> FloatArray:
    """Sample the joints along each path at its nodes [rad], shape (k, `samples`, n)."""
    # Dense at the slow ends of the motion, so that the path is resolved uniformly.
    progress = (1.0 - cos(np.linspace(0.0, np.pi, SENSITIVITY.instants))) / 2.0
    time = spans[:, :1] + progress * (spans[:, 1:] - spans[:, :1])
    q = trajectory.clamped(time.ravel())[0][:, columns].reshape(*time.shape, len(columns))
    step = norm(np.diff(q, axis=1) / scale, axis=2)
    travelled = np.concatenate([np.zeros((len(q), 1)), np.cumsum(step, axis=1)], axis=1)
    nodes = _nodes()
    return np.stack([_read_off(q[k], travelled[k], nodes) for k in range(len(q))])


def _read_off(q: FloatArray, travelled: FloatArray, nodes: FloatArray) -> FloatArray:
    """Interpolate joints at fractions of one path's length, linearly."""
    at = nodes * travelled[-1]
    index = np.clip(np.searchsorted(travelled, at, side="right") - 1, 0, len(travelled) - 2)
    gap = travelled[index + 1] - travelled[index]
    part = np.divide(at - travelled[index], gap, out=np.zeros_like(at), where=gap > 0.0)[:, None]
    joints: FloatArray = (1.0 - part) * q[index] + part * q[index + 1]
    return joints


def _nodes() -> FloatArray:
    """Compute Chebyshev's extrema on [0, 1], which avoid oscillation at the ends."""
    return (1.0 - cos(np.pi * np.arange(SENSITIVITY.samples) / (SENSITIVITY.samples - 1))) / 2.0


def _shape_times(path: FloatArray, limits: JointLimits) -> FloatArray:
    """Compute the times required by each joint's limits, (g, k, 3 n)."""
    k, m, n = path.shape
    flat = np.moveaxis(path, 1, 0).reshape(m, -1)
    rates = [
        np.abs(product(operator, flat)).reshape(len(SHAPES.start), -1, k, n).max(axis=1)
        for operator in _operators()
    ]
    return np.concatenate(
        [
            rates[0] / limits.velocity,
            np.sqrt(rates[1] / limits.acceleration),
            cbrt(rates[2] / limits.jerk),
        ],
        axis=2,
    )


@lru_cache(maxsize=1)
def _operators() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute matrices from path samples to q', q'', q''' in unit time.

    Rows are the instants of the shapes.

    They are in unit time.
    """
    return SHAPES.path_rates(SENSITIVITY.per_phase, _nodes())


LINES = ("approach", "retract")
MOTIONS = ("transfer", "return", *LINES)


@dataclass(frozen=True)
class LimitSensitivity:
    """Effect on the cycle time of one assumed limit, or of several together."""

    joint: str | None
    """Joint, or None for all joints with assumed limits."""
    limit: str
    """`acceleration`, `jerk`, or `acceleration and jerk`."""
    value: float | None
    """The assumed limit at the job's speed [rad/s² or rad/s³]; None for several."""
    lower: float
    """Cycle time with the limit 10 % lower [s]."""
    higher: float
    """Cycle time with the limit 10 % higher [s]."""


@dataclass(frozen=True)
class _Line:
    """An approach, a retract, or a transfer."""

    arm: str
    stage: int
    start: float
    end: float


@dataclass(frozen=True)
class _Chains:
    """Arrays of every arm's work in s stages, hand-overs for the first arm."""

    moved: FloatArray
    """Displacement of every joint in the transfer [rad], shape (s, n)."""
    lines: tuple[_Line, ...]
    """Approaches and retracts."""
    passing: tuple[_Line, ...]
    """Transfers that begin or end in motion."""
    fixed: Mapping[str, FloatArray]
    """Limit-independent time, such as dwells, by arm [s], (s,), -inf without work."""
    returns: BoolArray
    """Mask of returns and of stages without work: all joints arrive together, shape (s,)."""
    recorded: FloatArray
    """Length of the longest transfer [s], shape (s,)."""
    is_handover: BoolArray
    """Mask of the stages that are hand-overs, shape (s,)."""


def sensitivity(schedule: Schedule) -> list[LimitSensitivity]:
    """Compute the effect of assumed limits on the cycle time, largest first.

    All of them together come last. Every joint's acceleration and jerk limit whose source is assumed is taken
    10 % lower and 10 % higher. Postures stay: transfers follow from their displacements in closed form, a stage
    lasts as long as the slower arm (a hand- over as long as the slower transfer and then both arms' lines and
    dwells), lines change by the ratio of two estimates along the same path, dwells do not change. The profile
    of a transfer that begins or ends in motion is slowed to the changed limits. New postures for the other
    limits could only be faster than this, so that `higher` is conservative. Under a tool-speed cap the factor
    by which a transfer was slowed is kept. Transfers with delays or detours count as straight ones of the same
    displacement, with their extra time constant; a note of the plan reports this.

    Args:
        schedule: a planned one; of one without stages, whose stages overlap, since its length is no sum of them then,
            or that does not say its limits, nothing is returned; nor of one with conveyors, as quicker arms would meet
            parts elsewhere.
    """
    limits = schedule.robot.limits.select(schedule.trajectory.joints)
    entries = _entries(limits)
    assumed = [set(limits.assumed("acceleration")), set(limits.assumed("jerk"))]
    parts = stage_parts(schedule)
    moving = any(event.moves for event in schedule.events)
    if not entries or not parts or overlap(schedule.stages) or moving:
        return []
    if not np.isfinite(limits.acceleration).all():
        return []
    # Row 0 is the unchanged plan; then every entry lower and higher.
    acceleration, jerk = np.ones((2, 2 * len(entries) + 1, len(limits.joints)))
    for row, (_, which, limit) in enumerate(entries):
        for step, factor in enumerate((1.0 - SENSITIVITY.share, 1.0 + SENSITIVITY.share), start=1):
            for rate, factors, assumed_columns in zip(
                ("acceleration", "jerk"), (acceleration, jerk), assumed, strict=True
            ):
                if rate in limit:
                    factors[2 * row + step, [k for k in which if k in assumed_columns]] = factor
    chains = _chains(schedule, parts, limits)
    cycle = _cycle_times(schedule, chains, limits, acceleration, jerk)
    # The closed forms give differences from the duration of the schedule.
    cycle += schedule.duration - cycle[0]
    sensitivities = [
        LimitSensitivity(
            joint=joint,
            limit=limit,
            value=None if joint is None else float(getattr(limits, limit)[which[0]]),
            lower=float(cycle[2 * row + 1]),
            higher=float(cycle[2 * row + 2]),
        )
        for row, (joint, which, limit) in enumerate(entries)
    ]
    single = [entry for entry in sensitivities if entry.joint is not None]
    single.sort(key=lambda entry: -round(entry.lower - entry.higher, 12))
    return single + [entry for entry in sensitivities if entry.joint is None]


def _entries(limits: JointLimits) -> list[tuple[str | None, list[int], str]]:
    """List the changed limits by joint: each joint's alone, then all together."""
    assumed = limits.assumed("acceleration")
    jerked = [k for k in limits.assumed("jerk") if np.isfinite(limits.jerk[k])]
    entries: list[tuple[str | None, list[int], str]] = []
    for limit, columns in (("acceleration", assumed), ("jerk", jerked)):
        entries += [(limits.joints[k], [k], limit) for k in columns]
    if assumed:
        entries.append((None, assumed, "acceleration"))
    if jerked:
        entries.append((None, jerked, "jerk"))
    if assumed and jerked:
        entries.append((None, sorted({*assumed, *jerked}), "acceleration and jerk"))
    return entries


def _chains(schedule: Schedule, parts: Sequence[StageParts], limits: JointLimits) -> _Chains:
    """Convert the stages to arrays."""
    starts = np.array([part.stage.start for part in parts])
    arrivals = {name: starts.copy() for name in schedule.robot.arms}
    fixed = {name: np.full(len(parts), -np.inf) for name in schedule.robot.arms}
    lines: list[_Line] = []
    passing: list[_Line] = []
    for k, part in enumerate(parts):
        for name, segments in part.arms.items():
            remaining = segments[-1].end - part.stage.start
            for segment in segments:
                if segment.kind in MOTIONS:
                    remaining -= segment.end - segment.start
                if segment.kind in LINES:
                    lines.append(_Line(name, k, segment.start, segment.end))
                elif segment.kind in MOTIONS:
                    arrivals[name][k] = segment.end
                    if _is_passed(schedule, name, (segment.start, segment.end)):
                        passing.append(_Line(name, k, segment.start, segment.end))
            fixed[name][k] = remaining
    returns = np.array([not part.stage.tasks or not part.arms for part in parts])
    met = np.array([is_handover(part.arms) for part in parts])
    for k, part in enumerate(parts):
        if met[k]:
            arrival = max(arrivals[name][k] for name in part.arms)
            moved = sum(line.end - line.start for line in lines if line.stage == k)
            first, *other_arms = fixed.values()
            first[k] = part.stage.end - arrival - moved
            for other_times in other_arms:
                other_times[k] = 0.0
    # In a return all joints arrive at its end, also the platform alone; elsewhere with the last arm.
    ends = np.array([part.stage.end for part in parts])
    arrived = np.where(returns, ends, np.max(list(arrivals.values()), axis=0))
    displaced = _displacements(schedule, starts, arrivals, arrived, limits.joints)
    # A motion with a given duration takes the same time under any limits.
    displaced[[part.stage.bottleneck == DURATION for part in parts]] = 0.0
    for line in passing:
        joints = schedule.robot.arms[line.arm].joints
        displaced[line.stage, [limits.joints.index(joint) for joint in joints]] = 0.0
    return _Chains(
        moved=displaced,
        lines=tuple(lines),
        passing=tuple(passing),
        fixed=fixed,
        returns=returns,
        recorded=arrived - starts,
        is_handover=met,
    )


def _displacements(
    schedule: Schedule,
    starts: FloatArray,
    arrivals: Mapping[str, FloatArray],
    arrived: FloatArray,
    joints: tuple[str, ...],
) -> FloatArray:
    """Compute the displacement of each joint in each stage's transfer [rad], (s, n)."""
    trajectory = schedule.trajectory
    before = trajectory.clamped(starts)[0]
    moved = np.abs(trajectory.clamped(arrived)[0] - before)
    for name, arm in schedule.robot.arms.items():
        columns = [joints.index(joint) for joint in arm.joints]
        after = trajectory.clamped(arrivals[name])[0]
        moved[:, columns] = np.abs(after - before)[:, columns]
    return moved


def _cycle_times(
    schedule: Schedule,
    chains: _Chains,
    limits: JointLimits,
    acceleration: FloatArray,
    jerk: FloatArray,
) -> FloatArray:
    """Compute the duration for each row of factors [s], (v,)."""
    robot = schedule.robot
    groups = {PLATFORM: [limits.joints.index(joint) for joint in robot.platform]}
    groups |= {
        name: [limits.joints.index(j) for j in arm.joints] for name, arm in robot.arms.items()
    }
    groups = {name: columns for name, columns in groups.items() if columns}
    velocity = limits.velocity * _slowing(schedule, chains, limits)[:, None]
    line_times = {
        name: _line_times(schedule, chains, limits, name, acceleration, jerk) for name in robot.arms
    }
    passing = {
        name: _passing_times(schedule, chains, limits, name, acceleration, jerk)
        for name in robot.arms
    }
    cycle = np.empty(len(acceleration))
    for row, (a, j) in enumerate(zip(acceleration, jerk, strict=True)):
        law = RestToRest(velocity, limits.acceleration * a, limits.jerk * j)
        alone = law.per_joint(chains.moved)
        times = {name: alone[:, columns].max(axis=1) for name, columns in groups.items()}
        times |= {name: np.maximum(times[name], passing[name][row]) for name in passing}
        longest = np.max(list(times.values()), axis=0)
        platform = times.get(PLATFORM, np.zeros_like(longest))
        lengths = stage_length(
            [np.maximum(platform, times[name]) for name in chains.fixed],
            [line_times[name][row] for name in chains.fixed],
            list(chains.fixed.values()),
            chains.is_handover,
        )
        cycle[row] = np.where(chains.returns, longest, lengths).sum()
    return cycle


def _slowing(schedule: Schedule, chains: _Chains, limits: JointLimits) -> FloatArray:
    """Estimate each stage's factors on the speed limits, (s,).

    They are below 1 only under a cap on the tools' speed, and follow from the durations of the transfers.
    """
    low, high = np.zeros(len(chains.moved)), np.ones(len(chains.moved))
    if schedule.robot.tool_speed is None:
        return high

    def times(factor: FloatArray) -> FloatArray:
        law = RestToRest(limits.velocity * factor[:, None], limits.acceleration, limits.jerk)
        return law.duration(chains.moved)

    slowed = chains.recorded > times(high) * (1.0 + SENSITIVITY.slowed)
    for _ in range(SENSITIVITY.speed_bisections):
        middle = (low + high) / 2.0
        enough = times(middle) <= chains.recorded
        low, high = np.where(enough, low, middle), np.where(enough, middle, high)
    return np.where(slowed, high, 1.0)


def _is_passed(schedule: Schedule, arm: str, span: tuple[float, float]) -> bool:
    """Check whether an arm moves at either end of a transfer [s]."""
    velocity = schedule.trajectory.clamped(np.array(span))[1]
    columns = [schedule.trajectory.joints.index(name) for name in schedule.robot.arms[arm].joints]
    return bool(np.abs(velocity[:, columns]).max() > SENSITIVITY.at_rest)


def _passing_times(
    schedule: Schedule,
    chains: _Chains,
    limits: JointLimits,
    arm: str,
    acceleration: FloatArray,
    jerk: FloatArray,
) -> FloatArray:
    """Compute durations of transfers that begin or end in motion [s], (v, s)."""
    times = np.zeros((len(acceleration), len(chains.moved)))
    lines = [line for line in chains.passing if line.arm == arm]
    if not lines:
        return times
    arm_limits = limits.select(schedule.robot.arms[arm].joints)
    columns = [limits.joints.index(joint) for joint in arm_limits.joints]
    spans = np.array([[line.start, line.end] for line in lines])
    demands = _own_times(schedule.trajectory, spans, columns, arm_limits)
    demands /= demands.max(axis=1, keepdims=True)
    a, j = acceleration[:, columns], jerk[:, columns]
    slower = np.concatenate([np.ones_like(j), power(a, -0.5), cbrt(1.0 / j)], axis=1)
    for line, factor in zip(lines, _slowest(demands[None], slower).T, strict=True):
        times[:, line.stage] = factor * (line.end - line.start)
    return times


def _line_times(
    schedule: Schedule,
    chains: _Chains,
    limits: JointLimits,
    arm: str,
    acceleration: FloatArray,
    jerk: FloatArray,
) -> FloatArray:
    """Compute the time of one arm's lines by factors and stage [s], (v, s)."""
    times = np.zeros((len(acceleration), len(chains.moved)))
    lines = [line for line in chains.lines if line.arm == arm]
    arm_limits = limits.select(schedule.robot.arms[arm].joints)
    columns = [limits.joints.index(joint) for joint in arm_limits.joints]
    if not lines or not columns:
        return times
    spans = np.array([[line.start, line.end] for line in lines])
    factors = np.ones((len(acceleration), len(lines)))
    changed = (acceleration[:, columns] != 1.0).any(axis=1) | (jerk[:, columns] != 1.0).any(axis=1)
    factors[changed] = line_factors(
        schedule.trajectory,
        spans,
        arm_limits,
        *(v[np.ix_(changed, columns)] for v in (acceleration, jerk)),
    )
    for column, line in enumerate(lines):
        times[:, line.stage] += factors[:, column] * (line.end - line.start)
    return times
