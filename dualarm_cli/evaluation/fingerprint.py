"""What decides an evaluation, as one hash: files, settings, replaced values, and the programs that plan."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import sys
from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from dualarm_cli import __version__
from dualarm_cli.evaluation.request import Request
from dualarm_cli.loading.projects import Project

LIBRARIES = (
    "numpy",
    "pin",
    "coal",
    "ruckig",
    "scipy",
    "piqp",
    "ortools",
    "casadi",
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
    """Returns what plans here: versions of this package, its libraries and Python, and a hash of its own sources.

    The sources are hashed as well since a version stays the same while somebody works on it.
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
    """Returns a hash of all modules of this package."""
    folder = Path(__file__).resolve().parent.parent
    total = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        total.update(path.relative_to(folder).as_posix().encode() + b"\0")
        total.update(hashlib.sha256(path.read_bytes()).digest())
    return total.hexdigest()


def question(request: Request) -> dict[str, Any]:
    """Returns what is asked, without what the files hold and where they are."""
    document = request.as_document()
    del document["path"]
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
