"""Spans of tools on the lines and in the dwells of stops, measured on the motion.

Allowed contacts and the start and end of tasks follow from these spans. A schedule's own list of segments is checked
against the motion (`stage_checks`) and not used here.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.geometry.products import product
from dualarm_cli.model.job import Job, Stop
from dualarm_cli.model.lines import Line
from dualarm_cli.model.schedule import Event, Schedule
from dualarm_cli.records import dataclass
from dualarm_cli.verification.measuring.dense_times import AT_ONCE, dense_spans
from dualarm_cli.verification.measuring.tolerances import TOL
from dualarm_cli.verification.measuring.tool_model import ToolModel, rotation_angle

FIRST_INSTANTS = 128
"""Number of instants of a line that are sampled first; most lines have fewer."""


@dataclass(frozen=True)
class LineSpan:
    """Span of a tool on the lines and in the dwell of one stop."""

    event: Event
    """Event of the tool at the target."""
    stop: Stop
    """Stop of the job."""
    start: float
    """Start of the approach line [s], or the event's time without one."""
    end: float
    """End of the retract line [s], or of the dwell without one."""

    @property
    def dwell_end(self) -> float:
        """End of the dwell [s]."""
        return self.event.time + self.event.dwell


def line_spans(schedule: Schedule, job: Job, model: ToolModel) -> tuple[LineSpan, ...]:
    """Measure the line spans of the job's stops, in the order of events.

    The line of a stop begins at the event, with the job's length and direction; it moves with a moving target.
    An approach begins at the last time before the event at which the tool is at the outer end of this line, or as far
    out as it is without leaving the line; a retract ends at the first such time after the dwell.

    Args:
        schedule: with finite numbers and rising times.
        job: each task with the arm that did it.
        model: forward kinematics of the tools.
    """
    stops = job.stops_by_key()
    spans: dict[int, LineSpan] = {}
    for arm in schedule.robot.arms:
        numbers_of_arm = [k for k, event in enumerate(schedule.events) if event.arm == arm]
        numbers_of_arm.sort(key=lambda k: schedule.events[k].time)
        numbers, lines = [], []
        for place, k in enumerate(numbers_of_arm):
            event = schedule.events[k]
            stop = stops.get((arm, event.task, event.action))
            if stop is None:
                continue
            dwell_end = event.time + event.dwell
            # Motion before the previous event, or after the next one, belongs to another stop.
            first = schedule.trajectory.time[0]
            if place:
                before = schedule.events[numbers_of_arm[place - 1]]
                first = before.time + before.dwell
            last = schedule.trajectory.time[-1]
            if place + 1 < len(numbers_of_arm):
                last = schedule.events[numbers_of_arm[place + 1]].time
            numbers.append(k)
            lines.append(_Line(event, stop, event.time, min(first, event.time)))
            lines.append(_Line(event, stop, dwell_end, max(last, dwell_end)))
        ends = _line_ends(schedule, model, lines)
        for k, line, start, end in zip(numbers, lines[::2], ends[::2], ends[1::2], strict=True):
            spans[k] = LineSpan(line.event, line.stop, start, end)
    return tuple(spans[k] for k in sorted(spans))


@dataclass(frozen=True)
class _Line:
    """Approach or retract line of a stop."""

    event: Event
    stop: Stop
    target_time: float
    """Time of the tool at the target [s]."""
    limit: float
    """Limit of the search for the line's outer end [s]."""

    @property
    def length(self) -> float:
        """Length of the job's line [m]."""
        return self.line[0]

    @property
    def line(self) -> Line:
        """Length and direction of the job's line."""
        return self.stop.lines[int(self.limit >= self.target_time)]


