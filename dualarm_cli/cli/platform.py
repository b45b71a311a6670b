"""`dualarm platform`: platform angles of one move by every method, as table and figure."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dualarm_cli.cli.parts.options import read_quantity
from dualarm_cli.cli.parts.output import JsonOption, print_json, print_message, stdout_console
from dualarm_cli.errors import UsageError
from dualarm_cli.report.printable import numbers

if TYPE_CHECKING:
    from dualarm_cli.geometry.arrays import FloatArray
    from dualarm_cli.platform_angle import PlatformProblem
    from dualarm_cli.platform_angle.table import MethodRow


PAPER = {
    "radius": "50 mm",
    "alpha": "120 deg",
    "links": "70 mm, 70 mm",
    "angle": "-30 deg",
    "start": "120 mm, 0; 0, 120 mm",
    "goal": "80 mm, 10 mm; 50 mm, 100 mm",
}
"""Table 1 of [Bottin2021], as options."""


def platform_command(
    tasks: Annotated[
        Path | None,
        typer.Argument(
            help="Task file that holds the move; without it the options describe a planar robot."
        ),
    ] = None,
    stage: Annotated[int, typer.Option("--stage", help="Stage of the task file, from 1.")] = 1,
    radius: Annotated[str, typer.Option(help="Shoulders' distance from the axis.")] = PAPER[
        "radius"
    ],
    alpha: Annotated[str, typer.Option(help="Second shoulder's azimuth from the first.")] = PAPER[
        "alpha"
    ],
    links: Annotated[str, typer.Option(help="Upper arm and forearm.")] = PAPER["links"],
    angle: Annotated[str, typer.Option(help="Platform angle before the move.")] = PAPER["angle"],
    start: Annotated[str, typer.Option(help="Both wrists before: x, y; x, y.")] = PAPER["start"],
    goal: Annotated[str, typer.Option(help="Both wrists after: x, y; x, y.")] = PAPER["goal"],
    plot: Annotated[
        Path | None, typer.Option("--plot", help="Figure to write (.png, .svg, .pdf).")
    ] = None,
    json_output: JsonOption = False,
) -> None:
    """Show one move's platform angles by every method.

    Without a task file the defaults are Table 1 of Bottin, Rosati, Boschetti (2021), and the rows of `linearised`
    are the paper's Table 2.
    """
    from dualarm_cli.platform_angle import PLATFORM_SOLVERS
    from dualarm_cli.platform_angle.table import candidate_rows

    planar = {"radius": radius, "alpha": alpha, "links": links}
    planar |= {"angle": angle, "start": start, "goal": goal}
    _refuse_contradictions(tasks, stage, [k for k, v in planar.items() if v != PAPER[k]])
    if tasks is None:
        problem, before = _planar(radius, alpha, links, angle, start, goal)
    else:
        problem, before = _stage(tasks, stage)
    rows = [
        row
        for solver in ("linearised", "exact", "fixed")
        for row in candidate_rows(solver, PLATFORM_SOLVERS[solver].solve(problem))
    ]
    if plot is not None:
        _write_figure(plot, problem, rows, before)
    if json_output:
        print_json(_document(problem, rows))
    else:
        stdout_console().print(_table(rows))


def _refuse_contradictions(tasks: Path | None, stage: int, given: list[str]) -> None:
    """Refuse options that have no effect with the other ones."""
    if tasks is not None and given:
        raise UsageError(f"--{given[0]} describes a planar robot; {tasks} has its own")
    if tasks is None and stage != 1:
        raise UsageError(f"--stage {stage}: only a task file has stages; name one")


def _write_figure(
    plot: Path, problem: PlatformProblem, rows: list[MethodRow], before: FloatArray
) -> None:
    from dualarm_cli.exporting.whole_files import write_file
    from dualarm_cli.kinds.drawing import FIGURE_KINDS
    from dualarm_cli.report.figures.platform_figure import draw_move

    kind = plot.suffix.lower().lstrip(".")
    if kind not in FIGURE_KINDS:
        raise UsageError(f"--plot {plot}: must end in .{', .'.join(FIGURE_KINDS)}")
    write_file(plot, draw_move(problem, rows, before, kind), force=True)
    print_message(f"written: {plot}")


def _planar(
    radius: str, alpha: str, links: str, angle: str, start: str, goal: str
) -> tuple[PlatformProblem, FloatArray]:
    """Build the move of a planar robot and its wrists before."""
    import numpy as np

    from dualarm_cli.files.source.quantities import ANGLE, LENGTH
    from dualarm_cli.platform_angle import PlatformProblem

    a1, a2 = _numbers("--links", links, LENGTH, (2,))
    points = [
        _numbers(name, text, LENGTH, (2, 2))
        for name, text in (("--start", start), ("--goal", goal))
    ]
    try:
        problem = PlatformProblem.planar(
            radius=float(_numbers("--radius", radius, LENGTH, (1,))[0]),
            alpha=float(_numbers("--alpha", alpha, ANGLE, (1,))[0]),
            links=(float(a1), float(a2)),
            angle_0=float(_numbers("--angle", angle, ANGLE, (1,))[0]),
            start=points[0],
            goal=points[1],
        )
    except ValueError as error:
        raise UsageError(f"this robot cannot make the move: {error}") from None
    return problem, np.column_stack([points[0], np.zeros(2)])


def _numbers(option: str, text: str, quantity: Any, shape: tuple[int, ...]) -> FloatArray:
    """Parse quantities separated by commas and semicolons, in SI units."""
    import numpy as np

    words = [word.strip() for word in text.replace(";", ",").split(",")]
    if len(words) != math.prod(shape):
        raise UsageError(f"{option} '{text}': needs {math.prod(shape)} values, got {len(words)}")
    return np.array([read_quantity(option, word, quantity) for word in words]).reshape(shape)


def _stage(tasks: Path, stage: int) -> tuple[PlatformProblem, FloatArray]:
    """Plan the move into one stage of a task file.

    The second result has the wrists before the move.
    """
    from dualarm_cli.files.tasks.tasks import load_job
    from dualarm_cli.stages.platform_moves import stage_move

    return stage_move(load_job(tasks), stage)


def _table(rows: list[MethodRow]) -> Any:
    from rich.table import Table

    figures = numbers("φf − φ0 °", "φf °", "Δq4,1 °", "Δq4,2 °", "|Δ2| − |Δ1| °")
    table = Table("method", *numbers("N"), "candidate", *figures, "")
    number, method = 0, ""
    for row in rows:
        number = number + 1 if row.method == method else 1
        if row.method != method and method:
            table.add_section()
        method = row.method
        table.add_row(
            method,
            str(number),
            row.kind.name.lower().replace("_", " "),
            _degrees(row.turn),
            _degrees(row.angle),
            *(_degrees(value) for value in row.delta),
            _printed_difference(row),
            "chosen" if row.chosen else "unreachable" if row.difference is None else "",
        )
    return table


def _printed_difference(row: MethodRow) -> str:
    """Compute the difference of the two printed displacements, as in the paper's table."""
    first, second = (
        None if value is None else round(math.degrees(value), 2) for value in row.delta
    )
    return "–" if first is None or second is None else f"{abs(second) - abs(first) + 0.0:.2f}"


def _degrees(value: float | None) -> str:
    """Format an angle in degrees with the paper's two decimals; a dash for None."""
    # Adding zero turns -0.00 into 0.00.
    return "–" if value is None else f"{round(math.degrees(value), 2) + 0.0:.2f}"


def _document(problem: PlatformProblem, rows: list[MethodRow]) -> dict[str, Any]:
    return {
        "format": "dualarm.platform/1",
        "angle_0": float(problem.angle_0[0]),
        "elbow_0": [float(q) for q in problem.elbow_0[0]],
        "candidates": [
            {
                "method": row.method,
                "kind": row.kind.name.lower(),
                "angle": row.angle,
                "turn": row.turn,
                "elbow_displacement": list(row.delta),
                "difference": row.difference,
                "chosen": row.chosen,
            }
            for row in rows
        ],
    }
