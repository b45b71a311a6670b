"""Crew of supervised worker processes; a crash or timeout costs only its own request."""

from __future__ import annotations

import json
import math
import os
import selectors
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import Any

from dualarm_cli.errors import DualArmError
from dualarm_cli.evaluation.request import Request
from dualarm_cli.model.studies.evaluation import Evaluation, Finding, Status
from dualarm_cli.records import dataclass
from dualarm_cli.system import memory_file

_START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from dualarm_cli.evaluation.worker import main; main(int(sys.argv[2]), int(sys.argv[3]))"
)


@dataclass(frozen=True)
class CrewSettings:
    """Limits on attempts and times of processes."""

    most_words: int = 200
    """Maximum length of a process's reported last message."""
    longest_start: float = 120.0
    """Maximum time for a process to load its libraries [s]."""
    longest_wait: float = 3600.0
    """Longest single wait [s]; the kernel's timers end at some weeks."""
    failed_starts: int = 3
    """Number of consecutive failed starts after which the crew gives up."""
    attempts: int = 2
    """Maximum number of attempts at a request whose process dies or times out."""


CREW = CrewSettings()

_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class Attempt:
    """Attempt at one request."""

    index: int
    number: int = 1


class WorkerProcess:
    """Worker process and its current request."""

    def __init__(self, first: Attempt | None) -> None:
        """Start the process; `first` reserves it for an attempt."""
        self.first = first
        self.attempt: Attempt | None = None
        self.ready = False
        self.since = time.monotonic()
        self._rest = b""
        self.answers, theirs = os.pipe()
        self._errors = memory_file()
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
                # Detached from the terminal's Ctrl-C: the supervisor ends it.
                start_new_session=True,
                env=os.environ | dict.fromkeys(_ONE_THREAD, "1"),
            )
        except BaseException:
            self._close()
            raise
        finally:
            os.close(theirs)

    def give(self, attempt: Attempt, request: Request) -> None:
        """Send a request.

        The death of the process is detected later, when it is read.
        """
        self.attempt, self.first, self.since = attempt, None, time.monotonic()
        # Drop messages about earlier requests; the process appends at its file position.
        os.ftruncate(self._errors, 0)
        os.lseek(self._errors, 0, os.SEEK_SET)
        line = json.dumps(request.as_document(), allow_nan=False).encode() + b"\n"
        with suppress(BrokenPipeError):
            _pipe(self.process).write(line)
            _pipe(self.process).flush()

    def read(self) -> tuple[list[Any], bool]:
        """Read the complete documents, and whether the process has ended."""
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
        """Kill the process and describe its end: signal or exit code, and last message."""
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self.process.pid, signal.SIGKILL)
        code = self.process.wait()
        with suppress(BrokenPipeError):
            _pipe(self.process).close()
        words = self._last_words()
        self._close()
        return ended_by(code) + (f" ({words})" if words else "")

    def _last_words(self) -> str:
        """Return the last line that the process wrote to stderr."""
        if not self._open:
            return ""
        size = os.fstat(self._errors).st_size
        data = os.pread(self._errors, 1 << 12, max(0, size - (1 << 12)))
        lines = data.decode(errors="replace").split("\n")
        line = next((line.strip() for line in reversed(lines) if line.strip()), "")
        return line if len(line) <= CREW.most_words else f"{line[: CREW.most_words]} ..."

    def _close(self) -> None:
        """Close the pipes and the error file."""
        if self._open:
            self._open = False
            os.close(self.answers)
            os.close(self._errors)


def _pipe(process: subprocess.Popen[bytes]) -> Any:
    """Return the pipe to a process's stdin, which every worker has."""
    return process.stdin


def ended_by(code: int) -> str:
    """Describe the end of a process.

    Args:
        code: as `subprocess` gives it.
    """
    if code >= 0:
        return f"exit code {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:
        return f"signal {-code}"
    return f"{name}; possibly out of memory" if -code == signal.SIGKILL else name


class WorkersFailedError(DualArmError):
    """Error: no worker process could be started."""

    exit_code = 4


