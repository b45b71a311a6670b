"""Comparison of a recorded motion with its plan: tracking errors, delays, tools, clearance.

A joint has a delay d and a residual: q_recorded(t) = q_plan(t - d) + residual(t). Least squares for d would take a slow
residual, such as an oscillation of the arm, for a delay. So the residual is modelled by an autoregression, and d
minimises the squares that it leaves; steps of generalised least squares then make it exact (Cochrane and Orcutt, 1949).
A controller moves a group of joints: its delay is the median of theirs. Tracking errors are measured without the delay
of the group. Tools and clearance are judged without the delay that all groups have in common, so that the relative
delay of the arms counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, distinct
from dualarm_cli.geometry.interpolation import Interpolation, PiecewisePolynomial, interpolated
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.model.job import Job
from dualarm_cli.model.motion.joint_motion import JointMotion, LoggedMotion
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.schedule import Event, Schedule, ScheduleRobot
from dualarm_cli.model.verification import COLLISIONS, Check, StageClearance, Verification
from dualarm_cli.records import dataclass
from dualarm_cli.verification.as_done import job_as_done
from dualarm_cli.verification.clearance_checks import check_clearance
from dualarm_cli.verification.measuring.criteria import judge, not_checked
from dualarm_cli.verification.measuring.tolerances import TOL
from dualarm_cli.verification.measuring.tool_model import ToolModel, rotation_angle


@dataclass(frozen=True)
class ComparisonSettings:
    """Resolution of the comparison with a recorded motion."""

    max_delay: float = 1.0
    """Longest delay in either direction [s]."""
    delay_step: float = 0.01
    """Step of the grid of delays [s]."""
    grid_samples: int = 2_000
    """Maximum number of samples on the grid of delays."""
    fit_half_width: float = 0.05
    """Half-width of the fit's search about the best delay of the grid [s]."""
    fine_step: float = 0.002
    """Step of the fit's first search for a delay [s]."""
    max_steps: int = 20
    """Maximum number of steps of generalised least squares."""
    convergence: float = 1e-7
    """Change of the delay below which generalised least squares has converged [s]."""
    order: int = 8
    """Order of the autoregression, in samples."""
    max_samples: int = 20_000
    """Maximum number of samples in the fit."""
    min_motion: float = 0.02
    """Range of a joint's planned positions below which its delay is not measured [rad or m]."""
    error_fractions: tuple[float, ...] = (0.0, 0.25, 0.5, 0.75)
    """Fractions of a step at which errors are measured."""
    cubics_per_quintic: int = 8
    """Number of cubics that replace a quintic piece in the proof of clearance."""
    max_mean_speed: float = 10.0
    """Mean speed beyond which clearance is unproven, as a fraction of the limit."""
    min_piece: float = 1e-7
    """Minimum length of a piece in the proof of clearance [s]."""


TRACK = ComparisonSettings()

NOT_LOGGED = "joints that it depends on are not in the file"
"""Reason of checks that need joints which were not logged."""


@dataclass(frozen=True)
class TrackingLimits:
    """Requirements on a recorded motion."""

    error: float
    """Largest error of revolute joints without their delay [rad]."""
    distance: float
    """Largest error of sliding joints, and of tools at events [m]."""
    delay: float
    """Largest delay of joints [s]."""
    clearance: bool = True
    """Flag that clearance has to be proven."""


@dataclass(frozen=True)
class JointTracking:
    """Tracking of one joint."""

    joint: str
    """Name of the joint."""
    slides: bool
    """Flag of a sliding joint, whose errors are lengths."""
    delay: float | None
    """Delay behind the plan [s], or None if the joint moves too little."""
    error: float
    """Largest distance from the plan without the delay of its group [rad or m]."""
    time: float
    """Time of the largest error, by the clock of the log [s]."""
    offset: float
    """Mean of the error, with its sign [rad or m]."""
    as_logged: float
    """Largest distance from the plan at the same instant [rad or m]."""


@dataclass(frozen=True)
class EventTracking:
    """Tracking of a tool at an event."""

    event: Event
    """Event of the plan."""
    as_logged: float
    """Distance of the tool from its pose at the planned instant [m]."""
    distance: float
    """Distance of the tool from its pose without the common delay [m]."""
    angle: float
    """Angle of the tool from its pose without the common delay [rad]."""


