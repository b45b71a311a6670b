"""Checks of care: rates, tool speed and tilt during tasks and while parts are held."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import arctan2
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.model.job import Job
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.part_flow import NO_CARE, Care
from dualarm_cli.model.schedule import Event, Schedule, Segment
from dualarm_cli.model.verification import Check
from dualarm_cli.records import dataclass
from dualarm_cli.verification.measuring.tolerances import TOL
from dualarm_cli.verification.measuring.tool_model import ToolModel
from dualarm_cli.verification.motion_checks import jerk_fraction, velocity_extrema
from dualarm_cli.verification.tool_checks import Worst, instants, too_long, tool_speeds


@dataclass(frozen=True)
class CareSpan:
    """Span of time in which an arm, or with a part also the platform, keeps care."""

    arm: str
    """Name of the arm."""
    start: float
    """Start [s]."""
    end: float
    """End [s]."""
    care: Care
    """Limits."""
    task: str
    """Id of the task."""
    holds: bool
    """Whether the arm holds the task's part throughout, or follows a path or seam."""


def check_care(schedule: Schedule, job: Job, model: ToolModel) -> list[Check]:
    """Check the limits of tasks and of held parts; for jobs with such limits only.

    Args:
        schedule: the schedule to check.
        job: the job as the schedule did it.
        model: forward kinematics of the schedule's robot.
    """
    spans, where = list(_spans(schedule, job)), too_long(schedule)
    rates, tilt = Worst(), Worst()
    if where:
        spans = []
        rates.add(np.inf, where)
        tilt.add(np.inf, where)
    for span in spans:
        if span.care.slows:
            value, what = _largest_share(schedule, span, model)
            rates.add(value, f"{what} from {span.start:.3f} s to {span.end:.3f} s ({span.task})")
    off = 0.0
    leans = [] if where else list(_leaning(schedule, job, spans, model))
    # The error of measurement is an angle, and so a larger share of a smaller limit.
    if leans:
        span, angle, at = max(
            leans, key=lambda lean: (lean[1] - TOL.pose_angle) / lean[0].care.tilt
        )
        tilt.add(angle / span.care.tilt, f"{span.arm} at {at:.3f} s ({span.task})")
        off = TOL.pose_angle / span.care.tilt
    named = ((rates, "care", TOL.tool_speed_slack), (tilt, "tilt", off))
    limited = job.slows, any(task.tilt < np.inf for task in job.tasks)
    return [
        worst.judge(name, 1.0 + slack)
        for (worst, name, slack), listed in zip(named, limited, strict=True)
        if listed
    ]


def _spans(schedule: Schedule, job: Job) -> Iterator[CareSpan]:
    """List the spans of held parts, and of tasks from first transfer to last retract."""
    events_of: defaultdict[tuple[str, str], list[Event]] = defaultdict(list)
    moves_of: defaultdict[tuple[str, str], list[Segment]] = defaultdict(list)
    for event in schedule.events:
        events_of[event.arm, event.task].append(event)
    for segment in schedule.segments:
        if segment.kind != "wait":
            moves_of[segment.arm, segment.task].append(segment)
    for task in job.tasks:
        key = task.arm, task.id
        events, moves = events_of[key], moves_of[key]
        times = [t for s in moves for t in (s.start, s.end)] + [e.time for e in events]
        follows = task.path is not None or task.seam is not None
        if times and task.care.slows:
            yield CareSpan(task.arm, min(times), max(times), task.care, task.id, holds=follows)
        held = [e for e in events if e.action in ("pick", "take", "place", "give")]
        care = task.care.stricter(task.holding)
        if len(held) == 2 and care != NO_CARE:
            start, end = held[0].time, held[1].time + held[1].dwell
            yield CareSpan(task.arm, start, end, care, task.id, holds=True)


