"""Ctrl-C while something has been found: the first one ends the search, the next one everything."""

from __future__ import annotations

import os
import signal
import sys
from contextlib import suppress
from types import FrameType, TracebackType

from dualarm_cli.orders.watch import SeenEnoughError, Watch

STOPPING = "stopping: the best found so far is planned and verified (Ctrl-C again to give up)"
"""What the first Ctrl-C is answered with."""


class Interrupts:
    """Within its `with` block Ctrl-C ends a search that has found something; any other one is a KeyboardInterrupt.

    Once there is a plan, or an order that can be planned, only the second one gives up.

    Where SIGINT is ignored, as in the background of a shell script, it stays so.
    """

    def __init__(self, watch: Watch, *, quiet: bool) -> None:
        """Prepares for a search.

        Args:
            watch: of the search; its `enough` is set.
            quiet: whether to say nothing.
        """
        self.watch, self.quiet = watch, quiet
        self.asked = False
        self._former = signal.getsignal(signal.SIGINT)

    def __enter__(self) -> Interrupts:
        """Takes over SIGINT."""
        self.watch.enough = lambda: self.asked
        if self._former is not signal.SIG_IGN:
            signal.signal(signal.SIGINT, self._interrupt)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Gives SIGINT back."""
        if self._former is not signal.SIG_IGN:
            signal.signal(signal.SIGINT, self._former)

    def _interrupt(self, _signal: int, frame: FrameType | None) -> None:
        if self.asked or not self.watch.endable:
            raise KeyboardInterrupt
        self.asked = True
        if not self.quiet:
            _say(STOPPING)
        if self.watch.droppable and not _importing(frame):
            raise SeenEnoughError


def _importing(frame: FrameType | None) -> bool:
    """Returns whether a module is being imported, which would be left half initialised and is needed later."""
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def _say(text: str) -> None:
    """Writes a line on stderr past its buffer, which the signal may have come in the middle of."""
    with suppress(OSError, ValueError):
        # On a terminal it takes the place of the status line, which is drawn again below it.
        clear = "\r\x1b[2K" if sys.stderr.isatty() else ""
        os.write(sys.stderr.fileno(), f"{clear}{text}\n".encode())
