"""Files written whole or not at all."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path

from dualarm_cli.errors import OutputError


def write_file(path: Path, content: bytes, force: bool) -> None:
    """Writes one file whole or not at all.

    Raises:
        OutputError: it is there already and `force` is not given, or it cannot be written.
    """
    if path.exists() and not force:
        raise OutputError(f"{path}: is there already; add --force to replace it")
    if path.is_dir():
        raise OutputError(f"{path}: is a folder; name a file")
    if path.exists() and not path.is_file():
        # It would be replaced, for all who use it.
        raise OutputError(f"{path}: is not a regular file (a pipe or a device); name a file")
    if not path.parent.is_dir():
        raise OutputError(f"{path}: there is no folder {path.parent}")
    replace_all(path.parent, {path.name: [content]})


def replace_all(folder: Path, files: Mapping[str, Iterable[bytes]]) -> None:
    """Writes all files, each from its parts, beside their places first, then moves each into it, in order."""
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


def _write_beside(folder: Path, name: str, content: Iterable[bytes]) -> Path:
    """Writes content to a new hidden file of the folder and onto the disk."""
    return write_new(folder, f".{name}.", ".part", content)


def write_new(folder: Path, prefix: str, suffix: str, content: Iterable[bytes]) -> Path:
    """Writes content to a new file whose name nothing else has, and onto the disk.

    Args:
        folder: where it is made.
        prefix: what its name begins with.
        suffix: what its name ends with.
        content: parts of what it holds; whoever may read other new files of this process may read it.

    Raises:
        OSError: it cannot be written; nothing is left of it.
    """
    handle, path = tempfile.mkstemp(prefix=prefix, suffix=suffix, dir=folder)
    try:
        with os.fdopen(handle, "wb") as file:
            file.writelines(content)
            file.flush()
            os.fsync(file.fileno())
        umask = os.umask(0)
        os.umask(umask)
        Path(path).chmod(0o666 & ~umask)
    except BaseException:
        with contextlib.suppress(OSError):
            Path(path).unlink()
        raise
    return Path(path)


def _sync_folder(folder: Path) -> None:
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
