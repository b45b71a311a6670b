"""Output of commands: results on stdout, messages and progress on stderr."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dualarm_cli.errors import UsageError

if TYPE_CHECKING:
    from rich.console import Console

JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON document on stdout.")]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]


PIPE_WIDTH = 120
"""Width of tables where stdout is no terminal [characters]."""
STDOUT = "-"
"""What `--out` takes for standard output."""


def refuse_two_documents(out: object, json_output: bool) -> None:
    """Raise where standard output would get both a result and a JSON document."""
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
    """Return the console for what people read: stderr where standard output gets the result itself."""
    return stderr_console() if str(out) == STDOUT else stdout_console()


def stdout_console() -> Console:
    """Return a console for results; plain text where stdout is no terminal."""
    from rich.console import Console as RichConsole
    from rich.table import Table

    from dualarm_cli.cli.parts.fitting import fitted

    class Console(RichConsole):
        """A console whose tables fit; a closed pipe is left to the one place that knows its exit code."""

        def print(self, *objects: Any, **options: Any) -> None:
            """Print as rich does."""
            shown = [fitted(one, self) if isinstance(one, Table) else one for one in objects]
            super().print(*shown, **options)

        def on_broken_pipe(self) -> None:
            """Pass the error on instead of ending the process with 1."""
            raise BrokenPipeError

    if isinstance(sys.stdout, TextIOWrapper):
        # A stdout that is not UTF-8 gets escapes for what it cannot show, not a traceback.
        sys.stdout.reconfigure(errors="backslashreplace")
    console = Console(highlight=False, soft_wrap=False)
    return console if console.is_terminal else Console(highlight=False, width=PIPE_WIDTH)


def stderr_console() -> Console:
    """Return a console for sentences and progress."""
    from rich.console import Console

    return Console(stderr=True, highlight=False)


def print_json(document: dict[str, Any]) -> None:
    """Print one JSON document on stdout, in its own order; refuses NaN."""
    ascii_only = (sys.stdout.encoding or "").lower().replace("-", "") != "utf8"
    text = json.dumps(document, indent=2, allow_nan=False, ensure_ascii=ascii_only)
    sys.stdout.write(text + "\n")


def print_message(text: str) -> None:
    """Print one sentence on stderr."""
    sys.stderr.write(text + "\n")
