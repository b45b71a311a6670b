"""`schedule.csv`: the motion sampled for people, spreadsheets and simple controllers."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dualarm_cli.model.schedule import Schedule

SAME_SAMPLE = 1e-9
"""Samples nearer than this to an exact time give way to it [s]."""
BLOCK = 10_000
"""Rows that are written at a time."""
FORMULA = ("=", "+", "-", "@", "\t")
"""First characters that make a spreadsheet run a cell."""


def to_csv(schedule: Schedule, rate: float) -> Iterator[bytes]:
    """Yields the CSV in blocks: time, then position, velocity, acceleration of each joint; rad, s.

    Uniform samples at `rate` and the exact times of all events and of the end. Numbers are written so that
    reading them gives the same double.

    Args:
        schedule: what to sample.
        rate: samples per second [1/s].
    """
    trajectory = schedule.trajectory
    start, end = trajectory.time[0], trajectory.time[-1]
    uniform = start + np.arange(int((end - start) * rate) + 1) / rate
    exact = np.unique([*(event.time for event in schedule.events), end])
    # A sample next to an exact time would differ from it by rounding alone: the exact one stays.
    after = np.clip(np.searchsorted(exact, uniform), 1, len(exact)) - 1
    behind = np.minimum(after + 1, len(exact) - 1)
    apart = np.minimum(np.abs(uniform - exact[after]), np.abs(uniform - exact[behind]))
    time = np.sort(np.concatenate([uniform[apart > SAME_SAMPLE], exact]))
    time = time[(time >= start) & (time <= end)]
    names = [_safe(name) for name in trajectory.joints]
    header = ["time"] + [
        f"{name}_{what}" for name in names for what in ("position", "velocity", "acceleration")
    ]
    yield ",".join(header).encode() + b"\n"
    # In blocks: as Python numbers, a long table would take ten times its size.
    for k in range(0, len(time), BLOCK):
        some = time[k : k + BLOCK]
        rates = np.stack(trajectory.at(some), axis=2).reshape(len(some), -1)
        rows = np.column_stack([some, rates]).tolist()
        yield "".join(",".join(map(repr, row)) + "\n" for row in rows).encode()


def _safe(name: str) -> str:
    """Returns a joint's name that no spreadsheet takes for a formula and no comma splits."""
    text = "".join("_" if c in ',"\r\n' else c for c in name)
    return f"'{text}" if text.startswith(FORMULA) else text
