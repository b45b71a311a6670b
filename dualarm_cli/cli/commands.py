"""Binds every command to its name; commands load their heavy libraries when they run."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Annotated

import typer

COMMANDS: Mapping[str, str] = {
    "init": "init.init_command",
    "plan": "plan.plan_command",
    "platform": "platform.platform_command",
    "curve": "curve.curve_command",
    "compare": "compare.compare_app",
    "sweep": "sweep.sweep_command",
    "robot": "robot.robot_app",
    "calibrate": "calibrate.calibrate_command",
    "score": "score.score_command",
    "check": "check.check_command",
    "verify": "verify.verify_command",
    "report": "report.report_command",
    "export": "export.export_command",
    "solvers": "solvers.solvers_command",
    "explain": "explain.explain_command",
    "schema": "schema.schema_command",
}
"""Modules and names of commands and of groups of commands, in the order of the help."""


def command_line(only: str = "") -> typer.Typer:
    """Returns the whole command line.

    Args:
        only: the command that will be run; if it is one of COMMANDS, no other is loaded.
    """
    app = typer.Typer(
        name="dualarm",
        help="How fast can this dual-arm cell run? Cell + tasks in, verified joint schedule out.",
        no_args_is_help=True,
        add_completion=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(root)
    for name in [only] if only in COMMANDS else COMMANDS:
        module, _, attribute = COMMANDS[name].partition(".")
        command = getattr(import_module(f"dualarm_cli.cli.{module}"), attribute)
        if isinstance(command, typer.Typer):
            app.add_typer(command)
        else:
            app.command(name)(command)
    return app


def _print_version(wanted: bool) -> None:
    if wanted:
        from dualarm_cli import __version__

        typer.echo(f"dualarm {__version__}")
        raise typer.Exit


def root(
    _: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None:
    """How fast can this dual-arm cell run? Cell + tasks in, verified joint schedule out."""
