"""Request: a job and what it is to be planned by; plain data that goes to other processes and machines.

Class of the processor and C library, which may decide a plan's last digits.

Ruckig, pinocchio and the solvers take sines and roots from the C library, which has variants for processors.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping
from dataclasses import asdict, field, fields
from pathlib import Path
from typing import Any

from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class Request:
    """One evaluation that is asked for."""

    case: str
    """The task file as the user names it: all messages name files from there."""
    path: str
    """The task file's absolute path."""
    platform: str | None = None
    """Method that a person asked for; None for the one that serves the robot."""
    redundancy: str | None = None
    """Solver that a person asked for, as `plan --redundancy` names it."""
    timing: str = "ruckig"
    """Timing solver."""
    blend: str = "lines"
    """Where tools do not stop: lines or none."""
    effort: str = "normal"
    """quick, normal or thorough."""
    seed: int = 0
    """Seed of all randomness."""
    overrides: Mapping[str, Any] = field(default_factory=dict)
    """Values in place of those in the files, by `tasks:`, `cell:` or `robot:` and a JSON pointer: JSON-ready."""
    page: bool = False
    """Whether the data of the plan's page are asked for as well."""

    @classmethod
    def of(cls, tasks: str | Path, **chosen: Any) -> Request:
        """Returns a request for a task file.

        Args:
            tasks: the file, from the working directory.
            chosen: the other fields.
        """
        return cls(case_name(tasks), os.path.abspath(tasks), **chosen)  # noqa: PTH100

    @property
    def folder(self) -> str:
        """The folder of the task file."""
        return os.path.dirname(self.path)  # noqa: PTH120

    @property
    def file(self) -> str:
        """The name of the task file in its folder."""
        return os.path.basename(self.path)  # noqa: PTH119

    @property
    def settings(self) -> dict[str, Any]:
        """What it is planned by, without what is planned."""
        return {
            name: getattr(self, name)
            for name in ("platform", "redundancy", "timing", "blend", "effort", "seed")
        }

    def as_document(self) -> dict[str, Any]:
        """Returns it as JSON-ready data."""
        return asdict(self)

    @classmethod
    def of_document(cls, document: Mapping[str, Any]) -> Request:
        """Returns the request that `as_document` wrote down."""
        return cls(**{entry.name: document[entry.name] for entry in fields(cls)})


def case_name(tasks: str | Path) -> str:
    """Returns what a task file is called: from the working directory where it is below it, with forward slashes."""
    path = os.path.normpath(tasks)
    if os.path.isabs(path):  # noqa: PTH117
        inside = os.path.relpath(path)
        path = path if Path(inside).parts[0] == os.pardir else inside
    return Path(path).as_posix()


LEVELS = (("x86-64-v4", "avx512f"), ("x86-64-v3", "fma"))
"""Classes of x86-64 processors, each with a flag that lower ones lack."""


def machine() -> str:
    """Return the processor's class and the C library, as in "x86-64-v3, glibc 2.36"."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    flags = next((set(line.split()) for line in lines if line.startswith("flags")), set())
    level = next((name for name, flag in LEVELS if flag in flags), platform.machine())
    return ", ".join(filter(None, [level, " ".join(platform.libc_ver()).strip()]))


def other_machine(made_on: str) -> str:
    """Describe how a baseline's machine differs from this one; empty if unknown."""
    here = machine()
    if made_on in ("", here):
        return ""
    return f"the baseline was made on {made_on}, this is {here}"
