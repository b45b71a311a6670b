"""Hash of everything that decides an evaluation: files, settings, replaced values, programs."""

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
"""Packages that decide results."""


def canonical(document: Any) -> str:
    """Returns a JSON document as text that is the same for the same data; refuses NaN."""
    return json.dumps(
        document, sort_keys=True, separators=(",", ":"), allow_nan=False, ensure_ascii=True
    )


def digest(document: Any) -> str:
    """Returns the SHA-256 of a JSON document."""
    return hashlib.sha256(canonical(document).encode()).hexdigest()


@cache
def programs() -> Mapping[str, str]:
    """Returns what plans here: versions of this package, its libraries and Python, and a hash of its own code.

    The code is hashed as well since a version stays the same while somebody works on it.
    """
    found = {
        "dualarm": __version__,
        "sources": _sources(),
        "python": f"{sys.version_info.major}.{sys.version_info.minor}",
        "machine": platform.machine(),
    }
    for name in LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "none"
    return found


def _sources() -> str:
    """Compute a hash of this package's modules and compiled library."""
    folder = Path(__file__).resolve().parent.parent
    total = hashlib.sha256()
    for path in sorted([*folder.rglob("*.py"), *(folder / "compiled" / "built").glob("*.so")]):
        total.update(path.relative_to(folder).as_posix().encode() + b"\0")
        total.update(hashlib.sha256(path.read_bytes()).digest())
    return total.hexdigest()


def question(request: Request) -> dict[str, Any]:
    """Returns what is asked, without what the files hold and where they are; figures do not depend on the page."""
    document = request.as_document()
    del document["path"], document["page"]
    return document


def answer_key(request: Request, inputs: Mapping[str, str]) -> str:
    """Returns the key of a request's answer: the same if nothing differs that decides it.

    A job is read from its task file on, and each file says which ones follow. So where all the files that were read
    once still hold the same, the same ones would be read again.

    Args:
        request: what is asked.
        inputs: hashes of the files that it is read from, by their names.
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
    """Returns the project folder from a task file's: paths may not lead out of it."""
    real = os.path.realpath(folder)
    return os.path.relpath(Project.of(Path(real) / "tasks.yaml").folder, real)
