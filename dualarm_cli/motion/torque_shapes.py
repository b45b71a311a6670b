"""Motion whose overloaded transfers have another shape, stage by stage.

A transfer beyond its torques is replaced by one within them between the same states (`torque_transfer`), while the
platform and all else of the arm stay as they are. The rest of the arm's stage comes later by the added time; the other
arm waits, or waits less. Bodies then meet at other times: a stage that loses its clearance keeps its transfers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from dualarm_cli.kinematics.dynamics import Dynamics
from dualarm_cli.model.job import Job
from dualarm_cli.model.joint_motion import merge
from dualarm_cli.model.schedule import Event, Segment, Stage
from dualarm_cli.model.trajectory import SAME_TIME, Trajectory
from dualarm_cli.motion.builder import Motion
from dualarm_cli.motion.torque_limits import (
    SETTINGS,
    PayloadSpan,
    carried_inertias,
    payload_spans,
    sampled_motion,
)
from dualarm_cli.motion.torque_transfer import TransferEnds, transfer_within_torques
from dualarm_cli.notes import Note, NoteTable
from dualarm_cli.records import dataclass
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
    job: Job, motion: Motion, is_clear: Callable[[Motion, int], bool]
) -> tuple[Motion, list[Note]]:
    """Replace transfers beyond torques where that can be done, with a note.

    Args:
        job: with the arms of all tasks, and a cell that limits torques.
        motion: synchronous stages, in which each arm has a rest.
        is_clear: check of a stage of a motion, by its index.
    """
    if not _may_reshape(job, motion):
        return motion, []
    shaped = _replacements(job, motion)
    while shaped:
        changed = _with_shapes(job, motion, shaped)
        touching = {k for k, _ in shaped if not is_clear(changed, k)}
        if not touching:
            seconds = changed.trajectory.duration - motion.trajectory.duration
            return changed, [shape_note("reshaped", transfers=len(shaped), seconds=seconds)]
        shaped = {key: value for key, value in shaped.items() if key[0] not in touching}
    return motion, []


def _may_reshape(job: Job, motion: Motion) -> bool:
    """Check that nothing but torques prescribes the time of transfers."""
    return (
        job.tool_speed is None
        and bool(np.isfinite(job.limits.jerk).all())
        and all(not stage.arm for stage in motion.stages)
        and not any(event.moves for event in motion.events)
        and not any(segment.kind in ("path", "seam") for segment in motion.segments)
    )


def _replacements(job: Job, motion: Motion) -> dict[tuple[int, str], _Shaped]:
    """Compute the new shape of each overloaded transfer, by stage and arm."""
    spans, shared = payload_spans(job, motion), {task.id for task in job.tasks if task.handover}
    models: dict[tuple[PayloadSpan, ...], Dynamics] = {}
    shaped, arms, tracks = {}, job.cell.robot.arms, _tracks(job, motion)
    for k, stage in enumerate(motion.stages):
        rests = [_rest(motion, track, name, stage, None) for name, track in tracks.items()]
        if shared.intersection(stage.tasks) or None in rests:
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
            key = tuple(replace(span, start=0.0, end=0.0) for span in held)
            if key not in models:
                models[key] = Dynamics(job.cell, carried_inertias(job, held))
            piece = _shape(job, motion.trajectory, transfers[0], models[key])
            if piece is None:
                continue
            replaced = _Shaped(transfers[0], piece)
            if _rest(motion, tracks[arm.name], arm.name, stage, replaced) is not None:
                shaped[k, arm.name] = replaced
    return shaped


def _shape(
    job: Job, trajectory: Trajectory, segment: Segment, dynamics: Dynamics
) -> Trajectory | None:
    """Reshape a transfer that is beyond its torques; None if it is not, or cannot be."""
    robot = job.cell.robot
    columns = robot.columns(robot.arm(segment.arm).joints)
    _, _, (q, v, a) = sampled_motion(trajectory, segment.start, segment.end)
    if np.abs(v[:, robot.columns(robot.platform)]).max(initial=0.0) > SETTINGS.at_rest:
        return None
    at_rest, moving, viscous = dynamics.torques(q, v, a)
    torque = np.abs(at_rest + moving + viscous)[:, columns]
    if (torque <= (1.0 - SETTINGS.reserve) * dynamics.limit[columns]).all():
        return None
    start, end = trajectory.clamped(segment.start), trajectory.clamped(segment.end)
    duration = segment.end - segment.start
    ends = TransferEnds(start, end, duration, q.min(axis=0), q.max(axis=0))
    return transfer_within_torques(dynamics, columns, ends, job.limits)


def _tracks(job: Job, motion: Motion) -> dict[str, Trajectory]:
    """Select the motions of the platform, named "", and of the arms."""
    robot = job.cell.robot
    groups = (("", robot.platform), *((arm.name, arm.joints) for arm in robot.arms))
    return {name: motion.trajectory.select(joints) for name, joints in groups if joints}


def _with_shapes(job: Job, motion: Motion, shaped: Mapping[tuple[int, str], _Shaped]) -> Motion:
    """Build the motion with replaced transfers."""
    tracks, arms = _tracks(job, motion), [arm.name for arm in job.cell.robot.arms]
    pieces: dict[str, list[Trajectory]] = {name: [] for name in tracks}
    segments: dict[str, list[Segment]] = {name: [] for name in arms}
    stages: list[Stage] = []
    events: list[Event] = []
    clock = 0.0
    for k, stage in enumerate(motion.stages):
        edits = _edits(motion, tracks, stage, {n: shaped[k, n] for n in tracks if (k, n) in shaped})
        for name, track in tracks.items():
            pieces[name].append(edits[name].track(track, stage))
        for name in arms:
            later = replace(edits[name], shift=clock - stage.start)
            segments[name] += later.segments(_inside(motion, name, stage))
            events += [
                replace(event, time=later.end(event.time))
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

    def _later(self, time: float) -> float:
        moved = self.shaped is not None and time >= self.shaped.segment.end - SAME_TIME
        return time + self.shift + (self.added if moved else 0.0)

    def track(self, track: Trajectory, stage: Stage) -> Trajectory:
        """Build the motion of the group in the stage, from time 0."""
        begin, parts = stage.start, []
        if self.shaped is not None:
            parts += [_cut(track, begin, self.shaped.segment.start), self.shaped.motion]
            begin = self.shaped.segment.end
        parts.append(_cut(track, begin, max(self.rest + min(self.inserted, 0.0), begin)))
        if self.inserted > SAME_TIME:
            parts.append(hold(track.joints, track.clamped(self.rest)[0], self.inserted))
        parts.append(_cut(track, self.rest, stage.end))
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
) -> dict[str, _Edit]:
    """Compute the change of every joint group such that all end the stage together."""
    edits = {}
    for name, track in tracks.items():
        place = _rest(motion, track, name, stage, shaped.get(name))
        rest, waited = (stage.end, 0.0) if place is None else place
        edits[name] = _Edit(rest, waited, shaped.get(name))
    if not shaped:
        return edits
    # An arm that waits for the other one may wait less; no stage becomes shorter than it was.
    added = max(0.0, *(edit.added - edit.waited for edit in edits.values()))
    return {name: replace(edit, inserted=added - edit.added) for name, edit in edits.items()}


def _rest(
    motion: Motion, track: Trajectory, name: str, stage: Stage, shaped: _Shaped | None
) -> tuple[float, float] | None:
    """Find a rest of a group after its transfer, and the wait before it [s].

    Returns None for a group that is never at rest there.
    """
    after = [s for s in _inside(motion, name, stage) if s.kind in ("wait", "dwell", "approach")]
    if shaped is not None:
        after = [s for s in after if s.start >= shaped.segment.end - SAME_TIME]
    waits = [s for s in after if s.kind == "wait" and s.reason == "partner"]
    places = [(s.end, s.end - s.start) for s in waits[-1:]]
    places += [(s.end, 0.0) for s in reversed(after) if s.kind != "wait"]
    for time, waited in (*places, (stage.end, 0.0), *([] if shaped else [(stage.start, 0.0)])):
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
