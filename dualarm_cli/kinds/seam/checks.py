"""Checks of seams: closed chain, part pose, speed, and freedoms of the tool.

The speed is that along the seam.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from dualarm_cli.geometry.arrays import FloatArray, distinct
from dualarm_cli.geometry.elementary import arccos, arctan2, cos, sin
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.geometry.rotations import log_rotation
from dualarm_cli.model.job import Job
from dualarm_cli.model.process_work import SeamWork, longest_ramp
from dualarm_cli.model.schedule import Schedule, Segment
from dualarm_cli.model.verification import Check
from dualarm_cli.records import dataclass
from dualarm_cli.verification.kind_checks import KindChecks, Touch
from dualarm_cli.verification.measuring.criteria import NO_TASKS, Criterion, not_checked
from dualarm_cli.verification.measuring.dense_times import dense_times
from dualarm_cli.verification.measuring.line_spans import LineSpan, spans_of
from dualarm_cli.verification.measuring.tolerances import TOL
from dualarm_cli.verification.measuring.tool_model import ToolModel, rotation_angle
from dualarm_cli.verification.tool_checks import Worst


@dataclass(frozen=True)
class SeamSampling:
    """Sampling of seams between instants."""

    rounds: int = 12
    """Newton steps along the seam to the place nearest to the tool."""
    rate_step: float = 2e-4
    """Half the interval of the differences that measure speed and acceleration along a seam [s]."""
    most_rates: int = 20_000
    """Approximate maximum of instants with measured rates."""
    steady: float = 0.999
    """Fraction of the largest speed from which on the speed counts as steady."""


DENSE = SeamSampling()


@dataclass(frozen=True)
class OnSeam:
    """Tool and part during one seam, at k instants."""

    time: FloatArray
    """Instants [s], shape (k,)."""
    length: FloatArray
    """Length along the seam to the nearest place [m], shape (k,)."""
    distance: FloatArray
    """Distance of the tool's working point from the seam [m], shape (k,)."""
    angle: FloatArray
    """Rotation error of the tool beyond its freedoms [rad], shape (k,)."""
    lean: FloatArray
    """Tilt of the tool's axis [rad], shape (k,)."""
    R_part: FloatArray
    """Rotations of the part in the world, shape (k, 3, 3)."""
    p_part: FloatArray
    """Positions of the part [m], shape (k, 3)."""


