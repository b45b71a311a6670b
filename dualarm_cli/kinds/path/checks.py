"""Checks of tools that follow paths: deviation, progress, speed and synchrony."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import cbrt, cube
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.geometry.rotations import log_rotation
from dualarm_cli.model.curves.tool_path import TURN_LENGTH, ToolPath
from dualarm_cli.model.job import Job
from dualarm_cli.model.process_work import PathWork
from dualarm_cli.model.schedule import Event, Schedule, Segment
from dualarm_cli.model.verification import Check
from dualarm_cli.records import dataclass
from dualarm_cli.verification.kind_checks import KindChecks
from dualarm_cli.verification.measuring.criteria import NO_TASKS, Criterion, not_checked
from dualarm_cli.verification.measuring.dense_times import dense_times
from dualarm_cli.verification.measuring.tolerances import TOL
from dualarm_cli.verification.measuring.tool_model import ToolModel, rotation_angle
from dualarm_cli.verification.tool_checks import Worst

NO_PATHS = "the job has no paths"
CRITERIA = {
    "path_distance": Criterion(
        "share of the tolerance", "Largest distance of the tool from its path.", NO_PATHS
    ),
    "path_angle": Criterion(
        "share of the tolerance", "Largest angle of the tool from its path's orientation.", NO_PATHS
    ),
    "path_progress": Criterion(
        "m", "Length of a path that is left out at its ends, or gone backwards.", NO_PATHS
    ),
    "path_speed": Criterion(
        "share beyond what is asked", "Excess of the tool's speed along its path.", NO_PATHS
    ),
    "path_time": Criterion(
        "s beyond what is asked", "Excess of a path's duration at its speed.", NO_PATHS
    ),
    "paths_together": Criterion(
        "m", "Distance of one arm along its path ahead of the other one.", NO_PATHS
    ),
    "path_corners": Criterion(
        "share of what is allowed", "Largest distance from a rounded corner.", NO_PATHS
    ),
}


DIFFERENCE_STEPS = 4001
"""Number of steps of a path, for its directions.

A direction is a difference over a step to both sides.
"""
SPEED_WINDOW = 0.02
"""Time over which a tool's speed along its path is measured [s]."""
NEWTON_STEPS = 4
"""Number of Newton steps towards the nearest place of the path."""


@dataclass(frozen=True)
class Along:
    """Motion of one tool along its path, at k instants."""

    time: FloatArray
    """Instants [s], shape (k,)."""
    length: FloatArray
    """Path length up to the nearest place [m], shape (k,)."""
    distance: FloatArray
    """Distance of the tool from its path [m], shape (k,)."""
    angle: FloatArray
    """Angle of the tool from its path's orientation [rad], shape (k,)."""


