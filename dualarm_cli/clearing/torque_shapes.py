"""Motion whose overloaded transfers have another shape, stage by stage.

A transfer beyond its torques is replaced by one within them between the same states (`torque_transfer`), while the
platform and all else of the arm stay as they are. The rest of the arm's stage comes later by the added time; the other
arm waits, or waits less. Bodies then meet at other times: a stage that loses its clearance keeps its transfers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from dualarm_cli.clearing.stage_samples import is_clear, stage_samples
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.dynamics import Dynamics
from dualarm_cli.model.cell import Held
from dualarm_cli.model.job import Job
from dualarm_cli.model.motion.joint_motion import merge
from dualarm_cli.model.motion.trajectory import SAME_TIME, Trajectory
from dualarm_cli.model.motion_limits import MotionLimits
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.schedule import Event, Segment, Stage
from dualarm_cli.motion.builder import Motion
from dualarm_cli.motion.payloads import carried_inertias, payload_spans
from dualarm_cli.motion.torque_limits import SETTINGS, sampled_motion
from dualarm_cli.motion.torque_transfer import State, TransferEnds, transfer_within_torques
from dualarm_cli.motion.transfers import keeps_tool_speed
from dualarm_cli.notes import Note, NoteTable
from dualarm_cli.postures.holding import Holding
from dualarm_cli.records import dataclass
from dualarm_cli.stages.method import MethodProblem
from dualarm_cli.timing.composition import concatenate, hold

shape_note = NoteTable(
    "torque",
    reshaped="torque: {transfers:# transfer has|# transfers have} another shape, together slower by {seconds:.3f} s",
)


@dataclass(frozen=True)
class _Shaped:
    """Replaced transfer of an arm."""

    segment: Segment
    """The transfer as it was."""
    motion: Trajectory
    """New motion of the arm's joints, from time 0."""

    @property
    def added(self) -> float:
        """Added duration [s]."""
        return self.motion.duration - (self.segment.end - self.segment.start)


def reshaped_within_torques(
    problem: MethodProblem, motion: Motion, holding: Holding | None, *, late: bool = False
) -> tuple[Motion, list[Note]]:
    """Replace transfers beyond torques where that can be done, with a note.

    Args:
        problem: of the job, with the arms of all tasks.
        motion: synchronous stages, or those of an arm alone.
        holding: bodies that must not collide; None checks none.
        late: whether belts may be met later than planned, as in estimates of delays.
    """
    job = problem.job
    if not problem.limits_torques or not np.isfinite(job.limits.jerk).all():
        return motion, []
    shaped = _replacements(job, motion)
    while shaped:
        changed = _with_shapes(job, motion, shaped, late=late)
        if isinstance(changed, int):
            # The belt of a stage would be met too late: the largest delay before it goes.
            before = [key for key in shaped if key[0] <= changed]
            shaped.pop(max(before, key=lambda key: shaped[key].added))
            continue
        touching = {k for k, _ in shaped if not _keeps(problem, changed, k, holding)}
        if not touching:
            seconds = changed.trajectory.duration - motion.trajectory.duration
            return changed, [shape_note("reshaped", transfers=len(shaped), seconds=seconds)]
        shaped = {key: value for key, value in shaped.items() if key[0] not in touching}
    return motion, []


def _keeps(problem: MethodProblem, motion: Motion, stage: int, holding: Holding | None) -> bool:
    """Check a stage's clearance and the speed of its tools."""
    caps = _limits(problem.job, motion, stage).caps
    if caps and not keeps_tool_speed(problem.model, caps, motion, stage):
        return False
    return holding is None or is_clear(holding.cell, stage_samples(motion, stage, stage, holding))


def _limits(job: Job, motion: Motion, stage: int) -> MotionLimits:
    """Return the limits of a stage's transfers."""
    events = [event for (k, _), event in motion.event_of.items() if k == stage]
    return MotionLimits.of_stage(job, frozenset((e.arm, e.task, e.action) for e in events))


