"""Atomic file writes: each file is written completely or not changed."""

from __future__ import annotations

import contextlib
import os
import stat
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import BinaryIO

from dualarm_cli.errors import OutputError
from dualarm_cli.system import lock

_PART = ".part"
_FRESH = 1.0
"""Maximum time between the creation of a temporary file and its lock [s]."""


def write_file(path: Path, content: bytes, force: bool) -> None:
    """Write one file atomically.

    Raises:
        OutputError: it already exists and `force` is not given, or it cannot be written.
    """
    if path.exists() and not force:
        raise OutputError(f"{path}: already exists; add --force to replace it")
    if path.is_dir():
        raise OutputError(f"{path}: is a folder; name a file")
    if path.exists() and not path.is_file():
        # The write would replace the pipe or device for every user.
        raise OutputError(f"{path}: is not a regular file (a pipe or a device); name a file")
    if not path.parent.is_dir():
        raise OutputError(f"{path}: there is no folder {path.parent}")
    # A named file may be a symbolic link: its target is replaced.
    place = Path(os.path.realpath(path))
    replace_all(place.parent, {place.name: [content]})


def place_in(folder: Path, name: str) -> Path:
    """Resolve the real path of a folder's file; symbolic links are followed.

    Raises:
        OutputError: it is outside the folder.
    """
    place = Path(os.path.realpath(folder / name))
    if not place.is_relative_to(os.path.realpath(folder)):
        raise OutputError(
            f"{folder}: {name} leads out of the folder; remove the symbolic link, or name another folder"
        )
    return place


def replace_all(folder: Path, files: Mapping[str, Iterable[bytes]]) -> None:
    """Write the files of a folder, each atomically.

    Each is first written to a temporary file in the same folder; then all are moved, in order. The target of a symbolic
    link within the folder is replaced, not the link. An existing file keeps its permissions.

    Args:
        folder: where to; made if need be.
        files: contents in parts, by names that may have folders in them.

    Raises:
        OutputError: a name leads out of the folder, or nothing could be written, or not everything.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        places = [place_in(folder, name) for name in files]
        for place in places:
            place.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be made: {error.strerror}") from None
    with contextlib.ExitStack() as written:
        try:
            moves = []
            for place, content in zip(places, files.values(), strict=True):
                _remove_abandoned(place)
                moves.append((written.enter_context(_temporary_file(place, content)), place))
            for temporary, place in moves:
                temporary.replace(place)
            for parent in dict.fromkeys(place.parent for _, place in moves):
                _sync_folder(parent)
        except OSError as error:
            raise OutputError(f"{folder}: cannot be written: {error.strerror}") from None


@contextlib.contextmanager
def _temporary_file(place: Path, content: Iterable[bytes]) -> Iterator[Path]:
    """Write a locked temporary file next to a place; remove it at the end."""
    handle, name = tempfile.mkstemp(prefix=f".{place.name}.", suffix=_PART, dir=place.parent)
    with os.fdopen(handle, "wb") as file:
        try:
            with contextlib.suppress(OSError):  # not every file system has locks
                lock(handle)
            _fill(file, content, _mode_of(place))
            yield Path(name)
        finally:
            with contextlib.suppress(OSError):
                Path(name).unlink(missing_ok=True)


def _remove_abandoned(place: Path) -> None:
    """Remove unlocked temporary files, which killed processes have left."""
    beginning = f".{place.name}."
    for path in place.parent.iterdir():
        if not (path.name.startswith(beginning) and path.name.endswith(_PART)):
            continue
        if path.is_symlink() or not path.is_file():
            continue  # not a temporary file of ours; opening a pipe would block
        with contextlib.suppress(OSError), path.open("rb") as file:
            lock(file.fileno())
            # A file just created may not be locked yet.
            if time.time() - os.fstat(file.fileno()).st_mtime > _FRESH:
                path.unlink()


def write_new(folder: Path, content: Iterable[bytes]) -> Path:
    """Write content to a new file with a unique name, flushed to the disk.

    Args:
        folder: where it is made.
        content: parts of the file, which gets the permissions of any new file of this process.

    Raises:
        OSError: it cannot be written; nothing is left of it.
    """
    handle, path = tempfile.mkstemp(prefix="", dir=folder)
    try:
        with os.fdopen(handle, "wb") as file:
            _fill(file, content, _new_mode())
    except BaseException:
        with contextlib.suppress(OSError):
            Path(path).unlink()
        raise
    return Path(path)


def _fill(file: BinaryIO, content: Iterable[bytes], mode: int) -> None:
    file.writelines(content)
    file.flush()
    os.fchmod(file.fileno(), mode)
    os.fsync(file.fileno())


def _mode_of(place: Path) -> int:
    """Return the permissions of an existing file, or the default ones."""
    with contextlib.suppress(FileNotFoundError):
        return stat.S_IMODE(place.stat().st_mode)
    return _new_mode()


def _new_mode() -> int:
    umask = os.umask(0)
    os.umask(umask)
    return 0o666 & ~umask


def _sync_folder(folder: Path) -> None:
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
