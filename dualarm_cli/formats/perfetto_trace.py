"""Export of the Gantt chart in Chrome's trace event format, for ui.perfetto.dev."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Any

from dualarm_cli.formats.request import ExportRequest
from dualarm_cli.model.schedule import Event, Schedule, Segment

STAGES = "stages"


def files(request: ExportRequest) -> Mapping[str, Iterable[bytes]]:
    """Build a file with tracks of stages and of each arm [µs]."""
    schedule = request.schedule
    tracks = {STAGES: 1} | {arm: k for k, arm in enumerate(schedule.robot.arms, start=2)}
    process = {"name": "process_name", "ph": "M", "pid": 1, "args": {"name": schedule.robot.name}}
    rows = [process]
    for name, track in tracks.items():
        args = {"name": name}
        rows.append({"name": "thread_name", "ph": "M", "pid": 1, "tid": track, "args": args})
        order = {"sort_index": track}
        rows.append({"name": "thread_sort_index", "ph": "M", "pid": 1, "tid": track, "args": order})
    rows += _stages(schedule, tracks)
    rows += [_segment(segment, tracks[segment.arm]) for segment in schedule.segments]
    rows += [_event(event, tracks[event.arm]) for event in schedule.events]
    text = ",\n".join(json.dumps(row, ensure_ascii=False) for row in rows)
    head = '{"displayTimeUnit": "ms", "traceEvents": [\n'
    return {"gantt.json": [f"{head}{text}\n]}}\n".encode("utf-8", "backslashreplace")]}


def _stages(schedule: Schedule, tracks: Mapping[str, int]) -> list[dict[str, Any]]:
    """List the stages of both arms.

    Asynchronous arms' stages overlap; their segments show the same information.
    """
    return [
        _span(
            f"stage {number}",
            (stage.start, stage.end),
            tracks[STAGES],
            {"tasks": ", ".join(stage.tasks), "bottleneck": stage.bottleneck},
        )
        for number, stage in enumerate(schedule.stages, start=1)
        if not stage.arm
    ]


def _segment(segment: Segment, track: int) -> dict[str, Any]:
    about = {"task": segment.task, "action": segment.action, "reason": segment.reason}
    name = " ".join(word for word in (segment.kind, segment.task) if word)
    return _span(name, (segment.start, segment.end), track, about) | {"cat": segment.kind}


def _event(event: Event, track: int) -> dict[str, Any]:
    return {
        "name": f"{event.action} {event.task}",
        "ph": "i",
        "s": "t",
        "ts": _microseconds(event.time),
        "pid": 1,
        "tid": track,
        "args": {
            "task": event.task,
            "action": event.action,
            "dwell_s": event.dwell,
            **({"signal": event.signal} if event.signal else {}),
            **({"width_m": event.width} if event.width else {}),
        },
    }


def _span(
    name: str, times: tuple[float, float], track: int, about: Mapping[str, str]
) -> dict[str, Any]:
    start, end = (_microseconds(time) for time in times)
    return {
        "name": name,
        "ph": "X",
        "ts": start,
        # The difference of rounded ends, so that consecutive spans neither overlap nor leave a gap.
        "dur": round(end - start, 3),
        "pid": 1,
        "tid": track,
        "args": {key: value for key, value in about.items() if value},
    }


def _microseconds(time: float) -> float:
    """Convert a time to µs, rounded to the nanosecond, which is Perfetto's resolution."""
    return round(time * 1e6, 3)
