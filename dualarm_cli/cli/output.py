"""What commands print: results on stdout, sentences and progress on stderr."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from rich.console import Console

JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON document on stdout.")]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]


def stdout_console() -> Console:
    """Returns a console for results; plain text where stdout is no terminal."""
    from rich.console import Console

    console = Console(highlight=False, soft_wrap=False)
    return console if console.is_terminal else Console(highlight=False, width=120)


def stderr_console() -> Console:
    """Returns a console for sentences and progress."""
    from rich.console import Console

    return Console(stderr=True, highlight=False)


def print_json(document: dict[str, Any]) -> None:
    """Prints one JSON document on stdout, sorted as given; refuses NaN."""
    sys.stdout.write(json.dumps(document, indent=2, allow_nan=False, ensure_ascii=False) + "\n")


def print_message(text: str) -> None:
    """Prints one sentence on stderr."""
    sys.stderr.write(text + "\n")