def check_paths(schedule: Schedule, job: Job | None, model: ToolModel) -> list[Check]:
    """Check the tools on every path of a job: deviation, progress, speed and synchrony.

    Args:
        schedule: with finite numbers and rising times.
        job: cell and tasks; None for no check of paths.
        model: kinematics of the tools.
    """
    if job is None or not job.has_paths:
        return [not_checked(name, NO_TASKS if job is None else "") for name in CRITERIA]
    distance, angle, progress, speed, slow, together, corners = (Worst() for _ in range(7))
    events = {(e.arm, e.task): e for e in schedule.events if e.action == "path"}
    for section in job.sections():
        work = section[0].path
        if work is None:
            continue
        motions, paced = {}, job.under(section[0].care)
        work = followed_work(schedule, model, work, section[0].id)
        for task in section:
            segments = _segments(schedule, task.arm, task.id)
            place = f"{task.id} ({task.arm})"
            if len(segments) != 1 or segments[0].end <= segments[0].start:
                progress.add(
                    np.inf,
                    f"{place}: {len(segments)} segments of kind path; it takes one, of some length",
                )
                continue
            [segment] = segments
            path = work.paths[task.arm]
            event = events.get((task.arm, task.id))
            if event is None or abs(event.time - segment.end) > TOL.same_time:
                progress.add(np.inf, f"{place}: its event is not where its segment ends")
            elif (off := _pose_error(event, path)) > TOL.pose_distance:
                progress.add(off, f"{place}: its event commands a pose that is not the path's end")
            along = motions[task.arm] = along_path(schedule, model, segment, path)
            _add(distance, along.distance / work.tolerance, along.time, place)
            _add(angle, along.angle * TURN_LENGTH / work.tolerance, along.time, place)
            _add(progress, _progress_errors(along.length, path.length), along.time, place)
            allowed = work.speed * paced.speed * path.length / work.length
            # Over a short while: within its tolerance the tool may be a little ahead or behind.
            window = min(SPEED_WINDOW, float(along.time[-1] - along.time[0]))
            ahead = np.interp(along.time + window, along.time, along.length)
            rate = (ahead - along.length) / window
            if task.arm in work.sharp:
                _add_corners(corners, schedule, model, segment, work)
            _add(speed, rate / allowed - 1.0, along.time, place)
            if not work.slower:
                slow.add(_excess_time(paced, work, segment), place)
        if len(motions) == 2:
            fractions = [_fraction(motions[arm], work, arm) for arm in motions]
            first, second = motions.values()
            lead = (
                np.abs(fractions[0] - np.interp(first.time, second.time, fractions[1]))
                * work.length
            )
            _add(together, lead, first.time, section[0].id)
    lost, nothing = "no path has its segment", "no path has both arms"
    return [
        distance.judge("path_distance", 1.0, lost),
        angle.judge("path_angle", 1.0, lost),
        progress.judge("path_progress", TOL.line_distance, lost),
        speed.judge("path_speed", TOL.path_speed_slack, lost),
        slow.judge("path_time", TOL.path_late, "every path may be slower"),
        together.judge("paths_together", TOL.line_distance, nothing),
        corners.judge("path_corners", 1.0, "no corner of a path is rounded"),
    ]


def _segments(schedule: Schedule, arm: str, task: str) -> list[Segment]:
    return [s for s in schedule.segments if (s.kind, s.arm, s.task) == ("path", arm, task)]


def followed_work(schedule: Schedule, model: ToolModel, work: PathWork, task: str) -> PathWork:
    """Select the variant of a path that a tool follows: rounded or sharp corners.

    Args:
        schedule: the motion.
        model: kinematics of the tools.
        work: the path with rounded corners.
        task: its task.
    """
    for arm in work.sharp:
        segments = _segments(schedule, arm, task)
        if len(segments) == 1 and segments[0].end > segments[0].start:
            rounded, sharp = (
                along_path(schedule, model, segments[0], paths[arm]).distance.max()
                for paths in (work.paths, work.sharp)
            )
            if sharp < rounded:
                return work.stopping()
    return work


def _add_corners(
    worst: Worst, schedule: Schedule, model: ToolModel, segment: Segment, work: PathWork
) -> None:
    """Add the distances of a tool from corners that may be rounded.

    They are fractions of `blend` and tolerance together.
    """
    path = work.sharp[segment.arm]
    time = dense_times(schedule.trajectory.time, segment.start, segment.end)
    _, p = model.poses(segment.arm, schedule.trajectory.clamped(time)[0])
    # Between two instants the tool comes nearer than at both by less than half of their distance.
    steps = np.concatenate([[0.0], norm(np.diff(p, axis=0), axis=1)])
    for s in path.corners:
        away = norm(p - path.pose(s).translation, axis=1)
        nearest = int(np.argmin(away))
        least = float(away[nearest]) - 0.5 * float(steps[nearest : nearest + 2].max())
        share = least / (work.blend + work.tolerance)
        place = f"{segment.task} ({segment.arm}) at {time[nearest]:.3f} s"
        worst.add(max(0.0, share), place)


def _pose_error(event: Event, path: ToolPath) -> float:
    """Compute the distance of an event's pose from a path's end [m, rad]."""
    off = path.pose(path.length).actInv(event.pose)
    return max(float(norm(off.translation)), float(rotation_angle(off.rotation)))


def _excess_time(job: Job, work: PathWork, segment: Segment) -> float:
    """Compute a path's time beyond the longest allowed ramps [s], or 0.

    Defaults are an acceleration that takes `path_ramp` to the speed, and a jerk that takes `path_rise` to the
    acceleration. Between stops a double S from rest to rest ([Biagiotti2008] §3.4).
    """
    v = work.speed * job.speed
    if job.tool_speed is not None:
        v = min(v, job.tool_speed)
    given_a, given_j = work.acceleration, work.jerk
    a = given_a * np.square(job.speed) if given_a is not None else v * job.speed / TOL.path_ramp
    j = given_j * cube(job.speed) if given_j is not None else a * job.speed / TOL.path_rise
    v *= 1.0 - TOL.path_speed_slack
    stretches = np.diff([0.0, *work.corners(), 1.0]) * work.length
    late = segment.end - segment.start - sum(_double_s(float(d), v, a, j) for d in stretches)
    return float(late) if not late < 0.0 else 0.0


