"""The command table."""

from __future__ import annotations

from typing import Annotated

import typer

from dualarm_cli import __version__

app = typer.Typer(
    name="dualarm",
    help="How fast can this dual-arm cell run? Cell + tasks in, verified joint schedule out.",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"dualarm {__version__}")
        raise typer.Exit


@app.callback()
def root(
    _: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None:
    """How fast can this dual-arm cell run? Cell + tasks in, verified joint schedule out."""
