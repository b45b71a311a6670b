"""Ctrl-C while something has been found: the first one ends the search, the next one everything.

One line on a terminal about what is being done, put into words whenever it is drawn.
"""

from __future__ import annotations

import os
import signal
import sys
from contextlib import suppress
from types import FrameType, TracebackType
from typing import TYPE_CHECKING

from dualarm_cli.orders.watch import SeenEnoughError, Watch

if TYPE_CHECKING:
    from rich.text import Text

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


class StatusLine:
    """What is being done, as a thing that rich draws: the search is not kept by telling it anything more."""

    def __init__(self, watch: Watch, doing: str) -> None:
        """Begins with what is being done first; the watch tells what comes then."""
        self.watch, self.doing = watch, doing
        watch.tell = self.tell

    def tell(self, doing: str) -> None:
        """Something else is being done from now on."""
        self.doing = doing

    def words(self) -> str:
        """Returns the line as it is now: while a search goes on with its best, its bound and its time."""
        watch = self.watch
        if not watch.searching:
            return self.doing
        known = []
        if watch.best is not None:
            known.append(f"best {watch.best:.2f} s")
        if watch.bound is not None:
            known.append(f"bound {watch.bound:.2f} s")
        limit = "" if watch.limit is None else f" of {watch.limit:g} s"
        known.append(f"{watch.elapsed():.0f} s{limit}")
        return f"{self.doing}: {', '.join(known)}"

    def __rich__(self) -> Text:
        """Returns what is drawn."""
        from rich.text import Text

        return Text(self.words(), no_wrap=True, overflow="ellipsis")
