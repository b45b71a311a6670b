"""Commands that list features: `solvers`, `explain` and `schema`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from dualarm_cli.cli.parts.completion import complete_code, complete_kind, families
from dualarm_cli.cli.parts.output import (
    STDOUT,
    JsonOption,
    print_json,
    print_message,
    stdout_console,
)
from dualarm_cli.errors import UsageError, did_you_mean


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

    table = Table("family", "name", "what it does", "reference")
    for row in rows:
        table.add_row(*row.values())
    stdout_console().print(table)


def explain_command(
    code: Annotated[
        str,
        typer.Argument(
            help="An error code, such as E610; all of them without it.",
            autocompletion=complete_code,
        ),
    ] = "",
    json_output: JsonOption = False,
) -> None:
    """Explain an error code: causes and remedies."""
    from dualarm_cli.errors import explain
    from dualarm_cli.explanations import explanations
    from dualarm_cli.files.source.bundled import documentation_page

    wanted = code.strip().upper()
    chosen = {wanted: explain(code)} if wanted else explanations()
    if json_output:
        codes = [{"code": name} | asdict(entry) for name, entry in chosen.items()]
        print_json({"format": "dualarm.explanations/1", "codes": codes})
        return
    if not wanted:
        for name, entry in chosen.items():
            typer.echo(f"{name}  {entry.title}")
        return
    entry = chosen[wanted]
    lines = [f"{wanted}: {entry.title}", "", "Why:", *(f"  - {text}" for text in entry.causes)]
    lines += ["", "What to do:", *(f"  - {text}" for text in entry.remedies)]
    if entry.example:
        lines += ["", f"Example: {entry.example}"]
    if entry.page:
        lines += ["", f"More: {documentation_page(entry.page)}"]
    typer.echo("\n".join(lines))


def schema_command(
    kind: Annotated[
        str,
        typer.Argument(
            help="Kind of file, such as tasks; all kinds without it.", autocompletion=complete_kind
        ),
    ] = "",
    out: Annotated[
        Path | None, typer.Option("--out", help="File to write; stdout without it.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite the file.")] = False,
) -> None:
    """Print the JSON Schema of a kind of file: editors complete, explain and check with it.

    Without a kind: list the kinds.
    """
    from dualarm_cli.exporting.whole_files import write_file
    from dualarm_cli.schemas import KINDS, editor_line, schema_of, schema_text

    if not kind:
        if out is not None:
            raise UsageError(f"--out {out}: name a kind of file, such as tasks")
        for name in KINDS:
            typer.echo(f"{name:19} {schema_of(name)['description']}")
        return
    if kind not in KINDS:
        guess = did_you_mean(kind, list(KINDS)) or ";"
        kinds = ", ".join(KINDS)
        raise UsageError(f"there is no kind of file '{kind}'{guess} there are {kinds}")
    if out is None or str(out) == STDOUT:
        typer.echo(schema_text(kind), nl=False)
        return
    out.parent.mkdir(parents=True, exist_ok=True)
    write_file(out, schema_text(kind).encode(), force)
    line = editor_line(out.as_posix()).rstrip()
    print_message(f"written: {out}; {kind} files in this folder begin with the line: {line}")
