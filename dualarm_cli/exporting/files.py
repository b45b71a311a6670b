"""Files written whole or not at all."""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path

from dualarm_cli.errors import OutputError
from dualarm_cli.exporting.schedule_csv import to_csv
from dualarm_cli.exporting.schedule_json import to_json
from dualarm_cli.model.schedule import Schedule

SCHEDULE, TABLE, URDF = "schedule.json", "schedule.csv", "robot.urdf"


def check_writable(folder: Path, force: bool) -> None:
    """Refuses early where `write_schedule_set` could not write in the end.

    Raises:
        OutputError: the folder cannot be made or holds results already, with what to do.
    """
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"--out {folder}: is a file; name a folder")
    if not force:
        _refuse_existing(folder, (SCHEDULE, TABLE, URDF))
    parent = folder
    while not parent.exists():
        parent = parent.parent
    if not parent.is_dir():
        raise OutputError(f"--out {folder}: {parent} is a file, not a folder")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise OutputError(f"--out {folder}: no permission to write in {parent}")


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
        force: whether a schedule that is there already is replaced.

    Raises:
        OutputError: nothing could be written, or not everything; what was there is whole.
    """
    check_writable(folder, force)
    if not force:
        _refuse_existing(folder, others)
    files = {URDF: schedule.robot.urdf.encode(), TABLE: to_csv(schedule, rate), **others}
    hashes = {name: hashlib.sha256(content).hexdigest() for name, content in sorted(files.items())}
    files[SCHEDULE] = to_json(schedule, URDF, hashes)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"--out {folder}: cannot be made: {error.strerror}") from None
    _replace_all(folder, files)


def _refuse_existing(folder: Path, names: Iterable[str]) -> None:
    """Raises OutputError where a folder has one of the files: it may be somebody's own."""
    for name in names:
        if (folder / name).exists():
            what = "a schedule" if name == SCHEDULE else f"a file {name}"
            raise OutputError(
                f"--out {folder}: already holds {what}; add --force to replace it, or name another"
            )


def write_file(path: Path, content: bytes, force: bool) -> None:
    """Writes one file whole or not at all.

    Raises:
        OutputError: it is there already and `force` is not given, or it cannot be written.
    """
    if path.exists() and not force:
        raise OutputError(f"{path}: is there already; add --force to replace it")
    if path.is_dir():
        raise OutputError(f"{path}: is a folder; name a file")
    if not path.parent.is_dir():
        raise OutputError(f"{path}: there is no folder {path.parent}")
    _replace_all(path.parent, {path.name: content})


def _replace_all(folder: Path, files: Mapping[str, bytes]) -> None:
    """Writes all files beside their places first, then moves each into it, in order."""
    written: list[tuple[Path, Path]] = []
    try:
        for name, content in files.items():
            written.append((_write_beside(folder, name, content), folder / name))
        for temporary, place in written:
            temporary.replace(place)
        _sync_folder(folder)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written: {error.strerror}") from None
    finally:
        for temporary, _ in written:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)


def _write_beside(folder: Path, name: str, content: bytes) -> Path:
    """Writes content to a new hidden file of the folder and onto the disk."""
    handle, path = tempfile.mkstemp(prefix=f".{name}.", suffix=".part", dir=folder)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        umask = os.umask(0)
        os.umask(umask)
        Path(path).chmod(0o666 & ~umask)
    except BaseException:
        Path(path).unlink(missing_ok=True)
        raise
    return Path(path)


def _sync_folder(folder: Path) -> None:
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
