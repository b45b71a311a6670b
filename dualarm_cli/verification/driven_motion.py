"""A motion as it was driven, compared with its plan: tracking errors, delays, tools at events, clearance.

A joint is late by a delay d and off by the rest: q_driven(t) = q_plan(t - d) + rest(t). Least squares for d would take
a slow rest, such as a swing of the arm, for a delay. So the rest is described by an autoregression, and d is where that
leaves least; steps of generalised least squares then make it exact (Cochrane and Orcutt, 1949). A controller moves
a group of joints: its delay is the median of theirs. Tracking errors are what is left without the delay of the group.
Tools and clearance are judged without the delay that all groups have in common, so that arms that are late by
different times are judged where they really were to each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, distinct
from dualarm_cli.geometry.interpolation import Interpolation, PiecewisePolynomial, interpolated
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.model.job import Job
from dualarm_cli.model.joint_motion import JointMotion, LoggedMotion
from dualarm_cli.model.schedule import Event, Schedule, ScheduleRobot
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.model.verification import COLLISIONS, Check, StageClearance, Verification
from dualarm_cli.records import dataclass
from dualarm_cli.verification.as_done import job_as_done
from dualarm_cli.verification.clearance_checks import check_clearance
from dualarm_cli.verification.criteria import judge, not_checked
from dualarm_cli.verification.tolerances import TOL
from dualarm_cli.verification.tool_model import ToolModel, rotation_angle


@dataclass(frozen=True)
class DrivenSettings:
    """Resolution of the comparison with a driven motion."""

    longest_delay: float = 1.0
    """Longest delay that is looked for, in either direction [s]."""
    delay_step: float = 0.01
    """Step of the grid of delays [s]."""
    grid_samples: int = 2_000
    """Samples of a long log that the grid looks at."""
    nearby: float = 0.05
    """Half-width of the fit's search about the best delay of the grid [s]."""
    fine_step: float = 0.002
    """Step of the fit's first search for a delay [s]."""
    steps: int = 20
    """Maximum number of steps of generalised least squares."""
    enough: float = 1e-7
    """Change of the delay below which generalised least squares has converged [s]."""
    order: int = 8
    """Order of the autoregression: the number of previous samples that predict the next one."""
    most_samples: int = 20_000
    """Samples of a long log that the fit looks at."""
    least_motion: float = 0.02
    """Range of a joint's planned positions below which its delay is not measured [rad or m]."""
    between: tuple[float, ...] = (0.0, 0.25, 0.5, 0.75)
    """Places between two samples where errors are measured, as shares of the step."""
    per_quintic: int = 8
    """Cubics that stand for one quintic piece where the clearance is proven."""
    farthest: float = 10.0
    """Mean speed, as a share of its limit, beyond which clearance is unproven."""
    shortest: float = 1e-7
    """Length of the shortest piece of which the clearance is proven [s]."""


DRIVEN = DrivenSettings()

NOT_LOGGED = "joints that it depends on are not in the file"
"""Why tools or clearance are not checked."""


@dataclass(frozen=True)
class TrackingLimits:
    """Requirements on a driven motion."""

    error: float
    """Largest error of joints that turn, without their delay [rad]."""
    distance: float
    """Largest error of joints that slide, and of tools at events [m]."""
    delay: float
    """Largest delay of joints [s]."""
    clearance: bool = True
    """Flag of a clearance of all bodies that has to be proven."""


@dataclass(frozen=True)
class JointTracking:
    """How one joint followed its plan."""

    joint: str
    """Its name."""
    slides: bool
    """Whether it slides: its errors are lengths."""
    delay: float | None
    """How late it is [s]; None where it moves too little to tell."""
    error: float
    """Largest distance from the plan without the delay of its group [rad or m]."""
    time: float
    """When that is, by the clock of the log [s]."""
    offset: float
    """Mean of the error, with its sign [rad or m]."""
    as_logged: float
    """Largest distance from the plan at the same instant [rad or m]."""


