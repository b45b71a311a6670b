"""`dualarm export`: a plan in formats of other programs."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from dualarm_cli.cli.parts.options import (
    COLUMNS,
    ColumnsOption,
    PlanTasksOption,
    ReceiverInterpolation,
)
from dualarm_cli.cli.parts.output import (
    JsonOption,
    QuietOption,
    print_json,
    print_message,
    stdout_console,
)
from dualarm_cli.errors import UsageError
from dualarm_cli.formats import FORMATS
from dualarm_cli.report.printable import numbers

if TYPE_CHECKING:
    from dualarm_cli.formats.sampling import JointLoss

RATE = 100.0
"""Default sampling rate [Hz]."""


if TYPE_CHECKING:
    Format = StrEnum
else:
    Format = StrEnum("Format", list(FORMATS))


class PlatformGroup(StrEnum):
    """Arm whose controller moves the platform."""

    platform = "own"
    both = "both"
    left = "left"
    right = "right"


def export_command(
    plan: Annotated[Path, typer.Argument(help="Folder of a plan, or a schedule file.")],
    to: Annotated[Format, typer.Option("--to", help="Format.")],
    out: Annotated[
        str | None,
        typer.Option(
            "--out",
            help="Folder for the files; default a folder of the format's name in the plan's.",
        ),
    ] = None,
    rate: Annotated[float, typer.Option("--rate", help="Samples per second.")] = RATE,
    columns: ColumnsOption = COLUMNS,
    interpolation: Annotated[
        ReceiverInterpolation,
        typer.Option(
            "--interpolation",
            help="Interpolation of the receiver between points; a JointTrajectory has velocities for cubic, and "
            "accelerations for quintic.",
        ),
    ] = ReceiverInterpolation.cubic,
    platform: Annotated[
        PlatformGroup,
        typer.Option(
            "--platform-with",
            help="Arm whose controller moves the platform; own: a separate controller.",
        ),
    ] = PlatformGroup.platform,
    uniform: Annotated[
        bool,
        typer.Option(
            "--uniform",
            help="No points of a JointTrajectory at the schedule's knots, only at --rate.",
        ),
    ] = False,
    tasks: PlanTasksOption = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite earlier results.")] = False,
    json_output: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Export a plan to other formats, with its loss between samples.

    The formats include ROS 2, Foxglove and NumPy.

    Exit code 1 if the plan fails its verification; the files are written.
    """
    from dualarm_cli.cli.parts.result_files import refuse_folder
    from dualarm_cli.cli.report import tasks_of
    from dualarm_cli.exporting.schedule_reader import read_schedule
    from dualarm_cli.files.tasks.tasks import load_job
    from dualarm_cli.formats.request import check_rate, columns_named
    from dualarm_cli.interface.exporting import EXPORT_REPORT, export

    check_rate(rate, "--rate")
    chosen = columns_named(columns.split(","), "--columns")
    if to.value != "csv" and columns != COLUMNS:
        raise UsageError(f"--columns goes with --to csv; leave it out with --to {to.value}")
    home = plan if plan.is_dir() else plan.parent
    folder = Path(out) if out is not None else home / to.value
    job = None
    if FORMATS[to.value].needs_job or tasks is not None:
        job = load_job(tasks if tasks is not None else tasks_of(read_schedule(plan), plan))
    refuse_folder(str(folder) if out is None else out, (EXPORT_REPORT,), force)
    made = export(
        plan,
        cast("Any", to.value),
        job=job,
        rate=rate,
        interpolation=interpolation.value,
        platform=platform.value,
        columns=chosen,
        uniform=uniform,
    )
    refuse_folder(str(folder), tuple(made.files), force)
    made.write(folder, force=True)
    loss, motion = made.loss, FORMATS[to.value].motion
    if json_output:
        print_json(made.document)
    elif not quiet:
        if loss is not None:
            rows = loss.worst()
            stdout_console().print(_table(rows, loss.interpolation, made.sliding))
            over = [row.joint for row in rows if not row.within_limits]
            # Samples and scenes are not meant for controllers.
            if over and motion == "trajectories":
                knots = uniform and loss.interpolation == "cubic"
                advice = f"raise --rate{', or leave out --uniform' if knots else ''}"
                print_message(
                    f"warning: beyond limits under {loss.interpolation} interpolation: {', '.join(over)}; {advice}"
                )
        print_message(f"written: {folder}: {', '.join((*made.files, EXPORT_REPORT))}")
    if not made.verification.passed:
        failed = ", ".join(check.name for check in made.verification.failures)
        print_message(f"verification: FAILED: {failed}; `dualarm verify` has details")
        raise typer.Exit(1)


def _table(rows: list[JointLoss], kind: str, sliding: frozenset[str]) -> Any:
    from rich.markup import escape
    from rich.table import Table

    title = (
        f"largest deviation from the plan between samples, {kind} interpolation; shares of limits"
    )
    figures = numbers("deviation", "at s", "velocity", "accel.", "jerk")
    table = Table("joint", *figures, "limits", title=title, title_justify="left")
    for row in rows:
        unit = "m" if row.joint in sliding else "rad"
        shares = (row.velocity, row.acceleration, row.jerk)
        table.add_row(
            escape(row.joint),
            f"{row.deviation:.2g} {unit}",
            f"{row.time:.3f}",
            *("–" if share is None else f"{share:.4f}" for share in shares),
            "[green]kept[/]" if row.within_limits else "[bold red]exceeded[/]",
        )
    return table
