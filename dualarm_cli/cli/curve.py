"""`dualarm curve`: points of curves for a controller, and their quality.

The curves are those of coordinate tasks.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dualarm_cli.cli.parts.completion import complete_job
from dualarm_cli.cli.parts.options import read_positive, refuse_plot
from dualarm_cli.cli.parts.output import (
    STDOUT,
    JsonOption,
    QuietOption,
    print_json,
    print_message,
    refuse_two_documents,
    text_console,
    write_out,
)
from dualarm_cli.errors import UsageError, did_you_mean

if TYPE_CHECKING:
    from dualarm_cli.model.process_work import SeamWork
    from dualarm_cli.report.curve_report import CurveReport

INTERVAL = "4 ms"
"""Default interval of the points."""


def curve_command(
    tasks: Annotated[
        Path, typer.Argument(help="Task file with coordinate tasks.", autocompletion=complete_job)
    ],
    task: Annotated[
        str | None, typer.Option("--task", help="Task whose curve is written.", show_default="all")
    ] = None,
    step: Annotated[
        str | None, typer.Option("--step", help="Interval between points.", show_default=INTERVAL)
    ] = None,
    spacing: Annotated[
        str | None,
        typer.Option("--spacing", help="Distance between points along the curve instead."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", help="CSV to write: s, x, y, z, qx, qy, qz, qw; - prints it on stdout."
        ),
    ] = None,
    plot: Annotated[
        Path | None, typer.Option("--plot", help="Figure to write (.png, .svg, .pdf).")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite files.")] = False,
    json_output: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Discretise the curves of coordinate tasks: points and frames at constant tool speed.

    The last step is shorter if the length of the curve is not a multiple of the step. For comparison, the forward Euler
    step of Qin et al. (2024), Eq. 14 to 17, is shown.
    """
    from dualarm_cli.files.tasks.tasks import load_job

    if plot is not None:
        refuse_plot(plot, force)
    refuse_two_documents(out, json_output)
    interval, distance = _steps(step, spacing)
    job = load_job(tasks)
    seams = _chosen(
        {entry.id: entry.seam for entry in job.tasks if entry.seam is not None}, task, tasks
    )
    if out is not None and len(seams) > 1:
        raise UsageError(f"--out {out}: holds one curve; choose with --task: {', '.join(seams)}")
    reports = [_report(name, work, interval, distance) for name, work in seams.items()]
    _write(reports, out, plot, force)
    if json_output:
        from dualarm_cli.report.curve_report import curves_document

        print_json(curves_document(reports))
    elif not quiet:
        from dualarm_cli.report.curve_report import print_curves

        print_curves(reports, text_console(out))
    for file in (out, plot):
        if file is not None and str(file) != STDOUT and not quiet:
            print_message(f"written: {file}")


def _steps(step: str | None, spacing: str | None) -> tuple[float | None, float | None]:
    """Return interval [s] or distance [m], whichever is given."""
    from dualarm_cli.files.source.quantities import LENGTH, TIME

    if step is not None and spacing is not None:
        raise UsageError("--spacing does not go with --step; keep one")
    if spacing is not None:
        return None, read_positive("--spacing", spacing, LENGTH)
    return read_positive("--step", step if step is not None else INTERVAL, TIME), None


def _chosen(seams: dict[str, SeamWork], task: str | None, file: Path) -> dict[str, SeamWork]:
    """Select the requested seams by their tasks."""
    if not seams:
        raise UsageError(
            f"{file}: has no coordinate task, so there is no curve; name a task file with one"
        )
    if task is None:
        return seams
    if task not in seams:
        guess = did_you_mean(task, list(seams)) or ";"
        raise UsageError(
            f"--task {task}: {file} has no such coordinate task{guess} it has {', '.join(seams)}"
        )
    return {task: seams[task]}


def _report(
    name: str, work: SeamWork, interval: float | None, distance: float | None
) -> CurveReport:
    """Compute the points of one task's curve; refuse invalid steps."""
    from dualarm_cli.model.curves.discretisation import CURVE_STEPS
    from dualarm_cli.report.curve_report import curve_report

    speed = None
    if distance is None and interval is not None:
        speed = work.speed if work.speed is not None else work.length / (work.duration or 1.0)
        distance = speed * interval
    step = distance or 0.0
    option = "--spacing" if interval is None else "--step"
    if step < CURVE_STEPS.shortest_step:
        raise UsageError(
            f"{option}: task {name} would have a point every {step * 1e6:.3g} um; at least "
            f"{CURVE_STEPS.shortest_step * 1e6:g} um are needed"
        )
    if work.length / step > CURVE_STEPS.most_points:
        raise UsageError(
            f"{option}: task {name} would have {work.length / step:.3g} points; at most "
            f"{CURVE_STEPS.most_points} are allowed"
        )
    return curve_report(name, work.curve, step, interval, speed, mean=work.speed is None)


def _write(reports: list[CurveReport], out: Path | None, plot: Path | None, force: bool) -> None:
    from dualarm_cli.exporting.whole_files import write_file

    if out is not None:
        from dualarm_cli.exporting.files import curve_csv
        from dualarm_cli.model.curves.discretisation import step_lengths

        report = reports[0]
        s = step_lengths(report.curve.length, report.step)
        write_out(out, [curve_csv(s, report.points["arc_length"])], force)
    if plot is not None:
        from dualarm_cli.report.curve_report import draw_curves

        write_file(plot, draw_curves(reports, plot.suffix.lower().lstrip(".")), force)