@dataclass(frozen=True)
class EventTracking:
    """Where a tool was at an event."""

    event: Event
    """Of the plan."""
    as_logged: float
    """How far the tool was from its pose at the planned instant [m]."""
    distance: float
    """The same without the common delay [m]."""
    angle: float
    """How far it was turned away then [rad]."""


@dataclass(frozen=True)
class DrivenJudgement:
    """The judgement of a driven motion."""

    verification: Verification
    """Every check, and the least clearance of every stage as driven."""
    delay: float
    """The delay that all groups have in common [s]."""
    joints: tuple[JointTracking, ...]
    """In the order of the file."""
    events: tuple[EventTracking, ...]
    """In the order of the plan."""


def judge_driven(
    schedule: Schedule,
    job: Job,
    logged: LoggedMotion,
    kind: Interpolation,
    allowed: TrackingLimits,
    *,
    as_planned: bool = False,
) -> DrivenJudgement:
    """Returns the judgement of what was driven.

    Args:
        schedule: the plan, with finite numbers and rising times.
        job: cell and tasks of the plan.
        logged: what was driven.
        kind: how the robot moved between the samples.
        allowed: what it may be off, and whether clearance is proven.
        as_planned: whether joints that were not logged count as driven as planned; otherwise tools and clearance that
            depend on them are not checked, and the motion fails.

    Raises:
        ValueError: the interpolation needs derivatives that were not logged.
    """
    schedule = replace(schedule, robot=ScheduleRobot.of_job(job))
    motion = interpolated(kind, logged.time, logged.position, logged.velocity, logged.acceleration)
    plan = schedule.trajectory.select(logged.joints)
    groups = _groups(schedule.robot, logged.joints)
    delays = _delays(plan, motion)
    late = {group: _median([delays[k] for k in columns]) for group, columns in groups.items()}
    joints = _joints(plan, motion, groups, late, delays, schedule.robot.sliding)
    common = _common([delay for delay in late.values() if delay is not None])
    driven = _driven(schedule, logged.joints, motion, common)
    missing = [joint for joint in schedule.trajectory.joints if joint not in logged.joints]
    unknown = [] if as_planned else missing
    events = _events(schedule, driven, common, unknown)
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
        found = not_checked(COLLISIONS, why)
    elif (share := _share_of_speed(driven, schedule)) > DRIVEN.farthest:
        why = f"cannot be proven: on average a joint moves at {share:.3g} times its speed limit"
        found = judge(COLLISIONS, np.nan, TOL.clearance_slack, why)
    else:
        moved = replace(schedule, motion=JointMotion.of(driven))
        found, stages = check_clearance(moved, job_as_done(schedule, job))
    if stages:
        # The required clearance is there for errors such as these: what it leaves is shown, a contact fails.
        worst = min(stages, key=lambda s: s.clearance - min(s.required, 0.0))
        into = min(worst.required, 0.0) - worst.clearance
        found = judge(COLLISIONS, max(into, 0.0), TOL.clearance_slack, found.detail)
    return DrivenJudgement(Verification((*checks, found), stages), common, joints, events)


def _groups(robot: ScheduleRobot, joints: Sequence[str]) -> dict[str, list[int]]:
    """Returns the columns of joints that one controller moves, by the group's name."""
    named = {name: arm.joints for name, arm in robot.arms.items()} | {"platform": robot.platform}
    found = {
        group: [k for k, joint in enumerate(joints) if joint in own] for group, own in named.items()
    }
    return {group: columns for group, columns in found.items() if columns}