@dataclass(frozen=True)
class MeasuredSeam:
    """Motion in the frame of one seam."""

    schedule: Schedule
    """The motion."""
    job: Job
    """Cell and tasks."""
    model: ToolModel
    """Forward kinematics of the tools."""
    work: SeamWork
    """The seam."""

    def during(self, segment: Segment) -> OnSeam:
        """Locate tool and part during a segment of kind seam."""
        motion = self.schedule.trajectory.time
        return self.near(dense_times(motion, segment.start, segment.end), None)

    def near(self, time: FloatArray, guess: FloatArray | None) -> OnSeam:
        """Locate tool and part at instants near given places on the seam.

        The part hangs on the master's flange, or stands in the world; the tool's pose is taken in its frame. Without
        a guess the place on the seam is searched from the distance that the working point has covered.

        Args:
            time: instants [s], shape (k,).
            guess: places on the seam [m], shape (k,), or None.
        """
        work, position = self.work, self.schedule.trajectory.clamped(time)[0]
        R, p = self.model.poses(work.slave, position)
        R_part, p_part = (
            np.tile(work.part.rotation, (len(time), 1, 1)),
            np.tile(work.part.translation, (len(time), 1)),
        )
        if work.master is not None:
            R_tool, p_tool = self.model.poses(work.master, position)
            T: pin.SE3 = self.job.cell.tools[work.master].tcp.inverse() * work.part
            R_part, p_part = product(R_tool, T.rotation), p_tool + product(R_tool, T.translation)
        tip = p + work.tool.standoff * R[:, :, 2]
        inside = product((tip - p_part)[:, None], R_part)[:, 0]
        if guess is None:
            travelled = np.concatenate([[0.0], np.cumsum(norm(np.diff(inside, axis=0), axis=1))])
            guess = travelled * (work.length / max(travelled[-1], 1e-12))
        s = np.clip(guess, 0.0, work.length)
        for _ in range(DENSE.rounds):
            along = ((inside - work.curve.at(s)[1]) * work.curve.directions(s)).sum(axis=1)
            s = np.clip(s + along, 0.0, work.length)
        R_seam, p_seam = work.curve.at(s)
        E = product(np.swapaxes(product(R_part, R_seam, work.tool.R_curve_tool), -1, -2), R)
        distance = norm(inside - p_seam, axis=1)
        lean = arctan2(np.hypot(E[:, 0, 2], E[:, 1, 2]), E[:, 2, 2])
        return OnSeam(time, s, distance, _rotation_errors(E, lean, work), lean, R_part, p_part)

    def tool_in_part(self, time: FloatArray) -> FloatArray:
        """Compute the tool centre point in the part's frame at instants (k,) [s], (k, 3) [m]."""
        _, p = self.model.poses(self.work.slave, self.schedule.trajectory.clamped(time)[0])
        at = self.near(time, np.zeros(len(time)))
        inside: FloatArray = product((p - at.p_part)[:, None], at.R_part)[:, 0]
        return inside

    def rates(self, seam: OnSeam) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Measure instants (k,) [s], speed (k,) [m/s] and acceleration (k,) [m/s²].

        Central differences of the place on the seam, over intervals short enough for a relative error of 1e-6.
        """
        step = min(DENSE.rate_step, float(seam.time[-1] - seam.time[0]) / 100.0)
        inner = np.clip(seam.time, seam.time[0] + step, seam.time[-1] - step)
        middle = distinct(inner)[:: max(1, len(inner) // DENSE.most_rates)]
        behind, middle_place, ahead = (
            self.near(time, np.interp(time, seam.time, seam.length)).length
            for time in (middle - step, middle, middle + step)
        )
        speed = (ahead - behind) / (2.0 * step)
        return middle, speed, (ahead - 2.0 * middle_place + behind) / np.square(step)


def _rotation_errors(E: FloatArray, lean: FloatArray, work: SeamWork) -> FloatArray:
    """Compute rotation errors of tools beyond their freedoms, (k,) [rad].

    Args:
        E: rotations of the tools in their target frames, shape (k, 3, 3).
        lean: tilts of their axes [rad], shape (k,).
        work: the seam.
    """
    beyond = np.maximum(lean - work.tool.tilt, 0.0)
    if work.tool.free_spin:
        return beyond
    # The rotation that remains after the shortest turn that undoes the tilt.
    axis = np.stack([-E[:, 1, 2], E[:, 0, 2], np.zeros(len(E))], axis=-1)
    size = norm(axis, axis=1, keepdims=True)
    back = -np.where(size > 1e-12, axis / np.where(size > 1e-12, size, 1.0), 0.0) * lean[:, None]
    K = np.zeros((len(E), 3, 3))
    K[:, 0, 2], K[:, 1, 2] = back[:, 1], -back[:, 0]
    K[:, 2, 0], K[:, 2, 1] = -back[:, 1], back[:, 0]
    sine = np.where(lean > 1e-12, sin(lean) / np.where(lean > 1e-12, lean, 1.0), 1.0)
    cosine = np.where(
        lean > 1e-6, (1.0 - cos(lean)) / np.where(lean > 1e-6, np.square(lean), 1.0), 0.5
    )
    upright = product(
        np.eye(3) + sine[:, None, None] * K + cosine[:, None, None] * product(K, K), E
    )
    spin = np.abs(log_rotation(upright)[:, 2])
    return np.maximum(beyond, spin)


NO_SEAMS = "the job has no seams"
CRITERIA = {
    "seam_distance": Criterion("m", "Largest distance of the tool from its seam.", NO_SEAMS),
    "seam_angle": Criterion(
        "rad",
        "Largest angle of the tool from its seam's orientation, beyond its freedoms.",
        NO_SEAMS,
    ),
    "seam_progress": Criterion(
        "m", "Length of a seam that is left out at its ends, or gone backwards.", NO_SEAMS
    ),
    "seam_speed": Criterion(
        "share beyond what is asked", "Excess of the speed along a seam.", NO_SEAMS
    ),
    "seam_steady": Criterion(
        "share of the speed", "Deviation of the speed from ramp, constant speed and ramp.", NO_SEAMS
    ),
    "seam_as_asked": Criterion(
        "share", "Excess of a seam's time, acceleration or entry over what the file sets.", NO_SEAMS
    ),
    "seam_part": Criterion(
        "m, rad", "Distance or angle of the part from the pose that the file sets.", NO_SEAMS
    ),
    "seam_downhand": Criterion(
        "rad beyond",
        "Tilt of the seam from the horizontal position beyond what is allowed.",
        NO_SEAMS,
    ),
}


def check_seams(
    schedule: Schedule, job: Job | None, model: ToolModel, lines: Sequence[LineSpan]
) -> list[Check]:
    """Check every seam of the job.

    Args:
        schedule: with finite numbers and rising times.
        job: cell and tasks; None for no check of seams.
        model: kinematics of the tools.
        lines: spans of the job's stops.
    """
    if job is None or not job.has_seams:
        return [not_checked(name, NO_TASKS if job is None else "") for name in CRITERIA]
    worst = {name: Worst() for name in CRITERIA}
    for section in job.sections():
        work = section[0].seam
        if work is None:
            continue
        task = section[0].id
        spans = {
            arm: [s for s in schedule.segments if (s.kind, s.arm, s.task) == ("seam", arm, task)]
            for arm in work.arms
        }
        [slave_segments, *other_segments] = [spans[arm] for arm in work.arms]
        if wrong := _wrong_order(schedule, work, task):
            worst["seam_progress"].add(np.inf, f"{task}: {wrong}")
            continue
        simultaneous = all(
            len(segments) == len(slave_segments) == 1
            and abs(segments[0].start - slave_segments[0].start)
            + abs(segments[0].end - slave_segments[0].end)
            < TOL.same_time
            for segments in other_segments
        )
        if (
            len(slave_segments) != 1
            or not simultaneous
            or slave_segments[0].end <= slave_segments[0].start
        ):
            message = f"{task}: it needs one segment of kind seam for each arm that works, at the same time"
            worst["seam_progress"].add(np.inf, message)
            continue
        measured = MeasuredSeam(schedule, job.under(section[0].care), model, work)
        SeamJudge(worst, measured, slave_segments[0], lines).judge()
    lost, nothing = "no seam has its segments", "not required by any seam"
    return [
        worst["seam_distance"].judge("seam_distance", TOL.chain_distance, lost),
        worst["seam_angle"].judge("seam_angle", TOL.chain_angle, lost),
        worst["seam_progress"].judge("seam_progress", TOL.line_distance, lost),
        worst["seam_speed"].judge("seam_speed", TOL.seam_speed_slack, lost),
        worst["seam_steady"].judge("seam_steady", TOL.seam_speed_slack, lost),
        worst["seam_as_asked"].judge("seam_as_asked", TOL.seam_speed_slack, nothing),
        worst["seam_part"].judge("seam_part", TOL.chain_distance, nothing),
        worst["seam_downhand"].judge("seam_downhand", TOL.chain_angle, nothing),
    ]


@dataclass(frozen=True)
class SeamJudge:
    """Judge of one seam that adds to the worst figures of the checks."""

    worst: dict[str, Worst]
    """Figures by check."""
    motion: MeasuredSeam
    """The motion and the seam."""
    segment: Segment
    """Segment of kind seam."""
    lines: Sequence[LineSpan]
    """Spans of the job's stops."""

    def judge(self) -> None:
        """Measure the seam."""
        work, seam = self.motion.work, self.motion.during(self.segment)
        self._add("seam_distance", seam.distance, seam.time)
        self._add("seam_angle", seam.angle, seam.time)
        backward = np.maximum.accumulate(seam.length) - seam.length
        backward[0] = max(backward[0], seam.length[0])
        backward[-1] = max(backward[-1], work.length - seam.length[-1])
        self._add("seam_progress", backward, seam.time)
        self._judge_rates(seam)
        self._judge_entry()
        if work.master is not None and (work.hold.given or work.hold.stands):
            self._add("seam_part", _part_errors(seam, work), seam.time)
        self._judge_ends(seam)
        if work.downhand is not None:
            R, _ = work.curve.at(seam.length)
            up = product(seam.R_part, R)[:, 2, 2]
            lean = arccos(np.clip(up, -1.0, 1.0))
            self._add("seam_downhand", lean - work.downhand, seam.time)

    def _add(self, name: str, values: FloatArray, time: FloatArray) -> None:
        k = int(np.argmax(values))
        value = float(values[k])
        place = f"{self.segment.task} at {time[k]:.3f} s"
        self.worst[name].add(value if not value < 0.0 else 0.0, place)

    def _judge_rates(self, seam: OnSeam) -> None:
        """Judge speed, steadiness, duration and acceleration."""
        work, pace, task = self.motion.work, self.motion.job.speed, self.segment.task
        middle, speed, acceleration = self.motion.rates(seam)
        if work.speed is not None:
            self._add("seam_speed", speed / (work.speed * pace) - 1.0, middle)
        else:
            self.worst["seam_speed"].add(0.0, task)
        dip, index = _speed_deviation(speed)
        self.worst["seam_steady"].add(dip, f"{task} at {middle[index]:.3f} s")
        taken, as_asked = self.segment.end - self.segment.start, self.worst["seam_as_asked"]
        if work.duration is not None:
            late = taken / (work.duration / pace) - 1.0
            as_asked.add(max(0.0, -late) if work.slower else abs(late), task)
        elif not work.slower:
            assert work.speed is not None
            as_asked.add(max(0.0, 1.0 - float(speed.max()) / (work.speed * pace)), task)
            longest = work.length / (work.speed * pace) + longest_ramp(work, pace)
            as_asked.add(max(0.0, taken / longest - 1.0), task)
        if work.acceleration is not None:
            allowed = work.acceleration * np.square(pace)
            self._add("seam_as_asked", np.abs(acceleration) / allowed - 1.0, middle)

    def _judge_entry(self) -> None:
        """Judge the start of the seam, and the time of the transfer to it."""
        work, start, task = self.motion.work, self.segment.start, self.segment.task
        if work.not_before > start + TOL.same_time:
            message = f"{task} begins before {work.not_before:g} s"
            self.worst["seam_as_asked"].add(np.inf, message)
        if work.entry_duration is not None:
            required = work.entry_duration / self.motion.job.speed
            taken = start - _free_time(self.motion.schedule, task, self.lines, start)
            waits = work.not_before >= start - TOL.same_time
            if taken < required - TOL.same_time or (taken > required + TOL.same_time and not waits):
                message = f"{task}: the motion to it takes {taken:.6g} s, not {required:g} s"
                self.worst["seam_as_asked"].add(np.inf, message)

    def _judge_ends(self, seam: OnSeam) -> None:
        """Judge that the part stands still while the tool approaches, dwells and retracts."""
        motion = self.motion
        for end, action in ((0, "seam_start"), (-1, "seam_end")):
            [stop] = spans_of(self.lines, motion.work.slave, self.segment.task, action)
            for start, end_time in ((stop.start, stop.event.time), (stop.dwell_end, stop.end)):
                if end_time > start:
                    self._add_still_part(seam, end, start, end_time)
            if stop.event.dwell > 0.0:
                time = self._add_still_part(seam, end, stop.event.time, stop.dwell_end)
                target = motion.tool_in_part(np.array([seam.time[end]]))
                self._add("seam_distance", norm(motion.tool_in_part(time) - target, axis=1), time)

    def _add_still_part(self, seam: OnSeam, end: int, start: float, over: float) -> FloatArray:
        """Measure the part against its pose at an end of the seam; return the instants [s]."""
        time = dense_times(self.motion.schedule.trajectory.time, start, over)
        at = self.motion.near(time, np.zeros(len(time)))
        away = norm(at.p_part - seam.p_part[end], axis=1)
        turned = rotation_angle(product(seam.R_part[end].T, at.R_part))
        self._add("seam_part", np.maximum(away, turned), time)
        return time