@dataclass(frozen=True)
class RecordedJudgement:
    """Verification of a recorded motion."""

    verification: Verification
    """Checks, and the least clearance of every recorded stage."""
    delay: float
    """Delay common to all groups [s]."""
    joints: tuple[JointTracking, ...]
    """Tracking of joints, in the order of the log."""
    events: tuple[EventTracking, ...]
    """Tracking of tools at events, in the order of the plan."""


def judge_recorded(
    schedule: Schedule,
    job: Job,
    logged: LoggedMotion,
    kind: Interpolation,
    allowed: TrackingLimits,
    *,
    as_planned: bool = False,
) -> RecordedJudgement:
    """Verify a recorded motion against its plan.

    Args:
        schedule: the plan, with finite numbers and rising times.
        job: cell and tasks of the plan.
        logged: the recorded motion.
        kind: interpolation between the samples.
        allowed: largest errors, and whether clearance is proven.
        as_planned: whether joints missing from the log count as following the plan; otherwise tools and clearance that
            depend on them are not checked, and the motion fails.

    Raises:
        ValueError: the interpolation needs derivatives that were not logged.
    """
    schedule = replace(schedule, robot=ScheduleRobot.of_job(job))
    motion = interpolated(kind, logged.time, logged.position, logged.velocity, logged.acceleration)
    plan = schedule.trajectory.select(logged.joints)
    groups = _groups(schedule.robot, logged.joints)
    delays = _estimate_delays(plan, motion)
    group_delays = {g: _median([delays[k] for k in columns]) for g, columns in groups.items()}
    joints = _track_joints(plan, motion, groups, group_delays, delays, schedule.robot.sliding)
    common = _common_delay([delay for delay in group_delays.values() if delay is not None])
    actual = _recorded_trajectory(schedule, logged.joints, motion, common)
    missing = [joint for joint in schedule.trajectory.joints if joint not in logged.joints]
    unknown = [] if as_planned else missing
    events = _track_events(schedule, actual, common, unknown)
    checks = [
        _check_joints(missing, as_planned),
        _check_span(schedule, logged),
        *_check_tracking(joints, allowed),
        *_check_limits(schedule, motion, logged.joints, allowed),
        _check_events(events, allowed, unknown),
    ]
    stages: tuple[StageClearance, ...] = ()
    if unknown or not allowed.clearance:
        why = NOT_LOGGED if unknown else "not requested; leave out --no-clearance"
        collisions = not_checked(COLLISIONS, why)
    elif (speed_fraction := _mean_speed_fraction(actual, schedule)) > TRACK.max_mean_speed:
        why = f"cannot be proven: on average a joint moves at {speed_fraction:.3g} times its speed limit"
        collisions = judge(COLLISIONS, np.nan, TOL.clearance_slack, why)
    else:
        moved = replace(schedule, motion=JointMotion.of(actual))
        collisions, stages = check_clearance(moved, job_as_done(schedule, job))
    if stages:
        # Required clearance is an allowance for such errors: what remains is shown, and only contact fails.
        worst = min(stages, key=lambda s: s.clearance - min(s.required, 0.0))
        depth = max(min(worst.required, 0.0) - worst.clearance, 0.0)
        collisions = judge(COLLISIONS, depth, TOL.clearance_slack, collisions.detail)
    return RecordedJudgement(Verification((*checks, collisions), stages), common, joints, events)


def _groups(robot: ScheduleRobot, joints: Sequence[str]) -> dict[str, list[int]]:
    """Group the columns of joints by the controller that moves them."""
    named = {name: arm.joints for name, arm in robot.arms.items()} | {"platform": robot.platform}
    columns_of_group = {
        group: [k for k, joint in enumerate(joints) if joint in members]
        for group, members in named.items()
    }
    return {group: columns for group, columns in columns_of_group.items() if columns}


def _estimate_delays(plan: Trajectory, motion: PiecewisePolynomial) -> list[float | None]:
    """Estimate the delay of each joint [s], or None if it moves too little.

    Args:
        plan: planned motion of the logged joints.
        motion: their recorded motion.
    """
    count = int(np.clip(len(motion.time), 4 * TRACK.order, TRACK.max_samples))
    times = np.linspace(motion.time[0], motion.time[-1], count)
    actual = motion.derivatives(times)[:, 0]
    part = distinct(np.linspace(0, count - 1, TRACK.grid_samples).astype(int))
    steps = round(TRACK.max_delay / TRACK.delay_step)
    grid = np.arange(-steps, steps + 1) * TRACK.delay_step
    off = (actual[part] - plan.clamped(times[part] - d)[0] for d in grid)
    spread = np.array([np.var(errors, axis=0) for errors in off])
    moves = np.ptp(plan.clamped(times)[0], axis=0) >= TRACK.min_motion
    best = grid[np.argmin(spread, axis=0)]
    return [
        _fit_delay(plan.select([joint]), times, actual[:, k], float(best[k])) if moves[k] else None
        for k, joint in enumerate(plan.joints)
    ]