def _delays(plan: Trajectory, motion: PiecewisePolynomial) -> list[float | None]:
    """Returns by how much each joint is late [s]; None of one that moves too little.

    Args:
        plan: of the joints that were logged.
        motion: how they were driven.
    """
    count = int(np.clip(len(motion.time), 4 * DRIVEN.order, DRIVEN.most_samples))
    times = np.linspace(motion.time[0], motion.time[-1], count)
    driven = motion.derivatives(times)[:, 0]
    some = distinct(np.linspace(0, count - 1, DRIVEN.grid_samples).astype(int))
    steps = round(DRIVEN.longest_delay / DRIVEN.delay_step)
    grid = np.arange(-steps, steps + 1) * DRIVEN.delay_step
    rests = np.array([np.var(driven[some] - plan.at(times[some] - d)[0], axis=0) for d in grid])
    moves = np.ptp(plan.at(times)[0], axis=0) >= DRIVEN.least_motion
    best = grid[np.argmin(rests, axis=0)]
    return [
        _fitted(plan.select([joint]), times, driven[:, k], float(best[k])) if moves[k] else None
        for k, joint in enumerate(plan.joints)
    ]


def _fitted(plan: Trajectory, times: FloatArray, driven: FloatArray, first: float) -> float:
    """Returns the delay of one joint [s].

    Args:
        plan: of the joint.
        times: instants at equal distances, shape (m,).
        driven: positions then, shape (m,).
        first: a delay nearby.
    """
    from scipy.optimize import minimize_scalar

    if np.abs(_rest(plan, times, driven, first)).max() < TOL.same_joints:
        return first
    nearby = first + np.arange(-DRIVEN.nearby, DRIVEN.nearby + DRIVEN.fine_step, DRIVEN.fine_step)
    least = [_untold(plan, times, driven, d) for d in nearby]
    middle = float(nearby[int(np.argmin(least))])
    near = (middle - DRIVEN.fine_step, middle + DRIVEN.fine_step)
    best = minimize_scalar(lambda d: _untold(plan, times, driven, d), bounds=near)
    found = delay = float(best.x)
    for _ in range(DRIVEN.steps):
        rest = _rest(plan, times, driven, delay)
        if np.abs(rest).max() < TOL.same_joints:
            break
        weights, windows = _autoregression(rest)
        velocity = plan.at(times - delay)[1][:, 0]
        slope = velocity - velocity.mean()
        slope = slope[DRIVEN.order :] - product(_windows(slope), weights)
        # What is late by d is off by -d v.
        change = -float(product(slope, rest[DRIVEN.order :] - product(windows, weights))) / float(
            product(slope, slope)
        )
        delay += change
        if abs(delay - found) > DRIVEN.fine_step:
            return found
        if abs(change) < DRIVEN.enough:
            break
    return delay


def _rest(plan: Trajectory, times: FloatArray, driven: FloatArray, delay: float) -> FloatArray:
    """Returns by what a joint is off besides a delay, about its mean, shape (m,)."""
    error = driven - plan.at(times - delay)[0][:, 0]
    return np.asarray(error - error.mean())


def _untold(plan: Trajectory, times: FloatArray, driven: FloatArray, delay: float) -> float:
    """Returns the sum of squares that an autoregression leaves of the rest."""
    rest = _rest(plan, times, driven, delay)
    weights, windows = _autoregression(rest)
    left = rest[DRIVEN.order :] - product(windows, weights)
    return float(product(left, left))


