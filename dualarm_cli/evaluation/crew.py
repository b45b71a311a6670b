"""Crew: processes that evaluate requests, supervised: one that dies or takes too long costs its own request only."""

from __future__ import annotations

import json
import os
import selectors
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from dualarm_cli.errors import DualArmError
from dualarm_cli.evaluation.request import Request
from dualarm_cli.model.evaluation import Evaluation, Finding

ATTEMPTS = 2
"""How often a request is tried whose process dies or takes too long."""
LONGEST_START = 120.0
"""How long a process may take to load its libraries [s]."""
FAILED_STARTS = 3
"""After how many processes that die before they are ready it is given up."""
_START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from dualarm_cli.evaluation.worker import main; main(int(sys.argv[2]), int(sys.argv[3]))"
)
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class WorkersFailedError(DualArmError):
    """No process could be started that evaluates anything."""

    exit_code = 4


@dataclass(frozen=True)
class _Attempt:
    """One try at one request."""

    index: int
    number: int = 1


class _Worker:
    """One process, and what it is doing."""

    def __init__(self, first: _Attempt | None) -> None:
        """Starts the process; `first` is what it will do first, None for anything."""
        self.first = first
        self.attempt: _Attempt | None = None
        self.ready = False
        self.since = time.monotonic()
        self._rest = b""
        self.answers, theirs = os.pipe()
        os.set_blocking(self.answers, False)
        self._open = True
        path = json.dumps(sys.path)
        try:
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-c", _START, path, str(theirs), str(os.getpid())],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                pass_fds=(theirs,),
                # Away from the terminal's Ctrl-C: who supervises ends it.
                start_new_session=True,
                env=os.environ | dict.fromkeys(_ONE_THREAD, "1"),
            )
        finally:
            os.close(theirs)

    def give(self, attempt: _Attempt, request: Request) -> None:
        """Begins a request; a process that has died meanwhile is found out by its silence."""
        self.attempt, self.first, self.since = attempt, None, time.monotonic()
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

    def end(self) -> int:
        """Ends the process at once and returns what it ended with."""
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self.process.pid, signal.SIGKILL)
        code = self.process.wait()
        with suppress(BrokenPipeError):
            _pipe(self.process).close()
        if self._open:
            os.close(self.answers)
            self._open = False
        return code


def _pipe(process: subprocess.Popen[bytes]) -> Any:
    """Returns the pipe to a process's stdin, which all have that this module starts."""
    return process.stdin


