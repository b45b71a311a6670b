"""Entry point of `python -m dualarm_cli` and the `dualarm` command."""

from __future__ import annotations

import atexit
import gc
import os
import signal
import sys
from contextlib import suppress
from typing import NoReturn

from dualarm_cli.system import memory_limit

SIGINT_EXIT = 130
NO_MEMORY_EXIT = 4
LEAST_MEMORY = 400_000_000
"""Minimum address space of the libraries [B]; with less, OpenBLAS retries forever."""

COLLECT_AFTER = 300_000
"""Number of new objects that starts a garbage collection."""
STACK = 70_000
"""Stack size of the outermost frame [words]: half of a 1 MB chunk of CPython."""


def main() -> NoReturn:
    """Run the command line and end the process with its exit code."""
    allowed = memory_limit()
    if allowed is not None and allowed < LEAST_MEMORY:
        print(
            f"error: not enough memory: this process may use {allowed / 1e6:.0f} MB (ulimit -v), "
            f"at least {LEAST_MEMORY / 1e6:.0f} MB are needed",
            file=sys.stderr,
        )
        sys.exit(NO_MEMORY_EXIT)
    # The matrices here are small: further threads of the linear algebra only cost time. The variable must be set before
    # numpy is imported; a user's own value is kept.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Pydantic's search for plugins, which are not needed here, would read the metadata of every installed package.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    # Modules, jobs and plans are no garbage: scanning them repeatedly takes a tenth of the start.
    gc.set_threshold(COLLECT_AFTER)
    try:
        code = _run(sys.argv[1:])
    except KeyboardInterrupt:
        # It came before the command began, or while an earlier interrupt was reported.
        code = SIGINT_EXIT
    _end(code)


def _run(arguments: list[str]) -> int:
    from dualarm_cli.cli.run import run

    return run(arguments)


# CPython keeps frames in chunks of 16 kB. If the calls of a loop cross the end of a chunk, each of them maps and unmaps
# memory: some of numpy's modules, imported at such a depth, took ten times as long.
_run.__code__ = _run.__code__.replace(co_stacksize=STACK)


def _end(code: int) -> NoReturn:
    """End the process without the interpreter's clean-up, which takes longer than many commands.

    Threads that are no daemons are not waited for: none exist by then.

    Args:
        code: exit code.
    """
    # Further signals do not change the result.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    if sys.getprofile() or sys.gettrace() or sys.flags.inspect:
        # A profiler, a debugger or an interactive session needs the regular exit.
        sys.exit(code)
    # No public function runs the exit handlers, by which libraries close files and coverage writes its data.
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        # The command itself has reported failed output, if possible.
        with suppress(AttributeError, OSError, ValueError):
            stream.flush()
    os._exit(code)


if __name__ == "__main__":
    main()
