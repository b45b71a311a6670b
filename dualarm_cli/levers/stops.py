"""Stops of sliders: parts of a lever, each with an estimate of its own.

Between two estimates nothing is known, so that a slider has stops instead of a range.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dualarm_cli.errors import DualArmError
from dualarm_cli.files.source.amounts import in_unit, read_amount
from dualarm_cli.files.source.yaml_source import Document
from dualarm_cli.levers.changes import Lever, changed_by, documents_of, value_of
from dualarm_cli.levers.estimates import Estimate, lengths_under
from dualarm_cli.levers.kept_plan import KeptPlan
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.model.studies.study import Amount, Span
from dualarm_cli.records import dataclass
from dualarm_cli.report.critical_path import retimed


@dataclass(frozen=True)
class StopSettings:
    """Stops of sliders."""

    shares: tuple[float, ...] = (0.25, 0.5, 0.75)
    """Shares of a change between nothing and all of it."""
    two_directions: tuple[float, ...] = (-1.0, -0.5, 0.5)
    """Shares of a displacement; negative ones go in the other direction."""
    sliders: int = 8
    """Number of levers that have stops, largest estimates first."""


STOPS = StopSettings()


@dataclass(frozen=True)
class PartialLever:
    """Part of a lever with its estimate."""

    share: float
    """Share of the lever's change."""
    lever: Lever
    """The partial lever."""
    gain: float
    """Estimated gain [s]."""


def estimated_stops(
    schedule: Schedule, job: Job, tasks: Path, estimates: Sequence[Estimate]
) -> dict[str, list[PartialLever]]:
    """Estimate parts of the levers with the largest estimates, without those of the robot.

    Args:
        schedule: the plan.
        job: its job.
        tasks: its task file.
        estimates: of all levers, largest first.

    Returns:
        Stops in order of their shares, by name and change of the lever.
    """
    kept, documents = KeptPlan(schedule, job), documents_of(tasks)
    gaining = [
        e
        for e in estimates
        if (e.gain or 0.0) > 0.0 and e.lever.kind != "robot" and e.lever.is_number
    ]
    stops: dict[str, list[PartialLever]] = {}
    for estimate in gaining[: STOPS.sliders]:
        lever = estimate.lever
        shares = STOPS.two_directions if lever.kind == "layout" else STOPS.shares
        rows = []
        for share in shares:
            try:
                fewer = part(lever, documents, share)
                lengths = lengths_under(kept, fewer, tasks)
            except DualArmError:
                continue
            if not isinstance(lengths, str):
                rows.append((share, fewer, lengths))
        if not rows:
            continue
        times = retimed(schedule, kept.pieces, np.array([lengths for *_, lengths in rows]))
        partial = [
            PartialLever(share, fewer, schedule.duration - float(time))
            for (share, fewer, _), time in zip(rows, times, strict=True)
        ]
        stops[str(lever)] = [*partial, PartialLever(1.0, lever, estimate.gain or 0.0)]
    return stops


def part(lever: Lever, documents: Mapping[str, Document], share: float) -> Lever:
    """Build a part of a lever, between the values of the files and its own.

    Args:
        lever: a change of numbers.
        documents: files of the job by role.
        share: of the change, from -1 to 1.
    """
    if share == 1.0:
        return lever
    values: dict[str, Any] = {}
    pairs = []
    for key, new in lever.values.items():
        old = value_of(documents, key)
        if isinstance(new, list):
            old = [0] * len(new) if old is None else old
            values[key] = [_between(a, b, share)[1].written for a, b in zip(old, new, strict=True)]
        else:
            start, value = _between(0 if old is None else old, new, share)
            values[key] = value.written
            pairs.append((key.rpartition("/")[2], start, value))
    if lever.kind == "layout":
        step = read_amount(lever.change.lstrip("+"))
        change = f"{step.number * share:+g} {step.unit}"
    else:
        change = changed_by(pairs)
    return replace(lever, change=change, values=values)


def _between(old: Any, new: Any, share: float) -> tuple[Amount, Amount]:
    """Interpolate two numbers of a file; return the old one and the result, in one unit."""
    end = read_amount(new)
    start = in_unit(read_amount(old), end)
    return start, Span(start, end).at(share)