def _replacements(job: Job, motion: Motion) -> dict[tuple[int, str], _Shaped]:
    """Compute the new shape of each overloaded transfer, by stage and arm."""
    spans, shared = payload_spans(job, motion), _shared(job)
    models: dict[tuple[tuple[str, Held], ...], Dynamics] = {}
    shaped, arms, tracks = {}, job.cell.robot.arms, _tracks(job, motion)
    for k, stage in enumerate(motion.stages):
        meets = bool(shared.intersection(stage.tasks))
        rests = [_rest(motion, track, name, stage, None, meets) for name, track in tracks.items()]
        if None in rests:
            continue
        for arm in arms:
            inside = _inside(motion, arm.name, stage)
            transfers = [s for s in inside if s.kind in ("transfer", "return")]
            if len(transfers) != 1 or transfers[0].end - transfers[0].start <= SAME_TIME:
                continue
            held = [
                span
                for span in spans
                if span.arm == arm.name
                and span.start <= transfers[0].start + SAME_TIME
                and span.end >= transfers[0].end - SAME_TIME
            ]
            key = tuple(span.load for span in held)
            if key not in models:
                models[key] = Dynamics(job.cell, carried_inertias(job, held))
            limits = _limits(job, motion, k).joints
            piece = _shape(job, motion.trajectory, (transfers[0], stage, limits), models[key])
            if piece is None:
                continue
            replaced = _Shaped(transfers[0], piece)
            if _rest(motion, tracks[arm.name], arm.name, stage, replaced, meets) is not None:
                shaped[k, arm.name] = replaced
    return shaped


def _shape(
    job: Job,
    trajectory: Trajectory,
    transfer: tuple[Segment, Stage, JointLimits],
    dynamics: Dynamics,
) -> Trajectory | None:
    """Reshape a transfer that is beyond its torques; None if it is not, or cannot be.

    The platform keeps its time in the stage.
    """
    robot, (segment, stage, limits) = job.cell.robot, transfer
    columns = robot.columns(robot.arm(segment.arm).joints)
    _, _, (q, v, a) = sampled_motion(trajectory, segment.start, segment.end)
    at_rest, moving, viscous = dynamics.torques(q, v, a)
    torque = np.abs(at_rest + moving + viscous)[:, columns]
    if (torque <= (1.0 - SETTINGS.reserve) * dynamics.limit[columns]).all():
        return None
    start, end = trajectory.clamped(segment.start), trajectory.clamped(segment.end)
    duration = segment.end - segment.start
    moves = np.abs(v[:, robot.columns(robot.platform)]).max(initial=0.0) > SETTINGS.at_rest
    beside = partial(_beside, trajectory, segment.start, stage.end) if moves else None
    ends = TransferEnds(start, end, duration, q.min(axis=0), q.max(axis=0), beside)
    return transfer_within_torques(dynamics, columns, ends, limits)


def _beside(trajectory: Trajectory, start: float, end: float, time: FloatArray) -> State:
    """Evaluate all joints at times after a start [s], at most at the end."""
    return trajectory.clamped(np.minimum(start + time, end))


def _shared(job: Job) -> set[str]:
    """Collect the tasks in which arms meet."""
    return {task.id for task in job.tasks if task.handover}


def _tracks(job: Job, motion: Motion) -> dict[str, Trajectory]:
    """Select the motions of the platform, named "", and of the arms."""
    robot = job.cell.robot
    groups = (("", robot.platform), *((arm.name, arm.joints) for arm in robot.arms))
    return {name: motion.trajectory.select(joints) for name, joints in groups if joints}


def _with_shapes(
    job: Job, motion: Motion, shaped: Mapping[tuple[int, str], _Shaped], *, late: bool
) -> Motion | int:
    """Build the motion with replaced transfers, or return the stage whose belt it misses."""
    tracks, arms = _tracks(job, motion), [arm.name for arm in job.cell.robot.arms]
    pieces: dict[str, list[Trajectory]] = {name: [] for name in tracks}
    segments: dict[str, list[Segment]] = {name: [] for name in arms}
    stages: list[Stage] = []
    events: list[Event] = []
    clock, shared = 0.0, _shared(job)
    for k, stage in enumerate(motion.stages):
        meets = bool(shared.intersection(stage.tasks))
        here = {n: shaped[k, n] for n in tracks if (k, n) in shaped}
        edits = _edits(motion, tracks, stage, here, meets)
        met = [e for e in motion.events if e.moves and _stage_of(e, motion.stages) == k]
        skipped = _skipped(motion, stage, clock - stage.start, met, edits, late=late)
        if skipped is None:
            return k
        for name, track in tracks.items():
            edits[name] = replace(edits[name], skipped=skipped)
            pieces[name].append(edits[name].track(track, stage))
        for name in arms:
            later = replace(edits[name], shift=clock - stage.start - skipped)
            inside = later.segments(_inside(motion, name, stage))
            segments[name] += [replace(s, start=max(s.start, clock)) for s in inside]
            events += [
                replace(event, time=later.at_event(event.time))
                for event in motion.events
                if event.arm == name and _stage_of(event, motion.stages) == k
            ]
        length = pieces[arms[0]][-1].duration
        stages.append(replace(stage, start=clock, end=clock + length))
        clock += length
    whole = [concatenate(parts) for parts in pieces.values()]
    trajectory = merge(whole, motion.trajectory.joints)
    events.sort(key=lambda event: event.time)
    in_order = tuple(segment for name in arms for segment in segments[name])
    return replace(
        motion, trajectory=trajectory, stages=tuple(stages), segments=in_order, events=tuple(events)
    )


