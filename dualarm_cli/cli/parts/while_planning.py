"""What happens beside a search: Ctrl-C, the status line, and watched files that are planned again.

Ctrl-C while something has been found: the first one ends the search, the next one everything.

One line on a terminal about what is being done, put into words whenever it is drawn.

`dualarm plan --watch`: plans again whenever a file of the job changes, and shows the newest page.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Collection
from contextlib import suppress
from pathlib import Path
from types import FrameType, TracebackType
from typing import TYPE_CHECKING

import typer

from dualarm_cli.cli.parts.output import print_message
from dualarm_cli.errors import DualArmError, InputError
from dualarm_cli.orders.watch import SeenEnoughError, Watch

if TYPE_CHECKING:
    from rich.text import Text

    from dualarm_cli.page.live import LivePage

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


PAUSE = 0.3
"""How often files are looked at [s]."""
STILL = 0.2
"""How long they must not have changed: editors write in steps [s]."""
KINDS = (".yaml", ".yml", ".urdf", ".csv", ".stl", ".obj", ".ply", ".dae")
"""Files of a job, by their endings."""


def keep_planning(tasks: Path, page: Path, plan: Callable[[], None]) -> None:
    """Plans whenever a file of the job has changed, until Ctrl-C.

    Args:
        tasks: the task file, or the name of a bundled job.
        page: the page that a plan writes.
        plan: plans once; raises what is wrong.

    Raises:
        PageNotBuiltError: this installation has no code of the page.
    """
    from dualarm_cli.files.source.bundled import task_file
    from dualarm_cli.page.live import LivePage
    from dualarm_cli.page.page import require_built

    require_built()
    file, _ = task_file(tasks)
    live, known = LivePage(), frozenset[Path]()
    print_message(f"watching {file}: its plan is shown at {live.address}; Ctrl-C ends")
    try:
        while True:
            known = _inputs(file, known)
            seen = stamps(known)
            _plan_once(live, page, plan)
            while stamps(known) == seen:
                time.sleep(PAUSE)
            while (now := stamps(known)) != seen:
                seen = now
                time.sleep(STILL)
    except KeyboardInterrupt:
        print_message("watching has ended")
    finally:
        live.close()


def stamps(files: Collection[Path]) -> dict[Path, tuple[int, int]]:
    """Returns when files were changed, and how long they are; those that are not there are left out."""
    found = {}
    for path in files:
        with suppress(OSError):
            state = path.stat()
            found[path] = (state.st_mtime_ns, state.st_size)
    return found


def _inputs(tasks: Path, known: frozenset[Path]) -> frozenset[Path]:
    """Returns the files of a job, and those beside its task file; while it cannot be read, those known before too."""
    from dualarm_cli.files.source.projects import Project
    from dualarm_cli.files.tasks.tasks import load_job

    beside = {path for path in tasks.parent.iterdir() if path.suffix.lower() in KINDS}
    try:
        names = load_job(tasks).inputs
    except DualArmError:
        return known | beside
    return frozenset(beside | {Project.of(tasks).folder / name for name in names})


def _plan_once(live: LivePage, page: Path, plan: Callable[[], None]) -> None:
    """Plans, and shows the plan's page or what is wrong."""
    from dualarm_cli.files.source.diagnostics import render

    try:
        # The verifier fails a plan, or it is over its budget: its page says so.
        with suppress(typer.Exit):
            plan()
    except DualArmError as error:
        text = render(error.diagnostics) if isinstance(error, InputError) else str(error)
        print_message(text)
        live.tell("No plan", text, "This page reloads when a file of the job changes.")
        return
    live.show(page.read_bytes())
