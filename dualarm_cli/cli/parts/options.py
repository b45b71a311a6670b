"""Options that several commands share."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dualarm_cli.cli.parts.completion import complete_solver
from dualarm_cli.errors import UsageError

if TYPE_CHECKING:
    from dualarm_cli.files.source.quantities import Dimension


class Effort(StrEnum):
    """Search effort: more time for a smaller gap."""

    quick = "quick"
    normal = "normal"
    thorough = "thorough"


class Blend(StrEnum):
    """Places that tools pass without stop."""

    lines = "lines"
    none = "none"


class ReceiverInterpolation(StrEnum):
    """Interpolation of a receiver between samples."""

    linear = "linear"
    cubic = "cubic"
    quintic = "quintic"


EffortOption = Annotated[
    Effort, typer.Option("--effort", help="Search effort: more planning time for a faster plan.")
]
SeedOption = Annotated[int, typer.Option("--seed", min=0, max=2**32 - 1, help="Random seed.")]
PackageDirOption = Annotated[
    list[Path] | None,
    typer.Option("--package-dir", help="Folder of a ROS package, or of several."),
]
XacroArgOption = Annotated[
    list[str] | None,
    typer.Option(
        "--xacro-arg",
        metavar="NAME:=VALUE",
        help="Value of an argument of the xacro file; of a pair also left:NAME:=VALUE.",
    ),
]

SrdfOption = Annotated[
    Path | None, typer.Option("--srdf", help="SRDF: groups, postures and contacts.")
]
JointLimitsOption = Annotated[
    Path | None, typer.Option("--joint-limits", help="MoveIt's joint_limits.yaml.")
]
LeftTipOption = Annotated[
    str,
    typer.Option(
        "--left-tip",
        help="Link that the left arm's tool is bolted to; none if there is no left arm.",
    ),
]
RightTipOption = Annotated[
    str,
    typer.Option(
        "--right-tip",
        help="Link that the right arm's tool is bolted to; none if there is no right arm.",
    ),
]
PlatformJointOption = Annotated[
    list[str] | None, typer.Option("--platform", help="A joint that carries both arms.")
]
ConvexPartsOption = Annotated[
    list[str] | None,
    typer.Option(
        "--convex-parts",
        help="A link whose meshes become several convex parts instead of one hull (extra `coacd`).",
    ),
]

SOLVERS = {
    "method": "sequence, minimum_time, fixed, exact, linearised",
    "redundancy": "arm_angle, numeric",
    "path follower": "arm_angle, virtual_spring, virtual_spring_damped, manipulability, min_acceleration, min_norm",
    "timing": "ruckig|toppra|trapezoid",
}
"""Names of solvers by family, for help without their libraries; tested against the registries."""
PlatformOption = Annotated[
    str | None,
    typer.Option(
        "--platform",
        help=f"Method that chooses the platform angles: {SOLVERS['method']}.",
        show_default="sequence",
        autocompletion=complete_solver("method"),
    ),
]
RedundancyOption = Annotated[
    str | None,
    typer.Option(
        "--redundancy",
        help=f"Redundancy solver of stops: {SOLVERS['redundancy']}; of paths: {SOLVERS['path follower']}.",
        show_default="arm_angle, numeric for arms that are not SRS; for paths the file's",
        autocompletion=complete_solver("redundancy", "path follower"),
    ),
]
TimingOption = Annotated[
    str,
    typer.Option(
        "--timing",
        metavar=SOLVERS["timing"],
        help="Timing solver.",
        autocompletion=complete_solver("timing"),
    ),
]
BlendOption = Annotated[
    Blend,
    typer.Option(
        "--blend",
        help="Places that tools pass without stop: the outer ends of approaches and retracts (lines), or none.",
    ),
]
TimeLimitOption = Annotated[
    str | None,
    typer.Option(
        "--time-limit",
        metavar="DURATION",
        help="Time limit of the search for orders (30, '30 s', '2 min'). The result then depends on the machine.",
        show_default="as long as --effort says",
    ),
]
PlanTasksOption = Annotated[
    Path | None,
    typer.Option(
        "--tasks",
        help="Task file of the plan; default: its original task file, if it is found unchanged.",
    ),
]
ColumnsOption = Annotated[
    str, typer.Option("--columns", help="Columns of each joint in schedule.csv.")
]
COLUMNS = "position,velocity,acceleration"
"""All columns."""


def read_duration(option: str, text: str | None) -> float | None:
    """Read the duration of an option, above 0 [s], or None if not given."""
    from dualarm_cli.files.source.quantities import TIME

    return None if text is None else read_positive(option, text, TIME, "30 or '2 min'")


def read_positive(option: str, text: str, dimension: Dimension, example: str = "") -> float:
    """Read an option's quantity above 0, as `read_quantity` does."""
    value = read_quantity(option, text, dimension, example)
    if value <= 0.0:
        advice = f"; write one such as {example}" if example else ""
        raise UsageError(f"{option} {text}: must be above 0 {dimension.unit}{advice}")
    return value


def read_quantity(option: str, text: str, dimension: Dimension, example: str = "") -> float:
    """Read the quantity that an option gives, in SI units.

    Args:
        option: its name.
        text: what the user wrote.
        dimension: of the quantity.
        example: of what could be written; by default one of the dimension.

    Raises:
        UsageError: it is no such quantity.
    """
    from dualarm_cli.files.source.quantities import QuantityError, parse_quantity

    try:
        return parse_quantity(text, dimension, example)
    except QuantityError as error:
        raise UsageError(f"{option}: {error}") from None


def refuse_plot(plot: Path, force: bool, option: str = "--plot") -> None:
    """Raise before planning if a figure could not be written.

    Args:
        plot: the figure.
        force: whether a file is replaced.
        option: its option.

    Raises:
        UsageError: the name or the folder is wrong, or the file already exists.
        MissingDependencyError: matplotlib is not installed.
    """
    from dualarm_cli.kinds.drawing import FIGURE_KINDS, require_matplotlib

    if plot.suffix.lower().lstrip(".") not in FIGURE_KINDS:
        raise UsageError(f"{option} {plot}: must end in .{', .'.join(FIGURE_KINDS)}")
    if not plot.parent.is_dir():
        raise UsageError(f"{option} {plot}: there is no folder {plot.parent}")
    if plot.exists() and not force:
        raise UsageError(f"{option} {plot}: already exists; add --force to replace it")
    require_matplotlib()
