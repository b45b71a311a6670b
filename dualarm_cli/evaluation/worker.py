"""Worker process: evaluate one request after another, in lines of JSON."""

from __future__ import annotations

import json
import os
import signal
import sys

from dualarm_cli.evaluation.request import Request
from dualarm_cli.system import end_with_parent


def main(answers: int, parent: int) -> None:
    """Answer requests from stdin until it ends.

    Args:
        answers: file descriptor that answers are written to: stdout is for libraries that print.
        parent: id of the process that has started this one and that it must not outlive.
    """
    # Ctrl-C is left to the parent process, which ends this one.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    end_with_parent(parent)
    from dualarm_cli.evaluation.evaluate import evaluate

    with os.fdopen(answers, "wb") as out:
        out.write(b'"ready"\n')
        out.flush()
        for line in sys.stdin.buffer:
            answer = evaluate(Request.of_document(json.loads(line)))
            out.write(json.dumps(answer.as_document(), allow_nan=False).encode() + b"\n")
            out.flush()
