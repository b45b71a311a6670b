"""How far a study is: a bar on a terminal, nothing elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from dualarm_cli.cli.output import stderr_console

if TYPE_CHECKING:
    from dualarm_cli.studies.study_run import Progress


@contextmanager
def progress_bar(total: int, quiet: bool) -> Iterator[Callable[[Progress], None]]:
    """Yields what is told after every point.

    Args:
        total: how many points there are.
        quiet: whether to show nothing.
    """
    console = stderr_console()
    if quiet or not console.is_terminal:
        yield lambda _: None
        return
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    words = TextColumn("{task.description}")
    with Bar(TextColumn("planning"), *columns, words, console=console, transient=True) as bar:
        task = bar.add_task("", total=total)

        def tell(progress: Progress) -> None:
            known = [f"{progress.known} known already"] if progress.known else []
            time = None if progress.best is None else progress.best.figures["cycle_time"]
            best = [] if time is None else [f"best {time:.3f} s"]
            bar.update(task, completed=progress.done, description=", ".join([*best, *known]))

        yield tell
