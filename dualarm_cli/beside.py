"""Work shared with a second process, a copy of this one, where the caller allows it; results are the same without."""

from __future__ import annotations

import atexit
import ctypes
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

S = TypeVar("S")
T = TypeVar("T")

PR_SET_PDEATHSIG = 1
"""Linux's number of the request to get a signal when the parent ends (`linux/prctl.h`)."""
ENDING = signal.SIGINT, signal.SIGTERM
"""Signals that end a command."""
LENGTH = 8
"""So many bytes before a result say how long it is: what is shorter is not whole."""

CONTROL_GROUPS = Path("/sys/fs/cgroup")
"""Where Linux shows what a container is given."""
MOST_CORES = 1024
"""More than any machine has."""

_copies: ContextVar[bool] = ContextVar("copies", default=False)
_unreaped: list[int] = []
"""Copies whose results are there: giving their memory back takes longer than sending a small one. They are reaped as
the next copy is made, the last ones as the process ends."""


def usable_cores() -> int:
    """Returns how many cores this process may use: those that it may run on, no more than its container is given."""
    return max(1, min(len(os.sched_getaffinity(0)), math.ceil(_given_cores(CONTROL_GROUPS))))


def _given_cores(root: Path) -> float:
    """Returns how many cores' time this process's control group has, or one around it; many where none says.

    Args:
        root: where the kernel shows control groups (version 2).
    """
    cores = float(MOST_CORES)
    with suppress(OSError, StopIteration, ValueError):
        lines = Path("/proc/self/cgroup").read_text().splitlines()
        own = next(line.removeprefix("0::/") for line in lines if line.startswith("0::/"))
        for folder in (
            root,
            *(root.joinpath(*own.split("/")[:k]) for k in range(1, own.count("/") + 2)),
        ):
            with suppress(OSError, ValueError):
                quota, period = (folder / "cpu.max").read_text().split()
                cores = min(cores, int(quota) / int(period))
    return cores


@contextmanager
def copies(allowed: bool) -> Iterator[None]:
    """Allows work within the `with` block to be shared with copies of this process, or forbids it.

    Args:
        allowed: whether there is a second core; else this process does everything.
    """
    before = _copies.set(allowed)
    try:
        yield
    finally:
        _copies.reset(before)


class Beside(Generic[T]):
    """A function's result. Within the `with` block a copy of this process works it out, if copies are allowed.

    The result is the same with and without. Where the copy fails, of whatever, this process calls the function itself,
    so that errors are its own.
    """

    def __init__(self, made: Callable[[], T]) -> None:
        """Prepares for it.

        Args:
            made: the function; what it returns can be pickled, and it has no side effects.
        """
        self.made = made
        self._child: int | None = None
        self._pipe: int | None = None

    def __enter__(self) -> Beside[T]:
        """Makes the copy."""
        if not _copies.get():
            return self
        _reap(os.WNOHANG)
        # A signal in between would leave a copy that nobody ends, or one that does all that this process does.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
        parent = os.getpid()
        try:
            self._pipe, end = os.pipe()
            try:
                self._child = os.fork()
                if self._child == 0:
                    _work(self.made, end, before, parent)
            except OSError:
                # There is no memory or no place for another process: this one does the work.
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
        """Ends the copy, if it still works."""
        self._end()

    def _end(self) -> None:
        if self._child is not None:
            # Where SIGCHLD is ignored it may be gone already.
            with suppress(ProcessLookupError):
                os.kill(self._child, signal.SIGKILL)
            _is_reaped(self._child)
            self._child = None
        if self._pipe is not None:
            os.close(self._pipe)
            self._pipe = None

    def result(self) -> T:
        """Returns the result as soon as there is one."""
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
                found: T = pickle.loads(written[LENGTH:])
                return found
        return self.made()


def both(one: Callable[[], S], other: Callable[[], T]) -> tuple[S, T]:
    """Returns the results of two functions, a copy of this process working out the second one's where allowed.

    Args:
        one: the longer one.
        other: see `Beside`.
    """
    with Beside(other) as beside:
        return one(), beside.result()


def halves(
    made: Callable[[Sequence[S]], Sequence[T]], items: Sequence[S], least: int = 2
) -> list[T]:
    """Returns what a function makes of items, a copy of this process working out their second half where allowed.

    Args:
        made: the function, which makes one result of each item, whatever the others are; see `Beside`.
        items: in any number.
        least: fewer of them are not worth a copy.
    """
    if not _copies.get() or len(items) < max(2, least):
        return list(made(items))
    middle = (len(items) + 1) // 2
    with Beside(lambda: list(made(items[middle:]))) as rest:
        # Meanwhile both cores have work.
        with copies(False):
            first = made(items[:middle])
        return [*first, *rest.result()]


def _work(made: Callable[[], T], end: int, mask: set[int], parent: int) -> NoReturn:
    """Writes a function's result to one end of a pipe and ends the process, without anything that is done at exit.

    Args:
        made: the function.
        end: of the pipe.
        mask: signals that are blocked from here on.
        parent: the process that was copied.
    """
    try:
        # Ctrl-C is answered by the process that was copied.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        # However the process ends that was copied, this one does not outlive it.
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:  # it ended before this could be asked for
            os._exit(0)
        _copies.set(False)
        # What was there before is not looked through: each page that is touched would be copied.
        gc.freeze()
        result = pickle.dumps(made(), pickle.HIGHEST_PROTOCOL)
        with os.fdopen(end, "wb") as pipe:
            pipe.write(len(result).to_bytes(LENGTH))
            pipe.write(result)
    finally:
        os._exit(0)


def _reap(options: int = 0) -> None:
    """Reaps copies that have ended; waits for all of them, but with the option WNOHANG."""
    _unreaped[:] = [copy for copy in _unreaped if not _is_reaped(copy, options)]


def _is_reaped(copy: int, options: int = 0) -> bool:
    """Reaps a copy, if it has ended, see `_reap`; returns whether it has."""
    try:
        return os.waitpid(copy, options)[0] == copy
    except ChildProcessError:
        # Where SIGCHLD is ignored the system has done it.
        return True


# So the processor time of all copies counts as this process's.
atexit.register(_reap)
