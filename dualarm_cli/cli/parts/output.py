"""Output of commands: results on stdout, messages and progress on stderr."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterable, Mapping
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dualarm_cli.errors import UsageError
from dualarm_cli.report.printable import print_lines

if TYPE_CHECKING:
    from rich.console import Console

JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON document on stdout.")]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]
ResultOnlyOption = Annotated[
    bool, typer.Option("--quiet", "-q", help="Print one line only, the result; errors as ever.")
]
DetailsOption = Annotated[bool, typer.Option("--details", "-v", help="Print tables and all notes.")]


PIPE_WIDTH = 120
"""Width of tables if stdout is no terminal and COLUMNS is not set [characters]."""
STDOUT = "-"
"""Name of standard output in `--out`."""


def refuse_two_documents(out: object, json_output: bool) -> None:
    """Raise if standard output would get both a result and a JSON document."""
    if str(out) == STDOUT and json_output:
        raise UsageError("--json does not go with --out -: both print on standard output; keep one")


def write_out(out: Path, parts: Iterable[bytes], force: bool) -> None:
    """Write a command's main result to a file, or to standard output for `-`.

    Raises:
        OutputError: the file already exists and `force` is not given, or it cannot be written.
    """
    from dualarm_cli.exporting.whole_files import write_file

    if str(out) != STDOUT:
        write_file(out, b"".join(parts), force)
        return
    for part in parts:
        typer.echo(part, nl=False)


def text_console(out: object) -> Console:
    """Return the console for text: stderr if standard output gets the result."""
    return stderr_console() if str(out) == STDOUT else stdout_console()


def stdout_console() -> Console:
    """Create a console for results; plain text if stdout is not a terminal."""
    from rich.console import Console as RichConsole
    from rich.table import Table

    from dualarm_cli.cli.parts.fitting import fitted

    class Console(RichConsole):
        """A console with fitted tables.

        A closed pipe is handled in `cli.run`, which has its exit code.
        """

        def print(self, *objects: Any, **options: Any) -> None:
            """Print with fitted tables."""
            shown = [fitted(item, self) if isinstance(item, Table) else item for item in objects]
            super().print(*shown, **options)

        def on_broken_pipe(self) -> None:
            """Re-raise the error instead of ending the process with 1."""
            raise BrokenPipeError

    _escape_unsupported()
    console = Console(highlight=False, soft_wrap=False)
    # Programs without a terminal set COLUMNS to 0.
    if console.is_terminal or os.environ.get("COLUMNS", "").lstrip("0").isdigit():
        return console
    return Console(highlight=False, width=PIPE_WIDTH)


def _escape_unsupported() -> None:
    """Give a stdout that is not UTF-8 escapes for unsupported characters, not a traceback."""
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


def print_sentences(out: object, *texts: str) -> None:
    """Print sentences: on stderr if standard output gets the result.

    Rich, which takes 20 ms to load, is for terminals and for colours that are asked for.
    """
    stream = sys.stderr if str(out) == STDOUT else sys.stdout
    if stream.isatty() or os.environ.get("FORCE_COLOR"):
        print_lines(text_console(out), *texts)
        return
    _escape_unsupported()
    stream.write("\n".join(texts) + "\n")


def stderr_console() -> Console:
    """Create a console for sentences and progress."""
    from rich.console import Console

    return Console(stderr=True, highlight=False)


def print_json(document: Mapping[str, Any]) -> None:
    """Print one JSON document on stdout in its own order; refuse NaN."""
    ascii_only = (sys.stdout.encoding or "").lower().replace("-", "") != "utf8"
    text = json.dumps(document, indent=2, allow_nan=False, ensure_ascii=ascii_only)
    sys.stdout.write(text + "\n")


def print_message(text: str) -> None:
    """Print sentences on stderr."""
    if sys.stderr.isatty():
        print_lines(stderr_console(), text)
    else:
        sys.stderr.write(text + "\n")
