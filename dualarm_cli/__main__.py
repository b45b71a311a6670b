"""`python -m dualarm_cli` and the `dualarm` command."""

from __future__ import annotations

import os
import sys


def main() -> None:
    """Runs the command line and ends the process with its exit code."""
    # The matrices here are small: more than one thread of the linear algebra only costs time. It must be
    # said before numpy is loaded, and a user who said otherwise is right.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from dualarm_cli.cli.run import run

    sys.exit(run(sys.argv[1:]))


if __name__ == "__main__":
    main()
