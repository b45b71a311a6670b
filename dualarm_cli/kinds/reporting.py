"""Interface of kinds of work to reports and comparisons."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Event, Schedule, Segment
from dualarm_cli.model.verification import nearest as nearest_of
from dualarm_cli.records import dataclass

if TYPE_CHECKING:
    from rich.table import Table

Measure = Callable[[Schedule, Job], Any]
"""Function that measures a plan; its value is JSON-ready."""


@dataclass(frozen=True)
class KindMeasures:
    """Interface of one kind of work to reports and comparisons."""

    report_section: Literal["work", "arms", "waits"]
    """Section of the report after which its lines are printed."""
    rows: Mapping[str, Measure]
    """Measures of the report, by key; empty for jobs without such work."""
    lines: Callable[[dict[str, Any]], list[str]]
    """Sentences of a printed report."""
    compared: Mapping[str, Measure] = field(default_factory=dict)
    """Measures of a comparison's row, by key; empty for jobs without such work."""
    table: Callable[[dict[str, Any]], Any] = lambda section: None
    """Table below that of a compared task file, or None."""
    waits: Mapping[str, Callable[[Segment, Schedule, Job], Event | None]] = field(
        default_factory=dict
    )
    """Event that ends a wait, by its reason; None where unknown."""


def joint_use(
    job: Job, position: FloatArray, velocity: FloatArray, columns: Sequence[int]
) -> dict[str, Any]:
    """Measure the travel of joints, and those nearest to a position and speed limit.

    Travel is in rad or m.

    The platform's travel is that of its revolute joints, or of all where all of them slide (`platform_slides`).

    Args:
        job: its robot moves.
        position: of all joints [rad or m], shape (k, n).
        velocity: likewise [rad/s or m/s].
        columns: joints whose distance from a limit counts.
    """
    robot, limits = job.cell.robot, job.limits
    travel = np.abs(np.diff(position, axis=0)).sum(axis=0)
    joint_travel = dict(zip(robot.joints, travel.tolist(), strict=True))
    turning = [joint for joint in robot.platform if joint not in robot.sliding]
    room = np.minimum(position - limits.lower, limits.upper - position).min(axis=0)
    nearest = columns[int(np.argmin(room[columns]))]
    speed_share = (np.abs(velocity) / limits.velocity).max(axis=0)
    fastest = int(np.argmax(speed_share))
    return {
        "joint_travel": sum(
            distance for joint, distance in joint_travel.items() if joint not in robot.sliding
        ),
        "slide_travel": sum(
            distance for joint, distance in joint_travel.items() if joint in robot.sliding
        ),
        "platform_travel": sum(joint_travel[joint] for joint in turning or robot.platform),
        "platform_slides": bool(robot.platform) and not turning,
        "limit_room": float(room[nearest]),
        "limit_joint": limits.joints[nearest],
        "limit_slides": limits.joints[nearest] in robot.sliding,
        "speed_share": float(speed_share[fastest]),
        "speed_joint": limits.joints[fastest],
    }


def least_clearance(schedule: Schedule, stages: Collection[int]) -> float | None:
    """Return the least proved clearance of stages [m], or None."""
    clearances = schedule.verification.clearances if schedule.verification is not None else ()
    least = nearest_of(c for c in clearances if c.stage in stages)
    return None if least is None else least.clearance


def methods_table(
    section: dict[str, Any],
    kind: str,
    texts: Sequence[str],
    numbers: Sequence[str],
    cells: Callable[[dict[str, Any], dict[str, Any]], list[str]],
) -> Table | None:
    """Build the table of each method's measures of one kind; None without such work.

    Args:
        section: one member of the comparison's `comparisons`.
        kind: path or seam.
        texts: names of its columns of text.
        numbers: names of its columns of numbers, before those of `joint_use` and clearance.
        cells: of all these, for a row of the comparison and one of its works.
    """
    from rich.markup import escape
    from rich.table import Table

    works = [(row, work) for row in section["rows"] for work in row[f"{kind}s"]]
    if not works:
        return None
    names = {work["task"] for _, work in works}
    subject = f"{kind}s" if len(names) > 1 else f"{kind} {next(iter(names))}"
    table = Table(title=escape(f"{section['tasks']}: {subject}"), title_justify="left")
    for name in [*([kind] if len(names) > 1 else []), *texts]:
        table.add_column(name, no_wrap=True)
    for name in (*numbers, "travel °", "room", "speed", "clear mm"):
        table.add_column(name, justify="right", no_wrap=True)
    for row, work in works:
        clearance = work["clearance"]
        table.add_row(
            *([escape(work["task"])] if len(names) > 1 else []),
            *cells(row, work),
            f"{math.degrees(work['joint_travel']):.0f}",
            room_words(work),
            f"{work['speed_share']:.0%}",
            "–" if clearance is None else f"{clearance * 1e3:.1f}",
        )
    return table


def travel_words(work: Mapping[str, Any]) -> str:
    """Format the total travel of joints, from a row of `joint_use`."""
    slides = work["slide_travel"]
    also = f" and {slides * 1e3:.0f} mm" if slides > 0.0 else ""
    return f"{math.degrees(work['joint_travel']):.0f} deg{also}"


def room_words(work: Mapping[str, Any]) -> str:
    """Format the least joint distance from a limit, from a `joint_use` row."""
    room = work["limit_room"]
    return f"{room * 1e3:.1f} mm" if work["limit_slides"] else f"{math.degrees(room):.1f} deg"
