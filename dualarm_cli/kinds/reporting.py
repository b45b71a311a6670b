"""What a kind of work adds to reports and comparisons."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Event, Schedule, Segment

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
