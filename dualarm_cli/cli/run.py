"""Entry of all commands: every error becomes an exit code here.

0 good; 1 ran and found a violation or a regression; 2 bad input or usage; 3 no feasible plan;
4 internal error; 130 and 143 on signals.

Binds every command to its name; commands load their heavy libraries when they run.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Mapping
from importlib import import_module
from types import FrameType
from typing import Annotated, Any

import typer

from dualarm_cli.cli.parts.help import HelpCommand, HelpGroup
from dualarm_cli.errors import DualArmError, lacks_memory

# typer carries click within itself since 0.25 and stood on it before: its errors' common ancestor is
# found from either.
_COMMAND_LINE_ERROR: Any = next(
    base for base in typer.BadParameter.__mro__ if base.__name__ == "ClickException"
)
SIGINT_EXIT, SIGTERM_EXIT, PIPE_EXIT, INTERNAL_EXIT = 130, 143, 141, 4


class _TerminatedError(BaseException):
    """SIGTERM arrived; derived from BaseException so that no solver swallows it."""


_arrived: list[int] = []
"""Exit codes of the signals that arrived, because a library may convert their errors."""


def _terminate(_signal: int, _frame: FrameType | None) -> None:
    _arrived.append(SIGTERM_EXIT)
    raise _TerminatedError


def _interrupt(_signal: int, _frame: FrameType | None) -> None:
    _arrived.append(SIGINT_EXIT)
    raise KeyboardInterrupt


def run(arguments: list[str]) -> int:
    """Run one command.

    Args:
        arguments: the words after `dualarm`.

    Returns:
        The exit code of the process.
    """
    _arrived.clear()
    signal.signal(signal.SIGTERM, _terminate)
    # Where SIGINT is ignored, as in the background of a shell script, it stays so.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupt)
    _open_closed_streams()
    try:
        code = _run_command(arguments)
        sys.stdout.flush()
        return code
    except BrokenPipeError:
        # The reader has closed the pipe: nothing can be printed, not even by the interpreter at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return PIPE_EXIT
    except SystemExit as error:
        # typer ends the process itself on Ctrl-C, rich on a closed pipe: both lose their meaning by that.
        code = error.code if isinstance(error.code, int) else INTERNAL_EXIT
        return _report("interrupted", code, arguments) if code == SIGINT_EXIT else code
    except (KeyboardInterrupt, typer.Abort):
        return _report("interrupted", SIGINT_EXIT, arguments)
    except _TerminatedError:
        return _report("terminated", SIGTERM_EXIT, arguments)
    except _COMMAND_LINE_ERROR as error:
        if type(error).__name__ == "NoArgsIsHelpError":
            return _report(error.format_message(), 2, arguments)
        context = getattr(error, "ctx", None)
        hint = f" Try '{context.command_path} --help'." if context is not None else ""
        # typer repeats how pydantic names the kind of an error.
        text = error.format_message().rstrip(".").replace("Value error, ", "")
        return _report(f"error: {text}{'' if text.endswith('?') else '.'}{hint}", 2, arguments)
    except DualArmError as error:
        from dualarm_cli.files.source.diagnostics import error_text

        return _report(error_text(error), error.exit_code, arguments)
    except Exception as error:
        if _arrived:
            words = {SIGINT_EXIT: "interrupted", SIGTERM_EXIT: "terminated"}
            return _report(words[_arrived[-1]], _arrived[-1], arguments)
        return _unexpected(error, arguments)


def _unexpected(error: Exception, arguments: list[str]) -> int:
    """Report an unexpected error and return its exit code."""
    if lacks_memory(error):
        text = (
            f"error: not enough memory ({type(error).__name__}); close other programs, allow this one more "
            "(ulimit -v), or plan fewer tasks at once"
        )
        return _report(text, INTERNAL_EXIT, arguments)
    if isinstance(error, OSError):
        return _report(
            f"error: {error.strerror}: {error.filename or 'standard output'}", 2, arguments
        )
    if os.environ.get("DUALARM_DEBUG"):
        raise error
    text = f"error: internal error: {type(error).__name__}: {error}\nThis is a bug; "
    return _report(f"{text}DUALARM_DEBUG=1 shows where.", INTERNAL_EXIT, arguments)


def _open_closed_streams() -> None:
    """Open a null device in place of closed stdout or stderr."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            # Kept open on purpose: it lasts as long as the process.
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115, PTH123


def _run_command(arguments: list[str]) -> int:
    command = typer.main.get_command(command_line(arguments[0] if arguments else ""))
    result = command.main(args=arguments, prog_name="dualarm", standalone_mode=False)
    if result == SIGINT_EXIT:
        raise KeyboardInterrupt  # typer makes an exit code of it
    return result if isinstance(result, int) else 0


def _report(text: str, code: int, arguments: list[str]) -> int:
    """Report an error on stderr, and on stdout as a JSON document if requested."""
    from dualarm_cli.cli.parts.output import print_json, print_message

    if code == INTERNAL_EXIT:
        # There may be too little memory for a library that colours it.
        sys.stderr.write(text + "\n")
    else:
        print_message(text)
    if "--json" in arguments:
        print_json({"format": "dualarm.error/1", "exit_code": code, "message": text})
    return code


COMMANDS: Mapping[str, str] = {
    "init": "init.init_command",
    "check": "check.check_command",
    "explain": "lists.explain_command",
    "schema": "lists.schema_command",
    "plan": "plan.plan_command",
    "sweep": "sweep.sweep_command",
    "why": "why.why_command",
    "report": "report.report_command",
    "export": "export.export_command",
    "verify": "verify.verify_command",
    "score": "score.score_command",
    "compare": "compare.compare_app",
    "platform": "platform.platform_command",
    "curve": "curve.curve_command",
    "solvers": "lists.solvers_command",
    "robot": "robot.robot_app",
    "calibrate": "calibrate.calibrate_command",
}
"""Modules and names of commands and groups, in the order of the help."""


def command_line(only: str = "") -> typer.Typer:
    """Build the command line application with its commands.

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
        cls=HelpGroup,
    )
    app.callback()(root)
    for name in [only] if only in COMMANDS else COMMANDS:
        module, _, attribute = COMMANDS[name].partition(".")
        command = getattr(import_module(f"dualarm_cli.cli.{module}"), attribute)
        if isinstance(command, typer.Typer):
            app.add_typer(command)
        else:
            app.command(name, cls=HelpCommand)(command)
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
    """Handle the options that precede every command: `--version`."""
