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
from dualarm_cli.records import dataclass

if TYPE_CHECKING:
    from rich.table import Table

Measure = Callable[[Schedule, Job], Any]
"""Measures a plan; its answer is JSON-ready."""


@dataclass(frozen=True)
class KindMeasures:
    """What one kind of work adds to reports and comparisons."""

    beside: Literal["work", "arms", "waits"]
    """What it stands beside: other work, what the arms do, or what they wait for."""
    rows: Mapping[str, Measure]
    """Its part of the report, by key; empty where a job has none of its work."""
    lines: Callable[[dict[str, Any]], list[str]]
    """The sentences that a report prints of it."""
    compared: Mapping[str, Measure] = field(default_factory=dict)
    """Its part of a comparison's row, a list by key; empty where a job has none of its work."""
    table: Callable[[dict[str, Any]], Any] = lambda section: None
    """The table of it below that of a compared task file; None where that has none of its work."""
    waits: Mapping[str, Callable[[Segment, Schedule, Job], Event | None]] = field(
        default_factory=dict
    )
    """By a wait's reason the event that ends it; None where that is not known."""


def joint_use(
    job: Job, position: FloatArray, velocity: FloatArray, columns: Sequence[int]
) -> dict[str, Any]:
    """Returns the ways of joints [rad or m], the one nearest to its limit, and the one nearest to its speed limit.

    The platform's way is that of its joints that turn, or of all where all of them slide (`platform_slides`).

    Args:
        job: its robot moves.
        position: of all joints [rad or m], shape (k, n).
        velocity: likewise [rad/s or m/s].
        columns: joints whose distance from a limit counts.
    """
    robot, limits = job.cell.robot, job.limits
    travel = np.abs(np.diff(position, axis=0)).sum(axis=0)
    ways = dict(zip(robot.joints, travel.tolist(), strict=True))
    turning = [joint for joint in robot.platform if joint not in robot.sliding]
    room = np.minimum(position - limits.lower, limits.upper - position).min(axis=0)
    nearest = columns[int(np.argmin(room[columns]))]
    share = (np.abs(velocity) / limits.velocity).max(axis=0)
    fastest = int(np.argmax(share))
    return {
        "joint_travel": sum(way for joint, way in ways.items() if joint not in robot.sliding),
        "slide_travel": sum(way for joint, way in ways.items() if joint in robot.sliding),
        "platform_travel": sum(ways[joint] for joint in turning or robot.platform),
        "platform_slides": bool(robot.platform) and not turning,
        "limit_room": float(room[nearest]),
        "limit_joint": limits.joints[nearest],
        "limit_slides": limits.joints[nearest] in robot.sliding,
        "speed_share": float(share[fastest]),
        "speed_joint": limits.joints[fastest],
    }


def least_clearance(schedule: Schedule, stages: Collection[int]) -> float | None:
    """Returns the least clearance that the verifier proved in stages [m]; None where it looked at none."""
    known = schedule.verification.clearances if schedule.verification is not None else ()
    return min((one.clearance for one in known if one.stage in stages), default=None)


def methods_table(
    section: dict[str, Any],
    kind: str,
    texts: Sequence[str],
    numbers: Sequence[str],
    cells: Callable[[dict[str, Any], dict[str, Any]], list[str]],
) -> Table | None:
    """Returns the table of how methods do a task file's work of one kind; None where it has none.

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
    what = f"{kind}s" if len(names) > 1 else f"{kind} {next(iter(names))}"
    table = Table(title=escape(f"{section['tasks']}: {what}"), title_justify="left")
    for name in [*([kind] if len(names) > 1 else []), *texts]:
        table.add_column(name, no_wrap=True)
    for name in (*numbers, "travel °", "room", "speed", "clear mm"):
        table.add_column(name, justify="right", no_wrap=True)
    for row, work in works:
        clear = work["clearance"]
        table.add_row(
            *([escape(work["task"])] if len(names) > 1 else []),
            *cells(row, work),
            f"{math.degrees(work['joint_travel']):.0f}",
            room_words(work),
            f"{work['speed_share']:.0%}",
            "–" if clear is None else f"{clear * 1e3:.1f}",
        )
    return table


def travel_words(work: Mapping[str, Any]) -> str:
    """Returns how far the joints travel in all, from a row with `joint_ways`."""
    slides = work["slide_travel"]
    also = f" and {slides * 1e3:.0f} mm" if slides > 0.0 else ""
    return f"{math.degrees(work['joint_travel']):.0f} deg{also}"


def room_words(work: Mapping[str, Any]) -> str:
    """Returns the least distance of a joint from its limit, from a row that says whether it slides."""
    room = work["limit_room"]
    return f"{room * 1e3:.1f} mm" if work["limit_slides"] else f"{math.degrees(room):.1f} deg"
