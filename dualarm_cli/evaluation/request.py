"""Request to evaluate a job: plain data for other processes and machines.

It also names the processor class and C library: Ruckig, pinocchio and the solvers take sines and roots from the C
library, whose variants per processor may change a plan's last digits.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping
from dataclasses import asdict, field, fields
from pathlib import Path
from typing import Any

from dualarm_cli.files.source.bundled import bundled_tasks
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class Request:
    """Request to evaluate a job."""

    case: str
    """Task file as given by the user; messages name files relative to it."""
    path: str
    """Absolute path of the task file."""
    platform: str | None = None
    """Requested planning method; None for the robot's default."""
    redundancy: str | None = None
    """Requested redundancy solver, in the form of `plan --redundancy`."""
    timing: str = "ruckig"
    """Timing solver."""
    blend: str = "lines"
    """Blending of corners: lines or none."""
    effort: str = "normal"
    """Planning effort: quick, normal or thorough."""
    seed: int = 0
    """Seed of all randomness."""
    overrides: Mapping[str, Any] = field(default_factory=dict)
    """JSON-ready replacements of file values, by `tasks:`, `cell:` or `robot:` and JSON pointer."""
    draw: int | None = None
    """Number of a draw of what varies, from 1; 0 for the nominal job of draws."""
    draw_seed: int = 0
    """Seed of all draws."""
    above: float | None = None
    """Cycle time above which the answer has the schedule [s]; None for never."""
    page: bool = False
    """Flag to include the data of the plan's page."""

    @classmethod
    def of(cls, tasks: str | Path, case: str | None = None, **chosen: Any) -> Request:
        """Build a request for a task file.

        Args:
            tasks: the file, from the working directory, or the name of a bundled job.
            case: its name in messages; None for its path.
            chosen: the other fields.
        """
        path = tasks if os.path.lexists(tasks) else bundled_tasks().get(str(tasks), tasks)
        return cls(case_name(case or tasks), os.path.abspath(path), **chosen)  # noqa: PTH100

    @property
    def folder(self) -> str:
        """Folder of the task file."""
        return os.path.dirname(self.path)  # noqa: PTH120

    @property
    def file(self) -> str:
        """Name of the task file in its folder."""
        return os.path.basename(self.path)  # noqa: PTH119

    @property
    def settings(self) -> dict[str, Any]:
        """Planning settings, without the job."""
        return {
            name: getattr(self, name)
            for name in ("platform", "redundancy", "timing", "blend", "effort", "seed")
        }

    def as_document(self) -> dict[str, Any]:
        """Convert to JSON-ready data."""
        return asdict(self)

    @classmethod
    def of_document(cls, document: Mapping[str, Any]) -> Request:
        """Restore a request from `as_document`."""
        return cls(**{entry.name: document[entry.name] for entry in fields(cls)})


def case_name(tasks: str | Path) -> str:
    """Name a task file relative to the working directory if inside it.

    The name has forward slashes.
    """
    path = os.path.normpath(tasks)
    if os.path.isabs(path):  # noqa: PTH117
        inside = os.path.relpath(path)
        path = path if Path(inside).parts[0] == os.pardir else inside
    return Path(path).as_posix()


LEVELS = (("x86-64-v4", "avx512f"), ("x86-64-v3", "fma"))
"""Classes of x86-64 processors, each with a flag that lower classes lack."""


def machine() -> str:
    """Describe the processor class and C library, as in "x86-64-v3, glibc 2.36"."""
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