def _fit_delay(plan: Trajectory, times: FloatArray, actual: FloatArray, first: float) -> float:
    """Estimate the delay of one joint [s].

    Args:
        plan: planned motion of the joint.
        times: instants at equal distances [s], shape (m,).
        actual: recorded positions, shape (m,).
        first: initial guess of the delay [s].
    """
    from scipy.optimize import minimize_scalar

    if np.abs(_residual(plan, times, actual, first)).max() < TOL.same_joints:
        return first
    half, step = TRACK.fit_half_width, TRACK.fine_step
    grid = first + np.arange(-half, half + step, step)
    squares = [_unexplained(plan, times, actual, d) for d in grid]
    middle = float(grid[int(np.argmin(squares))])
    bounds = (middle - TRACK.fine_step, middle + TRACK.fine_step)
    best = minimize_scalar(lambda d: _unexplained(plan, times, actual, d), bounds=bounds)
    initial = delay = float(best.x)
    for _ in range(TRACK.max_steps):
        residual = _residual(plan, times, actual, delay)
        if np.abs(residual).max() < TOL.same_joints:
            break
        weights, windows = _autoregression(residual)
        velocity = plan.clamped(times - delay)[1][:, 0]
        slope = velocity - velocity.mean()
        slope = slope[TRACK.order :] - product(_windows(slope), weights)
        # A delay d is an error of -d v.
        innovations = residual[TRACK.order :] - product(windows, weights)
        change = -float(product(slope, innovations)) / float(product(slope, slope))
        delay += change
        if abs(delay - initial) > TRACK.fine_step:
            return initial
        if abs(change) < TRACK.convergence:
            break
    return delay


def _residual(plan: Trajectory, times: FloatArray, actual: FloatArray, delay: float) -> FloatArray:
    """Compute the residual of a joint without a delay and its mean, shape (m,)."""
    error = actual - plan.clamped(times - delay)[0][:, 0]
    return np.asarray(error - error.mean())


def _unexplained(plan: Trajectory, times: FloatArray, actual: FloatArray, delay: float) -> float:
    """Compute the squared residual that an autoregression leaves."""
    residual = _residual(plan, times, actual, delay)
    weights, windows = _autoregression(residual)
    innovations = residual[TRACK.order :] - product(windows, weights)
    return float(product(innovations, innovations))


