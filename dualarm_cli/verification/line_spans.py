"""When tools are on the lines and in the dwells of their stops, measured on the motion itself.

What a tool may touch, when a task begins and when it is over follow from here. A schedule's own list of segments says
the same where it is right; it is checked (`segment_checks`) and never believed.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.geometry.products import product
from dualarm_cli.model.job import Job, Stop
from dualarm_cli.model.schedule import Event, Schedule
from dualarm_cli.records import dataclass
from dualarm_cli.verification.dense_times import AT_ONCE, dense_spans
from dualarm_cli.verification.tolerances import TOL
from dualarm_cli.verification.tool_model import ToolModel, rotation_angle

FIRST_INSTANTS = 128
"""Instants of a line that are looked at first: more than most lines have."""


@dataclass(frozen=True)
class LineSpan:
    """When a tool is on the lines and in the dwell of one stop."""

    event: Event
    """The tool is at the target."""
    stop: Stop
    """What the job asks for there."""
    start: float
    """It comes onto the approach line [s]; the event's time where the stop has none."""
    end: float
    """It is at the end of the retract line [s]; the end of the dwell where the stop has none."""

    @property
    def over(self) -> float:
        """When the dwell is over [s]."""
        return self.event.time + self.event.dwell


def line_spans(schedule: Schedule, job: Job, model: ToolModel) -> tuple[LineSpan, ...]:
    """Returns the span of every event that is one of the job's stops, in the order of the events.

    The line of a stop is the tool's negative z axis where it is at the event, as long as the job asks, moving with the
    target where that moves. An approach begins the last time that the tool is at the outer end of this line before
    the event, or as far out as it is without leaving the line; a retract ends the first time after the dwell.

    Args:
        schedule: with finite numbers and rising times.
        job: each task with the arm that did it.
        model: where the tools are.
    """
    stops = job.stops_by_key()
    found: dict[int, LineSpan] = {}
    for arm in schedule.robot.arms:
        own = [k for k, event in enumerate(schedule.events) if event.arm == arm]
        own.sort(key=lambda k: schedule.events[k].time)
        numbers, lines = [], []
        for place, k in enumerate(own):
            event = schedule.events[k]
            stop = stops.get((arm, event.task, event.action))
            if stop is None:
                continue
            over = event.time + event.dwell
            # What comes before the event before, or after the next one, belongs to another stop.
            first = schedule.trajectory.time[0]
            if place:
                before = schedule.events[own[place - 1]]
                first = before.time + before.dwell
            last = schedule.trajectory.time[-1]
            if place + 1 < len(own):
                last = schedule.events[own[place + 1]].time
            numbers.append(k)
            lines.append(_Line(event, stop, event.time, min(first, event.time)))
            lines.append(_Line(event, stop, over, max(last, over)))
        ends = _line_ends(schedule, model, lines)
        for k, line, start, end in zip(numbers, lines[::2], ends[::2], ends[1::2], strict=True):
            found[k] = LineSpan(line.event, line.stop, start, end)
    return tuple(found[k] for k in sorted(found))


@dataclass(frozen=True)
class _Line:
    """The line of a stop on one side of it in time."""

    event: Event
    stop: Stop
    near: float
    """When the tool is at the target [s]."""
    limit: float
    """Where in time the line's outer end is looked for at most [s]."""

    @property
    def length(self) -> float:
        """As the job asks [m]."""
        return self.stop.approach if self.limit < self.near else self.stop.retract


def _line_ends(schedule: Schedule, model: ToolModel, lines: Sequence[_Line]) -> list[float]:
    """Returns when the tool of one arm is at the outer end of each line, from its target towards the limit [s]."""
    ends = [line.near for line in lines]
    left = [k for k, line in enumerate(lines) if line.length > 0.0 and line.limit != line.near]
    # Most lines are short: few need all instants up to their limit.
    count = FIRST_INSTANTS
    while left:
        longer = []
        for k in range(0, len(left), AT_ONCE):
            some = left[k : k + AT_ONCE]
            found = _ends_among(schedule, model, [lines[number] for number in some], count)
            for number, end in zip(some, found, strict=True):
                if end is None:
                    longer.append(number)
                else:
                    ends[number] = end
        left, count = longer, 4 * count
    return ends


def _ends_among(
    schedule: Schedule, model: ToolModel, lines: Sequence[_Line], count: int
) -> list[float | None]:
    """Returns the outer ends [s]; None for a line that goes on beyond the first `count` instants."""
    near, limit = np.array([(line.near, line.limit) for line in lines]).T
    times, first = dense_spans(
        schedule.trajectory.time, np.minimum(near, limit), np.maximum(near, limit)
    )
    all_instants = [
        times[i:j] if line.limit > line.near else times[i:j][::-1]
        for line, (i, j) in zip(lines, pairwise(first), strict=True)
    ]
    some = [instants[:count] for instants in all_instants]
    depths, on_lines = _on_lines(schedule, model, lines, some)
    found: list[float | None] = []
    for line, every, instants, depth, on_line in zip(
        lines, all_instants, some, depths, on_lines, strict=True
    ):
        off = np.flatnonzero(~on_line | (depth > line.length + TOL.line_distance))
        if not len(off) and len(instants) < len(every):
            found.append(None)
            continue
        on = int(off[0]) if len(off) else len(instants)
        if on == 0:
            found.append(line.near)
            continue
        # Beyond the end that is asked for a transfer may go on the same way.
        outermost = depth[:on] >= min(depth[:on].max(), line.length) - TOL.same_place
        found.append(float(instants[int(np.argmax(outermost))]))
    return found


def _on_lines(
    schedule: Schedule, model: ToolModel, lines: Sequence[_Line], instants: Sequence[FloatArray]
) -> tuple[list[FloatArray], list[BoolArray]]:
    """Returns for each line, at its instants (m,), how far out the tool is [m], and whether it is on it at all."""
    arm, events = lines[0].event.arm, np.array([line.event.time for line in lines])
    line = np.repeat(np.arange(len(lines)), [len(some) for some in instants])
    times = np.concatenate(instants)
    R, p = model.poses(arm, schedule.trajectory.at(times)[0])
    R_event, p_event = model.poses(arm, schedule.trajectory.at(events)[0])
    velocity = np.array([line.stop.velocity for line in lines])
    moved = p - p_event[line] - (times - events[line])[:, None] * velocity[line]
    turn = R_event.transpose(0, 2, 1)[line]
    local = product(turn, moved[:, :, None])[:, :, 0]
    depth = -local[:, 2]
    on_line = (np.hypot(local[:, 0], local[:, 1]) <= TOL.line_distance) & (
        rotation_angle(product(turn, R)) <= TOL.line_angle
    )
    on_line &= depth >= -TOL.line_distance
    ends = np.cumsum([len(some) for some in instants])[:-1]
    return np.split(depth, ends), np.split(on_line, ends)


def spans_of(spans: Sequence[LineSpan], arm: str, task: str, action: str) -> list[LineSpan]:
    """Returns the spans of one stop: one where it is done once."""
    return [s for s in spans if (s.event.arm, s.event.task, s.event.action) == (arm, task, action)]
