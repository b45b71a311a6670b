"""Options that several commands share."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from dualarm_cli.errors import UsageError


class Effort(StrEnum):
    """How hard to try: more time for a smaller gap."""

    quick = "quick"
    normal = "normal"
    thorough = "thorough"


EffortOption = Annotated[
    Effort, typer.Option("--effort", help="How hard to try: more planning time for a faster plan.")
]
SeedOption = Annotated[
    int, typer.Option("--seed", min=0, max=2**32 - 1, help="Seed of all randomness.")
]


def refuse_plot(plot: Path, force: bool) -> None:
    """Raises before any work is done where a figure could not be written anyway.

    Raises:
        UsageError: the name or the folder is wrong, or the file is there already.
        MissingDependencyError: matplotlib is not installed.
    """
    from dualarm_cli.reporting.figures import FIGURE_KINDS, require_matplotlib

    if plot.suffix.lower().lstrip(".") not in FIGURE_KINDS:
        raise UsageError(f"--plot {plot}: must end in .{', .'.join(FIGURE_KINDS)}")
    if not plot.parent.is_dir():
        raise UsageError(f"--plot {plot}: there is no folder {plot.parent}")
    if plot.exists() and not force:
        raise UsageError(f"--plot {plot}: is there already; add --force to replace it")
    require_matplotlib()
