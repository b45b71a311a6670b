"""`python -m dualarm_cli` and the `dualarm` command."""

from __future__ import annotations

import atexit
import gc
import os
import resource
import signal
import sys
from contextlib import suppress
from typing import NoReturn

SIGINT_EXIT = 130
NO_MEMORY_EXIT = 4
LEAST_MEMORY = 400_000_000
"""Address space that the libraries need by themselves [B]: with less, OpenBLAS tries forever to get some."""

COLLECT_AFTER = 300_000
"""Objects more than before after which garbage is looked for."""
STACK = 70_000
"""Words that the outermost frame asks for: CPython gives it a chunk of 1 MB, of which half is left for the others."""


def main() -> NoReturn:
    """Runs the command line and ends the process with its exit code."""
    allowed = resource.getrlimit(resource.RLIMIT_AS)[0]
    if allowed != resource.RLIM_INFINITY and allowed < LEAST_MEMORY:
        print(
            f"error: not enough memory: this process may use {allowed / 1e6:.0f} MB (ulimit -v), "
            f"at least {LEAST_MEMORY / 1e6:.0f} MB are needed",
            file=sys.stderr,
        )
        sys.exit(NO_MEMORY_EXIT)
    # The matrices here are small: more than one thread of the linear algebra only costs time. It must be
    # said before numpy is loaded, and a user who said otherwise is right.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Looking for plugins that pydantic does not need here reads the metadata of every package there is.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    # Modules, jobs and plans are no garbage: looking through them again and again takes a tenth of the start.
    gc.set_threshold(COLLECT_AFTER)
    try:
        code = _run(sys.argv[1:])
    except KeyboardInterrupt:
        # It came before there was anything to end, or while an earlier one was being reported.
        code = SIGINT_EXIT
    _end(code)


def _run(arguments: list[str]) -> int:
    from dualarm_cli.cli.run import run

    return run(arguments)


# CPython keeps frames in chunks of 16 kB. Where the calls of a loop happen to cross the end of one, each of them maps
# and unmaps memory: some of numpy's modules, loaded at such a depth, took ten times as long.
_run.__code__ = _run.__code__.replace(co_stacksize=STACK)


def _end(code: int) -> NoReturn:
    """Ends the process without the interpreter's tidying up, which takes longer than many a command.

    Threads that are no daemons are not waited for: there are none by then.

    Args:
        code: its exit code.
    """
    # Whoever asks once more gets the same answer.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    if sys.getprofile() or sys.gettrace() or sys.flags.inspect:
        # A profiler, a debugger or whoever looks around afterwards wants it otherwise.
        sys.exit(code)
    # Nothing public does it: libraries close their files so, and coverage writes its own.
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        # The command itself has said what could not be written, as far as anybody listens.
        with suppress(AttributeError, OSError, ValueError):
            stream.flush()
    os._exit(code)


if __name__ == "__main__":
    main()