def _free_time(schedule: Schedule, task: str, lines: Sequence[LineSpan], begin: float) -> float:
    """Measure when the robot has finished the work before a seam [s].

    Work ends at the latest end of a line or a dwell, or where the robot stops soon after it. The first work
    follows the start of the motion.

    Args:
        schedule: the schedule.
        task: the seam's task.
        lines: spans of the job's stops.
        begin: when the seam begins [s].
    """
    motion = schedule.trajectory
    ends = (s.end for s in lines if s.event.task != task and s.event.time < begin)
    done = max(ends, default=float(motion.time[0]))
    # Near its end a line is so slow that rounding reaches its last place a moment before rest.
    at_rest = int(np.searchsorted(motion.time, done - TOL.same_time))
    while at_rest < len(motion.time) - 1 and np.abs(motion.velocity[at_rest]).max() > TOL.at_rest:
        at_rest += 1
    moved = np.abs(motion.position[at_rest] - motion.clamped(np.array([done]))[0][0]).max()
    return float(motion.time[at_rest]) if moved <= TOL.stands else done


def _wrong_order(schedule: Schedule, work: SeamWork, task: str) -> str:
    """Describe the first order error in a seam's segments and events, if any."""
    slave_segments = [s for s in schedule.segments if (s.arm, s.task) == (work.slave, task)]
    parts: dict[tuple[str, str], list[Segment]] = {}
    for segment in slave_segments:
        if segment.kind not in ("transfer", "wait"):
            parts.setdefault((segment.kind, segment.action), []).append(segment)
    doubled = [key for key, segments in parts.items() if len(segments) > 1]
    if doubled:
        return f"{len(parts[doubled[0]])} segments of kind {doubled[0][0]} ({doubled[0][1]})"
    seam = next((s for s in slave_segments if s.kind == "seam"), None)
    if seam is None:
        return "it has no segment of kind seam"
    events = [e for e in schedule.events if (e.arm, e.task) == (work.slave, task)]
    if sorted(event.action for event in events) != ["seam_end", "seam_start"]:
        return "it takes one event seam_start and one seam_end"
    last, first = sorted(events, key=lambda event: event.action)
    off = max(abs(first.time + first.dwell - seam.start), abs(last.time - seam.end))
    if not off <= TOL.same_time:
        return "its events are not where its segment begins and ends"
    for (kind, action), [segment] in parts.items():
        ends = {
            "approach": abs(segment.end - first.time),
            "retract": abs(segment.start - last.time - last.dwell),
            "dwell": abs(segment.start - (first if action == "seam_start" else last).time),
        }
        if not ends.get(kind, 0.0) <= TOL.same_time:
            return f"its {kind} ({action}) is not at its event"
    return ""


