"""Checks of stages, and of the kinds of segments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.job import Job, Stop, StopKey, Task
from dualarm_cli.model.schedule import WORK_ENDS, Event, Schedule, Segment
from dualarm_cli.model.verification import Check
from dualarm_cli.records import dataclass
from dualarm_cli.verification.as_done import contains, events_by_stage, in_time, stages_of_arm
from dualarm_cli.verification.measuring.criteria import judge, not_checked
from dualarm_cli.verification.measuring.dense_times import dense_times
from dualarm_cli.verification.measuring.line_spans import LineSpan
from dualarm_cli.verification.measuring.tolerances import TOL
from dualarm_cli.verification.tool_checks import Worst

NAME = "segment_kinds"
"""Name of the check."""


def check_segment_kinds(schedule: Schedule) -> Check:
    """Check that every segment's kind agrees with the motion and the events.

    An arm stands still while it waits; its transfers lead to its next event, and its returns come after the last one.
    Paths and seams have events of their own. Only waits have reasons, and no work follows a wait with reason `end`.

    Args:
        schedule: the schedule to check, with finite numbers and rising times.
    """
    if not schedule.segments:
        return not_checked(NAME)
    faults = []
    last = max((e.time for e in schedule.events), default=-np.inf)
    for arm in schedule.robot.arms:
        events = _Events.of([e for e in schedule.events if e.arm == arm], last)
        for segment in schedule.segments:
            if segment.arm == arm and (fault := _fault(schedule, segment, events)):
                of = f" of {segment.task}" if segment.task else ""
                faults.append(
                    f"{arm} {segment.kind}{of} from {segment.start:.4f} to {segment.end:.4f} s: {fault}"
                )
    where = faults[0] if faults else "every segment agrees with the motion"
    return judge(NAME, len(faults), 0, where)


@dataclass(frozen=True)
class _Events:
    """Index of one arm's events, which may be as many as its segments."""

    ordered: Sequence[Event]
    """Events in time order."""
    times: FloatArray
    """Times of the events [s]."""
    keys: frozenset[tuple[str, str]]
    """Tasks and actions of the events."""
    last: float
    """Time of the last event of any arm [s], -inf without events."""

    @classmethod
    def of(cls, events: Sequence[Event], last: float) -> _Events:
        ordered = in_time(events)
        times = np.array([e.time for e in ordered], dtype=np.float64)
        return cls(ordered, times, frozenset((e.task, e.action) for e in ordered), last)

    def ahead(self, segment: Segment) -> Event | None:
        """Find the first event from a segment's end on whose dwell it does not follow."""
        first = int(np.searchsorted(self.times, segment.end - TOL.same_time))
        later = (self.ordered[k] for k in range(first, len(self.ordered)))
        return next((e for e in later if e.time + e.dwell > segment.start + TOL.same_time), None)


def _fault(schedule: Schedule, segment: Segment, events: _Events) -> str:
    """Describe the fault of a segment by its arm's events, if any."""
    if segment.reason and segment.kind != "wait":
        return f"a reason for waiting is given ('{segment.reason}')"
    key = (segment.task, segment.action)
    ahead = events.ahead(segment)
    due = (ahead.task, ahead.action) if ahead else ("", "")
    if segment.kind == "wait":
        if moved := first_move(schedule, segment.arm, segment.start, segment.end):
            return f"the arm moves at {moved:.4f} s"
        if segment.reason == "end" and ahead:
            return f"its work is not done: {' '.join(due)} follows"
    elif segment.kind == "return":
        if any(key):
            return "a return belongs to no task"
        if ahead:
            return f"{' '.join(due)} follows, returns come last"
    elif segment.kind == "transfer":
        if any(key) and key != due:
            return f"the arm's next event is {' '.join(due).strip() or 'none'}, not {' '.join(key)}"
        # An arm that only makes room may move beyond the last event, but it starts before.
        if not any(key) and events.last < segment.start + TOL.same_time:
            return "nothing follows; a motion back to the start is a return"
    elif segment.kind in WORK_ENDS:
        due = (segment.task, WORK_ENDS[segment.kind])
        if key != due or due not in events.keys:
            return f"the arm has no event {' '.join(due)} that it leads to"
    return ""