class Crew:
    """As many processes as are wanted, started when there is work and kept warm until `close`."""

    def __init__(self, processes: int, timeout: float | None = None) -> None:
        """Prepares; nothing is started yet.

        Args:
            processes: how many there are at most, one or more.
            timeout: how long one request may take [s], from when a process that is ready begins; None for no limit.
        """
        self._processes, self._timeout = max(1, processes), timeout
        self._workers: list[_Worker] = []
        self._failed_starts = 0

    def __enter__(self) -> Crew:
        """Returns itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Ends all processes."""
        self.close()

    def close(self) -> None:
        """Ends all processes at once."""
        while self._workers:
            self._workers[-1].end()
            self._workers.pop()

    def run(self, requests: Sequence[Request]) -> Iterator[tuple[int, Evaluation]]:
        """Yields the place of each request and what it came to, in the order in which they are done.

        Args:
            requests: any number.

        Raises:
            WorkersFailedError: processes die before they are ready.
        """
        try:
            yield from self._run(requests)
        finally:
            # Whoever stops early leaves nothing behind that would answer the next one's requests.
            for worker in [w for w in self._workers if w.attempt or w.first]:
                self._workers.remove(worker)
                worker.end()

    def _run(self, requests: Sequence[Request]) -> Iterator[tuple[int, Evaluation]]:
        waiting = deque(_Attempt(index) for index in range(len(requests)))
        again: deque[_Attempt] = deque()
        left = len(requests)
        while left:
            self._assign(requests, waiting, again)
            done = []
            for worker in self._heard():
                documents, ended = worker.read()
                for document in documents:
                    if document == "ready":
                        worker.ready, self._failed_starts = True, 0
                    elif worker.attempt is not None:
                        done.append((worker.attempt.index, Evaluation.of_document(document)))
                        worker.attempt = None
                if ended:
                    done += self._lost(worker, requests, again, "crashed")
            for worker in self._late():
                done += self._lost(worker, requests, again, "timed_out")
            left -= len(done)
            yield from done

    def _assign(
        self, requests: Sequence[Request], waiting: deque[_Attempt], again: deque[_Attempt]
    ) -> None:
        """Gives work to processes that are ready, and starts some where there is more work than processes."""
        for worker in self._workers:
            if worker.ready and worker.attempt is None:
                attempt = worker.first or (waiting.popleft() if waiting else None)
                if attempt is not None:
                    worker.give(attempt, requests[attempt.index])
        # What failed once gets a process that has done nothing else; an idle one makes room for it.
        while again and len(self._workers) >= self._processes:
            idle = next((w for w in self._workers if w.attempt is None and w.first is None), None)
            if idle is None:
                break
            self._workers.remove(idle)
            idle.end()
        while again and len(self._workers) < self._processes:
            self._workers.append(_Worker(again.popleft()))
        starting = sum(not worker.ready for worker in self._workers)
        while len(self._workers) < self._processes and starting < len(waiting):
            self._workers.append(_Worker(None))
            starting += 1

    def _heard(self) -> list[_Worker]:
        """Waits until some processes have something to say, or one of them is late."""
        limits = [limit for worker in self._workers if (limit := self._until(worker)) is not None]
        now = time.monotonic()
        with selectors.DefaultSelector() as selector:
            for worker in self._workers:
                selector.register(worker.answers, selectors.EVENT_READ, worker)
            wait = None if not limits else max(0.0, min(limits) - now)
            return [key.data for key, _ in selector.select(wait)]

    def _until(self, worker: _Worker) -> float | None:
        """Returns until when a process must have said something; None where it has time."""
        if not worker.ready:
            return worker.since + LONGEST_START
        if worker.attempt is None or self._timeout is None:
            return None
        return worker.since + self._timeout

    def _late(self) -> list[_Worker]:
        now = time.monotonic()
        return [w for w in self._workers if (limit := self._until(w)) is not None and limit <= now]

    def _lost(
        self,
        worker: _Worker,
        requests: Sequence[Request],
        again: deque[_Attempt],
        status: Any,
    ) -> list[tuple[int, Evaluation]]:
        """Ends a process that died or is late, and returns the request that is given up for it, if one is.

        Raises:
            WorkersFailedError: it is one of several in a row that were never ready.
        """
        self._workers.remove(worker)
        code = worker.end()
        if not worker.ready:
            self._failed_starts += 1
            if self._failed_starts >= FAILED_STARTS:
                raise WorkersFailedError(
                    f"{FAILED_STARTS} processes in a row ended before they were ready, the last one by {_ended(code)}"
                )
            if worker.first is not None:
                again.append(worker.first)
            return []
        attempt = worker.attempt
        if attempt is None:
            return []
        if attempt.number < ATTEMPTS:
            again.append(_Attempt(attempt.index, attempt.number + 1))
            return []
        case = requests[attempt.index].case
        if status == "timed_out":
            text = f"took longer than {self._timeout:g} s, {ATTEMPTS} times (--timeout)"
        else:
            text = f"its process died {ATTEMPTS} times, at last by {_ended(code)}"
            text += "; is memory short?" if code == -signal.SIGKILL else ""
        return [(attempt.index, Evaluation(case, status, findings=(Finding(text, case),)))]


def _ended(code: int) -> str:
    """Returns what a process ended by."""
    if code >= 0:
        return f"exit code {code}"
    try:
        return signal.Signals(-code).name
    except ValueError:
        return f"signal {-code}"


def usable_cores() -> int:
    """Returns how many cores this process may use."""
    return max(1, len(os.sched_getaffinity(0)))
