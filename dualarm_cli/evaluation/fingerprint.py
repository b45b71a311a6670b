"""Hash of everything that determines an evaluation: files, settings, replaced values, programs."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import sys
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from dualarm_cli import __version__
from dualarm_cli.errors import InputError
from dualarm_cli.evaluation.request import Request
from dualarm_cli.files.source.bundled import robots_folder
from dualarm_cli.files.source.projects import Project
from dualarm_cli.files.source.text_source import read_bytes

BUNDLED = "bundled:"
"""Name prefix of files bundled with this package."""
GONE = "gone"
"""Placeholder for the hash of an unreadable file."""
MOST_BYTES = 50_000_000
"""Maximum size of a hashed file [B], as for meshes."""


def names_of(record: Mapping[str, str], folder: str) -> dict[str, str]:
    """Name files relative to a folder, and sort their hashes by name.

    Args:
        record: hashes by the paths as opened.
        folder: the task file's, absolute.
    """
    return dict(sorted((_name(path, folder), digest) for path, digest in record.items()))


def hashes_now(names: Iterable[str], folder: str, path_hashes: dict[str, str]) -> dict[str, str]:
    """Hash the present files, sorted by name; GONE for unreadable ones.

    Args:
        names: in the form of `names_of`.
        folder: the task file's, absolute.
        path_hashes: hashes by path, extended; many jobs share a robot.
    """
    hashes = {}
    for name in sorted(names):
        path = path_of(name, folder)
        if path not in path_hashes:
            path_hashes[path] = _hash(path)
        hashes[name] = path_hashes[path]
    return hashes


def path_of(name: str, folder: str) -> str:
    """Return the path of a file, not resolved.

    Args:
        name: in the form of `names_of`.
        folder: the task file's, absolute.
    """
    if name.startswith(BUNDLED):
        return f"{robots_folder()}/{name[len(BUNDLED) :]}"
    # `..` in a linked folder leads to the parent of the link's target.
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


LIBRARIES = (
    "numpy",
    "pin",
    "coal",
    "ruckig",
    "scipy",
    "piqp",
    "ortools",
    "toppra",
    "pydantic",
    "PyYAML",
)
"""Packages that affect results."""


def canonical(document: Any) -> str:
    """Encode JSON-ready data as text, equal for equal data; NaN is refused."""
    return json.dumps(
        document, sort_keys=True, separators=(",", ":"), allow_nan=False, ensure_ascii=True
    )


def digest(document: Any) -> str:
    """Compute the SHA-256 of a JSON document."""
    return hashlib.sha256(canonical(document).encode()).hexdigest()


@cache
def programs() -> Mapping[str, str]:
    """List versions of package, libraries and Python, and a hash of the code.

    The hash is of this package's code.

    The code is hashed because a version stays the same during development.
    """
    versions = {
        "dualarm": __version__,
        "sources": _sources(),
        "python": f"{sys.version_info.major}.{sys.version_info.minor}",
        "machine": platform.machine(),
    }
    for name in LIBRARIES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "none"
    return versions


def _sources() -> str:
    """Compute a hash of this package's modules and compiled library."""
    folder = Path(__file__).resolve().parent.parent
    total = hashlib.sha256()
    for path in sorted([*folder.rglob("*.py"), *(folder / "compiled" / "built").glob("*.so")]):
        total.update(path.relative_to(folder).as_posix().encode() + b"\0")
        total.update(hashlib.sha256(path.read_bytes()).digest())
    return total.hexdigest()


def question(request: Request) -> dict[str, Any]:
    """Return the request without its path and without extra contents of the answer."""
    document = request.as_document()
    del document["path"], document["page"], document["above"]
    return document


def answer_key(request: Request, inputs: Mapping[str, str]) -> str:
    """Compute the key of a request's answer from everything that determines it.

    A job is read from its task file on, and each file names those that follow. So if all files read before are
    unchanged, the same files would be read again.

    Args:
        request: the request.
        inputs: hashes of its files by name.
    """
    return digest(
        {
            "question": question(request),
            "inputs": dict(inputs),
            "programs": dict(programs()),
            "project": _project(request.folder),
        }
    )


@cache
def _project(folder: str) -> str:
    """Return the project folder relative to a task file's; paths must stay inside it."""
    real = os.path.realpath(folder)
    return os.path.relpath(Project.of(Path(real) / "tasks.yaml").folder, real)
