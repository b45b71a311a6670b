"""The files that a job is read from, by names that stay the same wherever its folder is."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Mapping
from pathlib import Path

from dualarm_cli.errors import InputError
from dualarm_cli.loading.bundled import robots_folder
from dualarm_cli.loading.text_source import read_bytes

BUNDLED = "bundled:"
"""What the names of files begin with that come with this package."""
GONE = "gone"
"""What stands for the hash of a file that cannot be read."""
MOST_BYTES = 50_000_000
"""Largest file that is hashed [bytes]: the largest mesh that is read."""


def names_of(record: Mapping[str, str], folder: str) -> dict[str, str]:
    """Returns the hashes of files by their names from a folder, sorted.

    Args:
        record: hashes by the paths as they were opened.
        folder: the task file's, absolute.
    """
    return dict(sorted((_name(path, folder), digest) for path, digest in record.items()))


def hashes_now(names: Iterable[str], folder: str, known: dict[str, str]) -> dict[str, str]:
    """Returns the hashes that files have now, sorted by name; GONE for those that cannot be read.

    Args:
        names: as `names_of` gives them.
        folder: the task file's, absolute.
        known: hashes of paths that were looked at already, added to: many jobs share a robot.
    """
    found = {}
    for name in sorted(names):
        path = path_of(name, folder)
        if path not in known:
            known[path] = _hash(path)
        found[name] = known[path]
    return found


def path_of(name: str, folder: str) -> str:
    """Returns the path of a file, not made shorter.

    Args:
        name: as `names_of` gives it.
        folder: the task file's, absolute.
    """
    if name.startswith(BUNDLED):
        return f"{robots_folder()}/{name[len(BUNDLED) :]}"
    # `..` of a linked folder is where the link leads.
    return f"{folder}/{name}"


def _name(path: str, folder: str) -> str:
    if path.startswith(f"{folder}/"):
        return path[len(folder) + 1 :]
    real, bundled = os.path.realpath(path), os.path.realpath(robots_folder())
    if real.startswith(f"{bundled}/"):
        return BUNDLED + real[len(bundled) + 1 :]
    return os.path.relpath(real, os.path.realpath(folder))


def _hash(path: str) -> str:
    try:
        return hashlib.sha256(read_bytes(Path(path), path, MOST_BYTES)).hexdigest()
    except InputError:
        return GONE