def first_move(schedule: Schedule, arm: str, start: float, end: float) -> float:
    """Find the time at which an arm leaves its first posture [s], or 0.

    Args:
        schedule: the motion; an arm without listed joints counts as standing.
        arm: name of the arm.
        start: start of the span [s].
        end: end of the span [s].
    """
    joints = schedule.robot.arms[arm].joints
    if not joints or not end > start:
        return 0.0
    columns = [schedule.trajectory.joints.index(name) for name in joints]
    times = dense_times(schedule.trajectory.time, start, end)
    q = schedule.trajectory.clamped(times)[0][:, columns]
    moved = np.flatnonzero(np.abs(q - q[0]).max(axis=1) > TOL.stands)
    return float(times[moved[0]]) if len(moved) else 0.0


def check_stages(schedule: Schedule, job: Job | None = None) -> Check:
    """Check that stages follow one another from the start of the motion to its end.

    In asynchronous mode the stages of one arm and the common ones follow one another with waits between them, and each
    has the event of its task.

    Args:
        schedule: the schedule to check.
        job: decides whether arms are paired; without it the stages do.
    """
    if not schedule.stages:
        return not_checked("stages")
    free = any(stage.arm for stage in schedule.stages) if job is None else job.mode == "free"
    return _check_asynchronous(schedule) if free else _check_synchronous(schedule)


def _check_synchronous(schedule: Schedule) -> Check:
    worst, clock = Worst(where="one after the other"), 0.0
    for number, stage in enumerate(schedule.stages, start=1):
        late = abs(stage.start - clock)
        worst.add(late, f"stage {number} does not start where the one before ends")
        worst.add(stage.start - stage.end, f"stage {number} ends before it starts")
        clock = stage.end
    worst.add(abs(clock - schedule.duration), "the last stage does not end the motion")
    return worst.judge("stages", TOL.same_time)


def _check_asynchronous(schedule: Schedule) -> Check:
    worst = Worst(where="each arm's one after the other")
    for number, stage in enumerate(schedule.stages, start=1):
        worst.add(stage.start - stage.end, f"stage {number} ends before it starts")
        worst.add(-stage.start, f"stage {number} starts before the motion")
        worst.add(stage.end - schedule.duration, f"stage {number} ends after the motion")
    for arm in schedule.robot.arms:
        clock, before = 0.0, 0
        for k in stages_of_arm(schedule, arm):
            start, end = schedule.stages[k].start, schedule.stages[k].end
            where = f"stage {k + 1} starts before the {arm} arm has finished stage {before}"
            worst.add(clock - start, where)
            if end >= clock:
                clock, before = end, k + 1
    misplaced = _misplaced_work(schedule)
    if misplaced and worst.value <= TOL.same_time:
        worst.add(np.inf, misplaced)
    return worst.judge("stages", TOL.same_time)


def _misplaced_work(schedule: Schedule) -> str:
    """Describe an event without stage or a stage without event, or return ''."""
    if not schedule.events:
        return ""
    events_of_stage = events_by_stage(schedule)
    placed = {id(event) for events in events_of_stage for event in events}
    for event in schedule.events:
        if id(event) not in placed:
            return _unplaced(schedule, event)
    for number, (stage, events) in enumerate(
        zip(schedule.stages, events_of_stage, strict=True), start=1
    ):
        idle = [name for name in stage.tasks if all(event.task != name for event in events)]
        if idle:
            return f"stage {number} names {idle[0]}, which has no stop in it"
    return ""


def _unplaced(schedule: Schedule, event: Event) -> str:
    """Describe why an event belongs to no stage."""
    for number, stage in enumerate(schedule.stages, start=1):
        if stage.arm in ("", event.arm) and contains(stage, event):
            return f"{event.task} ({event.action}) is more than one stop of the {event.arm} arm in stage {number}"
    stages = f"the {event.arm} arm's stages"
    return f"{event.task} ({event.action}) at {event.time:.3f} s is within none of {stages} that name it"


