"""What commands print: results on stdout, sentences and progress on stderr."""

from __future__ import annotations

import json
import sys
from io import TextIOWrapper
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from rich.console import Console

JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON document on stdout.")]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]


def stdout_console() -> Console:
    """Returns a console for results; plain text where stdout is no terminal."""
    from rich.console import Console as RichConsole

    class Console(RichConsole):
        """A console that leaves a closed pipe to the one place that knows its exit code."""

        def on_broken_pipe(self) -> None:
            """Passes the error on instead of ending the process with 1."""
            raise BrokenPipeError

    if isinstance(sys.stdout, TextIOWrapper):
        # A stdout that is not UTF-8 gets escapes for what it cannot show, not a traceback.
        sys.stdout.reconfigure(errors="backslashreplace")
    console = Console(highlight=False, soft_wrap=False)
    return console if console.is_terminal else Console(highlight=False, width=120)


def stderr_console() -> Console:
    """Returns a console for sentences and progress."""
    from rich.console import Console

    return Console(stderr=True, highlight=False)


def print_json(document: dict[str, Any]) -> None:
    """Prints one JSON document on stdout, in its own order; refuses NaN."""
    ascii_only = (sys.stdout.encoding or "").lower().replace("-", "") != "utf8"
    text = json.dumps(document, indent=2, allow_nan=False, ensure_ascii=ascii_only)
    sys.stdout.write(text + "\n")


def print_message(text: str) -> None:
    """Prints one sentence on stderr."""
    sys.stderr.write(text + "\n")