def _largest_share(schedule: Schedule, span: CareSpan, model: ToolModel) -> tuple[float, str]:
    """Measure the largest share of a limit in a span, and name the joint or tool."""
    care, robot = span.care, schedule.robot
    joints = (*robot.arms[span.arm].joints, *(robot.platform if span.holds else ()))
    motion = _cut(schedule.trajectory.select(joints), span.start, span.end)
    limits = robot.limits.select(joints).scaled(care.speed, care.acceleration)
    shares = np.stack(
        [
            velocity_extrema(motion) / limits.velocity,
            np.abs(motion.acceleration).max(axis=0) / limits.acceleration,
            jerk_fraction(motion, limits),
        ]
    )
    worst = float(shares.max()), joints[int(np.argmax(shares.max(axis=0)))]
    if care.tool_speed == np.inf:
        return worst
    speed = max(
        float(tool_speeds(schedule, model, times, [span.arm])[span.arm].max())
        for times in instants(schedule, span.start, span.end)
    )
    return max(worst, (speed / care.tool_speed, f"{span.arm} tool"))


def _cut(trajectory: Trajectory, start: float, end: float) -> Trajectory:
    """Cut a span out of a motion, without jumps of acceleration at its ends."""
    start, end = start + TOL.same_time, end - TOL.same_time
    inside = (trajectory.time > start) & (trajectory.time < end)
    time = np.concatenate([[start], trajectory.time[inside], [end]])
    return Trajectory(trajectory.joints, time, *trajectory.clamped(time))


def _leaning(
    schedule: Schedule, job: Job, spans: list[CareSpan], model: ToolModel
) -> Iterator[tuple[CareSpan, float, float]]:
    """Measure how far parts lean from their attitude at the pick: span, angle [rad], instant [s].

    The axis that is vertical at the pick is fixed in the tool; at a hand-over it changes the tool.
    """
    followed = [segment for segment in schedule.segments if segment.kind in ("path", "seam")]
    for task in job.tasks:
        for segment in followed:
            is_followed = (segment.arm, segment.task) == (task.arm, task.id)
            if is_followed and task.care.tilt < np.inf:
                span = CareSpan(
                    task.arm, segment.start, segment.end, task.care, task.id, holds=True
                )
                start = schedule.trajectory.clamped(np.array([span.start]))[0]
                up = model.poses(span.arm, start)[0][0][2]
                yield _most(schedule, span, up, model)
    firsts = {(e.arm, e.task): e for e in schedule.events if e.action in ("pick", "take")}
    axes: dict[str, FloatArray] = {}
    for span in sorted(spans, key=lambda span: span.start):
        if not span.holds or span.care.tilt == np.inf or (span.arm, span.task) not in firsts:
            continue
        first = firsts[span.arm, span.task]
        up = np.array([0.0, 0.0, 1.0])
        if first.action == "take":
            giver = next(arm for arm, task in firsts if task == span.task and arm != span.arm)
            up = product(_turn(schedule, model, giver, first), axes[span.task])
        axis = product(_turn(schedule, model, span.arm, first).T, up)
        axes[span.task] = axis
        yield _most(schedule, span, axis, model)


def _most(
    schedule: Schedule, span: CareSpan, axis: FloatArray, model: ToolModel
) -> tuple[CareSpan, float, float]:
    """Measure how far an axis of the tool leans at most in a span."""
    worst = span, 0.0, span.start
    for times in instants(schedule, span.start, span.end):
        R, _ = model.poses(span.arm, schedule.trajectory.clamped(times)[0])
        x, y, z = product(R, axis).T
        angle = arctan2(norm(np.stack([x, y]), axis=0), z)
        k = int(np.argmax(angle))
        if angle[k] > worst[1]:
            worst = span, float(angle[k]), float(times[k])
    return worst


def _turn(schedule: Schedule, model: ToolModel, arm: str, event: Event) -> FloatArray:
    """Compute the rotation of an arm's tool in the world at an event, shape (3, 3)."""
    at = schedule.trajectory.clamped(np.array([event.time]))[0]
    return model.poses(arm, at)[0][0]
