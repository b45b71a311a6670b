"""`dualarm robot reach`: the part of a table that each arm and both arms reach."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dualarm_cli.cli.parts.completion import complete_robot
from dualarm_cli.cli.parts.options import read_quantity, refuse_plot
from dualarm_cli.cli.parts.output import JsonOption, print_json, print_message, stdout_console
from dualarm_cli.errors import UsageError
from dualarm_cli.notes import Note, NoteTable
from dualarm_cli.report.printable import print_lines

if TYPE_CHECKING:
    from dualarm_cli.model.cell import Cell

_note = NoteTable(
    "tools",
    assumed="tools are assumed, no cell file names them: {tools:*; }",
    tool="{arm}: along {axis} of the flange, {mm:.3g} mm long",
)
MOST_NODES = 400_000
"""Maximum number of points over all platform angles."""
MAX_TILT = 90.0
"""Largest tilt [deg]."""


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
        str,
        typer.Option("--tilt", help="Tilt of the tool from straight down, its tip outwards."),
    ] = "0 deg",
    step: Annotated[
        str | None,
        typer.Option("--step", help="Spacing of the points.", show_default="by the robot's size"),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Picture to write (.png, .svg, .pdf).", show_default=False),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite the picture.")] = False,
    json_output: JsonOption = False,
) -> None:
    """Show the part of a table that each arm and both arms reach, tools down."""
    import math

    import numpy as np

    from dualarm_cli.exporting.whole_files import write_file
    from dualarm_cli.files.source.quantities import ANGLE, LENGTH
    from dualarm_cli.reachability.reach_map import reach_map
    from dualarm_cli.reachability.region import best_height, platform_positions, region
    from dualarm_cli.report.reach import area_table, frame_table, reach_document, reach_lines

    if out is not None:
        refuse_plot(out, force, "--out")
    leaning = read_quantity("--tilt", tilt, ANGLE)
    if not abs(leaning) <= math.radians(MAX_TILT):
        raise UsageError(f"--tilt {tilt}: must be between -{MAX_TILT:g} and {MAX_TILT:g} deg")
    spacing = None if step is None else read_quantity("--step", step, LENGTH)
    level = None if height is None else read_quantity("--height", height, LENGTH)
    cell, notes = _cell(robot)
    here = region(cell)
    platform = platform_positions(cell)
    spacing = here.step if spacing is None else spacing
    width = 2.0 * (here.radius + here.travel)
    points = len(platform) * (width / spacing) ** 2 if spacing > 0.0 else math.inf
    if not points <= MOST_NODES:
        least = width * math.sqrt(len(platform) / MOST_NODES) * 1000.0
        raise UsageError(f"--step {step}: must be {math.ceil(least)} mm or more for this robot")
    if level is None and cell.frames:
        level = float(np.median([pose.translation[2] for pose in cell.frames.values()]))
    if level is None:
        level = best_height(cell, here)
    if level is None:
        level = here.easy[1]
    grid = here.grid(platform, np.array([level]), spacing, leaning, whole=True)
    document = reach_document(robot, cell, reach_map(cell, grid))
    if out is not None:
        from dualarm_cli.report.figures.platform_figure import draw_reach

        write_file(out, draw_reach(document, cell, out.suffix.lower().lstrip(".")), force)
    if json_output:
        print_json(document)
    else:
        console = stdout_console()
        console.print(
            f"{robot}: reach {level:.3g} m high, points {spacing * 1000:g} mm apart", markup=False
        )
        console.print(area_table(document))
        if document["frames"]:
            console.print(frame_table(document))
        print_lines(console, *notes, *reach_lines(document))
    if out is not None:
        print_message(f"written: {out}")


def _cell(robot: str) -> tuple[Cell, list[Note]]:
    """Load the cell of an argument, with notes on assumptions."""
    from dualarm_cli.files.cells.cells import load_cell
    from dualarm_cli.files.robots.robots import load_robot
    from dualarm_cli.files.source.bundled import ROBOT_FILE, bundled_robots
    from dualarm_cli.files.source.documents import read_document
    from dualarm_cli.files.source.projects import Project
    from dualarm_cli.reachability.proposed_tool import with_tools
    from dualarm_cli.robot_import.contacts import bare_cell
    from dualarm_cli.starting.robot_source import CELL_FILE

    path = Path(robot)
    if path.is_dir() and robot not in bundled_robots():
        path = path / (CELL_FILE if (path / CELL_FILE).is_file() else ROBOT_FILE)
    if robot in bundled_robots() or not path.is_file():
        cell = bare_cell(load_robot(robot).robot)
    elif read_document(Project.of(path), path, str(path)).data["dualarm"] == "cell/1":
        cell = load_cell(path).cell
    else:
        cell = bare_cell(load_robot(path).robot)
    if any(tool.shapes or not tool.tcp.isIdentity() for tool in cell.tools.values()):
        return cell, []
    cell, tools = with_tools(cell)
    assumed = [
        _note("tool", arm=arm, axis=tool.axis, mm=(tool.start + tool.length) * 1e3)
        for arm, tool in tools.items()
    ]
    return cell, [_note("assumed", tools=assumed)]
