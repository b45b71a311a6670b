"""Binds every command to its name; commands load their heavy libraries when they run."""

from __future__ import annotations

from typing import Annotated

import typer

from dualarm_cli import __version__
from dualarm_cli.cli.calibrate import calibrate_command
from dualarm_cli.cli.check import check_command
from dualarm_cli.cli.compare import compare_app
from dualarm_cli.cli.curve import curve_command
from dualarm_cli.cli.explain import explain_command
from dualarm_cli.cli.export import export_command
from dualarm_cli.cli.init import init_command
from dualarm_cli.cli.plan import plan_command
from dualarm_cli.cli.platform import platform_command
from dualarm_cli.cli.report import report_command
from dualarm_cli.cli.robot import robot_app
from dualarm_cli.cli.schema import schema_command
from dualarm_cli.cli.score import score_command
from dualarm_cli.cli.solvers import solvers_command
from dualarm_cli.cli.sweep import sweep_command
from dualarm_cli.cli.verify import verify_command

app = typer.Typer(
    name="dualarm",
    help="How fast can this dual-arm cell run? Cell + tasks in, verified joint schedule out.",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
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


app.command("init")(init_command)
app.command("plan")(plan_command)
app.command("platform")(platform_command)
app.command("curve")(curve_command)
app.add_typer(compare_app)
app.command("sweep")(sweep_command)
app.add_typer(robot_app)
app.command("calibrate")(calibrate_command)
app.command("score")(score_command)
app.command("check")(check_command)
app.command("verify")(verify_command)
app.command("report")(report_command)
app.command("export")(export_command)
app.command("solvers")(solvers_command)
app.command("explain")(explain_command)
app.command("schema")(schema_command)

__all__ = ["app"]