def _double_s(d: float, v: float, a: float, j: float) -> float:
    """Compute the least time for a distance from rest to rest [s].

    Limits are those of speed, acceleration and jerk.
    """
    if v * j < a * a:
        a = np.sqrt(v * j)
    if d >= v * (v / a + a / j):
        return d / v + v / a + a / j
    if d >= 2.0 * cube(a) / np.square(j):
        # A peak speed w below v: w (w / a + a / j) = d.
        w = a * (np.sqrt(np.square(a / j) / 4.0 + d / a) - a / j / 2.0)
        return float(2.0 * (w / a + a / j))
    return float(4.0 * cbrt(d / (2.0 * j)))


def _add(worst: Worst, values: FloatArray, time: FloatArray, where: str) -> None:
    """Add the largest of some measurements; NaN counts as the largest."""
    k = int(np.argmax(values))
    value = float(values[k])
    worst.add(value if not value < 0.0 else 0.0, f"{where} at {time[k]:.3f} s")


def _fraction(along: Along, work: PathWork, arm: str) -> FloatArray:
    return along.length / work.paths[arm].length


def _progress_errors(length: FloatArray, whole: float) -> FloatArray:
    """Compute missing lengths at both ends, and backward motion [m], shape (k,)."""
    off = np.maximum.accumulate(length) - length
    off[0] = max(off[0], length[0])
    off[-1] = max(off[-1], whole - length[-1])
    return off


def along_path(schedule: Schedule, model: ToolModel, segment: Segment, path: ToolPath) -> Along:
    """Locate a tool along its path during a segment.

    The search starts from the distance that the tool has travelled, because a path may cross itself or close. Newton
    steps then make the offset of the tool normal to the path.

    Args:
        schedule: the motion.
        model: kinematics of the tools.
        segment: of kind path.
        path: the path of the segment's tool.
    """
    time = dense_times(schedule.trajectory.time, segment.start, segment.end)
    R, p = model.poses(segment.arm, schedule.trajectory.clamped(time)[0])
    moved = norm(np.diff(p, axis=0), axis=1)
    turned = norm(log_rotation(product(R[1:], np.swapaxes(R[:-1], -1, -2))), axis=1)
    travelled = np.concatenate([[0.0], np.cumsum(np.maximum(moved, TURN_LENGTH * turned))])
    s = np.clip(travelled * (path.length / max(travelled[-1], path.length)), 0.0, path.length)
    step = path.length / DIFFERENCE_STEPS
    # Beyond a corner the path may return along itself: each instant stays on its side.
    edges = np.array([0.0, *path.corners, path.length])
    side = np.clip(np.searchsorted(edges, s, side="right") - 1, 0, len(edges) - 2)
    first, last = edges[side], edges[side + 1]
    for _ in range(NEWTON_STEPS):
        low, high = np.maximum(s - step, first), np.minimum(s + step, last)
        (R0, p0), (R1, p1), (R_here, p_here) = path.at(low), path.at(high), path.at(s)
        span = (high - low)[:, None]
        direction = np.hstack(
            [
                (p1 - p0) / span,
                TURN_LENGTH * log_rotation(product(R1, np.swapaxes(R0, -1, -2))) / span,
            ]
        )
        off = np.hstack(
            [p - p_here, TURN_LENGTH * log_rotation(product(R, np.swapaxes(R_here, -1, -2)))]
        )
        s = np.clip(
            s + (direction * off).sum(axis=1) / (direction * direction).sum(axis=1), first, last
        )
    R_here, p_here = path.at(s)
    angle = norm(log_rotation(product(R, np.swapaxes(R_here, -1, -2))), axis=1)
    return Along(time, s, norm(p - p_here, axis=1), angle)


CHECKS = KindChecks(
    {
        "work": lambda case: check_paths(case.schedule, case.done, case.model),
    },
    CRITERIA,
)
