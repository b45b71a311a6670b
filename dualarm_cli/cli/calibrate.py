"""`dualarm calibrate`: relative pose of two robots, from points that both have touched."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dualarm_cli.cli.parts.completion import complete_solver
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
    from dualarm_cli.calibration.calibrate import Calibration
    from dualarm_cli.model.touches import Fitted, Touches


class Reading(StrEnum):
    """Reading to use for a point with both kinds."""

    joints = "joints"
    xyz = "xyz"


def calibrate_command(
    points: Annotated[Path, typer.Argument(help="File of touched points (dualarm: points/1).")],
    method: Annotated[
        str,
        typer.Option(
            "--method",
            help="least_squares, or frame: the paper's three points.",
            autocompletion=complete_solver("calibration"),
        ),
    ] = "least_squares",
    origin: Annotated[
        str | None,
        typer.Option(
            "--origin",
            help="Origin of the frame method: one of the first three points.",
            show_default="the second",
        ),
    ] = None,
    fit: Annotated[
        str | None,
        typer.Option(
            "--fit", help="Further estimated parameters: tool, base_height or tool,base_height."
        ),
    ] = None,
    use: Annotated[
        Reading,
        typer.Option(
            "--use", help="Reading to use if a point has both joint readings and coordinates."
        ),
    ] = Reading.joints,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", help="Base file to write, for `base:` of a cell file; - prints it on stdout."
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite the file.")] = False,
    json_output: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Estimate the right robot's base pose in the left base from touched points.

    Exit code 3, without a file, for two points, points on a line, and readings that do not determine the transform.
    """
    refuse_two_documents(out, json_output)
    from dualarm_cli.calibration import CALIBRATION_SOLVERS
    from dualarm_cli.calibration.calibrate import calibrate
    from dualarm_cli.files.calibration.points import load_points

    solver = CALIBRATION_SOLVERS[method]
    if origin is not None and solver.name != "frame":
        raise UsageError(f"--origin {origin}: only --method frame has an origin")
    touches = _with_options(load_points(points).touches, origin, fit)
    result = calibrate(touches, solver.name, use.value)
    if out is not None:
        _write(out, force, points, result)
    if json_output:
        from dualarm_cli.report.calibration import calibration_document

        print_json(calibration_document(result))
    elif not quiet:
        from dualarm_cli.report.calibration import print_calibration

        print_calibration(result, text_console(out))
    if not quiet:
        for note in result.notes:
            print_message(f"note: {note}")
        for warning in result.judgement.warnings:
            print_message(f"warning: {warning}")
        if out is not None:
            print_message(f"written: {out}" if str(out) != STDOUT else "written to stdout")


def _with_options(touches: Touches, origin: str | None, fit: str | None) -> Touches:
    """Replace values of the file by those of the options."""
    from dataclasses import replace

    if origin is not None:
        points = list(touches.names[:3])
        if origin not in points:
            raise UsageError(
                f"--origin {origin}: must be one of the first three points: {', '.join(points)}"
            )
        touches = replace(touches, origin=points.index(origin))
    if fit is not None:
        fits: dict[str, Fitted] = {"tool": "tool", "base_height": "base_height"}
        words = [word.strip() for word in fit.split(",") if word.strip()]
        for word in words:
            if word not in fits:
                hint = did_you_mean(word, list(fits)) or ";"
                raise UsageError(
                    f"--fit {fit}: there is no '{word}'{hint} known: tool, base_height"
                )
        touches = replace(touches, fit=tuple(fits[word] for word in dict.fromkeys(words)))
    return touches


def _write(out: Path, force: bool, points: Path, result: Calibration) -> None:
    from dualarm_cli.exporting.files import base_file

    judgement, solution = result.judgement, result.solution
    remarks = [
        f"from {points.name} by dualarm calibrate --method {result.method}: {len(result.problem.names)} points, "
        f"residuals {judgement.rms * 1000:.3g} mm RMS, {judgement.distances.max() * 1000:.3g} mm at most",
        *(f"warning: {warning}" for warning in judgement.warnings),
    ]
    write_out(out, [base_file(solution.rotation, solution.translation, remarks)], force)