def check_pairing(schedule: Schedule, job: Job, spans: Sequence[LineSpan]) -> Check:
    """Check that paired targets fall into one stage, which both arms start together.

    The arm that finishes a stage first stands until the other one has; the segments have to agree.

    Args:
        schedule: the schedule to check.
        job: as it was done.
        spans: of the job's stops.
    """
    if job.mode == "free":
        return not_checked("pairing")
    if wrong := _unpaired(schedule, job):
        return judge("pairing", np.inf, TOL.same_time, wrong)
    worst = Worst(where="both arms start every stage together")
    times = {(e.arm, e.task, e.action): e.time for e in schedule.events}
    parts: dict[StopKey, list[Segment]] = {}
    for segment in schedule.segments:
        parts.setdefault((segment.arm, segment.task, segment.action), []).append(segment)
    required = job.stages()
    for number, work in enumerate(required, start=1):
        if number > len(schedule.stages):
            return judge("pairing", np.inf, TOL.same_time, f"stage {number} is missing")
        stage = schedule.stages[number - 1]
        keys = [(arm, task.id, stop.action) for arm, (task, stop) in work.items()]
        for key in keys:
            time = times.get(key, np.inf)
            outside = max(stage.start - time, time - stage.end)
            worst.add(outside, f"{key[1]} ({key[2]}) is outside stage {number}")
        # An arm may have waited for other tasks until the stage begins.
        due = stage.start + TOL.same_time
        starts = [
            [p.start for p in parts.get(key, ()) if p.kind != "wait" or p.end > due] for key in keys
        ]
        first_starts = [min(times) for times in starts if times]
        offset = max(first_starts, default=0.0) - min(first_starts, default=0.0)
        worst.add(offset, f"the arms do not start stage {number} together")
    _add_early(worst, schedule, required, spans)
    wrong = _wrong_tasks(schedule, [[task.id for task, _ in work.values()] for work in required])
    if wrong and worst.value <= TOL.same_time:
        return judge("pairing", np.inf, TOL.same_time, wrong)
    return judge("pairing", worst.value, TOL.same_time, worst.where)


def _add_early(
    worst: Worst,
    schedule: Schedule,
    required: Sequence[Mapping[str, tuple[Task, Stop]]],
    spans: Sequence[LineSpan],
) -> None:
    """Add the times by which arms leave stages early [s], measured on the motion."""
    by_key = {(s.event.arm, s.event.task, s.event.action): s for s in spans}
    previous_end, number = -np.inf, 0
    for work in required:
        keys = [(arm, task.id, stop.action) for arm, (task, stop) in work.items()]
        span_of_arm = {key[0]: by_key[key] for key in keys if key in by_key}
        for arm, span in span_of_arm.items():
            where = (
                f"the {arm} arm is at {span.event.task} before both have finished stage {number}"
            )
            worst.add(previous_end - span.start, where)
        ends = {arm: _time_at_rest(schedule, span) for arm, span in span_of_arm.items()}
        previous_end, number = max(ends.values(), default=previous_end), number + 1
        for arm, end in ends.items():
            if moved := first_move(schedule, arm, end, previous_end):
                where = f"the {arm} arm leaves stage {number} before the other one is done"
                worst.add(previous_end - moved, where)


def _time_at_rest(schedule: Schedule, span: LineSpan) -> float:
    """Find the time at which an arm is at rest after a stop [s].

    After a moving target that is beyond the line.
    """
    if not span.stop.moves:
        return span.end
    trajectory = schedule.trajectory
    names = schedule.robot.arms[span.event.arm].joints
    columns = [trajectory.joints.index(name) for name in names]
    first = int(np.searchsorted(trajectory.time, span.end))
    speed = np.abs(trajectory.velocity[first:, columns]).max(axis=1)
    stands = np.flatnonzero(speed <= TOL.at_rest)
    return float(trajectory.time[first + stands[0]]) if len(stands) else schedule.duration


def _unpaired(schedule: Schedule, job: Job) -> str:
    """Describe a stage of one arm or a target without stage, or return ''."""
    for number, stage in enumerate(schedule.stages, start=1):
        if stage.arm:
            return (
                f"stage {number} is the {stage.arm} arm's alone, but with "
                f"mode: paired both arms start every stage together"
            )
    if job.pairing is None:
        return ""
    required = {(task.arm, task.id, stop.action) for task in job.tasks for stop in task.stops}
    paired = {key for stage in job.pairing for key in stage}
    for event in schedule.events:
        key = (event.arm, event.task, event.action)
        if key in required and key not in paired:
            return _unplaced(schedule, event)
    return ""


def _wrong_tasks(schedule: Schedule, required: list[list[str]]) -> str:
    """Describe a stage with other tasks than the job's, or return ''.

    A further stage, the return to the start, has no tasks.
    """
    for number, stage in enumerate(schedule.stages, start=1):
        due = required[number - 1] if number <= len(required) else []
        # Both arms may do one task together.
        if sorted(stage.tasks) != sorted(due) and set(stage.tasks) != set(due):
            said, wanted = (", ".join(names) or "no task" for names in (stage.tasks, due))
            return f"stage {number} names {said}; the tasks are {wanted}"
    return ""