@dataclass(frozen=True)
class _Edit:
    """Change of a joint group's motion in a stage: transfer, and wait at a rest."""

    rest: float
    """Time at rest at which the wait ends or is inserted [s]."""
    waited: float = 0.0
    """Present wait before it [s]."""
    shaped: _Shaped | None = None
    """Replaced transfer."""
    inserted: float = 0.0
    """Added wait [s], negative for a shorter one."""
    shift: float = 0.0
    """Change of the stage's start [s]."""
    skipped: float = 0.0
    """Time by which a common wait at the stage's start is shorter [s]."""
    meets: bool = False
    """Whether the wait is before the event, as in hand-overs."""

    @property
    def added(self) -> float:
        """Duration added by the transfer [s]."""
        return 0.0 if self.shaped is None else self.shaped.added

    def start(self, time: float) -> float:
        """Return the new time of what starts at an old one [s]."""
        return self._later(time) + (self.inserted if time >= self.rest - SAME_TIME else 0.0)

    def end(self, time: float) -> float:
        """Return the new time of what ends at an old one [s]."""
        return self._later(time) + (self.inserted if time > self.rest + SAME_TIME else 0.0)

    def at_event(self, time: float) -> float:
        """Return the new time of an event [s]."""
        return self.start(time) if self.meets else self.end(time)

    def _later(self, time: float) -> float:
        moved = self.shaped is not None and time >= self.shaped.segment.end - SAME_TIME
        return time + self.shift + (self.added if moved else 0.0)

    def track(self, track: Trajectory, stage: Stage) -> Trajectory:
        """Build the motion of the group in the stage, from time 0."""
        begin, parts = stage.start + self.skipped, []
        rest = max(self.rest, begin)
        if self.shaped is not None:
            parts += [_cut(track, begin, self.shaped.segment.start), self.shaped.motion]
            begin = self.shaped.segment.end
        parts.append(_cut(track, begin, max(rest + min(self.inserted, 0.0), begin)))
        if self.inserted > SAME_TIME:
            parts.append(hold(track.joints, track.clamped(rest)[0], self.inserted))
        parts.append(_cut(track, rest, stage.end))
        return concatenate([part for part in parts if part.duration > 0.0] or parts[-1:])

    def segments(self, old: Sequence[Segment]) -> list[Segment]:
        """Move the segments of an arm; a new wait gets one of its own."""
        moved: list[Segment] = []
        for segment in old:
            is_wait = segment.kind == "wait" and abs(segment.end - self.rest) <= SAME_TIME
            end = self.start(segment.end) if is_wait else self.end(segment.end)
            start = self.end(segment.start) if is_wait else self.start(segment.start)
            if end - start > SAME_TIME or not is_wait:
                moved.append(replace(segment, start=start, end=end))
            last = segment.end >= self.rest - SAME_TIME and segment.start < self.rest
            if last and not is_wait and self.inserted > SAME_TIME:
                names = segment.task, segment.action
                moved.append(
                    Segment(segment.arm, "wait", *names, end, end + self.inserted, reason="partner")
                )
        return moved