def _line_ends(schedule: Schedule, model: ToolModel, lines: Sequence[_Line]) -> list[float]:
    """Find the times of one arm's tool at the outer end of each line [s]."""
    ends = [line.target_time for line in lines]
    remaining = [
        k for k, line in enumerate(lines) if line.length > 0.0 and line.limit != line.target_time
    ]
    # Most lines are short: few need all instants up to their limit.
    count = FIRST_INSTANTS
    while remaining:
        longer = []
        for k in range(0, len(remaining), AT_ONCE):
            batch = remaining[k : k + AT_ONCE]
            ends_of_batch = _ends_among(schedule, model, [lines[number] for number in batch], count)
            for number, end in zip(batch, ends_of_batch, strict=True):
                if end is None:
                    longer.append(number)
                else:
                    ends[number] = end
        remaining, count = longer, 4 * count
    return ends


def _ends_among(
    schedule: Schedule, model: ToolModel, lines: Sequence[_Line], count: int
) -> list[float | None]:
    """Find outer ends within the first `count` instants [s], None for longer lines."""
    target_time, limit = np.array([(line.target_time, line.limit) for line in lines]).T
    times, first = dense_spans(
        schedule.trajectory.time, np.minimum(target_time, limit), np.maximum(target_time, limit)
    )
    all_instants = [
        times[i:j] if line.limit > line.target_time else times[i:j][::-1]
        for line, (i, j) in zip(lines, pairwise(first), strict=True)
    ]
    first_instants = [instants[:count] for instants in all_instants]
    depths, on_lines = _on_lines(schedule, model, lines, first_instants)
    ends: list[float | None] = []
    for line, all_of_line, instants, depth, on_line in zip(
        lines, all_instants, first_instants, depths, on_lines, strict=True
    ):
        off = np.flatnonzero(~on_line | (depth > line.length + TOL.line_distance))
        if not len(off) and len(instants) < len(all_of_line):
            ends.append(None)
            continue
        count_on_line = int(off[0]) if len(off) else len(instants)
        if count_on_line == 0:
            ends.append(line.target_time)
            continue
        # A transfer may continue in the same direction beyond the line's end.
        outermost = (
            depth[:count_on_line] >= min(depth[:count_on_line].max(), line.length) - TOL.same_place
        )
        ends.append(float(instants[int(np.argmax(outermost))]))
    return ends


def _on_lines(
    schedule: Schedule, model: ToolModel, lines: Sequence[_Line], instants: Sequence[FloatArray]
) -> tuple[list[FloatArray], list[BoolArray]]:
    """Measure the tool's depth on each line [m], and whether it is on the line.

    Both have shape (m,) for the m instants of a line.
    """
    arm, events = lines[0].event.arm, np.array([line.event.time for line in lines])
    line = np.repeat(
        np.arange(len(lines)), [len(instants_of_line) for instants_of_line in instants]
    )
    times = np.concatenate(instants)
    R, p = model.poses(arm, schedule.trajectory.clamped(times)[0])
    R_event, p_event = model.poses(arm, schedule.trajectory.clamped(events)[0])
    velocity = np.array([line.stop.velocity for line in lines])
    moved = p - p_event[line] - (times - events[line])[:, None] * velocity[line]
    turn = R_event.transpose(0, 2, 1)[line]
    pairs = zip(lines, R_event, strict=True)
    axes = np.array([each.line[1].axes(R_tool) for each, R_tool in pairs])[line]
    local = product(moved[:, None], turn.transpose(0, 2, 1), axes)[:, 0]
    depth = -local[:, 2]
    on_line = (np.hypot(local[:, 0], local[:, 1]) <= TOL.line_distance) & (
        rotation_angle(product(turn, R)) <= TOL.line_angle
    )
    on_line &= depth >= -TOL.line_distance
    ends = np.cumsum([len(instants_of_line) for instants_of_line in instants])[:-1]
    return np.split(depth, ends), np.split(on_line, ends)


def spans_of(spans: Sequence[LineSpan], arm: str, task: str, action: str) -> list[LineSpan]:
    """Select the spans of one stop."""
    return [s for s in spans if (s.event.arm, s.event.task, s.event.action) == (arm, task, action)]
