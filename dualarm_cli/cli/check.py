"""`dualarm check`: validation of input files of every kind, without planning."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dualarm_cli.cli.parts.output import JsonOption, QuietOption, print_json, stdout_console
from dualarm_cli.report.printable import print_lines

if TYPE_CHECKING:
    from dualarm_cli.errors import Diagnostic
    from dualarm_cli.files.calibration.points import Base
    from dualarm_cli.model.cell import Cell
    from dualarm_cli.model.job import Job
    from dualarm_cli.model.robot import Robot
    from dualarm_cli.model.studies.study import Study
    from dualarm_cli.model.touches import Touches

    Loaded = Robot | Cell | Job | Touches | Base | Study


def check_command(
    files: Annotated[
        list[Path], typer.Argument(help="Task, cell, robot, study, points or base files.")
    ],
    json_output: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Validate input files of every kind, all errors at once, without planning.

    For a job, infeasible inputs are errors too: a colliding start, unreachable targets, tools or parts in obstacles.
    """
    from dualarm_cli.files.source.diagnostics import render

    results = [_check_one(str(file)) for file in files]
    diagnostics = list(dict.fromkeys(d for result in results for d in result["diagnostics"]))
    if json_output:
        print_json(_document(results))
    else:
        console = stdout_console()
        if diagnostics:
            print_lines(console, render(diagnostics))
        for result in results:
            if not result["diagnostics"] and not quiet:
                what = f"{result['kind']}, {result['summary']}"
                notes = (f"note: {_shown(note)}" for note in result["notes"])
                print_lines(console, f"{_shown(result['file'])}: good: {what}", *notes)
    if diagnostics:
        raise typer.Exit(3 if all(_is_infeasible(diagnostic) for diagnostic in diagnostics) else 2)


def _is_infeasible(diagnostic: Diagnostic) -> bool:
    """Return whether a fault is of the job, not of the file's text."""
    from dualarm_cli.refusals import codes

    return diagnostic.code in codes().values()


def _check_one(file: str) -> dict[str, Any]:
    """Check one file."""
    from dualarm_cli.errors import InputError
    from dualarm_cli.files.checking import load_file
    from dualarm_cli.model.job import Job
    from dualarm_cli.notes import is_about
    from dualarm_cli.report.bodies import cell_notes

    try:
        loaded = load_file(file)
    except InputError as error:
        result: dict[str, Any] = {"file": file, "kind": None, "summary": "", "notes": []}
        return result | {"diagnostics": error.diagnostics}
    kind, summary = _describe(loaded)
    wrong = [*_geometry(loaded), *_paths(loaded)] or _impossible(loaded)
    notes = []
    if isinstance(loaded, Job):
        expanded = [note for note in loaded.notes if is_about(note, "pattern")]
        notes = [*expanded, *cell_notes(loaded)]
    return {"file": file, "kind": kind, "summary": summary, "diagnostics": wrong, "notes": notes}


def _geometry(loaded: Loaded) -> list[Diagnostic]:
    """Check the geometry of arms against their kinds."""
    from dualarm_cli.kinematics.cell_model import find_false_kinds
    from dualarm_cli.model.cell import Cell
    from dualarm_cli.model.job import Job
    from dualarm_cli.model.robot import Robot

    cell = loaded.cell if isinstance(loaded, Job) else loaded
    if not isinstance(cell, Cell | Robot):
        return []
    return find_false_kinds(cell.robot if isinstance(cell, Cell) else cell)


def _paths(loaded: Loaded) -> list[Diagnostic]:
    """Check the requirements of paths and seams: methods, torque limits, duration."""
    from dualarm_cli.kinds.planning import kinds_of
    from dualarm_cli.model.job import Job

    if not isinstance(loaded, Job):
        return []
    return [fault for kind in kinds_of(loaded) for fault in kind.check(loaded)]


def _impossible(loaded: Loaded) -> list[Diagnostic]:
    """Return what makes a job impossible whatever is planned, as `dualarm plan` refuses it."""
    from dualarm_cli.errors import Diagnostic
    from dualarm_cli.model.job import Job
    from dualarm_cli.planning.grasps import possible_grasps
    from dualarm_cli.planning.job_faults import job_faults
    from dualarm_cli.refusals import codes

    if not isinstance(loaded, Job):
        return []
    return [
        Diagnostic(*fault.place.order, codes()[fault.key], fault.advised, about=fault.about)
        for fault in possible_grasps(loaded.blended(), job_faults)[1]
        if fault.place is not None
    ]


def _describe(loaded: Loaded) -> tuple[str, str]:
    """Describe the kind and content of a file."""
    from dualarm_cli.files.calibration.points import Base
    from dualarm_cli.model.cell import Cell
    from dualarm_cli.model.job import Job
    from dualarm_cli.model.studies.study import Study
    from dualarm_cli.model.touches import Touches
    from dualarm_cli.orders.model.tool_changes import with_changes

    if isinstance(loaded, Study):
        counts = [(len(loaded.parameters), "parameter"), (len(loaded.tasks), "task file")]
        return "study", ", ".join(_count(*count) for count in counts)
    if isinstance(loaded, Touches):
        return "points", _count(len(loaded.names), "point")
    if isinstance(loaded, Base):
        where = "the cell" if loaded.relative_to is None else f"the {loaded.relative_to} robot"
        return "base", f"a pose relative to {where}"
    if isinstance(loaded, Job):
        targets = sum(len(task.stops) for task in loaded.tasks)
        counts = [
            (len({task.id for task in loaded.tasks}), "task"),
            (targets, "target"),
        ]
        if loaded.is_decided:
            counts.append((len(with_changes(loaded).stages()), "stage"))
        words = [_count(*count) for count in counts]
        if not loaded.is_decided:
            words.append("order open" if loaded.order == "optimise" else "arms open")
        return "tasks", ", ".join(words)
    if isinstance(loaded, Cell):
        counts = [(len(loaded.frames), "frame"), (len(loaded.obstacles), "obstacle")]
        return "cell", ", ".join([loaded.robot.name, *(_count(*count) for count in counts)])
    counts = [
        (len(loaded.arms), "arm"),
        (len(loaded.joints), "joint"),
        (len(loaded.postures), "posture"),
    ]
    return "robot", ", ".join([loaded.name, *(_count(*count) for count in counts)])


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _shown(file: str) -> str:
    """Format a file's name for a terminal."""
    return "".join(c if c.isprintable() else "\N{MIDDLE DOT}" for c in file)


def _document(results: list[dict[str, Any]]) -> dict[str, Any]:
    """Build the JSON document of all files."""
    return {
        "format": "dualarm.check/1",
        "passed": not any(result["diagnostics"] for result in results),
        "files": [
            {
                "file": _shown(result["file"]),
                "kind": result["kind"],
                "summary": result["summary"],
                "notes": [_shown(note) for note in result["notes"]],
                "diagnostics": [_entry(diagnostic) for diagnostic in result["diagnostics"]],
            }
            for result in results
        ],
    }


def _entry(diagnostic: Diagnostic) -> dict[str, Any]:
    return {
        "file": _shown(diagnostic.file),
        "line": diagnostic.line,
        "column": diagnostic.column,
        "code": diagnostic.code,
        "message": diagnostic.message,
        **diagnostic.about,
    }
