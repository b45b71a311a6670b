"""When tools are on the lines and in the dwells of their stops, measured on the motion itself.

What a tool may touch, when a task begins and when it is over follow from here. A schedule's own list of segments says
the same where it is right; it is checked (`segment_checks`) and never believed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.model.job import Job, Stop
from dualarm_cli.model.schedule import Event, Schedule
from dualarm_cli.verification import tolerances as tol
from dualarm_cli.verification.tool_checks import dense_times
from dualarm_cli.verification.tool_model import ToolModel, rotation_angle


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
            found[k] = LineSpan(
                event,
                stop,
                _line_end(schedule, model, event, stop, (event.time, min(first, event.time))),
                _line_end(schedule, model, event, stop, (over, max(last, over))),
            )
    return tuple(found[k] for k in sorted(found))


def _line_end(
    schedule: Schedule, model: ToolModel, event: Event, stop: Stop, times: tuple[float, float]
) -> float:
    """Returns when a tool is at the outer end of a line, from where it is at the target towards a limit [s]."""
    near, limit = times
    length = stop.approach if limit < near else stop.retract
    if length <= 0.0 or limit == near:
        return near
    instants = dense_times(schedule.trajectory.time, min(times), max(times))
    instants = instants[::-1] if limit < near else instants
    depth, on_line = _on_line(schedule, model, event, stop, instants)
    left = np.flatnonzero(~on_line | (depth > length + tol.LINE_DISTANCE))
    count = int(left[0]) if len(left) else len(instants)
    if count == 0:
        return near
    # Beyond the end that is asked for a transfer may go on the same way.
    outermost = depth[:count] >= min(depth[:count].max(), length) - tol.SAME_PLACE
    return float(instants[int(np.argmax(outermost))])


def _on_line(
    schedule: Schedule, model: ToolModel, event: Event, stop: Stop, times: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Returns how far out a tool is along its line (m,) [m], and whether it is on it at all (m,)."""
    R, p = model.poses(event.arm, schedule.trajectory.at(np.append(event.time, times))[0])
    moved = p[1:] - p[0] - (times - event.time)[:, None] * np.array(stop.velocity)
    local = moved @ R[0]
    turned = rotation_angle(R[0].T @ R[1:])
    beside = np.hypot(local[:, 0], local[:, 1])
    depth = -local[:, 2]
    on_line: BoolArray = (beside <= tol.LINE_DISTANCE) & (turned <= tol.LINE_ANGLE)
    return depth, on_line & (depth >= -tol.LINE_DISTANCE)


def spans_of(spans: Sequence[LineSpan], arm: str, task: str, action: str) -> list[LineSpan]:
    """Returns the spans of one stop: one where it is done once."""
    return [s for s in spans if (s.event.arm, s.event.task, s.event.action) == (arm, task, action)]
