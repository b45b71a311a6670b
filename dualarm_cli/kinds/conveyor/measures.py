"""Measures of meetings on conveyors: travel of parts, and waits for them."""

from __future__ import annotations

from typing import Any

from dualarm_cli.kinds.reporting import KindMeasures
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.verification.as_done import job_as_done

DONE = {"pick": "picked", "place": "placed"}


def conveyor_rows(schedule: Schedule, job: Job) -> list[dict[str, Any]]:
    """List the picks and places on conveyors as JSON-ready rows [SI units].

    They are in time order.

    `gone` is the part's travel from the pose of the file when the tool reached it, `within` the largest allowed travel,
    `waited` the arm's wait for the part.

    Args:
        schedule: with events and segments.
        job: its job.
    """
    stops = job_as_done(schedule, job).stops_by_key()
    rows = []
    for event in sorted(schedule.events, key=lambda e: (e.time, e.arm)):
        stop = stops.get((event.arm, event.task, event.action))
        if stop is None or stop.belt is None:
            continue
        waited = sum(
            part.end - part.start
            for part in schedule.segments
            if part.kind == "wait"
            and part.reason == "conveyor"
            and (part.arm, part.task, part.action) == (event.arm, event.task, event.action)
        )
        rows.append(
            {
                "arm": event.arm,
                "task": event.task,
                "action": event.action,
                "conveyor": stop.belt.conveyor.name,
                "speed": stop.belt.conveyor.speed,
                "time": event.time,
                "passes": stop.belt.passes,
                "gone": stop.belt.gone(event.time),
                "within": stop.belt.within,
                "waited": float(waited),
            }
        )
    return rows


def conveyor_lines(report: dict[str, Any]) -> list[str]:
    """Write a sentence for every pick and place on a conveyor of a report.

    Args:
        report: as built by `build_report`.
    """
    return [
        f"conveyor {row['conveyor']}: {row['task']} {DONE[row['action']]} by the "
        f"{row['arm']} arm at {row['time']:.3f} s, {round(row['gone'] * 1e3)} mm on of {row['within'] * 1e3:.0f} mm"
        + (f"; waited {row['waited']:.2f} s for it" if row["waited"] >= 5e-3 else "")
        for row in report["conveyors"]
    ]


MEASURES = KindMeasures("work", {"conveyors": conveyor_rows}, conveyor_lines)
