"""`dualarm robot reach`: the part of a table within reach of the arms.

It is shown for each arm and for both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from dualarm_cli.cli.parts.completion import complete_robot
from dualarm_cli.cli.parts.options import read_quantity, refuse_plot
from dualarm_cli.cli.parts.output import JsonOption, print_json, print_message, stdout_console
from dualarm_cli.errors import UsageError
from dualarm_cli.report.printable import print_lines


def reach_command(
    robot: Annotated[
        str,
        typer.Argument(
            help="A bundled robot's name, a robot's folder, a robot file, or a cell file.",
            autocompletion=complete_robot,
        ),
    ],
    height: Annotated[
        str | None,
        typer.Option(
            "--height",
            help="Height of the tool centre point (0.8, '800 mm').",
            show_default="that of the cell's frames, else where most is reached",
        ),
    ] = None,
    tilt: Annotated[
        str, typer.Option("--tilt", help="Tilt of the tool from straight down, its tip outwards.")
    ] = "0 deg",
    step: Annotated[
        str | None,
        typer.Option("--step", help="Spacing of the points.", show_default="by the robot's size"),
    ] = None,
    handover: Annotated[
        str | None,
        typer.Option(
            "--handover",
            help="Also find where both tools face each other, this far apart ('80 mm').",
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Picture to write (.png, .svg, .pdf).")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite the picture.")] = False,
    json_output: JsonOption = False,
) -> None:
    """Show the part of a table that each and both arms reach.

    Tools point down.
    """
    from dualarm_cli.exporting.whole_files import write_file
    from dualarm_cli.files.source.quantities import ANGLE, LENGTH
    from dualarm_cli.interface.reaching import reach, reach_cell

    if out is not None:
        refuse_plot(out, force, "--out")
    leaning = read_quantity("--tilt", tilt, ANGLE)
    spacing = None if step is None else read_quantity("--step", step, LENGTH)
    level = None if height is None else read_quantity("--height", height, LENGTH)
    distance = None if handover is None else read_quantity("--handover", handover, LENGTH)
    cell, notes = reach_cell(robot)
    try:
        document = reach(cell, height=level, tilt=leaning, step=spacing, handover=distance)
    except UsageError as error:
        raise UsageError(f"--{error}") from None
    document["name"] = robot
    if out is not None:
        from dualarm_cli.report.figures.platform_figure import draw_reach

        write_file(out, draw_reach(document, cell, out.suffix.lower().lstrip(".")), force)
    if json_output:
        print_json(document)
    else:
        _print(document, notes)
    if out is not None:
        print_message(f"written: {out}")


def _print(document: Mapping[str, Any], notes: Sequence[str]) -> None:
    """Print areas and frames as tables, notes, and sentences."""
    from dualarm_cli.report.reach import area_table, frame_table, reach_lines

    console = stdout_console()
    print_lines(
        console,
        f"{document['name']}: reach {document['height']:.3g} m high, points {document['step'] * 1000:g} mm apart",
    )
    console.print(area_table(document))
    if document["frames"]:
        console.print(frame_table(document))
    print_lines(console, *notes, *reach_lines(document))