def _autoregression(rest: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Fit an autoregression to the residual of a joint.

    The result is the weights (`order`,) and the previous values that they apply to, shape (m - `order`, `order`).
    """
    windows = _windows(rest)
    gram = product(windows.T, windows)
    weights = np.asarray(
        np.linalg.lstsq(gram, product(windows.T, rest[DRIVEN.order :]), rcond=1e-10)[0], float
    )
    return weights, windows


def _windows(values: FloatArray) -> FloatArray:
    return np.lib.stride_tricks.sliding_window_view(values[:-1], DRIVEN.order)


def _median(delays: Sequence[float | None]) -> float | None:
    known = [delay for delay in delays if delay is not None]
    return float(np.median(known)) if known else None


def _common(delays: Sequence[float]) -> float:
    """Returns the delay nearest to none that all groups have; none where some are early and others late."""
    if not delays or min(delays) <= 0.0 <= max(delays):
        return 0.0
    return min(delays, key=abs)


def _joints(
    plan: Trajectory,
    motion: PiecewisePolynomial,
    groups: dict[str, list[int]],
    late: dict[str, float | None],
    delays: Sequence[float | None],
    sliding: frozenset[str],
) -> tuple[JointTracking, ...]:
    """Returns how each joint followed its plan, at the samples and between them."""
    inner = motion.time[:-1, None] + np.diff(motion.time)[:, None] * np.array(DRIVEN.between)
    times = np.append(inner.ravel(), motion.time[-1])
    driven = motion.derivatives(times)[:, 0]
    as_logged = np.abs(driven - plan.at(times)[0]).max(axis=0)
    found: dict[int, JointTracking] = {}
    for group, columns in groups.items():
        names = [plan.joints[k] for k in columns]
        error = driven[:, columns] - plan.select(names).at(times - (late[group] or 0.0))[0]
        for n, k in enumerate(columns):
            worst = int(np.argmax(np.abs(error[:, n])))
            found[k] = JointTracking(
                names[n],
                names[n] in sliding,
                delays[k],
                float(abs(error[worst, n])),
                float(times[worst]),
                float(error[:, n].mean()),
                float(as_logged[k]),
            )
    return tuple(found[k] for k in sorted(found))


def _driven(
    schedule: Schedule, joints: Sequence[str], motion: PiecewisePolynomial, delay: float
) -> Trajectory:
    """Returns the driven motion of all joints on the clock of the plan, as cubics between knots.

    Before the first sample and after the last one joints stand. A quintic is taken apart into cubics with its
    positions and velocities.

    Args:
        schedule: the plan, for joints that were not logged.
        joints: that were.
        motion: of them, by the clock of the log.
        delay: by which that is late [s].
    """
    plan, duration = schedule.trajectory, schedule.duration
    pieces = DRIVEN.per_quintic if motion.coefficients.shape[1] > 4 else 1
    inner = motion.time[:-1, None] + np.diff(motion.time)[:, None] * (np.arange(pieces) / pieces)
    logged = np.append(inner.ravel(), motion.time[-1]) - delay
    edges = np.union1d(np.union1d(logged, plan.time), [0.0, duration])
    edges = edges[(edges >= 0.0) & (edges <= duration)]
    edges = edges[np.append(np.diff(edges) > DRIVEN.shortest, True)]
    middle, length = 0.5 * (edges[:-1] + edges[1:]), np.diff(edges)[:, None]
    q, v, _ = (row.copy() for row in plan.at(edges))
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
    # Hermite's cubic: velocities may jump where pieces meet, so that each has knots of its own.
    chord = np.diff(q, axis=0) / length
    at_begin = (6.0 * chord - 4.0 * begin - 2.0 * end) / length
    at_end = (2.0 * begin + 4.0 * end - 6.0 * chord) / length
    time = np.column_stack([edges[:-1], edges[1:]]).ravel()
    pairs = ((q[:-1], q[1:]), (begin, end), (at_begin, at_end))
    rates = [np.stack(pair, axis=1).reshape(-1, q.shape[1]) for pair in pairs]
    return Trajectory(plan.joints, time, *rates)


def _events(
    schedule: Schedule, driven: Trajectory, delay: float, unknown: Sequence[str]
) -> tuple[EventTracking, ...]:
    """Locate tools at events of arms whose joints are all known."""
    model = ToolModel(schedule)
    known = [arm for arm in schedule.robot.arms if not set(unknown).intersection(model.joints(arm))]
    found = []
    for event in schedule.events:
        if event.arm not in known:
            continue
        late, at = (
            model.pose(event.arm, driven.at(np.array([event.time - shift]))[0][0])
            for shift in (delay, 0.0)
        )
        found.append(
            EventTracking(
                event,
                float(norm(late.translation - event.pose.translation)),
                float(norm(at.translation - event.pose.translation)),
                float(rotation_angle(product(event.pose.rotation.T, at.rotation))),
            )
        )
    return tuple(found)


def _check_joints(missing: Sequence[str], as_planned: bool) -> Check:
    if not missing:
        return judge("joints", 0.0, 0.0, "every joint of the robot")
    names = f"not in the file: {', '.join(missing)}"
    if as_planned:
        return not_checked("joints", f"{names}; taken as driven as planned")
    advice = "--unlogged-as-planned takes them as driven as planned"
    return judge("joints", float(len(missing)), 0.0, f"{names}; {advice}")


def _check_span(schedule: Schedule, logged: LoggedMotion) -> Check:
    """Check that the log spans the plan to two steps."""
    begin, end = float(logged.time[0]), float(logged.time[-1])
    missing = max(begin, schedule.duration - end, 0.0)
    where = f"{begin:.3f} to {end:.3f} s of {schedule.duration:.3f} s"
    step = 2.0 * float(np.diff(logged.time).max())
    slack = min(step, TOL.driven_span * schedule.duration)
    return judge("time_span", missing, slack, where)


def _check_tracking(joints: Sequence[JointTracking], allowed: TrackingLimits) -> list[Check]:
    """Checks delays and tracking errors, each at its worst joint; all that are too large are named."""
    timed = [(joint.joint, joint.delay) for joint in joints if joint.delay is not None]
    if not timed:
        checks = [not_checked("delay")]
    else:
        late = [f"{name} {d * 1e3:.1f} ms" for name, d in timed if abs(d) > allowed.delay]
        where = ", ".join(late) or "every joint"
        worst = max(abs(delay) for _, delay in timed)
        checks = [judge("delay", worst, allowed.delay, where)]
    for slides, limit, name in (
        (False, allowed.error, "tracking_error"),
        (True, allowed.distance, "tracking_distance"),
    ):
        own = [joint for joint in joints if joint.slides is slides]
        if own:
            scale, shown = (1e3, "mm") if slides else (180.0 / np.pi, "deg")
            off = [f"{j.joint} {j.error * scale:.3g} {shown}" for j in own if j.error > limit]
            where = ", ".join(off) or "every joint"
            checks.append(judge(name, max(joint.error for joint in own), limit, where))
    return checks


def _check_limits(
    schedule: Schedule, motion: PiecewisePolynomial, joints: Sequence[str], allowed: TrackingLimits
) -> list[Check]:
    """Checks positions, velocities and accelerations of the interpolated motion."""
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
        share = np.where(np.isfinite(limit), peak / limit, 0.0)
        k = int(np.argmax(share))
        most = 1.0 + TOL.driven_rate_slack
        where = f"{joints[k]}, limit {limit[k]:g}"
        checks.append(judge(name, float(share[k]), most, where))
    return checks


def _share_of_speed(driven: Trajectory, schedule: Schedule) -> float:
    """Return the largest mean speed of a joint, as a share of its limit."""
    time = np.union1d(driven.time, 0.5 * (driven.time[1:] + driven.time[:-1]))
    ways = np.abs(np.diff(driven.at(time)[0], axis=0)).sum(axis=0)
    limits = schedule.robot.limits.select(driven.joints).velocity
    return float((ways / (limits * (time[-1] - time[0]))).max())


def _check_events(
    events: Sequence[EventTracking], allowed: TrackingLimits, unknown: Sequence[str]
) -> Check:
    if not events:
        return not_checked("tool_at_events", NOT_LOGGED if unknown else "")
    worst = max(events, key=lambda one: one.distance)
    event = worst.event
    where = f"{event.task} ({event.action}) of the {event.arm} arm at {event.time:.3f} s"
    if unknown:
        where += f"; only of the {' and '.join(sorted({e.event.arm for e in events}))} arm"
    return judge("tool_at_events", worst.distance, allowed.distance, where)
