"""Number and duration of tool changes."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

from dualarm_cli.kinds.reporting import KindMeasures
from dualarm_cli.model.job import AT_STANDS, Job
from dualarm_cli.model.schedule import Schedule


def tool_change_rows(schedule: Schedule, job: Job) -> dict[str, dict[str, float]]:
    """Measure each arm's tool changes: number, visits to stands, and time [s].

    Consecutive visits are one change. The time has transfers to stands, lines and dwells there, but not the longer
    transfer to the next task.

    Args:
        schedule: with events and segments.
        job: its job.
    """
    rows = {}
    for arm in job.cell.tool_changes:
        events = sorted((e for e in schedule.events if e.arm == arm), key=lambda e: e.time)
        at_stand = [event.action in AT_STANDS for event in events]
        segments = [s for s in schedule.segments if s.arm == arm and s.action in AT_STANDS]
        rows[arm] = {
            "changes": sum(b and not a for a, b in pairwise([False, *at_stand])),
            "visits": sum(at_stand),
            "time": sum(s.end - s.start for s in segments if s.kind != "wait"),
        }
    return rows


def tool_change_lines(report: dict[str, Any]) -> list[str]:
    """Describe the number and time of each arm's tool changes.

    Args:
        report: as built by `build_report`.
    """
    return [
        f"{name} arm: {use['changes']} tool change{'s' if use['changes'] != 1 else ''}: {use['visits']} visits to "
        f"stands, {use['time']:.2f} s including the motions there"
        for name, use in report["tool_changes"].items()
    ]


MEASURES = KindMeasures("arms", {"tool_changes": tool_change_rows}, tool_change_lines)
