"""Calls in a second process, a fork of this one, if allowed.

Results are the same without it.
"""

from __future__ import annotations

import atexit
import gc
import math
import os
import pickle
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from types import TracebackType
from typing import Generic, NoReturn, TypeVar

from dualarm_cli.system import IS_LINUX, core_count, end_with_parent

S = TypeVar("S")
T = TypeVar("T")

ENDING = signal.SIGINT, signal.SIGTERM
"""Signals that end a command."""
LENGTH = 8
"""Size of the length prefix of a result [B]."""

CONTROL_GROUPS = Path("/sys/fs/cgroup")
"""Folder of Linux's control groups, with the quotas of containers."""
MOST_CORES = 1024
"""Number of cores without a quota, more than any machine has."""

_workers_allowed: ContextVar[bool] = ContextVar("workers_allowed", default=False)
_unreaped: list[int] = []
"""Process ids of workers with delivered results, not yet reaped.

Releasing their memory takes longer than sending a small result. They are reaped when the next worker starts, the last
ones when this process ends.
"""


def usable_cores() -> int:
    """Count the cores that this process may use: its affinity, capped by its container's quota."""
    return max(1, min(core_count(), math.ceil(_core_quota(CONTROL_GROUPS))))


def _core_quota(root: Path) -> float:
    """Read the core quota of this process's control groups, or MOST_CORES.

    Args:
        root: folder of the kernel's control groups (version 2).
    """
    cores = float(MOST_CORES)
    with suppress(OSError, StopIteration, ValueError):
        lines = Path("/proc/self/cgroup").read_text().splitlines()
        group = next(line.removeprefix("0::/") for line in lines if line.startswith("0::/"))
        for folder in (
            root,
            *(root.joinpath(*group.split("/")[:k]) for k in range(1, group.count("/") + 2)),
        ):
            with suppress(OSError, ValueError):
                quota, period = (folder / "cpu.max").read_text().split()
                cores = min(cores, int(quota) / int(period))
    return cores


@contextmanager
def allow_workers(allowed: bool) -> Iterator[None]:
    """Allow or forbid worker processes within the `with` block.

    Args:
        allowed: whether a second core is available; else this process does all work.
    """
    before = _workers_allowed.set(allowed)
    try:
        yield
    finally:
        _workers_allowed.reset(before)


class BackgroundCall(Generic[T]):
    """Function call in a worker process within a `with` block, if workers are allowed.

    The result is the same without a worker. If the worker fails for any reason, this process calls the function itself,
    so that errors are raised here.
    """

    def __init__(self, function: Callable[[], T], *, is_long: bool = True, nice: int = 0) -> None:
        """Prepare the call.

        Args:
            function: function without side effects, whose result can be pickled.
            is_long: whether it takes longer than a worker, which costs about 20 ms.
            nice: increment of the worker's nice value, if other workers' results are needed sooner.
        """
        self.function, self._is_long, self._nice = function, is_long, nice
        self._child: int | None = None
        self._pipe: int | None = None

    def __enter__(self) -> BackgroundCall[T]:
        """Start the worker."""
        if not (self._is_long and _workers_allowed.get() and IS_LINUX):
            return self
        _reap(os.WNOHANG)
        # A signal in between would leave an orphaned worker, or one that continues as this process.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
        parent = os.getpid()
        try:
            self._pipe, end = os.pipe()
            try:
                self._child = os.fork()
                if self._child == 0:
                    _work(self.function, end, (before, self._nice), parent)
            except OSError:
                # No memory or process slot is free for a worker: this process does the work.
                pass
            os.close(end)
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        except BaseException:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
            self._end()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End the worker, if it still runs."""
        self._end()

    def _end(self) -> None:
        if self._child is not None:
            # If SIGCHLD is ignored it may be reaped already.
            with suppress(ProcessLookupError):
                os.kill(self._child, signal.SIGKILL)
            _is_reaped(self._child)
            self._child = None
        if self._pipe is not None:
            os.close(self._pipe)
            self._pipe = None

    def result(self) -> T:
        """Wait for the result and return it."""
        if self._child is not None and self._pipe is not None:
            parts = []
            while part := os.read(self._pipe, 1 << 20):
                parts.append(part)
            written = memoryview(b"".join(parts))
            whole = len(written) == LENGTH + int.from_bytes(written[:LENGTH])
            if whole:
                _unreaped.append(self._child)
            else:
                _is_reaped(self._child)
            self._child = None
            if whole:
                result: T = pickle.loads(written[LENGTH:])
                return result
        return self.function()


def run_both(first: Callable[[], S], second: Callable[[], T]) -> tuple[S, T]:
    """Call two functions, the second in a worker process if allowed.

    Args:
        first: the longer function.
        second: see `BackgroundCall`.
    """
    with BackgroundCall(second) as call:
        return first(), call.result()


def map_halves(
    function: Callable[[Sequence[S]], Sequence[T]], items: Sequence[S], least: int = 2
) -> list[T]:
    """Map a function over items, the second half in a worker process if allowed.

    Args:
        function: makes a result of each item independently of the others; see `BackgroundCall`.
        items: items in any number.
        least: minimum number of items for a worker.
    """
    if not _workers_allowed.get() or len(items) < max(2, least):
        return list(function(items))
    middle = (len(items) + 1) // 2
    with BackgroundCall(lambda: list(function(items[middle:]))) as second:
        # Both cores are busy: no further workers.
        with allow_workers(False):
            first_results = function(items[:middle])
        return [*first_results, *second.result()]


def _work(
    function: Callable[[], T], end: int, before: tuple[set[int], int], parent: int
) -> NoReturn:
    """Write a function's result to a pipe and end the process, without exit handlers.

    Args:
        function: the function.
        end: writing end of the pipe.
        before: signals blocked from here on, and increment of the nice value.
        parent: id of the parent process.
    """
    try:
        # The parent handles Ctrl-C.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_SETMASK, before[0])
        os.nice(before[1])
        # The worker ends with its parent, however that ends.
        end_with_parent(parent)
        _workers_allowed.set(False)
        # Garbage collection of inherited objects would copy each page that it touches.
        gc.freeze()
        result = pickle.dumps(function(), pickle.HIGHEST_PROTOCOL)
        with os.fdopen(end, "wb") as pipe:
            pipe.write(len(result).to_bytes(LENGTH))
            pipe.write(result)
    finally:
        os._exit(0)


def _reap(options: int = 0) -> None:
    """Reap ended workers; waits for all of them without the option WNOHANG."""
    _unreaped[:] = [worker for worker in _unreaped if not _is_reaped(worker, options)]


def _is_reaped(worker: int, options: int = 0) -> bool:
    """Reap a worker if it has ended; returns whether it has."""
    try:
        return os.waitpid(worker, options)[0] == worker
    except ChildProcessError:
        # If SIGCHLD is ignored the system has reaped it.
        return True


# The processor time of reaped workers counts as this process's.
atexit.register(_reap)