def _edits(
    motion: Motion,
    tracks: Mapping[str, Trajectory],
    stage: Stage,
    shaped: Mapping[str, _Shaped],
    meets: bool,
) -> dict[str, _Edit]:
    """Compute the change of every joint group such that all end the stage together."""
    edits = {}
    for name, track in tracks.items():
        place = _rest(motion, track, name, stage, shaped.get(name), meets)
        rest, waited = (stage.end, 0.0) if place is None else place
        edits[name] = _Edit(rest, waited, shaped.get(name), meets=meets)
    if not shaped:
        return edits
    # An arm that waits for the other one may wait less; no stage becomes shorter than it was.
    added = max(0.0, *(edit.added - edit.waited for edit in edits.values()))
    return {name: replace(edit, inserted=added - edit.added) for name, edit in edits.items()}


def _skipped(
    motion: Motion,
    stage: Stage,
    lag: float,
    met: Sequence[Event],
    edits: Mapping[str, _Edit],
    *,
    late: bool,
) -> float | None:
    """Compute how much shorter a common wait for a belt or a window is [s].

    Args:
        motion: as it was.
        stage: one of its stages.
        lag: by which the stage would begin later [s].
        met: events on belts in the stage.
        edits: of the stage, by group.
        late: whether belts may be met later.

    Returns:
        The time, or None if a belt would not be met.
    """
    waits = [
        segment
        for name in edits
        for segment in _inside(motion, name, stage)[:1]
        if segment.kind == "wait" and segment.start <= stage.start + SAME_TIME
    ]
    for_time = any(segment.reason in ("conveyor", "window") for segment in waits)
    # All arms wait; the platform, which has no segments, does with them.
    common = for_time and len(waits) == sum(name != "" for name in edits)
    room = min((s.end - s.start for s in waits), default=0.0) if common else 0.0
    later = {edits[event.arm].at_event(event.time) - event.time for event in met}
    if not later:
        return min(lag, room)
    needed = lag + max(later)
    is_met = max(later) - min(later) <= SAME_TIME and needed <= room + SAME_TIME
    return min(needed, room) if late or is_met else None


def _rest(
    motion: Motion,
    track: Trajectory,
    name: str,
    stage: Stage,
    shaped: _Shaped | None,
    meets: bool,
) -> tuple[float, float] | None:
    """Find a rest of a group after its transfer, and the wait before it [s].

    Where arms meet it is before the lines. Returns None for a group that is never at rest there.
    """
    inside = _inside(motion, name, stage)
    after = [s for s in inside if s.kind in ("wait", "dwell", "approach")]
    if shaped is not None:
        after = [s for s in after if s.start >= shaped.segment.end - SAME_TIME]
    lines = [s.start for s in after if s.kind != "wait"]
    latest = min(lines) if meets and lines else stage.end
    waits = [s for s in after if s.kind == "wait" and s.reason == "partner" and s.end <= latest]
    places = [(s.end, s.end - s.start) for s in waits[-1:]]
    if latest == stage.end:
        places += [(s.end, 0.0) for s in reversed(after) if s.kind != "wait"]
    for time, waited in (*places, (latest, 0.0), *([] if shaped else [(stage.start, 0.0)])):
        _, v, a = track.clamped(time)
        if max(np.abs(v).max(), np.abs(a).max()) <= SETTINGS.at_rest:
            return time, waited
    return None


def _inside(motion: Motion, arm: str, stage: Stage) -> list[Segment]:
    """Select an arm's segments of a stage."""
    return [
        segment
        for segment in motion.segments
        if segment.arm == arm
        and segment.start >= stage.start - SAME_TIME
        and segment.end <= stage.end + SAME_TIME
        and (segment.end > segment.start or segment.start < stage.end - SAME_TIME)
    ]


def _stage_of(event: Event, stages: Sequence[Stage]) -> int:
    """Find the stage of an event: the first with its task that ends no earlier."""
    return next(
        k
        for k, stage in enumerate(stages)
        if event.task in stage.tasks and stage.end >= event.time + event.dwell - SAME_TIME
    )


def _cut(track: Trajectory, start: float, end: float) -> Trajectory:
    """Cut a span out of a motion; its time begins at 0."""
    rows = np.flatnonzero((track.time > start + SAME_TIME) & (track.time < end - SAME_TIME))
    first, last = track.clamped(start), track.clamped(end)
    inner = (track.position[rows], track.velocity[rows], track.acceleration[rows])
    rates = [np.vstack([x, y, z]) for x, y, z in zip(first, inner, last, strict=True)]
    time = np.concatenate([[start], track.time[rows], [end]]) - start
    return Trajectory(track.joints, time, *rates)
