"""Motion within joint torques: spans between rests are slowed as far as their torques require.

Slowing all joints together by a factor s leaves every place of the motion as it is, so that clearance stays proven.
Torques of the motion fall by s², those at rest do not: the least factor has a closed form ([Hollerbach1984]). Waits
follow dwells that would become longer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dualarm_cli.errors import BlockedError, InfeasibleError
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.kinematics.dynamics import Dynamics
from dualarm_cli.model.cell import Held
from dualarm_cli.model.job import Job
from dualarm_cli.model.motion.trajectory import SAME_TIME, Trajectory
from dualarm_cli.model.schedule import Segment
from dualarm_cli.motion.builder import Motion
from dualarm_cli.motion.payloads import PayloadSpan, carried_inertias, payload_spans
from dualarm_cli.motion.timed_work import timed_spans
from dualarm_cli.notes import Note, NoteTable
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal

torque_note = NoteTable(
    "torque",
    rated="torque: all motion between rests takes at least {factor:.2f} times as long, for the rated effort of {joint}",
    slowed="torque: {spans:# motion between rests is|# motions between rests are} slowed, by up to {most:.0%} for "
    "{joint}, together by {seconds:.3f} s",
)


@dataclass(frozen=True)
class TorqueSettings:
    """Sampling and reserve of torque limits."""

    step: float = 0.008
    """Largest distance of two instants [s]."""
    reserve: float = 3e-3
    """Fraction of efforts that is kept, for peaks between instants."""
    ahead: float = 5e-3
    """Fraction of efforts that is kept by paths, seams and motion on belts."""
    slowest: float = 4.0
    """Largest factor by which motion is slowed for rated efforts."""
    at_rest: float = 1e-9
    """Speed [rad/s] and acceleration [rad/s²] that count as zero."""


SETTINGS = TorqueSettings()
SHORTEST = 1e-3
"""Fraction of a wait that remains at least."""


def within_torques(job: Job, motion: Motion, *, late: bool = False) -> tuple[Motion, list[Note]]:
    """Slow a motion where joints would exceed their torques, with a note.

    Waits for a belt become shorter by what is slowed before them.

    Args:
        job: with the tasks of all events, and a cell that limits torques.
        motion: of all joints.
        late: whether belts may be met later than planned, as in estimates of delays.

    Raises:
        BlockedError: a joint cannot hold still at a place of the motion.
        InfeasibleError: a joint exceeds its torques on a path, a seam or a belt whose time the job gives, or a belt
            would be met too late.
    """
    factors, edges, joint, notes = _slowing(job, motion, late=late)
    if not (factors > 1.0).any():
        return motion, []
    slowed = _slowed(motion, factors, edges)
    seconds = slowed.trajectory.duration - motion.trajectory.duration
    count, most = int((factors > 1.0).sum()), float(factors.max()) - 1.0
    name = job.cell.robot.joints[joint]
    note = torque_note("slowed", spans=count, most=most, joint=name, seconds=seconds)
    return slowed, [note, *notes]


def _slowing(
    job: Job, motion: Motion, *, late: bool
) -> tuple[FloatArray, IntArray, int, list[Note]]:
    """Compute the factor of every span between rests, and the joint of the largest one.

    Returns:
        Factors, shape (m,); knots at the edges of the spans, shape (m + 1,); index of a joint; notes.
    """
    trajectory = motion.trajectory
    still = np.hstack([np.abs(trajectory.velocity), np.abs(trajectory.acceleration)]).max(axis=1)
    rests = np.flatnonzero(still <= SETTINGS.at_rest)
    edges = np.unique(np.concatenate([[0], rests, [len(still) - 1]]))
    times = trajectory.time[edges]
    if trajectory.duration <= 0.0:
        return np.ones(len(times) - 1), edges, 0, []
    loads = payload_spans(job, motion)
    bounds = np.unique([trajectory.time[0], *(t for load in loads for t in (load.start, load.end))])
    models: dict[tuple[tuple[str, Held], ...], Dynamics] = {}
    instants: list[_Instants] = []
    failures: list[BlockedError] = []
    for first, last in zip(bounds, [*bounds[1:], trajectory.time[-1]], strict=True):
        if last <= first:
            continue
        held = [load for load in loads if load.start <= first and load.end >= last]
        key = tuple(load.load for load in held)
        if key not in models:
            models[key] = Dynamics(job.cell, carried_inertias(job, held))
        time, knot, (q, v, a) = sampled_motion(trajectory, float(first), float(last))
        parts = models[key].torques(q, v, a)
        try:
            worst = _least_squares(job, models[key].limit, time, parts, held)
        except BlockedError as error:
            failures.append(error)
            continue
        instants.append(_Instants(time, _span(edges, knot), v, *parts, *worst, tuple(held)))
    if failures:
        # The first one says why; a search learns from all.
        unheld = tuple(dict.fromkeys(pair for error in failures for pair in error.unheld))
        raise BlockedError(*failures[0].refusals, stages=(), unheld=unheld)
    squares = np.ones(len(times) - 1)
    for part in instants:
        np.maximum.at(squares, part.span, part.square)
    loose = np.ones(len(squares), dtype=np.bool_)
    for timed in timed_spans(job, motion):
        inside = (times[:-1] < timed.end - SAME_TIME) & (times[1:] > timed.start + SAME_TIME)
        if (squares[inside] > 1.0).any():
            part, row = _worst_instant(instants, inside)
            raise InfeasibleError(timed.overloaded(*_overload(job, part, row)))
        loose &= ~inside
    part, row = _worst_instant(instants, loose)
    factors, notes = np.sqrt(squares), list[Note]()
    if np.isfinite(job.cell.robot.torques.rated).any():
        factors, notes = _within_rated(job, instants, factors, loose)
    _recover(job, motion, factors, times, late=late)
    return factors, edges, int(part.joint[row]), notes


@dataclass(frozen=True)
class _Instants:
    """Torques of all joints at instants of a motion, with one payload."""

    time: FloatArray
    """Times [s], shape (k,); not in order."""
    span: IntArray
    """Spans between rests, shape (k,)."""
    velocity: FloatArray
    """Velocities, shape (k, n)."""
    at_rest: FloatArray
    """Torques at rest [N m or N], shape (k, n)."""
    moving: FloatArray
    """Torques of the motion, shape (k, n)."""
    viscous: FloatArray
    """Torques of viscous friction, shape (k, n)."""
    square: FloatArray
    """Least squares of the slowing factor, shape (k,)."""
    joint: IntArray
    """Indices of the joints that need it, shape (k,)."""
    held: tuple[PayloadSpan, ...]
    """Loads of the arms."""

    def squares(self, factors: FloatArray, coulomb: FloatArray) -> tuple[FloatArray, float]:
        """Integrate squared torques (n,) over the motion slowed by factors, and its duration [s]."""
        order = np.argsort(self.time, kind="stable")
        factor = factors[self.span[order]][:, None]
        torque = self.at_rest[order] + self.viscous[order] / factor
        torque += self.moving[order] / np.square(factor)
        moves = np.abs(self.velocity[order]) > SETTINGS.at_rest
        sign = np.where(moves, np.sign(self.velocity[order]), np.sign(torque))
        weight = np.diff(self.time[order])[:, None] * np.minimum(factor[1:], factor[:-1])
        square = np.square(torque + coulomb * sign)
        return np.sum(weight * (square[1:] + square[:-1]) / 2.0, axis=0), float(weight.sum())


def _within_rated(
    job: Job, instants: Sequence[_Instants], factors: FloatArray, loose: BoolArray
) -> tuple[FloatArray, list[Note]]:
    """Slow all motion by the least factor that keeps rated efforts, with a note.

    Args:
        job: with a robot that has rated efforts.
        instants: of the whole motion.
        factors: least factors of the spans between rests, shape (m,).
        loose: spans that may be slowed, shape (m,).

    Raises:
        InfeasibleError: the largest factor is too small.
    """
    robot = job.cell.robot
    moves = np.zeros(len(factors), dtype=np.bool_)
    for part in instants:
        np.logical_or.at(moves, part.span, (np.abs(part.velocity) > SETTINGS.at_rest).any(axis=1))

    def slowed(factor: float) -> FloatArray:
        return np.where(loose & moves, np.maximum(factors, factor), factors)

    def effective(factor: float) -> FloatArray:
        parts = [part.squares(slowed(factor), robot.torques.coulomb) for part in instants]
        total, duration = (sum(values) for values in zip(*parts, strict=True))
        return np.sqrt(total / max(duration, 1e-9))

    allowed, low, high = (1.0 - SETTINGS.reserve) * robot.torques.rated, 1.0, SETTINGS.slowest
    first = effective(low) / allowed
    if (first <= 1.0).all():
        return factors, []
    last = effective(high)
    joint = int(np.argmax(last / allowed))
    if last[joint] > allowed[joint]:
        name, rated = robot.joints[joint], float(robot.torques.rated[joint])
        data = {
            "joint": name,
            "unit": robot.torque_unit(name),
            "share": last[joint] / rated,
            "factor": high,
        }
        raise InfeasibleError(
            Refusal("rated", measured=float(last[joint]), allowed=rated, data=data)
        )
    while high - low > 1e-3:
        middle = (low + high) / 2.0
        fits = bool((effective(middle) <= allowed).all())
        low, high = (low, middle) if fits else (middle, high)
    name = robot.joints[int(np.argmax(first))]
    return slowed(high), [torque_note("rated", factor=high, joint=name)]


def _worst_instant(instants: Sequence[_Instants], spans: BoolArray) -> tuple[_Instants, int]:
    """Find the instant within some spans (m,) that requires most slowing."""
    rows = [(part, int(np.argmax(part.square * spans[part.span]))) for part in instants]
    return max(rows, key=lambda place: place[0].square[place[1]] * spans[place[0].span[place[1]]])


def _recover(
    job: Job, motion: Motion, factors: FloatArray, times: FloatArray, *, late: bool
) -> None:
    """Shorten the waits for belts by what comes later before them.

    Args:
        job: with the tasks of all events.
        motion: of all joints.
        factors: of each span, changed, shape (m,).
        times: at the edges of the spans [s], shape (m + 1,).
        late: whether belts may be met later.

    Raises:
        InfeasibleError: the waits before a belt are too short.
    """
    lengths, first, lag = np.diff(times), 0, 0.0
    for event in sorted(motion.events, key=lambda event: event.time + event.dwell):
        if not event.moves:
            continue
        last = int(np.searchsorted(times[:-1], event.time + event.dwell - SAME_TIME))
        spans = np.arange(first, last)
        lag += float(((factors - 1.0) * lengths)[spans].sum())
        waits = [k for k in spans if lag > 0.0 and _waits_for_belt(motion, times[k], times[k + 1])]
        # A wait that remains has a length, so that times rise.
        room = lengths[waits] * (1.0 - SHORTEST)
        shorter = min(lag, float(room.sum()))
        if shorter > 0.0:
            factors[waits] -= room / lengths[waits] * (shorter / float(room.sum()))
        lag, first = lag - shorter, last
        if lag > SAME_TIME and not late:
            task = next(task for task in job.tasks if task.id == event.task)
            raise InfeasibleError(Refusal("late_by_torque", task.place, event.task, event.arm, lag))


def _waits_for_belt(motion: Motion, start: float, end: float) -> bool:
    """Check whether all arms wait in a span, one of them for a belt."""
    inside = [
        segment
        for segment in motion.segments
        if segment.start <= start + SAME_TIME and segment.end >= end - SAME_TIME
    ]
    arms = {segment.arm for segment in motion.segments}
    return {s.arm for s in inside if s.kind == "wait"} == arms and any(
        segment.reason == "conveyor" for segment in inside
    )


def _span(edges: IntArray, knot: IntArray) -> IntArray:
    """Find the spans of knots; of two at one time the first ends the span before."""
    return np.clip(np.searchsorted(edges, knot, side="right") - 1, 0, len(edges) - 2)


def sampled_motion(
    trajectory: Trajectory, start: float, end: float
) -> tuple[FloatArray, IntArray, tuple[FloatArray, FloatArray, FloatArray]]:
    """Sample a span at its knots, on both sides of jumps, and between them.

    Returns:
        Times [s] and knots at or before them, each (k,); positions, velocities and accelerations, each (k, n).
    """
    inside = trajectory.time[(trajectory.time > start) & (trajectory.time < end)]
    uniform = np.arange(start, end, SETTINGS.step)
    time = np.unique(np.concatenate([[start], inside, uniform, [end]]))
    q, v, a = trajectory.clamped(time)
    # At a jump `at` gives the later acceleration; the earlier one is in the first of both knots.
    jumps = np.flatnonzero(
        (np.diff(trajectory.time) <= 0.0)
        & (trajectory.time[1:] > start)
        & (trajectory.time[1:] <= end)
    )
    rows = (trajectory.position, trajectory.velocity, trajectory.acceleration)
    before = tuple(row[jumps] for row in rows)
    whole = [np.vstack([x, y]) for x, y in zip((q, v, a), before, strict=True)]
    knot = np.concatenate([np.searchsorted(trajectory.time, time, side="right") - 1, jumps])
    time = np.concatenate([time, trajectory.time[jumps]])
    return time, knot, (whole[0], whole[1], whole[2])


def _least_squares(
    job: Job,
    most: FloatArray,
    time: FloatArray,
    torques: tuple[FloatArray, FloatArray, FloatArray],
    held: Sequence[PayloadSpan],
) -> tuple[FloatArray, IntArray]:
    """Compute the least square of the slowing factor at instants, and its joint.

    Returns:
        Squares, 0 at rest, shape (k,); indices of joints, shape (k,).

    Raises:
        BlockedError: a joint cannot hold still.
    """
    limit, at_rest = (1.0 - SETTINGS.reserve) * most, torques[0]
    lacking = np.abs(at_rest) - limit
    k, joint = np.unravel_index(int(np.argmax(lacking)), lacking.shape)
    if lacking[k, joint] >= 0.0:
        raise _cannot_hold(job, float(time[k]), int(joint), float(at_rest[k, joint]), held)
    squares = least_squares(limit, torques)
    return squares.max(axis=1), squares.argmax(axis=1)


def least_squares(
    limit: FloatArray, torques: tuple[FloatArray, FloatArray, FloatArray]
) -> FloatArray:
    """Compute the least squares of slowing factors within limits (n,), shape (k, n).

    Args:
        limit: greater than the torques at rest [N m or N].
        torques: at rest, of the motion, of viscous friction, each (k, n).
    """
    at_rest, moving, viscous = torques
    # With u = 1 / factor: |moving| u² + along u <= room, and against `moving` -along u <= opposite.
    sign = np.copysign(1.0, moving)
    room, opposite = (limit - s * at_rest for s in (sign, -sign))
    along = sign * viscous
    root = np.sqrt(np.square(along) + 4.0 * np.abs(moving) * room)
    squares = np.abs(moving) / room + along * (along + root) / (2.0 * np.square(room))
    return np.maximum(squares, np.square(np.minimum(along, 0.0) / opposite), out=squares)


def least_slowing(dynamics: Dynamics, motion: Trajectory) -> tuple[float, int]:
    """Compute the least slowing factor of a motion, at knots and middles, and its joint.

    The factor is infinite where a joint cannot hold still.

    Args:
        dynamics: of the robot with its loads.
        motion: of all joints.
    """
    middles = (motion.time[1:] + motion.time[:-1]) / 2.0
    torques = dynamics.torques(*motion.clamped(np.concatenate([motion.time, middles])))
    limit = (1.0 - SETTINGS.ahead) * dynamics.limit
    excess = np.abs(torques[0]).max(axis=0) / limit
    if excess.max() >= 1.0:
        return np.inf, int(np.argmax(excess))
    squares = least_squares(limit, torques).max(axis=0)
    return float(np.sqrt(squares.max())), int(np.argmax(squares))


def _cannot_hold(
    job: Job, time: float, joint: int, torque: float, held: Sequence[PayloadSpan]
) -> BlockedError:
    """Build the error of a joint that cannot hold still: another arm may."""
    torque, effort, data = _overload_data(job, time, joint, torque, held)
    refusal = Refusal("cannot_hold", measured=torque, allowed=effort, data={**data, "tried": []})
    arms = _arms_of(job, joint)
    # A tool alone is no reason against the task that took it.
    unheld = tuple((load.arm, load.task) for load in held if load.arm in arms and load.held.part)
    return BlockedError(refusal, stages=(), unheld=unheld)


def _arms_of(job: Job, joint: int) -> list[str]:
    """List the arm that has a joint; none for a joint of the platform."""
    robot = job.cell.robot
    return [arm.name for arm in robot.arms if robot.joints[joint] in arm.joints]


def _overload(job: Job, part: _Instants, row: int) -> tuple[float, float, dict[str, object]]:
    """Describe an instant: torque and effort [N m or N], and data of a refusal."""
    joint = int(part.joint[row])
    torque = float((part.at_rest + part.moving + part.viscous)[row, joint])
    whole = _overload_data(job, float(part.time[row]), joint, torque, part.held)
    whole[2]["most"] = 1.0 / np.sqrt(part.square[row])
    return whole


def _overload_data(
    job: Job, time: float, joint: int, torque: float, held: Sequence[PayloadSpan]
) -> tuple[float, float, dict[str, object]]:
    """Describe a torque: with friction, effort [N m or N], and data of a refusal."""
    robot = job.cell.robot
    effort = float(robot.torques.effort[joint])
    torque = abs(torque) + float(robot.torques.coulomb[joint])
    arms = _arms_of(job, joint)
    # A joint of an arm does not bear what the other arm carries.
    loads = [f"{load.arm} {load.held.name}" for load in held if load.arm in arms or not arms]
    return (
        torque,
        effort,
        {
            "joint": robot.joints[joint],
            "unit": robot.torque_unit(robot.joints[joint]),
            "torque": torque,
            "share": torque / effort,
            "time": time,
            "loads": loads,
            "carrying": f", carrying {' and '.join(loads)}" if loads else "",
        },
    )


def _slowed(motion: Motion, factors: FloatArray, knots: IntArray) -> Motion:
    """Slow the spans of a motion by their factors.

    Args:
        motion: of all joints.
        factors: at least 1, shape (m,).
        knots: at the edges of the spans, shape (m + 1,).
    """
    old = motion.trajectory
    edges, span = old.time[knots], _span(knots, np.arange(len(old.time)))
    starts = np.concatenate([[0.0], np.cumsum(np.diff(edges) * factors)])
    # At an edge all joints are at rest, so that both factors give the same.
    factor = factors[span][:, None]
    time = starts[span] + (old.time - edges[span]) * factor[:, 0]
    trajectory = Trajectory(
        old.joints,
        np.maximum.accumulate(time),
        old.position,
        old.velocity / factor,
        old.acceleration / np.square(factor),
    )

    def later(t: float) -> float:
        k = min(max(int(np.searchsorted(edges, t, side="right")) - 1, 0), len(factors) - 1)
        return float(starts[k] + (t - edges[k]) * factors[k])

    return replace(
        motion,
        trajectory=trajectory,
        stages=tuple(replace(s, start=later(s.start), end=later(s.end)) for s in motion.stages),
        segments=_segments(motion, [(later(s.start), later(s.end)) for s in motion.segments]),
        events=tuple(replace(event, time=later(event.time)) for event in motion.events),
    )


def _segments(motion: Motion, spans: Sequence[tuple[float, float]]) -> tuple[Segment, ...]:
    """Move segments to their new spans [s]; dwells keep their length, and a wait follows."""
    segments: list[Segment] = []
    waits: Segment | None = None
    for segment, (start, end) in zip(motion.segments, spans, strict=True):
        if waits is not None and segment.kind == "wait" and segment.arm == waits.arm:
            start = segments.pop().start
        stop = start + segment.end - segment.start if segment.kind == "dwell" else end
        segments.append(replace(segment, start=start, end=stop))
        waits = None
        if end - stop > SAME_TIME:
            names = segment.task, segment.action
            waits = Segment(segment.arm, "wait", *names, stop, end, reason="partner")
            segments.append(waits)
    return tuple(segments)
