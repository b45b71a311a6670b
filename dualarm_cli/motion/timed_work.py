"""Paths, seams, entries and motion on belts that must not be slowed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

from dualarm_cli.model.job import Job
from dualarm_cli.motion.builder import Motion
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal


@dataclass(frozen=True)
class TimedSpan:
    """Span of a motion that must not be slowed."""

    start: float
    """Start [s]."""
    end: float
    """End [s]."""
    refusal: Refusal
    """Refusal where torques require it to be slower; lacks joint, torque and limit."""

    def overloaded(self, measured: float, allowed: float, data: Mapping[str, object]) -> Refusal:
        """Complete the refusal: torque and limit [N m or N], joint, time, loads."""
        cause = Refusal("overload", measured=measured, allowed=allowed, data=data)
        data = {**data, "cause": cause}
        return replace(self.refusal, measured=measured, allowed=allowed, data=data)


def timed_spans(job: Job, motion: Motion) -> Iterator[TimedSpan]:
    """List the spans of a motion that must not be slowed.

    Args:
        job: with the tasks of all events.
        motion: of all joints.
    """
    tasks = {task.id: task for task in job.tasks}
    starts = {stage.end: stage.start for stage in motion.stages}
    for segment in motion.segments:
        task = tasks.get(segment.task)
        work = None if task is None else task.path or task.seam
        if task is None or work is None or segment.kind not in ("path", "seam"):
            continue
        if not work.slower:
            refusal = Refusal("torque_on_path", work.place, task.id, segment.arm)
            yield TimedSpan(segment.start, segment.end, refusal)
        if task.seam is not None and task.seam.entry_duration is not None:
            entered = min(starts, key=lambda end: abs(end - segment.start))
            refusal = Refusal("torque_on_entry", work.place, task.id, segment.arm)
            yield TimedSpan(starts[entered], segment.start, refusal)
    for event in motion.events:
        if event.moves:
            stop = next(s for s in tasks[event.task].stops if s.action == event.action)
            refusal = Refusal("torque_on_belt", stop.place, event.task, event.arm)
            yield TimedSpan(event.time, event.time + event.dwell, refusal)
