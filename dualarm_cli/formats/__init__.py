"""The schedule in formats that other programs read; FORMATS lists them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from importlib import import_module
from typing import Any

from dualarm_cli.formats.request import ExportRequest
from dualarm_cli.formats.sampling import JointLoss, losses
from dualarm_cli.geometry.interpolation import Interpolation
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class ExportFormat:
    """A format, written by the module of its name here: `files(request)` returns contents by file name."""

    module: str
    """Of this folder; imported when it is asked for, with the libraries that it needs."""
    needs_job: bool = False
    """Whether it shows the cell, which the schedule alone does not know."""
    motion: str = ""
    """What it holds of the motion: trajectories, samples or frames; empty for none."""


FORMATS: Mapping[str, ExportFormat] = {
    "ros2": ExportFormat("ros2_files", motion="trajectories"),
    "mcap": ExportFormat("mcap_bag", needs_job=True, motion="trajectories"),
    "csv": ExportFormat("tables", motion="samples"),
    "npz": ExportFormat("npz_file", motion="samples"),
    "parquet": ExportFormat("parquet_file", motion="samples"),
    "perfetto": ExportFormat("perfetto_trace"),
    "gltf": ExportFormat("gltf_file", needs_job=True, motion="frames"),
}
"""By name."""


def export(name: str, request: ExportRequest) -> Mapping[str, Iterable[bytes]]:
    """Returns the files of one format, by their names.

    Args:
        name: of the format, one of FORMATS.
        request: what is exported.

    Raises:
        MissingDependencyError: a library of the extra `export` is not installed.
    """
    found = FORMATS[name]
    assert request.job is not None or not found.needs_job
    module: Any = import_module(f"{__name__}.{found.module}")
    return module.files(request)


@dataclass(frozen=True)
class ExportLoss:
    """What is lost between samples under one interpolation."""

    interpolation: Interpolation
    """The receiver's."""
    samples: Mapping[str, int]
    """How many there are, by the controller's group; of all joints together under `all`."""
    joints: Mapping[str, Sequence[JointLoss]]
    """What each joint loses, by the same names."""

    def worst(self) -> list[JointLoss]:
        """Returns each joint once, as the group has it that exceeds limits or else deviates most."""
        found: dict[str, JointLoss] = {}
        for row in (row for rows in self.joints.values() for row in rows):
            other = found.setdefault(row.joint, row)
            if (not row.within_limits, row.deviation) > (not other.within_limits, other.deviation):
                found[row.joint] = row
        return list(found.values())


def lost(name: str, request: ExportRequest) -> ExportLoss | None:
    """Returns what a format loses between its samples; None of one that holds no motion.

    Args:
        name: of the format.
        request: what is exported.
    """
    motion = FORMATS[name].motion
    if not motion:
        return None
    # Viewers turn and shift frames linearly between samples.
    kind: Interpolation = "linear" if motion == "frames" else request.interpolation
    samples = {"all": request.samples()}
    if motion == "trajectories":
        samples = {group: request.points(joints) for group, joints in request.groups().items()}
    return ExportLoss(
        kind,
        {group: len(own.nanoseconds) for group, own in samples.items()},
        {group: losses(request.schedule, own, kind) for group, own in samples.items()},
    )


__all__ = ["FORMATS", "ExportFormat", "ExportLoss", "ExportRequest", "export", "lost"]