def _autoregression(residual: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Fit an autoregression to the residual of a joint.

    The result is the weights (`order`,) and the previous values that they apply to, shape (m - `order`, `order`).
    """
    windows = _windows(residual)
    gram = product(windows.T, windows)
    weights = np.asarray(
        np.linalg.lstsq(gram, product(windows.T, residual[TRACK.order :]), rcond=1e-10)[0], float
    )
    return weights, windows


def _windows(values: FloatArray) -> FloatArray:
    return np.lib.stride_tricks.sliding_window_view(values[:-1], TRACK.order)


def _median(delays: Sequence[float | None]) -> float | None:
    measured = [delay for delay in delays if delay is not None]
    return float(np.median(measured)) if measured else None


def _common_delay(delays: Sequence[float]) -> float:
    """Return the common part of the groups' delays [s], 0 if their signs differ."""
    if not delays or min(delays) <= 0.0 <= max(delays):
        return 0.0
    return min(delays, key=abs)


def _track_joints(
    plan: Trajectory,
    motion: PiecewisePolynomial,
    groups: dict[str, list[int]],
    late: dict[str, float | None],
    delays: Sequence[float | None],
    sliding: frozenset[str],
) -> tuple[JointTracking, ...]:
    """Measure the tracking of each joint, at the samples and between them."""
    fractions = np.array(TRACK.error_fractions)
    inner = motion.time[:-1, None] + np.diff(motion.time)[:, None] * fractions
    times = np.append(inner.ravel(), motion.time[-1])
    actual = motion.derivatives(times)[:, 0]
    as_logged = np.abs(actual - plan.clamped(times)[0]).max(axis=0)
    tracking: dict[int, JointTracking] = {}
    for group, columns in groups.items():
        names = [plan.joints[k] for k in columns]
        error = actual[:, columns] - plan.select(names).clamped(times - (late[group] or 0.0))[0]
        for n, k in enumerate(columns):
            worst = int(np.argmax(np.abs(error[:, n])))
            tracking[k] = JointTracking(
                names[n],
                names[n] in sliding,
                delays[k],
                float(abs(error[worst, n])),
                float(times[worst]),
                float(error[:, n].mean()),
                float(as_logged[k]),
            )
    return tuple(tracking[k] for k in sorted(tracking))


def _recorded_trajectory(
    schedule: Schedule, joints: Sequence[str], motion: PiecewisePolynomial, delay: float
) -> Trajectory:
    """Convert the recorded motion to cubics between knots, by the clock of the plan.

    Joints stand before the first sample and after the last one. A quintic is split into cubics with its positions and
    velocities.

    Args:
        schedule: the plan, for joints that were not logged.
        joints: names of the logged joints.
        motion: recorded motion of these joints, by the clock of the log.
        delay: delay of the log [s].
    """
    plan, duration = schedule.trajectory, schedule.duration
    pieces = TRACK.cubics_per_quintic if motion.coefficients.shape[1] > 4 else 1
    inner = motion.time[:-1, None] + np.diff(motion.time)[:, None] * (np.arange(pieces) / pieces)
    logged = np.append(inner.ravel(), motion.time[-1]) - delay
    edges = np.union1d(np.union1d(logged, plan.time), [0.0, duration])
    edges = edges[(edges >= 0.0) & (edges <= duration)]
    edges = edges[np.append(np.diff(edges) > TRACK.min_piece, True)]
    middle, length = 0.5 * (edges[:-1] + edges[1:]), np.diff(edges)[:, None]
    q, v, _ = (row.copy() for row in plan.clamped(edges))
    begin, end = (row.copy() for row in (v[:-1], v[1:]))
    columns = [plan.joints.index(joint) for joint in joints]
    rows = motion.derivatives(edges + delay)
    q[:, columns] = rows[:, 0]
    if motion.coefficients.shape[1] == 2:
        begin[:, columns] = end[:, columns] = np.diff(rows[:, 0], axis=0) / length
    else:
        moves = (middle + delay > motion.time[0]) & (middle + delay < motion.time[-1])
        begin[:, columns] = rows[:-1, 1] * moves[:, None]
        end[:, columns] = rows[1:, 1] * moves[:, None]
    # Hermite's cubic: each piece has its own two knots, because velocities may jump where pieces meet.
    chord = np.diff(q, axis=0) / length
    at_begin = (6.0 * chord - 4.0 * begin - 2.0 * end) / length
    at_end = (2.0 * begin + 4.0 * end - 6.0 * chord) / length
    time = np.column_stack([edges[:-1], edges[1:]]).ravel()
    pairs = ((q[:-1], q[1:]), (begin, end), (at_begin, at_end))
    rates = [np.stack(pair, axis=1).reshape(-1, q.shape[1]) for pair in pairs]
    return Trajectory(plan.joints, time, *rates)


def _track_events(
    schedule: Schedule, actual: Trajectory, delay: float, unknown: Sequence[str]
) -> tuple[EventTracking, ...]:
    """Measure tools at events of arms whose joints are all known."""
    model = ToolModel(schedule)
    known_arms = [
        arm for arm in schedule.robot.arms if not set(unknown).intersection(model.joints(arm))
    ]
    tracking = []
    for event in schedule.events:
        if event.arm not in known_arms:
            continue
        without_delay, as_logged = (
            model.pose(event.arm, actual.clamped(np.array([event.time - shift]))[0][0])
            for shift in (delay, 0.0)
        )
        tracking.append(
            EventTracking(
                event,
                float(norm(without_delay.translation - event.pose.translation)),
                float(norm(as_logged.translation - event.pose.translation)),
                float(rotation_angle(product(event.pose.rotation.T, as_logged.rotation))),
            )
        )
    return tuple(tracking)


def _check_joints(missing: Sequence[str], as_planned: bool) -> Check:
    if not missing:
        return judge("joints", 0.0, 0.0, "every joint of the robot")
    names = f"not in the file: {', '.join(missing)}"
    if as_planned:
        return not_checked("joints", f"{names}; assumed to follow the plan")
    advice = "--unlogged-as-planned assumes that they follow the plan"
    return judge("joints", float(len(missing)), 0.0, f"{names}; {advice}")


def _check_span(schedule: Schedule, logged: LoggedMotion) -> Check:
    """Check that the log spans the plan to two steps."""
    begin, end = float(logged.time[0]), float(logged.time[-1])
    missing = max(begin, schedule.duration - end, 0.0)
    where = f"{begin:.3f} to {end:.3f} s of {schedule.duration:.3f} s"
    step = 2.0 * float(np.diff(logged.time).max())
    slack = min(step, TOL.recorded_span * schedule.duration)
    return judge("time_span", missing, slack, where)


def _check_tracking(joints: Sequence[JointTracking], allowed: TrackingLimits) -> list[Check]:
    """Check delays and tracking errors of the worst joint, and name all excessive ones."""
    timed = [(joint.joint, joint.delay) for joint in joints if joint.delay is not None]
    if not timed:
        checks = [not_checked("delay")]
    else:
        excessive = [f"{name} {d * 1e3:.1f} ms" for name, d in timed if abs(d) > allowed.delay]
        where = ", ".join(excessive) or "every joint"
        worst = max(abs(delay) for _, delay in timed)
        checks = [judge("delay", worst, allowed.delay, where)]
    for slides, limit, name in (
        (False, allowed.error, "tracking_error"),
        (True, allowed.distance, "tracking_distance"),
    ):
        selected = [joint for joint in joints if joint.slides is slides]
        if selected:
            scale, unit = (1e3, "mm") if slides else (180.0 / np.pi, "deg")
            excessive = [
                f"{j.joint} {j.error * scale:.3g} {unit}" for j in selected if j.error > limit
            ]
            where = ", ".join(excessive) or "every joint"
            checks.append(judge(name, max(joint.error for joint in selected), limit, where))
    return checks


def _check_limits(
    schedule: Schedule, motion: PiecewisePolynomial, joints: Sequence[str], allowed: TrackingLimits
) -> list[Check]:
    """Check positions, velocities and accelerations of the interpolated motion."""
    limits, sliding = schedule.robot.limits.select(joints), schedule.robot.sliding
    low, high = motion.extrema()
    beyond = np.maximum(np.maximum(limits.lower - low, high - limits.upper), 0.0)
    slack = np.array([allowed.distance if j in sliding else allowed.error for j in joints])
    k = int(np.argmax(beyond - slack))
    slides = joints[k] in sliding
    checks = [judge("position", float(beyond[k]), float(slack[k]), joints[k], slides=slides)]
    for order, name in enumerate(("velocity", "acceleration"), start=1):
        peak, limit = motion.peak(order), (limits.velocity, limits.acceleration)[order - 1]
        if peak is None:
            checks.append(not_checked(name, f"linear interpolation has no {name}"))
            continue
        fraction = np.where(np.isfinite(limit), peak / limit, 0.0)
        k = int(np.argmax(fraction))
        allowed_fraction = 1.0 + TOL.recorded_rate_slack
        where = f"{joints[k]}, limit {limit[k]:g}"
        checks.append(judge(name, float(fraction[k]), allowed_fraction, where))
    return checks


def _mean_speed_fraction(actual: Trajectory, schedule: Schedule) -> float:
    """Compute the largest mean joint speed, as a fraction of its limit."""
    time = np.union1d(actual.time, 0.5 * (actual.time[1:] + actual.time[:-1]))
    travel = np.abs(np.diff(actual.clamped(time)[0], axis=0)).sum(axis=0)
    limits = schedule.robot.limits.select(actual.joints).velocity
    return float((travel / (limits * (time[-1] - time[0]))).max())


def _check_events(
    events: Sequence[EventTracking], allowed: TrackingLimits, unknown: Sequence[str]
) -> Check:
    if not events:
        return not_checked("tool_at_events", NOT_LOGGED if unknown else "")
    worst = max(events, key=lambda tracking: tracking.distance)
    event = worst.event
    where = f"{event.task} ({event.action}) of the {event.arm} arm at {event.time:.3f} s"
    if unknown:
        where += f"; only of the {' and '.join(sorted({e.event.arm for e in events}))} arm"
    return judge("tool_at_events", worst.distance, allowed.distance, where)
