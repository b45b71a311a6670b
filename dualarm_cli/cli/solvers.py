"""`dualarm solvers`: every method by family, with its reference."""

from __future__ import annotations

from dualarm_cli.cli.parts.families import families
from dualarm_cli.cli.parts.output import JsonOption, print_json, stdout_console


def solvers_command(json_output: JsonOption = False) -> None:
    """List the methods of `--platform` and the solvers of every family, with their references."""
    rows = [
        {"family": family.family, "name": s.name, "summary": s.summary, "reference": s.reference}
        for family in families()
        for s in family
    ]
    if json_output:
        print_json({"format": "dualarm.solvers/1", "solvers": rows})
        return
    from rich.table import Table

    table = Table()
    for column in ("family", "name", "what it does", "reference"):
        table.add_column(column)
    for row in rows:
        table.add_row(*row.values())
    stdout_console().print(table)