def _speed_deviation(speed: FloatArray) -> tuple[float, int]:
    """Compute the relative deviation of a speed profile (k,) [m/s], and its index.

    The nominal profile has a ramp, a plateau and a ramp. Between its first and last instant at the top speed, the speed
    has to stay there. Before it may only rise, after it only fall.
    """
    top = float(speed.max())
    if not top > 0.0:
        return np.inf, 0  # the tool never moves
    steady = np.flatnonzero(speed >= DENSE.steady * top)
    first, last = int(steady[0]), int(steady[-1])
    dip = np.maximum.accumulate(speed) - speed
    dip[last:] = (np.maximum.accumulate(speed[::-1])[::-1] - speed)[last:]
    dip[first : last + 1] = top - speed[first : last + 1]
    k = int(np.argmax(dip))
    return float(dip[k]) / top, k


def _part_errors(seam: OnSeam, work: SeamWork) -> FloatArray:
    """Compute the distance of the part from its required pose, (k,) [m, rad]."""
    if work.hold.given:
        R, p = work.hold.at(seam.length / work.length)
    else:
        R, p = seam.R_part[:1], seam.p_part[:1]
    away = norm(seam.p_part - p, axis=1)
    turned = rotation_angle(product(np.swapaxes(R, -1, -2), seam.R_part))
    return np.maximum(away, turned)


def seam_touches(job: Job, spans: Sequence[LineSpan]) -> list[Touch]:
    """List the contacts of a seam's tool with the bodies that it may touch.

    They include approach and retract.

    Args:
        job: as done.
        spans: of the job's stops.
    """
    touches = []
    for task in job.tasks:
        work = task.seam
        if work is None or task.arm != work.slave:
            continue
        begins, ends = (
            spans_of(spans, task.arm, task.id, action) for action in ("seam_start", "seam_end")
        )
        # The check of the order reports missing or repeated events. The tool is on the seam between both events.
        if len(begins) != 1 or len(ends) != 1 or begins[0].dwell_end > ends[0].event.time:
            continue
        tool = ("", f"{work.slave}_tool")
        for body in work.touches:
            if ("", body) != tool:
                bodies = frozenset({tool, ("", body)})
                touches.append(Touch(bodies, begins[0].start, ends[0].end, gripped=False))
    return touches


CHECKS = KindChecks(
    {"work": lambda case: check_seams(case.schedule, case.done, case.model, case.spans)},
    CRITERIA,
    seam_touches,
)
