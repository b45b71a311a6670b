"""One process that evaluates requests, as who supervises it sees it: started, given work, heard, ended."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from dualarm_cli.evaluation.request import Request

_START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from dualarm_cli.evaluation.worker import main; main(int(sys.argv[2]), int(sys.argv[3]))"
)
MOST_WORDS = 200
"""Longest last words of a process that are told."""
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class Attempt:
    """One try at one request."""

    index: int
    number: int = 1


class WorkerProcess:
    """One process, and what it is doing."""

    def __init__(self, first: Attempt | None) -> None:
        """Starts the process; `first` is what it will do first, None for anything."""
        self.first = first
        self.attempt: Attempt | None = None
        self.ready = False
        self.since = time.monotonic()
        self._rest = b""
        self.answers, theirs = os.pipe()
        # In memory: where the disk is full there is no other place.
        self._errors = os.memfd_create("errors")
        self._open = True
        try:
            os.set_blocking(self.answers, False)
            self.process = subprocess.Popen(
                [
                    *(sys.executable, "-P", "-c", _START),
                    *(json.dumps(sys.path), str(theirs), str(os.getpid())),
                ],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=self._errors,
                pass_fds=(theirs,),
                # Away from the terminal's Ctrl-C: who supervises ends it.
                start_new_session=True,
                env=os.environ | dict.fromkeys(_ONE_THREAD, "1"),
            )
        except BaseException:
            self._close()
            raise
        finally:
            os.close(theirs)

    def give(self, attempt: Attempt, request: Request) -> None:
        """Begins a request; a process that has died meanwhile is found out by its silence."""
        self.attempt, self.first, self.since = attempt, None, time.monotonic()
        # The process writes from the same place on: what it said of earlier requests is forgotten.
        os.ftruncate(self._errors, 0)
        os.lseek(self._errors, 0, os.SEEK_SET)
        line = json.dumps(request.as_document(), allow_nan=False).encode() + b"\n"
        with suppress(BrokenPipeError):
            _pipe(self.process).write(line)
            _pipe(self.process).flush()

    def read(self) -> tuple[list[Any], bool]:
        """Returns the documents that have come, and whether the process has ended."""
        ended = False
        while True:
            try:
                data = os.read(self.answers, 1 << 16)
            except BlockingIOError:
                break
            if not data:
                ended = True
                break
            self._rest += data
        *lines, self._rest = self._rest.split(b"\n")
        return [json.loads(line) for line in lines], ended

    def end(self) -> str:
        """Ends the process at once and returns what it ended by: signal or exit code, and its last words if any."""
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self.process.pid, signal.SIGKILL)
        code = self.process.wait()
        with suppress(BrokenPipeError):
            _pipe(self.process).close()
        words = self._last_words()
        self._close()
        return ended_by(code) + (f" ({words})" if words else "")

    def _last_words(self) -> str:
        """Returns the last line that the process wrote to stderr."""
        if not self._open:
            return ""
        size = os.fstat(self._errors).st_size
        data = os.pread(self._errors, 1 << 12, max(0, size - (1 << 12)))
        lines = data.decode(errors="replace").split("\n")
        line = next((line.strip() for line in reversed(lines) if line.strip()), "")
        return line if len(line) <= MOST_WORDS else f"{line[:MOST_WORDS]} ..."

    def _close(self) -> None:
        """Closes what is read from the process."""
        if self._open:
            self._open = False
            os.close(self.answers)
            os.close(self._errors)


def _pipe(process: subprocess.Popen[bytes]) -> Any:
    """Returns the pipe to a process's stdin, which all have that this module starts."""
    return process.stdin


def ended_by(code: int) -> str:
    """Returns what a process ended by.

    Args:
        code: as `subprocess` gives it.
    """
    if code >= 0:
        return f"exit code {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:
        return f"signal {-code}"
    return f"{name}; is memory short?" if -code == signal.SIGKILL else name
