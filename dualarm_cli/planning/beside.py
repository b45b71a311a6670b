"""What does not depend on a plan, worked out in a second process while the plan is made."""

from __future__ import annotations

import os
import pickle
import signal
from collections.abc import Callable
from types import TracebackType
from typing import Generic, TypeVar

T = TypeVar("T")


class Beside(Generic[T]):
    """A function's result. Within the `with` block a copy of this process works it out, if there is to be one.

    The result is the same with and without. Where the copy fails, of whatever, this process calls the function itself,
    so that errors are its own.
    """

    def __init__(self, made: Callable[[], T], *, copied: bool) -> None:
        """Prepares for it.

        Args:
            made: the function; what it returns can be pickled, and it has no side effects.
            copied: whether a copy of this process works it out.
        """
        self.made, self.copied = made, copied
        self._child: int | None = None
        self._pipe: int | None = None

    def __enter__(self) -> Beside[T]:
        """Makes the copy."""
        if not self.copied:
            return self
        self._pipe, end = os.pipe()
        self._child = os.fork()
        if self._child == 0:
            _work(self.made, end)
        os.close(end)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Ends the copy, if it still works."""
        if self._child is not None:
            os.kill(self._child, signal.SIGKILL)
            self._wait()
        if self._pipe is not None:
            os.close(self._pipe)

    def result(self) -> T:
        """Returns the result as soon as there is one."""
        if self._child is not None and self._pipe is not None:
            parts = []
            while part := os.read(self._pipe, 1 << 20):
                parts.append(part)
            if self._wait() == 0:
                found: T = pickle.loads(b"".join(parts))
                return found
        return self.made()

    def _wait(self) -> int:
        """Returns how the copy ended: 0 where its result is whole."""
        assert self._child is not None
        _, status = os.waitpid(self._child, 0)
        self._child = None
        return status


def _work(made: Callable[[], T], end: int) -> None:
    """Writes a function's result to one end of a pipe and ends the process, without anything that is done at exit."""
    status = 1
    try:
        # Ctrl-C is answered by the process that was copied.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        with os.fdopen(end, "wb") as pipe:
            pipe.write(pickle.dumps(made()))
        status = 0
    finally:
        os._exit(status)