class Crew:
    """Pool of worker processes, started on demand and kept until `close`."""

    def __init__(
        self, processes: int, timeout: float | None = None, until: float | None = None
    ) -> None:
        """Store the limits; no process is started yet.

        Args:
            processes: maximum number, at least one.
            timeout: maximum time of one request in a ready process [s]; None for no limit.
            until: instant of the monotonic clock at which running requests end unanswered [s], or None.
        """
        self._processes, self._timeout = max(1, processes), timeout
        self._until = math.inf if until is None else until
        self._workers: list[WorkerProcess] = []
        self._failed_starts: list[str] = []

    def __enter__(self) -> Crew:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """End all processes."""
        self.close()

    def close(self) -> None:
        """End all processes at once."""
        while self._workers:
            self._workers[-1].end()
            self._workers.pop()

    def run(self, requests: Sequence[Request]) -> Iterator[tuple[int, Evaluation]]:
        """Yield the index and evaluation of each request on completion, as long as the time allows.

        Processes start at once, and load their libraries while the caller prepares to listen.

        Args:
            requests: any number.

        Raises:
            WorkersFailedError: processes die before they are ready; raised while listening.
        """
        while len(self._workers) < min(self._processes, len(requests)):
            self._workers.append(WorkerProcess(None))
        return self._listen(requests)

    def _listen(self, requests: Sequence[Request]) -> Iterator[tuple[int, Evaluation]]:
        try:
            yield from self._run(requests)
        finally:
            # After an early stop, remaining answers must not reach the next run.
            for worker in [w for w in self._workers if w.attempt or w.first]:
                self._workers.remove(worker)
                worker.end()

    def _run(self, requests: Sequence[Request]) -> Iterator[tuple[int, Evaluation]]:
        waiting = deque(Attempt(index) for index in range(len(requests)))
        again: deque[Attempt] = deque()
        left = len(requests)
        self._failed_starts.clear()
        # Processes that have died since the last requests are replaced; no request is lost to them.
        self._collect(requests, again, 0.0)
        while left and time.monotonic() < self._until:
            self._assign(requests, waiting, again)
            done = self._collect(requests, again, self._time_to_deadline())
            left -= len(done)
            yield from done
            if len(self._failed_starts) >= CREW.failed_starts:
                raise WorkersFailedError(
                    f"{CREW.failed_starts} processes in a row ended before they were ready, the last one by "
                    f"{self._failed_starts[-1]}"
                )

    def _assign(
        self, requests: Sequence[Request], waiting: deque[Attempt], again: deque[Attempt]
    ) -> None:
        """Give requests to ready processes, and start processes for the others."""
        for worker in self._workers:
            if worker.ready and worker.attempt is None:
                attempt = worker.first or (waiting.popleft() if waiting else None)
                if attempt is not None:
                    worker.give(attempt, requests[attempt.index])
        # A repeated attempt gets a fresh process, in place of an idle one.
        while again and len(self._workers) >= self._processes:
            idle = next((w for w in self._workers if w.attempt is None and w.first is None), None)
            if idle is None:
                break
            self._workers.remove(idle)
            idle.end()
        while again and len(self._workers) < self._processes:
            self._workers.append(WorkerProcess(again.popleft()))
        starting = sum(not worker.ready for worker in self._workers)
        while len(self._workers) < self._processes and starting < len(waiting):
            self._workers.append(WorkerProcess(None))
            starting += 1

    def _collect(
        self, requests: Sequence[Request], again: deque[Attempt], wait: float
    ) -> list[tuple[int, Evaluation]]:
        """Collect the evaluations that arrive, or are given up, within a time [s]."""
        done = []
        for worker in self._readable(wait):
            documents, ended = worker.read()
            for document in documents:
                if document == "ready":
                    worker.ready = True
                    self._failed_starts.clear()
                elif worker.attempt is not None:
                    done.append((worker.attempt.index, Evaluation.of_document(document)))
                    worker.attempt = None
            if ended:
                done += self._lost(worker, requests, again, "crashed")
        for worker in self._late():
            done += self._lost(worker, requests, again, "timed_out")
        return done

    def _readable(self, wait: float) -> list[WorkerProcess]:
        """Return the processes with data, or that have ended, within a time [s]."""
        with selectors.DefaultSelector() as selector:
            for worker in self._workers:
                selector.register(worker.answers, selectors.EVENT_READ, worker)
            return [key.data for key, _ in selector.select(wait)]

    def _time_to_deadline(self) -> float:
        """Compute the time until the next deadline of a process [s]."""
        limits = [limit for w in self._workers if (limit := self._deadline(w)) is not None]
        wait = min([self._until, *limits]) - time.monotonic()
        return min(CREW.longest_wait, max(0.0, wait))

    def _deadline(self, worker: WorkerProcess) -> float | None:
        """Compute the deadline of a process; None without a limit."""
        if not worker.ready:
            return worker.since + CREW.longest_start
        if worker.attempt is None or self._timeout is None:
            return None
        return worker.since + self._timeout

    def _late(self) -> list[WorkerProcess]:
        now = time.monotonic()
        return [w for w in self._workers if (end := self._deadline(w)) is not None and end <= now]

    def _lost(
        self,
        worker: WorkerProcess,
        requests: Sequence[Request],
        again: deque[Attempt],
        status: Status,
    ) -> list[tuple[int, Evaluation]]:
        """End a dead or late process; return its request if given up."""
        self._workers.remove(worker)
        ended = worker.end()
        if not worker.ready:
            self._failed_starts.append(ended)
            if worker.first is not None:
                again.append(worker.first)
            return []
        attempt = worker.attempt
        if attempt is None:
            return []
        if attempt.number < CREW.attempts:
            again.append(Attempt(attempt.index, attempt.number + 1))
            return []
        case = requests[attempt.index].case
        if status == "timed_out":
            text = f"took longer than {self._timeout:g} s, {CREW.attempts} times (--timeout)"
        else:
            text = f"its process ended {CREW.attempts} times, the last time by {ended}"
        return [(attempt.index, Evaluation(case, status, findings=(Finding(text, case),)))]
