"""Number and duration of tool changes."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

from dualarm_cli.kinds.reporting import KindMeasures
from dualarm_cli.model.job import AT_STANDS, Job
from dualarm_cli.model.schedule import Schedule


def tool_change_rows(schedule: Schedule, job: Job) -> dict[str, dict[str, float]]:
    """Returns, by arm that may change tools, how often it does, its visits to stands, and how long that takes [s].

    Visits one right after the other are one change. The time is that of transfers to stands, lines and dwells there;
    what a detour over the stands costs on the way to the next task is not in it.

    Args:
        schedule: with events and segments.
        job: what it was planned for.
    """
    found = {}
    for arm in job.cell.tool_changes:
        events = sorted((e for e in schedule.events if e.arm == arm), key=lambda e: e.time)
        at_stand = [event.action in AT_STANDS for event in events]
        own = [s for s in schedule.segments if s.arm == arm and s.action in AT_STANDS]
        found[arm] = {
            "changes": sum(b and not a for a, b in pairwise([False, *at_stand])),
            "visits": sum(at_stand),
            "time": sum(s.end - s.start for s in own if s.kind != "wait"),
        }
    return found


def tool_change_lines(report: dict[str, Any]) -> list[str]:
    """Returns how often each arm changes tools, in words.

    Args:
        report: as built by `build_report`.
    """
    return [
        f"{name} arm: {use['changes']} tool change{'s' if use['changes'] != 1 else ''}: {use['visits']} visits to "
        f"stands, {use['time']:.2f} s including the motions there"
        for name, use in report["tool_changes"].items()
    ]


MEASURES = KindMeasures("arms", {"tool_changes": tool_change_rows}, tool_change_lines)
