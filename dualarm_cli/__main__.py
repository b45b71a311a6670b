"""`python -m dualarm_cli` and the `dualarm` command."""

from __future__ import annotations

import gc
import os
import resource
import signal
import sys

SIGINT_EXIT = 130
NO_MEMORY_EXIT = 4
LEAST_MEMORY = 400_000_000
"""Address space that the libraries need by themselves [B]: with less, OpenBLAS tries forever to get some."""

COLLECT_AFTER = 300_000
"""Objects more than before after which garbage is looked for."""


def main() -> None:
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
        from dualarm_cli.cli.run import run

        code = run(sys.argv[1:])
    except KeyboardInterrupt:
        # It came before there was anything to end, or while an earlier one was being reported.
        code = SIGINT_EXIT
    if code == SIGINT_EXIT:
        # Whoever asks once more while the interpreter cleans up gets the same answer.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        # An interrupt that passed through text given to exec (dataclasses make their methods so, while their
        # module is imported) is marked by CPython as never caught, and the process would die of the signal
        # instead of giving its exit code. The next text unmarks it.
        exec("")
    # The system takes all memory back: nothing need be looked through at the end.
    gc.freeze()
    sys.exit(code)


if __name__ == "__main__":
    main()
