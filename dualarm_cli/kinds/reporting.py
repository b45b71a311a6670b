"""What a kind of work adds to reports and comparisons."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import field
from typing import Any, Literal

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.job import Job
from dualarm_cli.model.robot import Robot
from dualarm_cli.model.schedule import Event, Schedule, Segment
from dualarm_cli.records import dataclass

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


def joint_ways(robot: Robot, travel: FloatArray) -> dict[str, float | bool]:
    """Returns the ways of all joints that turn [rad], of those that slide [m], and of the platform [rad or m].

    The platform's is that of its joints that turn, or of all where all of them slide (`platform_slides`).

    Args:
        robot: whose joints they are.
        travel: of every joint [rad or m], shape (n,).
    """
    ways = dict(zip(robot.joints, travel.tolist(), strict=True))
    turning = [joint for joint in robot.platform if joint not in robot.sliding]
    return {
        "joint_travel": sum(way for joint, way in ways.items() if joint not in robot.sliding),
        "slide_travel": sum(way for joint, way in ways.items() if joint in robot.sliding),
        "platform_travel": sum(ways[joint] for joint in turning or robot.platform),
        "platform_slides": bool(robot.platform) and not turning,
    }


def travel_words(work: Mapping[str, Any]) -> str:
    """Returns how far the joints travel in all, from a row with `joint_ways`."""
    slides = work["slide_travel"]
    also = f" and {slides * 1e3:.0f} mm" if slides > 0.0 else ""
    return f"{math.degrees(work['joint_travel']):.0f} deg{also}"


def room_words(work: Mapping[str, Any]) -> str:
    """Returns the least distance of a joint from its limit, from a row that says whether it slides."""
    room = work["limit_room"]
    return f"{room * 1e3:.1f} mm" if work["limit_slides"] else f"{math.degrees(room):.1f} deg"
