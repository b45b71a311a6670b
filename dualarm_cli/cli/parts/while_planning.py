"""Interaction with a running search: Ctrl-C, the status line, and re-planning of watched files.

The first Ctrl-C ends a search that has a result, the next one gives up. A status line on a terminal names the current
activity. `dualarm plan --watch` plans again whenever a file of the job changes, and shows the newest page.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
import time
import webbrowser
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Any

import typer

from dualarm_cli.cli.parts.output import print_message
from dualarm_cli.errors import DualArmError
from dualarm_cli.orders.watch import SeenEnoughError, Watch

if TYPE_CHECKING:
    from rich.text import Text

    from dualarm_cli.page.live import LivePage

STOPPING = "stopping: the best found so far is planned and verified (Ctrl-C again to give up)"
"""Message on the first Ctrl-C."""


class Interrupts:
    """Context in which Ctrl-C ends a search that has a result.

    Without a result it raises KeyboardInterrupt.

    With a plan, or an order that can be planned, only the second Ctrl-C gives up.

    If SIGINT is ignored, as in the background of a shell script, it stays ignored.
    """

    def __init__(self, watch: Watch, *, quiet: bool) -> None:
        """Store the search to interrupt.

        Args:
            watch: of the search; its `enough` is set.
            quiet: whether to say nothing.
        """
        self.watch, self.quiet = watch, quiet
        self.asked = False
        self._former = signal.getsignal(signal.SIGINT)

    def __enter__(self) -> Interrupts:
        """Install the handler of SIGINT."""
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
        """Restore the previous handler of SIGINT."""
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
    """Check whether a module is being imported.

    An interrupt would leave it half initialised, and it is needed later.
    """
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def _say(text: str) -> None:
    """Write a line to stderr past its buffer.

    The signal may have interrupted a write to the buffer.
    """
    with suppress(OSError, ValueError):
        # On a terminal it takes the place of the status line, which is drawn again below it.
        clear = "\r\x1b[2K" if sys.stderr.isatty() else ""
        os.write(sys.stderr.fileno(), f"{clear}{text}\n".encode())


class StatusLine:
    """Status line that rich redraws with the current activity.

    It reads the watch whenever it is drawn; the search only reports a change of activity.
    """

    def __init__(self, watch: Watch, doing: str) -> None:
        """Start with the first activity; the watch reports the next ones."""
        self.watch, self.doing, self.begun = watch, doing, time.monotonic()
        watch.report = self.tell

    def tell(self, doing: str) -> None:
        """Change the displayed activity."""
        self.doing = doing

    def words(self) -> str:
        """Return the current text with best cycle time, bound, elapsed time and time left."""
        watch, figures = self.watch, list[str]()
        number, total = watch.step
        if number:
            figures.append(f"order {number} of {total}")
        if watch.best_plan is not None:
            figures.append(f"best {watch.best_plan.duration:.2f} s")
        elif watch.searching and watch.best is not None:
            figures.append(f"estimate {watch.best:.2f} s")
        if watch.searching and watch.bound is not None:
            figures.append(f"bound of the search {watch.bound:.2f} s")
        elapsed = f"after {time.monotonic() - self.begun:.0f} s"
        if watch.searching and watch.limit is not None:
            elapsed = f"after {watch.elapsed():.0f} s of {watch.limit:g} s"
        figures.append(elapsed)
        if (left := watch.left()) is not None:
            figures.append(f"at most about {left:.0f} s left")
        return f"{self.doing}: {', '.join(figures)}"

    def __rich__(self) -> Text:
        """Return the line as rich text."""
        from rich.text import Text

        return Text(self.words(), no_wrap=True, overflow="ellipsis")


INTERVAL = 30.0
"""Time between two lines of progress where stderr is no terminal [s]."""


@contextmanager
def lines_of_progress(status: StatusLine) -> Iterator[None]:
    """Write the status to stderr from time to time; short plans write none."""
    ended = threading.Event()

    def write() -> None:
        # Signals are for the main thread, which blocks them while it forks.
        signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
        while not ended.wait(INTERVAL):
            _say(status.words())

    threading.Thread(target=write, daemon=True).start()
    try:
        yield
    finally:
        ended.set()


PAUSE = 0.05
"""Interval at which the files are checked [s]."""
STILL = 0.05
"""Time without changes before planning starts [s]. Editors write in steps."""
KINDS = (".yaml", ".yml", ".urdf", ".csv", ".stl", ".obj", ".ply", ".dae")
"""Files of a job, by their endings."""


def keep_planning(tasks: Path, page: Path, plan: Callable[[], None], open_page: bool) -> None:
    """Plan whenever a file of the job has changed, until Ctrl-C.

    Args:
        tasks: the task file, or the name of a bundled job.
        page: the page that a plan writes.
        plan: plans once; raises what is wrong.
        open_page: whether the browser shows the page.

    Raises:
        PageNotBuiltError: this installation has no code of the page.
    """
    from dualarm_cli.files.source.bundled import task_file
    from dualarm_cli.page.live import LivePage
    from dualarm_cli.page.page import require_built

    require_built()
    file, _ = task_file(tasks)
    live = LivePage(replan=Replanning(file, page.parent))
    files = frozenset[Path]()
    print_message(f"watching {file}: its plan is shown at {live.link} ; Ctrl-C ends")
    if open_page:
        webbrowser.open(live.link)
    try:
        while True:
            files |= {path for path in file.parent.iterdir() if path.suffix.lower() in KINDS}
            seen, begin = stamps(files), time.time_ns()
            named = _inputs(file, page.parent, _plan_once(live, page, plan)) - files
            # Files that only the job names count as changed if they were saved while it was planned.
            seen |= {path: stamp for path, stamp in stamps(named).items() if stamp[0] < begin}
            files |= named
            while stamps(files) == seen:
                time.sleep(PAUSE)
            while (now := stamps(files)) != seen:
                seen = now
                time.sleep(STILL)
    except KeyboardInterrupt:
        print_message("watching has ended")
    finally:
        live.close()


class Replanning:
    """Planner of a job with levers chosen in its page, one at a time."""

    def __init__(self, tasks: Path, folder: Path) -> None:
        """Store the task file, and the folder of its plan."""
        self.tasks, self.folder = tasks, folder
        self._busy = threading.Lock()

    def __call__(self, request: Any) -> dict[str, Any]:
        """Plan, verify, and return status, cycle time and gain, or an error in words.

        Files and plan stay as they are: the values are replaced while the files are read, in a process of its own.

        Args:
            request: `{"levers": [["gripper 0.12 s to 0.06 s", 0.5], ...]}`: names with changes, and shares of them.
        """
        if not self._busy.acquire(blocking=False):
            return {"error": "a plan is being made: try again when it is shown"}
        try:
            chosen = [(str(name), float(share)) for name, share in request["levers"]]
            return self._planned(chosen)
        except DualArmError as error:
            return {"error": str(error)}
        except (LookupError, TypeError, ValueError):
            return {"error": "no levers of this plan: reload the page, and choose again"}
        finally:
            self._busy.release()

    def _planned(self, chosen: list[tuple[str, float]]) -> dict[str, Any]:
        from dualarm_cli.cli.parts.evaluating import evaluators
        from dualarm_cli.evaluation.request import case_name
        from dualarm_cli.exporting.schedule_reader import read_schedule
        from dualarm_cli.levers.changes import documents_of, levers
        from dualarm_cli.levers.replanning import Replanner, request_of
        from dualarm_cli.levers.stops import part

        schedule = read_schedule(self.folder)
        documents = documents_of(self.tasks)
        by_name = {str(lever): lever for lever in levers(documents)}
        parts = tuple(
            part(by_name[name], documents, min(max(share, -1.0), 1.0)) for name, share in chosen
        )
        request = request_of(schedule, self.tasks, case_name(self.tasks))
        with evaluators(1, None, None) as run:
            replanner = Replanner(schedule, request, run, None)
            replanner.plan([parts])
        [planned] = replanner.results
        evaluation = planned.evaluation
        return {
            "status": evaluation.status,
            "cycle_time": planned.cycle_time,
            "gain": planned.gain,
            "findings": [str(finding) for finding in evaluation.findings],
        }


def stamps(files: Collection[Path]) -> dict[Path, tuple[int, int]]:
    """Read modification time [ns] and size [B] of the files that exist."""
    stamps = {}
    for path in files:
        with suppress(OSError):
            state = path.stat()
            stamps[path] = (state.st_mtime_ns, state.st_size)
    return stamps


def _inputs(tasks: Path, folder: Path, is_planned: bool) -> frozenset[Path]:
    """List the files of a job, from its new plan if possible.

    The files of a plan are not read a second time.
    """
    from dualarm_cli.files.source.projects import Project
    from dualarm_cli.files.tasks.tasks import load_job

    try:
        if is_planned:
            schedule = json.loads((folder / "schedule.json").read_bytes())
            names = schedule["provenance"]["inputs"]
        else:
            names = load_job(tasks).inputs
    except (DualArmError, OSError, LookupError, TypeError, ValueError):
        return frozenset()
    return frozenset(Project.of(tasks).folder / name for name in names)


def _plan_once(live: LivePage, page: Path, plan: Callable[[], None]) -> bool:
    """Plan, and show the plan's page or the error; returns whether there is a plan."""
    from dualarm_cli.files.source.diagnostics import error_text

    try:
        # A plan that fails verification or misses its budget has a page that reports it.
        with suppress(typer.Exit):
            plan()
    except DualArmError as error:
        text = error_text(error)
        print_message(text)
        live.show_text("No plan", text, "This page reloads when a file of the job changes.")
        return False
    live.show(page.read_bytes())
    return True
