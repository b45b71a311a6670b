"""`dualarm schema`: JSON Schema of every kind of file, for editors."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dualarm_cli.cli.parts.completion import complete_kind
from dualarm_cli.cli.parts.output import STDOUT, print_message
from dualarm_cli.errors import UsageError, did_you_mean


def schema_command(
    kind: Annotated[
        str,
        typer.Argument(
            help="Kind of file, such as tasks; all kinds without it.", autocompletion=complete_kind
        ),
    ] = "",
    out: Annotated[
        Path | None,
        typer.Option("--out", help="File to write; stdout without it.", show_default=False),
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
            typer.echo(f"{name:9} {schema_of(name)['description']}")
        return
    if kind not in KINDS:
        guess = did_you_mean(kind, list(KINDS)) or ";"
        known = ", ".join(KINDS)
        raise UsageError(f"there is no kind of file '{kind}'{guess} there are {known}")
    if out is None or str(out) == STDOUT:
        typer.echo(schema_text(kind), nl=False)
        return
    out.parent.mkdir(parents=True, exist_ok=True)
    write_file(out, schema_text(kind).encode(), force)
    line = editor_line(out.as_posix()).rstrip()
    print_message(f"written: {out}; {kind} files in this folder begin with the line: {line}")
