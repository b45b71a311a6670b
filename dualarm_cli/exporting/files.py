"""A schedule's files, written as one set."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np

from dualarm_cli.errors import OutputError
from dualarm_cli.exporting.schedule_json import to_json
from dualarm_cli.exporting.whole_files import replace_all
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


SCHEDULE, TABLE, URDF = "schedule.json", "schedule.csv", "robot.urdf"


def check_writable(folder: Path, force: bool, option: str = "--out") -> None:
    """Refuses early where `write_schedule_set` could not write in the end.

    Args:
        folder: where to.
        force: whether a schedule that already exists may be replaced.
        option: that names the folder.

    Raises:
        OutputError: the folder cannot be made or holds results already, with what to do.
    """
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"{option} {folder}: is a file; name a folder")
    if not force:
        _refuse_existing(folder, (SCHEDULE, TABLE, URDF))
    parent = folder
    while not parent.exists():
        parent = parent.parent
    if not parent.is_dir():
        raise OutputError(f"{option} {folder}: {parent} is a file, not a folder")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise OutputError(f"{option} {folder}: no permission to write in {parent}")


def write_schedule_set(
    folder: Path, schedule: Schedule, others: Mapping[str, bytes], rate: float, force: bool
) -> None:
    """Writes a schedule with its CSV, its URDF and other files; schedule.json comes last.

    schedule.json carries the SHA-256 of the others, so that a set torn apart is noticed.

    Args:
        folder: where to; made if need be.
        schedule: what to write.
        others: further files by name.
        rate: samples per second of the CSV [1/s].
        force: whether a schedule that already exists is replaced.

    Raises:
        OutputError: nothing could be written, or not everything; what was there is whole.
    """
    check_writable(folder, force)
    given = {URDF: [schedule.robot.urdf.encode()], TABLE: to_csv(schedule, rate)}
    given |= {name: [content] for name, content in others.items()}
    if not force:
        _refuse_existing(folder, given)
    # Known once the files are written, which is before schedule.json asks for them.
    hashes = dict.fromkeys(sorted(given), "")
    files = {name: _hashed(name, content, hashes) for name, content in given.items()}
    files[SCHEDULE] = to_json(schedule, URDF, hashes)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"--out {folder}: cannot be made: {error.strerror}") from None
    replace_all(folder, files)


def _hashed(name: str, content: Iterable[bytes], hashes: dict[str, str]) -> Iterator[bytes]:
    """Yields a file's parts, and puts its SHA-256 down after the last one."""
    digest = hashlib.sha256()
    for part in content:
        digest.update(part)
        yield part
    hashes[name] = digest.hexdigest()


def _refuse_existing(folder: Path, names: Iterable[str]) -> None:
    """Raises OutputError where a folder has one of the files: it may be somebody's own."""
    for name in names:
        if (folder / name).exists():
            what = "a schedule" if name == SCHEDULE else f"a file {name}"
            raise OutputError(
                f"--out {folder}: already holds {what}; add --force to replace it, or name another"
            )
