"""`dualarm plan --watch`: plans again whenever a file of the job changes, and shows the newest page."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from dualarm_cli.cli.parts.output import print_message
from dualarm_cli.errors import DualArmError, InputError

if TYPE_CHECKING:
    from dualarm_cli.page.live import LivePage

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
