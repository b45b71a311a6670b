"""Export formats for other programs, listed in FORMATS."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any, Literal

from dualarm_cli.records import dataclass

if TYPE_CHECKING:
    # The command line lists the formats in its help, and that loads no numpy.
    from dualarm_cli.formats.request import ExportRequest

FormatName = Literal["ros2", "mcap", "csv", "npz", "parquet", "perfetto", "gltf"]


def _always_supported(_: ExportRequest) -> str | None:
    return None


def _without_controllers(request: ExportRequest) -> str | None:
    nameless = [name for name, arm in request.schedule.robot.arms.items() if not arm.joints]
    if not nameless:
        return None
    return (
        f"robot.arms.{nameless[0]}.joints is missing in the schedule; plan again with this version"
    )


@dataclass(frozen=True)
class ExportFormat:
    """Export format, written by `files(request)` of its module, by file name."""

    module: str
    """Module of this folder, imported on use together with its libraries."""
    needs_job: bool = False
    """Flag of formats that show the cell, for which the job is needed."""
    motion: str = ""
    """Contents of motion: trajectories, samples or frames; empty for none."""
    refuses: Callable[[ExportRequest], str | None] = _always_supported
    """Additional check: reason why a request is unsupported, or None."""

    def why_unsupported(self, request: ExportRequest) -> str | None:
        """Explain why a request is unsupported, or return None."""
        from dualarm_cli.model.schedule import too_many_samples

        if self.needs_job and request.job is None:
            return "the format shows the cell; add the task file, in Python `job=load(…)`"
        reason = too_many_samples(request.schedule.duration, request.rate) if self.motion else None
        return reason or self.refuses(request)


FORMATS: Mapping[str, ExportFormat] = {
    "ros2": ExportFormat("ros2_files", motion="trajectories", refuses=_without_controllers),
    "mcap": ExportFormat("mcap_bag", needs_job=True, motion="trajectories"),
    "csv": ExportFormat("tables", motion="samples"),
    "npz": ExportFormat("npz_file", motion="samples"),
    "parquet": ExportFormat("parquet_file", motion="samples"),
    "perfetto": ExportFormat("perfetto_trace"),
    "gltf": ExportFormat("gltf_file", needs_job=True, motion="frames"),
}
"""Export formats by name."""


def export(name: str, request: ExportRequest) -> Mapping[str, Iterable[bytes]]:
    """Build the files of one format, by their names.

    Args:
        name: of the format, one of FORMATS; it supports the request.
        request: what is exported.

    Raises:
        MissingDependencyError: a library of the extra `export` is not installed.
    """
    module: Any = import_module(f"{__name__}.{FORMATS[name].module}")
    files: Mapping[str, Iterable[bytes]] = module.files(request)
    assert files, f"{name} has no files for a request that it supports"
    return files
